# SPDX-License-Identifier: Apache-2.0
"""Munthe-Kaas methods of any explicit tableau on the state space of a constrained mechanism.

One step of (6.25), stages j = 1..s, on G x R^6n with G = SE(3)^n or (SO(3) x R^3)^n:
    Psi_j = h sum_l a_jl k_l ,   X_j = X_0 exp Psi_j ,   k_j = dexp^-1_{-Psi_j} F(X_j)
    X_1   = X_0 exp(h sum_j b_j k_j)
On the vector part (velocities) exp and dexp are the identity. On SO(3) x R^3 the velocity of the
group is (omega in body axes, rdot in WORLD axes): (6.26) and the note to it.

The number of stages is data, so that all tableaux share one compiled `advance`. A tableau with an
error estimate divides each step into substeps:
    delta = h sum_j e_j k_j ,   k_s+1 = dexp^-1_{-Psi} F(X_1) ,   Psi = h sum_j b_j k_j
is the difference of two such methods in the algebra, one screw (dxi, deta) and one twist
difference (dw, dv) for every body. A substep is accepted if for every body
    |dxi|^2/atol^2 + |deta|^2/atol^2 + |dw|^2/tol_w^2 + |dv|^2/tol_v^2 <= 1
    tol_w = atol + rtol max(|w_0|, |w_1|),   tol_v = atol + rtol max(|v_0|, |v_1|)
in rad, m, rad/s and m/s. Errors of poses have an absolute tolerance: they must not depend on the
world's origin. The body with the largest error decides, not a mean, which would hide one fast body
among many slow ones.
"""

import math

import numpy as np

from liegroup_core.compiling import SameTypes, Struct, borrowed, kernel, stepper, warm_up
from liegroup_core.formulations.planar.arrays import make_planar_work
from liegroup_core.integrators.methods import EXACT, GROUPS, is_positive
from liegroup_core.integrators.motion import copy_state
from liegroup_core.model.arrays import MET, WAIT, make_work
from liegroup_core.status import DEPENDENT_ROWS, OFF_PLANE, OK, SUBSTEP_TOO_SMALL, TOO_MANY_SUBSTEPS

from . import spaces

# Bounds of one change of the substep, and safety factor of the next error.
LARGEST_GROWTH, LARGEST_CUT, SAFETY = 5.0, 0.2, 0.9
# Smallest substep as a fraction of a step; its inverse is the largest number of substeps.
SMALLEST_SUBSTEP = 1e-9
MOST_SUBSTEPS = 100_000


class Scheme(Struct):
    """Data of a Munthe-Kaas method: tableau of s stages, series of dexpinv, tolerances."""

    a: np.ndarray  # (s + 1, s) the tableau's a, below it its b
    error: np.ndarray  # (1, s + 1) weights of the error estimate, or (0, s + 1): none
    highest: int  # last power of ad in dexpinv, or EXACT
    rtol: float  # of velocities
    atol: float  # rad, m, rad/s, m/s


@kernel
def _change(error):
    """Factor of the next substep for an error near 1: 0.9 error^(-3/16), within bounds.

    The estimate is of fourth order: error ~ h^5. The exponent 3/16 instead of 1/5 needs only square
    roots, which are bit-identical on every machine; so is then the run.
    """
    if not error < 1e4:
        return LARGEST_CUT
    root = math.sqrt(math.sqrt(math.sqrt(max(error, 1e-4))))
    return min(LARGEST_GROWTH, max(LARGEST_CUT, SAFETY / (root * math.sqrt(root))))


@kernel
def _judge(model, work, scheme, h, size, status, twist, control):
    """Accept or reject a substep, a given part of a step h, and set the size of the next one.

    returns (status, accepted): status is not OK if no smaller substep is allowed
    """
    error = math.inf
    if status == OK:
        error = spaces.error_norm(model, work, scheme, size, twist)
    control[0] = min(h, size * _change(error))
    control[2] += 1.0
    if error <= 1.0:
        control[1] += 1.0
        return OK, True
    if control[0] < SMALLEST_SUBSTEP * h:
        return (status if status != OK else SUBSTEP_TOO_SMALL), False
    return OK, False


