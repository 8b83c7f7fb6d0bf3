# SPDX-License-Identifier: Apache-2.0
"""The plots of the page, as what plotly.js draws: {"data": traces, "layout": layout}.

Colours are names of CSS variables ("--blue"); the page puts in those of its light or dark mode.
"""
import math
from html import escape

import numpy as np

POINTS = 1500           # per curve; more would not be seen
PATH_POINTS = 4000      # of all bodies together
HEIGHT = 340            # px
COLOURS = ("--blue", "--orange", "--green", "--violet", "--red", "--grey")


def make_plots(analysis):
    """[(title, remark, plot)] of what there is to see."""
    figures, curves = analysis.figures, analysis.curves
    plots = []
    if not curves:
        return plots
    bands = _push_bands(figures, analysis.motion)
    if curves.get("reference"):
        plots.append(("How the error grows", "distance from an independent tight integration, the "
                      "largest of all bodies; dotted: how well that one knows itself",
                      _plane(_error_traces(curves["reference"]), bands, "m, rad", log=True)))
    plots.append(("The way of the centres of mass", "red: while a wrench acts; drag to turn",
                  _paths(analysis)))
    if curves["energy"]:
        plots.append(("Energy", "change since the start of each stretch without a wrench",
                      _plane(_interval_traces([("energy", curves["energy"])]), bands, "J")))
    kept = [(f"{entry['component']}, {entry['unit']}", part)
            for entry, part in zip(figures["momentum"], curves["momentum"]) if part]
    if kept:
        plots.append(("Momentum components that the scene keeps", "change, as for the energy",
                      _plane(_interval_traces(kept[:6]), bands, "N m s" if all(
                          entry["unit"] == "N m s" for entry in figures["momentum"][:6])
                          else "N m s, N s")))
    if curves["joints"]:
        plots.append(("How far the joints are open", "the worst joint",
                      _plane(_interval_traces([("open by", curves["joints"])]), bands, "m, rad",
                             log=True)))
    late = _lateness_traces(analysis.recording.diagnostics)
    if late:
        plots.append(("Lateness", "of the ticks against the wall clock, since the start",
                      _plane(late, bands, "us", log=True)))
    return plots


def _error_traces(parts):
    times = _joined([part[0] for part in parts])
    names = (("position, m", "--blue", "solid"), ("attitude, rad", "--orange", "solid"),
             ("position, known to", "--blue", "dot"), ("attitude, known to", "--orange", "dot"))
    return [_line(name, times, _joined([part[k + 1] for part in parts]), colour, dash)
            for k, (name, colour, dash) in enumerate(names)]


def _interval_traces(named):
    """A curve of each name, with gaps between its intervals."""
    return [_line(name, _joined([times for times, _ in part]),
                  _joined([change for _, change in part]), COLOURS[k % len(COLOURS)])
            for k, (name, part) in enumerate(named)]


def _lateness_traces(diagnostics):
    traces = []
    for key, name, colour in (("p50", "half of them within", "--green"),
                              ("p99", "99 % within", "--orange"), ("max", "all within", "--red")):
        field = f"lateness_{key}_us"
        values = [(stamp * 1e-9, float(entry[field])) for stamp, entry in diagnostics
                  if field in entry]
        if values:
            traces.append({**_line(name, *np.array(values).T, colour), "mode": "lines+markers"})
    return traces


