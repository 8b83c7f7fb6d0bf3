# SPDX-License-Identifier: Apache-2.0
"""Published robots compared with Pinocchio and MuJoCo: cost of a step, and of a given true accuracy.

    python benchmarks/robot_cost.py [--quick] [--only UR5 Talos ...] [--steps-only] [--json FILE]

First a step of RKMK4 in relative coordinates and of RK4 in the other codes, each in a native loop, all
in turn, round by round. Then the cheapest configuration of each code for errors of 1e-3, 1e-6 and
1e-9 after a fall, as in peers.py. No code estimates its error. The robots are those of
side_by_side/published.py; packages that are not installed are reported and omitted.
"""

import argparse
import json
import statistics
import sys
import time

from peers import measure
from rich.console import Console
from rich.table import Table
from side_by_side import load_peers, ours, published
from side_by_side.report import as_data, costs_table, shortfalls

STEP = 1e-4  # s; the cost of a step does not depend on it
SECONDS = 0.1  # CPU time of a timing
ROUNDS = 9
# Seconds of the fall. The fall of Talos is chaotic: its end state is known to 1e-11 only up to half a second.
# Without springs Cassie's legs come near a singular pose at 0.36 s.
DURATIONS = {"Talos": 0.5, "Cassie, free": 0.3}


def step_costs(problem, codes):
    """{code: median CPU s of a step}, timed in turn."""
    steppers = {code.CODE: code.stepper(problem, STEP, *(["relative"] if code is ours else [])) for code in codes}
    times = {name: [] for name in steppers}
    counts = dict.fromkeys(steppers, 0)
    for name, take in steppers.items():
        count, taken = 10, 0.0
        while taken < 0.2 * SECONDS:
            count *= 2
            start = time.process_time()
            take(count)
            taken = time.process_time() - start
        counts[name] = max(1, round(count * SECONDS / taken))
    for _ in range(ROUNDS):
        for name, take in steppers.items():
            start = time.process_time()
            take(counts[name])
            times[name].append((time.process_time() - start) / counts[name])
    return {name: statistics.median(values) for name, values in times.items()}


def steps_table(costs):
    """Table of the costs of a step; costs: {robot: {code: s}}."""
    codes = list(next(iter(costs.values())))
    table = Table(title="CPU us per step of RKMK4 (RK4 of the others)", title_justify="left")
    for head in ("robot", *codes, "best of the others / ours"):
        table.add_column(head)
    for robot, row in costs.items():
        others = [cost for code, cost in row.items() if code != ours.CODE]
        ratio = f"{min(others) / row[ours.CODE]:.2f}" if others else "-"
        table.add_row(robot, *(f"{1e6 * row[code]:.2f}" for code in codes), ratio)
    return table


def main():
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="coarser ladders, fewer rounds")
    parser.add_argument("--only", nargs="+", metavar="ROBOT", help="first letters of robots' names")
    parser.add_argument("--steps-only", action="store_true", help="no cost of an accuracy")
    parser.add_argument("--json", metavar="FILE", help="write all measurements")
    options = parser.parse_args()
    ratio, budget, rounds = (2.0, 1.0, 3) if options.quick else (1.5, 5.0, 7)
    console = Console(width=None if sys.stdout.isatty() else 130, highlight=False)
    # Exudyn's kinematic trees are slower than both on all robots of peers.py.
    peers = [code for code in load_peers(console) if code.CODE != "exudyn"]
    names = [name for name in published.FILES if not options.only or name.startswith(tuple(options.only))]
    missing = [name for name in names if published.path_of(name) is None]
    if missing:
        console.print(f"Omitted, example-robot-data is not installed: {', '.join(missing)}")
    ours.prepare()
    problems = {name: published.problem_of(name, DURATIONS.get(name, 1.0)) for name in names if name not in missing}
    steps = {name: step_costs(problem, [ours, *peers]) for name, problem in problems.items()}
    if steps:
        console.print(steps_table(steps))
    data, missed = {"steps": steps}, []
    for name, problem in problems.items():
        if options.steps_only:
            continue
        results, known = measure([problem], peers, ["auto"], ratio, budget, rounds)
        console.print(costs_table(name, problem, results))
        console.print(f"exact end known to {known:.0e}\n")
        missed += shortfalls(name, problem, results)
        data[name] = as_data(problem, results) | {"exact_known_to": float(known)}
    for sentence in missed:
        console.print(f"* {sentence}", soft_wrap=True)
    if options.json:
        with open(options.json, "w", encoding="utf-8") as file:
            json.dump(data, file, indent=1)
    return 0


if __name__ == "__main__":
    sys.exit(main())
