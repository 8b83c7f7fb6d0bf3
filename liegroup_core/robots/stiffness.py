# SPDX-License-Identifier: Apache-2.0
"""Joints whose damping stops them faster than explicit methods can follow.

With mass matrix M and damping d of the joints, velocities decay with the time constants of
    M dv/dt = -d v
Explicit methods need steps of that size for as long as they simulate. An accuracy takes an implicit one.
"""

import numpy as np

from liegroup_core.lie.groups import SE3

SHORTEST = 1e-4  # s; a second takes 10 000 explicit steps, and more below
NO_INERTIA = 1e-12  # s; implicit methods fail too


def stiffness_notes(grouping):
    """Notes of the fastest damping at the start, if its time constant is below SHORTEST.

    grouping : Grouping of a tree, with poses at the start
    """
    # The others and floating links are held, which can only make these slower.
    coupled = {name for each in grouping.robot.couplings for name in (each.first, each.second)}
    damped = [
        joint for joint in grouping.moving if joint.damping and joint.direction.any() and joint.name not in coupled
    ]
    if not damped:
        return []
    joint, time = _fastest(grouping, damped)
    if time >= SHORTEST:
        return []
    advice = (
        "without a method, or with radau5 or generalized_alpha, steps need not be that short"
        if time > NO_INERTIA
        else "what it moves has almost no inertia here: correct the inertia, or lock the joint"
    )
    return [f"stiff: damping stops joint {joint.name} within {time:.1g} s; {advice}"]


def _fastest(grouping, damped):
    """(joint, s) of the shortest time constant of damped joints."""
    # Velocities, in axes of the world, of what a joint moves per unit of its velocity.
    columns = [_direction(grouping, joint) for joint in damped]
    inertia = np.zeros((len(damped), len(damped)))
    holders = {id(grouping.of_link[joint.child]): joint for joint in grouping.moving}
    for group in grouping.groups:
        path, at = set(), group
        while id(at) in holders:
            path.add(holders[id(at)].name)
            at = grouping.of_link[holders[id(at)].parent]
        moved = [i for i, joint in enumerate(damped) if joint.name in path]
        if not moved:
            continue
        mass, com, own = grouping.mass(group)
        to_com = group.pose.copy()
        to_com[:3, 3] += group.pose[:3, :3] @ com
        V = np.array([SE3.Ad(SE3.inverse(to_com)) @ columns[i] for i in moved])
        inertia[np.ix_(moved, moved)] += V[:, :3] @ own @ V[:, :3].T + mass * V[:, 3:] @ V[:, 3:].T
    scale = 1.0 / np.sqrt([joint.damping for joint in damped])
    times, motions = np.linalg.eigh(inertia * np.outer(scale, scale))
    return damped[np.argmax(np.abs(motions[:, 0]))], max(times[0], 0.0)


def _direction(grouping, joint):
    """(6,) twist of the child relative to the parent, axes and origin of the world."""
    child = grouping.of_link[joint.child]
    return SE3.Ad(child.pose @ grouping.frames(joint)[1]) @ joint.direction
