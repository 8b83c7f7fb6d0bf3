# SPDX-License-Identifier: Apache-2.0
"""Self-contained HTML report of analyses: verdict, plots, motion, tables, scene. Needs no network.

Names come from untrusted files, so all of them are escaped. The Content-Security-Policy of the page
forbids other scripts and all requests.
"""

import base64
import hashlib
import json
import re
from html import escape
from importlib.resources import files

from liegroup_sim_ros.numbers import NO_NUMBER, counted

from .plots import difference_plot, make_plots
from .summary import OVERVIEW, balance_table, comparison_rows, headline, overview, sections, short_names
from .view import make_view, speeds

MOST_PARTS = 20  # largest number of recordings with plots in a report; further ones have tables only
MOST_LISTED = 20  # largest number of problems in the list at the top
LONGEST = 200_000  # largest number of characters of a text
NUMBER = re.compile(
    r"-?\d[\d.]*(?:e[+-]\d+)?"
    r"(?: (?:m|s|ms|us|rad|J|W|N)\b(?:/s)?(?: m\b)?(?: s\b)?)?"
)


def page_part(analysis, plots=True, shapes=None, columns=()):
    """Content of the page for one Analysis: JSON types, except NaN and infinity.

    shapes : {body: triangles} for the 3D view, see shapes.robot_shapes
    columns : as of make_plots
    """
    recording = analysis.recording
    return {
        "figures": analysis.figures,
        "plots": make_plots(analysis, columns) if plots else [],
        "view": make_view(analysis, shapes) if plots and analysis.motion.stretches else None,
        "description": analysis.scene.description.strip(),
        "differences": [note.removeprefix("changes the motion: ") for note in analysis.scene.differences],
        "events": "\n".join(
            f"{event.stamp_ns * 1e-9:12.6f} s  {event.name}: " + event.text.partition("\n")[0]
            for event in recording.events
        ),
        "scene": recording.scene_text,
        "settings": recording.settings,
    }


def make_page(parts, comparison=None, exceeded=(), bounds=()):
    """HTML of the page (about 5 MB, including plotly.js).

    parts      : one result of page_part per recording, or {"figures": {"log", "failed"}}
    comparison : (figures, curve), see comparison.differences
    exceeded   : messages on exceeded bounds
    bounds     : texts of all given bounds
    """
    data = [{"plots": [plot for *_, plot in part.get("plots", ())], "view": part.get("view")} for part in parts]
    one = len(parts) == 1
    body = _one(parts[0], 0, exceeded, bounds) if one else _several(parts, exceeded, bounds)
    if comparison:
        plots = difference_plot(comparison[1])
        data.append({"plots": [plot for *_, plot in plots], "view": None})
        rows = _rows("Comparison with the other recording", comparison_rows(comparison[0]))
        drawn = _plot_cards(plots)
        body += (
            f"<h2>Compared with {escape(comparison[0]['logs'][1])}</h2>"
            f'<div class="cards" data-part="{len(parts)}">{drawn}{rows}</div>'
        )
    title = (
        f"{parts[0]['figures']['scene']}: analysis of a recording" if one else f"Analysis of {len(parts)} recordings"
    )
    return frame(title, body, data)