def _paths(analysis):
    """3D paths; where a wrench acts on a body, its path is drawn again in red."""
    bodies = analysis.recording.bodies
    stretches = analysis.motion.stretches
    count = sum(len(s.steps) for s in stretches) * len(bodies)
    every = max(1, count // PATH_POINTS)
    traces = []
    times = _joined([s.log_times[::every] for s in stretches])
    for n, body in enumerate(bodies):
        places = _joined([s.position[::every, n] for s in stretches])
        traces.append(_path(escape(body), places, times, COLOURS[n % 4], 2))
        if len(bodies) == 1:            # its colour is free to show the time
            traces[-1]["line"].update(color=_plain(times), colorscale=[
                [0.0, "--blue"], [1.0, "--green"]], showscale=True, colorbar={
                    "title": {"text": "s"}, "thickness": 8, "len": 0.6, "x": 1.0})
        for stretch in stretches:
            for first, end, pushed in stretch.pushed:
                inside = (stretch.steps >= first) & (stretch.steps <= end)
                if pushed == body and inside.any():
                    traces.append(_path(f"{escape(body)}, pushed", stretch.position[inside, n],
                                        stretch.log_times[inside], "--red", 8))
        start = stretches[0].position[:1, n]
        traces.append({"type": "scatter3d", "mode": "markers", "name": f"{escape(body)} at 0 s",
                       "x": _plain(start[:, 0]), "y": _plain(start[:, 1]),
                       "z": _plain(start[:, 2]), "showlegend": False,
                       "marker": {"size": 4, "color": COLOURS[n % 4]}})
    for trace in traces[20:]:           # a legend of many bodies would hide the plot
        trace["showlegend"] = False
    axis = {"color": "--text", "gridcolor": "--grid", "backgroundcolor": "--card",
            "zerolinecolor": "--grid", "showbackground": False}
    return {"data": traces, "layout": {
        "scene": {
            "aspectmode": "data",
            "camera": {"eye": {"x": 1.4, "y": 1.4, "z": 0.7},
                       "center": {"x": 0, "y": 0, "z": -0.1}},
            **{name: {**axis, "title": {"text": f"{name[0]}, m"}}
               for name in ("xaxis", "yaxis", "zaxis")}},
        "margin": {"l": 0, "r": 0, "t": 0, "b": 0}, "height": HEIGHT, **_BASE,
        "legend": {"orientation": "h", "x": 0, "y": 0, "yanchor": "bottom"},
        "showlegend": len(bodies) > 1}}


def _path(name, places, times, colour, width):
    return {"type": "scatter3d", "mode": "lines", "name": name, "x": _plain(places[:, 0]),
            "y": _plain(places[:, 1]), "z": _plain(places[:, 2]), "text": [
                f"{t:.3f} s" if math.isfinite(t) else "" for t in times],
            "hovertemplate": "%{text}<br>%{x:.4g}, %{y:.4g}, %{z:.4g} m",
            "line": {"color": colour, "width": width}}


_BASE = {"paper_bgcolor": "rgba(0,0,0,0)", "plot_bgcolor": "rgba(0,0,0,0)",
         "font": {"color": "--text", "family": "system-ui, sans-serif", "size": 12},
         "legend": {"orientation": "h", "y": -0.24, "yanchor": "top", "x": 0},
         "hoverlabel": {"bgcolor": "--card", "bordercolor": "--grid", "font": {"color": "--text"}}}


def _plane(traces, bands, unit, log=False):
    """Curves over time; the traces must be finite and, for a log axis, positive to be seen."""
    axis = {"gridcolor": "--grid", "zerolinecolor": "--grid", "linecolor": "--grid",
            "automargin": True}
    return {"data": traces, "layout": {
        "xaxis": {**axis, "title": {"text": "time, s", "standoff": 6}},
        "yaxis": {**axis, "title": {"text": unit, "standoff": 8}, **(
            {"type": "log", "dtick": _decades(traces), "exponentformat": "power"} if log else
            {"exponentformat": "e"})},
        "shapes": bands, "margin": {"l": 8, "r": 8, "t": 8, "b": 8}, "height": HEIGHT,
        "hovermode": "x unified" if len(traces) <= 4 else "closest", **_BASE}}


def _decades(traces):
    """Whole decades between two lines of a log axis, so that there are at most seven."""
    values = [v for trace in traces for v in trace["y"] if v is not None and v > 0.0]
    span = math.log10(max(values) / min(values)) if values else 1.0
    return max(1, math.ceil(span / 7.0))


def _push_bands(figures, motion):
    end = float(motion.stretches[-1].log_times[-1])
    return [{"type": "rect", "xref": "x", "yref": "paper", "x0": push["from_s"], "layer": "below",
             "x1": end if push["to_s"] is None else push["to_s"], "y0": 0, "y1": 1,
             "fillcolor": "--red", "opacity": 0.18, "line": {"width": 0}}
            for push in figures["pushes"][:200]]


def _line(name, x, y, colour, dash="solid"):
    """A curve of at most POINTS: of each group of neighbours the value of largest size."""
    if len(x) > POINTS:
        size = np.where(np.isfinite(y), np.abs(y), np.inf)      # gaps stay
        edges = np.linspace(0, len(x), POINTS + 1).astype(int)
        pick = [a + int(np.argmax(size[a:b])) for a, b in zip(edges, edges[1:])]
        x, y = x[pick], y[pick]
    return {"type": "scatter", "mode": "lines", "name": escape(name), "x": _plain(x),
            "y": _plain(y), "line": {"color": colour, "width": 1.6, "dash": dash},
            "connectgaps": False, "hovertemplate": "%{y:.3g}"}


def _joined(parts):
    """Arrays end to end with a gap (NaN) between them."""
    gap = np.full((1, *parts[0].shape[1:]), np.nan)
    return np.concatenate([piece for part in parts for piece in (part, gap)][:-1])


def _plain(values):
    """Numbers for JSON, seven digits; a gap is null."""
    return [float(f"{value:.7g}") if math.isfinite(value) else None for value in values]
