# SPDX-License-Identifier: Apache-2.0
"""Changes at an event of stops and dry friction: impulses, and the modes that follow.

    impact     impulses p at all rigid stops in contact, with the velocities v- and v+ of their
               coordinates, v+ - v- = A p and A = D M^-1 D^T with loops: p >= 0, v+ + e v- >= 0, one of
               them zero (Newton's law; Moreau). Friction at rest gives no impulse.
    modes      efforts x of the degrees of freedom at rest, within the bounds of stop and friction, and their
               accelerations: x inside its bounds and the degree of freedom held, or x at a bound and the
               degree of freedom moves away from it

Each is one complementarity problem for all switches (complementarity.py). With equal restitution e kinetic
energy never grows; if different ones would let it grow, the smallest holds for all. A rebound lower than
SMALLEST_REBOUND, or LOW_REBOUND after many events in a step, becomes zero, and so does the hop of a switch that the
impulses of others let leave its stop. So endless bouncing becomes contact.

Source: Brogliato, Nonsmooth Mechanics, 5.1; Acary and Brogliato, Numerical Methods for Nonsmooth
Dynamical Systems, 8. Accuracy: test/verification/test_stops.py, test_friction.py.
"""

from typing import NamedTuple

import numpy as np

from liegroup_core.compiling import SameTypes
from liegroup_core.dynamics.loads import FOUND, GIVEN, LOAD, MOST_ITERATIONS
from liegroup_core.dynamics.switches import AT_STOP, LEAST, MOST, RESTING, ROUND_OFF, bounds
from liegroup_core.mechanism.arrays import COORDINATE, EFFORT, RESTS, SIDE, SLIP
from liegroup_core.status import NO_FRICTION, OK

from .complementarity import FREE, HIGH, LOW, REDUNDANT, independent, solve
from .kernels import change_rates, look, respond

# rad, or relative to the characteristic length: a rebound that would stay below this height becomes zero.
# LOW_REBOUND is the height after many events in one step.
SMALLEST_REBOUND, LOW_REBOUND = 1e-10, 1e-8
LAST_DIGITS = 1e-14  # round-off of a position, relative to the largest distance from the origin
RETURNING = 1e-10  # relative to its terms: a smaller acceleration is zero
SAME_LOADS = 1e-12
SPENT = 1e-9  # relative to its bound: an effort nearer to it is at the bound
IMMOBILE = 1e-13  # relative to the mobility without closed loops: below it, loops hold the coordinate at this pose
IMPACT = "impact"


class JointEvent(NamedTuple):
    """Event at a joint with stops or friction, or of a contact.

    time    : s
    joint   : number of the switch; of a contact, after all switches
    kind    : "impact", "stop" (it stays at a stop), "leave" (a stop), "stick" or "slip"; of a contact "touch", "leave",
              "slip" (all points that press) or "stick"
    impulse : of an impact, on the joint's coordinate, N m s or N s
    energy  : change of the kinetic energy by this impulse, J; the sum over an impact is not positive
    """

    time: float
    joint: int
    kind: str
    impulse: float = 0.0
    energy: float = 0.0


