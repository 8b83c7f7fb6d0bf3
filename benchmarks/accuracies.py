# SPDX-License-Identifier: Apache-2.0
"""Requested accuracies compared with true errors, and CPU time, with random applied wrenches.

    python -P benchmarks/accuracies.py [--only SCENE ...] [--accuracies A ...] [--horizons S ...]
                                       [--budget S] [--seed N] [--json FILE]

Every scene is simulated to every accuracy over every horizon, with six pushes in body and in world
axes at random times, of random durations. Errors are the larger of position error / size of the
mechanism and attitude error in rad, at 50 times.

Two fine runs, `rkmk853` and `rkmk54` at a tolerance of 1e-13, give the true motion. Their distance is its
uncertainty. Only samples with an uncertainty below a tenth of the accuracy count.
For the shortest horizon the first run is also compared with the integration that shares no code with
the engine (liegroup_core.reference).

Steps of the simulations to an accuracy are at most a fiftieth of the horizon.

`compared`: end of the comparison: the end of the run, the last time at which the run reports an error within
the accuracy (said), the last time of a known true motion (unknown), or the time limit (budget). `true`:
largest true error until then; `estimate`: that of the run. Fixed configurations, without an estimate, are
`rkmk4` and `rkmk8` with steps from a fiftieth of the horizon down, and `rkmk54` and `rkmk853` with tolerances
from 1e-2 down. Cheapest: the choice of `trade`, where its errors and those of the next two finer ones stay
below a third of the accuracy. Least: the cheapest one whose errors stay below the accuracy; finding it requires
the true motion. CPU times are per simulated second, the fastest of three runs if they are short.
"""

import argparse
import json
import logging
import math
import sys
import time
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from liegroup_core import Simulation, SimulationError, load_scene
from liegroup_core.reference import Reference, Trajectory, WrenchSpan, distance
from liegroup_core.study.trade.trade import MARGIN, SETTLING

ROOT = Path(__file__).resolve().parents[1]
ACCURACIES, HORIZONS = (1e-3, 1e-6, 1e-9), (1.0, 10.0, 100.0)
SHORT = {"andrews_squeezer": 0.01}  # factor on the horizons: a fast mechanism needs milliseconds
SAMPLES, PUSHES = 50, 6
TIGHT = 1e-13  # tolerance of the two fine runs
KNOWN = 0.1  # largest uncertainty of a sample that counts, relative to the accuracy
LOST = 1e-2  # distance at which the two fine runs end
PARTS = (1, 2, 4, 10, 20, 40, 100, 200, 400, 1000, 2000, 4000)  # steps in a fiftieth of the horizon
TOLERANCES = tuple(10.0**-k for k in range(2, 14))
FIXED = {"rkmk4": "step", "rkmk8": "step", "rkmk54": "tolerance", "rkmk853": "tolerance"}
CHECKPOINT = 8  # steps between two error estimates of a simulation to an accuracy
FINER = 8.0  # upper bound of the relative cost of the next two finer configurations
REPEATED = 0.2  # s: shorter runs are measured three times


def random_pushes(scene, size, horizon, rng):
    """[(body, wrench, start, duration, axes)]: each changes velocities by a third of sqrt(g size)."""
    found = []
    for k in range(PUSHES):
        body = scene.bodies[rng.integers(len(scene.bodies))]
        duration = round(horizon * float(0.01 * 10.0 ** rng.random()), 9)  # whole nanoseconds
        force = body.mass * math.sqrt(9.81 * size) / (3.0 * duration) * rng.normal(size=3)
        torque = 0.1 * size * np.linalg.norm(force) * rng.normal(size=3)
        start = round(horizon * float(0.85 * rng.random()), 9)
        axes = ("body", "world")[k % 2]
        found.append((body.name, (*torque.tolist(), *force.tolist()), start, duration, axes))
    return found


class Run:
    """Simulation with pushes, advanced from sample to sample; `cpu` is in s."""

    def __init__(self, scene, pushes, **settings):
        self.simulation = Simulation(scene, quiet=True, **settings)
        for k, (body, wrench, start, duration, axes) in enumerate(pushes):
            self.simulation.apply_wrench(body, wrench, start, duration, f"push{k}", axes)
        self.cpu = 0.0

    def state_at(self, at):
        """Trajectory of one time in s."""
        simulation = self.simulation
        steps = round(at / simulation.step) - simulation.steps
        began = time.thread_time()
        simulation.advance(steps)
        self.cpu += time.thread_time() - began
        pose, twist = simulation.at_bodies()
        n = len(pose)
        rotation, position = pose[None, :, :9].reshape(1, n, 3, 3), pose[None, :, 9:]
        return Trajectory(None, rotation.copy(), position.copy(), twist[None].copy())


def apart(one, other, size):
    """Distance of two states as one number, relative to the size or in rad."""
    found = distance(one, other)
    return float(max(found.position.max() / size, found.angle.max()))


