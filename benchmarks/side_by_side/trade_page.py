# SPDX-License-Identifier: Apache-2.0
"""Markdown tables of the measurements of benchmarks/trade_all.py."""

from liegroup_sim_ros.report.summary import shown
from liegroup_sim_ros.report.trade_figures import error_text, reference_text, setting


def by_method(part):
    """{method: {accuracy: us per simulated second of its cheapest configuration, or None}}."""
    found = {}
    for entry in part["cheapest"]:
        best = {}
        for cell in part["cells"]:
            if cell["stopped"]:
                continue
            error = max(cell["error"], part["reference"]["known"])
            if part["margin"] * error <= entry["accuracy"]:
                best[cell["method"]] = min(best.get(cell["method"], float("inf")), cell["cost_us"])
        for cell in part["cells"]:
            found.setdefault(cell["method"], {})[f"{entry['accuracy']:g}"] = best.get(cell["method"])
    return found


def text(parts):
    """Markdown text of all scenes (`parts` of which_method.json)."""
    return (
        "\n\n".join(
            [
                HEAD.strip(),
                words(parts),
                "## For each scene",
                *map(scene, parts),
                "## Requested and measured accuracy",
                PROMISED.strip(),
                promised(parts),
                FOOT.strip(),
            ]
        )
        + "\n"
    )


def scene(part):
    """Markdown section of one scene."""
    lines = [
        f"### {part['scene']}",
        "",
        f"{_count(part['bodies'])} over {shown(part['horizon'], 's')}, errors relative to "
        f"{shown(part['length'], 'm')}. {part['settings']} configurations of "
        f"{len(part['methods'])} methods, {part['stopped']} of which failed. Errors against "
        f"{reference_text(part)}.",
        "",
        "| accuracy | cheapest configuration | its error | times real time | next methods |",
        "|---|---|---|---|---|",
    ]
    for entry in part["cheapest"]:
        if entry["cell"] is None:
            lines.append(f"| {entry['accuracy']:g} | none: at best {shown(part['best'])} | | | |")
            continue
        cell = part["cells"][entry["cell"]]
        lines.append(
            f"| {entry['accuracy']:g} | {setting(cell)} | "
            f"{error_text(cell['error'], part['reference']['known'])} | "
            f"{shown(entry['real_time_factor'])} | "
            f"{_others(part, entry['accuracy'], cell)} |"
        )
    return "\n".join(lines)


def _count(bodies):
    return f"{bodies} {'body' if bodies == 1 else 'bodies'}"


def _others(part, accuracy, cell):
    """The three next cheapest methods with their relative cost."""
    costs = sorted(
        (costs[f"{accuracy:g}"], name)
        for name, costs in part["methods"].items()
        if name != cell["method"] and costs[f"{accuracy:g}"]
    )
    return ", ".join(f"{name} {cost / cell['cost_us']:.2g}x" for cost, name in costs[:3]) or "none"


def words(parts):
    """Summary in sentences with numbers computed here."""
    lines = ["## In short", ""]
    for accuracy in (1e-3, 1e-6, 1e-9):
        won = {}
        for part in parts:
            for entry in part["cheapest"]:
                if entry["accuracy"] == accuracy and entry["cell"] is not None:
                    won.setdefault(part["cells"][entry["cell"]]["method"], []).append(part["scene"])
        said = "; ".join(
            f"{method} ({', '.join(names)})" for method, names in sorted(won.items(), key=lambda pair: -len(pair[1]))
        )
        none = [
            part["scene"]
            for part in parts
            for entry in part["cheapest"]
            if entry["accuracy"] == accuracy and entry["cell"] is None
        ]
        lines.append(
            f"* {accuracy:g} is cheapest with {said}" + (f"; out of reach for {', '.join(none)}" if none else "") + "."
        )
    for method in ("rkmk8", "rkmk4"):
        worst = [
            (costs[f"{accuracy:g}"] / best, part["scene"], accuracy)
            for part in parts
            for accuracy in (1e-3, 1e-6, 1e-9)
            for best in [
                min(
                    (costs[f"{accuracy:g}"] for costs in part["methods"].values() if costs[f"{accuracy:g}"]),
                    default=None,
                )
            ]
            for costs in [part["methods"].get(method, {})]
            if best and costs.get(f"{accuracy:g}")
        ]
        if worst:
            middle = sorted(ratio for ratio, *_ in worst)[len(worst) // 2]
            most = max(worst)
            missed = sum(1 for part in parts for entry in part["cheapest"] if entry["cell"] is not None) - len(worst)
            lines.append(
                f"* used for all scenes, {method} costs {middle:.2g} times the cheapest in "
                f"the median, at most {most[0]:.2g} times ({most[1]} at "
                f"{most[2]:g})"
                + (f", and in {missed} of them misses the accuracy within the time limit of a run" if missed else "")
                + "."
            )
    fastest = [
        (entry["real_time_factor"], part["scene"], entry["accuracy"])
        for part in parts
        for entry in part["cheapest"]
        if entry["cell"] is not None
    ]
    slow = [
        f"{name} at {accuracy:g} ({shown(factor)} times)" for factor, name, accuracy in sorted(fastest) if factor < 2.0
    ]
    lines.append(
        "* real time with half of a core to spare is reached "
        + ("in every attainable case." if not slow else f"except for {', '.join(slow)}.")
    )
    return "\n".join(lines)


def promised(parts):
    """Table of requested accuracies and measured errors."""
    lines = ["| scene | horizon | requested | measured | estimated at the end | kept |", "|---|---|---|---|---|---|"]
    for part in parts:
        for entry in part["promises"]:
            begin = f"| {part['scene']} | {shown(part['horizon'], 's')} | {entry['accuracy']:g} |"
            kept = max(entry["measured"], entry["known"]) <= entry["accuracy"]
            says = "" if entry["until"] is None else f", reported until {entry['until']:.3g} s"
            lines.append(
                f"{begin} {error_text(entry['measured'], entry['known'])} | "
                f"{shown(entry['estimate'])} | {'yes' if kept else 'NO'}{says} |"
            )
    return "\n".join(lines)


HEAD = """
# Which method and step?

Measured for every scene in `config/scenes/`: the cheapest configuration for an accuracy, and how many
times faster than real time it runs on one core. docs/how-to/choose_accuracy.md defines accuracy
and describes how it is measured and checked. `benchmarks/trade_all.py` writes this page from
`docs/which_method.json`. Your machine has other costs: measure them with
`liegroup_sim trade SCENE`.
"""

PROMISED = """
Simulations to an accuracy over the horizon: their largest error at up to 1000 instants, against a
separate reference integration.
"""

FOOT = """
## Checked against other software

`test/verification/test_trade_truth.py` checks the reference solutions behind these tables against
45-digit end states of free body and tops, the crank angle of the four-bar by quadrature of its
energy, and motions with the accelerations of Pinocchio. `benchmarks/trade_truth_peers.py` measures
every configuration on the Pareto fronts of four scenes against motions of Pinocchio and MuJoCo.
"""
