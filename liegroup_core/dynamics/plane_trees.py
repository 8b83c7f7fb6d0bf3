# SPDX-License-Identifier: Apache-2.0
"""Accelerations of planar trees in O(n): trees.py with three numbers per twist.

A twist is (omega, v_x, v_y) in link axes. With the pose (c, s, x, y) of a link in its parent,
    V_b = X V_a + S qdot ,   X (omega, v) = (omega, R^T (v + omega (-y, x)))
Let A be the acceleration of a link, less that of gravity, if no freedom accelerates:
    A_b = X A_a + [V_b, S qdot] ,   A_world = -g
In the plane it has no angular part. The bias forces include I A, and the sweeps find the rest:
    Vdot_b = A_b + E_b ,   E_b = X E_a + S qddot ,   E_world = 0
Nothing depends on gravity or velocities on the way back but the bias forces.

Hinges and slides store U in the axes of their parents, U X: qddot = (u - U X . E_a) / D follows from
the parent at once. A link with all freedoms of the plane adds nothing to its parent.
"""

from liegroup_core.compiling import kernel, subroutine
from liegroup_core.joints.elements import WORLD
from liegroup_core.lie.vec3 import dot3, load3, matrix3, store3, vector3
from liegroup_core.motion_groups.table import HINGE, SLIDE


@kernel
def move_links(model, work):
    """Velocities and A of all links at the stage; own inertias and bias forces.

    Writes work.velocities, drift (A) and inertia; to force and applied the bias forces without
    applied wrenches.
    """
    n = len(model.parts)
    pose, twist, velocities, drift = work.stage_pose, work.stage_twist, work.velocities, work.drift
    gx, gy = model.plane_gravity[0, 0], model.plane_gravity[0, 1]
    for b in range(len(model.links)):
        link = model.links[b]
        a, group, row = link["parent"], link["group"], n + b
        c, s = pose[row, 0], pose[row, 1]
        q = twist[row, 0]
        if a == WORLD:
            w, vx, vy = 0.0, 0.0, 0.0
            dx, dy = -gx, -gy
        else:
            w, ux, uy = load3(velocities, a, 0)
            ux, uy = ux - w * pose[row, 3], uy + w * pose[row, 2]
            vx, vy = c * ux + s * uy, c * uy - s * ux
            dx, dy = drift[a, 0], drift[a, 1]
        ax, ay = c * dx + s * dy, c * dy - s * dx
        if group == HINGE:
            w += q
            ax, ay = ax + q * vy, ay - q * vx
        elif group == SLIDE:
            vx += q
            ay += w * q
        else:
            sx, sy = twist[row, 1], twist[row, 2]
            w, vx, vy = w + q, vx + sx, vy + sy
            ax, ay = ax + (q * vy - w * sy), ay + (w * sx - q * vx)
        store3((w, vx, vy), velocities, b, 0)
        drift[b, 0], drift[b, 1] = ax, ay
        mass, mx, my = link["mass"], link["moment_x"], link["moment_y"]
        px, py = mass * vx - w * my, mass * vy + w * mx
        torque = (vx * py - vy * px) + (mx * ay - my * ax)
        fx, fy = mass * ax - w * py, mass * ay + w * px
        store3((torque, fx, fy), work.force, b, 0)
        store3((torque, fx, fy), work.applied, b, 0)
        inertia = work.inertia
        inertia[b, 0], inertia[b, 1], inertia[b, 2] = link["inertia"], -my, mx
        inertia[b, 3], inertia[b, 4], inertia[b, 5] = mass, 0.0, mass


@kernel
def apply_wrenches(model, work):
    """Subtract the wrenches on the bodies, work.wrench, from the bias forces of the links."""
    for i in range(len(model.parts)):
        part = model.parts[i]
        b = part["link"]
        if b == WORLD:
            continue
        m, (px, py, _) = matrix3(part["rotation"]), vector3(part["point"])
        torque, force = load3(work.wrench, i, 0), load3(work.wrench, i, 3)
        fx, fy = dot3((m[0], m[1], m[2]), force), dot3((m[3], m[4], m[5]), force)
        moment = dot3((m[6], m[7], m[8]), torque) + (px * fy - py * fx)
        for out in (work.force, work.applied):
            out[b, 0] -= moment
            out[b, 1] -= fx
            out[b, 2] -= fy


