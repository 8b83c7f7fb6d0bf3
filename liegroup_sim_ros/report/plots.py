# SPDX-License-Identifier: Apache-2.0
"""Plots of an analysis for plotly.js: {"data": traces, "layout": layout}.

Colours are names of CSS variables ("--blue"), which the page replaces for light or dark mode.
"""

import math
from html import escape
from types import MappingProxyType

import numpy as np

from liegroup_core.forces.contact import UNITS
from liegroup_core.observables.along import STORES
from liegroup_sim_ros.analysis.analyse import NO_RESULT
from liegroup_sim_ros.analysis.balance import WORKS
from liegroup_sim_ros.analysis.estimate import LEAST, MOST
from liegroup_sim_ros.analysis.promise import allowed
from liegroup_sim_ros.numbers import shown

BINS = 1000  # number of bins of a curve; the minimum and the maximum of each bin are drawn
PATH_POINTS = 4000
HEIGHT = 340  # px
# A log axis omits at most the fraction FEW of its smallest values, if they are below ODD times the others.
FEW, ODD = 0.02, 1e-2
COLOURS = ("--blue", "--orange", "--green", "--violet", "--red", "--grey")
MOST_RESTARTS = 200  # largest number of them that are marked
MANY_COLOURS = ("--blue", "--orange", "--green", "--violet", "--teal", "--pink", "--olive")
DASHES = ("solid", "dash", "dot")
MOST_CHOSEN = 6  # curves of many that are visible at first
TURNS = "angles are shown from -pi to pi, unless the joint"
# {(part, unit) of columns of joints: (title, remark or None: that of the quantity)} of their plots.
JOINT_PLOTS = {
    ("position", "rad"): ("Joint angles", f"{TURNS} has a spring, servo, law, coupling or drive"),
    ("position", "m"): ("Joint displacements", "along the axes"),
    ("velocity", "rad/s"): ("Joint angular velocities", "rates of the angles"),
    ("velocity", "m/s"): ("Joint velocities", "rates of the displacements"),
    ("total_effort", "N m"): ("Joint torques", None),
    ("total_effort", "N"): ("Joint forces", None),
    ("power", "W"): ("Joint powers", None),
}
PARTS = tuple(dict.fromkeys(part for part, _ in JOINT_PLOTS))
CONTACT_REMARKS = {
    "normal_force": "sum of its points; peaks between samples do not show",
    "depth": "of its deepest point, while it presses",
    "work": "on its bodies, since the start",
}
PICKS = {
    "body": "Bodies",
    "joint": "Joints",
    "force": "Forces",
    "law": "Signals",
    "contact": "Contacts",
    "sensor": "Sensors",
    "": "Mechanism",
}


