# SPDX-License-Identifier: Apache-2.0
"""Munthe-Kaas methods of any explicit tableau on the state space of a constrained mechanism.

One step of (6.25), stages j = 1..s, on G x R^6n with G = SE(3)^n or (SO(3) x R^3)^n:
    Psi_j = h sum_l a_jl k_l ,   X_j = X_0 exp Psi_j ,   k_j = dexp^-1_{-Psi_j} F(X_j)
    X_1   = X_0 exp(h sum_j b_j k_j)
On the vector part (velocities) exp and dexp are the identity. On SO(3) x R^3 the velocity of the
group is (omega in body axes, rdot in WORLD axes): (6.26) and the note to it.
"""
import math

from .._compile import borrowed, kernel
from ..dynamics.newton_euler import accelerations
from ..dynamics.projection import project
from ..lie.se3 import se3_compose, se3_dexpinv, se3_exp
from ..lie.so3 import so3_dexpinv, so3_exp
from ..lie.vec3 import (add3, axpy3, cross3, dot3, load3, load9, matmul3, matvec3, scale3, store3,
                        store9, tmatvec3)
from .methods import SE3
from .status import DEPENDENT_ROWS, LARGEST_ROTATION, NOT_FINITE, OK, ROTATION_TOO_LARGE


@kernel
def _group_velocity(group, pose, twist, i, out):
    """Velocity on the group of body i from its body twist."""
    v = load3(twist, i, 3)
    if group != SE3:
        v = matvec3(load9(pose, i, 0), v)
    store3(load3(twist, i, 0), out, i, 0)
    store3(v, out, i, 3)


@kernel
def _displace(group, pose, i, xi, eta):
    """pose exp(xi, eta) of body i: rotation and position."""
    rot = load9(pose, i, 0)
    r = load3(pose, i, 9)
    if group == SE3:
        turn, shift = se3_exp(xi, eta)
        return se3_compose(rot, r, turn, shift)
    return matmul3(rot, so3_exp(xi)), add3(r, eta)


@kernel
def _increment(h, weights, row, stages, slopes, n, i, part):
    """h sum_l weights[row, l] k_l of body i: two vectors from entry `part` of the slopes on."""
    first = (0.0, 0.0, 0.0)
    second = (0.0, 0.0, 0.0)
    for stage in range(stages):
        weight = weights[row, stage]
        if weight != 0.0:
            first = axpy3(weight, load3(slopes, stage * n + i, part), first)
            second = axpy3(weight, load3(slopes, stage * n + i, part + 3), second)
    return scale3(h, first), scale3(h, second)


@kernel
def _orthonormal(rot):
    """One step of Newton's iteration for the nearest rotation, R (3 I - R^T R) / 2.

    Products of rotations drift from SO(3) by rounding; one iteration squares that drift away.
    """
    x, y, z = (rot[0], rot[3], rot[6]), (rot[1], rot[4], rot[7]), (rot[2], rot[5], rot[8])
    xy, xz, yz = -0.5 * dot3(x, y), -0.5 * dot3(x, z), -0.5 * dot3(y, z)
    defect = (1.5 - 0.5 * dot3(x, x), xy, xz,
              xy, 1.5 - 0.5 * dot3(y, y), yz,
              xz, yz, 1.5 - 0.5 * dot3(z, z))
    return matmul3(rot, defect)


@kernel
def _move(model, work, group, h, weights, row, stages, pose, end):
    """Place all bodies at X_0 exp(h sum_l weights[row, l] k_l): work.stage_pose and stage_twist.

    end : False for a stage, whose Psi is left in work.slopes for `_evaluate`; True for the end of
          a step, where R is also brought back to SO(3)
    returns OK, ROTATION_TOO_LARGE or NOT_FINITE
    """
    n = len(model.bodies)
    for i in range(n):
        xi, eta = _increment(h, weights, row, stages, work.slopes, n, i, 0)
        dw, dv = _increment(h, weights, row, stages, work.slopes, n, i, 6)
        rotation = dot3(xi, xi)
        if not rotation < LARGEST_ROTATION * LARGEST_ROTATION:
            if rotation < math.inf:
                return ROTATION_TOO_LARGE
            return NOT_FINITE
        work.report[0] = max(work.report[0], rotation)
        rot, r = _displace(group, pose, i, xi, eta)
        if end:
            rot = _orthonormal(rot)
        else:
            store3(xi, work.slopes, row * n + i, 0)
            store3(eta, work.slopes, row * n + i, 3)
        v = add3(load3(work.velocity, i, 3), dv)
        if group != SE3:
            v = tmatvec3(rot, v)
        store9(rot, work.stage_pose, i, 0)
        store3(r, work.stage_pose, i, 9)
        store3(add3(load3(work.velocity, i, 0), dw), work.stage_twist, i, 0)
        store3(v, work.stage_twist, i, 3)
    return OK