@kernel
def _turn_mass(c, s, xx, xy, yy):
    """R M R^T of a symmetric (2, 2) matrix."""
    m0, m1 = c * xx - s * xy, c * xy - s * yy
    n0, n1 = s * xx + c * xy, s * xy + c * yy
    return m0 * c - m1 * s, n0 * c - n1 * s, n0 * s + n1 * c


@kernel
def _store_freedom(freedoms, f, U0, Ux, Uy, inverse, u):
    """Store U, 1 / D and u of a freedom."""
    freedoms[f, 0], freedoms[f, 1], freedoms[f, 2] = U0, Ux, Uy
    freedoms[f, 6], freedoms[f, 7] = inverse, u


@kernel
def _inverse(D):
    """1 / D; a freedom without inertia does not accelerate."""
    return 1.0 / D if D > 0.0 else 0.0


@kernel
def _eliminate_plane(work, b, f):
    """Eliminate the three freedoms of a link; U in its own axes."""
    ww, wx, wy = load3(work.inertia, b, 0)
    xx, xy, yy = load3(work.inertia, b, 3)
    torque, fx, fy = load3(work.force, b, 0)
    inverse = _inverse(ww)
    u = -torque
    _store_freedom(work.freedoms, f, ww, wx, wy, inverse, u)
    share = inverse * wx
    xx, xy, fx = xx - share * wx, xy - share * wy, fx + share * u
    share = inverse * wy
    yy, fy = yy - share * wy, fy + share * u
    inverse = _inverse(xx)
    u = -fx
    _store_freedom(work.freedoms, f + 1, 0.0, xx, xy, inverse, u)
    share = inverse * xy
    yy, fy = yy - share * xy, fy + share * u
    _store_freedom(work.freedoms, f + 2, 0.0, 0.0, yy, _inverse(yy), -fy)


@kernel
def _add_at(work, a, x, y, ww, wx, wy, xx, xy, yy, torque, fx, fy):
    """Add inertia and force of a link at (x, y), in the axes of its parent a, to those of a."""
    inertia, force = work.inertia, work.force
    # M times the velocity of the link if the parent turns
    bx, by = xy * x - xx * y, yy * x - xy * y
    inertia[a, 0] += ww + (x * (by + 2.0 * wy) - y * (bx + 2.0 * wx))
    inertia[a, 1] += wx + bx
    inertia[a, 2] += wy + by
    inertia[a, 3] += xx
    inertia[a, 4] += xy
    inertia[a, 5] += yy
    force[a, 0] += torque + (x * fy - y * fx)
    force[a, 1] += fx
    force[a, 2] += fy


@subroutine
def _pass_whole(work, row, b, a):
    """Add inertia and bias force of a link whose freedom is held to those of its parent."""
    inertia, force, pose = work.inertia, work.force, work.stage_pose
    c, s, x, y = pose[row, 0], pose[row, 1], pose[row, 2], pose[row, 3]
    ww, wx, wy = load3(inertia, b, 0)
    xx, xy, yy = load3(inertia, b, 3)
    torque, fx, fy = load3(force, b, 0)
    wx, wy = c * wx - s * wy, s * wx + c * wy
    xx, xy, yy = _turn_mass(c, s, xx, xy, yy)
    fx, fy = c * fx - s * fy, s * fx + c * fy
    _add_at(work, a, x, y, ww, wx, wy, xx, xy, yy, torque, fx, fy)
    return 0


