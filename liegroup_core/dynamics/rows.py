# SPDX-License-Identifier: Apache-2.0
"""Rows of the cut joints, and their responses in the degrees of freedom of the tree; see loops.py.

A lower pair constrains the components A (k x 6) of the relative twist of its two frames. Let
C_ba = C_b^-1 C_a, let W = Ad(C_ba) V_a be the twist of the parent in the axes of the child, and let
F_b be the frame of the joint in the child. With the constant J_b = A Ad(F_b^-1) the equations are
    velocity      J_b (V_b - W) = 0     so  J_a = -J_b Ad(C_ba)
    acceleration  J Vdot = -J_b [V_b, W] - J_b (0, omega_b x e)
because [V_b - W, W] = [V_b, W]. e is the velocity residual at the origin of the joint; the last term
keeps it constant in world axes, as g'' = 0, (6.29), does. For a joint to ground W = 0 and only J_b
remains: SE(3) satisfies such joints exactly. Elements other than pairs (joints/elements.py) have a J_b
that depends on the pose, and the bias has the additional term -Jdot_b (V_b - W).

At the stages of a step joints have small gaps. Whatever the gap, the force of a ball joint acts on each link
at the link's own joint point. At the other link's point it would have a moment about the axis of a rod
between two balls, which has almost no inertia about this axis and would spin. So rows and bias of a ball
joint are those of the accelerations of the two points, in world axes. With an empty tree this holds for all
joints, as in the chapter.
"""

from liegroup_core.compiling import kernel
from liegroup_core.joints.elements import WORLD
from liegroup_core.lie.se2 import se2_wrench
from liegroup_core.lie.vec3 import add_to3, axpy3, load3
from liegroup_core.mechanism.arrays import LARGEST_ROWS
from liegroup_core.motion_groups.table import leave

from .algebra import add_row, add_to, choice, column, load, product, relative, sub, wrench_at, zero
from .couplings import add_coupling
from .links import row_bracket, seen_from, set_variable_row, store_parent_row
from .matrix import set_block


@kernel
def set_rows(model, work):
    """Set the rows of all cut joints; write J V to work.slip, and the bias of J Vdot to work.bias."""
    for j in range(len(model.cuts)):
        cut = model.cuts[j]
        a, b, first, rows = cut["parent"], cut["child"], cut["first"], cut["rows"]
        V = load(model, work.velocities, b)
        X, W = seen_from(model, work, cut, a, b)
        error = sub(model, V, W)
        rate = set_variable_row(model, work, cut, X, error)
        e = zero(model)
        for r in range(first, first + rows):
            slip = product(model, 0.0, work.child_jacobian, r, error)
            work.slip[r] = slip
            e = add_row(model, e, slip, work.child_jacobian, r)
            if a != WORLD:
                store_parent_row(model, work, X, r)
        bracket = row_bracket(model, work, cut, a, b, X, V, W, e)
        for r in range(first, first + rows):
            work.bias[r] = -rate - product(model, 0.0, work.child_jacobian, r, bracket)


@kernel
def _respond_in_space(model, work, j):
    """Responses y of the rows of joint j, along its path to the world, and their block of W."""
    cut = model.cuts[j]
    a, b, first, rows = cut["parent"], cut["child"], cut["first"], cut["rows"]
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
        link = model.links[i]
        # The rows are independent: a processor works on several at once.
        for r in range(rows):
            # (w, v) stay in registers: a fifth faster.
            w, v = load(model, carried, LARGEST_ROWS * i + r)
            F = leave(link, work, link["freedom"], at + r, rows, w, v)
            if link["parent"] != WORLD:
                F = wrench_at(model, relative(model, work, i), F)
                add_to(model, F, carried, LARGEST_ROWS * link["parent"] + r)
        at += rows * link["freedoms"]
    set_block(model, work, j)


@kernel
def _respond_in_plane(model, work, j):
    """The same in a plane, two rows at a time: few joints have more.

    Writes J E without cut joints, the sums of y u / D, to work.right.
    """
    cut = model.cuts[j]
    a, b, first, rows = cut["parent"], cut["child"], cut["first"], cut["rows"]
    begin, end = model.paths[j, 0], model.paths[j, 1]
    carried, U, W = work.carried, work.freedoms, work.matrix
    for start in range(0, rows, 2):
        r, both = first + start, start + 1 < rows
        at = model.path_places[j] + start
        for k in range(begin, end):
            for c in range(6):
                carried[model.path_links[k], c] = 0.0
        for c in range(3):
            carried[b, c] = work.child_jacobian[r, 2 + c]
            if both:
                carried[b, 3 + c] = work.child_jacobian[r + 1, 2 + c]
            if a != WORLD:
                carried[a, c] += work.parent_jacobian[r, 2 + c]
                if both:
                    carried[a, 3 + c] += work.parent_jacobian[r + 1, 2 + c]
        if model.coupling[j] >= 0:
            add_coupling(model, work, model.coupling[j], 1.0, carried, 1)
        right, other_right = 0.0, 0.0
        square, product, other_square = 0.0, 0.0, 0.0
        for k in range(begin, end):
            i = model.path_links[k]
            link = model.plane_links[i]
            f, axis, whole = link["freedom"], column(model, link, 0), link["freedoms"] == 3
            for d in range(f, f + link["freedoms"]):
                y, z = carried[i, axis + d - f], carried[i, 3 + axis + d - f]
                work.response[at] = y
                if both:
                    work.response[at + 1] = z
                at += rows
                share, other = y * U[d, 6], z * U[d, 6]
                right, other_right = right + share * U[d, 7], other_right + other * U[d, 7]
                square, product = square + share * y, product + share * z
                other_square += other * z
                if whole:
                    for c in range(3):
                        carried[i, c] -= share * U[d, c]
                        carried[i, 3 + c] -= other * U[d, c]
                elif link["parent"] != WORLD:
                    # U is in the axes of the parent.
                    X, to, u = relative(model, work, i), link["parent"], load3(U, d, 0)
                    F = axpy3(-share, u, se2_wrench(X, load3(carried, i, 0)))
                    add_to3(F, carried, to, 0)
                    F = axpy3(-other, u, se2_wrench(X, load3(carried, i, 3)))
                    add_to3(F, carried, to, 3)
        work.right[r] = right
        W[r, r] = square
        if both:
            work.right[r + 1] = other_right
            W[r, r + 1], W[r + 1, r + 1] = product, other_square
    if rows > 2:
        set_block(model, work, j)


respond = choice("respond", _respond_in_space, _respond_in_plane)
