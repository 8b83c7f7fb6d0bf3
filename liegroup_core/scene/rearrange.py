# SPDX-License-Identifier: Apache-2.0
"""Consistent state with given poses or twists of bodies, or given coordinates or rates of joints.

The other bodies follow through their joints. First, the bodies behind a given joint move with it
(carried.py). Then come the steps of assembly: the nearest poses that satisfy all joints, and the change
of velocities with the least kinetic energy. Bodies that no path of joints connects to a given value stay
unchanged.

Given values are kept. If the joints do not permit them, they may change by ROUNDED, because single
precision and printed numbers have lost digits.
"""

import numpy as np

from liegroup_core.errors import SceneError
from liegroup_core.joints.coupling import rate_row, turns
from liegroup_core.joints.linkage import Linkage
from liegroup_core.lie.groups import within_a_turn
from liegroup_core.threads import one_blas_thread

from .assembly import cannot_close, consistent_velocities, not_kept, with_nearest_coordinates
from .carried import carried, coordinates_at, with_coupled
from .centres import pose_matrix
from .consistency import ResolvedCoupling, resolve_elements, resolve_frames, rigid_couplings
from .description import WORLD

# Largest change of given values, in rad or relative to the distances and velocities involved.
ROUNDED = 1e-6
# Smallest step towards given coordinates, as a fraction of the whole change.
SMALLEST_STEP = 1.0 / 16


@one_blas_thread()
def rearranged(scene, pose, twist, poses, twists, joints=None, angles=None, driven=None):
    """Nearest consistent state with the given values.

    scene  : with body frames at the centres of mass (scene.centres), like all states here
    pose, twist   : (n, 12), (n, 6) present state
    poses, twists : {body: (12,)}, {body: (6,)} of the bodies that are set
    joints : {joint: (coordinate, rate)} of the joints that are set, rad or m; None: not given
    angles : {joint: rad} present unwrapped angles
    driven : {joint: rate} of driven joints, kept where the given values permit it
    returns pose (n, 12), twist (n, 6), {joint: rad}: angles within half a turn of the new unwrapped ones
    If given coordinates cannot be reached in one step, they are approached in several.
    Raises SceneError with the joint that cannot be satisfied and its residual.
    """
    present, angles, driven = (pose, twist), angles or {}, driven or {}
    try:
        return _at_once(scene, *present, poses, twists, joints or {}, angles, driven)
    except SceneError:
        # Intermediate states are defined for joint coordinates only, not for poses of bodies.
        if poses or twists or not any(q is not None for q, _ in (joints or {}).values()):
            raise
        found = _in_steps(scene, *present, joints, angles, driven)
        if found is None:
            raise
        return found


def _in_steps(scene, pose, twist, joints, angles, driven):
    """As _at_once, in several steps from the present to the given coordinates; None if this fails.

    A joint without an unwrapped angle takes the shorter direction. A step that fails is halved.
    """
    numbers = {joint.name: j for j, joint in enumerate(scene.joints)}
    poses = {body.name: pose_matrix(row) for body, row in zip(scene.bodies, pose)}
    near = {numbers[name]: angle for name, angle in angles.items()}
    moved = {numbers[name]: q for name, (q, _) in joints.items() if q is not None}
    begin = coordinates_at(scene, resolve_frames(scene), poses | {WORLD: np.eye(4)}, moved.keys(), near)
    ways = {
        j: within_a_turn(q - begin[j], 0.0) if turns(scene.joints[j]) and j not in near else q - begin[j]
        for j, q in moved.items()
    }
    done, step = 0.0, 0.5
    while done < 1.0:
        part = min(1.0, done + step)
        between = {scene.joints[j].name: (begin[j] + part * ways[j], None) for j in moved}
        try:
            pose, twist, angles = _at_once(
                scene, pose, twist, {}, {}, joints if part == 1.0 else between, angles, driven
            )
        except SceneError:
            step /= 2.0
            if step < SMALLEST_STEP:
                return None
        else:
            done = part
    return pose, twist, angles


