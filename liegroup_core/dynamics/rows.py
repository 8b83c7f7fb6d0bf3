# SPDX-License-Identifier: Apache-2.0
"""Rows of the cut joints, and their responses in the freedoms of the tree; see loops.py.

A lower pair constrains the components A (k x 6) of the relative twist of its two frames. Let
C_ba = C_b^-1 C_a, let W = Ad(C_ba) V_a be the twist of the parent in the axes of the child, and let
F_b be the frame of the joint in the child. With the constant J_b = A Ad(F_b^-1) the equations are
    velocity      J_b (V_b - W) = 0     so  J_a = -J_b Ad(C_ba)
    acceleration  J Vdot = -J_b [V_b, W] - J_b (0, omega_b x e)
because [V_b - W, W] = [V_b, W]. e is the velocity residual at the origin of the joint; the last term
keeps it constant in world axes, as g'' = 0, (6.29), does. For a joint to ground W = 0 and only J_b
remains: SE(3) satisfies such joints exactly. Elements other than pairs (joints/elements.py) have a J_b
that depends on the pose, and the bias has the additional term -Jdot_b (V_b - W).

Stages of a step leave small gaps. The force of a ball joint acts on each of its links at that
link's own point, whatever the gap: at the point of the other link it would have a moment about a rod
between two balls, which has next to no inertia there and would spin. So rows and bias of a ball
joint are those of the accelerations of the two points, in world axes. With an empty tree they are
those of all joints, as in the chapter.
"""

from liegroup_core.compiling import kernel
from liegroup_core.joints.elements import PAIR, WORLD
from liegroup_core.joints.kinds import variable_row
from liegroup_core.lie.se3 import se3_Ad, se3_ad, se3_inverse
from liegroup_core.lie.vec3 import (
    ZERO3,
    add3,
    axpy3,
    cross3,
    dot3,
    load3,
    load9,
    matvec3,
    store3,
    sub3,
    tmatmul3,
    tmatvec3,
    vector3,
)
from liegroup_core.mechanism.arrays import LARGEST_ROWS
from liegroup_core.motion_groups.table import leave

from .couplings import add_coupling
from .matrix import set_block
from .trees import add_wrench


@kernel
def set_rows(model, work):
    """Rows of all cut joints, J V to work.slip, and the bias of J Vdot to work.bias."""
    for j in range(len(model.joints)):
        joint = model.joints[j]
        a, b, first, rows = joint["parent"], joint["child"], joint["first"], joint["rows"]
        rot_b, r_b = load9(work.world, b, 0), load3(work.world, b, 9)
        w_b, v_b = load3(work.velocities, b, 0), load3(work.velocities, b, 3)
        element = model.elements[joint["element"]]
        turn = w_b
        if a == WORLD:
            rot, p = se3_inverse(rot_b, r_b)
            w_a, v_a = ZERO3, ZERO3
        else:
            rot = tmatmul3(rot_b, load9(work.world, a, 0))
            p = tmatvec3(rot_b, sub3(load3(work.world, a, 9), r_b))
            if joint["own_points"] == 1:
                # The parent, moved by the gap: its point is that of the child.
                point = matvec3(rot, vector3(element["parent_point"]))
                p = sub3(vector3(element["child_point"]), point)
            w_a, v_a = se3_Ad(rot, p, load3(work.velocities, a, 0), load3(work.velocities, a, 3))
            if joint["own_points"] == 1:
                turn = add3(w_b, w_a)
        error_w, error_v = sub3(w_b, w_a), sub3(v_b, v_a)
        rate = 0.0
        if joint["kind"] != PAIR:
            row_w, row_v, rate = variable_row(element, rot, p, error_w, error_v)
            store3(row_w, work.child_jacobian, first, 0)
            store3(row_v, work.child_jacobian, first, 3)
        e = ZERO3
        for r in range(first, first + rows):
            alpha, beta = load3(work.child_jacobian, r, 0), load3(work.child_jacobian, r, 3)
            slip = dot3(alpha, error_w) + dot3(beta, error_v)
            work.slip[r] = slip
            e = axpy3(slip, beta, e)
            store3(tmatvec3(rot, sub3(cross3(p, beta), alpha)), work.parent_jacobian, r, 0)
            back = tmatvec3(rot, beta)
            store3((-back[0], -back[1], -back[2]), work.parent_jacobian, r, 3)
        bracket_w, bracket_v = se3_ad(w_b, v_b, w_a, v_a)
        bracket_v = add3(bracket_v, cross3(turn, e))
        for r in range(first, first + rows):
            work.bias[r] = -rate - (
                dot3(load3(work.child_jacobian, r, 0), bracket_w)
                + dot3(load3(work.child_jacobian, r, 3), bracket_v)
            )


@kernel
def respond(model, work, j):
    """Responses y of the rows of joint j, along its path to the world, and their block of W."""
    joint = model.joints[j]
    a, b, first, rows = joint["parent"], joint["child"], joint["first"], joint["rows"]
    carried, at = work.carried, model.path_places[j]
    for k in range(model.paths[j, 0], model.paths[j, 1]):
        start = LARGEST_ROWS * model.path_links[k]
        for r in range(start, start + rows):
            for c in range(6):
                carried[r, c] = 0.0
    for r in range(rows):
        for c in range(6):
            carried[LARGEST_ROWS * b + r, c] = work.child_jacobian[first + r, c]
            if a != WORLD:
                carried[LARGEST_ROWS * a + r, c] += work.parent_jacobian[first + r, c]
    if model.coupling[j] >= 0:
        add_coupling(model, work, model.coupling[j], 1.0, carried, LARGEST_ROWS)
    for p in range(model.paths[j, 0], model.paths[j, 1]):
        i = model.path_links[p]
        link = model.bodies[i]
        parent = link["parent"]
        # The rows do not depend on each other: a processor works on several at once.
        for r in range(rows):
            row = LARGEST_ROWS * i + r
            # It stays in registers: that is a fifth faster.
            w, v = load3(carried, row, 0), load3(carried, row, 3)
            w, v = leave(link, work, link["freedom"], at + r, rows, w, v)
            if parent != WORLD:
                rot, shift = load9(work.relative, i, 0), load3(work.relative, i, 9)
                add_wrench(w, v, rot, shift, carried, LARGEST_ROWS * parent + r)
        at += rows * link["freedoms"]
    set_block(model, work, j)
