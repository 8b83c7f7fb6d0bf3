# SPDX-License-Identifier: Apache-2.0
"""Measured trade-off of a scene as JSON types and as tables."""

from rich.text import Text

from liegroup_core.study.trade.trade import ACCURACIES, MARGIN
from liegroup_sim_ros.numbers import GROUPS, counted, shown
from liegroup_sim_ros.recording.attachments import versions

from .tables import table_of
from .terminal import printed

WIDTH = 130  # characters; in a narrower terminal, lines wrap
SHARE = 0.5  # of a core that a real-time integration may use


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


def tables(part):
    """[Table] of a scene: cheapest configurations, simulations to an accuracy, Pareto front."""
    known, cells = part["reference"], part["cells"]

    def of_cell(text):
        return lambda each: "-" if each["cell"] is None else text(each, cells[each["cell"]])

    cheapest = {
        "accuracy": lambda each: f"{each['accuracy']:g}",
        "configuration": lambda each: (
            f"none: best {shown(part['best'])}" if each["cell"] is None else setting(cells[each["cell"]])
        ),
        "error": of_cell(lambda _, cell: error_text(cell["error"], known["known"])),
        "CPU s per s": of_cell(lambda _, cell: shown(cell["cost_us"] * 1e-6)),
        "real-time factor": of_cell(lambda each, _: shown(each["real_time_factor"])),
    }
    accuracies = {
        "accuracy": lambda each: f"{each['accuracy']:g}",
        "error": lambda each: error_text(each["error"], known["known"]),
        "estimate": lambda each: "infinite" if each["estimate"] is None else shown(each["estimate"]),
        "met, by the estimate": lambda each: "yes" if each["until"] is None else f"until {shown(each['until'], 's')}",
        "CPU s per s": lambda each: shown(each["cost_us"] * 1e-6),
    }
    front = {
        "error": lambda cell: error_text(cell["error"], known["known"]),
        "CPU s per s": lambda cell: shown(cell["cost_us"] * 1e-6),
        "configuration": setting,
        "rad/s": lambda cell: error_text(cell["angular"], known["angular"]),
        "m/s": lambda cell: error_text(cell["linear"], known["linear"]),
        **{name: lambda cell, name=name: shown(cell[name]) for name in ("energy", "momentum", "joints")},
    }
    margin = f"Cheapest configuration for each accuracy, with a margin of {part['margin']:g}"
    text = "Pareto front; right columns: errors of angular velocity, velocity, energy, momentum, joints"
    return [
        table_of(cheapest, part["cheapest"], margin, 0),
        table_of(accuracies, part["to_accuracy"], "Simulations to an accuracy (cost includes the estimate)", 0),
        table_of(front, [cells[k] for k in part["front"]], text, 0),
    ]


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
    for each in tables(part):
        console.print()
        console.print(printed(each))
    console.print()
