# SPDX-License-Identifier: Apache-2.0
"""Coordinates of a scene with stops or dry friction, in the order of all arrays."""

from liegroup_core.joints.coupling import turns
from liegroup_core.joints.kinds import COORDINATES, position_residual
from liegroup_core.joints.stops import BACKLASH, DISTANCE, SLIDE


def switches_of(scene):
    """[Switch] of the joints of a scene, then of its couplings."""
    found = [switch._replace(joint=j) for j, joint in enumerate(scene.joints) for switch in joint.switches]
    return found + [
        switch._replace(coupling=c) for c, coupling in enumerate(scene.couplings) for switch in coupling.switches
    ]


def unit_of(switch, scene):
    """Unit of the coordinate of a Switch of a scene, "rad" or "m"."""
    if switch.kind == BACKLASH:
        name = scene.couplings[switch.coupling].joint
        return "rad" if turns(next(j for j in scene.joints if j.name == name)) else "m"
    return "m" if switch.kind in (SLIDE, DISTANCE) else "rad"


def coordinate_of(switch, C_rel):
    """Coordinate of a Switch of a joint, rad or m; C_rel (4, 4): child's joint frame in the parent's.

    An angle about z is unwrapped to the turn of its stops.
    """
    (q,) = position_residual((COORDINATES[switch.kind],), C_rel).tolist()
    return q if switch.limits is None else switch.limits.turn_of(q, switch.is_angle)
