# SPDX-License-Identifier: Apache-2.0
"""Logs of simulated machines: is what a model lacks named, and do 95 % intervals cover the truth?

    python benchmarks/identification.py [--seeds 10] [--jobs 2]

Machines and logs are those of test/machine_logs.py: random inputs, noise, a clock that is late by 4 ms, lost messages,
a start that is not given. Where two effects are the same in a machine (the mass of the Furuta arm is a rotor), both
must be named.
"""

import argparse
import sys
import time
from multiprocessing import Pool
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "test"))  # machines and their logs

from machine_logs import DELAY, log_of, machine  # noqa: E402

from liegroup_core.identification import compare, identify  # noqa: E402

SIZES = {
    "dry friction of hinge": ("hinge", "friction: {coulomb: %g}", {"furuta": 0.01, "four_bar": 0.1, "arm": 0.3}),
    "viscous friction of hinge": ("hinge", "friction: {viscous: %g}", {"furuta": 0.003, "four_bar": 0.05, "arm": 0.2}),
    "rotor inertia of motor": (
        "motor",
        "rotor: {inertia: %g, ratio: 10}",
        {"furuta": 2e-5, "four_bar": 3e-5, "arm": 5e-4},
    ),
}
PAYLOADS = {
    "furuta": ("mass of rod", {"mass: 0.15": "mass: 0.18"}),
    "four_bar": ("mass of rocker", {"mass: 0.8": "mass: 0.95"}),
    "arm": ("mass of hand", {"mass: 0.3": "mass: 0.4"}),
}
VARIED = {
    "furuta": (
        ["arm.shape.mass", "rod.shape.mass"],
        {"mass: 0.4": "mass: 0.44", "mass: 0.15": "mass: 0.14"},
        (0.44, 0.14),
    ),
    "four_bar": (["rocker.shape.mass", "coupler.shape.mass"], {"mass: 0.8": "mass: 0.88"}, (0.88, 0.6)),
    "arm": (["lower.shape.mass", "hand.shape.mass"], {"mass: 1},": "mass: 1.1},"}, (1.1, 0.3)),
}
LOG = {"seconds": 2.0, "rate": 250.0}


def named(case):
    """(machine, effect or None, whether it is named, s) of a case."""
    name, effect, seed = case
    keys = {}
    if effect in SIZES:
        joint, key, sizes = SIZES[effect]
        keys = {joint: key % sizes[name]}
    elif effect == "payload":
        effect, keys = PAYLOADS[name]
    log, began = log_of(machine(name, **keys), name, seed, **LOG), time.perf_counter()
    found = compare(machine(name), log, workers=1)
    if effect is None:
        right = found.agrees
    else:
        first = found.effects[0] if found.effects else None
        equal = [each.text for each in found.alone if first and each.share > 0.98 * first.share]
        right = effect in equal
    return name, effect, right, found.verdict, time.perf_counter() - began


def covered(case):
    """(machine, z-scores of numbers and the delay)."""
    name, seed = case
    names, texts, truth = VARIED[name]
    found = identify(machine(name), log_of(machine(name, **texts), name, seed, **LOG), names, workers=1)
    delay, deviation = found.comparison.delays["/joint_states"]
    return name, [*((found.values - truth) / found.deviations), (delay - DELAY) / deviation]


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--first", type=int, default=100)
    parser.add_argument("--machines", nargs="+", default=list(VARIED), choices=list(VARIED))
    args = parser.parse_args()
    seeds, console = range(args.first, args.first + args.seeds), Console(width=200)
    cases = [(name, effect, seed) for name in args.machines for effect in (None, *SIZES, "payload") for seed in seeds]
    with Pool(args.jobs) as pool:
        rows = {}
        for name, effect, right, verdict, seconds in pool.imap_unordered(named, cases):
            row = rows.setdefault((name, effect or "nothing"), [0, 0, []])
            row[0] += right
            row[1] += 1
            row[2].append(seconds)
            if not right:
                console.print(f"{name}, {effect}: {verdict}")
        table = Table("machine", "lacks", "named", "median time, s")
        for (name, effect), (right, count, seconds) in sorted(rows.items()):
            table.add_row(name, effect, f"{right} of {count}", f"{np.median(seconds):.1f}")
        console.print(table)
        scores = {}
        for name, z in pool.imap_unordered(covered, [(name, seed) for name in args.machines for seed in seeds]):
            scores.setdefault(name, []).append(z)
        table = Table("machine", "intervals", "cover", "rms of z", "largest")
        for name, z in scores.items():
            z = np.array(z)
            table.add_row(
                name,
                str(z.size),
                f"{100.0 * (np.abs(z) < 1.96).mean():.1f} %",
                f"{np.sqrt((z**2).mean()):.2f}",
                f"{np.abs(z).max():.1f}",
            )
        console.print(table)


if __name__ == "__main__":
    main()
