# SPDX-License-Identifier: Apache-2.0
"""Comparison with MuJoCo, Pinocchio and Exudyn: cost of a given true accuracy.

    python benchmarks/peers.py [--quick] [--only P1 P3 ...] [--json FILE]

Four problems with exact ends (side_by_side/problems.py, references.py); every code in a native
loop, on one core, in one process. Pinocchio's loop is compiled here if there is a C++ compiler.
Packages that are not installed are reported and omitted: pip install '.[bench]'.
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
from side_by_side import load_peers, ours, problems
from side_by_side.measure import TARGETS, climb, cost_at, time_ladders
from side_by_side.report import as_data, costs_table, shortfalls


def cases():
    """{name: variants of a problem with the same exact end state}."""
    return {
        "P1": [problems.heavy_top()],
        "P2": [problems.free_body()],
        "P3": [problems.four_bar()],
        **{
            f"P4 N={links}": [
                problems.chain(links, problems.HINGE),
                problems.chain(links, problems.BALL),
            ]
            for links in (10, 100)
        },
    }


def measure(variants, codes, ratio, budget, rounds):
    """([(entry, rungs, {target: cost})] of all codes, uncertainty of the exact end state)."""
    exact = variants[0].exact(1)
    known = np.abs(exact - variants[0].exact(0)).max()
    entries, ladders = [], []
    for problem in variants:
        for code in codes:
            for entry in code.entries(problem, ratio):
                entries.append(entry)
                ladders.append(climb(entry, problem, exact, budget))
    time_ladders(ladders, variants[0].duration, rounds)
    return [
        (entry, rungs, {target: cost_at(rungs, target) for target in TARGETS})
        for entry, rungs in zip(entries, ladders)
    ], known


def main():
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--quick", action="store_true", help="coarser ladders, fewer rounds, no run above a second"
    )
    parser.add_argument("--only", nargs="+", metavar="P", help="begin of a problem's name: P1..P4")
    parser.add_argument("--json", metavar="FILE", help="write all that was measured")
    options = parser.parse_args()
    ratio, budget, rounds = (2.0, 1.0, 3) if options.quick else (1.5, 10.0, 7)

    console = Console(width=None if sys.stdout.isatty() else 130, highlight=False)
    peers = load_peers(console)
    versions = {name: version(name) for name in ("numba", "numpy")} | {
        peer.CODE: peer.version() for peer in peers
    }
    machine = {
        "processor": platform.processor() or platform.machine(),
        "cores": os.cpu_count(),
        "load": os.getloadavg()[0],
        "python": platform.python_version(),
    }
    console.print(
        ", ".join(f"{key} {value}" for key, value in (versions | machine).items()), soft_wrap=True
    )

    ours.prepare()
    data, missed, start = {}, [], time.perf_counter()
    for name, variants in cases().items():
        if options.only and not name.startswith(tuple(options.only)):
            continue
        results, known = measure(variants, [ours, *peers], ratio, budget, rounds)
        problem = variants[0]
        console.print(costs_table(name, problem.title, problem.duration, results))
        console.print(
            f"exact end known to {known:.0e}; {time.perf_counter() - start:.0f} s so far\n"
        )
        missed += shortfalls(name, results)
        data[name] = as_data(results) | {"exact_known_to": float(known)}
    console.print("[bold]Where we fall short[/bold]" if missed else "Every target is met.")
    for sentence in missed:
        console.print(f"* {sentence}", soft_wrap=True)
    if options.json:
        with open(options.json, "w", encoding="utf-8") as file:
            json.dump({"versions": versions, "machine": machine, "problems": data}, file, indent=1)


if __name__ == "__main__":
    main()
