# SPDX-License-Identifier: Apache-2.0
"""Check of the accuracy for which a run controlled its error (liegroup_core.accuracy).

The run guarantees an error of at most accuracy * max(1, t / horizon), also with applied wrenches, until it
reports that its estimate exceeds this, or takes a coarser accuracy to keep real time. Later errors are reported
but do not violate the guarantee. An accuracy that is requested holds from then on. Without a reference solution,
the recorded estimate is checked. A reset starts the run again. Runs that continue a snapshot or an earlier part
of a recording are not checked, because the guarantee refers to the start of the run, but errors there to the
recorded state.
"""

from itertools import pairwise

import numpy as np

from liegroup_sim_ros.numbers import counted

MOST_CHANGES = 3  # largest number of requested accuracies in a text


def periods(promise, stretch):
    """[(s since step 0, accuracy)] from which on each accuracy was in force in a stretch."""
    changes = [(step * stretch.step, accuracy) for step, accuracy in stretch.accuracies]
    return [(stretch.start * stretch.step, promise["accuracy"]), *changes]


def allowed(promise, stretch, times):
    """Errors that an accuracy allows at times (k,) in s since step 0 of a stretch."""
    accuracy = np.empty(len(times))
    for since, value in periods(promise, stretch):
        accuracy[(times > since + 0.5 * stretch.step) | (since <= stretch.start * stretch.step)] = value
    return accuracy * np.maximum(1.0, times / promise["horizon"])


class Promise:
    """Check of an accuracy, block by block.

    promise : entry of the recorded settings; None for a run with a method
    """

    def __init__(self, promise):
        self._promise = promise
        self._inside = self._known = self._all = 0.0
        self._part = self._known_part = self._sure_part = 0.0  # relative to the allowed error
        self._seconds, self._unchecked = {}, {}  # {first stamp of a stretch: s}
        self._beyond = False
        self._changes = {}  # {first stamp of a stretch: [(s of the recording, accuracy)]} requested

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
        end = stretch.inaccurate_from + 0.5 * stretch.step  # includes the sample at this time
        inside = times < end
        self._beyond |= not inside.all()
        if stretch.start != 0:
            self._unchecked[stretch.begin_ns] = float(times[-1]) - stretch.start * stretch.step
            return
        if not inside.any():
            return
        error, known = error[inside], known[inside]
        self._changes[stretch.begin_ns] = [
            (stretch.base_ns * 1e-9 + since, value)
            for (_, before), (since, value) in pairwise(periods(self._promise, stretch))
            if since < end and (value < before or since < end - stretch.step)  # there a coarser one was not requested
        ]
        self._inside = max(self._inside, float(error.max()))
        self._known = max(self._known, float(known.max()))
        most = allowed(self._promise, stretch, times[inside])
        self._part = max(self._part, float((error / most).max()))
        self._known_part = max(self._known_part, float((known / most).max()))
        self._sure_part = max(self._sure_part, float(((error - known) / most).max()))
        self._seconds[stretch.begin_ns] = float(times[inside].max())

    def figures(self, by):
        """Result of the check, see config/analysis.schema.json; None for a run with a method.

        by : what the errors are from, "reference" or "estimate"
        """
        if self._promise is None:
            return None
        kept = None
        if self._seconds:
            if max(self._part, self._known_part) <= 1.0:
                kept = True
            elif self._sure_part > 1.0:
                kept = False
        return {
            "by": by,
            "accuracy": float(self._promise["accuracy"]),
            "changes": [
                {"from_s": since, "accuracy": accuracy} for part in self._changes.values() for since, accuracy in part
            ],
            "horizon": float(self._promise["horizon"]),
            "length": float(self._promise["length"]),
            "seconds": sum(self._seconds.values()) if self._seconds else None,
            "restarts": max(0, len(self._seconds) - 1),
            "unchecked_s": sum(self._unchecked.values()),
            "error": self._inside,
            "uncertainty": self._known,
            "kept": kept,
            "beyond": self._beyond,
            "error_of_all": self._all,
        }


def promise_text(found):
    """Text with the result of the check; found : as returned by Promise.figures."""
    accuracy = f"the accuracy of {found['accuracy']:g} in {found['horizon']:g} s"
    texts = [f"{change['accuracy']:g} from {change['from_s']:.4g} s on" for change in found["changes"]]
    if texts:
        more = len(texts) - MOST_CHANGES
        texts = [*texts[:MOST_CHANGES], f"{more} more"] if more > 0 else texts
        accuracy += f" ({', '.join(texts)}, as requested)"
    if found["seconds"] is None:
        return f"{accuracy} cannot be checked: there is no {found['by']} from the start of the run"
    error = f"below {found['uncertainty']:.3g}" if found["error"] <= found["uncertainty"] else f"{found['error']:.3g}"
    verdicts = {
        True: f"is kept{found['by'] == 'estimate' and ' by this estimate' or ''}",
        False: "is not kept",
        None: f"cannot be checked with this {found['by']}",
    }
    verdict, seconds = verdicts[found["kept"]], f"{found['seconds']:.4g} s"
    span = (
        f"in {seconds} that follow the start and {counted(found['restarts'], 'reset')}"
        if found["restarts"]
        else f"in the first {seconds}"
    )
    unchecked = (
        f" ({found['unchecked_s']:.4g} s that continue an earlier state are not checked)"
        if found["unchecked_s"]
        else ""
    )
    if not found["beyond"]:
        return f"{accuracy} {verdict}: {error} {span}{unchecked}"
    larger = found["error_of_all"] > found["error"]
    then = f"a larger error: {found['error_of_all']:.3g} over the whole run" if larger else "that it is exceeded"
    return f"{accuracy} {verdict} {span}: {error}{unchecked}. Then the run itself reports {then}"
