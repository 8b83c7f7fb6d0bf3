# SPDX-License-Identifier: Apache-2.0
"""Rows of the joints: Jacobian, acceleration bias, and the products that make S = J M^-1 J^T.

A lower pair forbids the directions A (k x 6) of the relative twist of its two frames. With
C_ba = C_b^-1 C_a, W = Ad(C_ba) V_a the parent's twist seen from the child, and J_b = A Ad(F_b^-1)
constant, all a joint needs while integrating is
    velocity      J_b (V_b - W) = 0     so  J_a = -J_b Ad(C_ba)
    acceleration  J Vdot = -J_b [V_b, W]
because [V_b - W, W] = [V_b, W]. To ground W = 0: J_b is all, and the bias vanishes, which is why
joints to ground are kept exactly on SE(3).
"""
from .._compile import kernel
from ..lie.se3 import se3_ad, se3_Ad
from ..lie.vec3 import (axpy3, cross3, dot3, load3, load9, matrix3, matvec3, scale3, store3, sub3,
                        tmatmul3, tmatvec3)
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
def assemble_rows(model, work, pose, twist, world_axes, bias_out):
    """Parent-side Jacobians and M^-1 times them, and the bias J Vdot = bias of every row.

    pose (n, 12), twist (n, 6); fills work.jacobian[m:], work.mobility[m:] and bias_out (rows,)
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
        if a == WORLD:
            for r in range(rows):
                bias_out[first + r] = 0.0
            if world_axes:
                _keep_violation_in_world_axes(model, work, j, omega, omega, v, bias_out)
            continue
        rot_b = load9(pose, b, 0)
        rot = tmatmul3(rot_b, load9(pose, a, 0))
        p = tmatvec3(rot_b, sub3(load3(pose, a, 9), load3(pose, b, 9)))
        parent_w, parent_v = se3_Ad(rot, p, load3(twist, a, 0), load3(twist, a, 3))
        bias_w, bias_v = se3_ad(omega, v, parent_w, parent_v)
        inverse_inertia = matrix3(model.bodies[a]["inverse_inertia"])
        inverse_mass = model.bodies[a]["inverse_mass"]
        for r in range(rows):
            alpha = load3(work.jacobian, j, 6 * r)
            beta = load3(work.jacobian, j, 6 * r + 3)
            bias_out[first + r] = -(dot3(alpha, bias_w) + dot3(beta, bias_v))
            # The row -(alpha, beta) Ad(C_ba).
            row_w = scale3(-1.0, tmatvec3(rot, sub3(alpha, cross3(p, beta))))
            row_v = scale3(-1.0, tmatvec3(rot, beta))
            store3(row_w, work.jacobian, m + j, 6 * r)
            store3(row_v, work.jacobian, m + j, 6 * r + 3)
            store3(matvec3(inverse_inertia, row_w), work.mobility, m + j, 6 * r)
            store3(scale3(inverse_mass, row_v), work.mobility, m + j, 6 * r + 3)
        if world_axes:
            _keep_violation_in_world_axes(model, work, j, omega, sub3(omega, parent_w),
                                          sub3(v, parent_v), bias_out)


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
def constraint_force(model, work, sign, wrench_out):
    """Add sign * J^T lambda to the wrenches of the bodies."""
    m = len(model.joints)
    for j in range(m):
        a = model.joints[j]["parent"]
        b = model.joints[j]["child"]
        for r in range(model.joints[j]["rows"]):
            value = sign * work.multiplier[model.joints[j]["row_start"] + r]
            for c in range(6):
                wrench_out[b, c] += value * work.jacobian[j, 6 * r + c]
            if a != WORLD:
                for c in range(6):
                    wrench_out[a, c] += value * work.jacobian[m + j, 6 * r + c]
