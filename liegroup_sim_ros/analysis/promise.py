# SPDX-License-Identifier: Apache-2.0
"""Check of the guaranteed accuracy of a run (liegroup_core.study.trade.accuracy).

The guarantee covers the first `horizon` seconds from the initial state, and ends with the first
applied wrench. Later errors are reported but do not violate it.
"""

import math

import numpy as np

from liegroup_core.study.trade.reference_solution import scaled

# Relative tolerance of a horizon: times are products of step count and step, with round-off.
ROUNDING = 1e-9


class Promise:
    """Check of a guaranteed accuracy, block by block.

    promise : entry of the recorded settings; None: nothing is guaranteed
    """

    def __init__(self, promise):
        self._promise = promise
        self._inside = self._known = self._all = 0.0
        self._seconds, self._beyond = None, False

    def add(self, stretch, times, error, uncertainty):
        """Add error and uncertainty, two Distances at k times in s since the start of a stretch."""
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
        """Result of the check, see config/analysis.schema.json; None if nothing is guaranteed."""
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


def promise_text(found):
    """Result of the check as text; found : as returned by Promise.figures."""
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
    verdicts = {
        True: "is kept",
        False: "is not kept",
        None: "cannot be checked with this reference",
    }
    text = f"{accuracy} {verdicts[found['kept']]}: {error} in the first {found['seconds']:.4g} s"
    if found["beyond"]:
        text += (
            ". Nothing is guaranteed after that (longer time, or a wrench): error "
            f"{found['error_of_all']:.3g} over the whole run"
        )
    return text
