# SPDX-License-Identifier: Apache-2.0
"""Results of an analysis as text: rows of the tables, headline and overview."""

from liegroup_sim_ros.analysis.estimate import error_of
from liegroup_sim_ros.analysis.timing import is_paced, requested_text
from liegroup_sim_ros.numbers import GROUPS, NO_MOMENTUM, counted, error_text, shown

from .tables import TextTable

MOST_JOINTS = 8  # number of joints in the table; the JSON document has all
# {part of an error in the analysis: name in tables}
PARTS = {
    "position": "position",
    "angle": "attitude",
    "attitude": "attitude |R - Rref|",
    "angular": "angular velocity",
    "linear": "velocity",
}
# {kind of event at a joint: name in tables}
NOUNS = {"impact": "impact", "stop": "stop", "leave": "release", "stick": "stick", "slip": "slip"}
OVERVIEW = ("position", "attitude", "energy", "joints", "bit-identical", "dropped")


def headline(figures):
    """Most important figures: [(name, value, remark)]."""
    rows = []
    errors, why = error_of(figures)
    if errors:
        rows += [
            (
                text,
                shown(max(entry["max"], entry["uncertainty"]), entry["unit"]),
                "largest estimate, recorded with the run"
                if why
                else "the reference uncertainty"
                if entry["max"] <= entry["uncertainty"]
                else f"maximum, uncertainty {shown(entry['uncertainty'], entry['unit'])}",
            )
            for name, text in (("position", "position error"), ("angle", "attitude error"))
            for entry in [errors[name]]
        ]
    elif "estimate" in figures:
        rows.append(("error", "unknown", why))
    if figures.get("joints"):
        name, worst = max(figures["joints"].items(), key=lambda item: item[1]["largest"])
        rows.append(("constraint residual", shown(worst["largest"], worst["unit"]), f"maximum: {name}"))
    if figures.get("energy") and figures["energy"]["relative_drift"] is not None:
        rows.append(("energy drift", shown(figures["energy"]["relative_drift"]), "of the largest kinetic energy"))
    elif figures.get("balance", {}).get("quadrature_J"):
        balance = figures["balance"]
        error = shown(balance["quadrature_J"], "J")
        if balance["quadrature_J"] > RESOLVED * max(map(abs, balance["work_J"].values())):
            remark = f"samples are too far apart: the error of the work is {error}; record more of them"
            rows.append(("energy balance", "unknown", remark))
        else:
            remark = f"largest; estimated error of the work {error}"
            rows.append(("energy does not add up by", shown(balance["largest_J"], "J"), remark))
    repeat = figures.get("repeat", {})
    if "identical" in repeat:
        same = repeat["identical"] == repeat["samples"]
        rows.append(
            (
                "re-simulation",
                "bit-identical" if same else "different",
                f"identical in {repeat['identical']} of {counted(repeat['samples'], 'sample')}",
            )
        )
    if is_paced(figures["timing"]):
        rows.append(
            ("real-time factor", f"{figures['timing']['real_time_factor']:.3f}", requested_text(figures["timing"]))
        )
    return rows


def sections(figures):
    """Tables of an analysis: [(title, [(name, value, remark)])]."""
    tables = [("Run", _run_rows(figures))]
    if "reference" in figures and "failed" not in figures["reference"]:
        tables.append(("Error against the reference integration", _error_rows(figures)))
    if figures.get("estimate"):
        tables.append(("Estimate of the error, recorded with the run", _estimate_rows(figures)))
    local = figures.get("local", {})
    if local and "failed" not in local:
        tables.append(("Error of one step, by step halving", _local_rows(local)))
    if "energy" in figures:
        tables.append(("Conserved quantities and constraints", _conserved_rows(figures)))
    if "failed" in figures.get("balance", {}):
        tables.append((BALANCE_TITLE, [("unknown", "-", figures["balance"]["failed"])]))
    if figures.get("joint_events"):
        tables.append(("Stops and friction", _joint_event_rows(figures["joint_events"])))
    repeat = figures.get("repeat", {})
    if "identical" in repeat:
        tables.append(
            (
                "Re-simulation",
                [
                    (
                        "bit-identical",
                        f"{repeat['identical']} of {counted(repeat['samples'], 'sample')}",
                        "from the recorded initial state, configuration and wrenches",
                    )
                ],
            )
        )
    tables.append(("Real time", _timing_rows(figures["timing"])))
    tables.append(("File", _file_rows(figures)))
    return tables


