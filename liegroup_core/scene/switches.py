# SPDX-License-Identifier: Apache-2.0
"""Coordinates of a scene with stops or dry friction, in the order of all arrays."""

import math

from liegroup_core.joints.coupling import coordinate, turns
from liegroup_core.joints.stops import BACKLASH, CONE, DISTANCE, SLIDE


def switches_of(scene):
    """[Switch] of the joints of a scene, then of its couplings."""
    found = [
        switch._replace(joint=j)
        for j, joint in enumerate(scene.joints)
        for switch in joint.switches
    ]
    return found + [
        switch._replace(coupling=c)
        for c, coupling in enumerate(scene.couplings)
        for switch in coupling.switches
    ]


def unit_of(switch, scene):
    """Unit of the coordinate of a Switch of a scene, "rad" or "m"."""
    if switch.kind == BACKLASH:
        name = scene.couplings[switch.coupling].joint
        return "rad" if turns(next(j for j in scene.joints if j.name == name)) else "m"
    return "m" if switch.kind in (SLIDE, DISTANCE) else "rad"


def coordinate_of(switch, joint, C_rel):
    """Coordinate of a Switch of a joint, rad or m; C_rel (4, 4): child's joint frame in the parent's.

    An angle about z is in the turn that its stops expect.
    """
    if switch.kind == DISTANCE:
        return math.hypot(*C_rel[:3, 3])
    if switch.kind == CONE:
        return math.atan2(math.hypot(C_rel[0, 2], C_rel[1, 2]), C_rel[2, 2])
    if switch.kind == SLIDE:
        return float(C_rel[2, 3])
    q = coordinate(joint, C_rel)
    return q if switch.limits is None else switch.limits.turn_of(q, True)
