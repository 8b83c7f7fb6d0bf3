# SPDX-License-Identifier: Apache-2.0
"""Rows of the joints: residual, Jacobian, acceleration bias, and the products of S = J M^-1 J^T.

A lower pair forbids the directions A (k x 6) of the relative twist of its two frames. With
C_ba = C_b^-1 C_a, W = Ad(C_ba) V_a the parent's twist seen from the child, and J_b = A Ad(F_b^-1)
constant, all a joint needs while integrating is
    velocity      J_b (V_b - W) = 0     so  J_a = -J_b Ad(C_ba)
    acceleration  J Vdot = -J_b [V_b, W]
because [V_b - W, W] = [V_b, W]. To ground W = 0: J_b is all, and the bias vanishes, which is why
joints to ground are kept exactly on SE(3).

The other elements (joints.elements) have a J_b that depends on the pose. It is computed anew
every time, and the bias has the term -Jdot_b (V_b - W) more.

Baumgarte's terms make an error g of position and velocity die out, gddot + 2 a gdot + a^2 g = 0:
the bias gets -2 a J V - a^2 g.
"""
from .._compile import borrowed, kernel, subroutine
from ..joints.distance import distance_rate, distance_residual, distance_row
from ..joints.elements import DISTANCE, PAIR, PERPENDICULAR
from ..joints.pairs import pair_coordinates
from ..joints.perpendicular import perpendicular_rate, perpendicular_residual, perpendicular_row
from ..lie.se3 import se3_ad, se3_Ad, se3_inverse
from ..lie.vec3 import (ZERO3, add3, axpy3, cross3, dot3, load3, load9, matmul3, matrix3, matvec3,
                        scale3, store3, sub3, tmatmul3, tmatvec3, vector3)
from ..model.arrays import WORLD


@kernel
def dot6(a, i, a_start, b, j, b_start):
    """Product of two rows of six."""
    return (a[i, a_start] * b[j, b_start] + a[i, a_start + 1] * b[j, b_start + 1]
            + a[i, a_start + 2] * b[j, b_start + 2] + a[i, a_start + 3] * b[j, b_start + 3]
            + a[i, a_start + 4] * b[j, b_start + 4] + a[i, a_start + 5] * b[j, b_start + 5])


@kernel
def _keep_violation_in_world_axes(model, work, j, omega, w, v, bias_out):
    """Change a joint's bias such that its velocity error stays constant in world axes.

    omega : angular velocity of the child, body axes
    w, v  : V_b - W, body axes

    With the bias above the error e of the joint's point stays constant in axes of the child. The
    classical g'' = 0, (6.29), keeps it constant in world axes instead: edot = -omega x e in axes of
    the child. On the constraint e = 0 and both are the same; off it they drift differently.
    """
    first = model.joints[j]["row_start"]
    rows = model.joints[j]["rows"]
    e = (0.0, 0.0, 0.0)
    for r in range(rows):
        beta = load3(work.jacobian, j, 6 * r + 3)
        e = axpy3(dot3(load3(work.jacobian, j, 6 * r), w) + dot3(beta, v), beta, e)
    turning = cross3(omega, e)
    for r in range(rows):
        bias_out[first + r] -= dot3(load3(work.jacobian, j, 6 * r + 3), turning)


@kernel
def _frame(pose, body, rotation, point):
    """Rotation and origin in the world of a frame that is fixed in a body (or in the world)."""
    if body == WORLD:
        return rotation, point
    rot = load9(pose, body, 0)
    return matmul3(rot, rotation), add3(load3(pose, body, 9), matvec3(rot, point))


