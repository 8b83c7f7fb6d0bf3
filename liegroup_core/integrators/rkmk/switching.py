# SPDX-License-Identifier: Apache-2.0
"""Events of stops and dry friction: where they are, and the steps that lead there.

An event ends the smooth motion between two steps: a joint reaches a stop or leaves it, comes to rest
or breaks away. munthe_kaas.py returns at the start of the substep in which a guard is crossed
(formulations/relative/switches.py). Steps of the method from there to a variable time find the zero
of the guard: the event is as accurate as the method. What changes there: mode_changes.py.

More than MOST_EVENTS in a step are a fault.
"""

import functools
import math
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

from liegroup_core.formulations.relative.arrays import COORDINATE, KNOWN, SIDE, SLIP
from liegroup_core.formulations.relative.switches import (
    AT_STOP,
    LOWER,
    RESTING,
    SLIDING,
    UPPER,
    lowest,
    modes_of,
)
from liegroup_core.status import BEYOND_STOP, EVENT, EVENTS_WITHOUT_END, MOST_EVENTS, OK

from .mode_changes import IMPACT, JointEvent, ModeChanges

BEYOND = 1e-9  # rad or m: a state that is set is not this far beyond a stop
TIME_STEP = 1e-15  # s; an event is found to this, and to round-off
DIGIT = 1e-17  # rad, m, rad/s, m/s, N m or N: no guard is known better
SAME_TIME = 10.0 * TIME_STEP  # s; events that are closer are one
HALVINGS, MOST_LOOKS = 40, 400
BEFORE, AFTER = 0.8, 1.25  # times the expected time of a zero: it is sought there at first
NEWTON = 6  # steps, which converge or start too far away
# Impacts of several contacts that follow each other without end become plastic: after half of
# MOST_EVENTS in a step, where so many are in this part of it.
DENSE, SHORT = 50, 0.005
CROWD, CROWDED = (
    1000,
    0.1,
)  # events, and the time in s in which so many take far more time than that
MOST_KEPT = 100_000  # events that nobody has taken
LOOSE = 1e100  # tolerance of error control that no step fails

STOP, LEAVE, STICK, SLIDE = "stop", "leave", "stick", "slip"


class JointInstant(NamedTuple):
    """Modes of all joints with stops or friction where one of them changes.

    time   : s
    modes  : (k, 5) from then on, as Sample.switching
    events : [JointEvent] of this time; none where a run starts
    """

    time: float
    modes: np.ndarray
    events: list


