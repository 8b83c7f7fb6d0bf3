# SPDX-License-Identifier: Apache-2.0
"""Check whether the loops of a mechanism can reach commanded positions of its driven joints."""

import numpy as np

from liegroup_core.joints.linkage import Linkage
from liegroup_core.mechanism.redundancy import dependent_groups
from liegroup_core.scene.centres import pose_matrix
from liegroup_core.scene.consistency import (
    ResolvedCoupling,
    driven_joints,
    resolve_elements,
    resolve_frames,
    rigid_couplings,
)
from liegroup_core.scene.description import WORLD


def beyond_reach(scene, pose, positions):
    """[(driven joint, position)] of the positions that a loop cannot reach from the present poses.

    scene     : with frames at the centres of mass
    pose      : (n, 12) present poses
    positions : (d,) rad or m, of the driven joints in the order of the scene
    """
    given = driven_joints(scene)
    couplings = rigid_couplings(scene)
    couplings += [ResolvedCoupling(j, j, 0.0, q) for j, q in zip(given, positions)]
    frames, parts = resolve_frames(scene), resolve_elements(scene)
    places = {body.name: pose_matrix(row) for body, row in zip(scene.bodies, pose)}
    places[WORLD] = np.eye(4)
    found = []
    for loops, numbers in dependent_groups(scene, couplings):
        entries = [couplings[n] for n in numbers]
        driven = [entry for entry in entries if entry.is_given]
        if not loops or not driven:
            continue

        def closes(kept):
            joints = sorted({*loops, *(j for entry in kept for j in (entry.joint, entry.other))})
            own = [entry._replace(joint=joints.index(entry.joint), other=joints.index(entry.other)) for entry in kept]
            return Linkage(scene, frames, parts, joints, couplings=own).closed(places) is not None

        if closes(entries):
            continue
        # Joints without which the loop can reach all other positions; if there are none, all joints.
        alone = [e for e in driven if closes([entry for entry in entries if entry is not e])]
        found += [(scene.joints[e.joint].name, e.offset) for e in alone or driven]
    return found
