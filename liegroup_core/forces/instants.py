# SPDX-License-Identifier: Apache-2.0
"""Instants at which inputs change: a step, and what has passed of it, exact at any time.

Floats of seconds lie 1.5e-11 s apart at t = 1e5 s: a push of 1 us between two of them would act too long
or too short by up to 1e-5. Parts of a step are differences of offsets from its start instead, and these
are exact numbers of ns.

The size of a step is exact here, too: the simplest fraction within rounding of its float, 1/1000 s for
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
# Decimal times and n * step are each rounded: about half a unit in the last place.
ROUNDING = 4.0 * np.finfo(float).eps
LATEST = 9.2e9  # s; later stamps do not fit into 64 bits


class Instant(NamedTuple):
    """A time in a step. Instants of the same steps are ordered by time."""

    step: int
    offset: Rational  # since the start of the step, exact, in the unit of StepGrid
    time: float  # s


_instant = partial(tuple.__new__, Instant)  # in half the time: every step begins with one
BEFORE, AFTER = Instant(-1, 0, -math.inf), Instant(NEVER, 0, math.inf)  # all others


def _rounding(time):
    """Rounding in ns of a time in s that was computed; 0 of an exact one."""
    return ROUNDING * abs(time) * NS if isinstance(time, float) else 0


def _whole(numerator, denominator):
    """Whole number nearest to a ratio, the even one of two, as `round`."""
    whole, rest = divmod(2 * numerator + denominator, 2 * denominator)
    return whole - whole % 2 if rest == 0 else whole


@lru_cache
def exact_step(h):
    """Size of a step in ns, a ratio, from the float in s: the simplest fraction within its rounding."""
    given = Fraction(h)
    simple = (given.limit_denominator(10**digits) for digits in range(17))
    # The step of a companion is a product of two rounded numbers.
    found = next((s for s in simple if abs(s - given) <= ROUNDING / 2 * given), given)
    return (found * NS).as_integer_ratio()


class StepGrid:
    """Instants of steps of size h in s.

    Their offsets are in a part of a ns, of which a step has a whole number: 1 ns for 1e-3 s, 1/3 ns for
    1/750 s.
    """

    def __init__(self, h):
        self._h = h
        self._size, self._parts = exact_step(h)

    def boundary(self, step):
        """Instant at which a step starts."""
        return _instant((step, 0, step * self._h))

    def end(self, step, part=1):
        """Instant at the end of a step, or of a part of it, as an Instant of this step."""
        size = self._size if part == 1 else Fraction(part) * self._size
        return Instant(step, size, (step + part) * self._h)

    def between(self, begin, end):
        """Time in s from one Instant to another of the same step, rounded once."""
        return float((end.offset - begin.offset) / (self._parts * NS))

    def time_ns(self, instant):
        """Time in whole ns."""
        return _whole(instant.step * self._size + instant.offset, self._parts)

    def instant(self, time):
        """Instant of a time in s, a float or exact Fraction: a boundary within half a ns, else whole ns."""
        if float(time) > LATEST:
            return AFTER
        numerator, denominator = time.as_integer_ratio()
        return self._nearest(numerator * NS, denominator, _rounding(time))

    def after(self, instant, duration):
        """Instant after a duration in s, as `instant`."""
        if instant.time + duration > LATEST:
            return AFTER
        begin = instant.step * self._size + instant.offset
        numerator, denominator = duration.as_integer_ratio()
        numerator = begin * denominator + numerator * NS * self._parts
        return self._nearest(numerator, denominator * self._parts, _rounding(duration))

    def scene_instant(self, time):
        """Instant of a time of a scene in s: the boundary of a step within rounding, else the decimal."""
        if not math.isfinite(time):
            return AFTER if time > 0.0 else BEFORE
        decimal = Fraction(repr(time)) * NS
        step, miss = self._nearest_boundary(*decimal.as_integer_ratio())
        if miss <= _rounding(time):
            return self.boundary(step)
        return Instant(*divmod(decimal * self._parts, self._size), time)

    def _nearest(self, numerator, denominator, rounding):
        """Instant of a time, a ratio in ns, that was computed with a rounding of so many ns."""
        whole = _whole(numerator, denominator)
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