def true_motion(scene, pushes, times, size, stabilisation, step, budget):
    """(states, uncertainties) at the first of the times, as long as they are known."""
    settings = {"step": step, "stabilisation": stabilisation, "rtol": TIGHT, "atol": TIGHT}
    fine, other = (Run(scene, pushes, method=method, estimate=False, **settings) for method in ("rkmk853", "rkmk54"))
    states, unknown, largest = [], [], 0.0
    for at in times:
        try:
            states.append(fine.state_at(at))
            largest = max(largest, apart(states[-1], other.state_at(at), size))
        except SimulationError:
            break
        if largest > LOST:
            break
        unknown.append(largest)
        if fine.cpu + other.cpu > budget:
            break
    return states[: len(unknown)], np.array(unknown)


def independent(scene, pushes, times, states, size):
    """Largest distance of the states from the integration that shares no code; None: not available."""
    spans = [
        WrenchSpan(start, start + duration, body, tuple(wrench), axes) for body, wrench, start, duration, axes in pushes
    ]
    try:
        start = Simulation(scene, quiet=True).state()
        exact, _ = Reference(scene, *start, spans, end=times[-1]).at(np.array(times))
    except (SimulationError, ValueError):
        return None
    return max(
        apart(state, Trajectory(None, *(part[k : k + 1] for part in exact[1:])), size) for k, state in enumerate(states)
    )


def keep(scene, pushes, times, truth, size, accuracy, horizon, budget):
    """Results of a simulation to an accuracy, with the number of compared samples."""
    states, unknown = truth
    run = Run(scene, pushes, accuracy=accuracy, horizon=horizon)
    errors, estimates, cpu, last = [], [], [], "end"
    for k, at in enumerate(times):
        state = run.state_at(at)
        if run.simulation.accurate_until < at:
            break
        if k >= len(states) or unknown[k] > KNOWN * accuracy:
            last = "unknown"
            break
        errors.append(apart(state, states[k], size))
        estimates.append(np.nan_to_num(run.simulation.largest_error, nan=0.0, posinf=np.inf))
        cpu.append(run.cpu)
        if run.cpu > budget:
            last = "budget"
            break
    # The next checkpoint may show that the accuracy was exceeded since the previous one.
    online = max(errors, default=0.0)
    run.simulation.advance(CHECKPOINT)
    until = run.simulation.accurate_until
    if until < math.inf and (last == "end" or until < times[len(errors) - 1]):
        last = "said"
    count = sum(at <= until for at in times[: len(errors)])
    return {
        "true": max(errors[:count], default=0.0),
        "estimate": float(max(estimates[:count], default=0.0)),
        "true_before_said": online,
        "cpu": cpu[count - 1] if count else 0.0,
        "count": count,
        "last": last,
    }


def cheapest(scene, pushes, times, states, size, accuracy, settings):
    """CPU times in s and texts of fixed configurations that keep the accuracy at all times.

    "fixed" : cheapest one as `trade` chooses: it and the next finer ones keep the accuracy with a margin
    "least" : cheapest one of all; finding it requires the true motion
    """
    fixed = least = (math.inf, None)
    for method, kind in FIXED.items():
        ladder = []
        for value in PARTS if kind == "step" else TOLERANCES:
            choice = {"method": method, "step": times[0] / value if kind == "step" else times[0]}
            if kind == "tolerance":
                choice |= {"rtol": value, "atol": value}
            cpu, error = _measured(scene, pushes, times, states, size, accuracy, choice | settings)
            text = f"{method} {choice['step']:g} s" if kind == "step" else f"{method} {value:g}"
            ladder.append((MARGIN * error, cpu, text))
            if error <= accuracy:
                least = min(least, (cpu, text), key=lambda found: found[0])
            near = ladder[-1 - SETTLING :]
            enough = len(near) > SETTLING and max(near)[0] <= accuracy
            if enough or cpu > FINER * min(fixed[0], FINER * least[0]):
                break
        for i, (_, cpu, text) in enumerate(ladder):
            if max(ladder[i : i + 1 + SETTLING])[0] <= accuracy and cpu < fixed[0]:
                fixed = cpu, text
    return {"fixed_cpu": fixed[0], "fixed": fixed[1], "least_cpu": least[0], "least": least[1]}


def _measured(scene, pushes, times, states, size, accuracy, settings):
    """(CPU time in s, largest error) of a run; an error that exceeds the accuracy is infinite."""
    largest = 0.0
    try:
        run = Run(scene, pushes, estimate=False, **settings)
        for at, state in zip(times, states):
            largest = max(largest, apart(run.state_at(at), state, size))
            if not largest <= accuracy:
                return run.cpu, math.inf
    except (SimulationError, ValueError):
        return 0.0, math.inf
    return run.cpu, largest


