# SPDX-License-Identifier: Apache-2.0
"""Steps of a Munthe-Kaas method with the events of stops, dry friction and contacts, and of the branches of laws.

An event ends the smooth motion between two steps: a joint reaches a stop or leaves it, comes to rest
or breaks away, or a law changes its branch. munthe_kaas.py returns at the start of the substep in which a guard
is crossed (crossings.py). times.py finds the event's time, mode_changes.py what changes. A method that runs ahead
returns at the start of the step, which is completed from the lead on.

More than MOST_EVENTS of one stop, joint or branch in a step are an error.
"""

from typing import NamedTuple

import numpy as np

from liegroup_core.dynamics.switches import LEAST, LOWER, MOST, SLIDING, UPPER, modes_of
from liegroup_core.forces.acting import Acting
from liegroup_core.forces.formulas import LOOSE, OPEN, SHARED, UNKNOWN
from liegroup_core.forces.law import is_shared, next_branch, places_of_branches
from liegroup_core.joints.stops import WITHIN_A_TURN
from liegroup_core.mechanism.arrays import BEGIN, COORDINATE, KNOWN, SETTLED, SIDE, SLIP, SPAN, WATCHED
from liegroup_core.status import BEYOND_STOP, EVENT, EVENTS_WITHOUT_END, MOST_EVENTS, OK, TOO_MANY_SUBSTEPS

from .crossings import lowest
from .mode_changes import IMPACT, JointEvent
from .times import SAME_PART, SAME_TIME, EventTimes

BEYOND = 1e-9  # rad, or relative to the characteristic length: a state that is set further beyond a stop is refused
# Endless impacts of several contacts become plastic: after half of MOST_EVENTS in a step, if the last DENSE
# are within this fraction of it.
DENSE, SHORT = 50, 0.005
MOST_KEPT = 100_000  # events kept until they are taken

STOP, TOUCH, LEAVE, STICK, SLIDE = "stop", "touch", "leave", "stick", "slip"


class JointInstant(NamedTuple):
    """Modes of all joints with stops or friction, and branches of laws, where one of them changes.

    time     : s
    modes    : (k, 5) from then on, as Sample.switching
    events   : [JointEvent] of this time; none where a run starts, and of other laws than contacts
    branches : (q,) of the kinks of laws, see forces/formulas.py; UNKNOWN where their block is skipped
    """

    time: float
    modes: np.ndarray
    events: list
    branches: np.ndarray


