# SPDX-License-Identifier: Apache-2.0
"""Tables of what benchmarks/trade_all.py measured, in Markdown."""

from liegroup_sim_ros.report.summary import shown
from liegroup_sim_ros.report.trade_figures import error_text, reference_text, setting


def by_method(part):
    """{method: [cost_us of the cheapest setting for each accuracy with the margin, or None]}."""
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
            found.setdefault(cell["method"], {})[f"{entry['accuracy']:g}"] = best.get(
                cell["method"]
            )
    return found


def text(parts):
    """The page."""
    return (
        "\n\n".join(
            [
                HEAD.strip(),
                words(parts),
                "## For each scene",
                *map(scene, parts),
                "## Promised and measured",
                PROMISED.strip(),
                promised(parts),
                FOOT.strip(),
            ]
        )
        + "\n"
    )


def scene(part):
    """The section of one scene."""
    lines = [
        f"### {part['scene']}",
        "",
        f"{_count(part['bodies'])} over {shown(part['horizon'], 's')}, lengths in parts of "
        f"{shown(part['length'], 'm')}. {part['settings']} settings of "
        f"{len(part['methods'])} methods, {part['stopped']} of which had to stop. Errors against "
        f"{reference_text(part)}.",
        "",
        "| accuracy | the cheapest setting | its error | times real time | next methods |",
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
    """The three next methods and how many times more they cost."""
    costs = sorted(
        (costs[f"{accuracy:g}"], name)
        for name, costs in part["methods"].items()
        if name != cell["method"] and costs[f"{accuracy:g}"]
    )
    return ", ".join(f"{name} {cost / cell['cost_us']:.2g}x" for cost, name in costs[:3]) or "none"


def words(parts):
    """What the figures say, in words, of which every number is counted here."""
    lines = ["## In short", ""]
    for accuracy in (1e-3, 1e-6, 1e-9):
        won = {}
        for part in parts:
            for entry in part["cheapest"]:
                if entry["accuracy"] == accuracy and entry["cell"] is not None:
                    won.setdefault(part["cells"][entry["cell"]]["method"], []).append(part["scene"])
        said = "; ".join(
            f"{method} ({', '.join(names)})"
            for method, names in sorted(won.items(), key=lambda pair: -len(pair[1]))
        )
        none = [
            part["scene"]
            for part in parts
            for entry in part["cheapest"]
            if entry["accuracy"] == accuracy and entry["cell"] is None
        ]
        lines.append(
            f"* {accuracy:g} is cheapest with {said}"
            + (f"; out of reach for {', '.join(none)}" if none else "")
            + "."
        )
    for method in ("rkmk8", "rkmk4"):
        worst = [
            (costs[f"{accuracy:g}"] / best, part["scene"], accuracy)
            for part in parts
            for accuracy in (1e-3, 1e-6, 1e-9)
            for best in [
                min(
                    (
                        costs[f"{accuracy:g}"]
                        for costs in part["methods"].values()
                        if costs[f"{accuracy:g}"]
                    ),
                    default=None,
                )
            ]
            for costs in [part["methods"].get(method, {})]
            if best and costs.get(f"{accuracy:g}")
        ]
        if worst:
            middle = sorted(ratio for ratio, *_ in worst)[len(worst) // 2]
            most = max(worst)
            missed = sum(
                1 for part in parts for entry in part["cheapest"] if entry["cell"] is not None
            ) - len(worst)
            lines.append(
                f"* taken everywhere, {method} costs {middle:.2g} times the cheapest in "
                f"the middle of all cases, at most {most[0]:.2g} times ({most[1]} at "
                f"{most[2]:g})"
                + (
                    f", and in {missed} of them does not reach the accuracy within the "
                    "time that a run was given"
                    if missed
                    else ""
                )
                + "."
            )
    fastest = [
        (entry["real_time_factor"], part["scene"], entry["accuracy"])
        for part in parts
        for entry in part["cheapest"]
        if entry["cell"] is not None
    ]
    slow = [
        f"{name} at {accuracy:g} ({shown(factor)} times)"
        for factor, name, accuracy in sorted(fastest)
        if factor < 2.0
    ]
    lines.append(
        "* real time, with half of a core kept free, can be had "
        + ("in all cases that can be had at all." if not slow else f"but for {', '.join(slow)}.")
    )
    return "\n".join(lines)


def promised(parts):
    """The table of promises against what runs were measured to be."""
    lines = [
        "| scene | horizon | promised | setting | measured | kept |",
        "|---|---|---|---|---|---|",
    ]
    for part in parts:
        for entry in part["promises"]:
            begin = f"| {part['scene']} | {shown(part['horizon'], 's')} | {entry['accuracy']:g} |"
            if "refused" in entry:
                lines.append(f"{begin} refused: {entry['refused']} | | |")
                continue
            settings = entry["settings"]
            cell = {
                "options": {key: value for key, value in settings.items() if key == "rtol"},
                **settings,
            }
            kept = max(entry["measured"], entry["known"]) <= entry["accuracy"]
            lines.append(
                f"{begin} {setting(cell)} | "
                f"{error_text(entry['measured'], entry['known'])} | "
                f"{'yes' if kept else 'NO'} |"
            )
    ratios = [
        entry["measured"] / entry["promise"]["error"]
        for part in parts
        for entry in part["promises"]
        if "refused" not in entry and entry["measured"] > entry["known"]
    ]
    if ratios:
        lines += [
            "",
            f"Between the samples of the trade the errors are at most {max(ratios):.2g} "
            "times those at the samples; the margin is "
            f"{parts[0]['margin']:g}.",
        ]
    return "\n".join(lines)


HEAD = """
# Which method and step?

Measured, for every scene in `config/scenes/`: the cheapest setting for an accuracy, and how many
times faster than the clock it runs on one core. What accuracy means, how it is measured and how
far it can be trusted is in [trade.md](trade.md). This page is written by
`benchmarks/trade_all.py` from `docs/which_method.json`; your machine has other costs:
`liegroup_sim trade SCENE` measures them.
"""

PROMISED = """
What `accuracy` chooses for each scene, run over the horizon, and its largest error at up to 1000
instants, most of which the choice was not made from, against an integration of its own.
"""

FOOT = """
## The same fronts against others

Whether the errors behind these tables are true: `test/verification/test_trade_truth.py` holds the
truth that they are measured against to closed forms (free body, Lagrangian top), to 45-digit end
states of the heavy top, to the crank angle of the four-bar by quadrature of its energy, and to
motions by the accelerations of Pinocchio. `benchmarks/trade_truth_peers.py` measures every setting
on the fronts of four scenes by motions of Pinocchio and MuJoCo: [trade.md](trade.md) has the table.
"""
