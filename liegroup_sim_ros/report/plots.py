# SPDX-License-Identifier: Apache-2.0
"""Plots of an analysis for plotly.js: {"data": traces, "layout": layout}.

Colours are names of CSS variables ("--blue"), which the page replaces for light or dark mode.
"""

import math
from html import escape

import numpy as np

from liegroup_sim_ros.analysis.estimate import LEAST, MOST

BINS = 1000  # number of bins of a curve; the minimum and the maximum of each bin are drawn
PATH_POINTS = 4000
HEIGHT = 340  # px
# A log axis omits at most the fraction FEW of its smallest values, if they are below ODD times the others.
FEW, ODD = 0.02, 1e-2
COLOURS = ("--blue", "--orange", "--green", "--violet", "--red", "--grey")


def make_plots(analysis):
    """[(title, remark, plot)] for all curves over time."""
    figures, curves = analysis.figures, analysis.curves
    plots = []
    if not curves:
        return plots
    marks = curves.get("joint_events")
    bands = _push_bands(figures, analysis.motion) + _event_lines(marks)
    if curves.get("reference"):
        kind = figures["reference"]["kind"]
        source = "the reference integration" if kind == "integration" else "the exact solution"
        estimate = "; dashed: estimate recorded with the run" if figures.get("estimate") else ""
        plots.append(
            (
                "Error",
                f"distance from {source}, largest of all bodies; dotted: reference uncertainty{estimate}",
                _plane(_error_traces(curves["reference"]), bands, "m, rad", log=True),
            )
        )
        ratios = _coverage_traces(curves["reference"])
        if ratios:
            plots.append(
                (
                    "Coverage",
                    f"estimate / error, where the error exceeds the uncertainty; lines at {LEAST:g} and {MOST:g}",
                    _ratio_plane(ratios, bands),
                )
            )
    if curves["energy"]:
        plots.append(
            (
                "Energy",
                "change since the start of each interval without applied wrenches",
                _plane(_interval_traces([("energy", curves["energy"])]), bands, "J"),
            )
        )
    conserved = [
        (f"{entry['component']}, {entry['unit']}", part)
        for entry, part in zip(figures["momentum"], curves["momentum"])
        if part
    ]
    if conserved:
        plots.append(
            (
                "Conserved momentum components",
                "change since the start of each interval without applied wrenches",
                _plane(
                    _interval_traces(conserved[:6]),
                    bands,
                    "N m s" if all(entry["unit"] == "N m s" for entry in figures["momentum"][:6]) else "N m s, N s",
                ),
            )
        )
    if curves["joints"]:
        plots.append(
            (
                "Constraint residuals",
                "largest of all joints",
                _plane(_interval_traces([("residual", curves["joints"])]), bands, "m, rad", log=True),
            )
        )
    for title, unit, part in (("forces", "N", slice(3, 6)), ("torques", "N m", slice(0, 3))):
        traces = _reaction_traces(analysis.recording.reactions, part)
        if traces:
            remark = "norm of the determined components, for the joints with the largest ones"
            plots.append((f"Reaction {title}", remark, _plane(traces, bands, unit)))
    late = _lateness_traces(analysis.recording.diagnostics)
    if late:
        plots.append(("Scheduling latency", "of all ticks since the start", _plane(late, bands, "µs", log=True)))
    if marks is not None and len(marks):
        for *_, plot in plots:
            plot["data"].append(_event_entry(figures, marks))
    return plots


def _error_traces(parts):
    times = _joined([part[0] for part in parts])
    names = (
        ("position, m", "--blue", "solid"),
        ("attitude, rad", "--orange", "solid"),
        ("position, uncertainty", "--blue", "dot"),
        ("attitude, uncertainty", "--orange", "dot"),
        ("position, estimate", "--blue", "dash"),
        ("attitude, estimate", "--orange", "dash"),
    )
    return [
        _line(name, times, _joined([part[k + 1] for part in parts]), colour, dash)
        for k, (name, colour, dash) in enumerate(names[: len(parts[0]) - 1])
    ]


