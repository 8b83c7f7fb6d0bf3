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

NAMES = ("furuta", "four_bar", "arm", "gripper", "swing", "double", "slider_crank", "cart")
# Effects that models lack: key of a joint, or forces of the scene, with a size for each machine; None: not in it.
LACKING = {
    "dry friction of hinge": ("hinge", "friction: {coulomb: %g}", (0.01, 0.1, 0.3, 0.1, 0.01, 0.01, 2.0, 0.01)),
    "viscous friction of hinge": ("hinge", "friction: {viscous: %g}", (3e-3, 0.05, 0.2, 0.3, 5e-3, 3e-3, 2.0, 3e-3)),
    "rotor inertia of motor": (
        "motor",
        "rotor: {inertia: %g, ratio: 10}",
        (2e-5, 3e-5, 5e-4, 2e-5, None, 2e-5, 2e-5, None),
    ),
    "quadratic drag": ("DRAG", "angular_quadratic: %g", (5e-4, 0.02, 0.05, 2e-3, 5e-3, 1e-3, None, 1e-3)),
}
DRAGGED = ("rod", "rocker", "lower", "palm", "rod", "lower", None, "pole")  # body with drag
PAYLOADS = {
    "furuta": ("mass of rod", {"mass: 0.15": "mass: 0.18"}),
    "four_bar": ("mass of rocker", {"mass: 0.8": "mass: 0.95"}),
    "arm": ("mass of hand", {"mass: 0.3": "mass: 0.4"}),
    "gripper": ("mass of right", {"mass: 0.16": "mass: 0.2"}),
    "double": ("mass of lower", {"mass: 0.2}": "mass: 0.23}"}),
    "slider_crank": ("mass of slider", {"mass: 0.8": "mass: 0.9"}),
    "cart": ("mass of pole", {"mass: 0.2}": "mass: 0.22}"}),
}
# Numbers that vary, text of the machine, and true values.
VISCOUS = "hinge.friction.viscous"
VARIED = {
    "furuta": (
        ["arm.shape.mass", "rod.shape.mass"],
        {"mass: 0.4": "mass: 0.44", "mass: 0.15": "mass: 0.14"},
        (0.44, 0.14),
    ),
    "four_bar": (["rocker.shape.mass", "coupler.shape.mass"], {"mass: 0.8": "mass: 0.88"}, (0.88, 0.6)),
    "arm": (["lower.shape.mass", "hand.shape.mass"], {"mass: 1},": "mass: 1.1},"}, (1.1, 0.3)),
    "gripper": (["palm.shape.mass", "right.shape.mass"], {"mass: 0.8": "mass: 0.88"}, (0.88, 0.16)),
    "swing": ([VISCOUS, "rod.shape.length"], {"viscous: 0.003": "viscous: 0.004"}, (0.004, 0.6)),
    "double": ([VISCOUS, "lower.shape.mass"], {"mass: 0.2}": "mass: 0.21}"}, (0.003, 0.21)),
    "slider_crank": (["slider.shape.mass", "rod.shape.mass"], {"mass: 0.8": "mass: 0.85"}, (0.85, 0.5)),
    "cart": ([VISCOUS, "pole.shape.mass"], {"mass: 0.2}": "mass: 0.21}"}, (0.003, 0.21)),
}
LOG = {"seconds": 2.0, "rate": 250.0}


def named(case):
    """(machine, effect or None, whether it agrees, whether it is named, verdict, s) of a case; None: no such case."""
    name, effect, seed = case
    k, keys, force = NAMES.index(name), {}, ""
    if effect in LACKING:
        place, key, sizes = LACKING[effect]
        if sizes[k] is None:
            return None
        if place == "DRAG":
            force = f"forces: [{{name: drag, type: drag, body: {DRAGGED[k]}, {key % sizes[k]}}}]\n"
        else:
            keys = {place: key % sizes[k]}
    elif effect == "payload":
        if name not in PAYLOADS:
            return None
        effect, keys = PAYLOADS[name]
    true = scene_from_text(machine(name, **keys).text + force)
    log, began = log_of(true, name, seed, **LOG), time.perf_counter()
    found = compare(machine(name), log, workers=1)
    first = found.effects[0] if found.effects else None
    equal = [each.text for each in found.alone if first and each.share > 0.98 * first.share]
    is_named = not found.effects if effect is None else any(text.startswith(effect) for text in equal)
    return name, effect, found.agrees, is_named, found.verdict, time.perf_counter() - began


def covered(case):
    """(machine, z-scores of numbers and the delay, whether each interval holds, whether it agrees)."""
    name, seed = case
    names, texts, truth = VARIED[name]
    keys = {"hinge": "friction: {viscous: 0.003}"} if VISCOUS in names else {}
    found = identify(machine(name, **keys), log_of(machine(name, **keys, **texts), name, seed, **LOG), names, workers=1)
    delay, deviation = found.comparison.delays["/joint_states"]
    z = [*((found.values - truth) / found.deviations), (delay - DELAY) / deviation]
    return name, z, np.abs(z) < found.comparison.half_width, found.comparison.agrees


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
    parser.add_argument("--machines", nargs="+", default=list(VARIED), choices=NAMES)
    parser.add_argument("--parts", nargs="+", default=["named", "covered"], choices=("named", "covered"))
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
    cases = [(name, effect, seed) for seed in seeds for name in args.machines for effect in (None, *LACKING, "payload")]
    with Pool(args.jobs) as pool:
        rows = {}
        for found in pool.imap_unordered(named, cases if "named" in args.parts else ()):
            if found is None:
                continue
            name, effect, agrees, is_named, verdict, seconds = found
            row = rows.setdefault((name, effect or "nothing"), [0, 0, 0, []])
            row[0] += agrees
            row[1] += is_named
            row[2] += 1
            row[3].append(seconds)
            if not is_named:
                console.print(f"{name}, {effect}: {verdict}")
        table = Table("machine", "lacks", "agrees", "named", "median time, s")
        for (name, effect), (agrees, is_named, count, seconds) in sorted(rows.items()):
            table.add_row(name, effect, f"{agrees}", f"{is_named} of {count}", f"{np.median(seconds):.1f}")
        console.print(table)
        scores = {}
        cases = [(name, seed) for seed in seeds for name in args.machines]
        for name, *found in pool.imap_unordered(covered, cases if "covered" in args.parts else ()):
            scores.setdefault(name, []).append(found)
        table = Table("machine", "number", "intervals", "cover", "rms of z", "largest", "agree")
        for name, found in scores.items():
            z, holds, agrees = (np.array(each) for each in zip(*found))
            for k, number in enumerate([*VARIED[name][0], "delay"]):
                cover, rms = f"{100.0 * holds[:, k].mean():.1f} %", f"{np.sqrt((z[:, k] ** 2).mean()):.2f}"
                most = f"{np.abs(z[:, k]).max():.1f}"
                table.add_row(name, number, str(len(z)), cover, rms, most, f"{agrees.sum()}")
        console.print(table)


if __name__ == "__main__":
    main()
