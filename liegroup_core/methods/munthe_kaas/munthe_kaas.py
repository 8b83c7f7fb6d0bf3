# SPDX-License-Identifier: Apache-2.0
"""Munthe-Kaas methods of any tableau on the state space of a constrained mechanism.

One step of (6.25), stages j = 1..s, with G = SE(3)^n, (SO(3) x R^3)^n, or the product of the joints' motion groups:
    Psi_j = h sum_l a_jl k_l ,   X_j = X_0 exp Psi_j ,   k_j = dexp^-1_{-Psi_j} F(X_j)
    X_1   = X_0 exp(h sum_j b_j k_j)
On the vector part (velocities) exp and dexp are the identity. On SO(3) x R^3 the velocity of the
group is (omega in body axes, rdot in WORLD axes): (6.26) and the note to it.

explicit.py has the step of explicit methods, implicit.py that of implicit ones, advance.py the loops over them. The
number of stages is data, so that all tableaux share one compiled code. With an error estimate each step is divided into
substeps: error_control.py.
"""

import math

import numpy as np

from liegroup_core.compiling import SameTypes
from liegroup_core.dynamics.state import model_and_work
from liegroup_core.dynamics.switches import ROUND_OFF
from liegroup_core.events.switching import Switching
from liegroup_core.forces.formulas import SHARED
from liegroup_core.mechanism.arrays import FURTHER, SPAN, links_of
from liegroup_core.methods.table import EXACT
from liegroup_core.status import DEPENDENT_ROWS, EVENT, OK, SUBSTEP_TOO_SMALL, TOO_MANY_SUBSTEPS

from . import explicit
from .advance import advance, advance_controlled, inside, reach
from .ahead import Lead
from .control import SubstepControl
from .error_control import ROUNDING
from .passage import passage

MOST_SUBSTEPS = 100_000
RUNS_AHEAD = "rkmk853"  # method that runs ahead, to an accuracy
# If no substep meets the tolerance, for example near a singular pose, a step is repeated with these multiples
# of it. With the last one a substep is rejected only if a stage cannot be computed.
LOOSER = (1e2, 1e4, 1e6, 1e8, 1e100)
UNSEEN = 1e-2  # of the error that a substep may have: a law that changes its branch with less effect needs no event
KERNELS = advance, advance_controlled, reach, inside
TOO_TIGHT = (DEPENDENT_ROWS, SUBSTEP_TOO_SMALL, TOO_MANY_SUBSTEPS)


