# SPDX-License-Identifier: Apache-2.0
"""One cell of the map of extremes: a method on a problem, run and judged against the true motion.

The verdicts, of which the last one must not be:
    accurate    the motion is right to BOUND of its size, or to what `expected` says
    flagged     it is not, and the run says so: a warning, or `Simulation.doubt`
    refused     no step was taken, and the reason was given
    stopped     the run stopped on the way, and said why
    unjudged    the true motion is not known well enough
    silent      the run went to its end with a wrong motion and no word of it

The size of a motion is how far it goes from its start over the horizon: rad, but no more than 1
counts, and m, for which one radian is the problem's length. An error is the largest distance from
the true motion at the samples, of attitudes in rad over the one, of positions in m over the other.
"""

import logging
import time
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from liegroup_core.engine import Engine
from liegroup_core.errors import SceneError, SimulationError

ACCURATE, FLAGGED, REFUSED, STOPPED, UNJUDGED, SILENT = VERDICTS = (
    "accurate",
    "flagged",
    "refused",
    "stopped",
    "unjudged",
    "silent",
)
# What is wrong by more than this part of the motion is plainly wrong.
BOUND = 0.05
# Of an axis along which problems are the same but for their scale: errors may grow by this factor
# against the problem at the scale 1, and what is below the second number is no loss.
ALIKE, NO_LOSS = 30.0, 1e-6
MOST_SAMPLES = 32


@dataclass(frozen=True)
class Problem:
    """What a method has to do in a cell, and what would be right.

    motion : the true one, see extremes_motions
    length : m, what positions are compared with beside the way that bodies go
    shown  : names of the bodies that are compared; None: all
    settings : further arguments of Simulation
    turns  : rad that bodies turn by for sure: whole turns between samples do not show
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
        """(k,) step counts at which the motion is compared."""
        return np.unique(
            np.linspace(0, self.steps, min(self.steps, MOST_SAMPLES) + 1).round().astype(int)
        )


def run_cell(problem, truth, method, make=Engine):
    """Run a method; returns a dict of what JSON holds: verdict, error and what the run said.

    truth    : Truth at the samples of the problem
    make     : what makes the simulation
    """
    cell = {
        "method": method,
        "step": problem.step,
        "steps": problem.steps,
        "error": None,
        "uncertainty": None,
        "wrong_from_s": None,
        "flagged_at_s": None,
        "says": [],
        "seconds": 0.0,
    }
    began = time.process_time()
    with _listening() as said:
        try:
            simulation = make(problem.scene, method, problem.step, **problem.settings)
        except (SceneError, ValueError) as error:
            return cell | {"verdict": REFUSED, "says": [str(error)]}
        stopped = _run(simulation, problem, truth, cell, said)
    if simulation.doubt and simulation.doubt not in said:
        said.append(simulation.doubt)
    cell["says"] = said + ([stopped] if stopped else [])
    cell["seconds"] = time.process_time() - began
    return cell | {"verdict": _verdict(cell, simulation, stopped)}


def _run(simulation, problem, truth, cell, said):
    """Take the steps and compare on the way; returns why the run stopped, or None."""
    names = simulation.layout.body_names
    rows = [i for i, name in enumerate(names) if problem.shown is None or name in problem.shown]
    angle_size, length_size = sizes(truth, problem.length, problem.turns)
    cell["uncertainty"] = float(truth.uncertainty / angle_size)
    for k, steps in enumerate(problem.samples().tolist()):
        try:
            simulation.advance(steps - simulation.steps)
        except SimulationError as error:
            return str(error)
        pose = simulation.sample().pose[rows]
        angle, way = apart(
            pose[:, :9].reshape(-1, 3, 3), pose[:, 9:], truth.rotation[k], truth.position[k]
        )
        error = max(angle / angle_size, way / length_size)
        cell["error"] = float(max(cell["error"] or 0.0, error))
        if cell["error"] > BOUND and cell["wrong_from_s"] is None:
            cell["wrong_from_s"] = simulation.time
        if said and cell["flagged_at_s"] is None:
            cell["flagged_at_s"] = simulation.time
    return None


def _verdict(cell, simulation, stopped):
    if stopped:
        return REFUSED if simulation.steps == 0 else STOPPED
    return judged(cell, BOUND)


def judged(cell, bound):
    """The verdict of a run that went to its end, against a bound on its error."""
    if not cell["uncertainty"] < bound:
        return UNJUDGED
    if cell["error"] <= bound + cell["uncertainty"]:
        return ACCURATE
    return FLAGGED if cell["says"] else SILENT


def judge_alike(cells, natural):
    """Judge the cells of an axis by those at its natural scale: errors must be alike."""
    errors = {
        cell["method"]: cell["error"]
        for cell in cells
        if cell["value"] == natural and cell["verdict"] == ACCURATE
    }
    for cell in cells:
        if cell["verdict"] == ACCURATE and cell["method"] in errors:
            cell["verdict"] = judged(cell, min(BOUND, max(NO_LOSS, ALIKE * errors[cell["method"]])))


def sizes(truth, length, turns=0.0):
    """How far a motion goes: rad, at most 1, and m; at least by so many rad."""
    angle, way = apart(truth.rotation, truth.position, truth.rotation[:1], truth.position[:1])
    angle = min(max(angle, way / length, turns), 1.0)
    return angle or 1.0, max(way, length * angle) or length


def apart(rotation, position, rotation_2, position_2):
    """Largest distance of attitudes (..., n, 3, 3), rad, and of positions (..., n, 3), m.

    Angles of 1e-300 are told from each other too.
    """
    turn = rotation @ np.swapaxes(rotation_2, -1, -2)
    sine = 0.5 * np.stack(
        [
            turn[..., 2, 1] - turn[..., 1, 2],
            turn[..., 0, 2] - turn[..., 2, 0],
            turn[..., 1, 0] - turn[..., 0, 1],
        ],
        axis=-1,
    )
    cosine = 0.5 * (np.trace(turn, axis1=-2, axis2=-1) - 1.0)
    angle = np.arctan2(_norm(sine), cosine)
    return float(angle.max(initial=0.0)), float(_norm(position - position_2).max(initial=0.0))


def _norm(vectors):
    """Lengths of vectors (..., 3), also where squares are too small or too large for a number."""
    largest = np.abs(vectors).max(axis=-1)
    scale = np.where((largest > 0.0) & np.isfinite(largest), largest, 1.0)
    return scale * np.linalg.norm(vectors / scale[..., None], axis=-1)


@contextmanager
def _listening():
    """The warnings of the core in this block, in a list, and nowhere else."""
    said = []

    class Listener(logging.Handler):
        def emit(self, record):
            if record.funcName != "warm_up":  # compiling is no doubt
                said.append(record.getMessage())

    logger, listener = logging.getLogger("liegroup_core"), Listener(logging.WARNING)
    propagates, logger.propagate = logger.propagate, False
    logger.addHandler(listener)
    try:
        yield said
    finally:
        logger.removeHandler(listener)
        logger.propagate = propagates
