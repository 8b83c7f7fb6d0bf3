# SPDX-License-Identifier: Apache-2.0
"""Detection of joint damping that is too stiff for explicit methods.

With mass matrix M and damping d of the joints, velocities decay with the time constants of
    M dv/dt = -d v
Explicit methods need steps of that size during the whole simulation. A simulation with an accuracy uses an
implicit method.
"""

import numpy as np

from liegroup_core.lie.groups import SE3

SHORTEST = 1e-4  # s; a second then takes 10 000 explicit steps
NO_INERTIA = 1e-12  # s; below, implicit methods fail too


def stiffness_notes(grouping):
    """Note on the joint with the fastest damping at the start, if its time constant is below SHORTEST; a list.

    grouping : Grouping of a tree, with poses at the start
    """
    # Other joints and floating links are assumed fixed, which can only make the time constants longer.
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
        "give no method, or radau5 or generalized_alpha, so that steps need not be that short"
        if time > NO_INERTIA
        else "the bodies that it moves have almost no inertia: correct the inertia, or lock the joint"
    )
    return [f"stiff: damping stops joint {joint.name} within {time:.1g} s; {advice}"]


def _fastest(grouping, damped):
    """(joint, time constant in s) with the shortest time constant of the damped joints."""
    # Twists, in axes of the world, of the bodies behind a joint at unit joint velocity.
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
