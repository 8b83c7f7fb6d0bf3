# SPDX-License-Identifier: Apache-2.0
"""Start and end times of the scene's applied wrenches, in steps and inside steps.

A time inside a step splits the step: the integration stops there and continues with the new
wrenches, so that the impulse is exact and a method keeps its order. Times of steps and samples do
not change. A time within round-off of a step boundary is that boundary.
"""

from bisect import bisect_right

import numpy as np

from .schedule import NEVER, ROUNDING


def acting_at(rows, time):
    """Mask (k,) of the applied wrenches that act at a time."""
    return (rows["start"] <= time) & (time < rows["end"])


class Timetable:
    """Starts and ends of the scene's applied wrenches, for steps of a given size."""

    def __init__(self, rows, step):
        self._rows = rows
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

    def inside(self, steps):
        """Times in s inside a step at which a wrench starts or ends."""
        return self._inside.get(steps, ())

    def acting(self, start, duration):
        """Mask (k,) of the wrenches that act over a part of a step."""
        # The middle is away from all starts and ends: round-off has no influence.
        return acting_at(self._rows, start + 0.5 * duration)
