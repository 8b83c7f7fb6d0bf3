# SPDX-License-Identifier: Apache-2.0
"""Screws of one pitch: a link turns about z and moves along it, s = (0, 0, 1; 0, 0, pitch)."""

import math

from liegroup_core.compiling import kernel
from liegroup_core.lie.vec3 import axpy3

from . import about_z
from .about_z import store_place, turn_of
from .elimination import (
    accelerate_direction,
    inverse_of,
    is_held,
    leave_direction,
    reduced,
    store_freedom,
)

NAME = "screw"
JOINTS = {
    "screw": "the frames share the z axis; the child rotates about z and translates along "
    "it by pitch per radian (nut on a bolt)"
}
COMPONENTS = (2,)  # that of the rate; with it goes the translation
MAY_BE_HELD = HAS_PITCH = True


@kernel
def _along(c, s, z, pitch):
    """Displacement of a screw: that of its angle, in the turn nearest to a displacement z."""
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


@kernel
def eliminate(link, work, f, m, torque, force):
    """The freedom leaves an articulated body."""
    if is_held(work, f):
        return m, torque, force
    pitch = link["pitch"]
    U = (
        m[2] + pitch * m[8],
        m[4] + pitch * m[11],
        m[5] + pitch * m[14],
        m[12] + pitch * m[17],
        m[13] + pitch * m[19],
        m[14] + pitch * m[20],
    )
    u = -(torque[2] + pitch * force[2])
    inverse = inverse_of(U[2] + pitch * U[5])
    store_freedom(work, f, U, inverse, u)
    share = u * inverse
    return (
        reduced(m, U, inverse),
        axpy3(share, (U[0], U[1], U[2]), torque),
        axpy3(share, (U[3], U[4], U[5]), force),
    )


@kernel
def accelerate(link, work, f, w, v):
    """Acceleration of a link with its freedom."""
    rate = accelerate_direction(work, f, w, v)
    return (w[0], w[1], w[2] + rate), (v[0], v[1], v[2] + link["pitch"] * rate)


@kernel
def leave(link, work, f, place, rows, w, v):
    """A wrench of a row without the freedom; without a pitch its component vanishes, as a hinge's."""
    pitch = link["pitch"]
    w, v = leave_direction(work, f, w[2] + pitch * v[2], place, w, v)
    return (w[0], w[1], 0.0 if pitch == 0.0 and work.held[f] == 0.0 else w[2]), v
