# SPDX-License-Identifier: Apache-2.0
"""Comparison of a log with a scene: as JSON types, in the terminal, and as a self-contained HTML page."""

from html import escape

import numpy as np
from rich.text import Text

from liegroup_sim_ros.numbers import counted, shown

from .page import frame, plot_card, table, unbroken
from .plots import COLOURS, joined, line, plane
from .tables import TextTable, table_of
from .terminal import printed

EFFECTS_TITLE = "Effects that would explain them, one after the other"
MOST_PLOTS, MOST_EFFECTS, MOST_MISSING = 12, 8, 2
BAND = 2.0  # deviations of the noise
WHITE = 1e-3  # probability below which residuals are correlated


def document(comparison, names):
    """JSON types; names: {"scene", "log"}."""
    result = comparison
    numerics = [
        float(x)
        for each, part in zip(result.fit.runs.log.measured, result.numerics)
        for x, column in zip(part, each.values.T)
        if np.isfinite(column).any()
    ]
    return {
        **names,
        "verdict": result.verdict,
        "agrees": result.agrees,
        "horizons": [_horizon(each) for each in result.horizons],
        "converged": result.solution.converged,
        "reduced_chi_square": result.reduced,
        "channels": [{**vars(channel), "numerics": numeric} for channel, numeric in zip(result.channels, numerics)],
        "effects": [_effect(each) for each in result.effects],
        "alone": [_effect(each) for each in result.alone],
        "missing": [
            {**vars(each), **{key: getattr(each, key).tolist() for key in ("at", "values", "deviations")}}
            for each in result.missing
        ],
        "delays": {
            name: {
                "delay": delay,
                "deviation": sd if np.isfinite(sd) else None,
                "interval": [delay - result.half_width * sd, delay + result.half_width * sd] if sd < np.inf else None,
            }
            for name, (delay, sd) in result.delays.items()
        },
        "segments": len(result.solution.point.states),
        "starts": [_start(each) for each in result.starts],
        "notes": [*result.fit.runs.log.notes, *_guessed(result)],
    }


def _horizon(each):
    differs = each.differs_from
    return {
        **{name: getattr(each, name) for name in ("name", "topic", "unit", "noise", "within_noise", "useful")},
        "text": each.text,
        "within_useful": each.within(each.useful),
        "differs_from": None if differs == np.inf else differs,
        **{
            name: [value if np.isfinite(value) else None for value in getattr(each, name).tolist()]
            for name in ("ahead", "error", "explained", "numerical", "starts")
        },
    }


def _effect(effect):
    found = dict(vars(effect))
    return found | {"deviation": found["deviation"] if np.isfinite(found["deviation"]) else None}


def _guessed(comparison):
    names = comparison.guessed
    return [f"not measured: {', '.join(names)}; their starts follow from the rest, and may be wrong"] if names else []


def _start(start):
    deviations = [x if np.isfinite(x) else None for x in start.deviations.tolist()]
    parts = {"name": start.names, "value": start.values.tolist(), "deviation": deviations}
    return {"time": float(start.time), "state": [dict(zip(parts, row)) for row in zip(*parts.values())]}


def start_table(result):
    """Table of the start of the log."""
    found = []
    for each in result["starts"][0]["state"]:
        own = "not shown by the log" if each["deviation"] is None else shown(each["deviation"])
        found.append((each["name"], f"{each['value']:.7g}", own))
    heads = ("start", "value", "deviation")
    return TextTable(f"Start at {round(result['starts'][0]['time'], 6):g} s", heads, found)


def _interval(each):
    low, high = each["interval"] or (np.nan, np.nan)
    return "the bag does not show it" if each["interval"] is None else f"{low:.6g} to {high:.6g}"


# Columns of tables, see tables.py.
NUMBERS = {
    "number": lambda each: each["name"],
    "in the scene": lambda each: f"{each['before']:.6g}",
    "found": lambda each: f"{each['value']:.6g}",
    "95 % interval": _interval,
}
CHANNELS = {
    "output": lambda each: each["name"],
    "measurements": lambda each: str(each["count"]),
    "noise": lambda each: shown(each["deviation"]),
    "rms": lambda each: shown(each["rms"]),
    "rms / noise": lambda each: shown(each["chi"]),
    "largest": lambda each: f"{shown(each['largest'])} at {each['time']:.4g} s",
    "white": lambda each: "yes" if each["p_white"] > WHITE else "no",
}
EFFECTS = {
    "effect": lambda each: each["text"],
    "size": lambda each: f"{shown(each['value'], each['unit'])} ± {shown(each['deviation'])}",
    "explains": lambda each: f"{100.0 * each['share']:.3g} %",
}