@kernel
def _keep(work, pose, twist, control):
    """Save the state at the start of a step that is taken in substeps."""
    copy_state(pose, twist, work.start_pose, work.start_twist)
    for i in range(len(work.angle)):
        work.start_angle[i] = work.angle[i]
    control[3] = control[0]


@kernel
def _restore(work, pose, twist, control):
    """Restore the state saved by `_keep`."""
    copy_state(work.start_pose, work.start_twist, pose, twist)
    for i in range(len(work.angle)):
        work.angle[i] = work.start_angle[i]
    control[0] = control[3]


@stepper
def advance(model, work, scheme, group, h, steps, pose_in, twist_in, external_in, control):
    """Take `steps` steps of size h in place of pose (n, 12) and twist (n, 6).

    model, work     : Model and Work, or PlanarModel and PlanarWork
    external (n, 6) : applied wrenches in body axes, constant over these steps
    control (4,)    : next substep in s, numbers of accepted and of attempted substeps so far, next
                      substep at the start of the step; only for schemes with error control
    returns (steps done, status): fewer steps if status is not OK, or if work.report[3] becomes MET
    (model.arrays). The low byte of status is the code; the rest is the element of DEPENDENT_ROWS or
    the torsional spring of TURNS_NOT_COUNTED. Pose, twist and work.angle are then those of the last
    valid step. OFF_PLANE: the state is not in the plane of a PlanarModel; it is unchanged.

    Steps, substeps and stages are loops of one function, because the mechanics are inlined, and so
    compiled, at every call.
    """
    pose_in, twist_in = borrowed(pose_in), borrowed(twist_in)
    external_in, control = borrowed(external_in), borrowed(control)
    pose, twist, external, status = spaces.enter(model, work, pose_in, twist_in, external_in)
    if status != OK:
        return 0, status
    stages = scheme.a.shape[1]
    controlled = len(scheme.error) > 0
    first = 0  # 1: slopes of the first stage are there, the last ones of the substep before
    done = 0
    while done < steps and status == OK:
        if controlled:
            _keep(work, pose, twist, control)
        left = h
        attempts = 0
        while left > 0.0 and status == OK:
            count = 1
            if controlled:
                # Equal substeps up to the end of the step: no tiny one is left over.
                count = max(1, math.ceil(left / control[0] - 1e-6))
            size = left / count
            attempts += 1
            work.report[1] = 0.0
            spaces.begin(model, work, group, pose, twist)
            # The end is one more stage: nothing to evaluate there but for an error estimate.
            for stage in range(first, stages + 1):
                if stage > 0:
                    status = spaces.move(
                        model, work, scheme, group, size, stage, stage == stages, pose
                    )
                    if status != OK:
                        break
                if stage < stages or controlled:
                    dependent = spaces.accelerate(model, work, external)
                    if dependent >= 0:
                        status = DEPENDENT_ROWS + (model.joints[dependent]["element"] << 8)
                        break
                    spaces.store_slopes(model, work, scheme, group, stage)
            if status == OK:
                status = spaces.check_end(model, work, size)
            if controlled:
                if status == OK:
                    first = 1
                status, good = _judge(model, work, scheme, h, size, status, twist, control)
                if status == OK and attempts >= MOST_SUBSTEPS and not (good and count == 1):
                    status = TOO_MANY_SUBSTEPS
                if status == OK and not good:
                    continue
            if status == OK and model.projects:
                status = spaces.close(model, work)
            if status != OK:
                break
            if controlled:
                # The slope at the end is the first of the next substep, taken there as it is;
                # a projected end has another.
                spaces.store_slopes(model, work, scheme, group, 0)
                first = 0 if model.projects else 1
            spaces.count_turns(model, work)
            copy_state(work.stage_pose, work.stage_twist, pose, twist)
            work.report[0] = max(work.report[0], work.report[1])
            left = left - size if count > 1 else 0.0
        if status == OK:
            done += 1
            if work.report[3] == WAIT and spaces.turns_over(model, work, h):
                work.report[3] = MET
                break
        elif controlled:
            _restore(work, pose, twist, control)
    spaces.leave(model, work, pose, twist, pose_in, twist_in)
    return done, status


