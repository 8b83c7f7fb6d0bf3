# SPDX-License-Identifier: Apache-2.0
"""Figs. 6.6 to 6.9 of the chapter: errors of the rotation methods against their step.

    6.6, 6.8  |Y - Y0| of the free body at 16 s, a multiple of all steps (the 1 s of the chapter is not
              a multiple of 8, 4 and 2 s)
    6.7       ||R - Rref||_2 of the Lagrangian top at 1 s
    6.9       ||R - Rref||_2 of the free body at 10 s
and the largest deviations of the integrals of motion of the top over 10 s.
The exact end states come from elliptic functions (liegroup_core.reference.elliptic). A run with a small
step would not be accurate enough as a reference for the smallest steps. No ROS.
"""

from dataclasses import dataclass, field

import numpy as np
from rich.table import Table

from liegroup_core import Simulation, SimulationError, load_scene
from liegroup_core.methods.table import METHODS

from .rotation_tables import (
    FREE_ATTITUDE,
    FREE_CONSTANTS,
    FREE_STEPS,
    MOMENTUM,
    MOMENTUM_STEPS,
    TOP_ATTITUDE,
    TOP_CONSTANTS,
    TOP_INTEGRALS,
    TOP_RATES,
)

# {method: (name in the figures, colour, marker)}
STYLES = {
    "stoermer_verlet": ("Störmer-Verlet (6.42)", "#b3432b", "o"),
    "lie_newmark": ("Lie-Newmark", "#2c6e9b", "s"),
    "rattle": ("RATTLE", "#3f8f4f", "D"),
    "rkmk4": ("RKMK4", "#8a5fa8", "^"),
    "coadjoint_rkmk2": ("coadjoint RKMK2 (midpoint)", "#c28a1e", "v"),
    "coadjoint_rkmk2_heun": ("coadjoint RKMK2 (Heun)", "#e0b85c", "1"),
    "coadjoint_rkmk4": ("coadjoint RKMK4", "#1ca3a3", "<"),
    "coadjoint_rkmk8": ("coadjoint RKMK8", "#d46a9f", ">"),
    "simo_wong": ("Simo-Wong", "#555555", "P"),
    "austin_krishnaprasad_wang": ("Austin et al.", "#7a5230", "X"),
    "lie_midpoint": ("Lie midpoint", "#9aa81f", "d"),
    "bottasso_borri_candidate": ("Bottasso-Borri (candidate)", "#5b6fd6", "*"),
}


@dataclass(frozen=True)
class FigurePanel:
    """Figure with its error measure, methods, steps, and results of independent implementations."""

    number: str  # number of the figure
    title: str
    unit: str
    scene: str
    time: float  # s
    quantity: str  # "momentum" or "attitude"
    methods: tuple
    steps: tuple  # s
    elsewhere: dict  # {method: errors at the steps}
    constants: dict = field(default_factory=dict)  # {method: (order, C)} of these errors


PANELS = (
    FigurePanel(
        "6.6",
        "Free body, 16 s: momentum",
        "|Y - Y0|, N m s",
        "free_body",
        16.0,
        "momentum",
        ("stoermer_verlet", "lie_newmark", "rattle", "rkmk4"),
        MOMENTUM_STEPS,
        MOMENTUM,
    ),
    FigurePanel(
        "6.7",
        "Lagrangian top, 1 s: attitude",
        "||R - Rref||, no unit",
        "lagrangian_top",
        1.0,
        "attitude",
        (
            "stoermer_verlet",
            "lie_newmark",
            "rattle",
            "rkmk4",
            "lie_midpoint",
            "simo_wong",
            "austin_krishnaprasad_wang",
            "coadjoint_rkmk4",
            "coadjoint_rkmk8",
        ),
        tuple(1 / rate for rate in TOP_RATES),
        TOP_ATTITUDE,
        TOP_CONSTANTS,
    ),
    FigurePanel(
        "6.8",
        "Free body, 16 s: momentum",
        "|Y - Y0|, N m s",
        "free_body",
        16.0,
        "momentum",
        ("coadjoint_rkmk2", "coadjoint_rkmk4", "simo_wong", "austin_krishnaprasad_wang", "lie_newmark"),
        MOMENTUM_STEPS,
        MOMENTUM,
    ),
    FigurePanel(
        "6.9",
        "Free body, 10 s: attitude",
        "||R - Rref||, no unit",
        "free_body",
        10.0,
        "attitude",
        (
            "coadjoint_rkmk2",
            "coadjoint_rkmk2_heun",
            "coadjoint_rkmk4",
            "austin_krishnaprasad_wang",
            "simo_wong",
            "bottasso_borri_candidate",
            "lie_midpoint",
            "stoermer_verlet",
            "lie_newmark",
            "rattle",
            "rkmk4",
        ),
        FREE_STEPS,
        FREE_ATTITUDE,
        FREE_CONSTANTS,
    ),
)
# Smaller errors count as round-off of 65536 steps.
ROUNDING = 1e-11


