# SPDX-License-Identifier: Apache-2.0
"""Difference of a run to measured outputs, with derivatives by numbers of the scene, for scipy.optimize."""

import numpy as np

from liegroup_core.errors import SceneError
from liegroup_core.simulation import Simulation

from .channels import apart
from .numbers import Numbers
from .sensitivities import outputs_of, sensitivities


class Misfit:
    """Weighted residuals (outputs - measured) / deviation of a run, as functions of numbers x (q,) of its scene.

    scene     : Scene with the first values
    names     : of q numbers, as `liegroup_sim sweep --vary` takes them
    times     : (k,) s, that do not decrease
    measured  : (k, p) in SI units, NaN where nothing was measured
    outputs   : names of the p outputs, see channels.py; names may stand for many
    deviation : standard deviations of the measurements, (p,) or a number
    settings  : of Simulation; default: accuracy 1e-12

    start     : (q,) present numbers of the scene
        least_squares(misfit.residuals, misfit.start, misfit.jacobian)
        minimize(misfit.cost, misfit.start, jac=True)
    Raises SceneError, also in the methods for numbers that the scene cannot have; SimulationError.
    Accuracy: test/verification/test_sensitivities.py.
    """

    def __init__(self, scene, names, times, measured, outputs, deviation=1.0, **settings):
        self._numbers = Numbers(scene, names)
        self.paths, self.start = self._numbers.paths, self._numbers.values
        self._times, self._settings = np.atleast_1d(times), settings
        self._outputs = outputs_of(Simulation(scene, quiet=True), outputs)
        shape = len(self._times), len(self._outputs)
        self._measured, deviation = np.array(measured, dtype=float), np.asarray(deviation, dtype=float)
        if self._measured.shape not in (shape, (shape[0],)) or self._measured.size != shape[0] * shape[1]:
            raise SceneError(f"measured must have the shape {shape}, got {self._measured.shape}")
        if not (deviation > 0.0).all() or deviation.shape not in ((), shape[1:]):
            raise SceneError("the deviation must be a number greater than 0, or one for each output")
        self._measured = self._measured.reshape(shape)
        self._weights = np.where(np.isnan(self._measured), 0.0, 1.0 / np.broadcast_to(deviation, shape))
        self._last = None

    def _at(self, x):
        """Sensitivities of the run with numbers x; those of the last x are kept."""
        key = tuple(np.atleast_1d(np.asarray(x, dtype=float)).tolist())
        if len(key) != len(self.paths):
            raise SceneError(f"{len(self.paths)} numbers are needed, got {len(key)}")
        if self._last is None or self._last[0] != key:
            scene = self._numbers.scene_at(key)
            self._last = key, sensitivities(scene, self.paths, self._times, self._outputs, **self._settings)
        return self._last[1]

    def residuals(self, x):
        """(k p,) weighted residuals."""
        found = self._at(x)
        return (self._weights * apart(found.values, np.nan_to_num(self._measured), found.angles)).ravel()

    def jacobian(self, x):
        """(k p, q) derivatives of the residuals."""
        return (self._weights[..., None] * self._at(x).derivatives).reshape(-1, len(self.paths))

    def cost(self, x):
        """Half the sum of the squares of the residuals, and its gradient (q,)."""
        residuals = self.residuals(x)
        return 0.5 * float(residuals @ residuals), residuals @ self.jacobian(x)
