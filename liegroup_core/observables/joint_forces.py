# SPDX-License-Identifier: Apache-2.0
"""Efforts of springs, dampers, motors and servos about or along the z axis of their joint.

A joint transmits its reaction and the efforts of these forces to its child.
"""

import numpy as np

from liegroup_core.compiling import kernel
from liegroup_core.forces import kinds, linear_motor, linear_spring_damper, motor, torsional_spring_damper, turn

# Kinds in the order of `_efforts`. Efforts of servos are computed elsewhere.
KINDS = ("torsional_spring_damper", "linear_spring_damper", "motor", "linear_motor")
SERVOS = ("servo", "linear_servo")


@kernel
def _efforts(forces, angle, pose, twist, out):
    """Write the effort of each force of KINDS on the child of its joint to out (k,)."""
    k = 0
    rows = forces.torsional_spring_damper
    for e in range(len(rows)):
        n = turn.axis(rows[e], pose)
        out[k] = torsional_spring_damper.effort(rows[e], angle[e], pose, twist, n)
        k += 1
    rows = forces.linear_spring_damper
    for e in range(len(rows)):
        out[k] = linear_spring_damper.effort(rows[e], pose, twist)
        k += 1
    rows = forces.motor
    for e in range(len(rows)):
        out[k] = motor.effort(rows[e], pose, twist, turn.axis(rows[e], pose))
        k += 1
    rows = forces.linear_motor
    for e in range(len(rows)):
        out[k] = linear_motor.effort(rows[e], pose, twist)
        k += 1


def names_of_forces(scene):
    """Names of the forces of a scene that act about or along the z axis of a joint."""
    return tuple(force.name for force in scene.forces if force.type in (*KINDS, *SERVOS))


class JointForces:
    """Forces at the joints of a scene.

    names  : names of the forces, in the order of the scene
    joints : {force: its joint}
    turns  : {force: True for a torque about z, False for a force along z}
    """

    def __init__(self, scene):
        found = [force for force in scene.forces if force.type in (*KINDS, *SERVOS)]
        self.names = names_of_forces(scene)
        self.joints = {force.name: force.joint for force in found}
        self.turns = {force.name: force.joint_moves == "turns" for force in found}
        ordered = [force for kind in KINDS for force in found if force.type == kind]
        self._ordered = [force.name for force in ordered]
        self._servos = [force.name for force in kinds.servos(scene.forces)]

    def at(self, forces, angles, pose, twist, servo_efforts):
        """{force: N m or N} on the child of its joint.

        forces : of the model;  angles, pose, twist : as in Reactions.at
        servo_efforts : (k,) efforts of the servos
        """
        efforts = dict(zip(self._servos, map(float, servo_efforts)))
        if self._ordered:
            out = np.zeros(len(self._ordered))
            _efforts(forces, angles, pose, twist, out)
            efforts |= dict(zip(self._ordered, out.tolist()))
        return {name: efforts[name] for name in self.names}
