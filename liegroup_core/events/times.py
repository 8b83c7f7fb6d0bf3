# SPDX-License-Identifier: Apache-2.0
"""Times of the events of stops, dry friction and laws, as those of contacts: zeros of guards within a substep.

Steps of the method from the start of the substep to a variable time give the guard at that time. So an
event is as accurate as the method.
"""

import functools
import math

import numpy as np
import scipy

from liegroup_core.dynamics.switches import AT_STOP, LEAST, LOWER, RESTING, SLIDING, UPPER
from liegroup_core.forces.law import may_be_beyond
from liegroup_core.mechanism.arrays import COORDINATE, NODES, SIDE, WATCHED
from liegroup_core.status import OK

from .crossings import END, PARTS, START, lowest
from .mode_changes import ModeChanges

TIME_PART = 1e-13  # tolerance of an event's time, relative to the substep
# The same at bends of contacts. A state that is late by a part p of a substep is off by p times a jump of its rates;
# here, where both branches leave each other slowly, by p^2 / 2 times their change.
BEND_PART = math.sqrt(TIME_PART)
NOTED = -1.0  # of Work.watch: guards of stages are kept, but no event ends the step
TRIES = 4  # steps from an expected time, see `_soon_after`
# Coefficients of a polynomial, the highest first, from its values at the ends of the parts of a substep.
COEFFICIENTS = np.linalg.pinv(np.vander(np.arange(PARTS + 1) / PARTS, NODES))
DIGIT = 2.0**-52  # round-off of a gap, relative to the characteristic length plus |stop|
SAME_TIME, SAME_PART = 1e-14, 1e-9  # s, and relative to a step; events that are closer count as one
SHRINKS, MOST_LOOKS = 10, 400  # by 16, to 1e-12 of a substep
APART = 1e3  # times of two zeros, by linear interpolation, in units of `same_time`
# Points of an interpolation; part of the first interval within which residuals decrease by far more than half, unless
# they are round-off.
MOST_POINTS, ROUND_OFF_PART, FURTHER = 5, 1e-11, 8.0
# Relative to the substep: range in which the smallest effort is sought, and its tolerance.
NEAR, PRECISE = 0.2, 1e-3
BEFORE, AFTER = 0.8, 1.25  # relative to the expected time of a zero: the interval that is tried first
NEWTON = 6  # steps; if they do not converge, the start is too far away