def _at_once(scene, pose, twist, poses, twists, joints, angles, driven):
    """As `rearranged`, in one step."""
    place = {body.name: i for i, body in enumerate(scene.bodies)}
    pose, twist = np.array(pose, dtype=float), np.array(twist, dtype=float)
    before = [
        {body: pose_matrix(pose[i]) for body, i in place.items()} | {WORLD: np.eye(4)},
        {body: twist[i].copy() for body, i in place.items()} | {WORLD: np.zeros(6)},
    ]
    set_parts = {body: pose_matrix(row) for body, row in poses.items()}, twists
    start, given = (old | part for old, part in zip(before, set_parts))
    couplings, frames, parts = (resolve(scene) for resolve in (rigid_couplings, resolve_frames, resolve_elements))
    number = {joint.name: j for j, joint in enumerate(scene.joints)}
    near = {number[name]: angle for name, angle in angles.items()}
    # The turns of a coupled joint follow from the turns of the other joint.
    others = coordinates_at(scene, frames, before[0], {j for e in couplings for j in e.joints[1:]}, near)
    near = {e.joint: e.rise(others) + e.offset for e in couplings} | near
    wanted, rates = ({number[name]: pair[k] for name, pair in joints.items() if pair[k] is not None} for k in (0, 1))
    if joints:
        now = coordinates_at(scene, frames, before[0], wanted, near)
        local = [e.counted_from(others) for e in couplings]
        changes = with_coupled(local, {j: wanted[j] - now[j] for j in wanted})
        # Of several joints that may follow, the further ones stay.
        stay = {j: 0.0 for e in local if e.joint in changes for j, _ in e.further}
        changes = with_coupled(local, stay | changes)
        local = [e.counted_from(others | dict.fromkeys(others, 0.0) | changes)._replace(curve=()) for e in local]
        near |= {j: near[j] + change for j, change in changes.items() if j in near}
        start, given = carried(scene, frames, before, set_parts, changes, with_coupled(local, rates))
    ends = {end for j in (*wanted, *rates) for end in (scene.joints[j].parent, scene.joints[j].child)}
    everything = range(len(scene.joints))
    bodies = {*poses, *twists, *ends} - {WORLD}
    numbers = everything if couplings else _connected(scene.joints, bodies)
    couplings = counted_couplings(scene, frames, start, couplings, near)
    # A prescribed coordinate is a coupling of ratio 0.
    at = {j: i for i, j in enumerate(numbers)}
    kept = [ResolvedCoupling(at[j], at[j], 0.0, value) for j, value in wanted.items()]

    def linked(held=(), kept=()):
        linkage = Linkage(scene, frames, parts, numbers, held, [*couplings, *kept])
        linkage.start = start
        return linkage

    free = linked()
    found = _closed(linked, free, start, poses, kept)
    for body in {*free.bodies, *poses}:
        pose[place[body]] = np.concatenate([found[body][:3, :3].ravel(), found[body][:3, 3]])
    driven = {
        at[number[name]]: rate for name, rate in driven.items() if number[name] in at and number[name] not in rates
    }
    rates = {at[j]: rate for j, rate in rates.items()}
    moving = _moving(scene, given, free, found, set(twists), rates, driven)
    for body in {*free.bodies, *twists}:
        twist[place[body]] = moving[body]
    return pose, twist, {scene.joints[j].name: angle for j, angle in near.items()}


def counted_couplings(scene, frames, poses, couplings, near):
    """Couplings with offsets that refer to angles of the other joints in (-pi, pi] at these poses.

    near : {j: rad} approximate unwrapped angles, within half a turn
    """
    others = {j for entry in couplings for j in entry.joints[1:]}
    principal, unwrapped = (coordinates_at(scene, frames, poses, others, angles) for angles in ({}, near))
    turned = {j: unwrapped[j] - principal[j] for j in others}
    return [entry.counted_from(turned) if any(turned[j] for j in entry.joints[1:]) else entry for entry in couplings]


def _closed(linked, free, start, given, kept):
    """Poses that satisfy all joints, with the given poses and coordinates kept or changed by up to ROUNDED.

    linked : function (bodies to hold, coordinates to keep) -> Linkage
    """
    held = linked(given.keys(), kept)
    found = held.nearest(start)
    if held.is_closed(found):
        return found
    rounded = free.nearest(start)
    moved = [np.abs(rounded[body] - start[body]) for body in given]
    far = max((np.abs(start[body][:3, 3]).max() for body in given), default=0.0)
    offs = [abs(free.coupling_gap(entry, rounded)) for entry in kept]
    angular = [turns(free.joints[entry.joint]) for entry in kept]
    rotations = [off for off, turned in zip(offs, angular) if turned]
    shifts = [off for off, turned in zip(offs, angular) if not turned]
    rotations += [change[:3, :3].max() for change in moved]
    shifts += [change[:3, 3].max() for change in moved]
    if (
        free.is_closed(rounded)
        and max(rotations, default=0.0) <= ROUNDED
        and max(shifts, default=0.0) <= ROUNDED * max(far, free.length)
    ):
        return rounded
    if kept:
        without = linked(given.keys())
        nearest = with_nearest_coordinates(without, found, kept)
        if without.is_closed(nearest):
            raise not_kept(without, nearest, kept)
        held, found = without, nearest
    raise cannot_close(held, found)


def _moving(scene, given, linkage, poses, fixed, rates, driven):
    """Twists {body: (6,)} that satisfy all joints, with those of `fixed` kept or changed by up to ROUNDED.

    rates  : {index of a joint of the linkage: rate}, kept in the same way
    driven : {index: rate} of driven joints, kept unless the other values prevent it
    """

    def solved(kept):
        return consistent_velocities(scene, given, linkage, poses, rates | kept, fixed)

    try:
        return solved(driven)
    except SceneError:
        kept = {}
        for i, rate in driven.items():
            try:
                solved(kept | {i: rate})
            except SceneError:
                continue
            kept[i] = rate
    try:
        return solved(kept)
    except SceneError:
        found = consistent_velocities(scene, given, linkage, poses, {}, set())
        sizes = [np.abs(given[body]).max() for body in linkage.bodies]
        most = ROUNDED * max([*sizes, *map(abs, rates.values())])
        changes = [np.abs(found[body] - given[body]).max() for body in fixed]
        V = np.concatenate([found[body] for body in linkage.bodies])
        for i, rate in rates.items():
            rows = [np.zeros((0, 6))] * len(linkage.joints)
            rows[i] = rate_row(linkage.joints[i], linkage.frames[i][1])[None]
            changes.append(abs((linkage.relative_rows(poses, rows) @ V)[0] - rate))
        if max(changes, default=0.0) > most:
            raise
        return found


def _connected(joints, bodies):
    """Indices of all joints of the bodies that are connected to `bodies` by joints, not via the world."""
    found, reached = set(), set(bodies)
    before = None
    while len(found) != before:
        before = len(found)
        for j, joint in enumerate(joints):
            ends = {joint.parent, joint.child} - {WORLD}
            if j not in found and ends & reached:
                found.add(j)
                reached |= ends
    return sorted(found)
