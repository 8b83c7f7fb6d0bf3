# SPDX-License-Identifier: Apache-2.0
"""Efforts of joints with one coordinate, as constant wrenches on the two bodies.

The z axis of a revolute, screw or prismatic joint is fixed in both bodies. So a torque tau about it, or a force
f along it, is constant in body axes for any motion:

    revolute   torque  tau z_b on the child   ,   -tau z_a on the parent; also of a screw, whose thread is its reaction
    prismatic  force   f z_b at p_b           ,   -f z_a at p_a: the same line in space

So an effort enters the schedule of external wrenches and rotates with the bodies inside a step. Its work
is exactly effort * d(joint coordinate) where the joint is satisfied.
"""

import numpy as np

from liegroup_core.joints.kinds import TYPES


def unit_wrenches(joints, frames, index, com):
    """Wrenches of a unit effort of every joint with one coordinate.

    joints : of the scene
    frames : (parent frame, child frame) of each, (4, 4), relative to the centres of mass
    index  : {body name: body index}, without the world
    com    : (n, 3) m, centres of mass in the body frames
    returns {joint: [(body index, wrench (6,))]}: torque N m, force N, body axes, about the origins
            of the body frames; none for the world
    """
    found = {}
    for joint, (parent_frame, child_frame) in zip(joints, frames):
        unit = TYPES[joint.type].coordinate
        if unit is None:
            continue
        wrenches = []
        for body, frame, sign in ((joint.child, child_frame, 1.0), (joint.parent, parent_frame, -1.0)):
            if body not in index:
                continue
            wrench = np.zeros(6)
            axis = sign * frame[:3, 2]
            if unit == "rad":
                wrench[:3] = axis
            else:
                wrench[:3] = np.cross(frame[:3, 3] + com[index[body]], axis)
                wrench[3:] = axis
            wrenches.append((index[body], wrench))
        found[joint.name] = wrenches
    return found
