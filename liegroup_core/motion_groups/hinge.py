# SPDX-License-Identifier: Apache-2.0
"""SO(2): a link turns about z of its frame."""

from liegroup_core.compiling import kernel
from liegroup_core.lie.vec3 import load3, load9

from .articulated import add_aligned_hinge_inertia, add_hinge_inertia

NAME = "SO(2)"
JOINTS = {"revolute": "the frames share origin and z axis; the child rotates about z (hinge)"}
COMPONENTS = PLANE_COMPONENTS = (2,)
MAY_BE_HELD = True


@kernel
def add_rates(link, sw, sv, w, v):
    """V and [V, S qdot]: neither of them has a part of the rate but about z."""
    rate = sw[2]
    w = (w[0], w[1], w[2] + rate)
    return (w, v), ((rate * w[1], -rate * w[0], 0.0), (rate * v[1], -rate * v[0], 0.0))


@kernel
def hand_on(link, work, b, m, torque, force):
    """Neither rotation about z nor drift along it, unless the hinge is held."""
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
