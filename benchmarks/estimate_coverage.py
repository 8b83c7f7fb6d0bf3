# SPDX-License-Identifier: Apache-2.0
"""Coverage of the running error estimate: estimates compared with true errors, and their cost.

    python benchmarks/estimate_coverage.py [--random N] [--seed S] [--json FILE]

The example scenes and N random mechanisms (one to six bodies, all types of joints, loops, springs,
dampers, drag) are simulated for 2 s with two pushes at random times, in body and in world axes. The
true error is the distance from the independent reference integration, where the uncertainty of that is ten
times smaller. `under`: share of samples with an estimate below half of the true error; `over`: above ten
times. `wrong`: runs whose largest error so far is above 5 % of the motion while the largest estimate so far
is below half of it. `silent`: wrong runs without an earlier warning that the motion is not predictable, or not
within the accuracy. `kept`: runs to an accuracy whose true error is below the accuracy until their warning,
and the largest ratio of true error and accuracy. `false alarms`: warnings at a true error below 1e-6 of the
mechanism's size and rad; for runs to an accuracy, the median ratio of true error and accuracy at the warning.
"""

import argparse
import json
import logging
import sys
from multiprocessing import Pool
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from liegroup_core import Simulation, SimulationError, load_scene
from liegroup_core.errors import SceneError
from liegroup_core.reference import Reference, WrenchSpan
from liegroup_core.scene.description import Drag

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "test"))  # random mechanisms, true errors

import mechanisms  # noqa: E402
from true_error import distance_at  # noqa: E402

METHODS = {
    "rkmk4": (5e-4, 2e-3, 8e-3),
    "rkmk8": (2e-3, 5e-3, 2e-2),
    "rkmk54": (1e-3, 5e-3, 2e-2),
    "generalized_alpha": (5e-4, 2e-3, 8e-3),
    "constrained_rattle": (5e-4, 2e-3, 8e-3),
    "lie_midpoint": (5e-4, 2e-3, 8e-3),
    "radau5": (1e-3, 5e-3, 2e-2),
}
ACCURACIES = (1e-3, 1e-5, 1e-7)  # with the horizon DURATION
ACCURATE = "to an accuracy"
GRID = 0.02  # s, step of a simulation to an accuracy
DURATION, SAMPLES = 2.0, 50  # s; all samples lie on steps
SHORT = {"andrews_squeezer": 0.01}  # factor on DURATION and steps: a fast mechanism needs milliseconds
PARTS = ("position", "angle", "linear", "angular")  # columns of the estimate
NO_ALARM = 1e-6  # true error of a pose below which a warning is a false alarm
SMALLEST = 1e-11  # m, rad, m/s, rad/s: errors below are round-off


def random_scene(seed):
    """Random mechanism, or None if its loops do not fit."""
    rng = np.random.default_rng([seed, 3])
    names = "abcdef"[: rng.integers(1, 7)]
    links = []
    for i, name in enumerate(names):
        parent = "world" if i == 0 or rng.random() < 0.25 else names[rng.integers(i)]
        free = parent == "world" and rng.random() < 0.1
        links.append((parent, name, None if free else str(rng.choice(mechanisms.KINDS))))
    loops = []
    if len(names) > 2 and rng.random() < 0.3:
        loops = [(*rng.choice(list(names), 2, replace=False), "distance")]
    try:
        scene = mechanisms.mechanism(rng, links, springs=int(rng.integers(4)), loops=loops)
    except (SceneError, ValueError, np.linalg.LinAlgError):
        return None
    if rng.random() < 0.3:
        drag = Drag(name="drag", body=names[0], linear=0.3, angular=0.05)
        scene = scene.model_copy(update={"forces": (*scene.forces, drag)})
    return scene