class Switching(EventTimes):
    """Steps of a Munthe-Kaas method with the events of the switches of its model.

    take, step, control, weights : see EventTimes
    lead    : Lead of the method
    touching : Touching of the contacts; None: their events are not noted

    leaps   : Laws.compared of kinks over which steps go on; None: none
    instants : [JointInstant] since they were last taken; None: not recorded
    count   : number of events since the state was set
    endless : (time in s, switches) of the first impacts without end that became plastic, or None
    tally   : (g,) number of instants at which a guard of each switch and branch was zero, since the state was set
    """

    def __init__(self, model, work, take, step, control, weights, lead, touching):
        super().__init__(model, work, take, step, control, weights)
        self._lead, self._points = lead, None
        self.touching = touching if touching and touching.names else None
        self.instants, self.count, self.leaps = None, 0, None
        self.endless = self._inputs = None
        self.tally, self._tally = np.zeros((2, len(work.guards)), dtype=int)  # and where a step began
        # s, of the last event of each in a step, and the time after which one is another event
        self._branch_times, self._again = np.full(len(work.branches), -np.inf), SAME_TIME
        work.watch[WATCHED] = 1.0

    def touch(self, pose, twist, external):
        """Call every kernel once; the state does not change."""
        self._look(self._model, self._work, pose, twist, external)
        self._step(1.0, 0, pose, twist, external)
        if self._lead.runs:
            with self._lead.left():
                self._take(1.0, 0, pose, twist, external)
        lowest(*np.ones(9).tolist())
        self._respond_at_stage()
        self._change_rates(self._model, self._work, self._no_changes, pose, twist)

    @property
    def memory(self):
        """Arrays of the modes of switches between calls."""
        return self._work.held, self._work.modes

    def log(self):
        """What was logged and counted since the state was set."""
        lists = [None if each is None else list(each) for each in (self.events, self.instants, self.impacts)]
        return (*lists, self._points, self.count, self.lost, self.endless, self._inputs, self.tally.copy())

    def take_log(self, log):
        """Return to a `log`."""
        self.events, self.instants, self.impacts, self._points, *counted, self._inputs, tally = log
        self.count, self.lost, self.endless = counted
        self.tally[:] = tally

    def expect(self, coordinates):
        """Unwrap the angles of a state that was set to those nearest to these coordinates (k,), rad or m."""
        self._work.modes[:, COORDINATE] = coordinates * self._model.switches["sign"]

    def restart(self):
        """Reset the modes after the state was set. Angles are unwrapped near 0, see `_meet_inputs`."""
        for part in self._all_modes:
            part[:] = 0.0
        self.events, self.count, self.lost, self._points = [], 0, 0.0, None
        self.endless = self._inputs = None
        self.tally[:] = 0
        self.instants = None if self.instants is None else []
        self.impacts = None if self.impacts is None else []

    def advance(self, h, steps, pose, twist, external):
        """Take steps of size h in place, with all events; returns (steps done, status)."""
        work, state = self._work, (pose, twist, external)
        if steps == 0:
            return self._take(h, 0, *state)
        del self.events[:-MOST_KEPT]
        self.step = h
        clock, done, first, base = work.clock, 0, work.clock.count[0], work.clock.offset[0]
        begin, end = clock.from_step[0], clock.to_step[0]
        whole = clock.since[0] == clock.until[0] == 0.0  # not a part of a step, which is completed at once
        status = self._meet_inputs(first * h + base, state)
        while status == OK and done < steps:
            clock.count[0], clock.offset[0] = first + done, base
            if whole:
                self._lead.call(begin + done, end)
            more, status = self._take(h, steps - done, *state)
            done += more
            if status == EVENT and self._lead.runs:
                one = 1 if whole else steps
                status = self._finish_from_lead(one * h, (first + done) * h + base, state)
                done += one if status == OK else 0
            elif status == EVENT:
                kept, logged = self._keep(pose, twist, True), self._logged()
                status = self._finish(h, (first + done) * h + base, state)
                if status == OK:
                    done += 1
                else:
                    self._return(kept, pose, twist)
                    self._change_rates(self._model, work, self._no_changes, pose, twist)
                    self._forget(logged)
        clock.count[0], clock.offset[0], clock.from_step[0], clock.to_step[0] = first, base, begin, end
        return done, status

    def _finish_from_lead(self, h, start, state):
        """Complete a step of size h with the next event, whose substep begins at the lead. Returns a status."""
        work, (pose, twist, _) = self._work, state
        own = work.angle, *self._all_modes, pose, twist
        kept, logged = [part.copy() for part in own], self._logged()
        work.angle[:], work.modes[:, COORDINATE] = work.lead_angle, work.lead_coordinates
        work.watch[SPAN] = min(work.watch[SPAN], h - work.watch[BEGIN])
        self._change_rates(self._model, work, self._no_changes, pose, twist)
        with self._lead.left():
            status = self._finish(h, start, state)
        if status != OK:
            for part, values in zip(own, kept):
                part[:] = values
            self._lead.go_back()
            self._forget(logged)
        return status

    def _logged(self):
        return len(self.events), len(self.instants or ()), len(self.impacts or ()), self.count, self.lost, self._points

    def _forget(self, logged):
        """Remove what was logged after `logged`, because the step failed."""
        events, instants, impacts, self.count, self.lost, self._points = logged
        del self.events[events:]
        self.impacts = self.impacts and self.impacts[:impacts]
        if self.instants:
            del self.instants[instants:]

    @property
    def are_known(self):
        """Whether the modes were found since the state was set: all are found together."""
        if not len(self._work.modes):
            return self._work.branches[0] != UNKNOWN
        return self._work.modes[0, KNOWN] != 0.0

    @property
    def any_at_rest(self):
        """Whether a stop or friction holds something: what it holds depends on the inputs."""
        return bool(self._at_rest().any())

    def is_settled(self, external):
        """Whether the modes are those of the present inputs."""
        return self.are_known and (not self.any_at_rest or self._same(external))

    def mark(self, external):
        """Note in the modes, for a copy of them, whether they are those of the present inputs."""
        if len(self._work.modes) and self.are_known:
            self._work.modes[:, KNOWN] = SETTLED if self.is_settled(external) else 1.0

    def restored(self, external):
        """Continue with modes and inputs that were set."""
        if len(self._work.modes) and self._work.modes[0, KNOWN] == SETTLED:
            self._note_inputs(external)

    def _note_inputs(self, external):
        self._inputs = Acting(external, self._work.targets, self._work.motions).copy()

    def _same(self, external):
        """Whether the inputs are those for which the modes were found."""
        work = self._work
        last = self._lead.acting if self._lead.known else self._inputs
        return last is not None and last.is_same((external, work.targets, work.motions))

    def _meet_inputs(self, time, state):
        """Find the modes after a state was set or the inputs changed."""
        if self.is_settled(state[2]):
            return OK
        work, known = self._work, self.are_known
        self._note_inputs(state[2])
        if self._lead.known:
            self._lead.go_back()
        if not known:
            work.modes[:, COORDINATE] = self._in_turns_of_stops(work.modes[:, COORDINATE])
            if len(work.shares):  # a state that was set slides on where it did
                work.branches[self._laws.surfaces] = work.angle[places_of_branches(self._laws)]
        work.clock.now[0] = time
        status = self._look(self._model, work, *state) if known else self.meet_surfaces(state)
        if status != OK:
            return status
        if not known:
            own = work.guards[: len(work.modes)]
            beyond = (self._rigid[:, None] & (own[:, : UPPER + 1] < -BEYOND * self._unit[:, None])).any(axis=1)
            if beyond.any():
                return BEYOND_STOP + (int(np.argmax(beyond)) << 8)
            rates = self._rates()
            work.modes[:, SLIP] = np.where(self._dry, np.sign(rates), 0.0)
            soft = ~self._rigid
            for end, side in ((0, -1.0), (1, 1.0)):
                work.modes[soft & (own[:, end] < 0.0), SIDE] = side
            work.modes[:, KNOWN] = 1.0
            log, count = len(self.events), self.count
            status = self._switch(time, state, np.zeros(work.guards.shape, dtype=bool))
            # A joint that starts at rest or at its stop is not an event. One that hits its stop is.
            hit = {event.joint for event in self.events[log:] if event.kind == IMPACT}
            self.events[log:] = [event for event in self.events[log:] if event.joint in hit]
            self.count = count + len(self.events) - log
            if self.instants and status == OK:
                self.instants[-1] = self.instants[-1]._replace(events=self.events[log:])
            return status
        if (work.guards[:, SLIDING + 1 :] >= 0.0).all():
            return OK
        return self._switch(time, state, np.zeros(work.guards.shape, dtype=bool))

    def _in_turns_of_stops(self, near):
        """Coordinates near which a state that was set is unwrapped: near (k,), limited to the range of the stops."""
        table = self._model.switches
        first, last = table["lower"] + WITHIN_A_TURN, table["upper"] - WITHIN_A_TURN
        return np.where(first > last, table["expected"], np.clip(near, first, last))

    def _finish(self, h, start, state):
        """Complete the step with the next event, from the substep of the event on. Returns a status."""
        self.step, self.same_time = h, min(SAME_TIME, SAME_PART * h)
        self._branch_times[:] = -np.inf
        self._note_inputs(state[2])
        status = self._take_events(h, start, state)
        self.is_dense = self.has_many = False
        return status

    def _take_events(self, h, start, state):
        work = self._work
        elapsed, times, begun = 0.0, [], self._control.attempted[0]
        self._tally[:] = self.tally
        while (self.tally - self._tally).max() < MOST_EVENTS:
            begin_of_substep, size = elapsed + work.watch[BEGIN], work.watch[SPAN]
            work.clock.count[0], work.clock.offset[0] = 0.0, start + begin_of_substep
            self._again = max(self.same_time, SAME_PART * size)
            tau, crossed, status = self._locate(size, state)
            if status != OK:
                return status
            elapsed = begin_of_substep + tau
            if crossed is not None:
                crosses = crossed.any(axis=1)
                if crosses[: len(work.modes)].any():
                    times.append(elapsed)
                # Impacts that converge do so by then; so many in so short a time do not.
                self.has_many = len(times) > MOST_EVENTS // 2
                self.is_dense = self.has_many and elapsed - times[-DENSE] < SHORT * h
                if self.is_dense and self.endless is None and crosses[: len(work.modes)].any():
                    self.endless = start + elapsed, np.flatnonzero(crosses[: len(work.modes)]).tolist()
                status = self._switch(start + elapsed, state, crossed)
                if status != OK:
                    return status
                self.tally += crosses
            if not elapsed < h * (1.0 - 1e-13):
                return OK
            work.clock.count[0], work.clock.offset[0] = 0.0, start + elapsed
            status = self._take_rest(h - elapsed, begun, state)
            if status != EVENT:
                return status
        return EVENTS_WITHOUT_END

    def _take_rest(self, h, begun, state):
        """Take the rest of a step, with what is left of its attempts: an event is not a new step. Returns a status.

        begun : attempts when its first event was found
        """
        control, most = self._control, self._control.most[0]
        spent = control.attempted[0] - begun
        control.most[0] = max(0.0, most - spent)
        _, status = self._take(h, 1, *state)
        control.most[0] = most
        if status == TOO_MANY_SUBSTEPS:
            new = control.attempted[0] - begun - spent
            control.part[0] = (spent + new) / (spent + new / control.part[0])
        return status

    def _switch(self, time, state, crossed):
        """Change the branches of laws and the modes of switches at an event; crossed: mask of the guards that are zero.

        returns a status
        """
        work, time = self._work, float(time)  # users read it in the events
        work.clock.now[0], log = time, len(self.events)
        if self.touching and self._points is None:
            self._points = self.touching.points(self._sides())
        crossed, ends = np.split(crossed, [len(work.modes)])
        status = self._slide(self._change_branches(time, ends), state)
        if status == OK and len(work.modes):
            status = self._change_modes(time, state, crossed)
        met = ends.any(axis=1)
        while status == OK:
            # Impulses change rates, and what laws do with them; and what was skipped has the branches of before.
            left = (work.guards[len(work.modes) :, LEAST:] < 0.0).any(axis=1) & ~met
            if not left.any():
                break
            for k in np.flatnonzero(left):
                beyond = is_shared(self._laws, work.branches[k], k), work.guards[len(work.modes) + k, MOST] < 0.0
                work.branches[k] = next_branch(self._laws, work.branches[k], k, beyond[1]) if beyond[0] else UNKNOWN
            met |= left
            status = self._look(self._model, work, *state)
        if len(work.shares):
            self._keep_shares()
        if self.leaps is not None:
            work.branches[np.isin(self._laws.compared[: len(work.branches)], self.leaps)] = LOOSE
        if status == OK and self.touching:
            before, self._points = self._points, self.touching.points(self._sides(), self._points)
            changes = self.touching.changes(before, self._points)
            self.events += [JointEvent(time, len(work.modes) + c, kind) for c, kind in changes]
        if status == OK and self.instants is not None:
            self.instants.append(JointInstant(time, self.present_modes(), self.events[log:], self._sides()))
        return status

    def _sides(self):
        """Branches of laws, as JointInstant has them."""
        work, under = self._work, self._laws.kinks[: len(self._work.branches), 1]
        is_shared_now = (self._laws.compared[: len(work.branches)] == 2) & (work.branches > 1.0)
        sides = np.where(is_shared_now, SHARED, work.branches)
        sides[(under >= 0) & (work.registers[under, 0] == 0.0)] = UNKNOWN  # that of before, which nothing reads
        return sides

    def _slide(self, shared, state):
        """Look at a state, from which the motion slides along these surfaces if it can. Returns a status."""
        work = self._work
        status = self._look(self._model, work, *state)
        apart = [k for k in shared if (work.guards[len(work.modes) + k, LEAST:] < 0.0).any()]
        if status == OK and apart:  # one of both sides leads away
            work.branches[apart] = OPEN
            status = self._look(self._model, work, *state)
        return status

    def meet_surfaces(self, state):
        """Find the branches of a state that was set, and whether it slides along surfaces on which it is. A status.

        It slides where the rates of the other side lead back to the surface, and those of its own do not lead away.
        """
        work, surfaces, met = self._work, self._laws.surfaces, set()
        status = self._look(self._model, work, *state)
        if not len(work.shares):
            return status
        on = (work.guards[len(work.modes) :, LEAST:] == 0.0).any(axis=1)[surfaces]
        while status == OK:
            sides = work.branches[surfaces]
            ways = sides * work.surface_rates
            left = [j for j in np.flatnonzero(on & (np.abs(sides) == 1.0) & (ways <= 0.0)) if j not in met]
            if not left:
                break
            j, k = left[0], surfaces[left[0]]
            met.add(j)
            work.branches[k] = -sides[j]
            status = self._look(self._model, work, *state)
            back = sides[j] * work.surface_rates[j] > 0.0
            if status == OK and (back or ways[j] == 0.0):
                work.branches[k] = SHARED if back else sides[j]
                status = self._slide([k] if back else [], state)
        return status

    def _change_modes(self, time, state, crossed):
        """Apply impulses and choose new modes, as `_switch`. Returns a status."""
        model, work = self._model, self._work
        log, impacts = len(self.events), len(self.impacts or ())
        modes, before = work.modes, (self._at_rest(), work.modes.copy())
        for k, c in np.argwhere(crossed[:, : UPPER + 1] & ~self._rigid[:, None]):
            side = -1.0 if c == LOWER else 1.0
            modes[k, SIDE] = 0.0 if modes[k, SIDE] == side else side
        table, q = model.switches, modes[:, COORDINATE]
        side = np.where(self._rigid, 0.0, modes[:, SIDE])
        for end, (stop, sign) in enumerate(((table["lower"], -1.0), (table["upper"], 1.0))):
            with np.errstate(invalid="ignore"):
                near = sign * (q - stop) >= -self._reach(state[0], stop)
            side[self._rigid & np.isfinite(stop) & (near | crossed[:, end])] = sign
        touching = self._rigid & (side != 0.0)
        # A held row is at rest: its rate is the error of the method. A switch that has stopped sliding is at
        # rest, too: its rate is the error of the event's time, however large its acceleration.
        at_rest = self._is_row & (work.held[self._freedoms] != 0.0)
        at_rest |= crossed[:, SLIDING] & (modes[:, SLIP] != 0.0)
        drift = np.where(at_rest, self._rates(), 0.0)
        rates = self._rates() - drift
        # A switch that returns before it was clear of its stop never left it.
        stays = touching & crossed[:, : UPPER + 1].any(axis=1) & (side * rates <= 0.0)
        pressed = (before[0] != 0.0) | crossed[:, : UPPER + 1].any(axis=1)
        while True:
            if (touching & (side * rates > self._still)).any() or stays.any():
                status = self._impact(time, state, side, touching, rates, stays)
                if status != OK:
                    return status
                rates = self._rates() - drift
            resting = (np.abs(rates) <= self._still) | (crossed[:, SLIDING] & self._is_slow(before, rates))
            resting &= self._dry | touching
            status = self._choose(state, side, resting, rates, crossed, pressed)
            if status == OK:
                status = self._look(model, work, *state)
            if status != OK:
                return status
            # The impulses of others may move a switch, but no further than a rebound that becomes zero.
            ends = ~stays & self._end_soon(state[0], np.where(touching, side, 0.0))
            if not ends.any():
                break
            stays, rates = stays | ends, self._rates() - drift
        self._merge_impacts(log, impacts)
        self._note(time, before)
        self.count += len(self.events) - log
        return OK

    def _change_branches(self, time, ends):
        """Go on with the branches beyond these ends (q, 5). One whose end is met again at once is shared, or OPEN.

        So is one with many events in a step. Returns the numbers of those that are shared.
        """
        laws, branches, shared, row = self._laws, self._work.branches, [], len(self._work.modes)
        for k, c in np.argwhere(ends):
            if self.tally[row + k] - self._tally[row + k] > MOST_EVENTS // 2:
                branches[k] = OPEN
            elif time - self._branch_times[k] > self._again or is_shared(laws, branches[k], k):
                branches[k] = next_branch(laws, branches[k], k, c == MOST)
            elif k in laws.surfaces:
                branches[k] = SHARED
                shared.append(k)
            else:
                branches[k] = OPEN
            self._branch_times[k] = time
        return shared

    def _keep_shares(self):
        """Keep the branches of surfaces for those who read the state."""
        branches = self._work.branches[self._laws.surfaces]
        self._work.angle[places_of_branches(self._laws)] = np.where(branches > 1.0, branches, UNKNOWN)

    @property
    def _laws(self):
        return self._model.space.forces.laws

    def _is_slow(self, before, rates):
        """Mask of the switches that slid until now and whose rate has changed its sign, or is zero."""
        slip = before[1][:, SLIP]
        return (slip != 0.0) & (slip * rates <= self._still * (1.0 + np.abs(rates / self._unit).max(initial=0.0)))

    def present_modes(self):
        """(k, 5) of all switches, see switches.modes_of, for a state that was not set."""
        return modes_of(self._model, self._work)

    def modes(self, time, state):
        """(k, 5) of all switches, see switches.modes_of; for a state that was set, the modes it will have."""
        if self.are_known:
            return self.present_modes()
        noted, known = (self.events, self.impacts, self.instants, self.count, self._inputs), self._work.known[0]
        points = self._points
        kept, self.events, self.impacts, self.instants = self._keep(*state[:2]), [], None, None
        self._look(self._model, self._work, *state)
        # If the state is beyond a stop, the next step reports that.
        self._meet_inputs(time, state)
        modes = self.present_modes()
        self._return(kept, *state[:2])
        self.events, self.impacts, self.instants, self.count, self._inputs = noted
        self._points = points
        self._work.known[0] = known
        return modes

    def _note(self, time, before):
        """Append the changes to `events`."""
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