def rows_of(scene, horizon, accuracies, seed, budget, first):
    """Rows of one scene and horizon."""
    default = Simulation(scene, horizon=horizon, quiet=True)
    size, stabilisation, step = default.promise["length"], default.stabilisation, default.step
    name = sum(map(ord, scene.name))
    pushes = random_pushes(scene, size, horizon, np.random.default_rng([seed, name, int(horizon)]))
    times = [horizon * k / SAMPLES for k in range(1, SAMPLES + 1)]
    truth = true_motion(scene, pushes, times, size, stabilisation, step, budget)
    common = {"scene": scene.name, "horizon": horizon}
    if first and len(truth[0]):
        common["from_independent"] = independent(scene, pushes, times[: len(truth[0])], truth[0], size)
    for accuracy in accuracies:
        case = (scene, pushes, times, truth, size, accuracy, horizon, budget)
        try:
            found = keep(*case)
        except SimulationError as error:
            yield common | {"accuracy": accuracy, "stopped": str(error)}
            continue
        count = found["count"]
        if count:
            fixed = cheapest(
                scene, pushes, times[:count], truth[0], size, accuracy,
                {"stabilisation": stabilisation},
            )  # fmt: skip
            if found["cpu"] < REPEATED:
                found["cpu"] = min(found["cpu"], *(_again(case, times[:count]) for _ in range(2)))
            found |= fixed
        known = float(truth[1][count - 1]) if count else None
        yield common | {"accuracy": accuracy, "seconds": count * times[0], "unknown": known} | found


def _again(case, times):
    """CPU time in s of one more run to an accuracy."""
    scene, pushes, *_, accuracy, horizon, _ = case
    run = Run(scene, pushes, accuracy=accuracy, horizon=horizon)
    for at in times:
        run.state_at(at)
    return run.cpu


def main():
    """Measure and print."""
    logging.disable(logging.CRITICAL)
    scenes = sorted(path.stem for path in (ROOT / "config" / "scenes").glob("*.yaml"))
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="+", choices=scenes, default=scenes, metavar="SCENE")
    parser.add_argument("--accuracies", nargs="+", type=float, default=ACCURACIES)
    parser.add_argument("--horizons", nargs="+", type=float, default=HORIZONS, help="s")
    parser.add_argument("--budget", type=float, default=60.0, help="CPU s of a run")
    parser.add_argument("--seed", type=int, default=0, help="of the pushes")
    parser.add_argument("--json", help="file for all rows")
    args = parser.parse_args()
    table = Table(title="Promised and true errors through random pushes")
    for title in (
        "scene", "horizon", "accuracy", "compared", "true", "estimate", "CPU", "cheapest", "times",
    ):  # fmt: skip
        table.add_column(title, justify="left" if title in ("scene", "cheapest") else "right")
    rows = []
    for name in args.only:
        scene = load_scene(name)
        for i, horizon in enumerate(args.horizons):
            horizon = horizon * SHORT.get(name, 1.0)
            for row in rows_of(scene, horizon, args.accuracies, args.seed, args.budget, i == 0):
                rows.append(row)
                table.add_row(*_shown(row))
                print(*_shown(row), sep="  ", file=sys.stderr, flush=True)
                if args.json:
                    Path(args.json).write_text(json.dumps(rows, indent=1))
    Console(width=130).print(table)
    compared = [row for row in rows if row.get("count")]
    missed = [row for row in compared if row["true"] > row["accuracy"]]
    print(f"compared: {len(compared)} of {len(rows)}; accuracy not kept: {len(missed)}")
    late = [row for row in compared if row["true_before_said"] > row["accuracy"]]
    print(f"error above the accuracy before the run could say so: {len(late)}")
    for kind, text in (("fixed_cpu", "cheapest"), ("least_cpu", "least")):
        ratios = [row["cpu"] / row[kind] for row in compared if row[kind] < math.inf]
        if ratios:
            print(f"times the {text}: median {np.median(ratios):.1f}, largest {max(ratios):.1f}")
    for row in rows:
        if row.get("from_independent") is not None and row["accuracy"] == args.accuracies[0]:
            print(f"{row['scene']}: {row['from_independent']:.1e} from the independent integration")


def _shown(row):
    begin = [row["scene"], f"{row['horizon']:g} s", f"{row['accuracy']:g}"]
    if not row.get("count"):
        return [*begin, row.get("stopped", row.get("last", ""))[:40], *[""] * 5]
    seconds, fixed = row["seconds"], row["fixed_cpu"]
    return [
        *begin,
        f"{seconds:g} s" + ("" if row["last"] == "end" else f" ({row['last']})"),
        f"{row['true']:.1e}",
        f"{row['estimate']:.1e}",
        f"{1e3 * row['cpu'] / seconds:.3g} ms/s",
        f"{row['fixed']}, {1e3 * fixed / seconds:.3g} ms/s" if row["fixed"] else "none",
        f"{row['cpu'] / fixed:.1f}" if row["fixed"] else "",
    ]


if __name__ == "__main__":
    main()