class MuntheKaas:
    """Munthe-Kaas method of a tableau of METHODS for a model, with its memory between calls.

    passes : True: a step that cannot meet its tolerance is taken with a larger one, see `follow_accuracy`
    """

    passes = _may_run_ahead = False

    def __init__(self, method, layout, group, step, options):
        self.controlled = method.controlled
        self._longest = step
        self._truncated = options.get("dexpinv") == "truncated"
        stages = 1 if method.implicit else len(method.tableau.b)
        locates = method.controlled or options.get("locates", False)
        located = len(layout.model.forces.laws.kinks) if locates else 0
        self._model, self._work, self.work = model_and_work(layout, group, options, stages, located)
        self._blocks = stages + 1 + FURTHER
        self._control = SubstepControl.make()
        self._control.most[0], self._control.dear[0], self._control.length[0] = MOST_SUBSTEPS, math.inf, 1.0
        self._tolerances = options.get("rtol", 0.0), options.get("atol", 1.0)
        self._lead = Lead(self._work, self._control)
        self._methods, self._chosen, self._part = [], np.zeros(1), 1.0
        self.add(method)
        self._passage = SameTypes(passage)
        self.switching = None
        if len(self._work.guards):
            steps = self._pass, self._step, self._control, lambda: self._methods[self.chosen][0].weights, self._lead
            touching = layout.touching if method.controlled else None
            self.switching = Switching(self._model, self._work, *steps, touching)
        self.restart()

    def add(self, method, looser=1.0):
        """Add a method with error control for `choose`; its tolerances are multiplied by `looser`."""
        if method.implicit:
            scheme = explicit.make_implicit_scheme(method.tableau, self.freedoms)
        else:
            highest = max(method.order - 2, 0) if self._truncated else EXACT
            scheme = explicit.make_scheme(method.tableau, highest, method.name == RUNS_AHEAD)
        self._methods.append((scheme, [SameTypes(each) for each in KERNELS], looser))
        self.tighten(self._part)

    @property
    def freedoms(self):
        """Number of freedoms of the joints, or of the bodies, and states of laws."""
        return self._work.slopes.size // (2 * self._blocks)

    def restart(self):
        """Clear the memory between calls: the state was set."""
        self.clear()
        if self.switching is not None:
            self.switching.restart()

    def clear(self):
        """Clear the memory, but for the modes of stops and friction."""
        self._control.part_of("size", "kept_size")[:] = self._longest, 0.0, 0.0, self._longest
        self._control.part_of("leads", "fresh")[:] = 0.0
        self._control.begins[0] = 1.0
        self._control.part_of("next_base", "next_after")[:] = math.inf, 0.0, math.inf
        self._control.longest[0] = math.inf if self._may_run_ahead else self._longest
        self._control.part_of("growth", "jumps")[:] = 0.0
        self._chosen[0] = 0.0
        self._forget_jacobians()
        self._set_ahead()
        self._work.known[0] = 0.0

    def _forget_jacobians(self):
        for scheme, *_ in self._methods:
            scheme.newton.known[:] = 0.0

    def tighten(self, part):
        """Set the tolerances to a fraction of those of the options."""
        self._part = part
        looser = self._methods[self.chosen][2]
        for k, tolerance in enumerate(self._tolerances):
            self._control.part_of("rtol", "atol")[k] = part * looser * tolerance
        self._work.least[0] = max(ROUND_OFF, UNSEEN * self._control.rtol[0])

    def follow_accuracy(self, length, bits):
        """Take all steps, none with tolerances below round-off. length : m, factor of tolerances of positions.

        bits : number of bits that are rounded away after every substep; a lower bound of tolerances, too
        """
        self.passes = True
        self._may_run_ahead = True
        self._set_ahead()
        self._control.coarse[0] = 2.0**bits + 1.0 if bits else 0.0
        self._control.length[0] = length
        self._control.rounded[0] = ROUNDING * max(1.0, self._control.coarse[0])

    @property
    def runs_ahead(self):
        """Whether the integration runs ahead of the caller, see ahead.py."""
        return self._lead.runs

    @property
    def jumps(self):
        """Number of substeps since the restart in which the order is not seen, see `JUMPS`."""
        return int(self._control.jumps[0])

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
        return self._lead.time

    def forget(self):
        """Forget the last substep, because no state in it is needed."""
        self._lead.forget()

    def inside(self, *state):
        """Set pose, twist, angles and coordinates of switches to the caller's time, up to which it ran; a status."""
        scheme, (*_, show), _ = self._methods[self.chosen]
        return show(self._model, self._work, scheme, *state, self._control)

    def _set_ahead(self):
        ahead = self._may_run_ahead and len(self._methods[self.chosen][0].inside) > 0
        self._control.ahead[0] = float(ahead)
        self._control.longest[0] = math.inf if ahead else self._longest

    def choose(self, number):
        """Continue with another of the methods, by its number in the order of `add`."""
        if number != self.chosen:
            self._control.size[0] = self._longest
            self._lead.go_back()  # the state ahead is that of the other method
            self._forget_jacobians()
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
        self._control.most[0], self._control.part[0] = most, 0.0

    def limit_evaluations(self, most=math.inf):
        """Set the largest number of further evaluations with the present method, after which a step fails."""
        self._control.dear[0] = most + self._methods[self.chosen][0].spent[0]
        self._control.part[0] = 0.0

    @property
    def part(self):
        """Fraction of its attempts that the last step made before it failed because of too many; otherwise 0."""
        return float(self._control.part[0])

    def limit(self, longest, longer=0.0):
        """Set the longest substep in s and, of a companion with given tolerances, its ratio q; and restart."""
        self._longest, self._control.longer[0] = longest, longer
        self.restart()

    @property
    def mechanism(self):
        """(RelativeModel, RelativeWork) of the method."""
        return self._model, self._work

    @property
    def mask_before(self):
        """Place in `memory` at which that of earlier versions has a mask of the wrenches of the scene, or None."""
        return 15 if self._may_run_ahead else None

    @property
    def memory(self):
        """Arrays of the memory between calls: substeps of error control, relative coordinates."""
        control, work = (), self._work
        if self.controlled:
            part_of = self._control.part_of
            control = part_of("size", "kept_size"), part_of("growth", "due"), self._chosen
        # The derivatives of further stages, and of an end that is projected, are computed again.
        blocks = self._blocks - FURTHER - self._model.projects
        known = work.kept_slopes[: blocks * 2 * self.freedoms // work.kept_slopes.shape[1]]
        lead = (
            (work.pose, work.twist, work.lead_angle, work.kept_pose, work.kept_twist, known)
            + (work.kept_angle, work.lead_external, work.lead_targets, work.lead_motions)
            + (work.lead_coordinates, work.kept_coordinates, work.watch[SPAN:], work.crossed, self._control.begins)
            + tuple(array for scheme, *_ in self._methods for array in scheme.newton.jacobian)
            if self._may_run_ahead
            else ()
        )
        branches = (work.branches,) if len(work.branches) else ()
        if branches:  # each evaluation finds the shares of a sliding motion anew
            surfaces = self._model.space.forces.laws.surfaces
            work.branches[surfaces] = np.minimum(work.branches[surfaces], SHARED)
        return (*control, *links_of(work), *lead, *branches)

    @property
    def substeps(self):
        """Numbers of accepted and attempted substeps since the restart; 0 without error control."""
        return int(self._control.accepted[0]), int(self._control.attempted[0])

    def stop_at(self, grid, start, known):
        """Let a substep of a call from an Instant end at another one, where inputs will change; AFTER: at no time."""
        self._lead.grid, self._lead.limit = grid, known
        self._control.part_of("next_base", "next_after")[:] = *grid.parts(known), grid.between(start, known)

    def advance(self, h, steps, pose, twist, external):
        """Take steps of size h in place; returns (steps done, status)."""
        advance = self._pass if self.switching is None else self.switching.advance
        return advance(h, steps, pose, twist, external)

    def look_ahead(self, h, pose, twist, external):
        """As `advance` of one step, for reading; not OK, and nothing done, if an event or a tolerance is in the way."""
        if self.switching is None:
            return self._take(h, 1, pose, twist, external)
        if not self.switching.is_settled(external):
            return 0, EVENT
        end = self._work.clock.part_of("to_step", "until").copy()
        done, status = self._take(h, 1, pose, twist, external)
        is_before = (self._work.clock.part_of("to_step", "until") != end).any()
        return done, EVENT if status == OK and is_before else status

    def passage(self, *given):
        """Go through parts of time, see passage.py; returns (parts done, status). Only without error control."""
        return self._passage(self._model, self._work, self._methods[0][0], *given)

    def _pass(self, h, steps, pose, twist, external):
        """Take steps, with larger tolerances where that is allowed and needed."""
        clock = self._work.clock
        end = clock.to_step.item(), clock.until.item()
        done, status = self._take(h, steps, pose, twist, external)
        if not (self.passes and status & 0xFF in TOO_TIGHT):
            return done, status
        first, times = clock.count[0], clock.part_of("from_step", "until")
        begin = times[:2].copy()

        def go_on(count):
            clock.count[0] = first + done
            times[:2] = (begin[0] + done, 0.0) if done else begin
            times[2:] = (begin[0] + done + count, 0.0) if done + count < steps else end
            return self._take(h, count, pose, twist, external)

        # A halt, which sets MOST to 0 from another thread, is no reason for a larger tolerance.
        while self.passes and status & 0xFF in TOO_TIGHT and self._control.most[0] > 0.0:
            bounds = self._control.part_of("rtol", "atol")
            tolerances, longest = bounds.copy(), self._control.longest[0]
            self._control.longest[0] = self._longest  # no errors of that size further ahead
            one = 0
            for factor in LOOSER:
                if self._control.most[0] == 0.0:
                    break
                bounds[:] = factor * tolerances
                self._control.size[0] = min(self._control.size[0], self._longest)
                one, status = go_on(1)
                if one or status & 0xFF not in TOO_TIGHT:
                    break
            bounds[:], self._control.longest[0] = tolerances, longest
            if not one:
                break
            done += 1
            if done < steps:
                more, status = go_on(steps - done)
                done += more
        clock.count[0], times[:2], times[2:] = first, begin, end
        return done, status

    def _step(self, h, steps, pose, twist, external):
        return self._take(h, steps, pose, twist, external, False)

    def _take(self, h, steps, pose, twist, external, controlled=True):
        """Take steps, ahead if it runs so; controlled : False: without error control."""
        scheme, (plain, within, ahead, _), _ = self._methods[self.chosen]
        parts, state = (self._model, self._work, scheme), (pose, twist, external)
        if not (self.controlled and controlled):
            return plain(*parts, h, steps, *state)
        if self._lead.runs:
            return ahead(*parts, steps, *state, self._control)
        return within(*parts, h, steps, *state, self._control)
