# SPDX-License-Identifier: Apache-2.0
"""Comparison of the error estimates of a run (liegroup_core.running_error) with its true errors.

At each sample, the largest estimate and the largest true error of all bodies are compared, if the true
error is above the uncertainty of the reference solution and the estimate is known (not NaN).
Without a reference solution, the estimates take the place of the errors.
"""

import math

import numpy as np

from liegroup_core.reference import Distance

# Column of the estimates -> (name in Distance, unit)
COLUMNS = (("position", "m"), ("angle", "rad"), ("linear", "m/s"), ("angular", "rad/s"))
LEAST, MOST = 0.5, 10.0  # an estimate / true error of at least LEAST covers it, of at most MOST is close


class Estimate:
    """Largest estimates of a recording, and statistics of estimate / true error.

    promise : analysis.promise.Promise that checks the estimates
    """

    def __init__(self, promise):
        self._promise, self._max = promise, None
        self._samples, self._covering, self._close = np.zeros((3, len(COLUMNS)), dtype=int)

    def add(self, block):
        """Add the estimates of a Block, without zeros at the start of a stretch, where no error exists yet."""
        if block.errors is not None:
            counted = (block.steps != block.stretch.start) | block.errors.any(axis=(1, 2))
            largest = np.fmax.reduce(block.errors[counted], axis=(0, 1), initial=np.nan)
            self._max = largest if self._max is None else np.fmax(self._max, largest)
            counted &= ~np.isnan(block.errors[..., :2]).any(axis=(1, 2))
            if counted.any():
                position, angle, *_ = np.moveaxis(block.errors[counted], 2, 0)
                lost = np.where(np.isinf(position + angle), np.inf, 0.0)
                error = Distance(np.where(lost, 0.0, position), None, np.where(lost, 0.0, angle), None, None)
                self._promise.add(block.stretch, block.times[counted], error, Distance(lost, None, lost, None, None))

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


def error_of(figures):
    """(errors, why): entries of position and angle with "max" and "uncertainty"; None if they are unknown.

    They are those against the reference; then why is None. If there is none, they are the recorded estimates,
    and why is the reason.
    """
    reference = figures.get("reference", {"failed": "the comparison with a reference was not requested"})
    if "failed" not in reference:
        return reference, None
    why, found = reference["failed"], figures.get("estimate")
    if not found:
        return None, f"{why}; no estimate was recorded"
    errors = {name: {**found[name], "uncertainty": 0.0} for name in ("position", "angle")}
    sizes = [entry["max"] for entry in errors.values()]
    if figures["events"].get("unpredictable"):
        return None, f"{why}; the run reported that its motion cannot be known"
    repeat = figures.get("repeat", {})
    if repeat.get("first_difference") and not repeat["platform"]:  # estimates of another run
        return None, f"{why}; the re-simulation differs from the recording"
    if None in sizes:
        return None, f"{why}; the run ended before its first estimate"
    return (errors, why) if all(map(math.isfinite, sizes)) else (None, f"{why}; the recorded estimate is infinite")


def _share(count, samples):
    return float(count / samples) if samples else None