class EventTimes(ModeChanges):
    """Times of events, by steps of a Munthe-Kaas method.

    take    : function (h, steps, pose, twist, external) -> (steps done, status)
    step    : the same, without error control
    control : SubstepControl
    weights : function () -> weights of the stages of the present method, see crossings.rows_and_weights

    parts   : number of steps up to an event. The event's time sets their size; another number of parts
              shows their error, see RunningError
    """

    def __init__(self, model, work, take, step, control, weights):
        super().__init__(model, work)
        self._take, self._step, self._control, self._weights, self.parts = take, step, control, weights, 1
        self.same_time = SAME_TIME
        self._all_modes = work.held, work.modes, work.branches
        table = model.switches
        # A guard whose initial value is below this starts at its zero.
        self._at_zero, self._digit = np.zeros((2, len(work.guards), 5))
        for end, stop in ((LOWER, table["lower"]), (UPPER, table["upper"])):
            far = np.where(np.isfinite(stop), np.abs(stop), 0.0)
            self._at_zero[: len(table), end] = AT_STOP * (self._unit + far)
            self._digit[: len(table), end] = DIGIT * (self._unit + far)
        self._at_zero[: len(table), SLIDING] = RESTING * self._unit
        # s: when a compliant stop is left, its pressure vanishes this long before its depth.
        self._lag = table["damping"] / np.where(self._rigid, np.inf, table["stiffness"])

    def _locate(self, size, state):
        """Go to the first zero of a guard in a substep.

        returns (time after its start, mask of the guards that are zero there, status); without an
        event the mask is None, and the whole substep is taken
        """
        work = self._work
        places, kept = work.crossed.copy(), self._keep(*state[:2])
        course = self._course(size, state, kept) if (places[len(work.modes) :] == 1.0).any() else None
        failed, reached = [], [-1.0, None]  # time of the present state, and the branches there

        @functools.cache
        def seen(tau):
            """(guards, coordinates, rates and accelerations) at a time."""
            self._return(kept, *state[:2])
            status = self._single(tau, state) if tau > 0.0 else OK
            if status != OK:
                failed.append(status)
                return np.full_like(work.guards, np.nan), None, None
            reached[:] = tau, work.branches.copy()
            work.clock.now[0] = work.clock.offset[0] + tau  # not that of the last trial
            self._look(self._model, work, *state)
            return work.guards.copy(), work.modes[:, COORDINATE].copy(), work.now.copy()

        def guard(tau, k, c):
            """A guard; for a rigid stop or a branch relative to its initial value, if that is beyond the end."""
            start = min(seen(0.0)[0][k, c], 0.0) if self._may_be_beyond(k, c) else 0.0
            return seen(tau)[0][k, c] - start

        def gap(tau, k, c):
            """(gap of a stop, its rate, its acceleration); of a compliant one that acts, its depth."""
            sign, stop = (1.0, "lower") if c == LOWER else (-1.0, "upper")
            if self._acts(k, c):
                sign = -sign
            _, q, rates = seen(tau)
            return sign * (q[k] - self._model.switches[stop][k]), *(sign * rates[k])

        ends = []
        for k, c in np.argwhere(places >= 0.0):
            end = places[k, c] * size
            expected, slope = math.nan, math.nan
            if course is not None and places[k, c] == 1.0 and k >= len(work.modes) and not self._may_be_beyond(k, c):
                expected, slope = self._expected(course[:, k, c - LEAST])
            if expected > 0.0:
                ends.append((expected * size, slope / size, end, k, c))
                continue
            if not guard(end, k, c) < 0.0:
                end = None
                if c <= UPPER and not failed:
                    end = self._dip(guard, gap, size, k, c, failed)
                elif c > SLIDING and places[k, c] < 1.0 and not failed:
                    end = self._give_way(guard, places[k, c], size, k, c)
            if failed:
                return 0.0, None, failed[0]
            if end is not None:  # else it only seemed to dip below zero
                above = max(guard(0.0, k, c), 0.0)  # infinite where a law skipped it
                place = above / (above - guard(end, k, c)) if above < math.inf else 1.0
                ends.append((end * place, math.nan, end, k, c))
        tau, crossed = size, np.zeros(places.shape, dtype=bool)
        for expected, slope, end, k, c in sorted(ends):
            later, is_seen = tau + self.same_time, not math.isnan(slope)  # the stages have seen a zero
            if crossed.any():
                if guard(tau, k, c) > 0.0 and expected - tau > APART * self.same_time:
                    continue  # its zero is later, by interpolation
                if end > later and not guard(later, k, c) < 0.0:
                    continue
                end = min(end, later)
            same = max(self.same_time, 2.0 * BEND_PART * size) if self._is_bend(k) else self.same_time
            if end == later and tau > same and guard(tau - same, k, c) > 0.0:
                crossed[k, c] = True
                continue
            try:
                at = None
                if slope < 0.0 and end == size and self._is_bend(k):
                    at = self._soon_after(guard, expected, slope, size, k, c)
                if at is None and is_seen and not guard(end, k, c) < 0.0:
                    continue
                if at is None:
                    at = self._zero(guard, gap, end, TIME_PART * size, k, c, expected if is_seen else math.nan)
            except ValueError:  # a guard is none where a trial failed
                if not failed:
                    raise
                return 0.0, None, failed[0]
            if at < tau - self.same_time:
                crossed[:] = False
            tau, crossed[k, c] = min(at, tau), True
        if failed:
            return 0.0, None, failed[0]
        if tau == reached[0]:
            work.branches[:], status = reached[1], OK
        else:
            self._return(kept, *state[:2])
            status = self._single(tau, state) if tau > 0.0 else OK
        return tau, crossed if crossed.any() and status == OK else None, status

    def _may_be_beyond(self, k, c):
        """Whether a guard may be negative at the start of a substep without an event, by the error of the method."""
        switches = len(self._work.modes)
        if k < switches:
            return c <= UPPER and self._rigid[k]
        return may_be_beyond(self._model.space.forces.laws, self._work.branches[k - switches], k - switches)

    def _is_bend(self, k):
        """Whether guard k is that of a bend of a contact, see Laws.compared."""
        k -= len(self._work.modes)
        return k >= 0 and self._model.space.forces.laws.compared[k] < 0

    def _course(self, size, state, kept):
        """Guards at the stages of the substep, as Work.course, or None if it fails."""
        work = self._work
        before = work.course.copy()
        self._return(kept, *state[:2])
        work.watch[WATCHED] = NOTED
        _, status = self._step(size, 1, *state)
        work.watch[WATCHED] = 1.0
        found, work.course[:] = work.course.copy(), before
        return found if status == OK else None

    def _expected(self, values):
        """(fraction of a substep at which a guard with these values at stages is zero, its slope there), or NaN.

        Zero of the polynomial through them, if it is positive at the start and negative at the end.
        """
        weights, begin, end = self._weights()[0], values[START], values[END]
        used = weights[0] != 0.0
        used[[START, END]] = True
        if not (begin > 0.0 > end and np.isfinite(values[used]).all()):
            return math.nan, math.nan
        polynomial = COEFFICIENTS @ [begin, *(weights[:, used] @ values[used]), end]
        if not np.polyval(polynomial, 0.0) > 0.0 > np.polyval(polynomial, 1.0):  # at its ends there is round-off
            return math.nan, math.nan
        place = scipy.optimize.brentq(lambda s: np.polyval(polynomial, s), 0.0, 1.0, xtol=TIME_PART)
        return place, float(np.polyval(np.polyder(polynomial), place))

    def _soon_after(self, guard, expected, slope, size, k, c):
        """Time at which a guard is negative, by BEND_PART of a substep after its zero at most; None: none was found."""
        late = BEND_PART * size
        time = expected + late
        for _ in range(TRIES):
            if not 0.0 < time < size:
                return None
            since = guard(time, k, c) / slope
            if 0.0 <= since <= 2.0 * late:
                return time
            time += late - since
        return None

    def _acts(self, k, c):
        """Whether a compliant stop acts."""
        return not self._rigid[k] and self._work.modes[k, SIDE] == (-1.0 if c == LOWER else 1.0)

    def _dip(self, guard, gap, size, k, c, failed):
        """First time found at which the guard of a stop is negative in a substep, or None."""
        spans, depth = [(0.0, size)], self._at_zero[k, c]
        lag = self._lag[k] if self._acts(k, c) else 0.0
        for _ in range(MOST_LOOKS):
            if failed or not spans:
                return None
            begin, end = spans.pop()
            ends = gap(begin, k, c), gap(end, k, c)
            place = lowest(*ends[0], *ends[1], end - begin, depth, lag)
            if place < 0.0 or end - begin < TIME_PART * size:
                continue
            middle = begin + min(max(place, 0.25), 0.75) * (end - begin)
            if guard(middle, k, c) < 0.0:
                return middle
            spans += (middle, end), (begin, middle)
        return None

    def _give_way(self, guard, place, size, k, c):
        """Time at which the guard of a held switch is negative, near a fraction of a substep, or None."""
        near = max(place - NEAR, 0.0) * size, min(place + NEAR, 1.0) * size
        options = {"xatol": PRECISE * size}
        find = scipy.optimize.minimize_scalar
        with np.errstate(invalid="ignore"):  # a guard is infinite where a law skips it
            found = find(guard, args=(k, c), bounds=near, method="bounded", options=options)
        return float(found.x) if found.fun < 0.0 else None

    def _zero(self, guard, gap, end, precise, k, c, expected):
        """Time of the zero of a guard before `end`, where it is negative; to `precise` s. expected : s, or NaN."""
        round_off = ROUND_OFF_PART * -guard(end, k, c)
        begin, starts = 0.0, guard(0.0, k, c) > max(self._at_zero[k, c], round_off)
        # Its zero for a constant acceleration; after an impact it is a small fraction of the substep.
        near = _first_zero(*gap(0.0, k, c)) if c <= UPPER else end
        if c <= UPPER and self._rigid[k]:
            time = self._closed(guard, gap, near, end, precise, k, c)
            if time is not None:
                return time
        if AFTER * near < end and guard(AFTER * near, k, c) < 0.0:
            end = AFTER * near
            if guard(BEFORE * near, k, c) > 0.0:
                begin, starts = BEFORE * near, True
        if not starts:
            # After an event the guard starts at zero and grows; if it does not grow, the start is its zero.
            for _ in range(SHRINKS):
                begin = end / 16.0
                if guard(begin, k, c) > 0.0:
                    break
                end = begin
            else:
                return 0.0
        # A held switch is released where its effort is at its bound or beyond: then it moves away.
        return root_of(functools.partial(guard, k=k, c=c), begin, end, precise, c > SLIDING, expected)

    def _closed(self, guard, gap, near, end, precise, k, c):
        """Time at which a gap closes, by Newton's method from `near`, or None."""
        time = near
        for _ in range(NEWTON):
            if not 0.0 < time < end:
                return None
            value, rate = guard(time, k, c), gap(time, k, c)[1]
            if not rate < 0.0:
                return None
            change = -value / rate
            if abs(value) <= self._digit[k, c] or abs(change) <= precise:
                return time
            time += change
        return None

    def _single(self, tau, state):
        """Take one step of size tau, or its parts, without events and without error control."""
        work = self._work
        work.watch[WATCHED] = 0.0
        _, status = self._step(tau / self.parts, self.parts, *state)
        work.watch[WATCHED] = 1.0
        return status

    def _keep(self, pose, twist, from_start=False):
        """Copies of the state; from_start: of that at the start of the step under error control."""
        work = self._work
        own = [work.pose, work.twist, work.angle]
        if from_start and self._control.attempted[0]:
            own = [work.start_pose, work.start_twist, work.start_angle]
        return [part.copy() for part in (*own, *self._all_modes, pose, twist)]

    def _return(self, kept, pose, twist):
        work = self._work
        own = (work.pose, work.twist, work.angle, *self._all_modes, pose, twist)
        for part, values in zip(own, kept):
            part[:] = values