@kernel
def _evaluate(model, work, group, stage, external):
    """k of one stage from work.stage_pose and work.stage_twist; Psi stands where k will.

    returns OK or DEPENDENT_ROWS + (joint << 8)
    """
    dependent = accelerations(model, work, work.stage_pose, work.stage_twist, external,
                              group != SE3)
    if dependent >= 0:
        return DEPENDENT_ROWS + (dependent << 8)
    n = len(model.bodies)
    for i in range(n):
        row = stage * n + i
        w = load3(work.stage_twist, i, 0)
        v = load3(work.stage_twist, i, 3)
        linear = load3(work.acceleration, i, 3)
        if group != SE3:
            rot = load9(work.stage_pose, i, 0)
            linear = matvec3(rot, add3(linear, cross3(w, v)))
            v = matvec3(rot, v)
        # In the first stage Psi = 0, and dexp^-1 is the identity.
        if stage > 0:
            xi = scale3(-1.0, load3(work.slopes, row, 0))
            if group == SE3:
                eta = scale3(-1.0, load3(work.slopes, row, 3))
                w, v = se3_dexpinv(xi, eta, w, v)
            else:
                w = so3_dexpinv(xi, w)
        store3(w, work.slopes, row, 0)
        store3(v, work.slopes, row, 3)
        store3(load3(work.acceleration, i, 0), work.slopes, row, 6)
        store3(linear, work.slopes, row, 9)
    return OK


@kernel
def _copy(source_pose, source_twist, pose_out, twist_out):
    """Copy a state."""
    for i in range(len(source_pose)):
        for c in range(12):
            pose_out[i, c] = source_pose[i, c]
        for c in range(6):
            twist_out[i, c] = source_twist[i, c]


@kernel
def _is_finite(pose, twist):
    """True when no number of a state is NaN or infinite."""
    total = 0.0
    for i in range(len(pose)):
        for c in range(12):
            total += abs(pose[i, c])
        for c in range(6):
            total += abs(twist[i, c])
    return total < math.inf


@kernel
def advance(model, work, a, b, group, h, steps, pose, twist, external):
    """Take `steps` steps of size h in place of pose (n, 12) and twist (n, 6).

    a (s, s), b (1, s) : tableau
    external (n, 6)    : applied wrenches in body axes, constant over these steps
    returns (steps done, status): fewer than asked when status is not OK (low byte; the rest names
    the joint of DEPENDENT_ROWS). Pose and twist are then those of the last good step.
    """
    model, work = borrowed(model), borrowed(work)
    a, b, external = borrowed(a), borrowed(b), borrowed(external)
    pose, twist = borrowed(pose), borrowed(twist)
    stages = b.shape[1]
    for done in range(steps):
        for i in range(len(model.bodies)):
            _group_velocity(group, pose, twist, i, work.velocity)
        _copy(pose, twist, work.stage_pose, work.stage_twist)
        for stage in range(stages):
            if stage > 0:
                status = _move(model, work, group, h, a, stage, stage, pose, False)
                if status != OK:
                    return done, status
            status = _evaluate(model, work, group, stage, external)
            if status != OK:
                return done, status
        # The new state is made beside the old one, which stays if the new one is not good.
        status = _move(model, work, group, h, b, 0, stages, pose, True)
        if status != OK:
            return done, status
        if not _is_finite(work.stage_pose, work.stage_twist):
            return done, NOT_FINITE
        if model.projects:
            _, status = project(model, work, work.stage_pose, work.stage_twist)
            if status != OK:
                return done, status
        _copy(work.stage_pose, work.stage_twist, pose, twist)
    return steps, OK