class Switching(ModeChanges):
    """Steps of a Munthe-Kaas method with the events of the switches of its model.

    take    : function (h, steps, pose, twist, external) -> (steps done, status)
    control : of error control, see munthe_kaas.advance

    parts   : steps that lead to an event. Where an event is sets the size of this step: another number
              of parts shows its error, see RunningError
    instants : [JointInstant] since they were taken; None: not wanted
    count   : of all events since the state was set
    endless : (time in s, switches) of the first impacts without end that became plastic, or None
    crowded : (time in s, switches, s between two) of the first CROWD events in the time CROWDED, or None
    """

    def __init__(self, model, work, take, control):
        super().__init__(model, work)
        self._take, self._control = take, control
        table = model.switches
        # A guard that starts below this starts at its zero.
        self._at_zero = np.zeros((len(table), 5))
        for end, stop in ((LOWER, table["lower"]), (UPPER, table["upper"])):
            self._at_zero[:, end] = AT_STOP * (1.0 + np.where(np.isfinite(stop), np.abs(stop), 0.0))
        self._at_zero[:, SLIDING] = RESTING
        # Of compliant stops, s: how long before its depth the pressure of one that returns is zero.
        self._lag = table["damping"] / np.where(self._rigid, np.inf, table["stiffness"])
        self.instants, self.count, self.parts = None, 0, 1
        self.endless = self.crowded = self._inputs = None
        self._crowd = 0, 0.0  # events and time from which on they are counted
        work.watch[0] = 1.0

    def touch(self, pose, twist, external):
        """Call every kernel once; the state stays."""
        self._look(self._model, self._work, pose, twist, external)
        lowest(*np.ones(9).tolist())
        self._respond_at_stage()
        self._change_rates(self._model, self._work, self._no_changes, pose, twist)

    def adopt(self, other):
        """Continue with the modes of another one, at the same state."""
        self._work.held[:] = other._work.held
        self._work.modes[:] = other._work.modes

    def restart(self):
        """Forget the modes: the state was set."""
        self._work.held[:] = 0.0
        self._work.modes[:] = 0.0
        self.events, self.count, self._crowd = [], 0, (0, 0.0)
        self.endless = self.crowded = self._inputs = None
        self.instants = None if self.instants is None else []
        self.impacts = None if self.impacts is None else []

    def advance(self, h, steps, pose, twist, external):
        """Take steps of size h in place, with all events; returns (steps done, status)."""
        work, state = self._work, (pose, twist, external)
        if steps == 0:
            return self._take(h, 0, *state)
        del self.events[:-MOST_KEPT]
        done, first, base = 0, work.clock[0], work.clock[1]
        status = self._meet_inputs(first * h + base, state)
        while status == OK and done < steps:
            work.clock[0], work.clock[1] = first + done, base
            more, status = self._take(h, steps - done, *state)
            done += more
            if status == EVENT:
                kept = self._keep(pose, twist, True)
                log, instants = len(self.events), len(self.instants or ())
                impacts = len(self.impacts or ())
                status = self._finish(h, (first + done) * h + base, state)
                if status == OK:
                    done += 1
                else:
                    self._return(kept, pose, twist)
                    self._change_rates(self._model, work, self._no_changes, pose, twist)
                    self.count -= len(self.events) - log
                    del self.events[log:]
                    self.impacts = self.impacts and self.impacts[:impacts]
                    if self.instants:
                        del self.instants[instants:]
        work.clock[0], work.clock[1] = first, base
        return done, status

    def _meet_inputs(self, time, state):
        """Find the modes of a state that was set, and of new inputs."""
        work, known = self._work, self._work.modes[:, KNOWN].all()
        inputs = (state[2].copy(), work.acting.copy(), work.wanted.copy(), work.motions.copy())
        same = self._inputs is not None and all(map(np.array_equal, inputs, self._inputs))
        self._inputs = inputs
        if known and (same or not self._at_rest().any()):
            return OK
        if not known:
            work.modes[:, COORDINATE] = self._model.switches["expected"]
        status = self._look(self._model, work, *state)
        if status != OK:
            return status
        if not known:
            beyond = (self._rigid[:, None] & (work.guards[:, : UPPER + 1] < -BEYOND)).any(axis=1)
            if beyond.any():
                return BEYOND_STOP + (int(np.argmax(beyond)) << 8)
            rates = self._rates()
            work.modes[:, SLIP] = np.where(self._dry, np.sign(rates), 0.0)
            soft = ~self._rigid
            for end, side in ((0, -1.0), (1, 1.0)):
                work.modes[soft & (work.guards[:, end] < 0.0), SIDE] = side
            work.modes[:, KNOWN] = 1.0
            log, count = len(self.events), self.count
            status = self._switch(time, state, np.zeros(work.guards.shape, dtype=bool))
            # A joint that starts at rest or at its stop is no event. One that hits its stop is.
            hit = {event.joint for event in self.events[log:] if event.kind == IMPACT}
            self.events[log:] = [event for event in self.events[log:] if event.joint in hit]
            self.count = count + len(self.events) - log
            if self.instants and status == OK:
                self.instants[-1] = self.instants[-1]._replace(events=self.events[log:])
            return status
        if (work.guards[:, SLIDING + 1 :] >= 0.0).all():
            return OK
        return self._switch(time, state, np.zeros(work.guards.shape, dtype=bool))

    def _finish(self, h, start, state):
        """Take the step in which the next event is, from the substep with it on. Returns a status."""
        status = self._take_events(h, start, state)
        self.is_dense = False
        return status

    def _take_events(self, h, start, state):
        work = self._work
        elapsed, times = 0.0, []
        for _ in range(MOST_EVENTS):
            begin_of_substep, size = elapsed + work.watch[1], work.watch[2]
            work.clock[0], work.clock[1] = 0.0, start + begin_of_substep
            tau, crossed, status = self._locate(size, state)
            if status != OK:
                return status
            elapsed = begin_of_substep + tau
            if crossed is not None:
                times.append(elapsed)
                # Those that converge do so by then; so many in so short a time are far too many.
                many = len(times) > MOST_EVENTS // 2
                self.is_dense = many and elapsed - times[-DENSE] < SHORT * h
                if self.is_dense and self.endless is None:
                    self.endless = start + elapsed, np.argwhere(crossed)[:, 0].tolist()
                status = self._switch(start + elapsed, state, crossed)
                if status != OK:
                    return status
                self._watch_crowd(start + elapsed, crossed)
            if not elapsed < h * (1.0 - 1e-13):
                return OK
            work.clock[0], work.clock[1] = 0.0, start + elapsed
            _, status = self._take(h - elapsed, 1, *state)
            if status != EVENT:
                return status
        return EVENTS_WITHOUT_END

    def _watch_crowd(self, time, crossed):
        count, since = self._crowd
        if self.count >= count + CROWD:
            if time - since < CROWDED and self.crowded is None:
                between = (time - since) / (self.count - count)
                self.crowded = time, np.argwhere(crossed)[:, 0].tolist(), between
            self._crowd = self.count, time

    def _locate(self, size, state):
        """Go to the first zero of a guard in a substep.

        returns (time after its start, mask of the guards that are zero there, status); no mask: there
        is no event, and the substep is taken
        """
        work = self._work
        places = work.crossed.copy()
        kept = self._keep(*state[:2])
        failed = []

        @functools.cache
        def seen(tau):
            """(guards, coordinates, rates and accelerations) at a time."""
            self._return(kept, *state[:2])
            status = self._single(tau, state) if tau > 0.0 else OK
            if status != OK:
                failed.append(status)
                return np.full_like(work.guards, np.nan), None, None
            self._look(self._model, work, *state)
            return work.guards.copy(), work.modes[:, COORDINATE].copy(), work.now.copy()

        def guard(tau, k, c):
            """Guard of a stop: beyond the place where it starts, if that is beyond the stop."""
            start = min(seen(0.0)[0][k, c], 0.0) if c <= UPPER and self._rigid[k] else 0.0
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
            if not guard(end, k, c) < 0.0:
                end = None
                if c <= UPPER and not failed:
                    end = self._dip(guard, gap, size, k, c, failed)
            if failed:
                return 0.0, None, failed[0]
            if end is not None:  # else it only seemed to dip below zero
                above = max(guard(0.0, k, c), 0.0)
                ends.append((end * above / (above - guard(end, k, c)), end, k, c))
        tau, crossed = size, np.zeros(places.shape, dtype=bool)
        for _, end, k, c in sorted(ends):  # by linear interpolation
            later = tau + SAME_TIME
            if crossed.any():
                if end > later and not guard(later, k, c) < 0.0:
                    continue  # its zero is later
                end = min(end, later)
            if end == later and tau > SAME_TIME and guard(tau - SAME_TIME, k, c) > 0.0:
                crossed[k, c] = True
                continue
            at = self._zero(guard, gap, end, k, c)
            if at < tau - SAME_TIME:
                crossed[:] = False
            tau, crossed[k, c] = min(at, tau), True
        if failed:
            return 0.0, None, failed[0]
        self._return(kept, *state[:2])
        status = self._single(tau, state) if tau > 0.0 else OK
        return tau, crossed if crossed.any() and status == OK else None, status

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
            if place < 0.0 or end - begin < TIME_STEP:
                continue
            middle = begin + min(max(place, 0.25), 0.75) * (end - begin)
            if guard(middle, k, c) < 0.0:
                return middle
            spans += (middle, end), (begin, middle)
        return None

    def _zero(self, guard, gap, end, k, c):
        """Time of the zero of a guard before `end`, where it is negative."""
        begin, starts = 0.0, guard(0.0, k, c) > self._at_zero[k, c]
        # Near its zero for a constant acceleration: a small part of the substep, after an impact.
        near = _first_zero(*gap(0.0, k, c)) if c <= UPPER else end
        if c <= UPPER and self._rigid[k]:
            time = self._closed(guard, gap, near, end, k, c)
            if time is not None:
                return time
        if AFTER * near < end and guard(AFTER * near, k, c) < 0.0:
            end = AFTER * near
            if guard(BEFORE * near, k, c) > 0.0:
                begin, starts = BEFORE * near, True
        if not starts:
            # It starts at zero, after an event, and grows at first; else it is there already.
            begin = end
            for _ in range(HALVINGS):
                begin *= 0.5
                if guard(begin, k, c) > 0.0:
                    break
            else:
                return 0.0
        slope = (guard(begin, k, c) - guard(end, k, c)) / (end - begin)
        return brentq(guard, begin, end, (k, c), max(TIME_STEP, DIGIT / slope), 1e-15)

    def _closed(self, guard, gap, near, end, k, c):
        """Time at which a gap closes, by Newton's method from `near`, or None."""
        time = near
        for _ in range(NEWTON):
            if not 0.0 < time < end:
                return None
            value, rate = guard(time, k, c), gap(time, k, c)[1]
            if not rate < 0.0:
                return None
            change = -value / rate
            if abs(value) <= DIGIT or abs(change) <= TIME_STEP:
                return time
            time += change
        return None

    def _single(self, tau, state):
        """Take one step of size tau, or its parts, without events and without error control."""
        work, control = self._work, self._control
        kept, size = control.copy(), tau / self.parts
        control[0], control[4:] = size, LOOSE
        work.watch[0] = 0.0
        _, status = self._take(size, self.parts, *state)
        work.watch[0] = 1.0
        control[:] = kept
        return status

    def _keep(self, pose, twist, from_start=False):
        """Copies of the state; from_start: of that at the start of the step under error control."""
        work = self._work
        own = [work.pose, work.twist, work.angle]
        if from_start and self._control[2]:
            own = [work.start_pose, work.start_twist, work.start_angle]
        return [part.copy() for part in (*own, work.held, work.modes, pose, twist)]

    def _return(self, kept, pose, twist):
        work = self._work
        own = (work.pose, work.twist, work.angle, work.held, work.modes, pose, twist)
        for part, values in zip(own, kept):
            part[:] = values

    def _switch(self, time, state, crossed):
        """Impulses and new modes at an event; crossed: mask of the guards that are zero.

        returns a status
        """
        model, work = self._model, self._work
        status = self._look(model, work, *state)
        if status != OK:
            return status
        log = len(self.events)
        modes, before = work.modes, (self._at_rest(), work.modes.copy())
        for k, c in np.argwhere(crossed[:, : UPPER + 1] & ~self._rigid[:, None]):
            side = -1.0 if c == LOWER else 1.0
            modes[k, SIDE] = 0.0 if modes[k, SIDE] == side else side
        table, q = model.switches, modes[:, COORDINATE]
        side = np.where(self._rigid, 0.0, modes[:, SIDE])
        for end, (stop, sign) in enumerate(((table["lower"], -1.0), (table["upper"], 1.0))):
            with np.errstate(invalid="ignore"):
                near = sign * (q - stop) >= -self.reach * (1.0 + np.abs(stop))
            side[self._rigid & np.isfinite(stop) & (near | crossed[:, end])] = sign
        touching = self._rigid & (side != 0.0)
        rates = self._rates()
        # It left the stop, and returns before it was away from it: it never left.
        stays = touching & crossed[:, : UPPER + 1].any(axis=1) & (side * rates <= 0.0)
        if (touching & (side * rates > RESTING)).any() or stays.any():
            status = self._impact(time, state, side, touching, rates, stays)
            if status != OK:
                return status
            rates = self._rates()
        resting = (np.abs(rates) <= RESTING) | (crossed[:, SLIDING] & self._is_slow(before, rates))
        resting &= self._dry | touching
        pressed = (before[0] != 0.0) | crossed[:, : UPPER + 1].any(axis=1)
        status = self._choose(state, side, resting, rates, crossed, pressed)
        if status != OK:
            return status
        self._note(time, before)
        self.count += len(self.events) - log
        if self.instants is not None:
            self.instants.append(JointInstant(time, self._modes(), self.events[log:]))
        return OK

    def _is_slow(self, before, rates):
        """Mask of the switches that slid until now and whose rate has changed its sign, or is zero."""
        slip = before[1][:, SLIP]
        return (slip != 0.0) & (slip * rates <= RESTING * (1.0 + np.abs(rates).max(initial=0.0)))

    def _modes(self):
        return modes_of(self._model, self._work)

    def modes(self, time, state):
        """(k, 5) of all switches, see switches.modes_of; of a state that was set, the modes it will have."""
        if self._work.modes[:, KNOWN].all():
            return self._modes()
        self._look(self._model, self._work, *state)  # the links have this state from here on
        noted = self.events, self.impacts, self.instants, self.count, self._inputs
        kept, self.events, self.impacts, self.instants = self._keep(*state[:2]), [], None, None
        # Where the state is beyond a stop, the next step reports that.
        self._meet_inputs(time, state)
        modes = self._modes()
        self._return(kept, *state[:2])
        self.events, self.impacts, self.instants, self.count, self._inputs = noted
        return modes

    def _note(self, time, before):
        """Write what has changed to `events`."""
        held, modes = before
        now = self._at_rest()
        for k in range(len(modes)):
            side, old = self._work.modes[k, SIDE], modes[k, SIDE]
            if side != 0.0 and old != side:
                self.events.append(JointEvent(time, k, STOP))
            elif side == 0.0 and old != 0.0:
                self.events.append(JointEvent(time, k, LEAVE))
            elif side == 0.0 and now[k] and not held[k]:
                self.events.append(JointEvent(time, k, STICK))
            elif held[k] and not now[k] and self._dry[k]:
                self.events.append(JointEvent(time, k, SLIDE))


def _first_zero(gap, rate, acceleration):
    """Time at which a gap closes with a constant acceleration, or inf."""
    gap = max(gap, 0.0)
    root = rate * rate - 2.0 * acceleration * gap
    if root < 0.0:
        return math.inf
    if rate < 0.0:
        return 2.0 * gap / (-rate + math.sqrt(root))
    return (rate + math.sqrt(root)) / -acceleration if acceleration < 0.0 else math.inf
