# SPDX-License-Identifier: Apache-2.0
"""Operations of a Munthe-Kaas step for planar bodies: states on SE(2)^n or (SO(2) x R^2)^n.

The steps are those of spatial.py, written for a constant axis of rotation: results agree to
machine precision (test/core/test_planar.py). SO(2) x R^2 is commutative: exp is a rotation and a
translation, dexp the identity.
"""

import math

from liegroup_core.compiling import kernel
from liegroup_core.forces import kinds
from liegroup_core.formulations.absolute.projection import close_joints
from liegroup_core.formulations.planar.dynamics import accelerations, clear_ground_slip
from liegroup_core.formulations.planar.state import external_to_plane, to_plane, to_space
from liegroup_core.integrators.methods import EXACT, SE3
from liegroup_core.integrators.motion import copy_state, is_finite
from liegroup_core.lie.coefficients import (
    dexpinv_coefficients,
    exp_coefficients,
    truncated_dexpinv_coefficients,
)
from liegroup_core.status import (
    LARGEST_ROTATION,
    NOT_FINITE,
    OK,
    ROTATION_TOO_LARGE,
    TURNS_NOT_COUNTED,
)


@kernel
def enter(model, work, pose, twist, external):
    """Convert the caller's state to the plane; the status is OFF_PLANE if it is not planar."""
    # Forces and projection need the positions along the normal.
    copy_state(pose, twist, work.space.stage_pose, work.space.stage_twist)
    external_to_plane(model, external, work.external)
    status = to_plane(model, pose, twist, work.pose, work.twist)
    return work.pose, work.twist, work.external, status


@kernel
def leave(model, work, pose, twist, pose_out, twist_out):
    """Write the planar state back to the caller's arrays."""
    # Only projection, in space, changes positions along the normal.
    copy_state(work.space.stage_pose, work.space.stage_twist, pose_out, twist_out)
    to_space(model, pose, twist, pose_out, twist_out)


@kernel
def begin(model, work, group, pose, twist):
    """Set stage 0 to the state."""
    for i in range(len(model.bodies)):
        vx, vy = twist[i, 1], twist[i, 2]
        if group != SE3:
            c, s = pose[i, 0], pose[i, 1]
            vx, vy = c * vx - s * vy, s * vx + c * vy
        work.velocity[i, 0], work.velocity[i, 1], work.velocity[i, 2] = twist[i, 0], vx, vy
    copy_state(pose, twist, work.stage_pose, work.stage_twist)


@kernel
def _increment(h, weights, row, stages, slopes, n, i):
    """Sum h weights[row, l] k_l of body i over the first stages l: six numbers.

    returns rotation, two translations, and the changes of omega, v_1, v_2
    """
    xi, ex, ey, dw, dx, dy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for stage in range(stages):
        weight = weights[row, stage]
        if weight != 0.0:
            k = stage * n + i
            xi += weight * slopes[k, 0]
            ex += weight * slopes[k, 1]
            ey += weight * slopes[k, 2]
            dw += weight * slopes[k, 3]
            dx += weight * slopes[k, 4]
            dy += weight * slopes[k, 5]
    return h * xi, h * ex, h * ey, h * dw, h * dx, h * dy


@kernel
def move(model, work, scheme, group, h, stage, end, pose):
    """Set all bodies to X_0 exp Psi of a stage; see spatial.move."""
    n = len(model.bodies)
    for i in range(n):
        xi, ex, ey, dw, dx, dy = _increment(h, scheme.a, stage, stage, work.slopes, n, i)
        x = xi * xi
        if not x < LARGEST_ROTATION * LARGEST_ROTATION:
            if x < math.inf:
                return ROTATION_TOO_LARGE
            return NOT_FINITE
        work.report[1] = max(work.report[1], x)
        row = stage * n + i
        work.slopes[row, 0], work.slopes[row, 1], work.slopes[row, 2] = xi, ex, ey
        sinc, versinc, _ = exp_coefficients(x)
        ct, st = 1.0 - x * versinc, xi * sinc
        c0, s0 = pose[i, 0], pose[i, 1]
        c, s = c0 * ct - s0 * st, s0 * ct + c0 * st
        if end:
            # One Newton iteration for the nearest rotation, see so3_nearest.
            scale = 1.5 - 0.5 * (c * c + s * s)
            c, s = c * scale, s * scale
        if group == SE3:
            # dexp_xi eta
            q = xi * versinc
            ex, ey = sinc * ex - q * ey, sinc * ey + q * ex
            ex, ey = c0 * ex - s0 * ey, s0 * ex + c0 * ey
        vx, vy = work.velocity[i, 1] + dx, work.velocity[i, 2] + dy
        if group != SE3:
            vx, vy = c * vx + s * vy, c * vy - s * vx
        work.stage_pose[i, 0], work.stage_pose[i, 1] = c, s
        work.stage_pose[i, 2], work.stage_pose[i, 3] = pose[i, 2] + ex, pose[i, 3] + ey
        work.stage_twist[i, 0] = work.velocity[i, 0] + dw
        work.stage_twist[i, 1], work.stage_twist[i, 2] = vx, vy
    if end and group == SE3:
        clear_ground_slip(model, work.stage_twist)
    return OK


