# SPDX-License-Identifier: Apache-2.0
"""Energy error and constraint drift over a million steps, every method at equal cost.

    python benchmarks/long_runs.py [--steps 1000000] [--scene NAME ...]

`constrained_rattle` takes the given steps. Every other method gets the same CPU time for the same
simulated time: its step follows from its cost per step. Prints
    us of CPU time per step, of the fastest of many runs, because other processes only add time
    scatter  rms of the energy about its fitted line over time
    drift    change of that line over the run, with the standard error from means of tenths of the run;
             both relative to the mean kinetic energy
    gap      largest position residual of a joint at the samples, m or rad
A drift below twice its standard error is not significant.
"""

import argparse
import logging

import numpy as np
from rich.console import Console
from rich.table import Table
from timing import seconds_of_step

from liegroup_core import SimulationError, load_scene
from liegroup_core.engine import Engine

SCENES = {"double_pendulum": 1e-3, "four_bar": 1e-3, "bricard": 1e-3}  # step of constrained_rattle, s
METHODS = (
    ("constrained_rattle", {}),
    ("constrained_rattle4", {}),
    ("constrained_rattle8", {}),
    ("rkmk4", {}),
    ("rkmk4", {"stabilisation": "projection"}),
    ("rkmk4", {"group": "se3"}),
    ("rkmk4", {"group": "se3", "stabilisation": "projection"}),
    ("rkmk8", {}),
    ("rkmk8", {"stabilisation": "projection"}),
    ("rkmk8", {"group": "se3"}),
    ("rkmk8", {"group": "se3", "stabilisation": "projection"}),
)
SAMPLES, BLOCKS = 2000, 10


def microseconds(scene, step, method, settings, steps=2000, repeat=40):
    """CPU time of one step, us: the fastest of several runs."""
    simulation = Engine(scene, method=method, step=step, **settings)
    return seconds_of_step(simulation, steps, repeat) * 1e6


def kinetic_energy(simulation):
    """Kinetic energy of the current state, J."""
    twist, bodies = simulation.state()[1], simulation.layout.model.bodies
    spin = np.einsum("ni,nij,nj->", twist[:, :3], bodies["inertia"].reshape(-1, 3, 3), twist[:, :3])
    return 0.5 * (spin + bodies["mass"] @ (twist[:, 3:] ** 2).sum(axis=1))


def long_run(scene, step, duration, method, settings):
    """(energy error (SAMPLES,) relative to the mean kinetic energy, largest residual)."""
    simulation = Engine(scene, method=method, step=step, **settings)
    total = round(duration / step)
    energy, kinetic, gap = [], [], 0.0
    for k in range(SAMPLES + 1):
        simulation.advance(total * k // SAMPLES - simulation.steps)
        sample = simulation.sample()
        energy.append(sample.energy)
        kinetic.append(kinetic_energy(simulation))
        gap = max(gap, sample.constraint_residual)
    return (np.array(energy[1:]) - energy[0]) / np.mean(kinetic), gap


def trend(energy):
    """(scatter, drift, standard error of the drift) of equidistant samples."""
    when = np.linspace(-0.5, 0.5, len(energy))
    line = np.polyfit(when, energy, 1)
    rest = energy - np.polyval(line, when)
    # Neighbouring samples are correlated; means of tenths of the run are treated as independent.
    blocks = rest.reshape(BLOCKS, -1).mean(axis=1)
    middle = when.reshape(BLOCKS, -1).mean(axis=1)
    error = np.sqrt(blocks @ blocks / (BLOCKS - 2) / (middle @ middle))
    return rest.std(), line[0], error


def main():
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=1_000_000)
    parser.add_argument("--scene", nargs="+", choices=SCENES, default=list(SCENES))
    options = parser.parse_args()
    logging.getLogger("liegroup_core").setLevel(logging.ERROR)  # the gaps are in the table
    console = Console(width=110)
    for name in options.scene:
        scene, first_step = load_scene(name), SCENES[name]
        duration = options.steps * first_step
        table = Table(title=f"{name}, {duration:g} s")
        for column in ("method", "step, s", "us/step", "scatter", "drift", "gap"):
            table.add_column(column, justify="left" if column == "method" else "right")
        reference = None
        for method, settings in METHODS:
            cost = microseconds(scene, first_step, method, settings)
            reference = reference or cost
            # Samples after whole steps each.
            parts = max(1, round(options.steps / SAMPLES * reference / cost))
            step = duration / (SAMPLES * parts)
            label = " ".join((method, *settings.values()))
            try:
                energy, gap = long_run(scene, step, duration, method, settings)
            except SimulationError as failure:
                when = str(failure).partition(" s ")[0]
                table.add_row(label, f"{step:.3g}", f"{cost:.2f}", f"{when} s")
                continue
            scatter, drift, error = trend(energy)
            table.add_row(
                label, f"{step:.3g}", f"{cost:.2f}", f"{scatter:.1e}", f"{drift:+.1e} ± {error:.0e}", f"{gap:.0e}"
            )
        console.print(table)


if __name__ == "__main__":
    main()
