# SPDX-License-Identifier: Apache-2.0
"""Springs, dampers, motors and servos at joints: what each of them exerts about or along the z axis.

A joint transmits its reaction and, beside it, what these forces exert on its child.
"""

import numpy as np

from liegroup_core.compiling import kernel
from liegroup_core.forces import (
    kinds,
    linear_motor,
    linear_spring_damper,
    motor,
    torsional_spring_damper,
)
from liegroup_core.joints.elements import WORLD

# Kinds in the order of the rows of `_on_children`; servos know their efforts.
KINDS = ("torsional_spring_damper", "linear_spring_damper", "motor", "linear_motor")
SERVOS = ("servo", "linear_servo")


@kernel
def _clear(row, scratch):
    for c in range(6):
        scratch[row["child"], c] = 0.0
        if row["parent"] != WORLD:
            scratch[row["parent"], c] = 0.0


@kernel
def _take(row, scratch, out, k):
    for c in range(6):
        out[k, c] = scratch[row["child"], c]


@kernel
def _on_children(forces, angle, pose, twist, scratch, out):
    """Wrench (k, 6) of each force of KINDS on the child of its joint; scratch (n, 6)."""
    k = 0
    rows = forces.torsional_spring_damper
    for e in range(len(rows)):
        _clear(rows[e], scratch)
        torsional_spring_damper.add_wrench(rows[e : e + 1], angle[e : e + 1], pose, twist, scratch)
        _take(rows[e], scratch, out, k)
        k += 1
    rows = forces.linear_spring_damper
    for e in range(len(rows)):
        _clear(rows[e], scratch)
        linear_spring_damper.add_wrench(rows[e : e + 1], pose, twist, scratch)
        _take(rows[e], scratch, out, k)
        k += 1
    rows = forces.motor
    for e in range(len(rows)):
        _clear(rows[e], scratch)
        motor.add_wrench(rows[e : e + 1], pose, twist, scratch)
        _take(rows[e], scratch, out, k)
        k += 1
    rows = forces.linear_motor
    for e in range(len(rows)):
        _clear(rows[e], scratch)
        linear_motor.add_wrench(rows[e : e + 1], pose, twist, scratch)
        _take(rows[e], scratch, out, k)
        k += 1


def names_of_forces(scene):
    """Names of the forces of a scene that act about or along the z axis of a joint."""
    return tuple(force.name for force in scene.forces if force.type in (*KINDS, *SERVOS))


class JointForces:
    """Forces at the joints of a scene.

    names  : of the forces, in the order of the scene
    joints : {force: its joint}
    turns  : {force: True for a torque about z, False for a force along z}
    """

    def __init__(self, scene, frames):
        """scene : with frames at the centres of mass; frames: (parent's, child's) of its joints."""
        found = [force for force in scene.forces if force.type in (*KINDS, *SERVOS)]
        self.names = names_of_forces(scene)
        self.joints = {force.name: force.joint for force in found}
        self.turns = {force.name: force.joint_moves == "turns" for force in found}
        axes = {joint.name: F_b[:3, 2] for joint, (_, F_b) in zip(scene.joints, frames)}
        ordered = [force for kind in KINDS for force in found if force.type == kind]
        self._ordered = [force.name for force in ordered]
        self._rows = np.zeros((len(ordered), 6))
        for row, force in zip(self._rows, ordered):
            first = 0 if self.turns[force.name] else 3
            row[first : first + 3] = axes[force.joint]
        self._servos = [force.name for force in kinds.servos(scene.forces)]

    def at(self, forces, angles, pose, twist, servo_efforts):
        """{force: N m or N} on the child of its joint.

        forces : of the model;  angles, pose, twist : as in Reactions.at
        servo_efforts : (k,) of the servos
        """
        efforts = dict(zip(self._servos, map(float, servo_efforts)))
        if self._ordered:
            out = np.zeros((len(self._ordered), 6))
            _on_children(forces, angles, pose, twist, np.zeros((len(pose), 6)), out)
            efforts |= dict(zip(self._ordered, (out * self._rows).sum(axis=1).tolist()))
        return {name: efforts[name] for name in self.names}
