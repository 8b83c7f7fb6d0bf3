# SPDX-License-Identifier: Apache-2.0
"""What pictures show of contacts: their planes, and their forces as arrows."""

import math

import numpy as np

from liegroup_core.fields.frames import rotation_z_to

ARROW, LONGEST = 0.75, 1.5  # of an arrow at the weight of all bodies, and of any, relative to the mechanism


def planes(scene, near):
    """[(point (3,) m, turn (3, 3))] of the planes that contacts of a scene touch, each once; world axes.

    near : (3,) m;  point : of the plane, the nearest one to it;  turn : its last column is the normal
    """
    found = {}
    for force in scene.forces:
        if force.type == "contact" and force.other is None:
            normal = np.array(force.plane.normal) / math.hypot(*force.plane.normal)
            height = float(normal @ force.plane.point)
            point = near + (height - float(normal @ near)) * normal
            found[(*normal.round(9).tolist(), round(height, 9))] = point, rotation_z_to(normal)
    return list(found.values())


def arrows(sample, size):
    """(c, 2, 3) m, world axes: start and tip of the force of each contact on its body; NaN where nothing presses.

    size : of the mechanism, m. Without gravity all arrows are equally long
    """
    scene, found = sample.scene, sample.contact_forces
    weight = sum(body.mass for body in scene.bodies) * math.hypot(*scene.gravity)
    forces = np.linalg.norm(found[:, 1], axis=1)
    lengths = np.minimum(ARROW * forces / weight, LONGEST) if weight else np.full(len(found), ARROW)
    scale = np.divide(size * lengths, forces, where=forces > 0.0, out=np.zeros(len(found)))
    return np.stack([found[:, 0], found[:, 0] + scale[:, None] * found[:, 1]], axis=1)