@kernel
def gather(model, work):
    """Articulated inertias and bias forces, from the leaves to the world."""
    n = len(model.parts)
    pose, inertia, force = work.stage_pose, work.inertia, work.force
    switches = len(model.switches) > 0
    for b in range(len(model.links) - 1, -1, -1):
        link = model.links[b]
        group, f, a, row = link["group"], link["freedom"], link["parent"], n + b
        if group != HINGE and group != SLIDE:
            _eliminate_plane(work, b, f)
            continue
        ww, wx, wy = load3(inertia, b, 0)
        torque, fx, fy = load3(force, b, 0)
        D, u = ww, -torque
        if group == SLIDE:
            D, u = inertia[b, 3], -fx
        inverse = _inverse(D)
        if switches and work.held[f] != 0.0:
            _store_freedom(work.freedoms, f, 0.0, 0.0, 0.0, 0.0, 0.0)
            if a != WORLD:
                _pass_whole(work, row, b, a)
            continue
        if a == WORLD:
            _store_freedom(work.freedoms, f, 0.0, 0.0, 0.0, inverse, u)
            continue
        c, s, x, y = pose[row, 0], pose[row, 1], pose[row, 2], pose[row, 3]
        xx, xy, yy = load3(inertia, b, 3)
        share = inverse * u
        if group == HINGE:
            # Without rotation only a mass matrix is left, and no torque: M - U U^T / D at the
            # place of the link. The division is last: the next link waits for it.
            Ux, Uy = c * wx - s * wy, s * wx + c * wy
            arm = x * Uy - y * Ux
            # M times the velocity of the link if the parent turns
            gx, gy = s * x - c * y, s * y + c * x
            hx, hy = xx * gx + xy * gy, xy * gx + yy * gy
            fx, fy = c * fx - s * fy, s * fx + c * fy
            xx, xy, yy = _turn_mass(c, s, xx, xy, yy)
            inertia[a, 0] += (gx * hx + gy * hy) - inverse * (arm * arm)
            inertia[a, 1] += (c * hx - s * hy) - inverse * (arm * Ux)
            inertia[a, 2] += (s * hx + c * hy) - inverse * (arm * Uy)
            inertia[a, 3] += xx - inverse * (Ux * Ux)
            inertia[a, 4] += xy - inverse * (Ux * Uy)
            inertia[a, 5] += yy - inverse * (Uy * Uy)
            force[a, 0] += (x * fy - y * fx) + share * arm
            force[a, 1] += fx + share * Ux
            force[a, 2] += fy + share * Uy
            _store_freedom(work.freedoms, f, ww + arm, Ux, Uy, inverse, u)
            continue
        Ux, Uy = c * xx - s * xy, s * xx + c * xy
        _store_freedom(work.freedoms, f, wx + (x * Uy - y * Ux), Ux, Uy, inverse, u)
        ww, wy, torque = ww - inverse * wx * wx, wy - inverse * wx * xy, torque + share * wx
        yy, fx, fy = yy - inverse * xy * xy, 0.0, fy + share * xy
        wx, wy = -s * wy, c * wy
        xx, xy, yy = s * s * yy, -c * s * yy, c * c * yy
        fx, fy = c * fx - s * fy, s * fx + c * fy
        _add_at(work, a, x, y, ww, wx, wy, xx, xy, yy, torque, fx, fy)


@subroutine
def spread(model, work):
    """Accelerations of all freedoms to work.acceleration, E of the links to work.moved."""
    n = len(model.parts)
    pose, moved, U, qddot = work.stage_pose, work.moved, work.freedoms, work.acceleration
    for b in range(len(model.links)):
        link = model.links[b]
        group, f, a, row = link["group"], link["freedom"], link["parent"], n + b
        w, ax, ay = 0.0, 0.0, 0.0
        vx, vy = 0.0, 0.0
        if a != WORLD:
            w, ax, ay = load3(moved, a, 0)
            c, s = pose[row, 0], pose[row, 1]
            ux, uy = ax - w * pose[row, 3], ay + w * pose[row, 2]
            vx, vy = c * ux + s * uy, c * uy - s * ux
        if group == HINGE or group == SLIDE:
            rate = U[f, 6] * (U[f, 7] - (U[f, 0] * w + U[f, 1] * ax + U[f, 2] * ay))
            qddot[f, 0] = rate
            if group == HINGE:
                w += rate
            else:
                vx += rate
        else:
            y = U[f + 2, 6] * U[f + 2, 7]
            x = U[f + 1, 6] * (U[f + 1, 7] - U[f + 1, 2] * y)
            turn = U[f, 6] * (U[f, 7] - (U[f, 1] * x + U[f, 2] * y))
            qddot[f, 0], qddot[f + 1, 0], qddot[f + 2, 0] = turn - w, x - vx, y - vy
            w, vx, vy = turn, x, y
        store3((w, vx, vy), moved, b, 0)
    return 0


# Neither gravity nor velocities act on the way back.
spread_response = spread
