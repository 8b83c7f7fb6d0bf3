# SPDX-License-Identifier: Apache-2.0
"""Constraint equations of the joints: residual, Jacobian and acceleration bias.

A lower pair constrains the components A (k x 6) of the relative twist of its two frames. Let
C_ba = C_b^-1 C_a, let W = Ad(C_ba) V_a be the twist of the parent in the axes of the child, and let
F_b be the frame of the joint in the child. With the constant J_b = A Ad(F_b^-1) the equations are
    velocity      J_b (V_b - W) = 0     so  J_a = -J_b Ad(C_ba)
    acceleration  J Vdot = -J_b [V_b, W] - J_b (0, omega_b x e)
because [V_b - W, W] = [V_b, W]. e is the velocity residual at the origin of the joint; the last term
is zero if the velocities satisfy the joint. The term keeps a velocity residual constant in world
axes, as g'' = 0, (6.29), does, instead of in the axes of the child: on a fast four-bar the drift is
smaller (measured). For a joint to ground W = 0 and only J_b remains. Therefore SE(3) satisfies
joints to ground exactly.

Other elements (joints/elements.py) have a J_b that depends on the pose. It is evaluated at every
pose, and the bias has the additional term -Jdot_b (V_b - W).

Baumgarte's terms damp the residuals of position and velocity, gddot + 2 a gdot + a^2 g = 0: they
add -2 a J V - a^2 g to the bias.
"""

from liegroup_core.compiling import borrowed, kernel, shared, subroutine
from liegroup_core.joints.elements import PAIR, WORLD
from liegroup_core.joints.kinds import variable_residual, variable_row
from liegroup_core.joints.pairs import pair_coordinates
from liegroup_core.lie.se3 import se3_Ad, se3_ad, se3_inverse
from liegroup_core.lie.vec3 import (
    ZERO3,
    add3,
    axpy3,
    cross3,
    dot3,
    load3,
    load9,
    matmul3,
    matrix3,
    matvec3,
    store3,
    sub3,
    tmatmul3,
    tmatvec3,
    vector3,
)


@kernel
def _frame(pose, body, rotation, point):
    """Rotation and origin, world axes, of a frame that is fixed in a body or in the world."""
    if body == WORLD:
        return rotation, point
    rot = load9(pose, body, 0)
    return matmul3(rot, rotation), add3(load3(pose, body, 9), matvec3(rot, point))


@shared
def position_residuals(model, pose, residual_out):
    """Position residuals of all rows of all elements, rad and m; see joints/elements.py.

    pose (n, 12), residual_out (all rows,)
    """
    pose, residual_out = borrowed(pose), borrowed(residual_out)
    for e in range(len(model.elements)):
        element = model.elements[e]
        kind = element["kind"]
        first = element["row_start"]
        rot_a, at_a = _frame(
            pose,
            element["parent"],
            matrix3(element["parent_rotation"]),
            vector3(element["parent_point"]),
        )
        rot_b, at_b = _frame(
            pose,
            element["child"],
            matrix3(element["child_rotation"]),
            vector3(element["child_point"]),
        )
        rot = tmatmul3(rot_a, rot_b)
        p = tmatvec3(rot_a, sub3(at_b, at_a))
        if kind != PAIR:
            residual_out[first] = variable_residual(kind, rot, p, element["parameter"])
        else:
            angular, linear = pair_coordinates(
                rot, p, element["turns_freely"] == 1, element["parameter"]
            )
            forbidden = element["forbidden"]
            for r in range(element["rows"]):
                total = 0.0
                for c in range(3):
                    total += (
                        forbidden[6 * r + c] * angular[c] + forbidden[6 * r + 3 + c] * linear[c]
                    )
                residual_out[first + r] = total
    return 0


@kernel
def _child_row(model, work, j, rot, p, w, v):
    """Write the row of an element other than a PAIR into work.child_jacobian and K.

    j      : index in model.joints
    rot, p : C_ba, pose of the parent in the body frame of the child
    w, v   : V_b - W
    returns Jdot_b (V_b - W)
    """
    element = model.elements[model.joints[j]["element"]]
    row_w, row_v, rate = variable_row(element, rot, p, w, v)
    store3(row_w, work.child_jacobian, model.joints[j]["first"], 0)
    store3(row_v, work.child_jacobian, model.joints[j]["first"], 3)
    # A block of one row is stored alike whether it is transposed or not.
    place = model.joints[j]["child_place"]
    for c in range(3):
        work.matrix[place + c] = row_w[c]
        work.matrix[place + 3 + c] = row_v[c]
    return rate


@kernel
def _set_bias(model, work, j, omega, bracket_w, bracket_v, error_w, error_v, rate):
    """Write the bias of the rows of joint j into work.solution, and J V into work.slip.

    omega   : angular velocity of the child, body axes
    bracket : [V_b, W], body axes of the child
    error   : V_b - W, body axes of the child
    rate    : Jdot_b (V_b - W) of an element other than a PAIR, else 0
    """
    start = model.joints[j]["start"]
    first = model.joints[j]["first"]
    rows = model.joints[j]["rows"]
    e = ZERO3
    for r in range(rows):
        beta = load3(work.child_jacobian, first + r, 3)
        slip = dot3(load3(work.child_jacobian, first + r, 0), error_w) + dot3(beta, error_v)
        work.slip[first + r] = slip
        e = axpy3(slip, beta, e)
    bracket_v = add3(bracket_v, cross3(omega, e))
    for r in range(rows):
        work.solution[start + r] = -rate - (
            dot3(load3(work.child_jacobian, first + r, 0), bracket_w)
            + dot3(load3(work.child_jacobian, first + r, 3), bracket_v)
        )