def root_of(function, begin, end, precise, beyond, expected=math.nan):
    """Root of a function between two times at which its signs differ, to `precise`: one at which it was evaluated.

    beyond : whether the function must not be positive there;  expected : the root, as far as it is known, or NaN

    Inverse interpolation through the points next to it, because each costs a step of a mechanism: it converges faster
    than Brent's method, which has three. Where a residual is not halved, the next step goes further, then as far as the
    geometric mean with the interval, so that this shrinks from both sides; if it is short by then, residuals are
    round-off. Raises ValueError where the function is NaN.
    """
    points, ends, stale, time, short = [], {}, 0, begin, ROUND_OFF_PART * abs(end - begin)
    while True:
        value = function(time)
        if math.isnan(value):
            raise ValueError("a value is not known")
        if value == 0.0:
            return time
        if len(points) > 1:
            stale = 0 if abs(value) <= 0.5 * min(abs(each) for _, each in ends.values()) else stale + 1
        points.append((time, value))
        ends[value > 0.0] = time, value
        if len(points) == 1:
            time = end
            continue
        (near, value), (far, _) = sorted(ends.values(), key=lambda each: abs(each[1]))
        width = abs(far - near)
        points.sort(key=lambda each: abs(each[0] - near))
        step = _zero_of(points[:MOST_POINTS]) - near
        if len(points) == 2 and min(begin, end) < expected < max(begin, end):
            time = expected
            continue
        if width <= (short if stale else precise) or not stale and len(points) > 2 and abs(step) <= precise:
            break
        time = near + step
        if stale:
            reach = math.sqrt(abs(step) * width) if stale > 1 else FURTHER * abs(step)
            time = near + math.copysign(min(reach, 0.5 * width), far - near)
        if not min(near, far) < time < max(near, far):
            time = 0.5 * (near + far)
    while beyond and value > 0.0:
        near, precise = min(near + precise, end), FURTHER * FURTHER * precise
        value = function(near)
    return near


def _zero_of(points):
    """Argument at which the polynomial of the values in [(argument, value)] is zero: Neville's scheme; or inf."""
    known = {value: argument for argument, value in points if abs(value) < math.inf}
    row, values = [], list(known)
    for k, (value, argument) in enumerate(known.items()):
        new = [argument]
        for j in range(k):
            other = values[k - 1 - j]
            new.append(new[j] + value * (new[j] - row[j]) / (other - value))
        row = new
    return row[-1] if len(row) > 1 else math.inf


def _first_zero(gap, rate, acceleration):
    """Time at which a gap closes with a constant acceleration, or inf."""
    gap = max(gap, 0.0)
    root = rate * rate - 2.0 * acceleration * gap
    if root < 0.0:
        return math.inf
    if rate < 0.0:
        return 2.0 * gap / (-rate + math.sqrt(root))
    return (rate + math.sqrt(root)) / -acceleration if acceleration < 0.0 else math.inf
