# SPDX-License-Identifier: Apache-2.0
"""Whether a run kept the accuracy that its setting was chosen for (liegroup_core.study.trade.accuracy).

The promise is over the first `horizon` seconds from the start of the scene, until a wrench comes
from outside; what lies beyond is told, and not held against it.
"""

import math

import numpy as np

from liegroup_core.study.trade.reference_solution import scaled

# Of a horizon: times are step counts times the step, rounded.
ROUNDING = 1e-9


class Promise:
    """Takes up errors on their way, and says what became of a promise (None: none was made)."""

    def __init__(self, promise):
        self._promise = promise
        self._inside = self._known = self._all = 0.0
        self._seconds, self._beyond = None, False

    def add(self, stretch, times, error, uncertainty):
        """Take up two Distances at k times, s since the start of a stretch."""
        if self._promise is None:
            return
        length = self._promise["length"]
        self._all = max(self._all, scaled(error.position, error.angle, length))
        end = self._promise["horizon"] * (1.0 + ROUNDING) if stretch.start == 0 else -1.0
        first = min((push[0] for push in stretch.pushed), default=math.inf)
        inside = np.asarray(times) <= min(end, first * stretch.step * (1.0 + ROUNDING))
        self._beyond |= not inside.all()
        if inside.any():
            self._inside = max(
                self._inside, scaled(error.position[inside], error.angle[inside], length)
            )
            self._known = max(
                self._known, scaled(uncertainty.position[inside], uncertainty.angle[inside], length)
            )
            self._seconds = max(self._seconds or 0.0, float(np.asarray(times)[inside].max()))

    def figures(self):
        """What became of it, see config/analysis.schema.json; or None."""
        if self._promise is None:
            return None
        accuracy = float(self._promise["accuracy"])
        kept = None
        if self._seconds is not None:
            if max(self._inside, self._known) <= accuracy:
                kept = True
            elif self._inside - self._known > accuracy:
                kept = False
        return {
            "accuracy": accuracy,
            "horizon": float(self._promise["horizon"]),
            "length": float(self._promise["length"]),
            "seconds": self._seconds,
            "error": self._inside,
            "uncertainty": self._known,
            "kept": kept,
            "beyond": self._beyond,
            "error_of_all": self._all,
        }


def told(found):
    """What became of a promise, in words; found : figures of one."""
    accuracy = f"the guaranteed accuracy of {found['accuracy']:g}"
    if found["seconds"] is None:
        return (
            f"{accuracy} cannot be checked: nothing was recorded between the initial state "
            "and the first wrench"
        )
    error = (
        f"below {found['uncertainty']:.3g}"
        if found["error"] <= found["uncertainty"]
        else f"{found['error']:.3g}"
    )
    said = {True: "is kept", False: "is not kept", None: "cannot be checked with this reference"}
    text = f"{accuracy} {said[found['kept']]}: {error} in the first {found['seconds']:.4g} s"
    if found["beyond"]:
        text += (
            ". Nothing is guaranteed after that (longer time, or a wrench): error "
            f"{found['error_of_all']:.3g} over the whole run"
        )
    return text
