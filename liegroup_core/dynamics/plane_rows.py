# SPDX-License-Identifier: Apache-2.0
"""Rows of the cut joints of a planar mechanism, and their responses: rows.py in the plane.

Of a row (6,) only (omega_z, v_x, v_y) in link axes, columns 2 to 4, act on planar twists.
"""

from liegroup_core.compiling import kernel
from liegroup_core.joints.elements import WORLD
from liegroup_core.lie.vec3 import load3
from liegroup_core.motion_groups.table import HINGE, SLIDE

from .matrix import set_block
from .plane_couplings import add_coupling


@kernel
def set_rows(model, work):
    """Rows of all cut joints, J V to work.slip, and the bias of J E to work.bias.

    With p and R of the parent in axes of the child, W = X V_a and J_b = (alpha, beta):
        J V = alpha (omega_b - omega_a) + beta . (v_b - W_v) ,   J_a = -J_b X
    """
    child, parent, place, drift = (
        work.child_jacobian,
        work.parent_jacobian,
        work.placed,
        work.drift,
    )
    for j in range(len(model.joints)):
        joint = model.joints[j]
        a, b, first, rows = joint["parent"], joint["child"], joint["first"], joint["rows"]
        w, vx, vy = load3(work.velocities, b, 0)
        c, s = place[b, 0], -place[b, 1]
        if a == WORLD:
            # The world accelerates by -g, see plane_trees.py.
            gx, gy = model.plane_gravity[0, 0], model.plane_gravity[0, 1]
            ax, ay = drift[b, 0] + (c * gx - s * gy), drift[b, 1] + (s * gx + c * gy)
            ew, ex, ey = w, vx, vy
        else:
            dx, dy = place[a, 2] - place[b, 2], place[a, 3] - place[b, 3]
            px, py = c * dx - s * dy, s * dx + c * dy
            ca, sa = place[a, 0], place[a, 1]
            c, s = c * ca - s * sa, s * ca + c * sa
            wa, ux, uy = load3(work.velocities, a, 0)
            wx, wy = c * ux - s * uy + wa * py, s * ux + c * uy - wa * px
            ew, ex, ey = w - wa, vx - wx, vy - wy
            ax = drift[b, 0] - (c * drift[a, 0] - s * drift[a, 1]) + (wa * vy - w * wy)
            ay = drift[b, 1] - (s * drift[a, 0] + c * drift[a, 1]) + (w * wx - wa * vx)
        # w x e keeps a velocity residual e constant in world axes, see rows.py.
        along_x, along_y = 0.0, 0.0
        for r in range(first, first + rows):
            alpha, x, y = load3(child, r, 2)
            slip = alpha * ew + x * ex + y * ey
            work.slip[r] = slip
            along_x, along_y = along_x + slip * x, along_y + slip * y
            if a != WORLD:
                parent[r, 2] = (px * y - py * x) - alpha
                parent[r, 3], parent[r, 4] = -(c * x + s * y), s * x - c * y
        ax, ay = ax - w * along_y, ay + w * along_x
        for r in range(first, first + rows):
            work.bias[r] = -(child[r, 3] * ax + child[r, 4] * ay)


@kernel
def respond(model, work, j):
    """Responses y of the rows of joint j, along its path to the world; their block of W.

    Writes J E of the links without cut joints, the sums of y u / D, to work.right. Two rows at a
    time: few joints have more in a plane.
    """
    joint = model.joints[j]
    a, b, first, rows = joint["parent"], joint["child"], joint["first"], joint["rows"]
    begin, end = model.paths[j, 0], model.paths[j, 1]
    carried, U, n, W = work.carried, work.freedoms, len(model.parts), work.matrix
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
            for c in range(3):
                carried[a, c] += work.parent_jacobian[r, 2 + c]
                if both:
                    carried[a, 3 + c] += work.parent_jacobian[r + 1, 2 + c]
        if model.coupling[j] >= 0:
            add_coupling(model, work, model.coupling[j], 1.0, carried, 1)
        right, other_right = 0.0, 0.0
        square, product, other_square = 0.0, 0.0, 0.0
        for k in range(begin, end):
            i = model.path_links[k]
            group, f, parent = model.links[i]["group"], model.links[i]["freedom"], WORLD
            count = 1 if group == HINGE or group == SLIDE else 3
            if count == 1:
                parent = model.links[i]["parent"]
            for d in range(f, f + count):
                axis = d - f + (1 if group == SLIDE else 0)
                y, z = carried[i, axis], carried[i, 3 + axis]
                work.response[at] = y
                if both:
                    work.response[at + 1] = z
                at += rows
                share, other = y * U[d, 6], z * U[d, 6]
                right, other_right = right + share * U[d, 7], other_right + other * U[d, 7]
                square, product = square + share * y, product + share * z
                other_square += other * z
                if count == 3:
                    for c in range(3):
                        carried[i, c] -= share * U[d, c]
                        carried[i, 3 + c] -= other * U[d, c]
                elif parent != WORLD:
                    _carry(work, i, n + i, 0, share, d, parent)
                    _carry(work, i, n + i, 3, other, d, parent)
        work.right[r] = right
        W[r, r] = square
        if both:
            work.right[r + 1] = other_right
            W[r, r + 1], W[r + 1, r + 1] = product, other_square
    if rows > 2:
        set_block(model, work, j)


@kernel
def _carry(work, i, row, column, share, f, parent):
    """Add a wrench on a hinge or slide i, less that of its freedom f, to the wrench on its parent."""
    carried, pose, U = work.carried, work.stage_pose, work.freedoms
    torque, fx, fy = load3(carried, i, column)
    c, s = pose[row, 0], pose[row, 1]
    fx, fy = c * fx - s * fy, s * fx + c * fy
    # U is in the axes of the parent.
    carried[parent, column] += (torque + (pose[row, 2] * fy - pose[row, 3] * fx)) - share * U[f, 0]
    carried[parent, column + 1] += fx - share * U[f, 1]
    carried[parent, column + 2] += fy - share * U[f, 2]
