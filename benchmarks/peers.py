# SPDX-License-Identifier: Apache-2.0
"""Comparison with MuJoCo, Pinocchio and Exudyn: cost of a given true accuracy.

    python benchmarks/peers.py [--quick] [--only P1 S3 ...] [--group auto se3] [--json FILE]

P1..P4 are planar or have one body (side_by_side/problems.py), S1..S5 are mechanisms in space
(spatial.py), S6..S8 robots (robots.py). Their exact end states come from references.py and, in space,
mechanism_reference.py. Every code runs in a native loop, on one core, in one process. Pinocchio's
loop is compiled here if there is a C++ compiler. Packages that are not installed are reported and
omitted: pip install '.[bench]'.
"""

import argparse
import json
import os
import platform
import sys
import time
from importlib.metadata import version

import numpy as np
from rich.console import Console
from side_by_side import load_peers, ours, problems, robots, spatial
from side_by_side.measure import TARGETS, climb, cost_at, time_ladders
from side_by_side.report import as_data, costs_table, shortfalls

# Entries up to this cost, relative to the cheapest one, are also measured with the estimate of their error.
CLOSE = 1.2


def cases():
    """{name: function that makes the variants of a problem with the same exact end state}."""
    chains = {
        f"P4 N={links}": lambda links=links: [
            problems.chain(links, problems.HINGE),
            problems.chain(links, problems.BALL),
        ]
        for links in (10, 100)
    }
    return {
        "P1": lambda: [problems.heavy_top()],
        "P2": lambda: [problems.free_body()],
        "P3": lambda: [problems.four_bar()],
        **chains,
        "S1": lambda: [spatial.arm()],
        "S2": lambda: [spatial.chain_in_space(10)],
        "S3": lambda: [spatial.chain_in_space(100)],
        "S4": lambda: [spatial.four_bar_in_space()],
        "S5": lambda: [spatial.stewart()],
        "S6": lambda: [robots.humanoid()],
        "S7": lambda: [robots.delta()],
        "S8": lambda: [robots.crane()],
    }


def measure(variants, codes, groups, ratio, budget, rounds):
    """([(entry, rungs, {target: cost})] of all codes, uncertainty of the exact end state).

    groups : values of the option `group` of our methods
    """
    exact = variants[0].exact(1)
    known = np.abs(exact - variants[0].exact(0)).max()
    entries, ladders = [], []

    def run(entry, problem):
        entries.append(entry)
        ladders.append(climb(entry, problem, exact, budget))

    for problem in variants:
        before = len(entries)
        for entry in ours.entries(problem, ratio, groups):
            run(entry, problem)
        for entry in promising(entries[before:], ladders[before:]):
            run(ours.estimating(entry), problem)
        for code in codes:
            for entry in code.entries(problem, ratio):
                run(entry, problem)
    time_ladders(ladders, variants[0].duration, rounds)
    return [
        (entry, rungs, {target: cost_at(rungs, target) for target in TARGETS}) for entry, rungs in zip(entries, ladders)
    ], known


def promising(entries, ladders):
    """Entries that may be the cheapest for a target, judged by the cost of their first runs."""
    chosen = {}
    for target in TARGETS:
        costs = {entry: met.cost for entry, rungs in zip(entries, ladders) if (met := cost_at(rungs, target))}
        chosen |= {e: None for e, cost in costs.items() if cost <= CLOSE * min(costs.values())}
    return list(chosen)


def main():
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="coarser ladders, fewer rounds, no run above a second")
    parser.add_argument("--only", nargs="+", metavar="P", help="first words of a problem's name: P1..S8")
    parser.add_argument(
        "--group",
        nargs="+",
        choices=ours.GROUPS,
        default=["auto"],
        help="values of the option `group` of our methods; several are compared",
    )
    parser.add_argument("--json", metavar="FILE", help="write all measurements")
    options = parser.parse_args()
    ratio, budget, rounds = (2.0, 1.0, 3) if options.quick else (1.5, 10.0, 7)

    console = Console(width=None if sys.stdout.isatty() else 130, highlight=False)
    peers = load_peers(console)
    versions = {name: version(name) for name in ("numba", "numpy")} | {peer.CODE: peer.version() for peer in peers}
    machine = {
        "processor": platform.processor() or platform.machine(),
        "cores": os.cpu_count(),
        "load": os.getloadavg()[0],
        "python": platform.python_version(),
    }
    console.print(", ".join(f"{key} {value}" for key, value in (versions | machine).items()), soft_wrap=True)

    ours.prepare()
    groups = options.group
    data, missed, start = {}, [], time.perf_counter()
    for name, make in cases().items():
        if options.only and not any(f"{name} ".startswith(f"{only} ") for only in options.only):
            continue
        variants = make()
        problem = variants[0]
        results, known = measure(variants, peers, groups, ratio, budget, rounds)
        console.print(costs_table(name, problem, results))
        console.print(f"exact end known to {known:.0e}; {time.perf_counter() - start:.0f} s so far\n")
        missed += shortfalls(name, problem, results)
        data[name] = as_data(problem, results) | {"exact_known_to": float(known)}
    console.print("[bold]Where we fall short[/bold]" if missed else "Every target is met.")
    for sentence in missed:
        console.print(f"* {sentence}", soft_wrap=True)
    if options.json:
        with open(options.json, "w", encoding="utf-8") as file:
            json.dump({"versions": versions, "machine": machine, "problems": data}, file, indent=1)


if __name__ == "__main__":
    main()
