# SPDX-License-Identifier: Apache-2.0
"""Munthe-Kaas methods of any tableau on the state space of a constrained mechanism.

One step of (6.25), stages j = 1..s, on G x R^6n with G = SE(3)^n or (SO(3) x R^3)^n:
    Psi_j = h sum_l a_jl k_l ,   X_j = X_0 exp Psi_j ,   k_j = dexp^-1_{-Psi_j} F(X_j)
    X_1   = X_0 exp(h sum_j b_j k_j)
On the vector part (velocities) exp and dexp are the identity. On SO(3) x R^3 the velocity of the
group is (omega in body axes, rdot in WORLD axes): (6.26) and the note to it.

explicit.py has the step of explicit methods, implicit.py that of implicit ones. The number of stages is data,
so that all tableaux share one compiled `advance`. With an error estimate each step is divided into substeps:
error_control.py.
"""

import math

import numpy as np

from liegroup_core.compiling import SameTypes, borrowed, kernel, stepper
from liegroup_core.dynamics.state import model_and_work
from liegroup_core.events.crossings import first_place
from liegroup_core.events.switching import Switching
from liegroup_core.mechanism.arrays import BEGIN, FURTHER, SPAN, links_of
from liegroup_core.mechanism.bodies import (
    COUNT,
    FROM,
    LARGEST_TURN,
    OFFSET,
    ROUND_OFF,
    SINCE,
    STEP_SIZE,
    STEP_TURN,
    TO,
    UNTIL,
    copy_state,
)
from liegroup_core.methods.table import EXACT, is_positive
from liegroup_core.status import DEPENDENT_ROWS, EVENT, OK, SUBSTEP_TOO_SMALL, TOO_MANY_SUBSTEPS

from . import explicit, implicit
from .ahead import (
    Lead,
    divides,
    ends_step,
    fraction,
    go_on,
    keep,
    keep_lead,
    keep_slopes,
    keep_turns,
    meet_inputs,
    meet_limit,
    recall,
    recall_lead,
    set_turns,
    set_weights,
    shorten,
    start_lead,
    time_before,
    time_left,
    time_of,
)
from .error_control import (
    ACCEPTED,
    AHEAD,
    ATTEMPTED,
    BASE,
    BEGINS,
    COARSE,
    DIVIDED,
    DUE,
    ENTRIES,
    FRESH,
    GROWTH,
    JUMPS,
    KEPT_BASE,
    KEPT_LEAD,
    KEPT_SIZE,
    LAST,
    LEAD,
    LEADS,
    LEFT,
    LENGTH,
    LIMIT,
    LIMIT_BASE,
    LONGER,
    LONGEST,
    MOST,
    NEXT,
    NEXT_AFTER,
    NEXT_BASE,
    PART,
    READY,
    ROUNDED,
    ROUNDING,
    RTOL,
    SIZE,
    SUBSTEPS,
    TOLERANCES,
    judge,
    unlike,
)
from .passage import passage
from .steps import begin, check_end, close, count_turns, enter, has_event, leave, place, rest, store_slopes, watches

MOST_SUBSTEPS = 100_000
MOST_EQUAL = 2.0  # substeps up to a known change that are equal
RUNS_AHEAD = "rkmk853"  # method that runs ahead, to an accuracy
# If no substep meets the tolerance, for example near a singular pose, a step is repeated with these multiples
# of it. With the last one a substep is rejected only if a stage cannot be computed.
LOOSER = (1e2, 1e4, 1e6, 1e8, 1e100)
TOO_TIGHT = (DEPENDENT_ROWS, SUBSTEP_TOO_SMALL, TOO_MANY_SUBSTEPS)


@kernel
def _save(work, pose, twist, control):
    """Save the state at the start of a step for `_restore`."""
    copy_state(pose, twist, work.start_pose, work.start_twist)
    keep_turns(work, work.start_angle, work.start_coordinates)
    control[KEPT_SIZE] = control[SIZE]


