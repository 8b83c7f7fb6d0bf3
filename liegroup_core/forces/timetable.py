# SPDX-License-Identifier: Apache-2.0
"""When the applied wrenches of a scene start and end, counted in steps and parts of steps.

A time that falls inside a step splits it: the integration stops there and goes on with the other
wrenches, so the impulse is exact and a method keeps its order. Steps and samples stay where they
are. A time that is a step up to rounding is that step.
"""

from bisect import bisect_right

import numpy as np

from .schedule import NEVER

# Times typed in decimals and n * step are each off by half a unit in the last place or so.
ROUNDING = 4.0 * np.finfo(float).eps


def acting_at(rows, time):
    """Which rows of applied_wrench act at a time, (k,) bool."""
    return (rows["start"] <= time) & (time < rows["end"])


class Timetable:
    """The starts and ends of rows of applied_wrench, for steps of a given size."""

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
        """The first step after this one that is split, or from which other wrenches act."""
        at = bisect_right(self._changes, steps)
        return self._changes[at] if at < len(self._changes) else NEVER

    def parts(self, steps):
        """A step in parts over which the same wrenches act: [(duration, acting)]."""
        if not len(self._rows):
            return self._no_change
        inside = self._inside.get(steps, ())
        ends = [steps * self._step, *inside, (steps + 1) * self._step]
        durations = np.diff(ends).tolist() if inside else [self._step]
        # In the middle of a part no rounding decides what acts.
        return [
            (duration, acting_at(self._rows, start + 0.5 * duration))
            for duration, start in zip(durations, ends)
        ]
