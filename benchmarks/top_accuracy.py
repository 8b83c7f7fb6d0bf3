# SPDX-License-Identifier: Apache-2.0
"""Accuracy and cost of every method on the Lagrangian top: 1 s, 150 rad/s, exact end state.

    python benchmarks/top_accuracy.py [method ...]

Prints ||R - Rref||_F at 1 s and the shortest time of several runs, because other load only adds
time. Methods with error control run over one step of 1 s.
"""

import argparse
import time

import numpy as np
from rich.console import Console
from rich.table import Table

from liegroup_core import SimulationError, load_scene
from liegroup_core.engine import Engine
from liegroup_core.methods.table import METHODS

# Taylor series in 45 digits.
R_1 = np.array(
    [
        [0.22929964080360759, 0.17334396409838604, 0.95779619170155087],
        [-0.76534074220468094, 0.64008859207056878, 0.067380580456872719],
        [-0.60139439891715374, -0.74849079113358131, 0.27943928238402867],
    ]
)
STEPS = (1e-2, 5e-3, 2e-3, 1e-3, 5e-4, 2e-4, 1e-4)
TOLERANCES = (1e-4, 1e-6, 1e-8, 1e-10, 1e-12)


def measure(repeat, **settings):
    """(error, wall s, substeps) of one simulated second, the fastest of several runs."""
    simulation = Engine(load_scene("lagrangian_top"), **settings)
    steps = round(1.0 / simulation.step)
    best = np.inf
    for _ in range(repeat):
        simulation.reset()
        start = time.perf_counter()
        simulation.advance(steps)
        best = min(best, time.perf_counter() - start)
    error = np.linalg.norm(simulation.sample().poses["top"][:3, :3] - R_1)
    return error, best, simulation.substeps[1] or steps


def main():
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("methods", nargs="*", default=list(METHODS), metavar="method")
    parser.add_argument("--repeat", type=int, default=15)
    options = parser.parse_args()
    table = Table(title="Lagrangian top, 1 s")
    for column in ("method", "step or tolerance", "error", "ms per s", "us per step"):
        table.add_column(column, justify="left" if column == "method" else "right")
    for name in options.methods:
        method = METHODS[name]
        controlled = method.controlled
        for value in TOLERANCES if controlled else STEPS:
            settings = {"step": 1.0, "rtol": value, "atol": value} if controlled else {"step": value}
            try:
                error, seconds, steps = measure(options.repeat, method=name, **settings)
            except SimulationError:
                continue  # the step is too large for this method
            table.add_row(name, f"{value:g}", f"{error:.1e}", f"{1e3 * seconds:.3f}", f"{1e6 * seconds / steps:.2f}")
    Console().print(table)


if __name__ == "__main__":
    main()