def _coverage_traces(parts):
    """Curves of estimate / error for position and attitude, where both are known."""
    with_estimate = [part for part in parts if len(part) > 5]
    if not with_estimate:
        return []
    times, traces = _joined([part[0] for part in with_estimate]), []
    for k, (name, colour) in enumerate((("position", "--blue"), ("attitude", "--orange"))):
        ratios = []
        for part in with_estimate:
            error, uncertainty, estimate = part[1 + k], part[3 + k], part[5 + k]
            with np.errstate(invalid="ignore", divide="ignore"):
                ratios.append(np.where(error > uncertainty, estimate / error, np.nan))
        if any(np.isfinite(ratio).any() for ratio in ratios):
            traces.append(_line(name, times, _joined(ratios), colour))
    return traces


def _ratio_plane(traces, bands):
    """Plot of `_coverage_traces` with lines at the bounds of an estimate that covers the error."""
    lines = [
        {
            "type": "line",
            "xref": "paper",
            "yref": "y",
            "x0": 0,
            "x1": 1,
            "y0": value,
            "y1": value,
            "line": {"color": "--grey", "width": 1, "dash": "dot"},
        }
        for value in (LEAST, MOST)
    ]
    plot = _plane(traces, bands + lines, "estimate / error", log=True)
    ends = [math.log10(0.5 * LEAST), math.log10(2.0 * MOST), *_logarithms(traces)]
    plot["layout"]["yaxis"]["range"] = [min(ends), max(ends)]
    return plot


def _interval_traces(named):
    """One curve per name, with gaps between its intervals."""
    return [
        _line(
            name,
            _joined([times for times, _ in part]),
            _joined([change for _, change in part]),
            COLOURS[k % len(COLOURS)],
        )
        for k, (name, part) in enumerate(named)
    ]


def _reaction_traces(reactions, part):
    """Curves of the joints with the largest forces or torques, one for each colour."""
    sizes = {
        joint: (track.time, np.sqrt(np.nansum(track.wrench[:, part] ** 2, axis=1)))
        for joint, track in reactions.items()
    }
    largest = sorted(sizes, key=lambda joint: -sizes[joint][1].max(initial=0.0))[: len(COLOURS)]
    return [_line(joint, *sizes[joint], COLOURS[k]) for k, joint in enumerate(largest)]


def _lateness_traces(diagnostics):
    traces = []
    for key, name, colour in (("p50", "median", "--green"), ("p99", "p99", "--orange"), ("max", "maximum", "--red")):
        field = f"lateness_{key}_us"
        values = [(stamp * 1e-9, float(entry[field])) for stamp, entry in diagnostics if field in entry]
        if values:
            traces.append({**_line(name, *np.array(values).T, colour), "mode": "lines+markers"})
    return traces


BASE = {
    "paper_bgcolor": "rgba(0,0,0,0)",
    "plot_bgcolor": "rgba(0,0,0,0)",
    "font": {"color": "--text", "family": "system-ui, sans-serif", "size": 12},
    "legend": {"orientation": "h", "yref": "container", "y": 0, "yanchor": "bottom", "x": 0},
    "hoverlabel": {"bgcolor": "--card", "bordercolor": "--grid", "font": {"color": "--text"}},
}


