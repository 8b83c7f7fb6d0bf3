# SPDX-License-Identifier: Apache-2.0
"""SO(2): a link turns about z of its frame."""

import math

from liegroup_core.compiling import kernel
from liegroup_core.lie.se2 import se2_turned_mass, turn2
from liegroup_core.lie.vec3 import ZERO3, add_to3, load3, load9

from . import about_z
from .articulated import add_aligned_hinge_inertia, add_hinge_inertia
from .in_plane import hand_on_whole, hand_on_with_rotor, place, store_freedom

NAME = "SO(2)"
JOINTS = {"revolute": "the frames share origin and z axis; the child rotates about z (hinge)"}
COMPONENTS = PLANE_COMPONENTS = (2,)
MAY_BE_HELD = True


@kernel
def add_rates(link, sw, sv, w, v):
    """V and [V, S qdot] for a rate about z."""
    rate = sw[2]
    w = (w[0], w[1], w[2] + rate)
    return (w, v), ((rate * w[1], -rate * w[0], 0.0), (rate * v[1], -rate * v[0], 0.0))


@kernel
def hand_on(link, work, b, m, torque, force):
    """Add the rest to the parent. Unless the hinge is held, it has no inertia about z and no drift along z."""
    if work.held[link["freedom"]] != 0.0:
        return False, torque, force
    w, v = load3(work.drift, b, 0), load3(work.drift, b, 3)
    torque = (
        torque[0] + (m[0] * w[0] + m[1] * w[1] + m[6] * v[0] + m[7] * v[1]),
        torque[1] + (m[1] * w[0] + m[3] * w[1] + m[9] * v[0] + m[10] * v[1]),
        torque[2],
    )
    force = (
        force[0] + (m[6] * w[0] + m[9] * w[1] + m[15] * v[0] + m[16] * v[1]),
        force[1] + (m[7] * w[0] + m[10] * w[1] + m[16] * v[0] + m[18] * v[1]),
        force[2] + (m[8] * w[0] + m[11] * w[1] + m[17] * v[0] + m[19] * v[1]),
    )
    rot, p = load9(work.relative, b, 0), load3(work.relative, b, 9)
    if link["aligned"] == 1:
        add_aligned_hinge_inertia(m, rot, p, work.inertia, link["parent"])
    else:
        add_hinge_inertia(m, rot, p, work.inertia, link["parent"])
    return True, torque, force


plane_displace, plane_normalise = about_z.turn, about_z.normalise


@kernel
def plane_coordinate(link, coordinates, row):
    """Angle in [-pi, pi]."""
    c, s, c0, s0 = coordinates[row, 0], coordinates[row, 1], link["cos"], link["sin"]
    return math.atan2(s * c0 - c * s0, c * c0 + s * s0)


@kernel
def plane_add_rates(link, S, V):
    """V and [V, S qdot] of a planar mechanism."""
    return (V[0] + S[0], V[1], V[2]), (S[0] * V[2], -S[0] * V[1])


@kernel
def plane_hand_on(link, work, row, m, F):
    """Add the rest to the parent: without the rotation, a mass matrix M - U U^T / D and a force at the link."""
    if link["rotor"] > 0.0:
        hand_on_with_rotor(link, work, row, m, F, (m[0], m[1], m[2]))
        return
    f, a = link["freedom"], link["parent"]
    inertia, inverse, u = work.inertia, work.freedoms[f, 6], work.freedoms[f, 7]
    if work.held[f] != 0.0:
        store_freedom(work, f, ZERO3, inverse, u)
        hand_on_whole(work, a, row, m, F)
        return
    c, s, x, y = place(work.stage_pose, row)
    Ux, Uy = turn2(c, s, m[1], m[2])
    arm, share = x * Uy - y * Ux, inverse * u
    # M times the velocity of the link if the parent turns
    gx, gy = s * x - c * y, s * y + c * x
    hx, hy = m[3] * gx + m[4] * gy, m[4] * gx + m[5] * gy
    fx, fy = turn2(c, s, F[1], F[2])
    xx, xy, yy = se2_turned_mass(c, s, m[3], m[4], m[5])
    # Terms with `inverse` come last, because the division takes longest.
    inertia[a, 0] += (gx * hx + gy * hy) - inverse * (arm * arm)
    inertia[a, 1] += (c * hx - s * hy) - inverse * (arm * Ux)
    inertia[a, 2] += (s * hx + c * hy) - inverse * (arm * Uy)
    xx, xy, yy = xx - inverse * (Ux * Ux), xy - inverse * (Ux * Uy), yy - inverse * (Uy * Uy)
    add_to3((xx, xy, yy), inertia, a, 3)
    F = ((x * fy - y * fx) + share * arm, fx + share * Ux, fy + share * Uy)
    add_to3(F, work.force, a, 0)
    store_freedom(work, f, (m[0] + arm, Ux, Uy), inverse, u)
