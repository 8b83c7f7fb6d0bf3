# SPDX-License-Identifier: Apache-2.0
"""Figs. 6.6 to 6.9 of the chapter: errors of the rotation methods against their step.

    6.6, 6.8  |Y - Y0| of the free body at 16 s, which all steps divide (at 1 s, as printed, steps
              of 8, 4 and 2 s have no end)
    6.7       ||R - Rref||_2 of the Lagrangian top at 1 s
    6.9       ||R - Rref||_2 of the free body at 10 s
The end states come from elliptic functions (liegroup_core.reference.elliptic), not from a run with
a small step, whose own error would be seen at the smallest ones. No ROS.
"""
from dataclasses import dataclass

import numpy as np
from rich.table import Table

from liegroup_core import Simulation, SimulationError, load_scene

from .rotation_tables import (FREE_ATTITUDE, FREE_STEPS, MOMENTUM, MOMENTUM_STEPS, TOP_ATTITUDE,
                              TOP_RATES)

# Of each method its name in the pictures, its colour and its marker.
STYLES = {
    "stoermer_verlet": ("Störmer-Verlet (6.42)", "#b3432b", "o"),
    "lie_newmark": ("Lie-Newmark", "#2c6e9b", "s"),
    "rattle": ("RATTLE", "#3f8f4f", "D"),
    "rkmk4": ("RKMK4", "#8a5fa8", "^"),
    "coadjoint_rkmk2": ("coadjoint RKMK2", "#c28a1e", "v"),
    "coadjoint_rkmk4": ("coadjoint RKMK4", "#1ca3a3", "<"),
    "coadjoint_rkmk8": ("coadjoint RKMK8", "#d46a9f", ">"),
    "simo_wong": ("Simo-Wong", "#555555", "P"),
    "austin_krishnaprasad_wang": ("Austin et al.", "#7a5230", "X"),
    "lie_midpoint": ("Lie midpoint", "#9aa81f", "d"),
    "bottasso_borri_candidate": ("Bottasso-Borri (candidate)", "#5b6fd6", "*"),
}


@dataclass(frozen=True)
class Panel:
    """One figure: what is measured, by which methods and steps, and the numbers of others."""

    number: str             # of the figure
    title: str
    unit: str
    scene: str
    time: float             # s
    quantity: str           # "momentum" or "attitude"
    methods: tuple
    steps: tuple            # s
    elsewhere: dict         # {method: errors at the steps}


PANELS = (
    Panel("6.6", "Free body, 16 s: momentum", "|Y - Y0|, N m s", "free_body", 16.0, "momentum",
          ("stoermer_verlet", "lie_newmark", "rkmk4"), MOMENTUM_STEPS, MOMENTUM),
    Panel("6.7", "Lagrangian top, 1 s: attitude", "||R - Rref||", "lagrangian_top", 1.0,
          "attitude", ("stoermer_verlet", "lie_newmark", "rattle", "rkmk4", "lie_midpoint",
                       "simo_wong", "coadjoint_rkmk4", "coadjoint_rkmk8"),
          tuple(1 / rate for rate in TOP_RATES), TOP_ATTITUDE),
    Panel("6.8", "Free body, 16 s: momentum", "|Y - Y0|, N m s", "free_body", 16.0, "momentum",
          ("coadjoint_rkmk2", "coadjoint_rkmk4", "simo_wong", "austin_krishnaprasad_wang",
           "lie_newmark"), MOMENTUM_STEPS, MOMENTUM),
    Panel("6.9", "Free body, 10 s: attitude", "||R - Rref||", "free_body", 10.0, "attitude",
          ("coadjoint_rkmk2", "coadjoint_rkmk4", "austin_krishnaprasad_wang", "simo_wong",
           "bottasso_borri_candidate", "stoermer_verlet", "lie_newmark", "rkmk4"), FREE_STEPS,
          FREE_ATTITUDE),
)


def make_rotation_figures(out):
    """Make the pictures in a folder; returns (their paths, a table for each)."""
    paths, tables = [], []
    for panel in PANELS:
        found = errors(panel)
        paths.append(_draw(out / f"fig_{panel.number.replace('.', '_')}.png", panel, found))
        tables.append(make_table(panel, found))
    return paths, tables


def end_attitude(scene, time):
    """Exact attitude (3, 3) of the free body or the Lagrangian top at a time."""
    from liegroup_core.reference.elliptic import free_body, heavy_top, to_floats

    body = load_scene(scene).bodies[0]
    if scene == "free_body":
        return to_floats(free_body(body.inertia_matrix, body.rotation, body.angular_velocity,
                                   time)[0])
    arm = np.array(body.position)           # the ball joint is at the origin
    across = body.inertia_matrix[0, 0] + body.mass * (arm @ arm)
    return to_floats(heavy_top(across, body.inertia_matrix[1, 1], body.mass * np.linalg.norm(arm),
                               arm / np.linalg.norm(arm), load_scene(scene).gravity, body.rotation,
                               body.angular_velocity, time)[0])


def errors(panel):
    """{method: errors at the steps of a panel}, None where the method has no solution."""
    reference = end_attitude(panel.scene, panel.time) if panel.quantity == "attitude" else None
    return {method: [_error(panel, method, step, reference) for step in panel.steps]
            for method in panel.methods}


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
    """Errors of all methods per step and, below each, those of independent implementations."""
    table = Table(title=f"Fig. {panel.number}, {panel.title}, {panel.unit}", box=None,
                  padding=(0, 1, 0, 0), title_justify="left")
    for column in ("step", "", *(STYLES[method][0] for method in panel.methods)):
        table.add_column(column, min_width=9)
    for k, step in enumerate(panel.steps):
        table.add_row(step_text(step), "here", *(_text(found[method][k])
                                                 for method in panel.methods))
        table.add_row("", "elsewhere", *(
            _text(panel.elsewhere[method][k]) if k < len(panel.elsewhere.get(method, ())) else ""
            for method in panel.methods), style="dim")
    return table


def step_text(step):
    """A step as a fraction of a second."""
    return f"{step:g} s" if step >= 1 else f"1/{1 / step:g} s"


def _text(error):
    return "none" if error is None else f"{error:.3e}"


def _draw(path, panel, found):
    """Errors against steps, both logarithmic."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.4, 4.8), layout="constrained", dpi=120)
    axis = figure.subplots()
    for method in panel.methods:
        label, colour, marker = STYLES[method]
        points = [(step, error) for step, error in zip(panel.steps, found[method]) if error]
        axis.loglog(*zip(*points), color=colour, marker=marker, markersize=4, linewidth=1.0,
                    label=label)
    axis.set_title(panel.title, fontsize=10)
    axis.set_xlabel("step, s")
    axis.set_ylabel(panel.unit)
    axis.grid(True, which="major", color="#dddddd", linewidth=0.6)
    figure.legend(loc="outside right upper", fontsize=8, frameon=False)
    figure.savefig(path)
    return path
