# SPDX-License-Identifier: Apache-2.0
"""Coordinates of links: from poses and twists of the bodies, and back.

A state that is set has poses and twists of the bodies: the coordinates follow from them once. Poses
that violate a joint of the tree are moved onto it, the parents first. From then on the coordinates
are the state, and the bodies follow from them. To find them again in every step would add the
round-off of poses to them, always to the same side: 1e-15 in a step of a mechanism of 10 m.
"""

import math

from liegroup_core.compiling import kernel, shared
from liegroup_core.joints.elements import WORLD
from liegroup_core.lie.coefficients import turn_coefficients
from liegroup_core.lie.se3 import se3_Ad_inverse, se3_compose, se3_exp
from liegroup_core.lie.so3 import so3_exp, so3_nearest
from liegroup_core.lie.vec3 import (
    ZERO3,
    add3,
    cross3,
    dot3,
    load3,
    load9,
    matmul3,
    matrix3,
    matvec3,
    store3,
    store9,
    sub3,
    tmatmul3,
    tmatvec3,
    transpose3,
    vector3,
)

from .arrays import AFTER_CROSS, BALL, CROSS, CYLINDER, FREE, HINGE, OWN, PLANE, SCREW, SLIDE


@kernel
def turned(m, c, s):
    """m Rz for a rotation about z with cosine c and sine s."""
    return (
        c * m[0] + s * m[1],
        c * m[1] - s * m[0],
        m[2],
        c * m[3] + s * m[4],
        c * m[4] - s * m[3],
        m[5],
        c * m[6] + s * m[7],
        c * m[7] - s * m[6],
        m[8],
    )


@kernel
def relative_pose(link, coordinates, row):
    """Pose T X of a link in its parent link: rotation, position in m."""
    rotation, point = matrix3(link["rotation"]), vector3(link["point"])
    group = link["group"]
    if group >= BALL:
        rot = matmul3(rotation, load9(coordinates, row, 0))
        if group == FREE:
            point = add3(point, matvec3(rotation, load3(coordinates, row, 9)))
        return rot, point
    if group != HINGE:
        point = add3(point, matvec3(rotation, load3(coordinates, row, 2)))
    return turned(rotation, coordinates[row, 0], coordinates[row, 1]), point


@kernel
def rate_twist(link, rates, row):
    """S qdot of a link: angular and linear part."""
    group = link["group"]
    first = rates[row, 0]
    if group == HINGE:
        return (0.0, 0.0, first), ZERO3
    if group == BALL:
        return load3(rates, row, 0), ZERO3
    if group == SLIDE:
        return ZERO3, (0.0, 0.0, first)
    if group == SCREW:
        return (0.0, 0.0, first), (0.0, 0.0, link["pitch"] * first)
    if group == CYLINDER:
        return (0.0, 0.0, first), (0.0, 0.0, rates[row, 1])
    if group == PLANE:
        return (0.0, 0.0, first), (rates[row, 1], rates[row, 2], 0.0)
    return load3(rates, row, 0), load3(rates, row, 3)


@kernel
def displace(model, b, coordinates, screws, at, out):
    """Write X exp(Psi) of link b to its row of `out`.

    Psi : first column of `screws`, from row `at` on
    returns the squared rotation angle, rad^2
    """
    link, row = model.bodies[b], len(model.parts) + b
    group = link["group"]
    psi = screws[at, 0]
    if group >= BALL:
        xi = (psi, screws[at + 1, 0], screws[at + 2, 0])
        rot = load9(coordinates, row, 0)
        if group == BALL:
            store9(matmul3(rot, so3_exp(xi)), out, row, 0)
        else:
            eta = (screws[at + 3, 0], screws[at + 4, 0], screws[at + 5, 0])
            turn, shift = se3_exp(xi, eta)
            rot, p = se3_compose(rot, load3(coordinates, row, 9), turn, shift)
            store9(rot, out, row, 0)
            store3(p, out, row, 9)
        return dot3(xi, xi)
    if group == SLIDE:
        out[row, 0], out[row, 1] = 1.0, 0.0
        out[row, 4] = coordinates[row, 4] + psi
        return 0.0
    sinc, versinc = turn_coefficients(psi * psi)
    c, s = 1.0 - psi * psi * versinc, psi * sinc
    c0, s0 = coordinates[row, 0], coordinates[row, 1]
    if group == SCREW:
        out[row, 4] = coordinates[row, 4] + link["pitch"] * psi
    elif group == CYLINDER:
        out[row, 4] = coordinates[row, 4] + screws[at + 1, 0]
    elif group == PLANE:
        # dexp_psi of the translation, in the axes of the start
        x, y = screws[at + 1, 0], screws[at + 2, 0]
        q = psi * versinc
        x, y = sinc * x - q * y, sinc * y + q * x
        x0, y0 = coordinates[row, 2], coordinates[row, 3]
        out[row, 2], out[row, 3] = x0 + (c0 * x - s0 * y), y0 + (s0 * x + c0 * y)
    out[row, 0], out[row, 1] = c0 * c - s0 * s, s0 * c + c0 * s
    return psi * psi


