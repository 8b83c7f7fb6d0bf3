# SPDX-License-Identifier: Apache-2.0
"""Growth of the cost of a step with the number of bodies, and memory allocated by steps.

    python benchmarks/growth.py [--quick] [--group auto se3] [--json FILE]

CPU us per step, in native loops, of chains that fall from rest: RK4 of every code, and Exudyn's
implicit method. `ball` and `hinge` fall in a plane. In space, hinges are at random angles (as in S2)
and balls are pulled aside. Peers that are not installed are reported and omitted. For this package it
also prints the growth with the bodies, t ~ n^p, and rows of closed loops: planar windows and
spatial four-bars.
"""

import argparse
import json
import os
import sys
import tracemalloc

# Before Numba is imported: it counts allocations of compiled code only on request.
os.environ["NUMBA_NRT_STATS"] = "1"

import numpy as np  # noqa: E402
from numba.core.runtime import rtsys  # noqa: E402
from rich.console import Console  # noqa: E402
from rich.table import Table  # noqa: E402
from side_by_side import load_peers, ours, problems, spatial  # noqa: E402
from side_by_side.measure import seconds_per_step  # noqa: E402

LINKS = (1, 10, 100, 1000, 2000)
LOOPS = (1, 10, 40)
BALL, HINGE = problems.BALL, problems.HINGE
CHAINS = {
    "ball": (BALL, lambda links: problems.chain(links, BALL)),
    "hinge": (HINGE, lambda links: problems.chain(links, HINGE)),
    "ball in space": (BALL, lambda links: spatial.chain_in_space(links, BALL)),
    "hinge in space": (HINGE, lambda links: spatial.chain_in_space(links)),
}
ROWS = {"windows": problems.windows, "spatial four-bars": spatial.ladder}
# Smallest number of links for the fit: with fewer, the constant cost of a step dominates.
GROWING = 10
# s. Exudyn's implicit method is made for larger steps, with more iterations each.
STEP, IMPLICIT_STEP = 1e-4, 1e-3
# Largest chains of other codes. Longer ones need too much memory (pinocchio: 200 balls take 8 GB, 300 take
# 27) or time (mujoco: 1000 balls take 5 s per step). Exudyn's stepper supports balls only.
LARGEST_OTHER = 1000
LARGEST = {("pinocchio", "ball"): 100, ("pinocchio", "hinge"): 100, ("mujoco", "ball"): 100, ("exudyn", "hinge"): 0}


def microseconds(code, problem, shortest, rounds, **options):
    """CPU time of one step, us; None if this package has no such formulation for the problem."""
    step = IMPLICIT_STEP if code.CODE == "exudyn" else STEP
    try:
        take_steps = code.stepper(problem, step, **options)
    except ValueError:
        if not options:
            raise
        return None
    return 1e6 * seconds_per_step(take_steps, shortest, rounds)


def slope(figures):
    """Exponent p of the growth t ~ n^p of {bodies: us}, a least-squares fit from GROWING on."""
    points = [(np.log(n), np.log(t)) for n, t in figures.items() if n >= GROWING and t is not None]
    return float(np.polyfit(*zip(*points), 1)[0]) if len(points) > 1 else float("nan")


def shown(figures, counts):
    """Cells of a table for {count: us or None}."""
    values = [figures.get(n) for n in counts]
    return ["-" if t is None else f"{t:.3g}" if t < 100.0 else f"{t:.0f}" for t in values]


def allocations(take_steps, steps):
    """(allocations in compiled code, growth of traced Python memory in bytes) of `steps` steps."""
    take_steps(10)
    tracemalloc.start()
    before, kept = rtsys.get_allocation_stats().alloc, tracemalloc.get_traced_memory()[0]
    take_steps(steps)
    kept = tracemalloc.get_traced_memory()[0] - kept
    tracemalloc.stop()
    return rtsys.get_allocation_stats().alloc - before, kept


def chains(console, groups, peers, timing):
    """Measure and print chains: {code and joints: {bodies: us per step}}."""
    table = Table(title="Chains: CPU us per step")
    table.add_column("code")
    table.add_column("joints")
    for links in LINKS:
        table.add_column(str(links), justify="right")
    table.add_column(f"us/body at {LINKS[-1]}", justify="right")
    table.add_column("t ~ n^p", justify="right")
    data = {}
    codes = [(ours, {"group": group}) for group in groups] + [(peer, {}) for peer in peers]
    for code, options in codes:
        for name, (kind, make) in CHAINS.items():
            largest = LARGEST.get((code.CODE, kind), LINKS[-1] if options else LARGEST_OTHER)
            figures = {
                links: microseconds(code, make(links), *timing, **options) for links in LINKS if links <= largest
            }
            if not figures:
                continue
            words = " ".join([code.CODE, *options.values()])
            data[f"{words} {name}"] = figures
            last = figures.get(LINKS[-1])
            table.add_row(
                words,
                name,
                *shown(figures, LINKS),
                "-" if last is None else f"{last / LINKS[-1]:.3g}",
                f"{slope(figures):.2f}",
            )
    console.print(table)
    return data


def rows_of_loops(console, groups, timing):
    """Measure and print rows of closed loops in this package: {formulation and row: {loops: us per step}}."""
    table = Table(title="Rows of closed loops: CPU us per step")
    table.add_column("formulation")
    table.add_column("loops")
    for count in LOOPS:
        table.add_column(str(count), justify="right")
    table.add_column(f"us/loop at {LOOPS[-1]}", justify="right")
    table.add_column("t ~ n^p", justify="right")
    data = {}
    for group in groups:
        for name, make in ROWS.items():
            figures = {n: microseconds(ours, make(n), *timing, group=group) for n in LOOPS}
            data[f"{group} {name}"] = figures
            last = figures[LOOPS[-1]]
            table.add_row(
                group,
                name,
                *shown(figures, LOOPS),
                "-" if last is None else f"{last / LOOPS[-1]:.3g}",
                f"{slope(figures):.2f}",
            )
    console.print(table)
    return data


def main():
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="one short timing of each")
    parser.add_argument(
        "--group",
        nargs="+",
        choices=ours.GROUPS,
        default=["auto"],
        help="values of the option `group` of our method; several are compared",
    )
    parser.add_argument("--json", metavar="FILE", help="write all measurements")
    options = parser.parse_args()
    shortest, rounds = (0.05, 1) if options.quick else (0.3, 5)
    console = Console(width=None if sys.stdout.isatty() else 130, highlight=False)
    peers = load_peers(console)
    ours.prepare()
    groups = options.group
    timing = (shortest, rounds)
    data = {"chains": chains(console, groups, peers, timing)}
    data["loops"] = rows_of_loops(console, groups, timing)

    data["allocations"] = {}
    for problem in (problems.chain(100, problems.BALL), problems.four_bar()):
        take_steps = ours.stepper(problem, STEP)
        for steps in (100, 5_000):
            counted, kept = allocations(take_steps, steps)
            data["allocations"][f"{problem.title}, {steps} steps"] = (counted, kept)
            console.print(
                f"{problem.title}: {steps} steps in one call make {counted} allocations and keep {kept} bytes"
            )
    if options.json:
        with open(options.json, "w", encoding="utf-8") as file:
            json.dump(data, file, indent=1)


if __name__ == "__main__":
    main()
