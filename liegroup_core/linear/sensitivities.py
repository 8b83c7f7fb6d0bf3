# SPDX-License-Identifier: Apache-2.0
"""Sensitivities of a run: derivatives of its outputs with respect to numbers of the scene.

Each is a central difference of order six from six runs to a tight accuracy. Its error is the difference to that of
order four, and the estimated errors of the runs over the change. Runs are repeated as a whole, so that events (stops,
friction) act as they do: the derivative of the time of an impact is included. Where the numbers of events differ, the
run is not smooth in this number.
"""

from dataclasses import dataclass

import numpy as np

from liegroup_core.errors import SceneError
from liegroup_core.scene.load import scene_as_written, scene_from_text
from liegroup_core.simulation import Simulation
from liegroup_core.study.sweep.parameters import changed, parameters, path_of

from .channels import Outputs
from .differences import SMALLER, WEIGHTS
from .probe import Probe

# Accuracy of the runs; relative change of a number, and the change of one that is zero: at 1e-3 both errors of a smooth
# function, 1e-3 to the sixth power times its seventh derivative and 1e-12 / 1e-3 times it, are below 1e-8.
TIGHT, CHANGE = 1e-12, 1e-3
# Where a run depends on a number more strongly, smaller changes follow, until the relative error is small.
ENOUGH, MOST_CHANGES = 1e-7, 4


@dataclass(frozen=True, eq=False)
class Sensitivities:
    """Derivatives of outputs along a run.

    times      : (k,) s
    outputs    : names of p outputs, see channels.py
    parameters : paths of q numbers of the scene
    values     : (k, p) outputs, SI units
    derivatives, errors : (k, p, q)
    rough      : parameters with different numbers of events on both sides
    angles     : (p,) whether an output is an angle, which values have modulo 2 pi
    """

    times: np.ndarray
    outputs: tuple
    parameters: tuple
    values: np.ndarray
    derivatives: np.ndarray
    errors: np.ndarray
    rough: tuple
    angles: np.ndarray


def numbers_of(scene, names):
    """(scene as written, paths, {path: number}) of numbers with these names. Raises ParameterError, SceneError."""
    written = scene_as_written(scene.text, scene.source)
    paths, known = tuple(path_of(written, name) for name in names), parameters(written)
    if missing := [path for path in paths if known[path] is None]:
        raise SceneError(f"the scene has no value of {missing[0]}: give it there")
    return written, paths, known


def sensitivities(scene, names, times, outputs=None, **settings):
    """Sensitivities of the run of a scene from its start.

    names    : of numbers of the scene, as `liegroup_sim sweep --vary` takes them
    times    : (k,) s, that do not decrease
    outputs  : names, see channels.py; None: joints
    settings : of Simulation; default: accuracy 1e-12
    Raises ParameterError, SceneError for unknown names or numbers that cannot change, SimulationError.
    Accuracy: test/verification/test_sensitivities.py.
    """
    settings = settings or {"accuracy": TIGHT}
    written, paths, known = numbers_of(scene, names)
    times = np.atleast_1d(np.asarray(times, dtype=float))
    if not len(times):
        raise SceneError("sensitivities need at least one time")
    values, labels, turning, events, noise = _run(scene, times, outputs, settings)
    derivatives, errors, rough = [], [], []

    def moved(path, number):
        """(changes of the outputs, number of events, errors) of the run with another number."""
        other = scene_from_text(changed(written, {path: number}).text, source=scene.source)
        found, _, _, count, noise = _run(other, times, outputs, settings)
        return difference(found, values, turning), count, noise

    for path in paths:
        h = CHANGE * (abs(known[path]) or 1.0)
        found = np.zeros_like(values), np.full_like(values, np.inf)
        for _ in range(MOST_CHANGES):
            moves, counts, noises = zip(*(moved(path, known[path] + step * h) for step in (1, -1, 2, -2, 3, -3)))
            fourth, sixth = (
                np.tensordot(weights, np.subtract(moves[::2], moves[1::2]), 1) / h for weights in WEIGHTS[1:]
            )
            truncation, rounding = np.abs(sixth - fourth), np.max([noise, *noises], axis=0)[:, None] / h
            is_better = truncation + rounding < found[1]
            found = np.where(is_better, sixth, found[0]), np.where(is_better, truncation + rounding, found[1])
            if not is_better.any() or (truncation <= ENOUGH * np.abs(sixth) + rounding).all():
                break
            h /= SMALLER
        if any(count != events for count in counts):
            rough.append(path)
        derivatives.append(found[0])
        errors.append(found[1])
    shape = len(paths), len(times), len(labels)
    derivatives, errors = (np.array(part).reshape(shape).transpose(1, 2, 0) for part in (derivatives, errors))
    return Sensitivities(times, labels, paths, values, derivatives, errors, tuple(rough), turning)


def difference(found, values, angles):
    """Differences (k, p) of outputs, of angles modulo 2 pi."""
    apart = found - values
    apart[:, angles] = (apart[:, angles] + np.pi) % (2.0 * np.pi) - np.pi
    return apart


def _run(scene, times, wanted, settings):
    """(outputs (k, p), names, mask of the angles, number of events, error of the states (k,)) of a run."""
    simulation = Simulation(scene, quiet=True, **settings)
    outputs = Outputs(Probe(simulation), wanted)
    values, noise = [], []
    for sample in simulation.samples(times):
        values.append(outputs.of(sample))
        noise.append(np.nan if sample.errors is None else np.max(sample.errors, initial=0.0))
    values = np.array(values).reshape(len(times), -1)
    units = simulation.layout.coordinates.units
    turning = np.array(
        [name.endswith(".position") and units.get(name.removesuffix(".position")) == "rad" for name in outputs.names],
        dtype=bool,
    )
    return values, tuple(outputs.names), turning, simulation.event_count, np.nan_to_num(noise)
