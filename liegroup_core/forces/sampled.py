# SPDX-License-Identifier: Apache-2.0
"""Sampled laws: controllers that read a state at exact instants, and hold what they compute until the next one.

Instants are the multiples k T of the period, as exact fractions rounded to whole ns, as for functions in Python
(control.py). At one of them

    y_k = g(x_k, u_k)    signals and outputs        x_k+1 = f(x_k, u_k)    states

Outputs act from k T + delay on, so that ceil(delay / T) sets of them wait; until the first one they are 0. Signals and
states are those of the last instant. All these numbers are kept behind the unwrapped angles of a run (Work.angle), so
each of two runs for an estimate of the error evaluates a law on its own state, and a state that is set, saved or
recorded has them. They are constant in a step, which ends where they change.

At an instant at which outputs of several laws start and laws are evaluated, outputs come first, then laws in order. So
a state at an instant is one after it: what stands there has passed it.
"""

import bisect
import math
from fractions import Fraction

import numpy as np

from .instants import AFTER, BEFORE, NS, exact_seconds, nearest_whole
from .kinds import registers_at
from .law import sample, sampled_laws, times_of_kinks, undefined_text


class _Times:
    """Instants of the multiples of a period, from a first time on; grid : StepGrid."""

    def __init__(self, period, first, grid):
        self._period, self._first, self._grid = float(period), float(first), grid
        # Numbers of ns as ratios of whole numbers: an Instant of a Fraction takes ten times as long.
        self._parts = math.lcm((first * NS).denominator, (period * NS).denominator)
        self._begin, self._size = (int(each * NS * self._parts) for each in (first, period))
        self._last, self._next, self._number = BEFORE, self._at(0), 0

    def _at(self, number):
        return self._grid.marked(nearest_whole(self._begin + number * self._size, self._parts))

    def after(self, now):
        """The first one after an Instant."""
        if not self._last <= now < self._next:
            if self._last <= now:
                self._go_on()
            if not self._last <= now < self._next:
                passed = (now.time - self._first) / self._period
                self._number = max(0, int(passed) - 1)  # round-off of the time is below one period
                self._last, self._next = BEFORE, self._at(self._number)
            while self._next <= now:
                self._go_on()
        return self._next

    def _go_on(self):
        self._number += 1
        self._last, self._next = self._next, self._at(self._number)

    def has(self, now):
        """Whether an Instant is one of them."""
        self.after(now)
        return self._last == now


class _Known:
    """Instants of times in s, in order; methods as _Times."""

    def __init__(self, times, grid):
        self._instants = [BEFORE, *map(grid.scene_instant, times), AFTER]

    def after(self, now):
        number = bisect.bisect_right(self._instants, now)
        self._last = self._instants[number - 1]
        return self._instants[number]

    has = _Times.has


def _undefined(each, values, time):
    """Text on states or outputs of a sampled law that are not finite, or ""."""
    if np.isfinite(values).all():
        return ""
    law, names = each.law, each.law._names_held()
    first, end = len(law.states), len(law.states) + len(law.signals)
    lost = np.flatnonzero(~np.isfinite(values))
    results = lost[(lost < first) | (lost >= end)]
    if not len(results):
        return ""
    cause = [names[k] for k in lost if first <= k < end]
    return undefined_text(law.name, names[results[0]], values[results[0]], time, "".join(cause[:1]))


class Sampling:
    """Sampled laws of a Layout on the StepGrid of a run, and the times at which others change by the time alone.

    are_located : whether the changes of laws are located. Steps end at those that are known, so none is too short
    """

    def __init__(self, layout, grid, are_located=False):
        self._forces, self._laws = layout.model.forces, sampled_laws(layout.centred.forces, layout.scene.sensors)
        self._grid = grid
        self._samples, self._starts = [], []  # _Times, the latter None without a delay
        for each in self._laws:
            period, delay = exact_seconds(each.law.period), exact_seconds(each.law.delay)
            self._samples.append(_Times(period, Fraction(0), grid))
            self._starts.append(_Times(period, delay % period, grid) if each.delayed else None)
        self._times = [each for each in (*self._samples, *self._starts) if each is not None]
        if are_located and (known := times_of_kinks(layout.centred.forces)):
            self._times.append(_Known(known, grid))

    def __bool__(self):
        return bool(self._times)

    @property
    def holds(self):
        """Whether there are sampled laws."""
        return bool(self._laws)

    def after(self, now):
        """First Instant after one at which held numbers change."""
        return min(each.after(now) for each in self._times)

    def last(self, now):
        """Time in s of the last Instant up to one at which held numbers changed; -inf before the first."""
        found = BEFORE
        for each in self._times:
            each.after(now)
            found = max(found, each._last)
        return found.time

    def has(self, now):
        """Whether held numbers change at an Instant."""
        return any(each.has(now) for each in self._times)

    def between(self, begin, end, most):
        """Times in s of the Instants between two at which held numbers change; none if there are more than `most`."""
        found = []
        while self and (begin := self.after(begin)) < end:
            found.append(begin.time)
            if len(found) > most:
                return []
        return found

    def meet(self, now, angles, pose, twist):
        """Let outputs start, and evaluate laws, that are due at an Instant, in a state at the centres of mass.

        angles : as Work.angle, in which the held numbers change
        returns the first number that is not finite, in one line, or ""
        """
        undefined = ""
        for each, times in zip(self._laws, self._starts):
            if times is not None and times.has(now):
                own = self._own(each, angles)
                waiting = own[len(own) - (1 + each.delayed) * each.outputs :]
                waiting[: len(waiting) - each.outputs] = waiting[each.outputs :].copy()
        laws = self._forces.laws
        for each, times in zip(self._laws, self._samples):
            if times.has(now):
                registers = registers_at(self._forces, now.time, angles)
                inputs = laws.sampled_inputs[each.inputs]
                noise = np.zeros(len(inputs))
                for k, sensor, number in each.noisy:
                    noise[k] = sensor.noise_at(self._grid.time_ns(now))[number]
                sample(laws, inputs, noise, laws.sampled_code[each.code], angles, pose, twist, registers)
                values, own = registers[each.found, 0], self._own(each, angles)
                shown = len(values) - each.outputs
                own[:shown] = values[:shown]
                own[len(own) - each.outputs :] = values[shown:]
                undefined = undefined or _undefined(each, values, now.time)
        return undefined

    def _own(self, each, angles):
        """View of the numbers of a law: states, signals, outputs, then those that wait, the oldest first.

        As one set starts in each period from 0 on, a set that is computed waits in the last place.
        """
        first = len(self._forces.counted) + each.first
        return angles[first : first + len(each.found) + each.delayed * each.outputs]
