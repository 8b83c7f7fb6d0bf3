# SPDX-License-Identifier: Apache-2.0
"""Error and cost of one configuration of a scene.

Errors are evaluated at the samples of the horizon that are whole steps. The cost is the minimum, over
several runs, of the CPU time of the thread in compiled loops. Other load on the machine affects it little.
"""

import logging
import math
import threading
import time
from contextlib import contextmanager
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from liegroup_core.compiling import source_digest
from liegroup_core.engine import Engine
from liegroup_core.errors import SimulationError
from liegroup_core.mechanism.symmetry import conserved_momentum
from liegroup_core.reference import Trajectory, distance
from liegroup_core.scene.load import scene_from_text
from liegroup_core.simulation import Simulation
from liegroup_core.study.machine import cpu_name
from liegroup_core.study.tasks import TasksError

from .configurations import SAMPLES, as_time, sample_times
from .reference_solution import ReferenceSolution, momentum_drift, scaled

LONG = 0.2  # CPU s: longer runs are timed once
SHORTEST, LEAST_RUNS = 0.02, 3  # CPU s of a timing, and least number of timings
MOST_STEPS_AT_ONCE = 100_000


class Study(NamedTuple):
    """Scene and reference solution, with all data that a worker needs."""

    text: str  # text of the scene file
    truth: ReferenceSolution
    sources: str  # digest of the sources, equal on all workers


def measure(work):
    """Measure a (Study, Configuration); returns a cell, JSON types.

    returns dict of method, step, group, stabilisation, options of the configuration, and
        stopped     reason why there is no result, one line; if it is None, the dict also has
        error       the larger of position error / length and attitude error in rad, the largest of
                    all bodies and samples
        position, attitude, angular, linear     largest errors in m, rad, rad/s, m/s
        energy      largest energy error relative to the largest kinetic energy
        momentum    largest relative drift of a conserved component; None if none is conserved
        joints      largest joint residual, m or rad
        flagged     warning of the engine about the run, one line, or None
        samples     number of evaluations
        cost_us     CPU time per simulated second, us
        timings     number of timed runs; the fastest counts
        cpu         name of the processor
    raises TasksError if the sources on this worker differ from those of the study
    """
    study, setting = work
    if study.sources != source_digest():
        raise TasksError("a worker has another version of liegroup_core: install the same version on all machines")
    cell = setting._asdict() | {"options": dict(setting.options), "cpu": cpu_name()}
    try:
        simulation = Engine(_scene(study.text), **setting.arguments())
        with listening() as said:
            found = _judge(simulation, study, as_time(setting.step))
            del found["estimate"]
            found["cost_us"], found["timings"] = _cost(simulation, float(study.truth.horizon), found.pop("cpu"))
    except (SimulationError, ValueError) as error:
        return cell | {"stopped": str(error)}
    if not all(math.isfinite(value) for value in found.values() if isinstance(value, float)):
        return cell | {"stopped": "an error is not a finite number"}
    flagged = next(iter(said), None)
    return cell | {"stopped": None, **found, "flagged": flagged}


def to_accuracy(scene, truth, accuracy):
    """Measure a simulation to an accuracy over the horizon; returns a dict, JSON types.

    accuracy    requested accuracy at the end of the horizon
    step        s, output interval, equal to the spacing of the samples
    error, estimate     true error as in `measure`, and the largest estimate at the samples
    until       s, time at which the estimate exceeded the accuracy; None: never
    cost_us     CPU time per simulated second, us, including the estimate
    """
    step = truth.horizon / SAMPLES
    simulation = Simulation(scene, step=float(step), accuracy=accuracy, horizon=float(truth.horizon))
    with listening():
        found = _judge(simulation, Study(scene.text, truth, ""), step)
        until = simulation.accurate_until
        cost, _ = _cost(simulation, float(truth.horizon), found["cpu"])
    return {
        "accuracy": accuracy,
        "step": float(step),
        "error": found["error"],
        "estimate": found["estimate"] if math.isfinite(found["estimate"]) else None,
        "until": until if math.isfinite(until) else None,
        "cost_us": cost,
    }


