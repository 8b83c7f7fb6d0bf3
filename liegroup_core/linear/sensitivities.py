# SPDX-License-Identifier: Apache-2.0
"""Sensitivities of a run: derivatives of its outputs with respect to numbers of the scene.

Each is a central difference of order four from four runs to a tight accuracy, with the difference to that of order
two as its error. Runs are repeated as a whole, so that events (stops, friction) act as they do: the derivative of the
time of an impact is included. Where the numbers of events differ, the run is not smooth in this number.
"""

from dataclasses import dataclass

import numpy as np

from liegroup_core.errors import SceneError
from liegroup_core.scene.load import scene_as_written, scene_from_text
from liegroup_core.simulation import Simulation
from liegroup_core.study.sweep.parameters import changed, parameters, path_of

from .channels import Outputs
from .probe import Probe

# Accuracy of the runs; relative change of a number, and the change of one that is zero. The error of order four is that
# of order two times the square of the change relative to the scale of the function: CHANGE is that of a thirtieth.
TIGHT, CHANGE = 1e-12, 1e-3


@dataclass(frozen=True, eq=False)
class Sensitivities:
    """Derivatives of outputs along a run.

    times      : (k,) s
    outputs    : names of p outputs, see channels.py
    parameters : paths of q numbers of the scene
    values     : (k, p) outputs, SI units
    derivatives, errors : (k, p, q)
    rough      : parameters with different numbers of events on both sides
    """

    times: np.ndarray
    outputs: tuple
    parameters: tuple
    values: np.ndarray
    derivatives: np.ndarray
    errors: np.ndarray
    rough: tuple


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
    written = scene_as_written(scene.text, scene.source)
    paths = tuple(path_of(written, name) for name in names)
    known = parameters(written)
    times = np.atleast_1d(np.asarray(times, dtype=float))
    values, labels, turning, events = _run(scene, times, outputs, settings)
    derivatives, errors, rough = [], [], []
    for path in paths:
        if known[path] is None:
            raise SceneError(f"the scene has no value of {path}: give it there")
        h = CHANGE * (abs(known[path]) or 1.0)
        found = []
        for step in (-2, -1, 1, 2):
            other = scene_from_text(changed(written, {path: known[path] + step * h}).text, source=scene.source)
            moved, _, _, count = _run(other, times, outputs, settings)
            difference = moved - values
            difference[:, turning] = (difference[:, turning] + np.pi) % (2.0 * np.pi) - np.pi
            found.append(difference)
            if count != events and path not in rough:
                rough.append(path)
        second, wide = (found[2] - found[1]) / (2.0 * h), (found[3] - found[0]) / (4.0 * h)
        derivatives.append((4.0 * second - wide) / 3.0)
        errors.append(np.abs(second - wide) / 3.0 * CHANGE + TIGHT / h)
    shape = len(paths), len(times), len(labels)
    derivatives, errors = (np.array(part).reshape(shape).transpose(1, 2, 0) for part in (derivatives, errors))
    return Sensitivities(times, labels, paths, values, derivatives, errors, tuple(rough))


def _run(scene, times, wanted, settings):
    """(outputs (k, p), names, mask of the angles, number of events) of a run."""
    simulation = Simulation(scene, quiet=True, **settings)
    outputs = Outputs(Probe(simulation), wanted)
    values = np.array([outputs.of(sample) for sample in simulation.samples(times)]).reshape(len(times), -1)
    units = simulation.layout.coordinates.units
    turning = np.array(
        [name.endswith(".position") and units.get(name.removesuffix(".position")) == "rad" for name in outputs.names],
        dtype=bool,
    )
    return values, tuple(outputs.names), turning, simulation.event_count
