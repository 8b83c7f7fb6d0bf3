# SPDX-License-Identifier: Apache-2.0
"""Coordinates of links in a plane: coordinates.py for planar mechanisms.

The coordinates of a link are its pose in its parent link, (cos, sin, x, y) in m: the placement of
the joint and its motion in one. Links are displaced by products from the right, so that no stage
needs the placement. Link frames have the normal of the plane as z axis.
"""

from liegroup_core.compiling import kernel, shared
from liegroup_core.joints.elements import WORLD
from liegroup_core.lie.coefficients import turn_coefficients
from liegroup_core.lie.vec3 import (
    dot3,
    load3,
    load9,
    matmul3,
    matrix3,
    matvec3,
    store3,
    store9,
    vector3,
)
from liegroup_core.motion_groups.about_z import nearest_turn, turned
from liegroup_core.motion_groups.table import HINGE, PLANE, SLIDE


@kernel
def displace(model, b, coordinates, screws, at, out):
    """Write the coordinates of link b after exp(Psi) to `out`; see coordinates.displace."""
    row = len(model.parts) + b
    group = model.links[b]["group"]
    psi = screws[at, 0]
    c0, s0 = coordinates[row, 0], coordinates[row, 1]
    if group == SLIDE:
        out[row, 2] = coordinates[row, 2] + c0 * psi
        out[row, 3] = coordinates[row, 3] + s0 * psi
        return 0.0
    x = psi * psi
    sinc, versinc = turn_coefficients(x)
    c, s = 1.0 - x * versinc, psi * sinc
    if group == PLANE:
        # dexp_psi of the translation, in the axes of the start
        ex, ey = screws[at + 1, 0], screws[at + 2, 0]
        q = psi * versinc
        ex, ey = sinc * ex - q * ey, sinc * ey + q * ex
        out[row, 2] = coordinates[row, 2] + (c0 * ex - s0 * ey)
        out[row, 3] = coordinates[row, 3] + (s0 * ex + c0 * ey)
    out[row, 0], out[row, 1] = c0 * c - s0 * s, s0 * c + c0 * s
    return x


displace_by_twist = displace


@kernel
def normalise(model, b, coordinates):
    """Remove the round-off by which a product leaves the group of link b."""
    link, row = model.links[b], len(model.parts) + b
    c, s = coordinates[row, 0], coordinates[row, 1]
    if link["group"] == SLIDE:
        x, y = coordinates[row, 2] - link["x"], coordinates[row, 3] - link["y"]
        along = c * x + s * y
        coordinates[row, 2], coordinates[row, 3] = link["x"] + c * along, link["y"] + s * along
    else:
        scale = 1.5 - 0.5 * (c * c + s * s)
        coordinates[row, 0], coordinates[row, 1] = scale * c, scale * s


@kernel
def _place_from_body(model, work, pose, twist, b):
    """Write pose in the plane and velocity of link b from those of the body that represents it."""
    link = model.bodies[b]
    i = link["body"]
    world, rotation = load9(model.axes, 0, 0), matrix3(link["body_rotation"])
    first, second = (world[0], world[3], world[6]), (world[1], world[4], world[7])
    row_x, row_y = (rotation[0], rotation[1], rotation[2]), (rotation[3], rotation[4], rotation[5])
    px, py, _ = vector3(link["body_point"])
    rot, r = load9(pose, i, 0), load3(pose, i, 9)
    x, y = matvec3(rot, row_x), matvec3(rot, row_y)
    c, s = nearest_turn(dot3(first, x) + dot3(second, y), dot3(second, x) - dot3(first, y))
    place = work.placed
    place[b, 0], place[b, 1] = c, s
    place[b, 2] = dot3(first, r) - (c * px - s * py)
    place[b, 3] = dot3(second, r) - (s * px + c * py)
    w = dot3((rotation[6], rotation[7], rotation[8]), load3(twist, i, 0))
    v = load3(twist, i, 3)
    store3((w, dot3(row_x, v) + py * w, dot3(row_y, v) - px * w), work.velocities, b, 0)


