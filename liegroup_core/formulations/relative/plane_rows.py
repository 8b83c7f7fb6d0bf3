# SPDX-License-Identifier: Apache-2.0
"""Rows of the cut joints of a planar mechanism, and their responses: rows.py in the plane.

Of a row (6,) only (omega_z, v_x, v_y) in link axes, columns 2 to 4, act on planar twists.
"""

from liegroup_core.compiling import kernel
from liegroup_core.joints.elements import WORLD
from liegroup_core.lie.vec3 import load3

from .arrays import HINGE, SLIDE


@kernel
def set_right(model, work):
    """Rows of all cut joints, J V to work.slip, and J A minus the bias of J Vdot to work.right.

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
        # w x e keeps a velocity residual e constant in world axes, see absolute/constraints.py.
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
            work.right[r] = child[r, 3] * ax + child[r, 4] * ay


@kernel
def respond(model, work, j):
    """Responses y of the rows of joint j, along its path to the world; sum of y u / D to work.right."""
    joint = model.joints[j]
    a, b, first, rows = joint["parent"], joint["child"], joint["first"], joint["rows"]
    begin, end = model.paths[j, 0], model.paths[j, 1]
    carried, freedoms, n = work.carried, work.freedoms, len(model.parts)
    for r in range(rows):
        at = model.path_places[j] + r
        total = 0.0
        for k in range(begin, end):
            i = model.path_links[k]
            carried[i, 0], carried[i, 1], carried[i, 2] = 0.0, 0.0, 0.0
        for c in range(3):
            carried[b, c] = work.child_jacobian[first + r, 2 + c]
        if a != WORLD:
            for c in range(3):
                carried[a, c] += work.parent_jacobian[first + r, 2 + c]
        for k in range(begin, end):
            i = model.path_links[k]
            link = model.links[i]
            f, group = link["freedom"], link["group"]
            torque, fx, fy = load3(carried, i, 0)
            if group != HINGE and group != SLIDE:
                y = torque
                work.response[at] = y
                share = y * freedoms[f, 6]
                total += share * freedoms[f, 7]
                fx, fy = fx - share * freedoms[f, 1], fy - share * freedoms[f, 2]
                work.response[at + rows] = fx
                share = fx * freedoms[f + 1, 6]
                total += share * freedoms[f + 1, 7]
                fy -= share * freedoms[f + 1, 2]
                work.response[at + 2 * rows] = fy
                total += fy * freedoms[f + 2, 6] * freedoms[f + 2, 7]
                at += 3 * rows
                continue
            y = torque if group == HINGE else fx
            work.response[at] = y
            at += rows
            share = y * freedoms[f, 6]
            total += share * freedoms[f, 7]
            parent = link["parent"]
            if parent != WORLD:
                row = n + i
                c, s = work.stage_pose[row, 0], work.stage_pose[row, 1]
                fx, fy = c * fx - s * fy, s * fx + c * fy
                torque += work.stage_pose[row, 2] * fy - work.stage_pose[row, 3] * fx
                # U of hinges and slides is in the axes of the parent.
                carried[parent, 0] += torque - share * freedoms[f, 0]
                carried[parent, 1] += fx - share * freedoms[f, 1]
                carried[parent, 2] += fy - share * freedoms[f, 2]
        work.right[first + r] += total


# The rows and J V are by-products.
set_rows = set_right