def _run_rows(figures):
    pushes = figures["pushes"]
    shown_pushes = "; ".join(
        f"{p.get('body') or 'joint ' + p['joint']} {p['from_s']:.3f} s to "
        + (f"{p['to_s']:.3f} s" if p["to_s"] is not None else "the end")
        for p in pushes[:4]
    )
    count = figures["push_count"]
    more = f" and {count - 4} more" if count > 4 else ""
    refused = figures["wrenches_refused"]
    return [
        (
            "scene",
            figures["scene"],
            ", ".join(figures["bodies"][:6])
            + (f" and {len(figures['bodies']) - 6} more" if len(figures["bodies"]) > 6 else ""),
        ),
        (
            "method",
            f"{figures['method']}, step {shown(figures['step'] * 1e3, 'ms')}",
            f"on {GROUPS.get(figures['group'], figures['group'])}",
        ),
        (
            "simulated time",
            shown(figures["sim_seconds"], "s"),
            counted(figures["samples"], "sample")
            + (f", {counted(figures['resets'], 'reset')}" if figures["resets"] else ""),
        ),
        (
            "wrenches and efforts",
            str(count),
            shown_pushes + more + (f"; {counted(refused, 'wrench message')} refused" if refused else ""),
        ),
    ]


def _error_rows(figures):
    return [
        (
            text,
            shown(entry["max"], entry["unit"]),
            f"at the end {shown(entry['final'], entry['unit'])}, "
            f"reference ± {shown(entry['uncertainty'], entry['unit'])}",
        )
        for text, entry in _named(figures["reference"])
    ]


def _estimate_rows(figures):
    compared = "failed" not in figures.get("reference", {"failed": None})
    nothing = "no error above the reference uncertainty to compare with" if compared else ""
    return [
        (
            text,
            shown(entry["max"], entry["unit"]),
            f"at least half of the true error in {_percent(entry['covering'])} of "
            f"{counted(entry['samples'], 'sample')}, at most ten times the error in "
            f"{_percent(entry['close'])}"
            if entry["samples"]
            else "no estimate is known"
            if entry["max"] is None
            else nothing,
        )
        for text, entry in _named(figures["estimate"])
    ]


def _named(parts):
    """[(name in tables, entry)] of the existing parts of an error; parts : {key: entry}."""
    return [(text, parts[key]) for key, text in PARTS.items() if key in parts]


def _percent(share):
    """Text of a share in percent; it is 100 % only if the share is exactly 1."""
    percent = round(100.0 * share, 1)
    return f"{percent if share == 1.0 else min(percent, 99.9):g} %"


def _local_rows(local):
    return [
        (
            "position",
            shown(local["position_m"], "m"),
            _joined(f"largest at {counted(local['windows'], 'sample')}", local["remark"]),
        ),
        ("attitude", shown(local["angle_rad"], "rad"), ""),
        (
            "observed order",
            "-" if local["order"] is None else f"{local['order']:.2f}",
            f"order of the method: {local['order_expected']}",
        ),
    ]


def _trend(slope, explained, unit):
    """Text with the linear trend of a drift; None if it explains at most half of the variance."""
    if slope is None or not explained > 0.5:
        return None
    return f"{'falls' if slope < 0.0 else 'grows'} by {shown(abs(slope), unit)}"


def _conserved_rows(figures):
    energy = figures["energy"]
    rows = [
        (
            "energy drift",
            shown(energy["drift_J"], "J"),
            _joined(
                energy["relative_drift"] is not None
                and f"{shown(energy['relative_drift'])} of the largest kinetic energy",
                _trend(energy["trend_W"], energy["trend_explains"], "W"),
                energy["left_out"] and f"without {energy['left_out']}"
                if energy["drift_J"] is not None
                else energy["left_out"],
            ),
        )
    ]
    for entry in figures["momentum"]:
        rows.append(
            (
                entry["component"],
                shown(entry["drift"], entry["unit"]),
                _joined(
                    f"of at most {shown(entry['largest'], entry['unit'])}",
                    _trend(entry["trend_per_s"], entry["trend_explains"], entry["unit"].removesuffix(" s")),
                    len(figures["bodies"]) > len(entry["bodies"]) and ", ".join(entry["bodies"][:4]),
                    entry["left_out"] and f"without {entry['left_out']}",
                ),
            )
        )
    if not figures["momentum"]:
        rows.append(("momentum", "-", NO_MOMENTUM))
    joints = sorted(figures["joints"].items(), key=lambda item: -item[1]["largest"])
    for name, entry in joints[:MOST_JOINTS]:
        rows.append(
            (
                f"constraint residual of {name}",
                shown(entry["largest"], entry["unit"]),
                f"at {shown(entry['at_s'], 's')}",
            )
        )
    if len(joints) > MOST_JOINTS:
        rows.append((counted(len(joints) - MOST_JOINTS, "other joint"), "smaller", ""))
    return rows


def _joint_event_rows(events):
    """Rows with the events and the impact energy of each joint, sorted by number of events."""
    joints = sorted(events["joints"].items(), key=lambda item: -_event_count(item[1]))
    rows = [
        (
            name,
            ", ".join(counted(entry[kind], noun) for kind, noun in NOUNS.items() if entry[kind]) or "no event",
            f"energy lost at impacts {shown(-entry['impact_energy_J'], 'J')}, largest impulse "
            f"{shown(entry['largest_impulse'], entry['unit'])}"
            if entry["impact"]
            else "",
        )
        for name, entry in joints[:MOST_JOINTS]
    ]
    if len(joints) > MOST_JOINTS:
        rows.append((counted(len(joints) - MOST_JOINTS, "other joint"), "fewer", ""))
    return rows


