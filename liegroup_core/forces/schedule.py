# SPDX-License-Identifier: Apache-2.0
"""Schedule of external wrenches: source, body, first step and duration in steps.

A source applies at most one wrench to a body. A later wrench of the same source replaces it when
its time comes; a zero wrench ends it. Wrenches of different sources add. Changes take effect at
step boundaries: a wrench is constant over whole steps and their stages, and the list of changes
reproduces a run exactly. A wrench in world axes is rotated into body axes at the start of every
step.
"""

import bisect
from typing import NamedTuple

import numpy as np

NEVER = 1 << 62  # a step that is never reached


class AppliedWrench(NamedTuple):
    """Total external wrench on a body from a step on.

    step   : first step over which it acts
    body   : name of the body
    wrench : (6,) torque N m, force N; body axes, about the body frame's origin
    """

    step: int
    body: str
    wrench: tuple


class _Command(NamedTuple):
    start: int
    end: int
    number: int  # order of arrival: of two at the same step the later wins
    source: str
    body: int
    wrench: tuple
    in_world: bool  # axes of the world, not of the body


class WrenchSchedule:
    """External wrenches that act, and those that start later; times in steps."""

    def __init__(self, body_count):
        self.total = np.zeros((body_count, 6))
        self._waiting = []
        self._acting = {}
        self._arrived = 0

    def __len__(self):
        """Number of wrenches that act or start later."""
        return len(self._waiting) + len(self._acting)

    @property
    def sources(self):
        """Names of the sources with a wrench that acts or starts later."""
        return {c.source for c in (*self._waiting, *self._acting.values())}

    def command(self, source, body, wrench, start, end, in_world=False):
        """Apply `wrench` (6,) of `source` to body number `body` over the steps start <= k < end."""
        self._arrived += 1
        wrench = tuple(float(x) for x in wrench)
        bisect.insort(
            self._waiting,
            _Command(start, end, self._arrived, source, body, wrench, in_world),
            key=lambda c: (c.start, c.number),
        )

    def clear(self, source):
        """End all wrenches of a source, also those that start later. It takes effect with the next update."""
        self._waiting = [c for c in self._waiting if c.source != source]
        for key in [key for key in self._acting if key[0] == source]:
            self._acting[key] = self._acting[key]._replace(end=0)

    def update(self, step, pose):
        """Make `total` the wrenches of this step; return the bodies whose sum changed.

        pose : (n, 12) at the start of the step
        """
        if not self._waiting and not self._acting:
            return ()
        touched = {c.body for c in self._acting.values() if c.in_world}
        while self._waiting and self._waiting[0].start <= step:
            command = self._waiting.pop(0)
            touched.add(command.body)
            self._acting[command.source, command.body] = command
        for key, command in list(self._acting.items()):
            if command.end <= step or not any(command.wrench):
                touched.add(command.body)
                del self._acting[key]
        changed = []
        for body in sorted(touched):
            # Summed in the order of the sources' names: the sum is bit-identical for the same wrenches.
            acting = [
                _in_body_axes(self._acting[key], pose[body])
                for key in sorted(self._acting)
                if key[1] == body
            ]
            total = np.sum(acting, axis=0) if acting else np.zeros(6)
            if not np.array_equal(total, self.total[body]):
                self.total[body] = total
                changed.append(body)
        return changed

    def next_change(self, step):
        """First later step at which a wrench starts, ends or is rotated with its body."""
        if not self._waiting and not self._acting:
            return NEVER
        starts = [c.start for c in self._waiting[:1]]
        ends = [step + 1 if c.in_world else c.end for c in self._acting.values()]
        return min(starts + ends, default=NEVER)


def _in_body_axes(command, pose):
    """(6,) wrench of a command in the axes of its body, whose pose is (12,)."""
    if not command.in_world:
        return command.wrench
    return (np.reshape(command.wrench, (2, 3)) @ pose[:9].reshape(3, 3)).ravel()
