# SPDX-License-Identifier: Apache-2.0
"""Logs of simulated machines: is what a model lacks named, do 95 % intervals cover the truth, and what does it cost?

    python benchmarks/identification.py [--seeds 10] [--jobs 2]
    python benchmarks/identification.py --cost 3 10 30

--cost: wall time of `identify` for 14 numbers (masses and dampings) of an arm with seven axes, from so many seconds of
a log at 500 Hz, and the largest error of a number by its standard deviation.

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

from liegroup_core import Simulation  # noqa: E402
from liegroup_core.identification import Given, Log, Measured, compare, identify  # noqa: E402
from liegroup_core.scene.load import scene_from_text  # noqa: E402

SIZES = {
    "dry friction of hinge": (
        "hinge",
        "friction: {coulomb: %g}",
        {"furuta": 0.01, "four_bar": 0.1, "arm": 0.3, "gripper": 0.1},
    ),
    "viscous friction of hinge": (
        "hinge",
        "friction: {viscous: %g}",
        {"furuta": 0.003, "four_bar": 0.05, "arm": 0.2, "gripper": 0.3},
    ),
    "rotor inertia of motor": (
        "motor",
        "rotor: {inertia: %g, ratio: 10}",
        {"furuta": 2e-5, "four_bar": 3e-5, "arm": 5e-4, "gripper": 2e-5},
    ),
}
PAYLOADS = {
    "furuta": ("mass of rod", {"mass: 0.15": "mass: 0.18"}),
    "four_bar": ("mass of rocker", {"mass: 0.8": "mass: 0.95"}),
    "arm": ("mass of hand", {"mass: 0.3": "mass: 0.4"}),
    "gripper": ("mass of right", {"mass: 0.16": "mass: 0.2"}),
}
VARIED = {
    "furuta": (
        ["arm.shape.mass", "rod.shape.mass"],
        {"mass: 0.4": "mass: 0.44", "mass: 0.15": "mass: 0.14"},
        (0.44, 0.14),
    ),
    "four_bar": (["rocker.shape.mass", "coupler.shape.mass"], {"mass: 0.8": "mass: 0.88"}, (0.88, 0.6)),
    "arm": (["lower.shape.mass", "hand.shape.mass"], {"mass: 1},": "mass: 1.1},"}, (1.1, 0.3)),
    "gripper": (["palm.shape.mass", "right.shape.mass"], {"mass: 0.8": "mass: 0.88"}, (0.88, 0.16)),
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


AXES, RATE = 7, 500.0  # of the arm whose cost is measured, Hz of its log
LENGTHS, MASSES = (0.2, 0.2, 0.25, 0.2, 0.2, 0.15, 0.1), (3.0, 3.0, 2.5, 2.0, 1.5, 1.0, 0.5)  # m, kg
STIFFNESS = np.array([300.0, 300.0, 200.0, 200.0, 100.0, 60.0, 30.0])  # N m/rad, of the controller


def axes(mass=1.0, damping=0.5):
    """Scene of the arm; mass: factor of the four links at its end; damping : N m s/rad."""
    bodies, joints, z = [], [], 0.0
    for k, (length, m) in enumerate(zip(LENGTHS, MASSES)):
        axis, parent = ("[0, 1, 0]" if k % 2 else "[0, 0, 1]"), f"l{k - 1}" if k else "world"
        bodies.append(
            f"  - {{name: l{k}, mass: {m * mass if k > 2 else m}, inertia: [{0.01 * m}, {0.011 * m}, {0.005 * m}],"
            f" com: [0.01, 0.005, {length / 2}], position: [0, 0, {z:.3f}]}}"
        )
        joints.append(
            f"  - {{name: j{k}, type: revolute, parent: {parent}, child: l{k}, child_frame: {{axis: {axis}}},"
            f" parent_frame: {{position: [0, 0, {LENGTHS[k - 1] if k else 0.0}], axis: {axis}}},"
            f" rotor: {{inertia: 1.0e-5, ratio: 50}}}}"
        )
        z += length
    forces = [
        f"  - {{name: d{k}, type: torsional_spring_damper, joint: j{k}, stiffness: 0, damping: {damping}}}"
        for k in range(AXES)
    ]
    parts = "\n".join(["bodies:", *bodies, "joints:", *joints, "forces:", *forces])
    return scene_from_text(f"name: axes\ngravity: [0, 0, -9.81]\n{parts}\n")


def log_of_axes(seconds):
    """Log of the arm that a controller moves along sums of sines; clocks of measurements are late by 3 ms."""
    simulation = Simulation(axes(1.05, 0.55), "rkmk4", 0.5 / RATE, estimate=False, quiet=True)
    rng, count = np.random.default_rng(0), int(seconds * RATE)
    sizes, rates, phases = (rng.uniform(low, high, (AXES, 3)) for low, high in ((0.2, 0.5), (1, 6), (0, 6)))
    at, efforts, states = np.arange(count) / RATE, np.zeros((count, AXES)), np.zeros((count, AXES, 2))
    for k, t in enumerate(at):
        states[k] = [simulation.sample().joint_coordinates[f"j{j}"] for j in range(AXES)]
        wanted = min(1.0, t) * (sizes * np.sin(rates * t + phases)).sum(axis=1)
        efforts[k] = STIFFNESS * (wanted - states[k, :, 0] - 0.1 * states[k, :, 1])
        for j, effort in enumerate(efforts[k].tolist()):
            simulation.apply_effort(f"j{j}", effort)
        simulation.advance(2)
    channels = tuple(f"j{j}.{part}" for j in range(AXES) for part in ("position", "velocity"))
    sigma = np.tile([2e-4, 5e-3], AXES)
    values = states.reshape(count, -1) + sigma * rng.standard_normal((count, 2 * AXES))
    inputs = tuple(Given(f"j{j}.effort", at, efforts[:, j]) for j in range(AXES))
    measured = Measured("/joint_states", at[10:] + 0.003, channels, values[10:], np.full(2 * AXES, np.nan))
    return Log(inputs, (measured,))


def cost(seconds, jobs):
    """(s of wall time, largest error of a number by its deviation) of 14 numbers of the arm."""
    log = log_of_axes(seconds)
    names = [f"bodies.l{k}.mass" for k in range(AXES)] + [f"forces.d{k}.damping" for k in range(AXES)]
    began = time.perf_counter()
    found = identify(axes(), log, names, workers=jobs)
    spent = time.perf_counter() - began
    truth = [m * 1.05 if k > 2 else m for k, m in enumerate(MASSES)] + [0.55] * AXES
    return spent, np.abs((found.values - truth) / found.deviations).max()


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--first", type=int, default=100)
    parser.add_argument("--machines", nargs="+", default=list(VARIED), choices=list(VARIED))
    parser.add_argument("--cost", type=float, nargs="+", metavar="S")
    args = parser.parse_args()
    if args.cost:
        table = Table("log, s", "time, s", "largest z")
        for seconds in args.cost:
            spent, largest = cost(seconds, args.jobs)
            table.add_row(f"{seconds:g}", f"{spent:.1f}", f"{largest:.1f}")
        Console().print(table)
        return
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
