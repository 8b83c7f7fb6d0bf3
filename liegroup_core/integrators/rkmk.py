# SPDX-License-Identifier: Apache-2.0
"""Munthe-Kaas methods of any explicit tableau on the state space of a constrained mechanism.

One step of (6.25), stages j = 1..s, on G x R^6n with G = SE(3)^n or (SO(3) x R^3)^n:
    Psi_j = h sum_l a_jl k_l ,   X_j = X_0 exp Psi_j ,   k_j = dexp^-1_{-Psi_j} F(X_j)
    X_1   = X_0 exp(h sum_j b_j k_j)
On the vector part (velocities) exp and dexp are the identity. On SO(3) x R^3 the velocity of the
group is (omega in body axes, rdot in WORLD axes): (6.26) and the note to it.

The number of stages is data: all tableaux share one compiled `advance`. A tableau with an error
estimate divides each step into substeps:
    delta = h sum_j e_j k_j ,   k_s+1 = dexp^-1_{-Psi} F(X_1) ,   Psi = h sum_j b_j k_j
is the difference of two such methods in the algebra, one screw (dxi, deta) and one twist
difference (dw, dv) for every body. A substep is good when for every body
    |dxi|^2/atol^2 + |deta|^2/atol^2 + |dw|^2/tol_w^2 + |dv|^2/tol_v^2 <= 1
    tol_w = atol + rtol max(|w_0|, |w_1|),   tol_v = atol + rtol max(|v_0|, |v_1|)
in rad, m, rad/s and m/s. A pose has no natural size (where the world's origin is must not matter),
so its error is held absolutely. The largest body counts and not a mean, which would let a single
fast body hide among many slow ones.
"""
import math
from typing import NamedTuple

import numpy as np

from .._compile import borrowed, kernel
from ..dynamics.constraints import clear_ground_slip
from ..dynamics.newton_euler import accelerations
from ..dynamics.projection import project
from ..forces.kinds import count_turns, too_fast
from ..lie.coefficients import dexpinv_coefficients, truncated_dexpinv_coefficients
from ..lie.se3 import se3_dexpinv_of
from ..lie.so3 import so3_dexpinv_of
from ..lie.vec3 import (ZERO3, add3, axpy3, cross3, dot3, load3, load9, matvec3, scale3, store3,
                        store9, tmatvec3)
from ..model.arrays import make_work
from .methods import GROUPS, SE3, is_positive
from .motion import copy_state, displace, group_velocity, is_finite, orthonormal
from .status import (DEPENDENT_ROWS, LARGEST_ROTATION, NOT_FINITE, OK, ROTATION_TOO_LARGE,
                     SUBSTEP_TOO_SMALL, TOO_MANY_SUBSTEPS, TURNS_NOT_COUNTED)

EXACT = -1                  # Scheme.highest: dexpinv in closed form

# Bounds of one change of the substep, and how far below the tolerance the next error is aimed.
LARGEST_GROWTH, LARGEST_CUT, SAFETY = 5.0, 0.2, 0.9
# A substep is never smaller than this part of a step, and a step has no more of them.
SMALLEST_SUBSTEP = 1e-9
MOST_SUBSTEPS = 100_000


class Scheme(NamedTuple):
    """A tableau of s stages and what else tells one Munthe-Kaas method from another."""

    a: np.ndarray           # (s + 1, s) the tableau's a, below it its b
    error: np.ndarray       # (1, s + 1) weights of the error estimate, or (0, s + 1): none
    highest: int            # last power of ad in dexpinv, or EXACT
    rtol: float             # of velocities
    atol: float             # rad, m, rad/s, m/s


