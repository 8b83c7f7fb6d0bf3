# SPDX-License-Identifier: Apache-2.0
"""Accelerations of planar trees in O(n) by the articulated-body algorithm.

Each body has one revolute, prismatic or fixed joint to its parent. Let X = Ad(C_ba), let s be the
free direction of the joint in the axes of its child b, and let c be the part of the relative
acceleration that depends on velocities only: V'_b = X V'_a + c + s q''. From the leaves to the
ground, each joint adds the inertia and wrench of its articulated body to its parent,
    I_a += X^T (I - U U^T / D) X ,   Q_a += X^T (Q - I c - U u / D)
    U = I s ,   D = s . U ,   u = s . (Q - I c)
From the ground to the leaves q'' = (u - U . X V'_a) / D. This is the elimination of K (dynamics.py)
with a joint and its child combined: one division per body instead of five. The subtraction loses as
many digits as neighbouring masses differ by. Mechanisms with large mass ratios are solved with K.

Source: Featherstone, Rigid Body Dynamics Algorithms, section 7.3.
"""

import numpy as np

from liegroup_core.compiling import kernel
from liegroup_core.joints.elements import WORLD

LINK = np.dtype(
    [  # joint of a tree; joints are ordered from the leaves to the ground
        ("parent", "i8"),
        ("child", "i8"),
        ("free", "f8", (3,)),  # s: free (omega, v_1, v_2) of the child; 0: fixed joint
        ("point", "f8", (6,)),  # (2, 3) maps V_b - W to the velocity residual at the joint
    ],
    align=True,
)

# Columns of PlanarWork.links: I (ww, w1, w2, 11, 12, 22), U, 1 / D, u, rotation and position of the
# parent relative to the child, linear part of c (its angular part is 0).
COLUMNS = 17


def tree_links(n, ends, jacobians):
    """(n,) of LINK; empty if the joints are not a tree of revolute, prismatic and fixed joints.

    n         : number of bodies
    ends      : (parent, child) of each joint
    jacobians : rows (k, 3) of each joint for its child
    """
    no_links = np.zeros(0, dtype=LINK)
    if sorted(child for _, child in ends) != list(range(n)):
        return no_links
    if not jacobians or any(len(jacobian) < 2 for jacobian in jacobians):
        return no_links
    pending = dict(
        (child, (parent, jacobian)) for (parent, child), jacobian in zip(ends, jacobians)
    )
    links, reached = [], {WORLD}
    while pending:
        ready = [child for child, (parent, _) in pending.items() if parent in reached]
        if not ready:
            return no_links
        for child in ready:
            parent, jacobian = pending.pop(child)
            free = np.cross(jacobian[0], jacobian[1]) if len(jacobian) == 2 else np.zeros(3)
            size = np.abs(free).max(initial=0.0) or 1.0
            links.append((parent, child, free / size, (jacobian[:, 1:].T @ jacobian).ravel()))
        reached.update(ready)
    return np.array(links[::-1], dtype=LINK)