def make_plots(analysis, columns=()):
    """[(title, remark, plot)] for all curves over time.

    columns : names of columns of the Catalogue to plot beside those of joints. Raises SceneError for an unknown name
    """
    figures, curves = analysis.figures, analysis.curves
    plots = []
    if not curves:
        return plots
    marks = curves.get("joint_events")
    restarts = np.array([stretch.begin_ns * 1e-9 for stretch in analysis.motion.stretches[1:]][:MOST_RESTARTS])
    bands = _push_bands(figures, analysis.motion) + _event_lines(marks, "--grey") + _event_lines(restarts, "--violet")
    columns = [*(["signals"] if analysis.layout.signals else []), *columns]
    plots += _joint_plots(analysis, bands) + (
        _column_plots(*analysis.columns(columns), bands, contacts=analysis.layout.touching.names) if columns else []
    )
    if curves["balance"]:
        plots += _energy_plots(figures["balance"], curves["balance"], bands)
    remark, traces = _errors(analysis)
    if traces:
        if figures.get("promise"):
            plots.append(("Accuracy", *_accuracy_plot(analysis, bands)))
        plots.append(("Error", remark, plane(traces, bands, "m, rad", log=True)))
        ratios = _coverage_traces(curves.get("reference") or [])
        if ratios:
            plots.append(
                (
                    "Coverage",
                    f"estimate / error, where the error exceeds the uncertainty; lines at {LEAST:g} and {MOST:g}",
                    _with_lines(plane(ratios, bands, "estimate / error", log=True), (LEAST, MOST)),
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
                plane(
                    _interval_traces(conserved[:6]),
                    bands,
                    "N m s" if all(entry["unit"] == "N m s" for entry in figures["momentum"][:6]) else "N m s, N s",
                ),
            )
        )
    if any((residual > 0.0).any() for _, residual in curves["joints"]):
        plots.append(
            (
                "Constraint residuals",
                "largest of all joints",
                plane(_interval_traces([("residual", curves["joints"])]), bands, "m, rad", log=True),
            )
        )
    for title, unit, part in (("forces", "N", slice(3, 6)), ("torques", "N m", slice(0, 3))):
        traces = _reaction_traces(analysis.recording.reactions, part)
        if traces:
            remark = "norm of the determined components, for the joints with the largest ones"
            plots.append((f"Reaction {title}", remark, plane(traces, bands, unit)))
    late = _lateness_traces(analysis.recording.diagnostics)
    if late:
        plots.append(("Scheduling latency", "of all ticks since the start", plane(late, bands, "µs", log=True)))
    entries = [_event_entry(figures, marks)] if marks is not None and len(marks) else []
    if len(restarts):
        entries.append(line("resets and set states", [math.nan], [math.nan], "--violet"))
    for *_, plot in plots:
        plot["data"] += entries
    return plots


ERRORS = (
    ("position, m", "--blue", "solid"),
    ("attitude, rad", "--orange", "solid"),
    ("position, uncertainty", "--blue", "dot"),
    ("attitude, uncertainty", "--orange", "dot"),
    ("position, estimate", "--blue", "dash"),
    ("attitude, estimate", "--orange", "dash"),
)


def _errors(analysis):
    """(remark, traces) of the errors against the reference, or else of the recorded estimates."""
    figures, parts = analysis.figures, analysis.curves.get("reference")
    if parts:
        remark = "distance from the reference integration, largest of all bodies; dotted: reference uncertainty"
        estimate = "; dashed: estimate recorded with the run" if figures["estimate"] else ""
        return remark + estimate, _error_traces(parts, ERRORS)
    if not figures["estimate"]:
        return "", []
    parts = [(s.log_times, *s.errors.max(axis=1).T[:2]) for s in analysis.motion.stretches]
    return "estimate recorded with the run, largest of all bodies", _error_traces(parts, ERRORS[4:])


def _accuracy_plot(analysis, bands):
    """(remark, plot) of true error, estimate and accuracy, each as the number that the accuracy limits."""
    promise, stretches = analysis.figures["promise"], analysis.motion.stretches

    def worst(position, angle):
        return np.maximum(position / promise["length"], angle)

    true = [(part[0], worst(*part[1:3])) for part in analysis.curves.get("reference") or []]
    estimates = [(s.log_times, worst(*s.errors.max(axis=1).T[:2])) for s in stretches if s.errors is not None]
    limits = [(s.log_times, allowed(promise, s, s.log_times - s.base_ns * 1e-9)) for s in stretches]
    kinds = ("true error", "--blue", "solid"), ("estimated error", "--orange", "solid"), ("accuracy", "--red", "dash")
    traces = [
        line(name, *(joined(column) for column in zip(*parts)), colour, dash)
        for (name, colour, dash), parts in zip(kinds, (true, estimates, limits))
        if parts
    ]
    remark = f"of the worst body, relative to the mechanism's size of {promise['length']:.3g} m, or in rad"
    return remark, plane(traces, bands, "error", log=True)


def _error_traces(parts, names):
    times = joined([part[0] for part in parts])
    return [
        line(name, times, joined([part[k + 1] for part in parts]), colour, dash)
        for k, (name, colour, dash) in enumerate(names[: len(parts[0]) - 1])
    ]