@subroutine
def position_residuals(model, pose, residual_out):
    """How far every element is from closed, all rows, rad and m; see joints.elements.

    pose (n, 12), residual_out (all rows,)
    """
    model, pose, residual_out = borrowed(model), borrowed(pose), borrowed(residual_out)
    for e in range(len(model.elements)):
        element = model.elements[e]
        kind = element["kind"]
        first = element["row_start"]
        rot_a, at_a = _frame(pose, element["parent"], matrix3(element["parent_rotation"]),
                             vector3(element["parent_point"]))
        rot_b, at_b = _frame(pose, element["child"], matrix3(element["child_rotation"]),
                             vector3(element["child_point"]))
        rot = tmatmul3(rot_a, rot_b)
        p = tmatvec3(rot_a, sub3(at_b, at_a))
        if kind == PERPENDICULAR:
            residual_out[first] = perpendicular_residual(rot)
        elif kind == DISTANCE:
            residual_out[first] = distance_residual(p, element["length"])
        else:
            angular, linear = pair_coordinates(rot, p, element["turns_freely"] == 1,
                                               element["pitch"])
            forbidden = element["forbidden"]
            for r in range(element["rows"]):
                total = 0.0
                for c in range(3):
                    total += (forbidden[6 * r + c] * angular[c]
                              + forbidden[6 * r + 3 + c] * linear[c])
                residual_out[first + r] = total


@kernel
def _child_row(model, work, j, rot, p, w, v):
    """Row of an element that is no PAIR, at this pose, into the child side of work.jacobian.

    rot, p : C_ba, pose of the parent in the body frame of the child
    w, v   : V_b - W
    returns Jdot_b (V_b - W)
    """
    element = model.elements[model.joints[j]["element"]]
    if element["kind"] == PERPENDICULAR:
        # columns of the frames: x of the parent's one, y of the child's one
        parent, child = element["parent_rotation"], element["child_rotation"]
        x = matvec3(rot, (parent[0], parent[3], parent[6]))
        y = (child[1], child[4], child[7])
        row_w, row_v = perpendicular_row(x, y), ZERO3
        rate = perpendicular_rate(x, y, w)
    else:
        s = vector3(element["child_point"])
        q = add3(p, matvec3(rot, vector3(element["parent_point"])))
        row_w, row_v = distance_row(s, q)
        rate = distance_rate(s, q, w, v)
    b = model.joints[j]["child"]
    store3(row_w, work.jacobian, j, 0)
    store3(row_v, work.jacobian, j, 3)
    store3(matvec3(matrix3(model.bodies[b]["inverse_inertia"]), row_w), work.mobility, j, 0)
    store3(scale3(model.bodies[b]["inverse_mass"], row_v), work.mobility, j, 3)
    return rate


@kernel
def assemble_rows(model, work, pose, twist, world_axes, bias_out):
    """Jacobians of this pose and M^-1 times them, and the bias J Vdot = bias of every row.

    pose (n, 12), twist (n, 6); fills all of work.jacobian and work.mobility that is not constant,
    and bias_out (rows,)
    world_axes : keep a velocity error of a joint constant in world axes, as (SO(3) x R^3)^n does,
                 or, if False, in axes of the child, as SE(3)^n does
    """
    m = len(model.joints)
    for j in range(m):
        rows = model.joints[j]["rows"]
        first = model.joints[j]["row_start"]
        a = model.joints[j]["parent"]
        b = model.joints[j]["child"]
        omega, v = load3(twist, b, 0), load3(twist, b, 3)
        if a == WORLD and model.joints[j]["kind"] == PAIR:
            for r in range(rows):
                bias_out[first + r] = 0.0
            if world_axes:
                _keep_violation_in_world_axes(model, work, j, omega, omega, v, bias_out)
            continue
        rot_b = load9(pose, b, 0)
        if a == WORLD:
            rot, p = se3_inverse(rot_b, load3(pose, b, 9))
            parent_w, parent_v = ZERO3, ZERO3
        else:
            rot = tmatmul3(rot_b, load9(pose, a, 0))
            p = tmatvec3(rot_b, sub3(load3(pose, a, 9), load3(pose, b, 9)))
            parent_w, parent_v = se3_Ad(rot, p, load3(twist, a, 0), load3(twist, a, 3))
        relative_w, relative_v = sub3(omega, parent_w), sub3(v, parent_v)
        bias_w, bias_v = se3_ad(omega, v, parent_w, parent_v)
        rate = 0.0
        if model.joints[j]["kind"] != PAIR:
            rate = _child_row(model, work, j, rot, p, relative_w, relative_v)
        for r in range(rows):
            bias_out[first + r] = -rate - (dot3(load3(work.jacobian, j, 6 * r), bias_w)
                                           + dot3(load3(work.jacobian, j, 6 * r + 3), bias_v))
        if world_axes:
            _keep_violation_in_world_axes(model, work, j, omega, relative_w, relative_v, bias_out)
        if a == WORLD:
            continue
        inverse_inertia = matrix3(model.bodies[a]["inverse_inertia"])
        inverse_mass = model.bodies[a]["inverse_mass"]
        for r in range(rows):
            # The row -(alpha, beta) Ad(C_ba).
            beta = load3(work.jacobian, j, 6 * r + 3)
            row_w = tmatvec3(rot, sub3(cross3(p, beta), load3(work.jacobian, j, 6 * r)))
            row_v = scale3(-1.0, tmatvec3(rot, beta))
            store3(row_w, work.jacobian, m + j, 6 * r)
            store3(row_v, work.jacobian, m + j, 6 * r + 3)
            store3(matvec3(inverse_inertia, row_w), work.mobility, m + j, 6 * r)
            store3(scale3(inverse_mass, row_v), work.mobility, m + j, 6 * r + 3)


