# SPDX-License-Identifier: Apache-2.0
"""Times at which inputs of the scene change, at step boundaries and inside steps.

These are starts and ends of applied wrenches, and times at which a prescribed motion passes to its next
polynomial. A time inside a step splits the step: the integration stops there and continues with the new
inputs, so that the impulse is exact and a method keeps its order. Times of steps and samples do not
change. A time within round-off of a step boundary counts as that boundary.
"""

from bisect import bisect_right

import numpy as np

from .instants import AFTER, NEVER, ROUNDING


def acting_at(rows, time):
    """Mask (k,) of the applied wrenches that act at a time."""
    return (rows["start"] <= time) & (time < rows["end"])


def just_after(time):
    """Time in s slightly after `time`, at which an input that starts at `time` acts despite rounding."""
    return time * (1.0 + ROUNDING)


class Timetable:
    """Changes of the inputs of a scene.

    rows    : records of the scene's applied wrenches
    grid    : StepGrid of the steps
    motions : [(m, 7)] prescribed motions of each driven joint, see joints/motion.py
    """

    def __init__(self, rows, grid, motions=()):
        times = [rows["start"], rows["end"], *(motion[1:, 0] for motion in motions)]
        instants = {time: grid.scene_instant(time) for time in np.concatenate(times).tolist()}
        self._instants = sorted(set(instants.values()))
        number = {instant: i for i, instant in enumerate(self._instants)}
        # Numbers of the instants at which each wrench starts and ends.
        self._starts, self._ends = (
            np.array([number[instants[time]] for time in rows[key].tolist()], dtype=np.int64)
            for key in ("start", "end")
        )
        self._inside = {}  # step number -> Instants inside that step
        for instant in self._instants:
            if instant.offset:
                self._inside.setdefault(instant.step, []).append(instant)
        self._changes = sorted({i.step for i in self._instants if i.step < NEVER})

    def next_change(self, steps):
        """First later step that starts with a change of the inputs, or is split by one."""
        at = bisect_right(self._changes, steps)
        return self._changes[at] if at < len(self._changes) else NEVER

    def __bool__(self):
        return bool(self._instants)

    def next_after(self, instant):
        """First later Instant at which an input changes."""
        at = bisect_right(self._instants, instant)
        return self._instants[at] if at < len(self._instants) else AFTER

    def inside(self, steps):
        """Instants inside a step at which an input changes."""
        return self._inside.get(steps, ())

    def acting(self, instant):
        """Mask (k,) of the wrenches that act from an Instant on."""
        passed = bisect_right(self._instants, instant)
        return (self._starts < passed) & (passed <= self._ends)
