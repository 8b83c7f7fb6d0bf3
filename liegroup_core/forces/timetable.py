# SPDX-License-Identifier: Apache-2.0
"""Start and end times of the scene's applied wrenches, in steps and parts of steps.

A time inside a step splits the step: the integration stops there and continues with the new
wrenches, so that the impulse is exact and a method keeps its order. Times of steps and samples do
not change. A time within round-off of a step boundary is that boundary.
"""

from bisect import bisect_right

import numpy as np

from .schedule import NEVER

# Decimal times and n * step are each rounded: about half a unit in the last place.
ROUNDING = 4.0 * np.finfo(float).eps


def acting_at(rows, time):
    """Mask (k,) of the applied wrenches that act at a time."""
    return (rows["start"] <= time) & (time < rows["end"])


class Timetable:
    """Starts and ends of the scene's applied wrenches, for steps of a given size."""

    def __init__(self, rows, step):
        self._rows, self._step = rows, step
        self._no_change = [(step, np.zeros(0, dtype=bool))]
        self._inside = {}  # step number -> times inside that step
        changes = set()
        for time in np.unique([rows["start"], rows["end"]]):
            if not np.isfinite(time):
                continue
            nearest = round(time / step)
            if abs(time - nearest * step) <= ROUNDING * time:
                changes.add(nearest)
                continue
            before = nearest - (nearest * step > time)
            self._inside.setdefault(before, []).append(float(time))
            changes.add(before)
        self._changes = sorted(changes)

    def next_change(self, steps):
        """First later step that is split, or from which other wrenches act."""
        at = bisect_right(self._changes, steps)
        return self._changes[at] if at < len(self._changes) else NEVER

    def parts(self, steps):
        """Parts of a step over which the same wrenches act: [(duration, acting)]."""
        if not len(self._rows):
            return self._no_change
        inside = self._inside.get(steps, ())
        ends = [steps * self._step, *inside, (steps + 1) * self._step]
        durations = np.diff(ends).tolist() if inside else [self._step]
        # The middle of a part is away from all starts and ends: round-off has no influence.
        return [
            (duration, acting_at(self._rows, start + 0.5 * duration))
            for duration, start in zip(durations, ends)
        ]
