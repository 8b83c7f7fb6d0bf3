# SPDX-License-Identifier: Apache-2.0
"""State in which some bodies have given poses or twists; the others follow through their joints.

The steps are those of assembly: the nearest poses that satisfy all joints, then the change of
velocities of least kinetic energy. Bodies without a path of joints to one that is set are not
touched.

What is given is kept. If the joints do not allow that, it may change by ROUNDED: the digits that
single precision, or a number printed for people, has lost.
"""

import numpy as np

from liegroup_core.errors import SceneError
from liegroup_core.joints.linkage import Linkage

from .assembly import cannot_close, consistent_velocities
from .consistency import resolve_couplings, resolve_elements, resolve_frames
from .description import WORLD

# Largest change of what is given: rad, and relative to the distances and velocities involved.
ROUNDED = 1e-6


def rearranged(scene, pose, twist, poses, twists):
    """Nearest consistent state with the given poses and twists: pose (n, 12), twist (n, 6).

    scene  : with body frames at the centres of mass (scene.centres), like all states here
    pose, twist   : (n, 12), (n, 6) present state
    poses, twists : {body: (12,)}, {body: (6,)} of the bodies that are set
    Raises SceneError with the joint that cannot be satisfied and its residual.
    """
    place = {body.name: i for i, body in enumerate(scene.bodies)}
    pose, twist = np.array(pose, dtype=float), np.array(twist, dtype=float)
    for target, given in ((pose, poses), (twist, twists)):
        for body, values in given.items():
            target[place[body]] = values
    couplings, frames, parts = (
        resolve(scene) for resolve in (resolve_couplings, resolve_frames, resolve_elements)
    )
    everything = range(len(scene.joints))
    joints = everything if couplings else _connected(scene.joints, {*poses, *twists})
    start = {body: _matrix(pose[i]) for body, i in place.items()} | {WORLD: np.eye(4)}

    def linked(held=()):
        linkage = Linkage(scene, frames, parts, joints, held, couplings)
        linkage.start = start
        return linkage

    free = linked()
    found = _closed(linked(poses.keys()), free, start, poses)
    for body in free.bodies:
        if found[body] is not start[body]:
            pose[place[body]] = np.concatenate([found[body][:3, :3].ravel(), found[body][:3, 3]])
    given = {body: twist[i].copy() for body, i in place.items()}
    moving = _moving(scene, given, free, found, set(twists))
    for body in free.bodies:
        twist[place[body]] = moving[body]
    return pose, twist


def _closed(held, free, start, given):
    """Poses that satisfy all joints: with the given bodies held, or moved by ROUNDED."""
    found = held.nearest(start)
    if held.is_closed(found):
        return found
    rounded = free.nearest(start)
    moved = [np.abs(rounded[body] - start[body]) for body in given]
    far = max((np.abs(start[body][:3, 3]).max() for body in given), default=0.0)
    turns = max((change[:3, :3].max() for change in moved), default=0.0)
    shifts = max((change[:3, 3].max() for change in moved), default=0.0)
    if free.is_closed(rounded) and turns <= ROUNDED and shifts <= ROUNDED * max(far, free.length):
        return rounded
    raise cannot_close(held, found)


def _moving(scene, given, linkage, poses, fixed):
    """Twists {body: (6,)} that satisfy all joints: with those of `fixed`, or changed by ROUNDED."""
    try:
        return consistent_velocities(scene, given, linkage, poses, {}, fixed)
    except SceneError:
        found = consistent_velocities(scene, given, linkage, poses, {}, set())
        most = ROUNDED * max(np.abs(given[body]).max() for body in linkage.bodies)
        if any(np.abs(found[body] - given[body]).max() > most for body in fixed):
            raise
        return found


def _connected(joints, bodies):
    """Indices of the joints of all bodies that joints connect to some bodies, not via the world."""
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


def _matrix(row):
    """(4, 4) of a pose (12,)."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = row[:9].reshape(3, 3), row[9:]
    return matrix
