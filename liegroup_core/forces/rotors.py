# SPDX-License-Identifier: Apache-2.0
"""Kinetic energy of the rotors of joints; see joints/rotor.py. Their inertia is in the equations of motion."""

import numpy as np

from liegroup_core.compiling import kernel

from . import slide, turn

# Those of a joint that turns and one that slides; parent and child are the same.
ROW = np.dtype([("inertia", "f8"), ("slides", "i8"), *turn.FIELDS, *slide.FIELDS[2:]], align=True)


def rows(joints, frames, index):
    """Records of ROW of the joints with a rotor; frames: of each joint, index: {body: index} with the world."""
    found = []
    for joint, (F_a, F_b) in zip(joints, frames):
        if joint.rotor:
            ends = index[joint.parent], index[joint.child], F_a, F_b
            slides = joint.type == "prismatic"
            found.append((joint.rotor_inertia, slides, *turn.fields(*ends), *slide.fields(*ends)[2:]))
    return np.array(found, dtype=ROW)


@kernel
def energy(rotors, pose, twist):
    """Sum of inertia qdot^2 / 2 of all rotors, J."""
    total = 0.0
    for e in range(len(rotors)):
        row = rotors[e]
        if row["slides"] == 1:
            rate = slide.rate(row, pose, twist)
        else:
            rate = turn.rate(row, pose, twist, turn.axis(row, pose))
        total += 0.5 * row["inertia"] * rate * rate
    return total
