# SPDX-License-Identifier: Apache-2.0
"""What pictures show of contacts: planes, points and forces."""

import math

import numpy as np

from liegroup_core.fields.frames import rotation_z_to
from liegroup_core.forces.contact import ROUND
from liegroup_core.scene.names import WORLD

ARROW, LONGEST = 2.0, 3.0  # of an arrow at the weight of the heaviest mechanism, and of any, by its size
# Radius of a point, by this size, and the least ones by that of the picture and by the radius R of a ball above it.
# Seen from 25 degrees above, the ball covers 0.1 R below its lowest point.
POINT, SMALLEST, BELOW = 0.05, 0.01, 0.3
WIDE, ROOM = 0.5, 1.1  # of a patch: least width by the longest edge of the bodies' box, and size by that of the box
STICKS, SLIPS = (0.08, 0.6, 0.2), (0.85, 0.1, 0.55)  # colours of points
PLANE = (0.45, 0.5, 0.56)


def planes(scene, near):
    """[(point (3,) m, turn (3, 3))] of the planes that contacts of a scene touch, each once; world axes.

    near : (3,) m;  point : of the plane, the nearest one to it;  turn : its last column is the normal
    """
    found = {}
    for force in scene.forces:
        if force.type == "contact" and force.other is None:
            normal, height = force.plane.unit, force.plane.height
            point = near + (height - float(normal @ near)) * normal
            found[(*normal.round(9).tolist(), round(height, 9))] = point, rotation_z_to(normal)
    return list(found.values())


def patches(scene, low, high):
    """[(v, 3) m] corners, in order, of the part of each plane of `planes` that is in a box about the bodies.

    low, high : (3,) m, bounds of the bodies. A box that does not reach a plane is extended to it
    """
    gravity, middle, found = np.array(scene.gravity), 0.5 * (low + high), []
    up = np.abs(gravity) / np.linalg.norm(gravity) if gravity.any() else np.zeros(3)
    longest = (high - low).max()
    half = np.maximum(0.5 * (high - low) * (up + ROOM * (1.0 - up)), 0.5 * WIDE * longest * (1.0 - up))
    for point, turn in planes(scene, middle):
        least, most = np.minimum(middle - half, point), np.maximum(middle + half, point)
        reach = np.linalg.norm(most - least)
        corners = [point + reach * (a * turn[:, 0] + b * turn[:, 1]) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
        for axis in range(3):
            for sign, limit in ((1.0, most[axis]), (-1.0, -least[axis])):
                corners = _cut(corners, lambda x, k=axis, s=sign, e=limit: e + 1e-9 * reach - s * x[k])
        if len(corners) > 2:
            found.append(np.array(corners))
    return found


def rulings(corners, cell):
    """(r, 2, 3) m, ends of lines on a patch at multiples of a distance in m."""
    normal, found = np.cross(corners[1] - corners[0], corners[2] - corners[0]), []
    for way in rotation_z_to(normal / np.linalg.norm(normal)).T[:2]:
        heights = corners @ way
        for height in cell * np.arange(math.ceil(heights.min() / cell), heights.max() / cell):
            sides, others = heights - height, np.roll(heights, -1) - height
            cut = (sides > 0.0) != (others > 0.0)
            part = (sides[cut] / (sides[cut] - others[cut]))[:, None]
            ends = corners[cut] + part * (np.roll(corners, -1, axis=0) - corners)[cut]
            if len(ends) == 2:
                found.append(ends)
    return np.reshape(found, (-1, 2, 3))


def _cut(corners, inside):
    """Corners of the part of a convex polygon where a linear function is positive."""
    found = []
    for one, other in zip(corners, corners[1:] + corners[:1]):
        a, b = inside(one), inside(other)
        if a > 0.0:
            found.append(one)
        if (a > 0.0) != (b > 0.0):
            found.append(one + a / (a - b) * (other - one))
    return found


def measure(scene, sizes):
    """(m, N) size and weight of the heaviest mechanism: of bodies that joints connect, other than to the world.

    sizes : (n,) m, of the bodies
    """
    groups = {body.name: {body.name} for body in scene.bodies}
    for joint in scene.joints:
        if WORLD not in (joint.parent, joint.child):
            both = groups[joint.parent] | groups[joint.child]
            groups |= dict.fromkeys(both, both)
    mass = {body.name: body.mass for body in scene.bodies}
    heaviest = max(groups.values(), key=lambda group: sum(mass[name] for name in group))
    own = [k for k, body in enumerate(scene.bodies) if body.name in heaviest]
    places = np.array([scene.bodies[k].position for k in own])
    size = float(np.linalg.norm(np.ptp(places, axis=0)) + max(sizes[k] for k in own))
    return size, sum(mass[name] for name in heaviest) * math.hypot(*scene.gravity)


def radius(scene, size, extent):
    """Radius of a drawn point, m; size : as `measure`, extent : m, of the picture."""
    contacts = (force for force in scene.forces if force.type == "contact")
    balls = (BELOW * shape.radius for each in contacts for shape in each.shapes if shape.type in ROUND)
    return max(POINT * size, SMALLEST * extent, *balls)


def arrows(sample, size, weight):
    """(c, 2, 3) m, world axes: start and tip of the force of each contact on its body; NaN where nothing presses.

    size, weight : as `measure`. Without gravity all arrows are equally long
    """
    found = sample.contact_forces
    forces = np.linalg.norm(found[:, 1], axis=1)
    lengths = np.minimum(ARROW * forces / weight, LONGEST) if weight else np.full(len(found), ARROW)
    scale = np.divide(size * lengths, forces, where=forces > 0.0, out=np.zeros(len(found)))
    return np.stack([found[:, 0], found[:, 0] + scale[:, None] * found[:, 1]], axis=1)
