# SPDX-License-Identifier: Apache-2.0
"""Times at which inputs of the scene change, in steps and inside steps.

Applied wrenches start and end, and prescribed motions go on to the next one. A time inside a step
splits the step: the integration stops there and continues with the new inputs, so that the impulse is
exact and a method keeps its order. Times of steps and samples do
not change. A time within round-off of a step boundary is that boundary.
"""

from bisect import bisect_right

import numpy as np

from .schedule import NEVER, ROUNDING


def acting_at(rows, time):
    """Mask (k,) of the applied wrenches that act at a time."""
    return (rows["start"] <= time) & (time < rows["end"])


def just_after(time):
    """A time in s at which an input that starts at `time`, computed otherwise, acts already."""
    return time * (1.0 + ROUNDING)


class Timetable:
    """Changes of the inputs of a scene, for steps of a given size.

    rows    : of the scene's applied wrenches
    motions : [(m, 7)] prescribed motions of each driven joint, see joints/motion.py
    """

    def __init__(self, rows, step, motions=()):
        self._rows = rows
        times = [rows["start"], rows["end"], *(motion[1:, 0] for motion in motions)]
        self._inside = {}  # step number -> times inside that step
        changes = set()
        for time in np.unique(np.concatenate(times)):
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
        """First later step that is split, or from which other inputs hold."""
        at = bisect_right(self._changes, steps)
        return self._changes[at] if at < len(self._changes) else NEVER

    def inside(self, steps):
        """Times in s inside a step at which an input changes."""
        return self._inside.get(steps, ())

    def acting(self, start, duration):
        """Mask (k,) of the wrenches that act over a part of a step."""
        # The middle is away from all starts and ends: round-off has no influence.
        return acting_at(self._rows, start + 0.5 * duration)
