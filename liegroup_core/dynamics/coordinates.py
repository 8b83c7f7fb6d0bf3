# SPDX-License-Identifier: Apache-2.0
"""Coordinates of links: from poses and twists of the bodies, and back.

A new state is given as poses and twists of the bodies. The coordinates are computed from them once; a pose
that violates a joint of the tree is moved onto it, parents first. From then on the coordinates are the
state, and the bodies follow from them. Computing the coordinates from poses in every step would add the
round-off of poses, always with the same sign: 1e-15 per step in a mechanism of 10 m.
"""

from liegroup_core.compiling import kernel, shared
from liegroup_core.joints.elements import WORLD
from liegroup_core.lie.se3 import se3_Ad_inverse, se3_compose
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
from liegroup_core.mechanism.arrays import AFTER_CROSS, CROSS, OWN
from liegroup_core.motion_groups.about_z import nearest_turn
from liegroup_core.motion_groups.table import relative_pose

from . import algebra
from .algebra import (
    compose,
    in_parent,
    lifted,
    link_of,
    load,
    placed,
    planar,
    project_pose,
    rates_of,
    relative,
    spatial,
    store,
    tree_size,
)
from .links import lift_links as lift_links
from .links import set_place

_displace, _displace_by_twist, _normalise = map(algebra.of_group, ("displace", "displace_by_twist", "normalise"))


@kernel
def displace_by_twist(model, b, coordinates, screws, at, out):
    """`displace` with Psi in link axes for all groups."""
    row = len(model.bodies) + b
    return _displace_by_twist(model, link_of(model, b), coordinates, row, screws, at, out)


@kernel
def displace(model, b, coordinates, screws, at, out):
    """Write X exp(Psi) of link b to its row of `out`.

    Psi : first column of `screws`, from row `at` on
    returns the squared rotation angle, rad^2
    """
    row = len(model.bodies) + b
    return _displace(model, link_of(model, b), coordinates, row, screws, at, out)


@kernel
def normalise(model, b, coordinates):
    """Project the coordinates of link b back onto the group, which removes round-off."""
    _normalise(model, link_of(model, b), coordinates, len(model.bodies) + b)


@kernel
def _body_of_link(model, link, pose, twist, world_out, velocities_out, b):
    """Write pose in the world and twist of link b from those of the body that represents it."""
    rotation, point = matrix3(link["body_rotation"]), vector3(link["body_point"])
    i = link["body"]
    rot = matmul3(load9(pose, i, 0), transpose3(rotation))
    store9(rot, world_out, b, 0)
    store3(sub3(load3(pose, i, 9), matvec3(rot, point)), world_out, b, 9)
    w = matvec3(rotation, load3(twist, i, 0))
    v = add3(matvec3(rotation, load3(twist, i, 3)), cross3(point, w))
    store(model, planar(model, (w, v)), velocities_out, b)


@shared
def coordinates(model, work, pose, twist):
    """Write the rows of the links in pose and twist (n + L, ...) from the rows of the bodies.

    Uses work.world and work.velocities as scratch memory.
    """
    n = len(model.bodies)
    world, velocities = work.world, work.velocities
    for b in range(len(model.links)):
        link = model.links[b]
        a = link["parent"]
        place = link["coordinates"]
        row = n + b
        rot_a, r_a, w_a, v_a = matrix3(link["rotation"]), vector3(link["point"]), ZERO3, ZERO3
        if a != WORLD:
            rot_a, r_a = se3_compose(load9(world, a, 0), load3(world, a, 9), rot_a, r_a)
            w_a, v_a = spatial(model, load(model, velocities, a))
        if place == CROSS:
            # The parent's rotation to the link after the cross is T1 Rz(first) T2 Rz(second).
            after = model.links[b + 1]
            _body_of_link(model, after, pose, twist, world, velocities, b + 1)
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
            # The axes are perpendicular: the rate about the first is the component of w_rel along it.
            w_rel = sub3(
                matvec3(load9(world, b + 1, 0), spatial(model, load(model, velocities, b + 1))[0]),
                matvec3(load9(world, a, 0), w_a) if a != WORLD else ZERO3,
            )
            rate = dot3((rot[2], rot[5], rot[8]), w_rel)
            twist[row, 0] = rate
            rel, p = relative_pose(link, pose, row)
            w, v = se3_Ad_inverse(rel, p, w_a, v_a)
            store(model, planar(model, ((w[0], w[1], w[2] + rate), v)), velocities, b)
            continue
        if link["body"] < 0 and place == OWN:
            project_pose(model, link_of(model, b), rot_a, r_a, pose, row)  # of a state of a law: see `enter`
            continue
        if place != AFTER_CROSS:
            _body_of_link(model, link, pose, twist, world, velocities, b)
        rot = tmatmul3(rot_a, load9(world, b, 0))
        p = tmatvec3(rot_a, sub3(load3(world, b, 9), r_a))
        project_pose(model, link_of(model, b), rot, p, pose, row)
        rel, q = lifted(model, in_parent(model, link_of(model, b), pose, row))
        w, v = se3_Ad_inverse(rel, q, w_a, v_a)
        w_b, v_b = spatial(model, load(model, velocities, b))
        V = planar(model, (sub3(w_b, w), sub3(v_b, v)))
        rates_of(model, link_of(model, b), V, twist, row)
    return 0


@kernel
def place_links(model, work):
    """Poses in the world of all links at the stage, from their poses in their parents."""
    for b in range(tree_size(model)):
        a, X = link_of(model, b)["parent"], relative(model, work, b)
        if a != WORLD:
            X = compose(model, placed(model, work, a), X)
        set_place(model, work, X, b)


@kernel
def place_bodies(model, work, pose, twist):
    """Poses and twists of the bodies, from those of the links."""
    lift_links(model, work)
    world = work.world
    for i in range(len(model.bodies)):
        body = model.bodies[i]
        b = body["link"]
        if b == WORLD:
            continue
        rotation, point = matrix3(body["rotation"]), vector3(body["point"])
        rot, p = se3_compose(load9(world, b, 0), load3(world, b, 9), rotation, point)
        store9(rot, pose, i, 0)
        store3(p, pose, i, 9)
        w, v = spatial(model, load(model, work.velocities, b))
        store3(tmatvec3(rotation, w), twist, i, 0)
        store3(tmatvec3(rotation, sub3(v, cross3(point, w))), twist, i, 3)