def centre_paths(analysis):
    """{body: (k, 3) m} of the centres of mass, with gaps at resets."""
    stretches = analysis.motion.stretches
    every = max(1, sum(len(s.steps) for s in stretches) // PATH_POINTS)
    return {
        body.name: _joined([s.position[::every, n] + s.rotation[::every, n] @ np.array(body.com) for s in stretches])
        for n, body in enumerate(analysis.scene.bodies)
    }


def difference_plot(curve):
    """[(title, remark, plot)] of the curves of a comparison; empty if all differences are zero."""
    if not any((values > 0.0).any() for _, values in curve):
        return []
    traces = [
        _line(name, *part, colour) for name, part, colour in zip(("position, m", "attitude, rad"), curve, COLOURS)
    ]
    return [("Difference of the two recordings", "largest of all bodies", _plane(traces, [], "m, rad", log=True))]


def _plane(traces, bands, unit, log=False):
    """Plot of curves over time; a log axis shows positive values only."""
    axis = {"gridcolor": "--grid", "zerolinecolor": "--grid", "linecolor": "--grid", "automargin": True}
    return {
        "data": traces,
        "layout": {
            "xaxis": {**axis, "title": {"text": "time / s", "standoff": 6}},
            "yaxis": {
                **axis,
                "title": {"text": unit, "standoff": 8},
                **(
                    {"type": "log", "exponentformat": "power", **_decades(traces)}
                    if log
                    else {"exponentformat": "power"}
                ),
            },
            "shapes": bands,
            "margin": {"l": 8, "r": 8, "t": 30, "b": 8},
            "height": HEIGHT,
            "hovermode": "x unified" if len(traces) <= 6 else "closest",
            **BASE,
        },
    }


def _logarithms(traces):
    """Logarithms of the positive values of all curves; may be empty."""
    return [math.log10(v) for trace in traces for v in trace["y"] if v is not None and v > 0.0]


def _decades(traces):
    """(decades between grid lines, range) of a log axis with at most seven grid lines."""
    found, values = {}, _logarithms(traces)
    if not values:
        return {"dtick": 1}
    low, high = min(values), max(values)
    usual = float(np.quantile(values, FEW)) + math.log10(ODD)
    if low < usual:  # prevent an accidental difference of 1e-40 from stretching the axis
        low = usual
        found["range"] = [low, high + 0.2]
    return {"dtick": max(1, math.ceil((high - low) / 7.0)), **found}


def _push_bands(figures, motion):
    end = float(motion.stretches[-1].log_times[-1])
    return [
        {
            "type": "rect",
            "xref": "x",
            "yref": "paper",
            "x0": push["from_s"],
            "layer": "below",
            "x1": end if push["to_s"] is None else push["to_s"],
            "y0": 0,
            "y1": 1,
            "fillcolor": "--red",
            "opacity": 0.18,
            "line": {"width": 0},
        }
        for push in figures["pushes"][:200]
    ]


def _event_lines(times):
    return [
        {
            "type": "line",
            "xref": "x",
            "yref": "paper",
            "x0": time,
            "x1": time,
            "y0": 0,
            "y1": 1,
            "layer": "below",
            "opacity": 0.5,
            "line": {"color": "--grey", "width": 0.8},
        }
        for time in ([] if times is None else times.tolist())
    ]


def _event_entry(figures, times):
    """Invisible curve that gives the lines at joint events an entry in the legend."""
    count = figures["joint_events"]["instants"]
    some = "" if len(times) == count else f", {len(times)} of {count}"
    return _line(f"events at joints{some}", [math.nan], [math.nan], "--grey")


def _line(name, x, y, colour, dash="solid"):
    """Trace of a curve. Long curves are reduced to minimum, maximum and a gap of each bin."""
    if len(x) > 2 * BINS:
        pick = _extremes(y)
        x, y = x[pick], y[pick]
    return {
        "type": "scatter",
        "mode": "lines",
        "name": label(name),
        "x": _plain(x),
        "y": _plain(y),
        "line": {"color": colour, "width": 1.6, "dash": dash},
        "connectgaps": False,
        "hovertemplate": "%{y:.3g}",
    }


def label(name):
    """Name with escaped markup, so that plotly.js shows it literally."""
    return escape(name, quote=False)


def _extremes(y):
    """Indices of the minimum, the maximum and a gap (NaN) in each bin of successive values."""
    gaps = ~np.isfinite(y)
    low, high = np.where(gaps, np.inf, y), np.where(gaps, -np.inf, y)
    edges = np.linspace(0, len(y), BINS + 1).astype(int)
    rows = {a + int(values[a:b].argmax()) for a, b in zip(edges, edges[1:]) for values in (-low, high, gaps)}
    return np.array(sorted(rows))


def _joined(parts):
    """Concatenated arrays, separated by a gap (NaN)."""
    gap = np.full((1, *parts[0].shape[1:]), np.nan)
    return np.concatenate([piece for part in parts for piece in (part, gap)][:-1])


def _plain(values):
    """Numbers for JSON with seven digits; a gap is null."""
    return [float(f"{value:.7g}") if math.isfinite(value) else None for value in values]
