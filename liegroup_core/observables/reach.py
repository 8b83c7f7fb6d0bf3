# SPDX-License-Identifier: Apache-2.0
"""Check whether the loops and cams of a mechanism can reach commanded positions of its driven joints."""

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
from liegroup_core.scene.rearrange import counted_couplings


def beyond_reach(scene, pose, positions, angles):
    """[(driven joint, position)] of the positions that a loop or a cam cannot reach from the present poses.

    scene     : with frames at the centres of mass
    pose      : (n, 12) present poses
    positions : (d,) rad or m, of the driven joints in the order of the scene
    angles    : (k,) rad, present ones of `scene.unwrapped`
    """
    given = driven_joints(scene)
    frames, parts = resolve_frames(scene), resolve_elements(scene)
    places = {body.name: pose_matrix(row) for body, row in zip(scene.bodies, pose)}
    places[WORLD] = np.eye(4)
    number = {joint.name: j for j, joint in enumerate(scene.joints)}
    near = {number[name]: angle for (name, _), angle in zip(scene.unwrapped, angles)}
    couplings = counted_couplings(scene, frames, places, rigid_couplings(scene), near)
    couplings += [ResolvedCoupling(j, j, 0.0, q) for j, q in zip(given, positions)]
    found = []
    for loops, numbers in dependent_groups(scene, couplings):
        entries = [couplings[n] for n in numbers]
        driven = [entry for entry in entries if entry.is_given]
        if not driven or not (loops or any(entry.curve for entry in entries)):
            continue

        def closes(kept):
            joints = sorted({*loops, *(j for entry in kept for j in entry.joints)})
            own = [entry.numbered({j: i for i, j in enumerate(joints)}) for entry in kept]
            linkage = Linkage(scene, frames, parts, joints, couplings=own)
            linkage.start = places
            return linkage.closed(places) is not None

        if closes(entries):
            continue
        # Joints without which the loop can reach all other positions; if there are none, all joints.
        alone = [e for e in driven if closes([entry for entry in entries if entry is not e])]
        found += [(scene.joints[e.joint].name, e.offset) for e in alone or driven]
    return found