@shared
def coordinates(model, work, pose, twist):
    """Write the rows of the links in pose and twist (n + L, ...) from the rows of the bodies.

    Uses work.placed and work.velocities as scratch memory.
    """
    n = len(model.parts)
    for b in range(len(model.links)):
        link = model.links[b]
        a, group = link["parent"], link["group"]
        _place_from_body(model, work, pose, twist, b)
        c, s, x, y = work.placed[b, 0], work.placed[b, 1], work.placed[b, 2], work.placed[b, 3]
        w, vx, vy = load3(work.velocities, b, 0)
        wa, ux, uy = 0.0, 0.0, 0.0
        if a != WORLD:
            ca, sa = work.placed[a, 0], work.placed[a, 1]
            c, s = ca * c + sa * s, ca * s - sa * c
            x, y = x - work.placed[a, 2], y - work.placed[a, 3]
            x, y = ca * x + sa * y, ca * y - sa * x
            wa, ux, uy = load3(work.velocities, a, 0)
        row = n + b
        if group == HINGE:
            pose[row, 0], pose[row, 1], pose[row, 2], pose[row, 3] = c, s, link["x"], link["y"]
            twist[row, 0] = w - wa
            continue
        if group == SLIDE:
            c, s = link["cos"], link["sin"]
            along = c * (x - link["x"]) + s * (y - link["y"])
            x, y = link["x"] + c * along, link["y"] + s * along
        pose[row, 0], pose[row, 1], pose[row, 2], pose[row, 3] = c, s, x, y
        ux, uy = ux - wa * y, uy + wa * x
        vx, vy = vx - (c * ux + s * uy), vy - (c * uy - s * ux)
        if group == SLIDE:
            twist[row, 0] = vx
        else:
            store3((w - wa, vx, vy), twist, row, 0)
    return 0


@kernel
def place_links(model, work):
    """Poses in the plane of all links at the stage, to work.placed."""
    n, place = len(model.parts), work.placed
    for b in range(len(model.links)):
        a, row = model.links[b]["parent"], n + b
        c, s = work.stage_pose[row, 0], work.stage_pose[row, 1]
        x, y = work.stage_pose[row, 2], work.stage_pose[row, 3]
        if a != WORLD:
            ca, sa = place[a, 0], place[a, 1]
            x, y = place[a, 2] + (ca * x - sa * y), place[a, 3] + (sa * x + ca * y)
            c, s = ca * c - sa * s, sa * c + ca * s
        place[b, 0], place[b, 1], place[b, 2], place[b, 3] = c, s, x, y


@kernel
def _turn(place, b):
    """Cosine and sine of a link, nearest to a rotation: one Newton iteration."""
    c, s = place[b, 0], place[b, 1]
    scale = 1.5 - 0.5 * (c * c + s * s)
    return c * scale, s * scale


@kernel
def lift_links(model, work):
    """Poses in the world of all links, to work.world, from those in the plane."""
    world = load9(model.axes, 0, 0)
    for b in range(len(model.links)):
        c, s = _turn(work.placed, b)
        store9(turned(world, c, s), work.world, b, 0)
        point = (work.placed[b, 2], work.placed[b, 3], model.link_heights[b])
        store3(matvec3(world, point), work.world, b, 9)


@kernel
def place_bodies(model, work, pose, twist):
    """Poses and twists of the bodies, from work.placed and the velocities of the links."""
    world = load9(model.axes, 0, 0)
    for i in range(len(model.parts)):
        part = model.parts[i]
        b = part["link"]
        if b == WORLD:
            continue
        m, (px, py, _) = matrix3(part["rotation"]), vector3(part["point"])
        c, s = _turn(work.placed, b)
        store9(matmul3(turned(world, c, s), m), pose, i, 0)
        x = work.placed[b, 2] + (c * px - s * py)
        y = work.placed[b, 3] + (s * px + c * py)
        store3(matvec3(world, (x, y, model.heights[i])), pose, i, 9)
        w, vx, vy = load3(work.velocities, b, 0)
        vx, vy = vx - w * py, vy + w * px
        store3((w * m[6], w * m[7], w * m[8]), twist, i, 0)
        store3((vx * m[0] + vy * m[3], vx * m[1] + vy * m[4], vx * m[2] + vy * m[5]), twist, i, 3)