def count_runs():
    """Number of runs in make_rotation_figures."""
    return sum(len(panel.methods) * len(panel.steps) for panel in PANELS) + len(TOP_INTEGRALS)


def make_rotation_figures(out, say=lambda text: None):
    """Draw Figs. 6.6 to 6.9 in a folder; returns (paths, tables of the errors and integrals).

    say : function that is called with the name of each run before it starts
    """
    paths, tables = [], []
    for panel in PANELS:
        panel_errors = errors(panel, say)
        paths.append(_draw(out / f"fig_{panel.number.replace('.', '_')}.png", panel, panel_errors))
        tables.append(make_table(panel, panel_errors))
    tables.append(_integrals_table(say))
    return paths, tables


def end_attitude(scene, time):
    """Exact attitude (3, 3) of the free body or the Lagrangian top at a time."""
    from liegroup_core.reference.elliptic import free_body, heavy_top, to_floats

    body = load_scene(scene).bodies[0]
    if scene == "free_body":
        return to_floats(free_body(body.inertia_matrix, body.rotation, body.angular_velocity, time)[0])
    arm = np.array(body.position)  # the spherical joint is at the origin
    across = body.inertia_matrix[0, 0] + body.mass * (arm @ arm)
    return to_floats(
        heavy_top(
            across,
            body.inertia_matrix[1, 1],
            body.mass * np.linalg.norm(arm),
            arm / np.linalg.norm(arm),
            load_scene(scene).gravity,
            body.rotation,
            body.angular_velocity,
            time,
        )[0]
    )


def errors(panel, say=lambda text: None):
    """{method: errors at the steps of a panel}, None if the method has no solution."""
    reference = end_attitude(panel.scene, panel.time) if panel.quantity == "attitude" else None
    result = {}
    for method in panel.methods:
        result[method] = []
        for step in panel.steps:
            say(f"Fig. {panel.number}, {method}, {step_text(step)}")
            result[method].append(_error(panel, method, step, reference))
    return result


def order_and_constant(steps, step_errors, order):
    """(observed order, C) from the last two errors above round-off; C = error / h^order with the given order.

    NaN if there are fewer than two such errors.
    """
    usable = [(step, error) for step, error in zip(steps, step_errors) if error and error > ROUNDING]
    if len(usable) < 2:
        return np.nan, np.nan
    (step, error), (last_step, last) = usable[-2:]
    return np.log(error / last) / np.log(step / last_step), last / last_step**order


