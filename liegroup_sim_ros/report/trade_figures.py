# SPDX-License-Identifier: Apache-2.0
"""Measured trade-off of a scene as JSON types and as tables."""

from rich.text import Text

from liegroup_core.study.trade.trade import ACCURACIES, MARGIN
from liegroup_sim_ros.numbers import GROUPS, counted, shown
from liegroup_sim_ros.recording.attachments import versions

from .terminal import plain_table

WIDTH = 130  # characters; in a narrower terminal, lines wrap
CHEAPEST_HEAD = ("accuracy", "configuration", "error", "CPU s per s", "real-time factor")
FRONT_HEAD = ("error", "CPU s per s", "configuration", "rad/s", "m/s", "energy", "momentum", "joints")
SHARE = 0.5  # of a core that a real-time integration may use
ACCURACY_HEAD = ("accuracy", "error", "estimate", "met, by the estimate", "CPU s per s")
ACCURACY_TITLE = "Simulations to an accuracy (cost includes the estimate)"
FRONT_TITLE = "Pareto front; right columns: errors of angular velocity, velocity, energy, momentum, joints"


def document_part(trade):
    """Results of a Trade as JSON types, see config/trade.schema.json."""
    truth = trade.truth
    cells = trade.cells
    number = {id(cell): k for k, cell in enumerate(cells)}
    cheapest = []
    for accuracy in ACCURACIES:
        cell = trade.cheapest(accuracy)
        cheapest.append(
            {
                "accuracy": accuracy,
                "cell": None if cell is None else number[id(cell)],
                "real_time_factor": None if cell is None else 1e6 / cell["cost_us"],
            }
        )
    best = trade.best()
    in_time = trade.best(lambda cell: cell["cost_us"] * 1e-6 <= SHARE)
    return {
        "scene": trade.scene.name,
        "bodies": len(trade.scene.bodies),
        "horizon": trade.horizon,
        "length": truth.length,
        "reference": {
            "kind": "integration",
            "known": truth.known,
            "position": truth.uncertainty[0],
            "attitude": truth.uncertainty[1],
            "angular": truth.uncertainty[2],
            "linear": truth.uncertainty[3],
            "seconds": truth.seconds,
        },
        "margin": MARGIN,
        "versions": versions(),
        "cells": cells,
        "front": [number[id(cell)] for cell in trade.front()],
        "cheapest": cheapest,
        "to_accuracy": trade.to_accuracies(),
        "best": None if best is None else best[1],
        "best_in_real_time": None if in_time is None else in_time[1],
    }


def setting(cell):
    """Text with the configuration of a cell."""
    tolerance = cell["options"].get("rtol")
    more = "" if tolerance is None else f", rtol {tolerance:g}"
    stabilised = "" if cell["stabilisation"] == "none" else f", {cell['stabilisation']}"
    step = shown(cell["step"] * 1e3, "ms") if cell["step"] < 1.0 else shown(cell["step"], "s")
    return f"{cell['method']}, {step}{more}, {GROUPS[cell['group']]}{stabilised}"


def error_text(value, known):
    """Text of an error: its value, or "below" the reference uncertainty if this is larger."""
    return f"below {shown(known)}" if value <= known else shown(value)


def reference_text(part):
    """Text that describes the reference solution."""
    return f"the reference integration; reference uncertainty {shown(part['reference']['known'])}"


def cheapest_rows(part):
    """[(accuracy, configuration, error, CPU s per s, real-time factor)], all texts."""
    rows = []
    for entry in part["cheapest"]:
        if entry["cell"] is None:
            rows.append((f"{entry['accuracy']:g}", f"none: best {shown(part['best'])}", "-", "-", "-"))
            continue
        cell = part["cells"][entry["cell"]]
        rows.append(
            (
                f"{entry['accuracy']:g}",
                setting(cell),
                error_text(cell["error"], part["reference"]["known"]),
                shown(cell["cost_us"] * 1e-6),
                shown(entry["real_time_factor"]),
            )
        )
    return rows


def accuracy_rows(part):
    """Rows of ACCURACY_HEAD for the simulations to an accuracy, all texts."""
    return [
        (
            f"{entry['accuracy']:g}",
            error_text(entry["error"], part["reference"]["known"]),
            "infinite" if entry["estimate"] is None else shown(entry["estimate"]),
            "yes" if entry["until"] is None else f"until {shown(entry['until'], 's')}",
            shown(entry["cost_us"] * 1e-6),
        )
        for entry in part["to_accuracy"]
    ]


def front_rows(part):
    """Rows of FRONT_HEAD for the Pareto front, all texts."""
    reference = part["reference"]
    rows = []
    for k in part["front"]:
        cell = part["cells"][k]
        rows.append(
            (
                error_text(cell["error"], reference["known"]),
                shown(cell["cost_us"] * 1e-6),
                setting(cell),
                error_text(cell["angular"], reference["angular"]),
                error_text(cell["linear"], reference["linear"]),
                shown(cell["energy"]),
                shown(cell["momentum"]),
                shown(cell["joints"]),
            )
        )
    return rows


def headline(part):
    """Main result in one sentence."""
    stopped = sum(bool(cell["stopped"]) for cell in part["cells"])
    return (
        f"{part['scene']}: {counted(len(part['cells']), 'configuration')} over "
        f"{shown(part['horizon'], 's')}, {stopped} of them stopped early; "
        f"{len(part['front'])} on the Pareto front"
    )


def print_trade(part, console):
    """Print the tables on a terminal."""
    console.width = max(console.width, WIDTH)
    console.print(Text(headline(part), style="bold"))
    console.print(
        Text(f"errors against {reference_text(part)}; lengths relative to {shown(part['length'], 'm')}", style="dim")
    )
    _print(
        console,
        f"Cheapest configuration for each accuracy, with a margin of {part['margin']:g}",
        CHEAPEST_HEAD,
        cheapest_rows(part),
    )
    _print(console, ACCURACY_TITLE, ACCURACY_HEAD, accuracy_rows(part))
    _print(console, FRONT_TITLE, FRONT_HEAD, front_rows(part))
    console.print()


def _print(console, title, heads, rows):
    console.print()
    console.print(plain_table(title, heads, rows))