@kernel
def _coarsen(factor, pose, twist):
    """Round all numbers to b fewer bits; factor : 2^b + 1 (Veltkamp's splitting)."""
    for i in range(len(pose)):
        for c in range(12):
            large = factor * pose[i, c]
            pose[i, c] = large - (large - pose[i, c])
        for c in range(6):
            large = factor * twist[i, c]
            twist[i, c] = large - (large - twist[i, c])


@kernel
def _restore(work, pose, twist, control):
    """Restore the state saved by `_save`."""
    copy_state(work.start_pose, work.start_twist, pose, twist)
    set_turns(work, work.start_angle, work.start_coordinates)
    control[SIZE] = control[KEPT_SIZE]


@stepper
def advance(model, work, scheme, h, steps, pose_in, twist_in, external_in, control):
    """Take `steps` steps of size h in place of pose (n, 12) and twist (n, 6).

    model, work     : RelativeModel or PlaneModel, and RelativeWork
    external        : external wrenches of these steps, see forces/external.py
    control (28,)   : see error_control.py; AHEAD: the integration may run ahead, see ahead.py
    returns (steps done, status): fewer steps if status is not OK, or ahead before a step with an event. Pose, twist
    and work.angle are those of the last valid step, but after EVENT, if not ahead, of the last valid substep. The low
    byte of status is the code. The other bytes are the element for DEPENDENT_ROWS, and for TURNS_NOT_COUNTED the
    torsional spring, or the switch, counted after the springs.

    Steps, substeps and stages are loops of one function, because the mechanics are inlined and compiled
    wherever they are called.
    """
    pose_in, twist_in = borrowed(pose_in), borrowed(twist_in)
    external_in, control = borrowed(external_in), borrowed(control)
    ahead = control[AHEAD] != 0.0
    if ahead:
        meet_inputs(work, external_in, control)
        keep_turns(work, work.start_angle, work.start_coordinates)
    if ahead and control[LEADS] != 0.0:
        meet_limit(work, control)
        pose, twist, external, status = enter(model, work, work.pose, work.twist, external_in)
        set_turns(work, work.lead_angle, work.lead_coordinates)
    else:
        if ahead:
            start_lead(work, control)
        pose, twist, external, status = enter(model, work, pose_in, twist_in, external_in)
        if ahead and watches(model, work):
            rest(model, work, twist)
    if status != OK:
        return 0, status
    controlled = len(scheme.error) > 0
    watching = watches(model, work)
    stages, inside = scheme.error.shape[1] - 1, len(scheme.a) - 1
    first, last = 0, stages + 1  # first: 1 if the last substep has already written the derivatives of stage 0
    done, rounds, failed, remaining = 0, steps, OK, 0.0
    if ahead:
        rounds = min(1, steps)
        first = 1 if control[FRESH] != 0.0 else 0
    step, left, at_limit, implicitly = work.clock[STEP_SIZE], 0.0, False, len(scheme.newton.z) > 0
    while done < rounds and status == OK:
        if controlled and not ahead:
            _save(work, pose, twist, control)
        remaining = h
        start = (work.clock[COUNT] + done) * h + work.clock[OFFSET]
        if ahead:
            remaining = time_left(work, control)
        if len(work.motions) > 0:
            first = 0  # the time at the end of the last step differs by round-off
        attempts, planned, tried = 0, 0, control[SIZE]
        if ahead and remaining > 0.0 and control[DUE] != 0.0:
            status = EVENT
        while status == OK and (remaining > 0.0 or ahead and remaining < 0.0):
            count, since, origin, rates, is_step = 1, h - remaining, pose, twist, remaining > 0.0
            if ahead:
                since = 0.0
            if not is_step:
                # The caller's time is inside the kept substep.
                origin, rates = work.kept_pose, work.kept_twist
                start, size = time_of(control[KEPT_BASE], control[KEPT_LEAD], step), control[LAST]
                first, last = inside, inside + 1
                if not implicitly:
                    recall(work)
                if control[READY] == 0.0 and not implicitly:
                    # The derivative at the end before a projection is not known either.
                    first, last = stages + 1 - model.projects, inside
                elif not implicitly:
                    set_weights(scheme, fraction(work, control))
            elif ahead:
                # Equal substeps up to a known change.
                start, size = time_of(control[BASE], control[LEAD], step), control[SIZE]
                left = control[LEFT]
                if 0.0 < left < size * MOST_EQUAL:
                    count = max(1, math.ceil(left / size - 1e-6))
                    size = left / count
                    if divides(control):
                        count, size = count + 1, size * DIVIDED
                at_limit = count == 1 and size == left
                if control[BEGINS] == 0.0:
                    start, since = 0.0, start  # an implicit method keeps its Jacobian
                control[BEGINS] = 0.0
                if first == 1:
                    recall_lead(work)
            else:
                if controlled:
                    # Equal substeps up to the end of the step, so that the last one is not tiny.
                    count = max(1, math.ceil(remaining / control[SIZE] - 1e-6))
                if remaining == h and control[LONGER] > 0.0:
                    planned = unlike(work, control, h, count)
                count = max(count, planned)
                size = remaining / count
            work.report[STEP_TURN] = work.report[ROUND_OFF] = 0.0
            begin(model, work, origin, rates)
            if implicitly and not is_step:
                status = implicit.inside(scheme, model, work, fraction(work, control), start, size, origin)
            elif implicitly:
                status = implicit.substep(scheme, model, work, size, start, since, first, pose, external)
            else:
                status = explicit.substep(scheme, model, work, size, start, since, first, last, origin, external)
            if not is_step:
                if status == OK and control[READY] == 0.0 and not implicitly:
                    keep_slopes(work)
                    control[READY] = 1.0
                    continue
                if status == OK and model.projects:
                    status = close(model, work, True)
                break
            attempts += 1
            if status == OK:
                status = check_end(model, work, size)
            if controlled:
                if status == OK:
                    first = 1
                    if ahead and control[FRESH] == 0.0:
                        keep_lead(work, control)
                status, accepted = judge(model, work, scheme, step, size, status, twist, control)
                ends = accepted and (size >= remaining if ahead else count == 1)
                most = control[MOST] * steps if ahead else control[MOST]  # a halt sets it from another thread
                if status == OK and attempts >= most and not ends:
                    status = TOO_MANY_SUBSTEPS
                if status == OK and not accepted:
                    continue
            if status == OK and watching:
                if has_event(model, work, scheme, h - remaining, size):
                    status = EVENT
                    if ahead and shorten(work, control, size, first_place(model, work)):
                        control[ACCEPTED] -= 1.0
                        status = OK
                        continue
            if status == OK and model.projects:
                status = close(model, work, controlled)
            if status == OK and ahead and (size >= remaining or ends_step(work, control, size, at_limit)):
                keep(work, pose, twist, size, control)
                if implicitly:
                    implicit.keep_stages(scheme, work)
                else:
                    keep_slopes(work)
            if status == OK and controlled:
                # First same as last: the end of a substep is stage 0 of the next one, where Psi is
                # zero. Projection changes the end, so that it must be evaluated again.
                store_slopes(model, work, scheme, 0)
                first = 0 if model.projects else 1
            if status == OK:
                count_turns(model, work)
                copy_state(work.stage_pose, work.stage_twist, pose, twist)
                if control[COARSE] > 0.0:
                    _coarsen(control[COARSE], pose, twist)
                    first = 0
                work.report[LARGEST_TURN] = max(work.report[LARGEST_TURN], work.report[STEP_TURN])
                remaining, planned = remaining - size if count > 1 else 0.0, planned - 1
            if status == OK and ahead:
                tried = control[SIZE]
                go_on(work, control, size, at_limit)
                remaining = time_left(work, control)
                control[FRESH] = 0.0
                if first == 1:
                    keep_lead(work, control)
        if status == EVENT and ahead:
            work.watch[BEGIN] = time_before(work, control)
        if status == EVENT and ahead and control[BASE] > work.clock[FROM]:
            # The caller's state becomes that at the start of the step with the event, which follows in the next call.
            status, steps, work.clock[TO] = OK, int(control[BASE] - work.clock[FROM]), control[BASE]
            work.clock[UNTIL] = 0.0
        elif status == OK:
            done += 1
        elif controlled and status != EVENT:
            control[PART] = 0.0
            if status == TOO_MANY_SUBSTEPS:
                control[PART] = attempts / (attempts + remaining / control[SIZE])
            if not ahead:
                _restore(work, pose, twist, control)
            elif failed == OK:
                control[SIZE] = tried
                passed = int(control[BASE] - work.clock[FROM])
                if 0 < passed < steps:
                    # The caller's state becomes that of the last step that the lead has passed.
                    failed, status, steps = status, OK, passed
                    work.clock[TO] = control[BASE]
    if not ahead:
        if done > 0 or status == EVENT:
            leave(model, work, pose, twist, pose_in, twist_in)
        return done, status
    keep_turns(work, work.lead_angle, work.lead_coordinates)
    if status != OK or steps == 0:
        set_turns(work, work.start_angle, work.start_coordinates)
        return 0, status
    if remaining < 0.0:
        set_turns(work, work.kept_angle, work.kept_coordinates)
        count_turns(model, work)
    else:
        begin(model, work, pose, twist)
    place(model, work, pose_in, twist_in)
    return steps, failed