def _coverage_traces(parts):
    """Curves of estimate / error for position and attitude, where both are known."""
    with_estimate = [part for part in parts if len(part) > 5]
    if not with_estimate:
        return []
    times, traces = joined([part[0] for part in with_estimate]), []
    for k, (name, colour) in enumerate((("position", "--blue"), ("attitude", "--orange"))):
        ratios = []
        for part in with_estimate:
            error, uncertainty, estimate = part[1 + k], part[3 + k], part[5 + k]
            with np.errstate(invalid="ignore", divide="ignore"):
                ratios.append(np.where(error > uncertainty, estimate / error, np.nan))
        if any(np.isfinite(ratio).any() for ratio in ratios):
            traces.append(line(name, times, joined(ratios), colour))
    return traces


def _with_lines(plot, values):
    """Plot with a log axis and horizontal lines."""
    layout = plot["layout"]
    layout["shapes"] = layout["shapes"] + [
        {
            "type": "line",
            "xref": "paper",
            "yref": "y",
            "x0": 0,
            "x1": 1,
            "y0": value,
            "y1": value,
            "line": {"color": "--grey", "width": 1.5, "dash": "longdash"},
        }
        for value in values
    ]
    before = layout["yaxis"].get("range") or _logarithms(plot["data"]) or [0.0]
    ends = [*before, *(math.log10(factor * value) for value in values for factor in (0.5, 2.0))]
    layout["yaxis"]["range"] = [min(ends), max(ends)]
    return plot


def _joint_plots(analysis, bands):
    """Plots of the joints with one coordinate, by quantity and unit."""
    layout = analysis.layout
    if not layout.coordinates.names:
        return []
    joints, acted = (
        layout.coordinates.names,
        {*(force.joint for force in layout.joint_forces.values()), *layout.motions},
    )
    try:
        times, columns, values = analysis.columns([f"{joint}.{part}" for part in PARTS for joint in joints])
    except NO_RESULT:
        return []
    of_part = dict(zip(PARTS, np.split(values, len(PARTS), axis=1)))
    idle = [
        joint not in acted and not np.nan_to_num(of_part["total_effort"][:, j]).any() for j, joint in enumerate(joints)
    ]
    for part in ("total_effort", "power"):
        of_part[part][:, idle] = np.nan
    # Of each kind, joints with an effort first.
    kinds = [[j for j, joint in enumerate(joints) if layout.coordinates.units[joint] == unit] for unit in ("rad", "m")]
    chosen = [
        name
        for kind in kinds
        for name in _chosen(
            {joints[j]: of_part["position"][:, j] for j in kind}, {joints[j]: not idle[j] for j in kind}
        )
    ]
    return _column_plots(times, columns, np.hstack([*of_part.values()]), bands, JOINT_PLOTS, chosen)


def _column_plots(times, columns, values, bands, titles=MappingProxyType({}), chosen=None, contacts=()):
    """Plots of Columns over time, by part and unit or by law, with a curve for each owner.

    titles : as JOINT_PLOTS, for the order and the texts;  chosen : owners that are visible at first
    contacts : names of laws that are contacts
    """
    found, rank, plots = {}, {key: k for k, key in enumerate(titles)}, []
    for name, unit, quantity, y in zip(columns.names, columns.units, columns.quantities, values.T):
        owner, _, part = name.rpartition(".")
        kind, frame = quantity.kind, quantity.frame
        if kind == "law" and owner in contacts:
            kind, frame = "contact", CONTACT_REMARKS.get(part, frame)
            y = np.where(y >= 0.0, y, np.nan) if part == "depth" else y  # not the way to the ground
        elif kind == "law":
            owner, part = part, owner  # one plot for all signals of a law
        if np.isfinite(y).any():
            found.setdefault((kind, frame, part, unit), {})[owner or name] = y
    looks = _looks(dict.fromkeys(name for curves in found.values() for name in curves))
    rank = {(part, UNITS[part]): k for k, part in enumerate(CONTACT_REMARKS)} | rank
    for (kind, frame, *key), curves in sorted(found.items(), key=lambda each: rank.get(each[0][2:], len(rank))):
        owner = f" {next(iter(curves))}:" if kind == "contact" and len(curves) == 1 else ""
        title = f"{kind.capitalize()}{owner} {key[0]}".strip().replace("_", " ")
        title, remark = titles.get(tuple(key), (title, frame))
        visible = _chosen(curves) if chosen is None else chosen
        traces = _many_traces(times, curves, looks, visible, jump=np.pi if key[1] == "rad" else np.inf)
        plots.append((title, remark or frame, {**plane(traces, bands, key[1]), "pick": PICKS[kind]}))
    return plots


