# SPDX-License-Identifier: Apache-2.0
"""Cost of the reactions of all joints at every step, compared with a step at the default accuracy.

    python benchmarks/reactions.py [SCENE ...] [--repeat 15]

Loops over the same steps with and without reactions alternate, and the table has medians of their
differences. Absolute figures depend on the machine and its load.
"""

import argparse
import logging
import statistics
import time

from rich.console import Console
from rich.table import Table

from liegroup_core import Simulation, load_scene
from liegroup_core.scene.load import example_scenes

STEPS = 200
FEW = {"andrews_squeezer": 5}  # steps of a scene that becomes faster and faster


def seconds(simulation, step, count):
    """CPU time of a loop of steps from the initial state, s per step."""
    simulation.reset()
    step()
    start = time.thread_time()
    for _ in range(count):
        step()
    return (time.thread_time() - start) / count


def costs(name, repeat):
    """(us of a step in one call of many, in a loop, of reaction_array, of Sample.reactions)."""
    simulation, count = Simulation(load_scene(name), quiet=True), FEW.get(name, STEPS)
    simulation.layout.reactions.warm_up()

    def plain():
        simulation.advance(1)

    def array():
        simulation.advance(1)
        simulation.reaction_array()

    def sample():
        simulation.advance(1)
        simulation.sample()

    def named():
        simulation.advance(1)
        _ = simulation.sample().reactions

    rows = []
    for _ in range(repeat):
        simulation.reset()
        simulation.advance(1)
        start = time.thread_time()
        simulation.advance(count)
        native = (time.thread_time() - start) / count
        loop, arrays, samples, names_ = (seconds(simulation, step, count) for step in (plain, array, sample, named))
        rows.append((native, loop, arrays - loop, names_ - samples))
    return [1e6 * statistics.median(column) for column in zip(*rows)]


def main():
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="*", metavar="SCENE", help="default: all example scenes")
    parser.add_argument("--repeat", type=int, default=15)
    options = parser.parse_args()
    logging.disable(logging.WARNING)
    table = Table(title="Reactions of all joints at every step, us")
    for column in ("scene", "step", "advance(1)", "reaction_array", "of a step", "of advance(1)", "Sample.reactions"):
        table.add_column(column, justify="left" if column == "scene" else "right")
    for name in options.scenes or sorted(example_scenes()):
        step, loop, array, named = costs(name, options.repeat)
        shares = f"{100 * array / step:.0f} %", f"{100 * array / loop:.0f} %"
        table.add_row(name, *(f"{x:.2f}" for x in (step, loop, array)), *shares, f"{named:.2f}")
    Console().print(table)


if __name__ == "__main__":
    main()