def number_remarks(result):
    """Sentences on a search that failed, robust intervals, what the log does not show, and segments left out."""
    found = []
    if not result["in_reach"]:
        found.append(
            "no run near to the noise was found: the numbers are the nearest of the search, and their intervals do not "
            "hold; change the model, its numbers, or give limits"
        )
    if result["robust"]:
        found.append("residuals are not white: the intervals are robust, of correlated residuals (Newey and West)")
    for one in result["unknown"]:
        parts = " ".join(f"{weight:+.2g} {path}" for path, weight in one.items())
        found.append(f"the bag does not show this combination of relative changes: {parts}")
    if result["held_out"] is not None:
        before, after = map(shown, result["held_out"])
        found.append(f"what was left out: rms of residuals {before} of the noise before, {after} after")
    return found


def print_comparison(result, console):
    """Print the verdict and the tables."""
    console.print(Text(f"{result['scene']} against {result['log']}", style="bold"))
    console.print(Text(result["verdict"], style="green" if result["agrees"] else "yellow"))
    alone = table_of(EFFECTS, result["alone"][:MOST_EFFECTS])
    for each in (
        table_of(CHANNELS, result["channels"]),
        alone._replace(heads=("effect, each alone", *alone.heads[1:])),
    ):
        console.print(printed(each))
    for text in _remarks(result):
        console.print(Text(text, style="dim"))


def _remarks(result):
    numerics = max(each["numerics"] for each in result["channels"])
    found = [
        f"one run along the log, in {counted(result['segments'], 'tied segment')}; errors of the integration: at most "
        f"{shown(numerics)} of the noise"
    ]
    for topic, delay in result["delays"].items():
        way = "late" if delay["delay"] > 0.0 else "early"
        if delay["interval"] is None:
            found.append(f"{topic}: the log does not show its delay: give it, as clocks of the map")
        elif delay["deviation"]:
            half = 0.5 * (delay["interval"][1] - delay["interval"][0])
            rest = "" if result["agrees"] else "; what the model lacks changes it"
            scale, unit = (1.0, "s") if abs(delay["delay"]) >= 1.0 else (1e3, "ms")
            size, within = f"{scale * abs(delay['delay']):.7g} {unit}", shown(scale * half, unit)
            is_late = f"is {way} by {size} ± {within}" if abs(delay["delay"]) > half else f"is on time to {within}"
            found.append(f"{topic} {is_late} (95 %){rest}")
    return found + result["notes"]


def make_page(comparison, result):
    """HTML of the page (about 5 MB, including plotly.js)."""
    plots = _horizon_plots(comparison.horizon) if comparison.horizons else []
    plots += [_missing_plot(each) for each in comparison.missing[:MOST_MISSING]] + _plots(comparison)
    state = "good" if result["agrees"] else "warn"
    sign = "✓ agrees" if result["agrees"] else "! contradiction"
    found = ""
    if "numbers" in result:
        remarks = "".join(f'<p class="soft">{unbroken(text)}</p>' for text in number_remarks(result))
        rows = table(table_of(NUMBERS, result["numbers"], "Numbers"))
        found = f'<div class="cards">{rows}</div>{remarks}'
    body = (
        f"<header><h1>{escape(result['scene'])} against {escape(result['log'])}</h1>"
        f'<span class="state {state}">{sign}</span></header>'
        f'<p class="verdict">{unbroken(result["verdict"])}</p>'
        + found
        + '<div class="cards">'
        + table(table_of(CHANNELS, result["channels"], "Residuals"))
        + '</div><div class="cards">'
        + (table(table_of(EFFECTS, result["effects"], EFFECTS_TITLE)) if result["effects"] else "")
        + table(table_of(EFFECTS, result["alone"][:MOST_EFFECTS], "Effects, each alone"))
        + table(start_table(result))
        + "</div>"
        + "".join(f'<p class="soft">{unbroken(text)}</p>' for text in _remarks(result))
        + '<div class="cards" data-part="0">'
        + "".join(plot_card(title, remark) for title, remark, _ in plots)
        + "</div>"
    )
    data = [{"plots": [plot for *_, plot in plots], "view": None}]
    return frame(f"{result['scene']} against {result['log']}", body, data)


