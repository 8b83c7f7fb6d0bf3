# SPDX-License-Identifier: Apache-2.0
"""Screws of one pitch: a link turns about z and moves along it, s = (0, 0, 1; 0, 0, pitch)."""

import math

from liegroup_core.compiling import kernel

from . import about_z
from .about_z import relative_pose as relative_pose
from .about_z import store_place, turn_of
from .elimination import accelerate_direction, column, eliminate_direction, is_held, leave_direction

JOINTS = ("screw",)
COMPONENTS = (2,)  # that of the rate; with it goes the translation
MAY_BE_HELD = True


@kernel
def rate_twist(link, rates, row):
    """S qdot."""
    return (0.0, 0.0, rates[row, 0]), (0.0, 0.0, link["pitch"] * rates[row, 0])


@kernel
def move(link, psi, at):
    """Rotation vector and shift."""
    return (0.0, 0.0, psi[at, 0]), (0.0, 0.0, link["pitch"] * psi[at, 0])


@kernel
def _along(c, s, z, pitch):
    """Displacement of a screw: that of its angle, in the turn nearest to a displacement z."""
    lead = 2.0 * math.pi * pitch
    turn = math.atan2(s, c)
    ahead = z - pitch * turn
    if abs(ahead) < 1e15 * abs(lead):
        turn += 2.0 * math.pi * math.floor(ahead / lead + 0.5)
    return pitch * turn


@kernel
def project_pose(link, rot, p, coordinates, row):
    """X nearest to a relative pose: the angle is kept."""
    c, s = turn_of(rot)
    store_place(c, s, 0.0, 0.0, _along(c, s, p[2], link["pitch"]), coordinates, row)


@kernel
def displace(link, coordinates, row, screws, at, out):
    """X exp(Psi)."""
    psi = screws[at, 0]
    out[row, 4] = coordinates[row, 4] + link["pitch"] * psi
    return about_z.turn(coordinates, row, psi, out)


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
    pitch, turn, lift = link["pitch"], column(m, 2), column(m, 5)
    U = (
        turn[0] + pitch * lift[0],
        turn[1] + pitch * lift[1],
        turn[2] + pitch * lift[2],
        turn[3] + pitch * lift[3],
        turn[4] + pitch * lift[4],
        turn[5] + pitch * lift[5],
    )
    u = -(torque[2] + pitch * force[2])
    return eliminate_direction(work, f, U, U[2] + pitch * U[5], u, m, torque, force)


@kernel
def accelerate(link, work, f, w, v):
    """Acceleration of a link with its freedom."""
    rate = accelerate_direction(work, f, w, v)
    return (w[0], w[1], w[2] + rate), (v[0], v[1], v[2] + link["pitch"] * rate)


@kernel
def leave(link, work, f, place, rows, torque, force):
    """A wrench of a row without the freedom."""
    y = torque[2] + link["pitch"] * force[2]
    return leave_direction(work, f, y, place, torque, force)