@kernel
def _gather(model, work, pose, twist):
    """Compute articulated inertias and wrenches, from the leaves to the ground."""
    links, rows, force = model.links, work.links, work.solution
    for i in range(len(model.bodies)):
        inertia, mass = model.bodies[i]["inertia"], model.bodies[i]["mass"]
        rows[i, 0], rows[i, 1], rows[i, 2] = inertia, 0.0, 0.0
        rows[i, 3], rows[i, 4], rows[i, 5] = mass, 0.0, mass
    for k in range(len(links)):
        a, b = links[k]["parent"], links[k]["child"]
        w, vx, vy = twist[b, 0], twist[b, 1], twist[b, 2]
        c, s, px, py = 1.0, 0.0, 0.0, 0.0
        wa, wx, wy = 0.0, 0.0, 0.0
        if a != WORLD:
            cb, sb, ca, sa = pose[b, 0], pose[b, 1], pose[a, 0], pose[a, 1]
            c, s = cb * ca + sb * sa, cb * sa - sb * ca
            dx, dy = pose[a, 2] - pose[b, 2], pose[a, 3] - pose[b, 3]
            px, py = cb * dx + sb * dy, cb * dy - sb * dx
            wa, ax, ay = twist[a, 0], twist[a, 1], twist[a, 2]
            wx, wy = c * ax - s * ay + wa * py, s * ax + c * ay - wa * px
        ew, ex, ey = w - wa, vx - wx, vy - wy
        point = links[k]["point"]
        slip_x = point[0] * ew + point[1] * ex + point[2] * ey
        slip_y = point[3] * ew + point[4] * ex + point[5] * ey
        bx, by = w * (slip_y + wy) - wa * vy, wa * vx - w * (slip_x + wx)

        ww, wX, wY = rows[b, 0], rows[b, 1], rows[b, 2]
        XX, XY, YY = rows[b, 3], rows[b, 4], rows[b, 5]
        at = 3 * b
        q0 = force[at] - (wX * bx + wY * by)
        q1 = force[at + 1] - (XX * bx + XY * by)
        q2 = force[at + 2] - (XY * bx + YY * by)
        free = links[k]["free"]
        f0, f1, f2 = free[0], free[1], free[2]
        u0, u1, u2 = (
            ww * f0 + wX * f1 + wY * f2,
            wX * f0 + XX * f1 + XY * f2,
            wY * f0 + XY * f1 + YY * f2,
        )
        d = f0 * u0 + f1 * u1 + f2 * u2
        inverse = 1.0 / d if d > 0.0 else 0.0
        u = f0 * q0 + f1 * q1 + f2 * q2
        rows[b, 6], rows[b, 7], rows[b, 8] = u0, u1, u2
        rows[b, 9], rows[b, 10] = inverse, u
        rows[b, 11], rows[b, 12], rows[b, 13], rows[b, 14] = c, s, px, py
        rows[b, 15], rows[b, 16] = bx, by
        if a == WORLD:
            continue
        d0, d1, d2 = u0 * inverse, u1 * inverse, u2 * inverse
        ww, wX, wY = ww - d0 * u0, wX - d0 * u1, wY - d0 * u2
        XX, XY, YY = XX - d1 * u1, XY - d1 * u2, YY - d2 * u2
        q0, q1, q2 = q0 - d0 * u, q1 - d1 * u, q2 - d2 * u
        # I X, column by column: X takes (omega, v) to (omega, R v + omega (p_y, -p_x))
        m00, m10, m20 = (ww + py * wX - px * wY, wX + py * XX - px * XY, wY + py * XY - px * YY)
        m01, m11, m21 = c * wX + s * wY, c * XX + s * XY, c * XY + s * YY
        m02, m12, m22 = c * wY - s * wX, c * XY - s * XX, c * YY - s * XY
        rows[a, 0] += m00 + py * m10 - px * m20
        rows[a, 1] += m01 + py * m11 - px * m21
        rows[a, 2] += m02 + py * m12 - px * m22
        rows[a, 3] += c * m11 + s * m21
        rows[a, 4] += c * m12 + s * m22
        rows[a, 5] += c * m22 - s * m12
        force[3 * a] += q0 + py * q1 - px * q2
        force[3 * a + 1] += c * q1 + s * q2
        force[3 * a + 2] += c * q2 - s * q1


@kernel
def solve_tree(model, work, pose, twist):
    """Replace the wrenches in work.solution (3 n,) by the accelerations of all bodies."""
    _gather(model, work, pose, twist)
    links, rows, x = model.links, work.links, work.solution
    for k in range(len(links) - 1, -1, -1):
        a, b = links[k]["parent"], links[k]["child"]
        w, vx, vy = 0.0, 0.0, 0.0
        if a != WORLD:
            c, s, px, py = rows[b, 11], rows[b, 12], rows[b, 13], rows[b, 14]
            w, ax, ay = x[3 * a], x[3 * a + 1], x[3 * a + 2]
            vx, vy = c * ax - s * ay + w * py, s * ax + c * ay - w * px
        q = rows[b, 9] * (rows[b, 10] - (rows[b, 6] * w + rows[b, 7] * vx + rows[b, 8] * vy))
        free = links[k]["free"]
        x[3 * b] = w + free[0] * q
        x[3 * b + 1] = vx + rows[b, 15] + free[1] * q
        x[3 * b + 2] = vy + rows[b, 16] + free[2] * q
