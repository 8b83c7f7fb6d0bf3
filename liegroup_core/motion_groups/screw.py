# SPDX-License-Identifier: Apache-2.0
"""Screws of one pitch: a link turns about z and moves along it, s = (0, 0, 1; 0, 0, pitch)."""

import math

from liegroup_core.compiling import kernel

from . import about_z
from .about_z import store_place, turn_of

NAME = "screw"
JOINTS = {
    "screw": "the frames share the z axis; the child rotates about z and translates along "
    "it by pitch per radian (nut on a bolt)"
}
COMPONENTS = (2,)
MAY_BE_HELD = HAS_PITCH = True


@kernel
def _along(c, s, z, pitch):
    """Displacement of a screw from its angle, with the number of turns nearest to a displacement z."""
    lead = 2.0 * math.pi * pitch
    angle = math.atan2(s, c)
    ahead = z - pitch * angle
    if abs(ahead) < 1e15 * abs(lead):
        angle += 2.0 * math.pi * math.floor(ahead / lead + 0.5)
    return pitch * angle


@kernel
def project_pose(link, rot, p, coordinates, row):
    """X nearest to a relative pose: the angle is kept."""
    c, s = turn_of(rot)
    store_place(c, s, 0.0, 0.0, _along(c, s, p[2], link["pitch"]), coordinates, row)


@kernel
def normalise(link, coordinates, row):
    """Remove the round-off of products of rotations, and that of the sum of translations."""
    c, s = coordinates[row, 0], coordinates[row, 1]
    about_z.normalise(link, coordinates, row)
    coordinates[row, 4] = _along(c, s, coordinates[row, 4], link["pitch"])
