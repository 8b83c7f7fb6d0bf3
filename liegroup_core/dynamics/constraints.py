# SPDX-License-Identifier: Apache-2.0
"""Rows of the joints: Jacobian and acceleration bias.

A lower pair forbids the directions A (k x 6) of the relative twist of its two frames. With
C_ba = C_b^-1 C_a, W = Ad(C_ba) V_a the parent's twist seen from the child, and J_b = A Ad(F_b^-1)
constant, all a joint needs while integrating is
    velocity      J_b (V_b - W) = 0     so  J_a = -J_b Ad(C_ba)
    acceleration  J Vdot = -J_b [V_b, W] - J_b (0, omega_b x e)
because [V_b - W, W] = [V_b, W]. The last term is zero as long as the velocities keep the joint;
e is the velocity error of the joint's point, and the term keeps an error there may be constant in
world axes, as g'' = 0, (6.29), does, instead of in axes of the child. On a fast four-bar this was
measured to drift less. To ground W = 0 and J_b is all: that is why joints to ground are kept
exactly on SE(3).
"""
from .._compile import kernel
from ..lie.se3 import se3_ad, se3_Ad
from ..lie.vec3 import (ZERO3, add3, axpy3, cross3, dot3, load3, load9, sub3, tmatmul3,
                        tmatvec3)
from ..model.arrays import WORLD


@kernel
def _set_bias(model, work, j, omega, bracket_w, bracket_v, error_w, error_v):
    """Bias of the rows of joint j into work.solution.

    omega   : angular velocity of the child, body axes
    bracket : [V_b, W]; error : V_b - W; both in body axes of the child
    """
    first = model.joints[j]["start"]
    rows = model.joints[j]["rows"]
    e = (0.0, 0.0, 0.0)
    for r in range(rows):
        beta = load3(model.child_jacobian, j, 6 * r + 3)
        slip = dot3(load3(model.child_jacobian, j, 6 * r), error_w) + dot3(beta, error_v)
        e = axpy3(slip, beta, e)
    bracket_v = add3(bracket_v, cross3(omega, e))
    for r in range(rows):
        work.solution[first + r] = -(dot3(load3(model.child_jacobian, j, 6 * r), bracket_w)
                                     + dot3(load3(model.child_jacobian, j, 6 * r + 3), bracket_v))


@kernel
def _set_parent_rows(model, work, j, rot, p):
    """J_a = -J_b Ad(C_ba) of joint j into its block of K; rot, p: C_ba."""
    rows = model.joints[j]["rows"]
    place = model.joints[j]["parent_place"]
    # One scalar after the other of a row, or, in a turned block, of a column.
    row_step, step = 6, 1
    if model.joints[j]["parent_turned"] == 1:
        row_step, step = 1, rows
    for r in range(rows):
        beta = load3(model.child_jacobian, j, 6 * r + 3)
        row_w = tmatvec3(rot, sub3(load3(model.child_jacobian, j, 6 * r), cross3(p, beta)))
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
    """K of this pose into work.matrix, and the rows' bias (J Vdot = bias) into work.solution.

    pose (n, 12), twist (n, 6)
    """
    if not model.is_constant:
        for i in range(len(model.constant)):
            work.matrix[i] = model.constant[i]
    for j in range(len(model.joints)):
        a = model.joints[j]["parent"]
        b = model.joints[j]["child"]
        omega, v = load3(twist, b, 0), load3(twist, b, 3)
        if a == WORLD:
            _set_bias(model, work, j, omega, ZERO3, ZERO3, omega, v)
            continue
        rot_b = load9(pose, b, 0)
        rot = tmatmul3(rot_b, load9(pose, a, 0))
        p = tmatvec3(rot_b, sub3(load3(pose, a, 9), load3(pose, b, 9)))
        parent_w, parent_v = se3_Ad(rot, p, load3(twist, a, 0), load3(twist, a, 3))
        bracket_w, bracket_v = se3_ad(omega, v, parent_w, parent_v)
        _set_bias(model, work, j, omega, bracket_w, bracket_v, sub3(omega, parent_w),
                  sub3(v, parent_v))
        _set_parent_rows(model, work, j, rot, p)
