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
from liegroup_core.events.switching import Switching
from liegroup_core.mechanism.arrays import links_of
from liegroup_core.mechanism.bodies import COUNT, LARGEST_TURN, OFFSET, ROUND_OFF, STEP_TURN, copy_state
from liegroup_core.methods.table import EXACT, is_positive
from liegroup_core.status import DEPENDENT_ROWS, EVENT, OK, SUBSTEP_TOO_SMALL, TOO_MANY_SUBSTEPS

from . import explicit, implicit
from .error_control import (
    ACCEPTED,
    ATTEMPTED,
    COARSE,
    GROWTH,
    KEPT_SIZE,
    LENGTH,
    LONGEST,
    MOST,
    PART,
    ROUNDED,
    ROUNDING,
    RTOL,
    SIZE,
    SUBSTEPS,
    TOLERANCES,
    judge,
)
from .steps import begin, check_end, close, count_turns, enter, has_event, leave, store_slopes, watches

MOST_SUBSTEPS = 100_000
# If no substep meets the tolerance, for example near a singular pose, a step is repeated with these multiples
# of it. With the last one a substep is rejected only if a stage cannot be computed.
LOOSER = (1e2, 1e4, 1e6, 1e8, 1e100)
TOO_TIGHT = (DEPENDENT_ROWS, SUBSTEP_TOO_SMALL, TOO_MANY_SUBSTEPS)


@kernel
def _save(work, pose, twist, control):
    """Save the state at the start of a step for `_restore`."""
    copy_state(pose, twist, work.start_pose, work.start_twist)
    for i in range(len(work.angle)):
        work.start_angle[i] = work.angle[i]
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
    for i in range(len(work.angle)):
        work.angle[i] = work.start_angle[i]
    control[SIZE] = control[KEPT_SIZE]


@stepper
def advance(model, work, scheme, h, steps, pose_in, twist_in, external_in, control):
    """Take `steps` steps of size h in place of pose (n, 12) and twist (n, 6).

    model, work     : RelativeModel or PlaneModel, and RelativeWork
    external        : external wrenches of these steps, see forces/external.py
    control (13,)   : see error_control.py
    returns (steps done, status): fewer steps if status is not OK. Pose, twist and work.angle are
    those of the last valid step, after EVENT of the last valid substep. The low byte of status is
    the code. The other bytes are the element for DEPENDENT_ROWS, and for TURNS_NOT_COUNTED the torsional
    spring, or the switch, counted after the springs.

    Steps, substeps and stages are loops of one function, because the mechanics are inlined and compiled
    wherever they are called.
    """
    pose_in, twist_in = borrowed(pose_in), borrowed(twist_in)
    external_in, control = borrowed(external_in), borrowed(control)
    pose, twist, external, status = enter(model, work, pose_in, twist_in, external_in)
    if status != OK:
        return 0, status
    controlled = len(scheme.error) > 0
    watching = watches(model, work)
    first = 0  # 1: the last substep has already written the derivatives of stage 0
    done = 0
    while done < steps and status == OK:
        if controlled:
            _save(work, pose, twist, control)
        remaining = h
        start = (work.clock[COUNT] + done) * h + work.clock[OFFSET]
        if len(work.motions) > 0:
            first = 0  # the time at the end of the last step differs by round-off
        attempts = 0
        while remaining > 0.0 and status == OK:
            count = 1
            if controlled:
                # Equal substeps up to the end of the step, so that the last one is not tiny.
                count = max(1, math.ceil(remaining / control[SIZE] - 1e-6))
            size = remaining / count
            attempts += 1
            work.report[STEP_TURN] = work.report[ROUND_OFF] = 0.0
            begin(model, work, pose, twist)
            if len(scheme.newton.z) > 0:
                status = implicit.substep(scheme, model, work, size, start, h - remaining, first, pose, external)
            else:
                status = explicit.substep(scheme, model, work, size, start, h - remaining, first, pose, external)
            if status == OK:
                status = check_end(model, work, size)
            if controlled:
                if status == OK:
                    first = 1
                status, accepted = judge(model, work, scheme, h, size, status, twist, control)
                if status == OK and attempts >= control[MOST] and not (accepted and count == 1):
                    status = TOO_MANY_SUBSTEPS
                if status == OK and not accepted:
                    continue
            if status == OK and watching:
                if has_event(model, work, scheme, h - remaining, size):
                    status = EVENT
            if status == OK and model.projects:
                status = close(model, work, controlled)
            if status != OK:
                break
            if controlled:
                # First same as last: the end of a substep is stage 0 of the next one, where Psi is
                # zero. Projection changes the end, so that it must be evaluated again.
                store_slopes(model, work, scheme, 0)
                first = 0 if model.projects else 1
            count_turns(model, work)
            copy_state(work.stage_pose, work.stage_twist, pose, twist)
            if control[COARSE] > 0.0:
                _coarsen(control[COARSE], pose, twist)
                first = 0
            work.report[LARGEST_TURN] = max(work.report[LARGEST_TURN], work.report[STEP_TURN])
            remaining = remaining - size if count > 1 else 0.0
        if status == OK:
            done += 1
        elif controlled and status != EVENT:
            control[PART] = 0.0
            if status == TOO_MANY_SUBSTEPS:
                control[PART] = attempts / (attempts + remaining / control[SIZE])
            _restore(work, pose, twist, control)
    if done > 0 or status == EVENT:
        leave(model, work, pose, twist, pose_in, twist_in)
    return done, status