@kernel
def _along_screw(c, s, z, pitch):
    """Displacement of a screw: that of its angle, in the turn nearest to a displacement z."""
    lead = 2.0 * math.pi * pitch
    turn = math.atan2(s, c)
    ahead = z - pitch * turn
    if abs(ahead) < 1e15 * abs(lead):
        turn += 2.0 * math.pi * math.floor(ahead / lead + 0.5)
    return pitch * turn


@kernel
def normalise(model, b, coordinates):
    """Remove the round-off by which products of rotations, and sums of a screw, leave the group.

    b : link
    """
    row = len(model.parts) + b
    if model.bodies[b]["group"] >= BALL:
        store9(so3_nearest(load9(coordinates, row, 0)), coordinates, row, 0)
    else:
        c, s = coordinates[row, 0], coordinates[row, 1]
        scale = 1.5 - 0.5 * (c * c + s * s)
        coordinates[row, 0], coordinates[row, 1] = scale * c, scale * s
        if model.bodies[b]["group"] == SCREW:
            pitch = model.bodies[b]["pitch"]
            coordinates[row, 4] = _along_screw(c, s, coordinates[row, 4], pitch)


@kernel
def _store_rates(link, w, v, rates_out, row):
    """Write qdot of a link for a relative twist (w, v) in its axes; a CROSS: see `coordinates`."""
    group = link["group"]
    if group == SLIDE:
        rates_out[row, 0] = v[2]
        return
    if group >= BALL:
        store3(w, rates_out, row, 0)
        if group == FREE:
            store3(v, rates_out, row, 3)
        return
    rates_out[row, 0] = w[2]
    if group == CYLINDER:
        rates_out[row, 1] = v[2]
    elif group == PLANE:
        rates_out[row, 1], rates_out[row, 2] = v[0], v[1]


@kernel
def _body_of_link(link, pose, twist, world_out, velocities_out, b):
    """Write pose in the world and twist of link b from those of the body that represents it."""
    rotation, point = matrix3(link["body_rotation"]), vector3(link["body_point"])
    i = link["body"]
    rot = matmul3(load9(pose, i, 0), transpose3(rotation))
    store9(rot, world_out, b, 0)
    store3(sub3(load3(pose, i, 9), matvec3(rot, point)), world_out, b, 9)
    w = matvec3(rotation, load3(twist, i, 0))
    store3(w, velocities_out, b, 0)
    store3(add3(matvec3(rotation, load3(twist, i, 3)), cross3(point, w)), velocities_out, b, 3)


@kernel
def nearest_turn(c, s):
    """Cosine and sine of an angle, from multiples of them.

    R00 + R11 and R10 - R01 are those of the rotation about z nearest to R. Upside down no angle is
    nearest: the joint does not allow such a pose.
    """
    length = math.sqrt(c * c + s * s)
    return (c / length, s / length) if length > 0.0 else (1.0, 0.0)