@kernel
def _increment(h, weights, row, stages, slopes, n, i):
    """h sum_l weights[row, l] k_l of body i over so many stages: four vectors."""
    xi, eta, dw, dv = ZERO3, ZERO3, ZERO3, ZERO3
    for stage in range(stages):
        weight = weights[row, stage]
        if weight != 0.0:
            k = stage * n + i
            xi = axpy3(weight, load3(slopes, k, 0), xi)
            eta = axpy3(weight, load3(slopes, k, 3), eta)
            dw = axpy3(weight, load3(slopes, k, 6), dw)
            dv = axpy3(weight, load3(slopes, k, 9), dv)
    return scale3(h, xi), scale3(h, eta), scale3(h, dw), scale3(h, dv)


@kernel
def _move(model, work, scheme, group, h, stage, end, pose):
    """Place all bodies at X_0 exp Psi of a stage: work.stage_pose and stage_twist.

    stage : its Psi is left in work.slopes for `_evaluate`
    end   : True for the end of a step, where R is also brought back to SO(3)
    returns OK, ROTATION_TOO_LARGE or NOT_FINITE
    """
    n = len(model.bodies)
    for i in range(n):
        xi, eta, dw, dv = _increment(h, scheme.a, stage, stage, work.slopes, n, i)
        rotation = dot3(xi, xi)
        if not rotation < LARGEST_ROTATION * LARGEST_ROTATION:
            if rotation < math.inf:
                return ROTATION_TOO_LARGE
            return NOT_FINITE
        work.report[1] = max(work.report[1], rotation)
        rot, r = displace(group, pose, i, xi, eta)
        if end:
            rot = orthonormal(rot)
        store3(xi, work.slopes, stage * n + i, 0)
        store3(eta, work.slopes, stage * n + i, 3)
        v = add3(load3(work.velocity, i, 3), dv)
        if group != SE3:
            v = tmatvec3(rot, v)
        store9(rot, work.stage_pose, i, 0)
        store3(r, work.stage_pose, i, 9)
        store3(add3(load3(work.velocity, i, 0), dw), work.stage_twist, i, 0)
        store3(v, work.stage_twist, i, 3)
    return OK


@kernel
def _store_slope(work, scheme, group, n, i, stage):
    """k of body i and a stage from work.stage_pose, stage_twist and acceleration.

    Psi stands where k will. In the first stage Psi = 0, and dexp^-1 is the identity.
    """
    row = stage * n + i
    w = load3(work.stage_twist, i, 0)
    v = load3(work.stage_twist, i, 3)
    linear = load3(work.acceleration, i, 3)
    if group != SE3:
        rot = load9(work.stage_pose, i, 0)
        linear = matvec3(rot, add3(linear, cross3(w, v)))
        v = matvec3(rot, v)
    if stage > 0:
        xi = scale3(-1.0, load3(work.slopes, row, 0))
        if scheme.highest == EXACT:
            first = 0.5
            b, u = dexpinv_coefficients(dot3(xi, xi))
        else:
            first, b, u = truncated_dexpinv_coefficients(scheme.highest, dot3(xi, xi))
        if group == SE3:
            eta = scale3(-1.0, load3(work.slopes, row, 3))
            w, v = se3_dexpinv_of(first, b, u, xi, eta, w, v)
        else:
            w = so3_dexpinv_of(first, b, xi, w)
    store3(w, work.slopes, row, 0)
    store3(v, work.slopes, row, 3)
    store3(load3(work.acceleration, i, 0), work.slopes, row, 6)
    store3(linear, work.slopes, row, 9)


@kernel
def _begin(model, work, group, pose, twist):
    """Stage 0: the state itself."""
    work.report[1] = 0.0
    for i in range(len(model.bodies)):
        group_velocity(group, pose, twist, i, work.velocity)
    copy_state(pose, twist, work.stage_pose, work.stage_twist)


@kernel
def _check_end(model, work, h):
    """OK, NOT_FINITE or TURNS_NOT_COUNTED + (spring << 8) for the end of a step of size h."""
    if not is_finite(work.stage_pose, work.stage_twist):
        return NOT_FINITE
    fast = too_fast(model.forces, h, work.stage_pose, work.stage_twist)
    if fast >= 0:
        return TURNS_NOT_COUNTED + (fast << 8)
    return OK