def frame(title, body, data):
    """HTML of a page with the common style.

    body : HTML; plots are drawn into elements with data-part="k", see page.js
    data : for each part {"plots": for plotly.js, "view": from view.py or None}
    """
    resources = files(__package__)
    style, code = ((resources / f"page.{kind}").read_text(encoding="utf-8") for kind in ("css", "js"))
    from plotly.offline import get_plotlyjs  # takes a second to import

    scripts = get_plotlyjs(), code
    allowed = " ".join(f"'sha256-{_digest(script)}'" for script in scripts)
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; img-src data: blob:; \
style-src 'unsafe-inline'; script-src {allowed}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{escape(title)}</title>
<link rel="icon" href="data:,">
<style>{style}</style>
</head>
<body>
<main>
{body}
</main>
<script type="application/json" id="data">{_json(data)}</script>
<script>{scripts[0]}</script>
<script>{scripts[1]}</script>
</body>
</html>
"""


def _one(part, number, exceeded=(), bounds=()):
    """Page of one recording."""
    figures = part["figures"]
    problems = [*exceeded, *figures["problems"]]
    state = _state(len(problems), len(figures["warnings"]), len(part["differences"]))
    return (
        f"<header><h1>{escape(figures['scene'])}</h1>{state}</header>"
        f'<p class="verdict">{unbroken(figures["verdict"])}</p>'
        + _list("bad", problems)
        + _list("warn", figures["warnings"])
        + _bounds(bounds, exceeded)
        + _tiles(figures)
        + (f'<p class="soft">{escape(part["description"])}</p>' if part["description"] else "")
        + _differences(part["differences"])
        + f'<div data-part="{number}">{_plots(part)}</div>'
        + _tables(part)
    )


def _several(parts, exceeded, bounds):
    """Overview of several recordings, with an expandable section for each."""
    found = [part["figures"] for part in parts]
    names = short_names(found)
    problems_of = [figures.get("problems", [figures.get("failed")]) for figures in found]
    warnings_of = [figures.get("warnings", []) for figures in found]
    (bad, count), (doubtful, more) = (
        [sum(map(kind, texts)) for kind in (bool, len)] for texts in (problems_of, warnings_of)
    )
    of = f"of {len(parts)} recordings"
    verdict = f"Problems in {bad} {of}. " if bad else "No problems found. "
    verdict += f"Warnings in {doubtful} {of}." if doubtful else ""
    lines = "".join(
        f'<tr><td data-what="recording"><a href="#log{k}">{escape(name)}</a></td>'
        + "".join(
            f'<td data-what="{what}"{_alarm(value)}>{escape(value)}</td>'
            for what, value in zip(OVERVIEW, overview(figures))
        )
        + f'<td data-what="problems" class="{_grade(problems, warnings)}">'
        f"{len(problems) or (counted(len(warnings), 'warning') if warnings else 'none')}</td></tr>"
        for k, (name, figures, problems, warnings) in enumerate(zip(names, found, problems_of, warnings_of))
    )
    heads = "".join(f"<th>{what}</th>" for what in ("recording", *OVERVIEW, "problems"))
    body = (
        f"<header><h1>{len(parts)} recordings</h1>{_state(count + len(exceeded), more)}</header>"
        f'<p class="verdict">{verdict}</p>'
        + _list("bad", _listed(found, names, problems_of, exceeded))
        + _bounds(bounds, exceeded)
        + f'<section class="card"><table class="logs"><thead><tr>{heads}</tr></thead>'
        f"<tbody>{lines}</tbody></table></section>"
    )
    for k, (part, name) in enumerate(zip(parts, names)):
        figures = part["figures"]
        inside = (
            _list("bad", [figures["failed"]])
            if "failed" in figures
            else f'<p class="verdict">{unbroken(figures["verdict"])}</p>'
            + _list("bad", figures["problems"])
            + _list("warn", figures["warnings"])
            + _tiles(figures)
            + _plots(part)
            + _tables(part)
        )
        body += f'<details class="log" id="log{k}" data-part="{k}"><summary>{escape(name)}</summary>{inside}</details>'
    return body


def _listed(found, names, problems_of, exceeded):
    """List of the first problems of several recordings."""
    listed = [
        *exceeded,
        *(
            f"{name}: {text.removeprefix(figures['log'] + ': ')}"
            for figures, name, problems in zip(found, names, problems_of)
            for text in problems
        ),
    ]
    more = len(listed) - MOST_LISTED
    return listed if more <= 0 else [*listed[:MOST_LISTED], f"and {more} more"]


def _plots(part):
    view = _view(part["view"], bool(part["plots"])) if part["view"] else ""
    balance = part["figures"].get("balance", {})
    energies = table(balance_table(balance)) if "stored" in balance else ""
    return f'<div class="cards">{view}{energies}{_plot_cards(part["plots"])}</div>'


def _plot_cards(plots):
    """HTML of plots, with an element before those of a group into which page.js draws its selector."""
    cards, group = "", None
    for title, remark, plot in plots:
        if plot.get("pick") not in (None, group):
            group = plot["pick"]
            cards += (
                f'<section class="card picker" data-pick="{group}"><h3>{group}</h3>'
                '<p class="remark">click to show or hide</p><div class="chips"></div></section>'
            )
        cards += plot_card(title, remark)
    return cards


def _tables(part):
    """Tables, scene and configuration of a recording."""
    figures, settings = part["figures"], part["settings"]
    rows = "".join(
        f"<tr><td>{escape(key)}</td><td>{escape(_text(value))}</td></tr>"
        for key, value in sorted(settings.items())
        if key != "topics"
    )
    return (
        '<div class="tables">'
        + "".join(_rows(*section) for section in sections(figures))
        + "</div>"
        + _details("Events", f"<pre>{_shortened(part['events'])}</pre>")
        + _details("Scene", f"<pre>{_shortened(part['scene'])}</pre>")
        + _details("Configuration", f'<table class="settings">{rows}</table>')
        + f'<p class="soft">{escape(figures["log"])}</p>'
    )


def _text(value):
    if isinstance(value, dict):
        return ", ".join(f"{key} {_text(entry)}" for key, entry in value.items()) or "-"
    return "-" if value is None else value if isinstance(value, str) else json.dumps(value)


def plot_card(title, remark):
    """HTML of an element into which page.js draws a plot."""
    return (
        f'<section class="card"><h3>{escape(title)}</h3><p class="remark">{escape(remark)}</p>'
        '<div class="plot plane"></div></section>'
    )


def _view(view, has_plots):
    choices, first = speeds(view["seconds"])
    options = "".join(
        f'<option value="{speed:g}"{" selected" if speed == first else ""}>{speed:g} ×</option>' for speed in choices
    )
    remark = f"{counted(view['frames'], 'frame')}; drag to rotate; toolbar: zoom and pan" + (
        "; click on a plot below to go to that time" if has_plots else ""
    )
    return (
        f'<section class="card view"><h3>Motion</h3><p class="remark">{remark}</p>'
        '<div class="plot"></div><div class="controls">'
        '<button type="button">Play</button>'
        f'<input type="range" min="0" max="{view["frames"] - 1}" value="0" step="1" '
        'aria-label="time">'
        f'<output></output><select aria-label="playback speed relative to real time">{options}</select>'
        "</div></section>"
    )


def _rows(title, rows):
    return (
        f'<section class="card"><h3>{escape(title)}</h3><table class="rows">'
        + "".join(
            f"<tr><td>{escape(what)}</td><td{_alarm(value)}>{unbroken(value)}</td><td>{unbroken(remark)}</td></tr>"
            for what, value, remark in rows
        )
        + "</table></section>"
    )


def _tiles(figures):
    tiles = "".join(
        f"<div><span>{escape(what)}</span><b{_alarm(value)}>{unbroken(value)}</b><span>{unbroken(remark)}</span></div>"
        for what, value, remark in headline(figures)
    )
    return f'<div class="tiles">{tiles}</div>'


def table(content):
    """HTML of a Table, in a card of its own."""
    title = f"<h3>{escape(content.title)}</h3>" if content.title else ""
    heads = "".join(f"<th>{escape(head)}</th>" for head in content.heads)
    rows = "".join(
        "<tr>"
        + "".join(
            f'<td data-what="{escape(head)}"><span>{unbroken(cell)}</span></td>'
            for head, cell in zip(content.heads, row)
        )
        + "</tr>"
        for row in content.rows
    )
    return (
        f'<section class="card">{title}<table class="logs"><thead><tr>{heads}</tr></thead>'
        f"<tbody>{rows}</tbody></table></section>"
    )


def _grade(problems, warnings):
    return "bad" if problems else "warn" if warnings else "good"


def _state(problems, warnings, notes=0):
    """HTML of the verdict: numbers of problems, of warnings and of notes on the model."""
    counts = [counted(count, noun) for count, noun in ((problems, "problem"), (warnings, "warning")) if count]
    counts = counts or ["no numerical problem found" if notes else "no problem found"]
    counts += [f"{counted(notes, 'note')} on the model"] if notes else []
    grade, sign = _grade(problems, warnings or notes), "✗" if problems else "!" if warnings or notes else "✓"
    return f'<span class="state {grade}">{sign} {", ".join(counts)}</span>'


def _differences(notes):
    return '<p class="warn">Notes on the model, which change the motion:</p>' + _list("soft", notes) if notes else ""


def _list(grade, texts):
    return f'<ul class="{grade}">' + "".join(f"<li>{escape(text)}</li>" for text in texts) + "</ul>" if texts else ""


def _bounds(bounds, exceeded):
    if not bounds:
        return ""
    result = "Bounds exceeded" if exceeded else "Within bounds"
    return f'<p class="{"bad" if exceeded else "good"}">{result}: {escape("; ".join(bounds))}</p>'


def _details(title, inside):
    return f'<details class="card"><summary>{title}</summary>{inside}</details>'


def _shortened(text):
    more = len(text) - LONGEST
    rest = f"\n... {counted(more, 'more character')}" if more > 0 else ""
    return escape(text[:LONGEST]) + rest


def unbroken(text):
    """Escaped text without line breaks within a number or before its unit."""
    parts, at = [], 0
    for number in NUMBER.finditer(text):  # before escaping: entities contain digits
        parts += [escape(text[at : number.start()]), f'<span class="n">{number[0]}</span>']
        at = number.end()
    return "".join(parts) + escape(text[at:])


def _alarm(value):
    return ' class="bad"' if value in NO_NUMBER else ""


def _digest(script):
    return base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()


def _json(data):
    """JSON escaped so that it cannot close its script element."""
    return json.dumps(data, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