@shared
def coordinates(model, work, pose, twist):
    """Write the rows of the links in pose and twist (n + L, ...) from the rows of the bodies.

    Uses work.world and work.velocities as scratch memory.
    """
    n = len(model.parts)
    world, velocities = work.world, work.velocities
    for b in range(len(model.bodies)):
        link = model.bodies[b]
        a = link["parent"]
        place = link["coordinates"]
        row = n + b
        rot_a, r_a, w_a, v_a = matrix3(link["rotation"]), vector3(link["point"]), ZERO3, ZERO3
        if link["group"] == HINGE and place == OWN:
            _body_of_link(link, pose, twist, world, velocities, b)
            rot = load9(world, b, 0)
            x_b, y_b = (rot[0], rot[3], rot[6]), (rot[1], rot[4], rot[7])
            x_a, y_a = (rot_a[0], rot_a[3], rot_a[6]), (rot_a[1], rot_a[4], rot_a[7])
            twist[row, 0] = velocities[b, 2]
            if a != WORLD:
                rot = load9(world, a, 0)
                x_a, y_a = matvec3(rot, x_a), matvec3(rot, y_a)
                twist[row, 0] -= dot3((rot_a[2], rot_a[5], rot_a[8]), load3(velocities, a, 0))
            pose[row, 0], pose[row, 1] = nearest_turn(
                dot3(x_a, x_b) + dot3(y_a, y_b), dot3(y_a, x_b) - dot3(x_a, y_b)
            )
            continue
        if a != WORLD:
            rot_a, r_a = se3_compose(load9(world, a, 0), load3(world, a, 9), rot_a, r_a)
            w_a, v_a = load3(velocities, a, 0), load3(velocities, a, 3)
        if place == CROSS:
            # The parent's rotation to the link after the cross is T1 Rz(first) T2 Rz(second).
            after = model.bodies[b + 1]
            _body_of_link(after, pose, twist, world, velocities, b + 1)
            rot_2 = matrix3(after["rotation"])
            rot = matmul3(tmatmul3(rot_a, load9(world, b + 1, 0)), transpose3(rot_2))
            # Rz(first) T2 Rz(second) T2^T leaves the second axis d = T2 e_z at Rz(first) d.
            dx, dy = rot_2[2], rot_2[5]
            x, y, _ = matvec3(rot, (dx, dy, 0.0))
            c, s = dx * x + dy * y, dx * y - dy * x
            pose[row, 0], pose[row, 1] = nearest_turn(c, s)
            rot, _ = relative_pose(link, pose, row)
            if a != WORLD:
                rot = matmul3(load9(world, a, 0), rot)
            store9(rot, world, b, 0)
            store3(r_a, world, b, 9)
            # The second axis does not rotate about the first: its rate is the component along it.
            w_rel = sub3(
                matvec3(load9(world, b + 1, 0), load3(velocities, b + 1, 0)),
                matvec3(load9(world, a, 0), w_a) if a != WORLD else ZERO3,
            )
            rate = dot3((rot[2], rot[5], rot[8]), w_rel)
            twist[row, 0] = rate
            rel, p = relative_pose(link, pose, row)
            w, v = se3_Ad_inverse(rel, p, w_a, v_a)
            store3((w[0], w[1], w[2] + rate), velocities, b, 0)
            store3(v, velocities, b, 3)
            continue
        if place != AFTER_CROSS:
            _body_of_link(link, pose, twist, world, velocities, b)
        rot = tmatmul3(rot_a, load9(world, b, 0))
        group = link["group"]
        p = ZERO3
        if group != HINGE and group != BALL:
            p = tmatvec3(rot_a, sub3(load3(world, b, 9), r_a))
        if group >= BALL:
            store9(so3_nearest(rot), pose, row, 0)
            store3(p, pose, row, 9)
        else:
            c, s = nearest_turn(rot[0] + rot[4], rot[3] - rot[1])
            if group == SLIDE:
                c, s = 1.0, 0.0
            if group == SCREW:
                p = (0.0, 0.0, _along_screw(c, s, p[2], link["pitch"]))
            pose[row, 0], pose[row, 1] = c, s
            if group != PLANE:
                p = (0.0, 0.0, p[2])
            else:
                p = (p[0], p[1], 0.0)
            store3(p, pose, row, 2)
        rel, q = relative_pose(link, pose, row)
        w, v = se3_Ad_inverse(rel, q, w_a, v_a)
        _store_rates(
            link, sub3(load3(velocities, b, 0), w), sub3(load3(velocities, b, 3), v), twist, row
        )
    return 0


@kernel
def place_links(model, work):
    """Poses in the world of all links at the stage, from their poses in their parents."""
    relative, world_out = work.relative, work.world
    for b in range(len(model.bodies)):
        a = model.bodies[b]["parent"]
        rot, p = load9(relative, b, 0), load3(relative, b, 9)
        if a != WORLD:
            rot, p = se3_compose(load9(world_out, a, 0), load3(world_out, a, 9), rot, p)
        # Without it a chain of many links would lose orthogonality along its length.
        store9(so3_nearest(rot), world_out, b, 0)
        store3(p, world_out, b, 9)


@kernel
def lift_links(model, work):
    """Nothing: `place_links` has written work.world. See plane_coordinates.py."""


@kernel
def place_bodies(model, work, pose, twist):
    """Poses and twists of the bodies, from those of the links."""
    world, velocities = work.world, work.velocities
    for i in range(len(model.parts)):
        part = model.parts[i]
        b = part["link"]
        if b == WORLD:
            continue
        rotation, point = matrix3(part["rotation"]), vector3(part["point"])
        rot, p = se3_compose(load9(world, b, 0), load3(world, b, 9), rotation, point)
        store9(rot, pose, i, 0)
        store3(p, pose, i, 9)
        w = load3(velocities, b, 0)
        store3(tmatvec3(rotation, w), twist, i, 0)
        store3(tmatvec3(rotation, sub3(load3(velocities, b, 3), cross3(point, w))), twist, i, 3)
