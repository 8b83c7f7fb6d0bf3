# SPDX-License-Identifier: Apache-2.0
"""Motion of the bodies behind joints with given coordinates and rates, along a spanning tree.

All other joints of the tree keep their relative pose and relative velocity, so the bodies behind a given
joint move as one. For a tree this is the result. With loops it is the initial guess from which
rearrange.py finds the nearest consistent state.
"""

import numpy as np

from liegroup_core.fields.curve import other_at
from liegroup_core.joints.coupling import coordinate, turns
from liegroup_core.joints.kinds import TYPES
from liegroup_core.joints.linkage import inverse
from liegroup_core.lie.groups import SE3, within_a_turn

from .description import WORLD


def relative_pose(scene, frames, j, poses):
    """C_rel (4, 4) of joint j; poses {body: (4, 4)} with the world."""
    joint, (F_a, F_b) = scene.joints[j], frames[j]
    return inverse(poses[joint.parent] @ F_a) @ poses[joint.child] @ F_b


def coordinates_at(scene, frames, poses, numbers, near):
    """{j: coordinate} of the joints `numbers`, rad or m. Angles are within half a turn of near: {j: rad}."""
    found = {}
    for j in numbers:
        found[j] = coordinate(scene.joints[j], relative_pose(scene, frames, j, poses))
        if j in near and turns(scene.joints[j]):
            found[j] = within_a_turn(found[j], near[j])
    return found


def with_coupled(couplings, values):
    """{j: value} extended to the joints coupled to them; values: changes of coordinates, or rates.

    couplings : counted from the present coordinates, see `counted_from`; for rates without their curves
    """
    values, before = dict(values), -1
    while len(values) != before:
        before = len(values)
        for entry in couplings:
            joint, other = entry.joint, entry.other
            unknown = [j for j in entry.joints if j not in values]
            if unknown == [joint]:
                values[joint] = entry.rise(values)
            elif unknown == [other] and any((entry.ratio, *entry.curve)):
                further = values[joint] - entry.rise(values | {other: 0.0})
                values[other] = other_at(entry._replace(offset=0.0), further, 0.0)
            elif len(unknown) == 1 and (c := dict(entry.further).get(unknown[0])):
                values[unknown[0]] = (values[joint] - entry.rise(values | {unknown[0]: 0.0})) / c
    return values


def carried(scene, frames, before, given, changes, rates):
    """Poses {body: (4, 4)} and twists {body: (6,)} after changes of joints and of bodies.

    frames  : (parent frame, child frame) of every joint
    before  : (poses, twists) of all bodies and the world
    given   : (poses, twists) of the bodies that are set
    changes : {j: change of the coordinate}, rad or m; rates: {j: rate}, rad/s or m/s
    """
    poses, twists = (old | part for old, part in zip(before, given))
    changed = set().union(*given)
    for j, near, far in _from_the_roots(scene, changes.keys() | rates.keys(), changed):
        if not (near in changed or j in changes or j in rates):
            continue
        changed.add(far)
        joint, (F_a, F_b) = scene.joints[j], frames[j]
        direction = _direction(joint)
        C_rel, V_rel = _relative(scene, frames, j, *before)
        C_rel = C_rel @ SE3.exp(changes.get(j, 0.0) * direction)
        if j in rates:
            V_rel = V_rel + (rates[j] - V_rel[TYPES[joint.type].rate]) * direction
        between = F_a @ C_rel @ inverse(F_b)  # child's frame in the parent's
        V_rel = SE3.Ad(F_b) @ V_rel
        if far == joint.child:
            pose = poses[near] @ between
            twist = SE3.Ad(inverse(between)) @ twists[near] + V_rel
        else:
            pose = poses[near] @ inverse(between)
            twist = SE3.Ad(between) @ (twists[near] - V_rel)
        for target, value, own in zip((poses, twists), (pose, twist), given):
            if far not in own:
                target[far] = value
    return poses, twists


def _relative(scene, frames, j, poses, twists):
    """C_rel (4, 4) and V_rel (6,) of joint j, axes of the child's joint frame."""
    joint, (F_a, F_b) = scene.joints[j], frames[j]
    C_rel = relative_pose(scene, frames, j, poses)
    V_a, V_b = (SE3.Ad(inverse(frame)) @ twists[body] for frame, body in ((F_a, joint.parent), (F_b, joint.child)))
    return C_rel, V_b - SE3.Ad(inverse(C_rel)) @ V_a


def _direction(joint):
    """(6,) relative twist at a joint velocity of 1; 0 for a joint that has not exactly one coordinate."""
    rate, direction = TYPES[joint.type].rate, np.zeros(6)
    if rate is not None:
        direction[rate] = 1.0
        if rate == 2:
            direction[5] = getattr(joint, "pitch", 0.0)
    return direction


def _from_the_roots(scene, wanted, set_bodies):
    """[(joint, body before it, body behind it)] of a spanning tree that contains the wanted joints if possible.

    Roots: the world, then bodies that are set.
    """
    names = [WORLD, *set_bodies, *(body.name for body in scene.bodies)]
    leader = {name: name for name in names}

    def find(name):
        while leader[name] != name:
            name = leader[name]
        return name

    beside = {name: [] for name in names}
    for j in sorted(range(len(scene.joints)), key=lambda j: (j not in wanted, j)):
        a, b = scene.joints[j].parent, scene.joints[j].child
        if find(a) != find(b):
            leader[find(b)] = find(a)
            beside[a].append((j, b))
            beside[b].append((j, a))
    reached = set()
    for root in names:
        pending = [] if root in reached else [root]
        reached.add(root)
        for body in pending:
            for j, far in beside[body]:
                if far not in reached:
                    reached.add(far)
                    pending.append(far)
                    yield j, body, far
