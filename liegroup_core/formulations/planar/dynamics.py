# SPDX-License-Identifier: Apache-2.0
"""Index-1 accelerations in the plane: constraints.py and newton_euler.py of `absolute` for SE(2).

Let p and R(phi) be the position and rotation of the parent relative to the child, and
J v = (-v_2, v_1). The twist of the parent at the child is W = (omega_a, R v_a - omega_a J p). A row
(alpha, beta) of the child gives
    velocity          alpha (omega_b - omega_a) + beta . (v_b - W_v) = 0
    row of the parent -(alpha - p x beta, R^T beta)
    acceleration      bias = -beta . (omega_b J W_v - omega_a J v_b + omega_b J e)
e is the velocity residual of the joint, as in constraints.py.
"""

from liegroup_core.compiling import kernel
from liegroup_core.formulations.absolute.newton_euler import REFINEMENTS_WHEN_SINGULAR
from liegroup_core.formulations.absolute.saddle_point import REGULARISATION, solve_in_plane
from liegroup_core.joints.elements import WORLD
from liegroup_core.lie.vec3 import load3

from .state import add_forces
from .tree import solve_tree


@kernel
def _wrenches(model, work, external):
    """Write applied wrenches, gravity, forces and gyroscopic terms into work.solution."""
    if model.has_forces:
        add_forces(model, work, work.wrench)
    gx, gy = model.gravity[0, 0], model.gravity[0, 1]
    for i in range(len(model.bodies)):
        at = 3 * i
        mass = model.bodies[i]["mass"]
        c, s = work.stage_pose[i, 0], work.stage_pose[i, 1]
        w, vx, vy = work.stage_twist[i, 0], work.stage_twist[i, 1], work.stage_twist[i, 2]
        torque, fx, fy = load3(external, i, 0)
        if external[i, 3] != 0.0 or external[i, 4] != 0.0:
            turned_x = c * external[i, 3] + s * external[i, 4]
            turned_y = c * external[i, 4] - s * external[i, 3]
            torque -= external[i, 5] * turned_y - external[i, 6] * turned_x
            fx, fy = fx + turned_x, fy + turned_y
        work.solution[at] = torque
        work.solution[at + 1] = fx + mass * (w * vy + (c * gx + s * gy))
        work.solution[at + 2] = fy + mass * ((c * gy - s * gx) - w * vx)
        if model.has_forces:
            for r in range(3):
                work.solution[at + r] += work.wrench[i, r]


@kernel
def _set_bias(model, work, j, w, error, bracket_x, bracket_y):
    """Write the bias of the rows of joint j into work.solution.

    w       : angular velocity of the child, rad/s
    error   : V_b - W, (omega, v_1, v_2)
    bracket : linear part of [V_b, W]; its angular part is 0
    """
    start, first = model.joints[j]["start"], model.joints[j]["first"]
    rows = model.joints[j]["rows"]
    jacobian = model.child_jacobian
    ex, ey = 0.0, 0.0
    for r in range(rows):
        alpha, x, y = load3(jacobian, first + r, 0)
        slip = alpha * error[0] + x * error[1] + y * error[2]
        ex += slip * x
        ey += slip * y
    bracket_x -= w * ey
    bracket_y += w * ex
    for r in range(rows):
        work.solution[start + r] = -(
            jacobian[first + r, 1] * bracket_x + jacobian[first + r, 2] * bracket_y
        )


@kernel
def _set_parent_rows(model, work, j, c, s, px, py):
    """Write the rows of joint j for its parent into K.

    c, s, px, py : rotation and position of the parent relative to the child
    """
    rows, first = model.joints[j]["rows"], model.joints[j]["first"]
    place = model.joints[j]["parent_place"]
    row_step, step = 3, 1
    if model.joints[j]["parent_turned"] == 1:
        row_step, step = 1, rows
    jacobian = model.child_jacobian
    for r in range(rows):
        alpha, x, y = load3(jacobian, first + r, 0)
        at = place + r * row_step
        work.matrix[at] = (px * y - py * x) - alpha
        work.matrix[at + step] = -(c * x + s * y)
        work.matrix[at + 2 * step] = s * x - c * y


@kernel
def assemble(model, work):
    """Write K of the stage into work.matrix and the bias of the rows into work.solution."""
    for i in range(model.summed):
        work.matrix[i] = model.matrix[i]
    pose, twist = work.stage_pose, work.stage_twist
    for j in range(len(model.joints)):
        a = model.joints[j]["parent"]
        b = model.joints[j]["child"]
        w, vx, vy = twist[b, 0], twist[b, 1], twist[b, 2]
        if a == WORLD:
            _set_bias(model, work, j, w, (w, vx, vy), 0.0, 0.0)
            continue
        cb, sb = pose[b, 0], pose[b, 1]
        ca, sa = pose[a, 0], pose[a, 1]
        c, s = cb * ca + sb * sa, cb * sa - sb * ca
        dx, dy = pose[a, 2] - pose[b, 2], pose[a, 3] - pose[b, 3]
        px, py = cb * dx + sb * dy, cb * dy - sb * dx
        wa, ax, ay = twist[a, 0], twist[a, 1], twist[a, 2]
        wx, wy = c * ax - s * ay + wa * py, s * ax + c * ay - wa * px
        _set_bias(model, work, j, w, (w - wa, vx - wx, vy - wy), wa * vy - w * wy, w * wx - wa * vx)
        _set_parent_rows(model, work, j, c, s, px, py)


@kernel
def accelerations(model, work, external):
    """Write accelerations of the stage, and multipliers, to work.solution; external (n, 7).

    returns -1, or the joint with dependent rows if the regularised solve fails too
    """
    if len(model.links) > 0:
        _wrenches(model, work, external)
        solve_tree(model, work, work.stage_pose, work.stage_twist)
        return -1
    dependent = -1
    refinements, shift = model.refinements, 0.0
    for _ in range(2):
        _wrenches(model, work, external)
        assemble(model, work)
        dependent = solve_in_plane(model, work, refinements, shift)
        if dependent < 0:
            break
        refinements, shift = REFINEMENTS_WHEN_SINGULAR, REGULARISATION
        work.report[2] += 1.0
    return dependent


@kernel
def clear_ground_slip(model, twist):
    """Remove the round-off of J V at joints to ground from the twists (n, 3)."""
    for j in range(len(model.joints)):
        if model.joints[j]["parent"] == WORLD:
            b = model.joints[j]["child"]
            w, vx, vy = twist[b, 0], twist[b, 1], twist[b, 2]
            for r in range(3):
                twist[b, r] -= (
                    model.ground_projector[j, 3 * r] * w
                    + model.ground_projector[j, 3 * r + 1] * vx
                    + model.ground_projector[j, 3 * r + 2] * vy
                )