class MuntheKaas:
    """Munthe-Kaas method of a tableau of METHODS for a model, with its memory between calls.

    dexpinv    : "exact", or "truncated" to the powers of ad that the method's order needs
    space      : "auto": a planar mechanism is integrated in its plane, see planar.build; "space":
                 always in space
    rtol, atol : tolerances of error control, only for a tableau with an estimate; see above
    """

    def __init__(self, method, layout, group, step, options):
        tableau = method.tableau
        stages = len(tableau.b)
        error = np.zeros((0, stages + 1)) if tableau.e is None else tableau.e.reshape(1, -1)
        self.controlled = tableau.e is not None
        self._schemes = {
            1.0: Scheme(
                np.vstack([tableau.a, tableau.b]),
                error,
                EXACT if options["dexpinv"] == "exact" else max(method.order - 2, 0),
                float(options.get("rtol", 0.0)),
                float(options.get("atol", 1.0)),
            )
        }
        self.tighten(1.0)
        self._model, self._group, self._longest = layout.model, GROUPS[group], step
        self.work = make_work(layout.model, stages)
        self._plane = layout.plane if options["space"] == "auto" else None
        self.kernels = "rkmk" if self._plane is None else "rkmk-planar"
        if self._plane is not None:
            self._planar_work = make_planar_work(self._plane, self.work, stages)
        self._control = np.zeros(4)
        self._advance, self._advance_planar = SameTypes(advance), SameTypes(advance)
        self._left_plane = False
        self.restart()

    @staticmethod
    def options(method):
        """{name: (default, description of valid values, check)} of the method's options."""
        kinds = ("exact", "truncated")
        spaces = ("auto", "space")
        found = {
            "dexpinv": (kinds[0], " or ".join(map(repr, kinds)), kinds.__contains__),
            "space": (spaces[0], " or ".join(map(repr, spaces)), spaces.__contains__),
        }
        if method.tableau.e is not None:
            found["rtol"] = found["atol"] = (1e-6, "a positive number", is_positive)
        return found

    def restart(self):
        """Clear the memory between calls: the state was set."""
        self._control[:] = self._longest, 0.0, 0.0, self._longest

    def tighten(self, part):
        """Set the tolerances to this fraction of those of the options."""
        if part not in self._schemes:
            given = self._schemes[1.0]
            self._schemes[part] = given.replace(rtol=part * given.rtol, atol=part * given.atol)
        self._scheme = self._schemes[part]

    @property
    def memory(self):
        """Arrays of the memory between calls; none without error control."""
        return (self._control,) if self.controlled else ()

    @property
    def substeps(self):
        """Numbers of accepted and attempted substeps since the restart; 0 without error control."""
        return int(self._control[1]), int(self._control[2])

    def advance(self, h, steps, pose, twist, external):
        """Take steps of size h in place; returns (steps done, status)."""
        if self._plane is not None:
            done, status = self._advance_planar(
                self._plane,
                self._planar_work,
                self._scheme,
                self._group,
                h,
                steps,
                pose,
                twist,
                external,
                self._control,
            )
            if status != OFF_PLANE:
                return done, status
            if not self._left_plane:
                self._left_plane = True
                warm_up(lambda: self._in_space(h, 0, pose, twist, external), "rkmk")
        return self._in_space(h, steps, pose, twist, external)

    def _in_space(self, h, steps, pose, twist, external):
        return self._advance(
            self._model,
            self.work,
            self._scheme,
            self._group,
            h,
            steps,
            pose,
            twist,
            external,
            self._control,
        )
