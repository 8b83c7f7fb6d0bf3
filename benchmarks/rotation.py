# SPDX-License-Identifier: Apache-2.0
"""Rotation methods: cost of a step, and conservation of energy and momentum in long runs.

    python benchmarks/rotation.py [--steps 10000000] [--method NAME ...]

Prints for the free body and the Lagrangian top of the chapter
    ns of CPU time per step, of the fastest of several runs, because other processes only add time
    energy errors at 1/100, 1/10 and the end of a long run: they show whether the energy drifts
    momentum errors there (of the top: about the vertical), and the exponent of their growth with the
    steps: 1/2 for random round-off, 1 for systematic round-off
"""

import argparse

import numpy as np
from rich.console import Console
from rich.table import Table
from timing import seconds_of_step

from liegroup_core import SimulationError, load_scene
from liegroup_core.engine import Engine
from liegroup_core.methods.table import METHODS

SCENES = {"free_body": 0.05, "lagrangian_top": 1e-4}  # and the step of the long run, s
SAMPLES = 60  # of a long run, evenly in log steps


def nanoseconds(scene, step, method, steps=100_000, repeat=7):
    """CPU time of one step, ns: the fastest of several runs."""
    simulation = Engine(load_scene(scene), method=method, step=step)
    return seconds_of_step(simulation, steps, repeat) * 1e9


def long_run(scene, step, method, steps):
    """(step counts (k,), relative energy errors (k,), relative momentum errors (k,)) of a long run."""
    simulation = Engine(load_scene(scene), method=method, step=step)
    parts = slice(0, 3) if scene == "free_body" else slice(2, 3)
    start = simulation.sample()
    counts = np.unique(np.geomspace(100, steps, SAMPLES).astype(int))
    energy, momentum = [], []
    size = np.linalg.norm(start.spatial_momentum[:3])
    for count in counts:
        simulation.advance(int(count) - simulation.steps)
        sample = simulation.sample()
        energy.append(sample.energy / start.energy - 1.0)
        momentum.append(np.linalg.norm((sample.spatial_momentum - start.spatial_momentum)[parts]) / size)
    return counts, np.array(energy), np.array(momentum)


def exponent(counts, errors):
    """Slope of log error over log steps; errors near zero are omitted."""
    good = errors > 0.0
    return np.polyfit(np.log(counts[good]), np.log(errors[good]), 1)[0]


def main():
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=10_000_000)
    parser.add_argument(
        "--method",
        nargs="*",
        metavar="NAME",
        default=[name for name, method in METHODS.items() if method.family == "rotation"] + ["rkmk4"],
    )
    options = parser.parse_args()
    console = Console(width=130)
    for scene, step in SCENES.items():
        table = Table(title=f"{scene}, h = {step:g} s, {options.steps} steps", box=None, title_justify="left")
        for column in (
            "method",
            "ns a step",
            "energy, 1/100",
            "1/10",
            "the end",
            "momentum, 1/100",
            "1/10",
            "the end",
            "exponent",
        ):
            table.add_column(column, justify="left" if column == "method" else "right")
        for method in options.method:
            try:
                cost = nanoseconds(scene, step, method)
                counts, energy, momentum = long_run(scene, step, method, options.steps)
            except SimulationError as error:
                table.add_row(method, str(error))
                continue
            at = [np.argmin(abs(counts - options.steps / part)) for part in (100, 10, 1)]
            table.add_row(
                method,
                f"{cost:.0f}",
                *(f"{energy[k]:.1e}" for k in at),
                *(f"{momentum[k]:.1e}" for k in at),
                f"{exponent(counts, momentum):.2f}",
            )
        console.print(table)


if __name__ == "__main__":
    main()
