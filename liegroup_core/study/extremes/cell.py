# SPDX-License-Identifier: Apache-2.0
"""One cell of the robustness map: a method on a problem, compared with the reference solution.

Verdicts, of which the last one is a defect:
    accurate    the error is below BOUND of the size of the motion
    flagged     the error is larger, but a warning was logged, or the simulation's estimate is at least
                half of the error or unknown (NaN)
    refused     no step was taken, with a reason
    stopped     the run stopped early, with a reason
    unjudged    the reference solution is not accurate enough
    silent      undetected error: the run finished with a larger error, an estimate below half of
                it, and no warning

The size of a motion is its largest distance from the start over the horizon, as an angle in rad, at most
1, and as a distance in m, where one radian counts as the length of the problem. The error is the largest
distance from the reference solution at the samples, relative to this size.
"""

import logging
import math
import time
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from liegroup_core.errors import SceneError, SimulationError
from liegroup_core.simulation import Simulation

ACCURATE, FLAGGED, REFUSED, STOPPED, UNJUDGED, SILENT = VERDICTS = (
    "accurate",
    "flagged",
    "refused",
    "stopped",
    "unjudged",
    "silent",
)
# Largest acceptable error, relative to the size of the motion.
BOUND = 0.05
HALF = 0.5  # fraction of the error that an estimate must reach
LARGE = 1e300  # replaces infinity, which JSON does not have
# Axes along which only the scale changes: errors may grow by the factor ALIKE relative to scale 1;
# errors below NO_LOSS always pass.
ALIKE, NO_LOSS = 30.0, 1e-6
MOST_SAMPLES = 32
DEFAULT = "default"  # instead of a method: simulation to the default accuracy


@dataclass(frozen=True)
class Problem:
    """Scene and run of a cell, with its reference solution.

    motion   : reference solution, see motions.py
    length   : characteristic length in m
    shown    : names of the bodies that are compared; None: all
    settings : further arguments of Simulation
    turns    : known rotation of the bodies in rad, because samples do not show full turns between them
    """

    scene: Any
    step: float
    steps: int
    motion: Callable
    length: float
    shown: tuple | None = None
    settings: dict = field(default_factory=dict)
    turns: float = 0.0

    def samples(self):
        """Step counts (k,) at which the motion is compared."""
        return np.unique(np.linspace(0, self.steps, min(self.steps, MOST_SAMPLES) + 1).round().astype(int))


def run_cell(problem, truth, method, make=Simulation):
    """Run a method. Returns verdict, error and warnings of the run as a dict of JSON types.

    truth    : ReferenceMotion at the samples of the problem
    make     : class of the simulation
    """
    cell = {
        "method": method,
        "step": problem.step,
        "steps": problem.steps,
        "error": None,
        "estimate": None,
        "uncertainty": None,
        "wrong_from_s": None,
        "flagged_at_s": None,
        "says": [],
        "seconds": 0.0,
    }
    began = time.process_time()
    with _listening() as said:
        try:
            simulation = make(problem.scene, None if method == DEFAULT else method, problem.step, **problem.settings)
        except (SceneError, ValueError) as error:
            return cell | {"verdict": REFUSED, "says": [str(error)]}
        stopped = _run(simulation, problem, truth, cell, said)
    cell["says"] = said + ([stopped] if stopped else [])
    cell["seconds"] = time.process_time() - began
    return cell | {"verdict": _verdict(cell, simulation, stopped)}


