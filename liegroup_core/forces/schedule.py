# SPDX-License-Identifier: Apache-2.0
"""Schedule of external wrenches: source, body, start and end.

A source applies at most one wrench to a body. A later wrench of the same source replaces it when
its time comes; a zero wrench ends it. Wrenches of different sources add. A wrench is constant in
body axes or in world axes from its start to its end. A step in which a wrench starts or ends is
split there, and the list of changes reproduces a run exactly.
"""

import bisect
import math
from typing import NamedTuple

import numpy as np

NEVER = 1 << 62  # a step that is never reached
# Decimal times and n * step are each rounded: about half a unit in the last place.
ROUNDING = 4.0 * np.finfo(float).eps
HALF_NS = 0.5e-9  # s; stamps are whole nanoseconds
LATEST = 9.2e9  # s; later stamps do not fit into 64 bits
AXES = ("body", "world")


class Instant(NamedTuple):
    """A time, and the step that contains it; instants are ordered by time."""

    step: int
    time: float  # s; step * h at the start of the step


class AppliedWrench(NamedTuple):
    """Total external wrench on a body in body axes, or that in world axes, from a time on.

    time    : s
    time_ns : the same in ns
    body    : name of the body
    wrench  : (6,) torque N m, force N; about the origin of the body frame
    axes    : "body" or "world"
    """

    time: float
    time_ns: int
    body: str
    wrench: tuple
    axes: str


class _Command(NamedTuple):
    start: Instant
    end: Instant
    number: int  # order of arrival: of two with the same start the later wins
    source: str
    body: int
    wrench: tuple
    axes: str


class WrenchSchedule:
    """External wrenches that act, and those that start later, for steps of size h in s.

    total : {"body": (n, 6), "world": (n, 6)} sums of the wrenches that act, by their axes
    """

    def __init__(self, body_count, h):
        self.total = {axes: np.zeros((body_count, 6)) for axes in AXES}
        self._h = h
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

    @property
    def waiting(self):
        """[(start in s, body number, wrench (6,), axes)] that start later."""
        return [(c.start.time, c.body, c.wrench, c.axes) for c in self._waiting]

    def act(self, source, body, wrench, axes):
        """Let a wrench (6,) act that acts already: it is no change."""
        self._arrived += 1
        wrench = tuple(float(x) for x in wrench)
        never, before = self.instant(math.inf), Instant(-1, -math.inf)
        self._acting[source, body] = _Command(
            before, never, self._arrived, source, body, wrench, axes
        )
        self.total[axes][body] = wrench

    def instant(self, time):
        """Instant of a time in s: the boundary of a step within half a ns, else whole ns."""
        if time > LATEST:
            return Instant(NEVER, math.inf)
        nearest = round(time / self._h)
        if abs(time - nearest * self._h) <= HALF_NS + ROUNDING * time:
            return self.boundary(nearest)
        time = round(time * 1e9) * 1e-9
        return Instant(math.floor(time / self._h), time)

    def boundary(self, step):
        """Instant at which a step starts."""
        return Instant(step, step * self._h)

    def command(self, source, body, wrench, start, end, axes="body"):
        """Apply `wrench` (6,) of `source` to body number `body` from one Instant to another.

        end : None: until it is replaced
        """
        self._arrived += 1
        wrench = tuple(float(x) for x in wrench)
        end = self.instant(math.inf) if end is None else end
        bisect.insort(
            self._waiting,
            _Command(start, end, self._arrived, source, body, wrench, axes),
            key=lambda c: (c.start, c.number),
        )

    def clear(self, source):
        """End all wrenches of a source, also those that start later. It takes effect with the next update."""
        self._waiting = [c for c in self._waiting if c.source != source]
        for key in [key for key in self._acting if key[0] == source]:
            self._acting[key] = self._acting[key]._replace(end=Instant(-1, -math.inf))

    def update(self, instant):
        """Make `total` the wrenches that act from an Instant on; returns [(body, axes)] that changed."""
        touched = set()
        while self._waiting and self._waiting[0].start <= instant:
            command = self._waiting.pop(0)
            key = command.source, command.body
            touched |= {(c.body, c.axes) for c in (command, self._acting.get(key)) if c}
            self._acting[key] = command
        for key, command in list(self._acting.items()):
            if command.end <= instant or not any(command.wrench):
                touched.add((command.body, command.axes))
                del self._acting[key]
        changed = []
        for body, axes in sorted(touched):
            # Summed in the order of the sources' names: the sum is bit-identical for the same wrenches.
            acting = [self._acting[key] for key in sorted(self._acting) if key[1] == body]
            wrenches = [c.wrench for c in acting if c.axes == axes]
            total = np.sum(wrenches, axis=0) if wrenches else np.zeros(6)
            if not np.array_equal(total, self.total[axes][body]):
                self.total[axes][body] = total
                changed.append((body, axes))
        return changed

    def inside(self, step):
        """Times in s inside a step at which a wrench starts or ends, in order."""
        start = self.boundary(step)
        return sorted({i.time for i in self._instants(step) if i.step == step and i > start})

    def next_change(self, step):
        """First later step that starts with a change of the wrenches, or contains one."""
        if not self:
            return NEVER
        return min((i.step for i in self._instants(step) if i.step > step), default=NEVER)

    def _instants(self, step):
        """Starts and ends up to the end of a step, and at least one later one if there is any."""
        instants = [c.end for c in self._acting.values()]
        for command in self._waiting:
            instants += command.start, command.end
            if command.start.step > step:
                break
        return instants
