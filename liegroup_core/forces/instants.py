# SPDX-License-Identifier: Apache-2.0
"""Instants at which inputs change: the number of a step and an exact offset from its start.

At t = 1e5 s, consecutive floats of seconds are 1.5e-11 s apart, so the duration of a wrench of 1 us would
have a relative error of up to 1e-5. Instead, durations within a step are differences of offsets from its
start, which are exact numbers of ns.

The size of a step is exact as well: the simplest fraction within the rounding of its float, 1/1000 s for
1e-3 and 1/750 s for 4/3 of it.
"""

import math
from fractions import Fraction
from functools import lru_cache, partial
from numbers import Rational
from typing import NamedTuple

import numpy as np

NS = 10**9  # in a second
NEVER = 1 << 62  # a step that is never reached
NOT_AHEAD = (-1.0, 0.0)  # whole steps and s after them, of a method that does not run ahead
# Decimal times and n * step are each rounded, by about half a unit in the last place.
ROUNDING = 4.0 * np.finfo(float).eps
LATEST = 9.2e9  # s; later stamps do not fit into 64 bits
EARLY = 1e5  # s; up to here a time in ns, as a float, has an error below 0.02 ns


class Instant(NamedTuple):
    """A time within a step. Instants of the same StepGrid are ordered by time."""

    step: int
    offset: Rational  # since the start of the step, exact, in the unit of StepGrid
    time: float  # s


_instant = partial(tuple.__new__, Instant)  # takes half the time; every step creates one
BEFORE, AFTER = Instant(-1, 0, -math.inf), Instant(NEVER, 0, math.inf)  # before and after all others


def just_after(time):
    """Time in s slightly after `time`, at which an input that starts at `time` acts despite rounding."""
    return time * (1.0 + ROUNDING)


def _rounding(time):
    """Rounding error in ns of a computed time in s; 0 for an exact one."""
    return ROUNDING * abs(time) * NS if isinstance(time, float) else 0


def nearest_whole(numerator, denominator):
    """Whole number nearest to a ratio; of two equally near ones the even one, as `round`."""
    whole, rest = divmod(2 * numerator + denominator, 2 * denominator)
    return whole - whole % 2 if rest == 0 else whole


@lru_cache
def exact_step(h):
    """Size of a step in ns as a ratio: the simplest fraction within the rounding of the float in s."""
    given = Fraction(h)
    simple = (given.limit_denominator(10**digits) for digits in range(17))
    # The step of a companion run is a product of two rounded numbers.
    found = next((s for s in simple if abs(s - given) <= ROUNDING / 2 * given), given)
    return (found * NS).as_integer_ratio()


def exact_seconds(time):
    """Time in s as a Fraction: the simplest one within the rounding of its float."""
    size, parts = exact_step(time) if time else (0, 1)
    return Fraction(size, parts * NS)


class StepGrid:
    """Instants of steps of size h in s.

    The unit of their offsets is a fraction of a ns of which a step is a whole multiple: 1 ns for 1e-3 s,
    1/3 ns for 1/750 s.
    """

    def __init__(self, h):
        self._h = h
        self._size, self._parts = exact_step(h)

    def boundary(self, step):
        """Instant at which a step starts."""
        return _instant((step, 0, step * self._h))

    def has(self, offset):
        """Whether an offset is within a step."""
        return 0 <= offset < self._size

    def at(self, step, offset):
        """Instant of an exact offset from the start of a step, in the unit of offsets."""
        whole, offset = divmod(offset, self._size)
        step += whole
        if offset == 0:
            return self.boundary(step)
        time = Fraction(step * self._size + offset, self._parts * NS)
        return Instant(step, offset, time.numerator / time.denominator)

    def inside(self, step, part):
        """Instant of an exact fraction of a step."""
        return self.at(step, part * self._size)

    def like(self, grid, instant):
        """Instant of another StepGrid in this one, within half a ns if their steps differ."""
        same = (grid._size, grid._parts) == (self._size, self._parts)
        return instant if same else self.marked(grid.mark(instant))

    def between(self, begin, end):
        """Time in s between two Instants, rounded once; inf to AFTER."""
        return math.inf if end.step >= NEVER else float(self.since(begin, end) / (self._parts * NS))

    def since(self, begin, end):
        """Exact time from one Instant to another, in the unit of offsets."""
        return (end.step - begin.step) * self._size + end.offset - begin.offset

    def parts(self, instant):
        """(whole steps, s after them, rounded once) of an Instant; (inf, 0.0) of none."""
        if instant.step >= NEVER:
            return math.inf, 0.0
        return instant.step, float(instant.offset / (self._parts * NS)) if instant.offset else 0.0

    def time_ns(self, instant):
        """Time in whole ns."""
        return nearest_whole(instant.step * self._size + instant.offset, self._parts)

    def mark(self, instant):
        """Time of an Instant in ns, from which `marked` finds it in any grid: whole, if it is at a whole ns."""
        time_ns = self.time_ns(instant)
        return time_ns if abs(time_ns / NS - instant.time) <= ROUNDING * instant.time else instant.time * NS

    def marked(self, time_ns):
        """Instant of a time in ns, see `mark`."""
        if not isinstance(time_ns, int):
            return self.instant(time_ns / NS)
        if time_ns > LATEST * NS:
            return AFTER
        step, passed = divmod(time_ns * self._parts, self._size)
        if 2 * passed <= self._parts:
            return self.boundary(step)
        if 2 * (self._size - passed) <= self._parts:
            return self.boundary(step + 1)
        return _instant((step, passed, time_ns / NS))

    def instant(self, time):
        """Instant of a time in s (float or exact Fraction): a step boundary within half a ns, else a whole ns."""
        if type(time) is float and 0.0 <= time < EARLY:
            near = round(time * NS)
            if abs(time * NS - near) < 0.48:
                return self.marked(near)
        if float(time) > LATEST:
            return AFTER
        numerator, denominator = time.as_integer_ratio()
        return self._nearest(numerator * NS, denominator, _rounding(time))

    def after(self, instant, duration):
        """Instant a duration in s after an Instant; rounded as by `instant`."""
        if instant.time + duration > LATEST:
            return AFTER
        begin = instant.step * self._size + instant.offset
        numerator, denominator = duration.as_integer_ratio()
        numerator = begin * denominator + numerator * NS * self._parts
        return self._nearest(numerator, denominator * self._parts, _rounding(duration))

    def scene_instant(self, time):
        """Instant of a time of a scene in s: a step boundary within rounding, else exactly the decimal."""
        if not math.isfinite(time):
            return AFTER if time > 0.0 else BEFORE
        decimal = Fraction(repr(time)) * NS
        step, miss = self._nearest_boundary(*decimal.as_integer_ratio())
        if miss <= _rounding(time):
            return self.boundary(step)
        return Instant(*divmod(decimal * self._parts, self._size), time)

    def _nearest(self, numerator, denominator, rounding):
        """Instant of a time, a ratio in ns, with a rounding error of `rounding` ns."""
        whole = nearest_whole(numerator, denominator)
        for *ratio, slack in ((numerator, denominator, rounding), (whole, 1, 0.5)):
            step, miss = self._nearest_boundary(*ratio)
            if miss <= slack:
                return self.boundary(step)
        return Instant(*divmod(whole * self._parts, self._size), whole / NS)

    def _nearest_boundary(self, numerator, denominator):
        """(step, distance in ns) of the boundary that is nearest to a time, a ratio in ns."""
        size = self._size * denominator
        step, passed = divmod(numerator * self._parts, size)
        if 2 * passed > size:
            step, passed = step + 1, size - passed
        return step, passed / (denominator * self._parts)