def top_integrals(method, step):
    """Largest deviations over 10 s of energy, J, vertical momentum, N m s, and spin, rad/s."""
    simulation = Simulation(load_scene("lagrangian_top"), method=method, step=step)
    start, deviations = simulation.sample(), []
    # Samples at every tenth step slightly underestimate the peaks of the nutation.
    for _ in range(round(10 / step) // 10):
        simulation.advance(10)
        sample = simulation.sample()
        deviations.append(
            (
                sample.energy - start.energy,
                sample.spatial_momentum[2] - start.spatial_momentum[2],
                sample.twist[0, 1] - start.twist[0, 1],
            )
        )
    return np.abs(deviations).max(axis=0)


def _integrals_table(say):
    """Table of the integrals of motion for methods and steps that have independent results."""
    table = _new_table("Lagrangian top, 10 s: largest deviation from the start")
    for column in ("method", "step", "", "energy, J", "vertical momentum, N m s", "spin, rad/s"):
        table.add_column(column, min_width=9)
    for (method, step), elsewhere in TOP_INTEGRALS.items():
        say(f"Lagrangian top, 10 s, {method}, {step:g} s")
        table.add_row(STYLES[method][0], f"{step:g} s", "here", *map(_text, top_integrals(method, step)))
        table.add_row(
            "", "", "elsewhere", *("< 1e-11" if value is None else _text(value) for value in elsewhere), style="dim"
        )
    return table


def _error(panel, method, step, reference):
    simulation = Simulation(load_scene(panel.scene), method=method, step=step)
    start = simulation.sample().spatial_momentum[:3]
    try:
        simulation.advance(round(panel.time / step))
    except SimulationError:
        return None
    sample = simulation.sample()
    if reference is None:
        return float(np.linalg.norm(sample.spatial_momentum[:3] - start))
    return float(np.linalg.norm(sample.pose_matrices[0, :3, :3] - reference, 2))


def make_table(panel, found):
    """Table of errors of all methods at each step, each row followed by that of independent implementations.

    For attitudes, it also has order and error constant.
    """
    table = _new_table(f"Fig. {panel.number}, {panel.title}, {panel.unit}")
    for column in ("step", "", *(STYLES[method][0] for method in panel.methods)):
        table.add_column(column, min_width=max(9, *map(len, column.split()), 0))

    def add(name, here, elsewhere):
        table.add_row(name, "here", *here)
        table.add_row("", "elsewhere", *elsewhere, style="dim")

    for k, step in enumerate(panel.steps):
        add(
            step_text(step),
            [_text(found[method][k]) for method in panel.methods],
            [
                _text(panel.elsewhere[method][k]) if k < len(panel.elsewhere.get(method, ())) else ""
                for method in panel.methods
            ],
        )
    if panel.constants:
        here = {
            method: order_and_constant(panel.steps, found[method], METHODS[method].order) for method in panel.methods
        }
        given = [panel.constants.get(method) for method in panel.methods]
        add(
            "order",
            [f"{here[method][0]:.2f}" for method in panel.methods],
            ["" if pair is None else f"{pair[0]:.2f}" for pair in given],
        )
        add(
            "C, 1/s^p",
            [_text(here[method][1]) for method in panel.methods],
            ["" if pair is None else _text(pair[1]) for pair in given],
        )
    return table


def _new_table(title):
    return Table(title=title, box=None, padding=(0, 1, 0, 0), title_justify="left")


def step_text(step):
    """Text of a step as a fraction of a second."""
    return f"{step:g} s" if step >= 1 else f"1/{1 / step:g} s"


def _text(error):
    return "none" if error is None else f"{error:.3e}"


def _draw(path, panel, found):
    """Draw errors over steps with logarithmic axes."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.4, 4.8), layout="constrained", dpi=120)
    axis = figure.subplots()
    for method in panel.methods:
        label, colour, marker = STYLES[method]
        # Lines have gaps where a method has no solution. Exact zeros are not drawn.
        axis.loglog(
            panel.steps,
            [error or np.nan for error in found[method]],
            color=colour,
            marker=marker,
            markersize=4,
            linewidth=1.0,
            label=label,
        )
    axis.set_title(panel.title, fontsize=10)
    axis.set_xlabel("step, s")
    axis.set_ylabel(panel.unit)
    axis.grid(True, which="major", color="#dddddd", linewidth=0.6)
    figure.legend(loc="outside right upper", fontsize=8, frameon=False)
    figure.savefig(path)
    return path
