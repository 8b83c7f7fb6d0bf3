# SPDX-License-Identifier: Apache-2.0
"""Comparison of the error estimates of a run (liegroup_core.running_error) with its true errors.

At each sample, the largest estimate and the largest true error of all bodies are compared, if the true
error is above the uncertainty of the reference solution and the estimate is known (not NaN).
"""

import math

import numpy as np

# Column of the estimates -> (name in Distance, unit)
COLUMNS = (("position", "m"), ("angle", "rad"), ("linear", "m/s"), ("angular", "rad/s"))
LEAST, MOST = 0.5, 10.0  # an estimate / true error of at least LEAST covers it, of at most MOST is close


class Estimate:
    """Largest estimates of a recording, and statistics of estimate / true error."""

    def __init__(self):
        self._max = None
        self._samples, self._covering, self._close = np.zeros((3, len(COLUMNS)), dtype=int)

    def add(self, block):
        """Add the estimates of a Block, without zeros at the start of a stretch, where no error exists yet."""
        if block.errors is not None:
            counted = (block.steps != block.stretch.start) | block.errors.any(axis=(1, 2))
            largest = np.fmax.reduce(block.errors[counted], axis=(0, 1), initial=np.nan)
            self._max = largest if self._max is None else np.fmax(self._max, largest)

    def compare(self, estimates, error, uncertainty):
        """Add the true errors, as two Distances at the samples of estimates (k, n, 4)."""
        for j, (name, _) in enumerate(COLUMNS):
            found, true, known = (
                part.max(axis=1) for part in (estimates[..., j], getattr(error, name), getattr(uncertainty, name))
            )
            counted = (true > known) & ~np.isnan(found)
            found, true = found[counted], true[counted]
            self._samples[j] += len(true)
            self._covering[j] += int((found >= LEAST * true).sum())
            self._close[j] += int((found <= MOST * true).sum())

    def figures(self):
        """Figures, see config/analysis.schema.json; None if no estimate was recorded."""
        if self._max is None:
            return None
        return {
            name: {
                "unit": unit,
                "max": None if math.isnan(self._max[j]) else float(self._max[j]),
                "samples": int(self._samples[j]),
                "covering": _share(self._covering[j], self._samples[j]),
                "close": _share(self._close[j], self._samples[j]),
            }
            for j, (name, unit) in enumerate(COLUMNS)
        }


def _share(count, samples):
    return float(count / samples) if samples else None