def pushes(scene, scale, rng):
    """Two pushes of 5 % of the duration: [(body, wrench, start, duration, axes)]."""
    found = []
    for axes in ("body", "world"):
        body = scene.bodies[rng.integers(len(scene.bodies))]
        force = 5.0 * body.mass * rng.normal(size=3) / scale
        start = scale * DURATION * round(0.6 * rng.random(), 6)
        found.append((body.name, (0.0, 0.0, 0.0, *force), start, 0.05 * scale * DURATION, axes))
    return found


def compare(job):
    """[(method, step, stabilisation, ratios, wrong, silent, error relative to the accuracy)] of one scene."""
    logging.disable(logging.CRITICAL)
    name, seed, methods = job
    scene = load_scene(name) if seed is None else random_scene(seed)
    if scene is None:
        return name, []
    rng = np.random.default_rng([0 if seed is None else seed, 4, len(name)])
    scale = SHORT.get(name, 1.0)
    wrenches = pushes(scene, scale, rng)
    changes = [
        WrenchSpan(start, start + duration, body, wrench, axes) for body, wrench, start, duration, axes in wrenches
    ]
    times = np.linspace(0.0, scale * DURATION, SAMPLES + 1)[1:]
    try:
        start = Simulation(scene).state()
        exact, uncertainty = Reference(scene, *start, changes, end=times[-1]).at(times)
    except (SimulationError, SceneError, ValueError) as error:
        return name, [("reference", str(error))]
    size = motion_of(exact)
    results = []
    for method, steps in (*METHODS.items(), (ACCURATE, ACCURACIES)):
        for step in steps if method in methods else ():
            stabilisation = "none"
            if method.startswith("rkmk") and rng.random() < 0.5:
                stabilisation = "projection"
            try:
                if method == ACCURATE:
                    grid, horizon = scale * GRID, scale * DURATION
                    simulation = Simulation(scene, step=grid, accuracy=step, horizon=horizon)
                else:
                    simulation = Simulation(scene, method, scale * step, stabilisation=stabilisation)
            except ValueError:
                continue
            for body, wrench, at, duration, axes in wrenches:
                simulation.apply_wrench(body, wrench, at, duration, str(at), axes)
            results.append((method, step, stabilisation, *follow(simulation, times, exact, uncertainty, size)))
    return name, results


def motion_of(exact):
    """(4,) extent of a motion: largest change of position, rotation, and size of velocities."""
    moved = np.linalg.norm(exact.position - exact.position[:1], axis=2).max()
    turned = np.linalg.norm(exact.rotation - exact.rotation[:1], axis=(2, 3)).max()
    speeds = [np.linalg.norm(part, axis=2).max() for part in (exact.twist[..., 3:], exact.twist[..., :3])]
    return np.maximum([moved, turned, *speeds], 1e-12)


def follow(simulation, times, exact, uncertainty, size):
    """(ratios of estimate and true error, first wrong sample or None, whether silent, largest error relative
    to the accuracy, true error of a pose at the first sample after a warning, or infinity).
    """
    ratios, wrong, silent, promise, part = [], None, False, simulation.promise, 0.0
    at_warning, length = np.inf, simulation.layout.size
    largest_error, largest_estimate = np.zeros(4), np.zeros(4)
    for k, time in enumerate(times):
        try:
            simulation.advance(round(time / simulation.step) - simulation.steps)
        except SimulationError:
            break
        sample = simulation.sample()
        true = distance_at(sample, exact, k)
        error = np.stack([getattr(true, part) for part in PARTS], axis=1)
        unknown = np.stack([getattr(uncertainty, part)[k] for part in PARTS], axis=1)
        known = (error > np.maximum(10.0 * unknown, SMALLEST)) & ~np.isnan(sample.errors)
        ratios.append(sample.errors[known] / error[known])
        said = simulation.accurate_until if promise else simulation.predictable_until
        if said <= time and at_warning == np.inf:
            at_warning = float((error[:, :2] / (length, 1.0)).max())
        if promise and simulation.accurate_until > time:
            scaled = np.where(known, error, 0.0)[:, :2] / (promise["length"], 1.0)
            part = max(part, float(scaled.max()) / promise["accuracy"])
        largest_error = np.maximum(largest_error, np.where(known, error, 0.0).max(axis=0))
        largest_estimate = np.fmax(largest_estimate, sample.errors.max(axis=0))
        missed = (largest_error > 0.05 * size) & (largest_estimate < 0.5 * largest_error)
        if missed.any() and wrong is None:
            column = int(np.argmax(missed))
            ratio = float(largest_estimate[column] / largest_error[column])
            wrong = (float(time), PARTS[column], ratio)
            silent = not said <= time
    return np.concatenate(ratios) if ratios else np.zeros(0), wrong, silent, part, at_warning


