# SPDX-License-Identifier: Apache-2.0
"""One self-contained page of an analysis: verdict, plots, tables, scene. Needs no network."""
import json
from html import escape

from plotly.offline import get_plotlyjs

from .plots import make_plots
from .summary import NO_NUMBER, sections

STYLE = """
:root { color-scheme: light dark; --page: #f6f7f9; --card: #ffffff; --text: #1b1f24;
  --soft: #59636e; --grid: #d8dde3; --good: #12703a; --bad: #b3261e; --blue: #2a6fd6;
  --orange: #cf6a12; --green: #16875a; --violet: #7049c0; --red: #d63a3a; --grey: #6b7480; }
@media (prefers-color-scheme: dark) { :root { --page: #14171b; --card: #1d2127; --text: #e6e9ee;
  --soft: #9aa5b1; --grid: #363d46; --good: #5ecb8c; --bad: #ff8a80; --blue: #5b9cf5;
  --orange: #f0963f; --green: #45b98a; --violet: #ab8df0; --red: #ff6b6b; --grey: #97a1ad; } }
* { box-sizing: border-box; }
body { margin: 0; background: var(--page); color: var(--text);
  font: 16px/1.45 system-ui, -apple-system, "Segoe UI", Roboto, sans-serif; }
main { max-width: 78rem; margin: 0 auto; padding: 1rem; }
h1 { font-size: 1.5rem; margin: .3rem 0 .2rem; overflow-wrap: anywhere; }
h2 { font-size: 1.05rem; margin: 0 0 .15rem; }
.verdict { font-size: 1.1rem; margin: .2rem 0 .7rem; overflow-wrap: anywhere; }
.soft, .remark { color: var(--soft); font-size: .88rem; margin: 0 0 .4rem; }
.state { font-weight: 600; } .good { color: var(--good); } .bad { color: var(--bad); }
ul.bad { margin: .2rem 0 .8rem; padding-left: 1.2rem; overflow-wrap: anywhere; }
.cards { display: grid; gap: .8rem; margin: .8rem 0;
  grid-template-columns: repeat(auto-fit, minmax(min(100%, 27rem), 1fr)); }
.card { background: var(--card); border: 1px solid var(--grid); border-radius: .6rem;
  padding: .8rem; min-width: 0; }
table { border-collapse: collapse; width: 100%; }
tr + tr { border-top: 1px solid var(--grid); }
td { padding: .28rem .5rem .28rem 0; vertical-align: top; overflow-wrap: anywhere; }
td:nth-child(1) { width: 36%; } td:nth-child(2) { font-variant-numeric: tabular-nums;
  font-weight: 600; width: 30%; } td:nth-child(3) { color: var(--soft); font-size: .88rem; }
@media (max-width: 40rem) { tr { display: grid; grid-template-columns: 1fr 1fr; }
  td:nth-child(n) { width: auto; } td:nth-child(3) { grid-column: 1 / -1; padding-top: 0; } }
pre { overflow-x: auto; font-size: .8rem; margin: .4rem 0 0; }
details { margin: .5rem 0; } summary { cursor: pointer; }
"""

# Theme colours are looked up when a plot is drawn. On a touch screen a finger on a plot scrolls.
SCRIPT = """
const plots = JSON.parse(document.getElementById("plots").textContent);
const touch = matchMedia("(pointer: coarse)").matches;
function themed(value, style) {
  if (typeof value === "string" && value.startsWith("--"))
    return style.getPropertyValue(value).trim();
  if (Array.isArray(value)) return value.map(entry => themed(entry, style));
  if (value && typeof value === "object")
    return Object.fromEntries(Object.entries(value).map(([k, v]) => [k, themed(v, style)]));
  return value;
}
function draw() {
  const style = getComputedStyle(document.documentElement);
  plots.forEach((plot, k) => {
    const layout = themed(plot.layout, style);
    if (touch && layout.xaxis) {
      layout.xaxis.fixedrange = layout.yaxis.fixedrange = true;
      layout.dragmode = false;
    }
    Plotly.react("plot" + k, themed(plot.data, style), layout,
                 {responsive: true, displaylogo: false, displayModeBar: false});
  });
}
draw();
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
"""


def make_page(analysis):
    """Text of the page (HTML, about 5 MB: it carries plotly.js)."""
    figures, recording = analysis.figures, analysis.recording
    plots = make_plots(analysis)
    state = ('<p class="state good">Nothing is missing, nothing is wrong with the run.</p>'
             if not figures["problems"] else
             '<p class="state bad">What is wrong:</p><ul class="bad">'
             + "".join(f"<li>{escape(text)}</li>" for text in figures["problems"]) + "</ul>")
    drawn = "".join(
        f'<section class="card"><h2>{escape(title)}</h2><p class="remark">{escape(remark)}</p>'
        f'<div id="plot{k}"></div></section>' for k, (title, remark, _) in enumerate(plots))
    tables = "".join(
        f'<section class="card"><h2>{escape(title)}</h2><table>' + "".join(
            f"<tr><td>{escape(what)}</td><td{_alarm(value)}>{escape(value)}</td>"
            f"<td>{escape(remark)}</td></tr>" for what, value, remark in rows)
        + "</table></section>" for title, rows in sections(figures))
    events = "\n".join(f"{event.stamp_ns * 1e-9:12.6f} s  {event.name}: {event.text}"
                       for event in recording.events)
    description = analysis.scene.description.strip()
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{escape(figures["scene"])}: how wrong is this run?</title>
<link rel="icon" href="data:,">
<style>{STYLE}</style>
</head>
<body>
<main>
<h1>{escape(figures["scene"])}</h1>
<p class="soft">{escape(description)}</p>
<p class="verdict">{escape(figures["verdict"])}</p>
{state}
<div class="cards">{drawn}</div>
<div class="cards">{tables}</div>
{_details("Events", events)}
{_details("Scene", recording.scene_text)}
{_details("Settings", json.dumps(recording.settings, indent=1))}
<p class="soft">{escape(figures["log"])}</p>
</main>
<script type="application/json" id="plots">{_json([plot for _, _, plot in plots])}</script>
<script>{get_plotlyjs()}</script>
<script>{SCRIPT}</script>
</body>
</html>
"""


def _details(title, text):
    return (f'<details class="card"><summary>{escape(title)}</summary><pre>{escape(text)}</pre>'
            "</details>")


def _alarm(value):
    return ' class="bad"' if value in NO_NUMBER else ""


def _json(data):
    """JSON that cannot end the script element it stands in."""
    return json.dumps(data, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