def _horizon_plots(each):
    """[(title, remark, plot)]: errors of predictions against the time ahead; the longest run, with its band."""
    curves = (
        ("measured minus predicted", each.error),
        ("explained", each.expected),
        ("noise", 0.0 * each.ahead + each.noise),
    )
    dashes, unit = ("solid", "dash", "dot"), each.unit or "SI units"
    traces = [
        line(name, each.ahead, np.where(np.isfinite(values), values, np.nan), colour, dash)
        for (name, values), colour, dash in zip(curves, (COLOURS[0], COLOURS[4], COLOURS[2]), dashes)
    ]
    curve = plane(traces, [], unit, True, "time ahead / s")
    curve["layout"]["xaxis"]["type"] = "log"
    times, measured, predicted, deviation = each.run
    band = BAND * np.sqrt(deviation**2 + each.noise**2)
    ends = [predicted - band, predicted + band]
    run = [line("measured", times, measured, COLOURS[0]), line("predicted", times, predicted, COLOURS[1], "dash")]
    run += [
        line(name, times, np.where(np.isfinite(end), end, np.nan), COLOURS[4], "dot")
        for name, end in zip(("low", "high"), ends)
    ]
    return [
        (f"How far ahead {each.name} is predicted", "rms of runs from starts all over the log", curve),
        (
            f"{each.name}: one run",
            f"from the start at {times[0]:.4g} s to the end of the log, without its measurements; dotted: two standard "
            "deviations of what noise, start and numbers explain",
            plane(run, [], unit),
        ),
    ]


def _missing_plot(each):
    """(title, remark, plot) of a Missing effort, with two standard deviations."""
    unit = "rad" if each.unit == "N m" else "m"
    unit = {"velocity": f"{unit}/s", "time": "s"}.get(each.variable, unit)
    ends = [each.values - BAND * each.deviations, each.values + BAND * each.deviations]
    traces = [line("least squares", each.at, each.values, COLOURS[0])]
    traces += [line(name, each.at, end, COLOURS[4], "dot") for name, end in zip(("low", "high"), ends)]
    remark = f"would explain {100.0 * each.share:.3g} % of the sum of squares; dotted: two standard deviations"
    return (
        f"Effort that {each.joint} lacks, against its {each.variable}",
        remark,
        plane(traces, [], each.unit, False, f"{each.variable} / {unit}"),
    )


def _plots(comparison):
    """[(title, remark, plot)]: for the outputs with the largest residuals, the values and the residuals."""
    solution, fit = comparison.solution, comparison.fit
    segments = fit.runs.segments(solution.point)
    order = sorted(comparison.channels, key=lambda channel: -channel.chi)[: MOST_PLOTS // 2]
    found = []
    for t, each in enumerate(fit.runs.log.measured):
        times = joined([each.times[segment.rows[t]] for segment in segments])
        for p, name in enumerate(each.channels):
            if name not in [channel.name for channel in order]:
                continue
            measured = joined([each.values[segment.rows[t], p] for segment in segments])
            outputs = joined([part[t][:, p] for part in solution.outputs])
            rest = joined([part[t][:, p] for part in solution.residuals])
            sigma = fit.deviation[t][p]
            traces = [
                line("measured", times, measured, COLOURS[0]),
                line("simulated", times, outputs, COLOURS[1], "dash"),
            ]
            found.append((name, f"{each.name}; one run along the log", plane(traces, [], "SI units")))
            bands = [_band(-BAND * sigma, BAND * sigma)]
            found.append(
                (
                    f"{name}: residual",
                    "measured minus simulated; band: two standard deviations of the noise",
                    plane([line("residual", times, rest, COLOURS[4])], bands, "SI units"),
                )
            )
    return found


def _band(low, high):
    return {
        **{"type": "rect", "xref": "paper", "yref": "y", "x0": 0, "x1": 1, "y0": low, "y1": high},
        **{"fillcolor": "--green", "opacity": 0.15, "line": {"width": 0}, "layer": "below"},
    }