def _run(simulation, problem, truth, cell, said):
    """Run and compare at the samples. Returns the reason why the run stopped, or None."""
    names = simulation.layout.body_names
    rows = [i for i, name in enumerate(names) if problem.shown is None or name in problem.shown]
    angle_size, length_size = sizes(truth, problem.length, problem.turns)
    cell["uncertainty"] = float(truth.uncertainty / angle_size)
    for k, steps in enumerate(problem.samples().tolist()):
        try:
            simulation.advance(steps - simulation.steps)
        except SimulationError as error:
            return str(error)
        sample = simulation.sample()
        pose = sample.pose[rows]
        position, attitude = sample.errors[rows, :2].max(axis=0).tolist()
        estimate = max(attitude / angle_size, position / length_size)
        angle, way = apart(pose[:, :9].reshape(-1, 3, 3), pose[:, 9:], truth.rotation[k], truth.position[k])
        error = max(angle / angle_size, way / length_size)
        cell["error"] = float(max(cell["error"] or 0.0, error))
        if steps and not math.isnan(estimate):  # NaN before the first comparison with the companion run
            cell["estimate"] = float(min(max(cell["estimate"] or 0.0, estimate), LARGE))
        if cell["error"] > BOUND and cell["wrong_from_s"] is None:
            cell["wrong_from_s"] = simulation.time
        if (said or (cell["estimate"] or 0.0) > BOUND) and cell["flagged_at_s"] is None:
            cell["flagged_at_s"] = simulation.time
    return None


def _verdict(cell, simulation, stopped):
    if stopped:
        return REFUSED if simulation.steps == 0 else STOPPED
    return judged(cell, BOUND)


def judged(cell, bound):
    """Verdict on a finished run for a bound on its error."""
    if not cell["uncertainty"] < bound:
        return UNJUDGED
    if cell["error"] <= bound + cell["uncertainty"]:
        return ACCURATE
    known = cell["estimate"] is not None
    seen = cell["says"] or not known or cell["estimate"] >= HALF * cell["error"]
    return FLAGGED if seen else SILENT


def judge_alike(cells, natural):
    """Compare the errors of scaled problems with those at the natural scale."""
    errors = {
        cell["method"]: cell["error"] for cell in cells if cell["value"] == natural and cell["verdict"] == ACCURATE
    }
    for cell in cells:
        if cell["verdict"] == ACCURATE and cell["method"] in errors:
            cell["verdict"] = judged(cell, min(BOUND, max(NO_LOSS, ALIKE * errors[cell["method"]])))


def sizes(truth, length, turns=0.0):
    """Size of a motion as (rad, at most 1; m); turns : lower bound of the rotation in rad."""
    angle, way = apart(truth.rotation, truth.position, truth.rotation[:1], truth.position[:1])
    angle = min(max(angle, way / length, turns), 1.0)
    return angle or 1.0, max(way, length * angle) or length


def apart(rotation, position, rotation_2, position_2):
    """(largest distance of attitudes (..., n, 3, 3) in rad, of positions (..., n, 3) in m).

    Accurate for angles down to 1e-300 rad.
    """
    turn = rotation @ np.swapaxes(rotation_2, -1, -2)
    sine = 0.5 * np.stack(
        [turn[..., 2, 1] - turn[..., 1, 2], turn[..., 0, 2] - turn[..., 2, 0], turn[..., 1, 0] - turn[..., 0, 1]],
        axis=-1,
    )
    cosine = 0.5 * (np.trace(turn, axis1=-2, axis2=-1) - 1.0)
    angle = np.arctan2(_norm(sine), cosine)
    return float(angle.max(initial=0.0)), float(_norm(position - position_2).max(initial=0.0))


def _norm(vectors):
    """Norms of vectors (..., 3) without underflow or overflow of the squares."""
    largest = np.abs(vectors).max(axis=-1)
    scale = np.where((largest > 0.0) & np.isfinite(largest), largest, 1.0)
    return scale * np.linalg.norm(vectors / scale[..., None], axis=-1)


@contextmanager
def _listening():
    """Collect the warnings of the core in a list instead of logging them."""
    said = []

    class Listener(logging.Handler):
        def emit(self, record):
            # Messages about compiling are not warnings about the run.
            if record.module != "kernels":
                said.append(record.getMessage())

    logger, listener = logging.getLogger("liegroup_core"), Listener(logging.WARNING)
    propagates, logger.propagate = logger.propagate, False
    logger.addHandler(listener)
    try:
        yield said
    finally:
        logger.removeHandler(listener)
        logger.propagate = propagates
