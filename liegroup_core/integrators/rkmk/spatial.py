# SPDX-License-Identifier: Apache-2.0
"""Operations of a Munthe-Kaas step for bodies in space: states on SE(3)^n or (SO(3) x R^3)^n.

spaces.py lists these functions; relative.py has those in relative coordinates. Here `model` is a
Model and `work` a Work.
"""

import math

from liegroup_core.compiling import kernel
from liegroup_core.forces import kinds
from liegroup_core.formulations.absolute.constraints import clear_ground_slip
from liegroup_core.formulations.absolute.newton_euler import accelerations
from liegroup_core.formulations.absolute.projection import close_joints
from liegroup_core.integrators.body_state import enter as enter
from liegroup_core.integrators.body_state import leave as leave
from liegroup_core.integrators.methods import EXACT, SE3
from liegroup_core.integrators.motion import displace, end_status, error_norm_square, group_velocity
from liegroup_core.lie.coefficients import dexpinv_coefficients, truncated_dexpinv_coefficients
from liegroup_core.lie.se3 import se3_dexpinv_of
from liegroup_core.lie.so3 import so3_dexpinv_of, so3_nearest
from liegroup_core.lie.vec3 import (
    ZERO3,
    add3,
    axpy3,
    cross3,
    dot3,
    load3,
    load9,
    matvec3,
    scale3,
    store3,
    store9,
    tmatvec3,
)
from liegroup_core.model.arrays import copy_state
from liegroup_core.status import LARGEST_ROTATION, NOT_FINITE, OK, ROTATION_TOO_LARGE


@kernel
def begin(model, work, group, pose, twist):
    """Set stage 0 to the state."""
    for i in range(len(model.bodies)):
        group_velocity(group, pose, twist, i, work.velocity)
    copy_state(pose, twist, work.stage_pose, work.stage_twist)


@kernel
def _increment(h, weights, row, stages, slopes, n, i):
    """Sum h weights[row, l] k_l of body i over the first stages l: four vectors.

    returns rotation, translation, and the changes of omega and v
    """
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
def move(model, work, scheme, group, h, stage, end, pose):
    """Set all bodies to X_0 exp Psi of a stage: work.stage_pose and work.stage_twist.

    stage : number of the stage; its Psi is written to work.slopes for `store_slopes`
    end   : True at the end of a step: R is also projected to SO(3), and the round-off of velocities
            at joints to ground is removed
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
            rot = so3_nearest(rot)
        store3(xi, work.slopes, stage * n + i, 0)
        store3(eta, work.slopes, stage * n + i, 3)
        v = add3(load3(work.velocity, i, 3), dv)
        if group != SE3:
            v = tmatvec3(rot, v)
        store9(rot, work.stage_pose, i, 0)
        store3(r, work.stage_pose, i, 9)
        store3(add3(load3(work.velocity, i, 0), dw), work.stage_twist, i, 0)
        store3(v, work.stage_twist, i, 3)
    if end and group == SE3 and model.baumgarte_rate == 0.0:
        clear_ground_slip(model, work.stage_twist)
    return OK


@kernel
def _store_slope(work, scheme, group, n, i, stage):
    """Compute k of body i from stage_pose, stage_twist and acceleration of `work`.

    k replaces Psi in work.slopes. In stage 0 Psi = 0, so that dexp^-1 is the identity.
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
def accelerate(model, work, external):
    """Compute the accelerations of a stage. Returns -1, or the element with dependent rows."""
    joint = accelerations(model, work, work.stage_pose, work.stage_twist, external)
    return joint if joint < 0 else model.joints[joint]["element"]


@kernel
def store_slopes(model, work, scheme, group, stage):
    """Compute k of all bodies from the accelerations of a stage."""
    n = len(model.bodies)
    for i in range(n):
        _store_slope(work, scheme, group, n, i, stage)


@kernel
def check_end(model, work, h):
    """Check the end of a step of size h; see spaces.py."""
    return end_status(model.forces, h, work.stage_pose, work.stage_twist)


@kernel
def error_square(model, work, scheme, row, h, twist, i, rtol, atol, length):
    """Square of an error estimate of body i for a step from `twist`; see error_control.py."""
    n = len(twist)
    xi, eta, dw, dv = _increment(h, scheme.error, row, scheme.error.shape[1], work.slopes, n, i)
    return error_norm_square(xi, eta, dw, dv, twist, work.stage_twist, i, rtol, atol, length)


@kernel
def close(model, work, controlled):
    """Project the end of a step onto the constraints. Returns a status."""
    return close_joints(model, work)


@kernel
def watches(model, work):
    """No joint has stops or dry friction on these groups."""
    return False


@kernel
def note_stage(model, work, scheme, stage):
    """Nothing: see `watches`."""


@kernel
def has_event(model, work, scheme, start, h):
    """Whether stops or friction change in a substep; see `watches`."""
    return False


@kernel
def count_turns(model, work):
    """Unwrap the angles of the torsional springs at the end of a step."""
    kinds.count_turns(model.forces, work.stage_pose, work.angle)