class MuntheKaas:
    """Munthe-Kaas method of a tableau of METHODS for a model, with its memory between calls.

    dexpinv    : "exact", or "truncated" to the powers of ad that an explicit method's order needs
    space      : "auto": in relative coordinates planar mechanisms (mechanism/planar.py)
                 move in their plane; "space": all mechanisms move in space
    rtol, atol : tolerances of error control, only for a tableau with an error estimate; see above

    passes     : True: a step that cannot meet its tolerance is taken with a larger one, see `follow_accuracy`
    """

    passes = False

    def __init__(self, method, layout, group, step, options):
        self.controlled = method.controlled
        self._longest = step
        self._truncated = options.get("dexpinv") == "truncated"
        stages = 1 if method.implicit else len(method.tableau.b)
        self._model, self._work, self.work = model_and_work(layout, group, options, stages)
        self._blocks = stages + 1
        self._control = np.zeros(13)
        self._control[MOST], self._control[LENGTH] = MOST_SUBSTEPS, 1.0
        self._tolerances = options.get("rtol", 0.0), options.get("atol", 1.0)
        self._methods, self._chosen, self._part = [], np.zeros(1), 1.0
        self.add(method)
        self.switching = None
        if len(self._model.switches):
            self.switching = Switching(self._model, self._work, layout.switch_sizes, self._pass, self._control)
        self.restart()

    def add(self, method, looser=1.0):
        """Add a method with error control for `choose`; its tolerances are multiplied by `looser`."""
        if method.implicit:
            scheme = explicit.make_implicit_scheme(method.tableau, self.freedoms)
        else:
            highest = max(method.order - 2, 0) if self._truncated else EXACT
            scheme = explicit.make_scheme(method.tableau, highest)
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
        self._control[SUBSTEPS] = self._longest, 0.0, 0.0, self._longest
        self._control[LONGEST], self._control[GROWTH] = self._longest, 0.0
        self._chosen[0] = 0.0
        self._work.known[0] = 0.0
        if self.switching is not None:
            self.switching.restart()

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
        self._control[COARSE] = 2.0**bits + 1.0 if bits else 0.0
        self._control[LENGTH] = length
        self._control[ROUNDED] = ROUNDING * max(1.0, self._control[COARSE])

    def choose(self, number):
        """Continue with another of the methods, by its number in the order of `add`."""
        if number != self.chosen:
            self._control[SIZE] = self._longest
        self._chosen[0] = number
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

    def limit(self, longest):
        """Set the longest substep in s, and restart."""
        self._longest = longest
        self.restart()

    @property
    def links(self):
        """(RelativeModel, RelativeWork) of the method."""
        return self._model, self._work

    @property
    def memory(self):
        """Arrays of the memory between calls: substeps of error control, relative coordinates."""
        control = (self._control[SUBSTEPS], self._control[GROWTH:], self._chosen) if self.controlled else ()
        return (*control, *links_of(self._work))

    @property
    def substeps(self):
        """Numbers of accepted and attempted substeps since the restart; 0 without error control."""
        return int(self._control[ACCEPTED]), int(self._control[ATTEMPTED])

    def advance(self, h, steps, pose, twist, external):
        """Take steps of size h in place; returns (steps done, status)."""
        advance = self._pass if self.switching is None else self.switching.advance
        return advance(h, steps, pose, twist, external)

    def _pass(self, h, steps, pose, twist, external):
        """Take steps, with larger tolerances where that is allowed and needed."""
        done, status = self._take(h, steps, pose, twist, external)
        while self.passes and status & 0xFF in TOO_TIGHT:
            tolerances = self._control[TOLERANCES].copy()
            for factor in LOOSER:
                self._control[TOLERANCES] = factor * tolerances
                one, status = self._take(h, 1, pose, twist, external)
                if one or status & 0xFF not in TOO_TIGHT:
                    break
            self._control[TOLERANCES] = tolerances
            if not one:
                break
            done += 1
            if done < steps:
                more, status = self._take(h, steps - done, pose, twist, external)
                done += more
        return done, status

    def _take(self, h, steps, pose, twist, external):
        scheme, advance_with, _ = self._methods[self.chosen]
        return advance_with(self._model, self._work, scheme, h, steps, pose, twist, external, self._control)
