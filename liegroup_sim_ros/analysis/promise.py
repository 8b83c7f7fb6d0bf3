# SPDX-License-Identifier: Apache-2.0
"""Check of the accuracy that a run kept by its own estimate (liegroup_core.accuracy).

The run promises an error of at most accuracy * max(1, t / horizon), through applied wrenches, until it
says itself that this has ended. Later errors are reported but do not violate it.
"""

import numpy as np


class Promise:
    """Check of an accuracy, block by block.

    promise : entry of the recorded settings; None: the run had a method
    """

    def __init__(self, promise):
        self._promise = promise
        self._inside = self._known = self._all = 0.0
        self._part = self._known_part = self._sure_part = 0.0  # of the promised error
        self._seconds, self._beyond = None, False

    def add(self, stretch, times, error, uncertainty):
        """Add error and uncertainty, two Distances at k times in s since the start of a stretch."""
        if self._promise is None:
            return
        error, known = (
            np.maximum(found.position / self._promise["length"], found.angle).max(axis=1)
            for found in (error, uncertainty)
        )
        self._all = max(self._all, float(error.max()))
        times = np.asarray(times)
        # Errors of a later part of a recording count from its start, the promise does not.
        end = stretch.inaccurate_from + 0.5 * stretch.step  # with the sample of that time
        inside = (times < end) & (stretch.start == 0)
        self._beyond |= not inside.all()
        if not inside.any():
            return
        error, known = error[inside], known[inside]
        allowed = self._promise["accuracy"] * np.maximum(
            1.0, times[inside] / self._promise["horizon"]
        )
        self._inside = max(self._inside, float(error.max()))
        self._known = max(self._known, float(known.max()))
        self._part = max(self._part, float((error / allowed).max()))
        self._known_part = max(self._known_part, float((known / allowed).max()))
        self._sure_part = max(self._sure_part, float(((error - known) / allowed).max()))
        self._seconds = max(self._seconds or 0.0, float(times[inside].max()))

    def figures(self):
        """Result of the check, see config/analysis.schema.json; None if nothing is promised."""
        if self._promise is None:
            return None
        kept = None
        if self._seconds is not None:
            if max(self._part, self._known_part) <= 1.0:
                kept = True
            elif self._sure_part > 1.0:
                kept = False
        return {
            "accuracy": float(self._promise["accuracy"]),
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
    accuracy = f"the accuracy of {found['accuracy']:g} in {found['horizon']:g} s"
    if found["seconds"] is None:
        return f"{accuracy} cannot be checked: there is no reference from the start of the run"
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
    verdict, span = verdicts[found["kept"]], f"in the first {found['seconds']:.4g} s"
    if not found["beyond"]:
        return f"{accuracy} {verdict}: {error} {span}"
    return (
        f"{accuracy} {verdict} {span}: {error}. Then the run itself reports a larger error: "
        f"{found['error_of_all']:.3g} over the whole run"
    )
