# SPDX-License-Identifier: Apache-2.0
"""Kinetic energy of the rotors of joints; see joints/rotor.py. Their inertia is in the equations of motion."""

import numpy as np

from liegroup_core.compiling import kernel

from . import axis

ROW = np.dtype([("inertia", "f8"), *axis.FIELDS], align=True)


def rows(joints, frames, index):
    """Records of ROW of the joints with a rotor; frames: of each joint, index: {body: index} with the world."""
    found = []
    for joint, (F_a, F_b) in zip(joints, frames):
        if joint.rotor:
            ends = index[joint.parent], index[joint.child], F_a, F_b
            found.append((joint.rotor_inertia, *axis.fields(joint.type == "prismatic", *ends)))
    return np.array(found, dtype=ROW)


@kernel
def energy(rotors, pose, twist):
    """Sum of inertia qdot^2 / 2 of all rotors, J."""
    total = 0.0
    for e in range(len(rotors)):
        row = rotors[e]
        rate = axis.rate(row, axis.unit_wrenches(row, pose), twist)
        total += 0.5 * row["inertia"] * rate * rate
    return total