@kernel
def _set_parent_rows(model, work, j, rot, p):
    """Write J_a = -J_b Ad(C_ba) of joint j into its block of K; rot, p: C_ba."""
    rows, first = model.joints[j]["rows"], model.joints[j]["first"]
    place = model.joints[j]["parent_place"]
    # Strides from row to row and within a row; the block may be transposed.
    row_step, step = 6, 1
    if model.joints[j]["parent_turned"] == 1:
        row_step, step = 1, rows
    for r in range(rows):
        beta = load3(work.child_jacobian, first + r, 3)
        row_w = tmatvec3(rot, sub3(load3(work.child_jacobian, first + r, 0), cross3(p, beta)))
        row_v = tmatvec3(rot, beta)
        at = place + r * row_step
        work.matrix[at] = -row_w[0]
        work.matrix[at + step] = -row_w[1]
        work.matrix[at + 2 * step] = -row_w[2]
        work.matrix[at + 3 * step] = -row_v[0]
        work.matrix[at + 4 * step] = -row_v[1]
        work.matrix[at + 5 * step] = -row_v[2]


@kernel
def assemble(model, work, pose, twist):
    """Write K into work.matrix, J V into work.slip and the bias of the rows into work.solution.

    pose (n, 12), twist (n, 6); bias: J Vdot = bias
    """
    for i in range(model.summed):
        work.matrix[i] = model.matrix[i]
    for j in range(len(model.joints)):
        a = model.joints[j]["parent"]
        b = model.joints[j]["child"]
        omega, v = load3(twist, b, 0), load3(twist, b, 3)
        rot_b = load9(pose, b, 0)
        if a == WORLD:
            rate = 0.0
            if model.joints[j]["kind"] != PAIR:
                rot, p = se3_inverse(rot_b, load3(pose, b, 9))
                rate = _child_row(model, work, j, rot, p, omega, v)
            _set_bias(model, work, j, omega, ZERO3, ZERO3, omega, v, rate)
            continue
        rot = tmatmul3(rot_b, load9(pose, a, 0))
        p = tmatvec3(rot_b, sub3(load3(pose, a, 9), load3(pose, b, 9)))
        parent_w, parent_v = se3_Ad(rot, p, load3(twist, a, 0), load3(twist, a, 3))
        error_w, error_v = sub3(omega, parent_w), sub3(v, parent_v)
        bracket_w, bracket_v = se3_ad(omega, v, parent_w, parent_v)
        rate = 0.0
        if model.joints[j]["kind"] != PAIR:
            rate = _child_row(model, work, j, rot, p, error_w, error_v)
        _set_bias(model, work, j, omega, bracket_w, bracket_v, error_w, error_v, rate)
        _set_parent_rows(model, work, j, rot, p)


@kernel
def clear_ground_slip(model, twist):
    """Remove the round-off of J V at lower pairs to ground from the twists (n, 6).

    SE(3) satisfies these joints exactly except for round-off. An acceleration error of 1e-16 of the
    forces, constant in time, would let the joint drift with the square of time.
    """
    for j in range(len(model.joints)):
        if model.joints[j]["parent"] == WORLD and model.joints[j]["kind"] == PAIR:
            b = model.joints[j]["child"]
            w, v = load3(twist, b, 0), load3(twist, b, 3)
            for r in range(6):
                twist[b, r] -= dot3(load3(model.ground_projector, j, 6 * r), w) + dot3(
                    load3(model.ground_projector, j, 6 * r + 3), v
                )


@kernel
def subtract_joint_forces(model, work, multipliers, at, wrench_out):
    """Subtract J^T lambda from the wrenches (n, 6), with the rows written by `assemble`.

    multipliers : array with lambda, in the order of Model.row_residual, from entry `at` on
    """
    for j in range(len(model.joints)):
        a = model.joints[j]["parent"]
        b = model.joints[j]["child"]
        rows = model.joints[j]["rows"]
        row_step, step = 6, 1
        if model.joints[j]["parent_turned"] == 1:
            row_step, step = 1, rows
        for r in range(rows):
            row = model.joints[j]["first"] + r
            value = multipliers[at + row]
            place = model.joints[j]["parent_place"] + r * row_step
            for c in range(6):
                wrench_out[b, c] -= value * work.child_jacobian[row, c]
                if a != WORLD:
                    wrench_out[a, c] -= value * work.matrix[place + c * step]


@subroutine
def add_baumgarte(model, work, pose):
    """Add Baumgarte's terms to the bias written by `assemble`."""
    pose = borrowed(pose)
    rate = model.baumgarte_rate
    position_residuals(model, pose, work.gap)
    for j in range(len(model.joints)):
        first = model.joints[j]["first"]
        for r in range(model.joints[j]["rows"]):
            g = work.gap[model.row_residual[first + r]]
            work.solution[model.joints[j]["start"] + r] -= rate * (
                2.0 * work.slip[first + r] + rate * g
            )