class MuntheKaas:
    """Munthe-Kaas method of a tableau of METHODS for a model, with its memory between calls.

    dexpinv    : "exact", or "truncated" to the powers of ad that an explicit method's order needs
    space      : "auto": in relative coordinates planar mechanisms (mechanism/planar.py)
                 move in their plane; "space": all mechanisms move in space
    rtol, atol : tolerances of error control, only for a tableau with an error estimate; see above

    passes     : True: a step that cannot meet its tolerance is taken with a larger one, see `follow_accuracy`
    """

    passes = _may_run_ahead = False

    def __init__(self, method, layout, group, step, options):
        self.controlled = method.controlled
        self._longest = step
        self._truncated = options.get("dexpinv") == "truncated"
        stages = 1 if method.implicit else len(method.tableau.b)
        self._model, self._work, self.work = model_and_work(layout, group, options, stages)
        self._blocks = stages + 1 + FURTHER
        self._control = np.zeros(ENTRIES)
        self._control[MOST], self._control[LENGTH] = MOST_SUBSTEPS, 1.0
        self._tolerances = options.get("rtol", 0.0), options.get("atol", 1.0)
        self._lead = Lead(self._work, self._control)
        self._methods, self._chosen, self._part = [], np.zeros(1), 1.0
        self.add(method)
        self._passage = SameTypes(passage)
        self.switching = None
        if len(self._model.switches):
            self.switching = Switching(self._model, self._work, self._pass, self._control, self._lead)
        self.restart()

    def add(self, method, looser=1.0):
        """Add a method with error control for `choose`; its tolerances are multiplied by `looser`."""
        if method.implicit:
            scheme = explicit.make_implicit_scheme(method.tableau, self.freedoms)
        else:
            highest = max(method.order - 2, 0) if self._truncated else EXACT
            scheme = explicit.make_scheme(method.tableau, highest, method.name == RUNS_AHEAD)
        self._methods.append((scheme, SameTypes(advance), looser))
        self.tighten(self._part)

    @property
    def freedoms(self):
        """Number of freedoms of the joints, or of the bodies."""
        return self._work.slopes.size // (2 * self._blocks)

    @staticmethod
    def options(method):
        """{name: (default, description of valid values, check)} of the method's options."""
        choices = {"dexpinv": ("exact", "truncated"), "space": ("auto", "space")}
        if method.implicit:
            del choices["dexpinv"]  # there is no order at which its iterations could stop
        options = {
            name: (values[0], " or ".join(map(repr, values)), values.__contains__) for name, values in choices.items()
        }
        if method.controlled:
            options["rtol"] = options["atol"] = (1e-6, "a positive number", is_positive)
        return options

    def restart(self):
        """Clear the memory between calls: the state was set."""
        self.clear()
        if self.switching is not None:
            self.switching.restart()

    def clear(self):
        """Clear the memory, but for the modes of stops and friction."""
        self._control[SUBSTEPS] = self._longest, 0.0, 0.0, self._longest
        self._control[LEADS : FRESH + 1] = 0.0
        self._control[BEGINS] = 1.0
        self.stop_at(math.inf, 0.0, math.inf)
        self._control[LONGEST] = math.inf if self._may_run_ahead else self._longest
        self._control[GROWTH : JUMPS + 1] = 0.0
        self._chosen[0] = 0.0
        self._set_ahead()
        self._work.known[0] = 0.0

    def tighten(self, part):
        """Set the tolerances to a fraction of those of the options."""
        self._part = part
        looser = self._methods[self.chosen][2]
        for k, tolerance in enumerate(self._tolerances):
            self._control[RTOL + k] = part * looser * tolerance

    def follow_accuracy(self, length, bits):
        """Take all steps, none with tolerances below round-off. length : m, factor of tolerances of positions.

        bits : number of bits that are rounded away after every substep; a lower bound of tolerances, too
        """
        self.passes = True
        self._may_run_ahead = True
        self._set_ahead()
        self._control[COARSE] = 2.0**bits + 1.0 if bits else 0.0
        self._control[LENGTH] = length
        self._control[ROUNDED] = ROUNDING * max(1.0, self._control[COARSE])

    @property
    def runs_ahead(self):
        """Whether the integration runs ahead of the caller, see ahead.py."""
        return self._lead.runs

    @property
    def jumps(self):
        """Number of substeps since the restart in which the order is not seen, see `JUMPS`."""
        return int(self._control[JUMPS])

    @property
    def spent(self):
        """Copies of the numbers of evaluations of all methods."""
        return [scheme.spent.copy() for scheme, *_ in self._methods]

    @spent.setter
    def spent(self, spent):
        for (scheme, *_), numbers in zip(self._methods, spent):
            scheme.spent[:] = numbers

    @property
    def lead(self):
        """(whole steps, s after them) that the integration has reached."""
        return self._lead.time(BASE)

    def has_others(self, external):
        """Whether the integration ran ahead with other inputs, or another time at which they change."""
        work, control = self._work, self._control
        if control[NEXT_BASE] != control[LIMIT_BASE] or control[NEXT] != control[LIMIT]:
            return True
        now = external, work.wanted, work.motions, work.acting
        then = work.lead_external, work.lead_wanted, work.lead_motions, work.lead_acting
        return any((one != other).any() for one, other in zip(now, then) if len(one))

    @property
    def kept_from(self):
        """(whole steps, s after them) from which on states inside substeps are known."""
        return self._lead.time(KEPT_BASE)

    def _set_ahead(self):
        ahead = self._may_run_ahead and len(self._methods[self.chosen][0].inside) > 0
        self._control[AHEAD] = float(ahead)
        self._control[LONGEST] = math.inf if ahead else self._longest

    def choose(self, number):
        """Continue with another of the methods, by its number in the order of `add`."""
        if number != self.chosen:
            self._control[SIZE] = self._longest
            self._lead.go_back()  # the state ahead is that of the other method
            self._work.kept_slopes[:] = 0.0  # equal states have equal snapshots
        self._chosen[0] = number
        self._set_ahead()
        self.tighten(self._part)

    @property
    def chosen(self):
        """Number of the present method."""
        return int(self._chosen[0])

    @property
    def evaluations(self):
        """Number of evaluations of the accelerations under error control, of all methods so far. Solves of
        linear systems count as evaluations that take as long.
        """
        return sum(float(scheme.spent[0]) for scheme, *_ in self._methods)

    def limit_attempts(self, most=MOST_SUBSTEPS):
        """Set the largest number of attempted substeps in a step."""
        self._control[MOST], self._control[PART] = most, 0.0

    @property
    def part(self):
        """Fraction of its attempts that the last step made before it failed because of too many; otherwise 0."""
        return float(self._control[PART])

    def limit(self, longest, longer=0.0):
        """Set the longest substep in s and, of a companion with given tolerances, its ratio q; and restart."""
        self._longest, self._control[LONGER] = longest, longer
        self.restart()

    @property
    def links(self):
        """(RelativeModel, RelativeWork) of the method."""
        return self._model, self._work

    @property
    def memory(self):
        """Arrays of the memory between calls: substeps of error control, relative coordinates."""
        control = (self._control[SUBSTEPS], self._control[GROWTH:READY], self._chosen) if self.controlled else ()
        work = self._work
        # The derivatives of further stages, and of an end that is projected, are computed again.
        blocks = self._blocks - FURTHER - self._model.projects
        known = work.kept_slopes[: blocks * 2 * self.freedoms // work.kept_slopes.shape[1]]
        lead = (
            (work.pose, work.twist, work.lead_angle, work.kept_pose, work.kept_twist, known)
            + (work.kept_angle, work.lead_external, work.lead_wanted, work.lead_acting, work.lead_motions)
            + (work.lead_coordinates, work.kept_coordinates, work.watch[SPAN:], work.crossed)
            if self._may_run_ahead
            else ()
        )
        return (*control, *links_of(work), *lead)

    @property
    def substeps(self):
        """Numbers of accepted and attempted substeps since the restart; 0 without error control."""
        return int(self._control[ACCEPTED]), int(self._control[ATTEMPTED])

    def stop_at(self, step, since, after):
        """Let a substep end where inputs will change: whole steps, s after them, s after the call; inf: at no time."""
        self._control[NEXT_BASE : NEXT_AFTER + 1] = step, since, after

    def advance(self, h, steps, pose, twist, external):
        """Take steps of size h in place; returns (steps done, status)."""
        advance = self._pass if self.switching is None else self.switching.advance
        return advance(h, steps, pose, twist, external)

    def look_ahead(self, h, pose, twist, external):
        """As `advance` of one step, for reading; status EVENT, and nothing done, if an event may come before."""
        if self.switching is None:
            return self._pass(h, 1, pose, twist, external)
        if not self.switching.is_settled(external):
            return 0, EVENT
        end = self._work.clock[TO : UNTIL + 1].copy()
        done, status = self._pass(h, 1, pose, twist, external)
        is_before = (self._work.clock[TO : UNTIL + 1] != end).any()
        return done, EVENT if status == OK and is_before else status

    def passage(self, *given):
        """Go through parts of time, see passage.py; returns (parts done, status). Only without error control."""
        return self._passage(self._model, self._work, self._methods[0][0], *given)

    def _pass(self, h, steps, pose, twist, external):
        """Take steps, with larger tolerances where that is allowed and needed."""
        clock = self._work.clock
        end = clock[TO]
        done, status = self._take(h, steps, pose, twist, external)
        if not (self.passes and status & 0xFF in TOO_TIGHT):
            return done, status
        first, begin = clock[COUNT], clock[FROM]
        whole = clock[SINCE] == clock[UNTIL] == 0.0  # not a part of a step

        def go_on(count):
            clock[COUNT] = first + done
            if whole:
                clock[FROM], clock[TO] = begin + done, begin + done + count
            return self._take(h, count, pose, twist, external)

        # A halt, which sets MOST to 0 from another thread, is no reason for a larger tolerance.
        while self.passes and status & 0xFF in TOO_TIGHT and self._control[MOST] > 0.0:
            tolerances, longest = self._control[TOLERANCES].copy(), self._control[LONGEST]
            self._control[LONGEST] = self._longest  # no errors of that size further ahead
            one = 0
            for factor in LOOSER:
                if self._control[MOST] == 0.0:
                    break
                self._control[TOLERANCES] = factor * tolerances
                self._control[SIZE] = min(self._control[SIZE], self._longest)
                one, status = go_on(1)
                if one or status & 0xFF not in TOO_TIGHT:
                    break
            self._control[TOLERANCES], self._control[LONGEST] = tolerances, longest
            if not one:
                break
            done += 1
            if done < steps:
                more, status = go_on(steps - done)
                done += more
        clock[COUNT], clock[FROM], clock[TO] = first, begin, end
        return done, status

    def _take(self, h, steps, pose, twist, external):
        scheme, advance_with, _ = self._methods[self.chosen]
        return advance_with(self._model, self._work, scheme, h, steps, pose, twist, external, self._control)