@kernel
def _error(model, work, scheme, h, twist):
    """Norm of the error estimate of a step that began with `twist`: good up to 1; see above."""
    n = len(model.bodies)
    largest = 0.0
    for i in range(n):
        xi, eta, dw, dv = _increment(h, scheme.error, 0, scheme.error.shape[1], work.slopes, n, i)
        w0, w1 = load3(twist, i, 0), load3(work.stage_twist, i, 0)
        v0, v1 = load3(twist, i, 3), load3(work.stage_twist, i, 3)
        tol_w = scheme.atol + scheme.rtol * math.sqrt(max(dot3(w0, w0), dot3(w1, w1)))
        tol_v = scheme.atol + scheme.rtol * math.sqrt(max(dot3(v0, v0), dot3(v1, v1)))
        error = ((dot3(xi, xi) + dot3(eta, eta)) / (scheme.atol * scheme.atol)
                 + dot3(dw, dw) / (tol_w * tol_w) + dot3(dv, dv) / (tol_v * tol_v))
        if not error < math.inf:
            return math.inf
        largest = max(largest, error)
    return math.sqrt(largest)


@kernel
def _change(error):
    """Factor of the substep that brings its error next to 1: 0.9 error^(-3/16), within bounds.

    The estimate is of fourth order: error ~ h^5. In place of 1/5 stands 3/16, made of square
    roots: they round alike on every machine, so that a run repeats bit for bit there too.
    """
    if not error < 1e4:
        return LARGEST_CUT
    root = math.sqrt(math.sqrt(math.sqrt(max(error, 1e-4))))
    return min(LARGEST_GROWTH, max(LARGEST_CUT, SAFETY / (root * math.sqrt(root))))


@kernel
def _judge(model, work, scheme, h, size, status, twist, control):
    """Whether a substep of so much of a step h was good, and the size of the next.

    returns (status, True when it was good): not OK where no smaller substep will be tried
    """
    error = math.inf
    if status == OK:
        error = _error(model, work, scheme, size, twist)
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
    """Remember the state at the start of a step that is taken in substeps."""
    copy_state(pose, twist, work.start_pose, work.start_twist)
    for i in range(len(work.angle)):
        work.start_angle[i] = work.angle[i]
    control[3] = control[0]


@kernel
def _restore(work, pose, twist, control):
    """Back to the state that `_keep` has kept."""
    copy_state(work.start_pose, work.start_twist, pose, twist)
    for i in range(len(work.angle)):
        work.angle[i] = work.start_angle[i]
    control[0] = control[3]