# Keys of all cells, and additional keys of finished runs.
ALWAYS = {
    "method": str,
    "step": float,
    "group": str,
    "stabilisation": str,
    "options": dict,
    "cpu": str,
    "stopped": (str, type(None)),
}
FINISHED = {
    **dict.fromkeys(("error", "position", "attitude", "angular", "linear", "energy", "joints", "cost_us"), float),
    "momentum": (float, type(None)),
    "flagged": (str, type(None)),
    "samples": int,
    "timings": int,
}


def is_whole(cell):
    """True if a dict is a complete cell, see `measure`."""
    wanted = ALWAYS | (FINISHED if cell.get("stopped", "") is None else {})
    return all(name in cell and isinstance(cell[name], kind) for name, kind in wanted.items())


@lru_cache(maxsize=4)
def _scene(text):
    return scene_from_text(text)


@lru_cache(maxsize=4)
def _kept_momentum(text):
    return conserved_momentum(_scene(text))


def _judge(simulation, study, step):
    """Run over the horizon. Returns errors, and the CPU time in s of the integration alone.

    step : s, Fraction
    """
    truth = study.truth
    times = sample_times(truth.horizon)
    rows = [row for row, at in enumerate(times) if at % step == 0]
    true = Trajectory(*(part[rows] for part in truth.motion))
    samples = []
    cpu = 0.0
    for row in rows:
        start = time.thread_time()
        simulation.advance(round(times[row] / step) - simulation.steps)
        cpu += time.thread_time() - start
        samples.append(simulation.sample())
    poses = np.array([sample.pose for sample in samples])
    k, n = poses.shape[:2]
    motion = Trajectory(
        true.times, poses[..., :9].reshape(k, n, 3, 3), poses[..., 9:], np.array([sample.twist for sample in samples])
    )
    off = distance(motion, true)
    energy = np.array([sample.energy for sample in samples])
    return {
        "error": scaled(off.position, off.angle, truth.length),
        "position": float(off.position.max()),
        "attitude": float(off.angle.max()),
        "angular": float(off.angular.max()),
        "linear": float(off.linear.max()),
        "energy": float(np.abs(energy - truth.energy[rows]).max() / (truth.kinetic or 1.0)),
        "momentum": momentum_drift(simulation.scene, _kept_momentum(study.text), truth, motion),
        "joints": max(sample.constraint_residual for sample in samples),
        "samples": k - 1,
        "estimate": max(_estimate(sample, truth.length) for sample in samples),
        "cpu": cpu,
    }


def _estimate(sample, length):
    """Largest estimated error of a pose; 0 if it is unknown."""
    if sample.errors is None or np.isnan(sample.errors).any():
        return 0.0
    return scaled(sample.errors[:, 0], sample.errors[:, 1], length)


def _cost(simulation, horizon, cpu):
    """(CPU time in us per simulated second, number of timings); cpu : CPU time of the first run, s."""
    times = [cpu]
    steps = simulation.steps
    while cpu < LONG and (len(times) < LEAST_RUNS or sum(times) < SHORTEST):
        simulation.reset()
        start = time.thread_time()
        for done in range(0, steps, MOST_STEPS_AT_ONCE):
            simulation.advance(min(MOST_STEPS_AT_ONCE, steps - done))
        times.append(time.thread_time() - start)
    return min(times) / horizon * 1e6, len(times)


@contextmanager
def listening():
    """Collect the warnings of the engine in this thread instead of logging them."""
    said, here = [], threading.get_ident()
    logger = logging.getLogger("liegroup_core")

    def hear(record):
        if record.thread != here or record.levelno < logging.WARNING:
            return True
        said.append(record.getMessage())
        return False

    logger.addFilter(hear)
    try:
        yield said
    finally:
        logger.removeFilter(hear)