class ModeChanges:
    """Impulses and modes at an event of the switches of a model, at the state in `work`.

    events  : [JointEvent] since they were last taken
    impacts : [(time in s, pose (n, 12), angles (u,), impulses (k,) on the coordinates of the joints)] since
              they were last taken; None: not recorded
    lost    : largest displacement of a rebound that became plastic, in a step or until it returns to its
              stop, rad or relative to the characteristic length
    """

    def __init__(self, model, work):
        self._model, self._work = model, work
        table = model.switches
        self._unit = table["unit"]
        self._still = RESTING * self._unit
        self._freedoms, self._is_row = table["freedom"], table["row"] >= 0
        self._rigid = table["stiffness"] == 0.0
        self._dry = table["static"] + table["static_by_load"] > 0.0
        self._responses = np.zeros((len(table), len(work.freedoms)))
        self._mobility = np.zeros((len(table), len(table)))
        self._open_mobility = np.zeros(len(table))
        self._no_changes = np.zeros(len(work.freedoms))
        self._look, self._respond = SameTypes(look), SameTypes(respond)
        self._change_rates = SameTypes(change_rates)
        self.events, self.impacts = [], None
        self.is_dense = False  # the impacts are endless, so they become plastic
        self.has_many = False  # events in this step
        self.step, self.lost = 1.0, 0.0

    def _height(self, pose, part):
        """(k,) `part` of 1 rad or of the characteristic length, at least round-off, rad or m."""
        return np.maximum(part * self._unit, LAST_DIGITS * np.abs(pose[:, 9:]).max())

    def _reach(self, pose, stop):
        """(k,) distance up to which a coordinate counts as being at a stop, rad or m."""
        round_off = AT_STOP * (self._unit + np.abs(stop))
        if not self.is_dense:
            return round_off
        return np.maximum(self._height(pose, SMALLEST_REBOUND), round_off)

    def _respond_at_stage(self):
        mobility, of_open = self._mobility, self._open_mobility
        status = self._respond(self._model, self._work, self._responses, mobility, of_open)
        # At a dead point of a loop the coordinate cannot move: mobility at round-off level counts as zero.
        mobility[:] = 0.5 * (mobility + mobility.T)
        dead = np.diagonal(mobility) <= IMMOBILE * of_open
        mobility[dead], mobility[:, dead] = 0.0, 0.0
        return status

    def _rates(self):
        """(k,) rates at the state of the last `look`."""
        return self._work.now[:, 0].copy()

    def _at_rest(self):
        """(k,) 1 for a switch that is held, or rests because of others."""
        return np.maximum(self._work.held[self._freedoms], self._work.modes[:, RESTS])

    def _stop(self, switches):
        """Set the rates of these switches, except rows, to exactly zero."""
        links, n = self._model.switches["link"], len(self._model.bodies)
        for k in switches:
            if not self._is_row[k]:
                row, component = n + links[k], self._model.switches["component"][k]
                self._work.twist[row, component] = self._work.now[k, 0] = 0.0

    def _impact(self, time, state, side, touching, rates, stays):
        """Apply impulses at the stops in contact; `stays`: mask of switches that stop in both directions.

        returns a status
        """
        model, work = self._model, self._work
        work.held[:], work.modes[:, RESTS] = 0.0, 0.0
        work.modes[touching | stays, SLIP] = 0.0
        status = self._look(model, work, *state)
        accelerations = work.now[:, 1].copy()
        if status == OK:
            status = self._respond_at_stage()
        if status != OK:
            return status
        hit = np.flatnonzero(touching | stays)
        restitution = model.switches["restitution"][hit]
        towards = side[hit] * accelerations[hit]
        rebound = restitution * np.maximum(side[hit] * rates[hit], 0.0)
        if self.is_dense:
            self._note_lost(hit, rebound, towards)
            restitution[:] = 0.0
        lowest = self._lowest(state[0])[hit]
        restitution[rebound**2 <= 2.0 * lowest * np.maximum(towards, 0.0)] = 0.0
        A = self._mobility[np.ix_(hit, hit)]
        lo = np.where((side[hit] > 0.0) | stays[hit], -np.inf, 0.0)
        hi = np.where((side[hit] < 0.0) | stays[hit], np.inf, 0.0)
        approach = np.where(side[hit] * rates[hit] > 0.0, rates[hit], 0.0)
        smallest = restitution[side[hit] * rates[hit] > self._still[hit]].min(initial=1.0)
        for e in (restitution, np.full(len(hit), smallest)):
            p, _, at = solve(A, rates[hit] + e * approach, lo, hi)
            after = rates[hit] + p @ A
            after[(at == FREE) & (e * approach == 0.0)] = 0.0
            energy = 0.5 * p * (rates[hit] + after)
            if energy.sum() <= ROUND_OFF * np.abs(p * rates[hit]).sum():
                break
        self._change_rates(model, work, p @ self._responses[hit], *state[:2])
        self._stop(hit[(at == FREE) & (e * approach == 0.0)])
        signs = model.switches["sign"]
        if self.impacts is not None:
            impulses = np.zeros(len(signs))
            impulses[hit] = signs[hit] * p
            self.impacts.append((time, state[0].copy(), work.angle.copy(), impulses))
        for k, impulse, loss in zip(hit, p, energy):
            # Else it is round-off, or friction that ends a slide.
            if abs(impulse) * self._mobility[k, k] > self._still[k] and side[k] != 0.0:
                self.events.append(JointEvent(time, int(k), IMPACT, float(signs[k] * impulse), float(loss)))
        return self._look(model, work, *state)

    def _merge_impacts(self, first, impacts):
        """Add up the impulses of one instant: events from `first` on, and `impacts` from their number on."""
        merged = {}
        for event in self.events[first:]:
            one = merged.get(event.joint)
            merged[event.joint] = (
                event
                if one is None
                else one._replace(impulse=one.impulse + event.impulse, energy=one.energy + event.energy)
            )
        self.events[first:] = merged.values()
        if self.impacts is not None and len(self.impacts) > impacts + 1:
            *place, impulses = self.impacts[impacts]
            self.impacts[impacts:] = [(*place, impulses + sum(more for *_, more in self.impacts[impacts + 1 :]))]

    def _end_soon(self, pose, side):
        """Mask of the switches that leave their stops, or slide, for a way at which rebounds become zero."""
        rates, accelerations = self._work.now.T
        moves = (side * rates < -self._still) | ((self._work.modes[:, SLIP] != 0.0) & (np.abs(rates) > self._still))
        slows = (rates * accelerations < 0.0) & (self._at_rest() == 0.0)
        return moves & slows & (rates**2 <= 2.0 * self._lowest(pose) * np.abs(accelerations))

    def _lowest(self, pose):
        """(k,) height up to which rebounds become zero, rad or m."""
        return self._height(pose, LOW_REBOUND if self.has_many else SMALLEST_REBOUND)

    def _note_lost(self, hit, rebound, towards):
        """Update `lost` for rebounds that become plastic; towards: accelerations towards their stops."""
        with np.errstate(divide="ignore", invalid="ignore"):
            height = np.where(towards > 0.0, rebound**2 / (2.0 * towards), np.inf)
        way = np.minimum(rebound * self.step, height) / self._unit[hit]
        self.lost = max(self.lost, float(way.max(initial=0.0)))

    def _choose(self, state, side, resting, rates, crossed, pressed):
        """Choose the modes of all switches from here on. Returns a status.

        crossed : mask of the guards that are zero: a switch whose effort reached a bound is released,
                  unless it would move back
        pressed : mask of switches that were held or returned to a stop: held if both are possible
        """
        model, work = self._model, self._work
        modes = work.modes
        shares = np.where(modes[:, RESTS] != 0.0, modes[:, EFFORT], 0.0)
        modes[:, SLIP] = np.where(self._dry & ~resting, np.sign(rates), 0.0)
        modes[self._rigid, SIDE] = 0.0
        chosen = np.flatnonzero(resting)
        if not len(chosen):
            work.held[:], modes[:, RESTS] = 0.0, 0.0
            return OK
        self._stop(chosen)
        released = np.where(crossed[chosen, LEAST], LOW, np.where(crossed[chosen, MOST], HIGH, FREE))
        status = OK
        for _ in range(MOST_ITERATIONS):
            status = self._distribute(state, side, chosen, released, pressed, shares)
            if status != OK or not model.has_loads:
                break
            # Repeat until the modes cause the loads for which they were chosen.
            status = self._look_with_loads(state)
            loads = work.loads
            if status != OK or np.abs(loads[:, FOUND] - loads[:, LOAD]).max() <= SAME_LOADS * (loads[:, FOUND].max()):
                break
        else:
            status = NO_FRICTION
        if status == OK:
            self._change_rates(model, work, self._no_changes, *state[:2])
        return status

    def _look_with_loads(self, state):
        """`look` with friction by given loads, those that were found last. Returns a status."""
        work = self._work
        work.iteration[GIVEN] = 1.0
        status = self._look(self._model, work, *state)
        work.iteration[GIVEN] = 0.0
        return status

    def _distribute(self, state, side, chosen, released, pressed, shares):
        """Choose efforts of the switches at rest and which of them move: new modes. Returns a status.

        shares : (k,) efforts of those that rested because of others until now
        """
        model, work = self._model, self._work
        modes, table = work.modes, model.switches
        work.held[:], modes[:, RESTS], modes[chosen, SLIP] = 0.0, 0.0, 0.0
        work.loads[:, LOAD] = work.loads[:, FOUND]
        loads = work.loads[:, LOAD].copy()
        status = self._look_with_loads(state)
        b = work.now[chosen, 1].copy()
        # Forces may cancel: an acceleration is zero if it cannot move the switch within a step.
        round_off = 2.0 * AT_STOP * self._unit[chosen] / self.step**2
        if status == OK:
            status = self._respond_at_stage()
        if status != OK:
            return status
        A = self._mobility[np.ix_(chosen, chosen)]
        at_rest = table["static"] + table["static_by_load"] * loads
        ends = [bounds(at_rest[k], side[k] if self._rigid[k] else 0.0) for k in chosen]
        lo, hi = np.array(ends).T.copy()
        sliding = (table["coulomb"] + table["sliding_by_load"] * loads)[chosen]
        if released.any():
            # A switch that rests because of others, with its effort at the bound to which theirs grow, cannot
            # replace them.
            share = shares[chosen]
            others = (released == FREE) & (share == 0.0)
            grows = A @ released
            grows -= A[:, others] @ np.linalg.lstsq(A[np.ix_(others, others)], grows[others], rcond=REDUNDANT)[0]
            released[(share != 0.0) & (share <= lo * (1.0 - SPENT)) & (grows < 0.0)] = LOW
            released[(share != 0.0) & (share >= hi * (1.0 - SPENT)) & (grows > 0.0)] = HIGH
        for _ in range(2 * len(chosen)):
            x, w, at = solve(A, b, lo, hi, released)
            back = released * w > RETURNING * (np.abs(A) @ np.abs(x) + np.abs(b)) + round_off
            if back.any():
                released[back] = FREE
                continue
            # A switch that breaks away has sliding friction from then on; others bear the rest.
            held, rests = independent(A, at == FREE)
            away = (at != FREE) & ~rests & (np.where(at == LOW, lo, hi) != 0.0)
            away &= np.abs(x) > sliding * (1.0 + 1e-15)
            if not away.any():
                break
            lo[away & (at == LOW)] = -sliding[away & (at == LOW)]
            hi[away & (at != LOW)] = sliding[away & (at != LOW)]
        slow = np.abs(w) <= RETURNING * (np.abs(A) @ np.abs(x) + np.abs(b)) + round_off
        held |= slow & (released == FREE) & pressed[chosen] & ~rests
        rests &= slow
        for i, k in enumerate(chosen):
            modes[k, SIDE] = 0.0 if self._rigid[k] else modes[k, SIDE]
            if self._rigid[k] and (held[i] or rests[i]):
                modes[k, SIDE] = side[k]
            if held[i]:
                work.held[self._freedoms[k]] = 1.0
                if self._is_row[k] and modes[k, SIDE] != 0.0:
                    modes[k, COORDINATE] = table["lower" if side[k] < 0.0 else "upper"][k]
            elif rests[i]:
                modes[k, RESTS], modes[k, EFFORT] = 1.0, x[i]
            elif self._dry[k]:
                modes[k, SLIP] = -at[i]
        work.loads[:, LOAD] = loads
        return OK