@kernel
def advance(model, work, scheme, group, h, steps, pose, twist, external, control):
    """Take `steps` steps of size h in place of pose (n, 12) and twist (n, 6).

    external (n, 6) : applied wrenches in body axes, constant over these steps
    control (4,)    : next substep in s, numbers of good substeps and of all attempts so far, next
                      substep at the start of the step; only for schemes with error control
    returns (steps done, status): fewer than asked when status is not OK (low byte; the rest names
    the joint of DEPENDENT_ROWS or the torsional spring of TURNS_NOT_COUNTED). Pose, twist and
    work.angle are then those of the last good step.

    Steps, substeps and stages are loops of one function: a kernel that contains the mechanics is
    compiled once more for every function it is inlined into, for many seconds.
    """
    model, work, scheme = borrowed(model), borrowed(work), borrowed(scheme)
    pose, twist = borrowed(pose), borrowed(twist)
    external, control = borrowed(external), borrowed(control)
    n = len(model.bodies)
    stages = scheme.a.shape[1]
    controlled = len(scheme.error) > 0
    first = 0       # 1: slopes of the first stage are there, the last ones of the substep before
    for done in range(steps):
        if controlled:
            _keep(work, pose, twist, control)
        left = h
        attempts = 0
        while left > 0.0:
            count = 1
            if controlled:
                # Equal substeps up to the end of the step: no tiny one is left over.
                count = max(1, math.ceil(left / control[0] - 1e-6))
            size = left / count
            attempts += 1
            _begin(model, work, group, pose, twist)
            status = OK
            # The end is one more stage: nothing to evaluate there but for an error estimate.
            for stage in range(first, stages + 1):
                if stage > 0:
                    status = _move(model, work, scheme, group, size, stage, stage == stages, pose)
                    if status != OK:
                        break
                    if stage == stages and group == SE3 and model.baumgarte_rate == 0.0:
                        clear_ground_slip(model, work.stage_twist)
                if stage < stages or controlled:
                    dependent = accelerations(model, work, work.stage_pose, work.stage_twist,
                                              external)
                    if dependent >= 0:
                        status = DEPENDENT_ROWS + (dependent << 8)
                        break
                    for i in range(n):
                        _store_slope(work, scheme, group, n, i, stage)
            if status == OK:
                status = _check_end(model, work, size)
            if controlled:
                if status == OK:
                    first = 1
                status, good = _judge(model, work, scheme, h, size, status, twist, control)
                if status == OK and attempts >= MOST_SUBSTEPS and not (good and count == 1):
                    status = TOO_MANY_SUBSTEPS
                if status == OK and not good:
                    continue
            if status == OK and model.projects:
                _, status = project(model, work, work.stage_pose, work.stage_twist)
            if status != OK:
                if controlled:
                    _restore(work, pose, twist, control)
                return done, status
            if controlled:
                # The slope at the end is the first of the next substep, taken there as it is;
                # a projected end has another.
                for i in range(n):
                    _store_slope(work, scheme, group, n, i, 0)
                first = 0 if model.projects else 1
            count_turns(model.forces, work.stage_pose, work.angle)
            copy_state(work.stage_pose, work.stage_twist, pose, twist)
            work.report[0] = max(work.report[0], work.report[1])
            left = left - size if count > 1 else 0.0
    return steps, OK


class MuntheKaas:
    """Any tableau of METHODS on a model: its memory, its options and what lasts between calls.

    dexpinv    : "exact", or "truncated" to the powers of ad that the method's order needs
    rtol, atol : tolerance of error control, only for a tableau that has one; see above
    """

    def __init__(self, method, layout, group, step, options):
        tableau = method.tableau
        stages = len(tableau.b)
        error = np.zeros((0, stages + 1)) if tableau.e is None else tableau.e.reshape(1, -1)
        self._scheme = Scheme(
            np.vstack([tableau.a, tableau.b]), error,
            EXACT if options["dexpinv"] == "exact" else max(method.order - 2, 0),
            float(options.get("rtol", 0.0)), float(options.get("atol", 1.0)))
        self._model, self._group, self._longest = layout.model, GROUPS[group], step
        self.work = make_work(layout.model, stages)
        self._control = np.zeros(4)
        self.restart()

    @staticmethod
    def options(method):
        """{name: (default, what it may be, check)} of the options this method takes."""
        kinds = ("exact", "truncated")
        found = {"dexpinv": (kinds[0], " or ".join(map(repr, kinds)), kinds.__contains__)}
        if method.tableau.e is not None:
            found["rtol"] = found["atol"] = (1e-6, "a positive number", is_positive)
        return found

    def restart(self):
        """Forget what lasts between calls: the state is a new one."""
        self._control[:] = self._longest, 0.0, 0.0, self._longest

    @property
    def substeps(self):
        """Numbers of good substeps and of attempts since the restart; 0 without error control."""
        return int(self._control[1]), int(self._control[2])

    def advance(self, h, steps, pose, twist, external):
        """Take steps of size h in place; returns (steps done, status)."""
        return advance(self._model, self.work, self._scheme, self._group, h, steps, pose, twist,
                       external, self._control)
