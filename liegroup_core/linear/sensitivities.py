# SPDX-License-Identifier: Apache-2.0
"""Sensitivities of a run: derivatives of its outputs with respect to numbers of the scene.

They follow from the variational equations along the run (variations.py), events included. A number whose change gives
the mechanism another structure, or other times of its inputs, has central differences of order six between runs.
"""

from dataclasses import dataclass

import numpy as np

from liegroup_core.errors import SceneError
from liegroup_core.fields.arguments import floats
from liegroup_core.forces.instants import LATEST
from liegroup_core.simulation import Simulation
from liegroup_core.threads import one_blas_thread

from .channels import OutputChannels
from .differences import SMALLER, WEIGHTS, kinked
from .numbers import Numbers, OtherStructure
from .probe import Probe
from .variations import Variations

# Of differences between runs: their accuracy, and the relative change of a number, or the change of one that is zero.
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
    derivatives, errors : (k, p, q); NaN from a time on at which a run has no derivative
    rough      : parameters with other events in neighbouring runs
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


@one_blas_thread()
def sensitivities(scene, names, times, outputs=None, tell=None, **settings):
    """Sensitivities of the run of a scene from its start.

    names    : of numbers of the scene, as `liegroup_sim sweep --vary` takes them
    times    : (k,) s, that do not decrease
    outputs  : names, see channels.py; None: joints
    tell     : function of a text, how far the work is; None: nothing is told
    settings : of Simulation; default: accuracy 1e-12
    Raises ParameterError, SceneError for unknown names or numbers that cannot change, SimulationError.
    Accuracy: test/verification/test_sensitivities.py.
    """
    run = _Run(scene, names, times, outputs, settings or {"accuracy": TIGHT}, tell or (lambda text: None))
    numbers, shape = run.numbers, (*run.values.shape, len(run.numbers))
    found, errors, rough = np.zeros(shape), np.zeros(shape), np.zeros(len(numbers), dtype=bool)
    other = []
    while len(other) < len(numbers):
        smooth = [path for path in numbers.paths if path not in other]
        mask = np.array([path in smooth for path in numbers.paths])
        try:
            found[:, :, mask], errors[:, :, mask], rough[mask] = run.variations(Numbers(scene, smooth))
            break
        except OtherStructure as error:
            other.append(error.path)
    for path in other:
        k = numbers.paths.index(path)
        found[:, :, k], errors[:, :, k], rough[k] = run.differences(k)
    names = tuple(path for path, is_rough in zip(numbers.paths, rough) if is_rough)
    return Sensitivities(run.times, run.outputs, numbers.paths, run.values, found, errors, names, run.seen.angles)


def outputs_of(simulation, names):
    """Names of single outputs for names that may stand for many. Raises SceneError."""
    return tuple(OutputChannels(Probe(simulation), names).names)


class _Run:
    """A run at times, with values (k, p) of its outputs."""

    def __init__(self, scene, names, times, outputs, settings, tell):
        self._tell, self.numbers, self.settings = tell, Numbers(scene, names), settings
        self.times = floats("times must be finite numbers", times).ravel()
        steps = np.diff(self.times, prepend=0.0)
        if not (len(steps) and (steps >= 0.0).all() and self.times[-1] <= LATEST):
            raise SceneError(f"sensitivities need times from 0 to {LATEST:g} s that do not decrease")
        self._wanted, self.seen = outputs, None
        self.values, self._events, self._noise, self.seen = self._run(scene, "run")
        self.outputs = tuple(self.seen.names)

    def _run(self, scene, what):
        """(outputs (k, p), number of events, errors of the states (k,), OutputChannels) of the run of a scene."""
        simulation = Simulation(scene, quiet=True, **self.settings)
        outputs = self._outputs(Probe(simulation))
        values, noise = [], []
        for time, sample in zip(self.times, simulation.samples(self.times)):
            self._tell(f"{what}, {time:.3g} of {self.times[-1]:.3g} s")
            values.append(outputs.of(sample))
            noise.append(np.nan if sample.errors is None else np.max(sample.errors, initial=0.0))
        values = np.array(values).reshape(len(self.times), -1)
        return values, simulation.event_count, np.nan_to_num(noise), outputs

    def _outputs(self, probe):
        return OutputChannels(probe, self._wanted, None if self.seen is None else self.seen.turns)

    def variations(self, numbers):
        """Derivatives (k, p, q) by numbers, their errors, and which of them are rough (q,)."""
        simulation = Simulation(self.numbers.scene, quiet=True, **self.settings)
        instants = [simulation.instant_of(round(time * 1e9)) for time in self.times]
        times = [round(instant.time * 1e9) for instant in instants]
        variations = Variations(simulation, times[-1], None, numbers)
        outputs, found, errors = self._outputs(variations.probe), [], []
        tell = lambda ns: self._tell(f"derivatives, {1e-9 * ns:.3g} of {1e-9 * times[-1]:.3g} s")  # noqa: E731
        for _, noise in zip(variations.through(times, tell), self._noise):
            derivatives, error = variations.of_outputs(outputs)
            lost = np.where(variations.rough, np.nan, 1.0) / numbers.scales
            found.append(derivatives.T * lost)
            # The second derivatives are taken as large as the first ones, per rad or m.
            errors.append((error.T + noise * np.abs(derivatives.T)) * lost)
        found = np.array(found)
        return found, np.array(errors), self._is_rough(found)

    def _is_rough(self, found):
        """(q,) which numbers have no derivative (k, p, q), where the output has a value."""
        return (np.isnan(found) & np.isfinite(self.values)[:, :, None]).any(axis=(0, 1))

    def differences(self, k):
        """Derivatives (k, p) by number k, their errors, and whether it is rough, from other runs."""
        h, counts = CHANGE, set()
        best = np.zeros_like(self.values), np.full_like(self.values, np.inf)
        for _ in range(MOST_CHANGES):
            moves, noises, counts = [], [self._noise], set()
            for step in (1, -1, 2, -2, 3, -3):
                what = f"{self.numbers.paths[k]} changed by {step * h:+.3g} of it"
                values, events, noise, _ = self._run(self.numbers.beside(k, step * h), what)
                moves.append(self.seen.apart(values, self.values))
                noises.append(noise)
                counts.add(events)
            step = h * self.numbers.scales[k]
            apart = np.subtract(moves[::2], moves[1::2])
            second, fourth, sixth = (np.tensordot(weights, apart, 1) / step for weights in WEIGHTS)
            # Orders that do not converge are those of a function that is smooth on each side only.
            last, before = np.abs(sixth - fourth), np.abs(fourth - second)
            truncation = np.where(last > 0.1 * before, 10.0, 1.0) * last
            rounding = np.max(noises, axis=0)[:, None] / step
            bent = kinked(np.reshape(moves[:4], (2, 2, *self.values.shape)), np.zeros_like(self.values))
            is_better = truncation + rounding < best[1]
            best = np.where(is_better, sixth, best[0]), np.where(is_better, truncation + rounding, best[1])
            if not is_better.any() or (truncation <= ENOUGH * np.abs(sixth) + rounding).all():
                break
            h /= SMALLER
        found = np.where(bent, np.nan, best[0])
        return found, best[1], counts != {self._events} or self._is_rough(found[:, :, None])[0]