def _event_count(entry):
    return sum(entry[kind] for kind in NOUNS)


RESOLVED = 0.1  # error of the work, relative to the largest work, up to which a balance says something
BALANCE_TITLE = "Energy balance"
MOST_LAWS = 20  # of a table of the balance


def balance_table(balance):
    """Table of the energy balance; balance : entry of the figures."""

    def row(name, *values):
        return (name, *("" if value is None else f"{value:.6g} J" if value else "0 J" for value in values))

    rows = [
        row(entry["name"], start, end, end - start)
        for entry in balance["stored"]
        for start, end in [(entry["start_J"], entry["end_J"])]
        if start or end
    ]
    rows += [row(f"work of {name}", None, None, work) for name, work in balance["work_J"].items() if work]
    laws = {name: work for name, work in balance["work_of_laws_J"].items() if work}
    if 1 < len(laws) <= MOST_LAWS:
        rows += [row(f"  by {name}", None, None, work) for name, work in laws.items()]
    if balance["set_J"]:
        rows.append(row("resets and states that were set", None, None, balance["set_J"]))
    rows.append(row("does not add up by", None, None, balance["remainder_J"]))
    rows.append(row("largest during the run", None, None, balance["largest_J"]))
    if balance["quadrature_J"]:
        rows.append(row("estimated error of the work", None, None, balance["quadrature_J"]))
    return TextTable(BALANCE_TITLE, ("", "start", "end", "change"), rows)


def _timing_rows(timing):
    late, ticks = timing["lateness_us"], timing.get("ticks")
    no_clock = "the run was not in real time"
    paced = is_paced(timing)
    return [
        ("real-time factor", f"{timing['real_time_factor']:.4f}" if paced else "-", requested_text(timing)),
        (
            "scheduling latency",
            _microseconds(late["p50"]),
            no_clock
            if late["p50"] is None
            else f"median; p99 {_microseconds(late['p99'])}, maximum {_microseconds(late['max'])}",
        ),
        (
            "deadline misses",
            "-" if timing.get("overruns") is None else f"{timing['overruns']:.0f}",
            "" if ticks is None else f"of {counted(ticks, 'tick')}",
        ),
        (
            "gaps",
            str(timing["gaps"]),
            ""
            if not timing["gaps"]
            else f"longest {shown(timing['largest_gap_s'], 's')}, at {shown(timing['largest_gap_at_s'], 's')}",
        ),
    ]


def _microseconds(value):
    return shown(value, "us") if value is None or value < 1e3 else shown(value * 1e-3, "ms")


def _file_rows(figures):
    lost = sum(figures["lost_messages"].values()) + figures["missing_samples"]
    return [
        ("messages", str(sum(figures["messages"].values())), counted(len(figures["messages"]), "topic")),
        ("dropped", str(lost), "by sequence numbers and sampling period"),
        ("complete", "yes" if figures["complete"] else "no", figures["file_problem"] or ""),
    ]


def _joined(*remarks):
    return "; ".join(remark for remark in remarks if remark)


def short_names(found):
    """Names of recordings: file names if these are unique, else paths."""
    names = [figures["log"].rpartition("/")[2] for figures in found]
    return names if len(set(names)) == len(names) else [figures["log"] for figures in found]


def overview(figures):
    """Row of the overview of several recordings: a text for each of OVERVIEW; ~ marks recorded estimates."""
    if "failed" in figures:
        return ["-"] * len(OVERVIEW)
    errors, why = error_of(figures)
    errors = (
        [("~" if why else "") + error_text(errors[name]).partition(" (")[0] for name in ("position", "angle")]
        if errors
        else ["-", "-"]
    )
    joints = [joint["largest"] for joint in figures.get("joints", {}).values()]
    repeat = figures.get("repeat", {})
    lost = sum(figures["lost_messages"].values()) + figures["missing_samples"]
    return [
        *errors,
        shown(figures.get("energy", {}).get("relative_drift")),
        shown(max(joints)) if joints else "-",
        f"{repeat['identical']}/{repeat['samples']}" if "identical" in repeat else "-",
        str(lost),
    ]


def comparison_rows(figures):
    """Table of a comparison: [(name, value, remark)]."""
    names = {"position": "position", "angle": "attitude", "angular": "angular velocity", "linear": "velocity"}
    rows = [
        (
            "bit-identical",
            f"{figures['identical']} of {counted(figures['samples'], 'sample')}",
            ""
            if figures["first_difference_s"] is None
            else f"first difference at {shown(figures['first_difference_s'], 's')}",
        )
    ]
    rows += [
        (
            names[name],
            shown(entry["max"], entry["unit"]),
            "" if entry["at_s"] is None else f"at {shown(entry['at_s'], 's')}",
        )
        for name, entry in figures["difference"].items()
    ]
    rows += [
        (what, "the same" if equal else "different", "")
        for what, equal in (("scene", figures["same_scene"]), ("wrenches", figures["same_wrenches"]))
    ]
    return rows + [
        (key, str(mine), f"in the other recording {theirs}") for key, (mine, theirs) in figures["settings"].items()
    ]