@kernel
def row_velocity(model, work, j, r, velocity):
    """J V of row r of joint j. velocity (n, 6): twists, accelerations or displacements."""
    a = model.joints[j]["parent"]
    value = dot6(work.jacobian, j, 6 * r, velocity, model.joints[j]["child"], 0)
    if a != WORLD:
        value += dot6(work.jacobian, len(model.joints) + j, 6 * r, velocity, a, 0)
    return value


@subroutine
def add_baumgarte(model, work, pose, twist, bias_out):
    """Add Baumgarte's terms to the bias of every row; needs the rows of this pose."""
    model, work = borrowed(model), borrowed(work)
    pose, twist, bias_out = borrowed(pose), borrowed(twist), borrowed(bias_out)
    rate = model.baumgarte_rate
    position_residuals(model, pose, work.residual)
    for j in range(len(model.joints)):
        for r in range(model.joints[j]["rows"]):
            row = model.joints[j]["row_start"] + r
            g = work.residual[model.row_residual[row]]
            bias_out[row] -= rate * (2.0 * row_velocity(model, work, j, r, twist) + rate * g)


@kernel
def _add_product(model, work, e, columns):
    """Add product e, J_i G_j^T, to its block of S, which has so many columns."""
    m = len(model.joints)
    place = model.products[e, 0]
    i = model.products[e, 1]
    row_i = model.products[e, 2] * m + i
    row_j = model.products[e, 4] * m + model.products[e, 3]
    for r in range(model.joints[i]["rows"]):
        for c in range(columns):
            work.solve[place + r * columns + c] += dot6(
                work.jacobian, row_i, 6 * r, work.mobility, row_j, 6 * c)


@kernel
def assemble_solve(model, work):
    """S = J M^-1 J^T, lower triangle of blocks, into work.solve."""
    for i in range(len(work.solve)):
        work.solve[i] = model.solve_constant[i]
    for e in range(len(model.products)):
        columns = model.joints[model.products[e, 3]]["rows"]
        if columns == 3:
            _add_product(model, work, e, 3)
        elif columns == 5:
            _add_product(model, work, e, 5)
        else:
            _add_product(model, work, e, columns)


@kernel
def add_transposed(model, work, rows, sign, out):
    """out += sign * rows^T lambda, body by body: out (n, 6).

    rows : work.jacobian, which gives wrenches, or work.mobility, which gives accelerations
    """
    m = len(model.joints)
    for j in range(m):
        a = model.joints[j]["parent"]
        b = model.joints[j]["child"]
        for r in range(model.joints[j]["rows"]):
            value = sign * work.multiplier[model.joints[j]["row_start"] + r]
            for c in range(6):
                out[b, c] += value * rows[j, 6 * r + c]
            if a != WORLD:
                for c in range(6):
                    out[a, c] += value * rows[m + j, 6 * r + c]


@kernel
def constraint_force(model, work, sign, wrench_out):
    """Add sign * J^T lambda to the wrenches of the bodies."""
    add_transposed(model, work, work.jacobian, sign, wrench_out)