def _many_traces(times, curves, looks, chosen, jump=np.inf):
    """Traces that the page lets the user choose; no legend has them. They have gaps at larger jumps."""
    traces = []
    for name, y in curves.items():
        gaps = np.flatnonzero(np.abs(np.diff(y)) > jump) + 1
        drawn = line(name, np.insert(times, gaps, np.nan), np.insert(y, gaps, np.nan), *looks[name], digits=5)
        traces.append({**drawn, "visible": name in chosen, "showlegend": False})
    return traces


def _chosen(curves, first=None):
    """Names of the MOST_CHOSEN curves that are visible at first: those in `first`, then those with large ranges."""
    spans = {name: np.nanmax(y, 0) - np.nanmin(y, 0) for name, y in curves.items() if np.isfinite(y).any()}
    return sorted(spans, key=lambda name: (not (first and first[name]), -np.max(spans[name])))[:MOST_CHOSEN]


def _looks(names):
    """{name: (colour, dash)} that distinguish many curves."""
    return {
        name: (MANY_COLOURS[k % len(MANY_COLOURS)], DASHES[k // len(MANY_COLOURS) % len(DASHES)])
        for k, name in enumerate(names)
    }


def _energy_plots(balance, parts, bands):
    """Plots of the energy balance: changes of its terms, and what does not add up."""
    times = joined([part[0] for part in parts])
    stored, works, remainder = (joined([part[k] for part in parts]) for k in (1, 2, 3))
    named = dict(zip((*STORES, *(f"work of {name}" for name in WORKS)), (*stored.T, *works.T)))
    looks = _looks(named)
    traces = [line(name, times, y, *looks[name]) for name, y in named.items() if np.nanmax(abs(y)) > 0.0]
    error = f"; estimated error of the work {shown(balance['quadrature_J'], 'J')}" if balance["quadrature_J"] else ""
    plots = [("Energy", "change since the start", plane(traces, bands, "J"))] if len(traces) > 1 else []
    remark = f"change of the energy minus the work done{error}"
    return [*plots, ("Energy error", remark, plane([line("error", times, remainder, "--blue")], bands, "J"))]


def _interval_traces(named):
    """One curve per name, with gaps between its intervals."""
    return [
        line(
            name,
            joined([times for times, _ in part]),
            joined([change for _, change in part]),
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
    return [line(joint, *sizes[joint], COLOURS[k]) for k, joint in enumerate(largest)]


def _lateness_traces(diagnostics):
    traces = []
    for key, name, colour in (("p50", "median", "--green"), ("p99", "p99", "--orange"), ("max", "maximum", "--red")):
        field = f"lateness_{key}_us"
        values = [(stamp * 1e-9, float(entry[field])) for stamp, entry in diagnostics if field in entry]
        if values:
            traces.append({**line(name, *np.array(values).T, colour), "mode": "lines+markers"})
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
        body.name: joined([s.position[::every, n] + s.rotation[::every, n] @ np.array(body.com) for s in stretches])
        for n, body in enumerate(analysis.scene.bodies)
    }


def difference_plot(curve):
    """[(title, remark, plot)] of the curves of a comparison; empty if all differences are zero."""
    if not any((values > 0.0).any() for _, values in curve):
        return []
    traces = [line(name, *part, colour) for name, part, colour in zip(("position, m", "attitude, rad"), curve, COLOURS)]
    return [("Difference of the two recordings", "largest of all bodies", plane(traces, [], "m, rad", log=True))]


def plane(traces, bands, unit, log=False, across="time / s"):
    """Plot of curves over time, or another quantity; a log axis shows positive values only."""
    axis = {"gridcolor": "--grid", "zerolinecolor": "--grid", "linecolor": "--grid", "automargin": True}
    return {
        "data": traces,
        "layout": {
            "xaxis": {**axis, "title": {"text": across, "standoff": 6}, **_ends_of_points(traces)},
            "yaxis": {
                **axis,
                "title": {"text": unit, "standoff": 8},
                **(
                    {"type": "log", "exponentformat": "power", "nticks": 7, **_range(traces)}
                    if log
                    else {"exponentformat": "power", **_range_of_one_value(traces)}
                ),
            },
            "shapes": bands,
            "margin": {"l": 8, "r": 8, "t": 30, "b": 8},
            "height": HEIGHT,
            "hovermode": "x unified" if len(traces) <= 6 else "closest",
            **BASE,
        },
    }


def _ends_of_points(traces):
    """Range of the axis of time, if plotly.js would extend it for points."""
    times = [x for trace in traces for x in trace["x"] if x is not None]
    return {"range": [min(times), max(times)]} if any("markers" in trace["mode"] for trace in traces) else {}


def _logarithms(traces):
    """Logarithms of the positive values of all curves; may be empty."""
    return [math.log10(v) for trace in traces for v in trace["y"] if v is not None and v > 0.0]


def _range(traces):
    """Range of a log axis, if it is not that of the curves."""
    values = _logarithms(traces)
    usual = float(np.quantile(values, FEW)) + math.log10(ODD) if values else 0.0
    # Prevent an accidental difference of 1e-40 from stretching the axis.
    return {"range": [usual, max(values) + 0.2]} if values and min(values) < usual else {}


def _range_of_one_value(traces):
    """Range of an axis if all curves have the same value, around which plotly.js would show round-off."""
    values = {v for trace in traces for v in trace["y"] if v}
    return {"range": sorted((0.0, 2.0 * values.pop()))} if len(values) == 1 else {}


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


def _event_lines(times, colour):
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
            "opacity": 0.3,
            "line": {"color": colour, "width": 0.8},
        }
        for time in ([] if times is None else times.tolist())
    ]


def _event_entry(figures, times):
    """Invisible curve that gives the lines at joint events an entry in the legend."""
    count = figures["joint_events"]["instants"]
    some = "" if len(times) == count else f", {len(times)} of {count}"
    return line(f"events at joints{some}", [math.nan], [math.nan], "--grey")


def line(name, x, y, colour, dash="solid", digits=7):
    """Trace of a curve. Long curves are reduced to minimum, maximum and a gap of each bin."""
    if len(x) > 2 * BINS:
        pick = _extremes(y)
        x, y = x[pick], y[pick]
    known = np.isfinite(np.concatenate([[np.nan], y, [np.nan]]))
    alone = known[1:-1] & ~known[:-2] & ~known[2:]  # a line of one sample is invisible
    return {
        "type": "scatter",
        **({"mode": "lines+markers", "marker": {"size": (5 * alone).tolist()}} if alone.any() else {"mode": "lines"}),
        "name": label(name),
        "x": _plain(x),
        "y": _plain(y, digits),
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


def joined(parts):
    """Concatenated arrays, separated by a gap (NaN)."""
    gap = np.full((1, *parts[0].shape[1:]), np.nan)
    return np.concatenate([piece for part in parts for piece in (part, gap)][:-1])


def _plain(values, digits=7):
    """Numbers for JSON; a gap is null."""
    return [float(f"{value:.{digits}g}") if math.isfinite(value) else None for value in values]
