# SPDX-License-Identifier: Apache-2.0
"""Rows of the joints: Jacobian and acceleration bias.

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
from ..lie.vec3 import axpy3, cross3, dot3, load3, load9, sub3, tmatmul3, tmatvec3
from ..model.arrays import WORLD


@kernel
def _keep_violation_in_world_axes(model, work, j, omega, w, v):
    """Change a joint's bias such that its velocity error stays constant in world axes.

    omega : angular velocity of the child, body axes
    w, v  : V_b - W, body axes

    With the bias above the error e of the joint's point stays constant in axes of the child. The
    classical g'' = 0, (6.29), keeps it constant in world axes instead: edot = -omega x e in axes of
    the child. On the constraint e = 0 and both are the same; off it they drift differently.
    """
    first = model.joints[j]["start"]
    rows = model.joints[j]["rows"]
    e = (0.0, 0.0, 0.0)
    for r in range(rows):
        beta = load3(model.child_jacobian, j, 6 * r + 3)
        e = axpy3(dot3(load3(model.child_jacobian, j, 6 * r), w) + dot3(beta, v), beta, e)
    turning = cross3(omega, e)
    for r in range(rows):
        work.solution[first + r] -= dot3(load3(model.child_jacobian, j, 6 * r + 3), turning)


@kernel
def assemble(model, work, pose, twist, world_axes):
    """K of this pose into work.matrix, and the rows' bias (J Vdot = bias) into work.solution.

    pose (n, 12), twist (n, 6)
    world_axes : keep a velocity error of a joint constant in world axes, as (SO(3) x R^3)^n does,
                 or, if False, in axes of the child, as SE(3)^n does
    """
    if not model.is_constant:
        for i in range(len(model.constant)):
            work.matrix[i] = model.constant[i]
    for j in range(len(model.joints)):
        rows = model.joints[j]["rows"]
        first = model.joints[j]["start"]
        a = model.joints[j]["parent"]
        b = model.joints[j]["child"]
        omega, v = load3(twist, b, 0), load3(twist, b, 3)
        if a == WORLD:
            for r in range(rows):
                work.solution[first + r] = 0.0
            if world_axes:
                _keep_violation_in_world_axes(model, work, j, omega, omega, v)
            continue
        rot_b = load9(pose, b, 0)
        rot = tmatmul3(rot_b, load9(pose, a, 0))
        p = tmatvec3(rot_b, sub3(load3(pose, a, 9), load3(pose, b, 9)))
        parent_w, parent_v = se3_Ad(rot, p, load3(twist, a, 0), load3(twist, a, 3))
        bias_w, bias_v = se3_ad(omega, v, parent_w, parent_v)
        place = model.joints[j]["parent_place"]
        # One scalar after the other of a row, or, in a turned block, of a column.
        row_step, step = 6, 1
        if model.joints[j]["parent_turned"] == 1:
            row_step, step = 1, rows
        for r in range(rows):
            alpha = load3(model.child_jacobian, j, 6 * r)
            beta = load3(model.child_jacobian, j, 6 * r + 3)
            work.solution[first + r] = -(dot3(alpha, bias_w) + dot3(beta, bias_v))
            # The row -(alpha, beta) Ad(C_ba).
            row_w = tmatvec3(rot, sub3(alpha, cross3(p, beta)))
            row_v = tmatvec3(rot, beta)
            at = place + r * row_step
            work.matrix[at] = -row_w[0]
            work.matrix[at + step] = -row_w[1]
            work.matrix[at + 2 * step] = -row_w[2]
            work.matrix[at + 3 * step] = -row_v[0]
            work.matrix[at + 4 * step] = -row_v[1]
            work.matrix[at + 5 * step] = -row_v[2]
        if world_axes:
            _keep_violation_in_world_axes(model, work, j, omega, sub3(omega, parent_w),
                                          sub3(v, parent_v))