@kernel
def accelerate(model, work, external):
    """Compute the accelerations of a stage. Returns -1, or the element with dependent rows."""
    joint = accelerations(model, work, external)
    return joint if joint < 0 else model.joints[joint]["element"]


@kernel
def store_slopes(model, work, scheme, group, stage):
    """Compute k of all bodies from the accelerations of a stage."""
    n = len(model.bodies)
    for i in range(n):
        row = stage * n + i
        at = 3 * i
        w, vx, vy = work.stage_twist[i, 0], work.stage_twist[i, 1], work.stage_twist[i, 2]
        ax, ay = work.solution[at + 1], work.solution[at + 2]
        if group != SE3:
            c, s = work.stage_pose[i, 0], work.stage_pose[i, 1]
            ax, ay = ax - w * vy, ay + w * vx
            ax, ay = c * ax - s * ay, s * ax + c * ay
            vx, vy = c * vx - s * vy, s * vx + c * vy
        elif stage > 0:
            # dexp^-1_{-Psi}: V + first [Psi, V] + b [Psi, [Psi, V]]
            xi, ex, ey = work.slopes[row, 0], work.slopes[row, 1], work.slopes[row, 2]
            if scheme.highest == EXACT:
                first = 0.5
                b, _ = dexpinv_coefficients(xi * xi)
            else:
                first, b, _ = truncated_dexpinv_coefficients(scheme.highest, xi * xi)
            gx, gy = ey * w - xi * vy, xi * vx - ex * w
            vx, vy = vx + first * gx - b * xi * gy, vy + first * gy + b * xi * gx
        work.slopes[row, 0], work.slopes[row, 1], work.slopes[row, 2] = w, vx, vy
        work.slopes[row, 3], work.slopes[row, 4], work.slopes[row, 5] = work.solution[at], ax, ay


@kernel
def check_end(model, work, h):
    """Check the end of a step of size h; see spaces.py."""
    if not is_finite(work.stage_pose, work.stage_twist):
        return NOT_FINITE
    if len(work.angle) > 0:
        space = work.space
        to_space(model, work.stage_pose, work.stage_twist, space.stage_pose, space.stage_twist)
        fast = kinds.too_fast(model.space.forces, h, space.stage_pose, space.stage_twist)
        if fast >= 0:
            return TURNS_NOT_COUNTED + (fast << 8)
    return OK


@kernel
def error_square(model, work, scheme, row, h, twist, i, rtol, atol):
    """Square of an error estimate of body i for a step from `twist`; see munthe_kaas.py."""
    n = len(twist)
    xi, ex, ey, dw, dx, dy = _increment(
        h, scheme.error, row, scheme.error.shape[1], work.slopes, n, i
    )
    w0, w1 = twist[i, 0], work.stage_twist[i, 0]
    x0, y0 = twist[i, 1], twist[i, 2]
    x1, y1 = work.stage_twist[i, 1], work.stage_twist[i, 2]
    tol_w = atol + rtol * max(abs(w0), abs(w1))
    tol_v = atol + rtol * math.sqrt(max(x0 * x0 + y0 * y0, x1 * x1 + y1 * y1))
    return (
        (xi * xi + ex * ex + ey * ey) / (atol * atol)
        + dw * dw / (tol_w * tol_w)
        + (dx * dx + dy * dy) / (tol_v * tol_v)
    )


@kernel
def close(model, work):
    """Project the end of a step onto the constraints, in space. Returns a status."""
    space = work.space
    to_space(model, work.stage_pose, work.stage_twist, space.stage_pose, space.stage_twist)
    status = close_joints(model.space, space)
    if status != OK:
        return status
    to_plane(model, space.stage_pose, space.stage_twist, work.stage_pose, work.stage_twist)
    return OK


@kernel
def count_turns(model, work):
    """Unwrap the angles of the torsional springs at the end of a step."""
    if len(work.angle) > 0:
        space = work.space
        to_space(model, work.stage_pose, work.stage_twist, space.stage_pose, space.stage_twist)
        kinds.count_turns(model.space.forces, space.stage_pose, work.angle)