def alarms(method, rows):
    """Text of the last column of the table."""
    said = [row for row in rows if row[8] < np.inf]
    if method == ACCURATE:
        return f"at {np.median([row[8] / row[2] for row in said] or [np.nan]):.2g} in {len(said)}"
    return f"{sum(row[8] < NO_ALARM for row in said)} of {len(said)}"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--random", type=int, default=500, help="number of random mechanisms")
    parser.add_argument("--seed", type=int, default=0, help="of the first one")
    parser.add_argument("--methods", nargs="+", default=[*METHODS, ACCURATE], help="only these")
    parser.add_argument("--json", help="file for all misses")
    args = parser.parse_args()
    scenes = sorted(path.stem for path in (ROOT / "config" / "scenes").glob("*.yaml"))
    jobs = [(name, None, args.methods) for name in scenes]
    jobs += [(f"random {seed}", seed, args.methods) for seed in range(args.seed, args.seed + args.random)]
    with Pool(2) as pool:
        found = list(pool.imap_unordered(compare, jobs))
    console = Console()
    table = Table(title=f"Running error: estimate over true error, {len(jobs)} mechanisms")
    for title in ("method", "runs", "samples", "under", "over", "median", "wrong", "silent", "false alarms"):
        table.add_column(title, justify="right")
    rows = [(name, *row) for name, rows in found for row in rows if len(row) == 8]
    wrong = [row for row in rows if row[5]]
    of_method = {method: [row for row in rows if row[1] == method] for method in METHODS}
    of_method["all methods"] = [row for mine in of_method.values() for row in mine]
    of_method[ACCURATE] = [row for row in rows if row[1] == ACCURATE]
    for method, mine in of_method.items():
        ratios = np.concatenate([row[4] for row in mine] or [np.zeros(0)])
        if not len(ratios):
            continue
        table.add_row(
            method,
            str(len(mine)),
            str(len(ratios)),
            f"{100 * np.mean(ratios < 0.5):.2f} %",
            f"{100 * np.mean(ratios > 10.0):.2f} %",
            f"{np.median(ratios):.2f}",
            str(sum(bool(row[5]) for row in mine)),
            str(sum(row[6] for row in mine)),
            alarms(method, mine),
        )
    console.print(table)
    unknown = [name for name, rows in found if not rows or rows[0][0] == "reference"]
    console.print(f"without a reference or refused: {len(unknown)} mechanisms")
    parts = np.array([row[7] for row in rows if row[1] == ACCURATE] or [0.0])
    console.print(f"accuracy kept: {np.mean(parts <= 1.0):.4f} of {len(parts)} runs, largest part {parts.max():.3g}")
    for row in rows:
        if row[7] > 1.0:
            console.print(f"not kept: {row[0]}, {row[2]:g}: {row[7]:.3g} times")
    for name, method, step, stabilisation, _, misses, unsaid, *_ in wrong:
        kind = "silent" if unsaid else "wrong"
        console.print(f"{kind}: {name}, {method}, {step:g} s, {stabilisation}: {misses}")
    if args.json:
        misses = [
            [*row[:4], float(np.mean(row[4] < 0.5)), float(np.mean(row[4] > 10.0)), row[5]]
            for row in rows
            if len(row[4])
        ]
        Path(args.json).write_text(json.dumps(misses))


if __name__ == "__main__":
    main()
