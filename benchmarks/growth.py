# SPDX-License-Identifier: Apache-2.0
"""Growth of the cost of a step with the number of bodies, and memory allocated by steps.

    python benchmarks/growth.py [--quick] [--json FILE]

CPU us per step, in native loops, of chains of ball and of hinge joints that fall from rest: RK4 of
every code, and Exudyn's implicit method. Peers that are not installed are left out, and said so.
"""

import argparse
import json
import os
import tracemalloc

# Before Numba comes in: counting what its code allocates is off by default.
os.environ["NUMBA_NRT_STATS"] = "1"

from numba.core.runtime import rtsys  # noqa: E402
from rich.console import Console  # noqa: E402
from rich.table import Table  # noqa: E402
from side_by_side import load_peers, ours, problems  # noqa: E402
from side_by_side.measure import seconds_per_step  # noqa: E402

LINKS = (1, 10, 100, 1000)
# s. Exudyn's implicit method is made for larger steps, and solves more often in them.
STEP, IMPLICIT_STEP = 1e-4, 1e-3
# Largest chains. Beyond, the memory is gone (pinocchio: 200 balls take 8 GB, 300 take 27) or the
# time (mujoco: 1000 balls take 5 s per step). Exudyn's stepper knows balls only.
LARGEST = {
    ("pinocchio", "ball"): 100,
    ("pinocchio", "hinge"): 100,
    ("mujoco", "ball"): 100,
    ("exudyn", "hinge"): 0,
}


def microseconds(code, problem, shortest, rounds):
    """CPU time of one step, us."""
    step = IMPLICIT_STEP if code.CODE == "exudyn" else STEP
    return 1e6 * seconds_per_step(code.stepper(problem, step), shortest, rounds)


def allocations(take_steps, steps):
    """(allocations in compiled code, growth of traced Python memory in bytes) of `steps` steps."""
    take_steps(10)
    tracemalloc.start()
    before, kept = rtsys.get_allocation_stats().alloc, tracemalloc.get_traced_memory()[0]
    take_steps(steps)
    kept = tracemalloc.get_traced_memory()[0] - kept
    tracemalloc.stop()
    return rtsys.get_allocation_stats().alloc - before, kept


def main():
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="one short timing of each")
    parser.add_argument("--json", metavar="FILE", help="write all that was measured")
    options = parser.parse_args()
    shortest, rounds = (0.05, 1) if options.quick else (0.3, 5)
    console = Console(highlight=False, soft_wrap=True)
    codes = [ours, *load_peers(console)]
    ours.prepare()

    table = Table(title="Chains: CPU us per step")
    table.add_column("code")
    table.add_column("joints")
    for links in LINKS:
        table.add_column(str(links), justify="right")
    data = {"chains": {}}
    for code in codes:
        for kind in (problems.BALL, problems.HINGE):
            largest = LARGEST.get((code.CODE, kind), LINKS[-1])
            figures = {
                links: microseconds(code, problems.chain(links, kind), shortest, rounds)
                for links in LINKS
                if links <= largest
            }
            if figures:
                data["chains"][f"{code.CODE} {kind}"] = figures
                table.add_row(
                    code.CODE,
                    kind,
                    *(f"{figures[links]:.3g}" if links in figures else "-" for links in LINKS),
                )
    console.print(table)

    row = problems.windows(40)
    data["40 windows"] = microseconds(ours, row, shortest, rounds)
    console.print(
        f"{ours.CODE}, 40 four-bar windows in a row, {len(row.bodies)} bodies, "
        f"{len(row.tree + row.loops)} hinges: {data['40 windows']:.4g} us per step"
    )

    data["allocations"] = {}
    for problem in (problems.chain(100, problems.BALL), problems.four_bar()):
        take_steps = ours.stepper(problem, STEP)
        for steps in (100, 5_000):
            counted, kept = allocations(take_steps, steps)
            data["allocations"][f"{problem.title}, {steps} steps"] = (counted, kept)
            console.print(
                f"{problem.title}: {steps} steps in one call make {counted} allocations "
                f"and keep {kept} bytes"
            )
    if options.json:
        with open(options.json, "w", encoding="utf-8") as file:
            json.dump(data, file, indent=1)


if __name__ == "__main__":
    main()
