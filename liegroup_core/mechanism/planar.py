# SPDX-License-Identifier: Apache-2.0
"""Detection of planar mechanisms.

A joint is planar if it allows only planar motions: a revolute joint about the normal, a prismatic or planar
joint in the plane, a fixed joint. If such joints connect every
body to the world, no body can leave the plane, for any wrench and any inertia: their constraint
wrenches balance all other loads. The spanning tree consists of these joints. All other joints close
loops; only the part of their rows in the plane remains.
"""

import numpy as np

from liegroup_core.joints.elements import PAIR
from liegroup_core.joints.stops import CONE, DISTANCE
from liegroup_core.scene.switches import switches_of

from .spanning_tree import WORLD_NAME

# Directions that differ by less are parallel, up to round-off.
PARALLEL = 1e-12
TURNS, SLIDES = ("revolute", "planar"), ("prismatic",)
# Reverses the z axis of a frame.
FLIP = np.diag([1.0, -1.0, -1.0, 1.0])


def find_plane(scene, frames, parts):
    """(normal, planar joints) of a planar mechanism, else None.

    scene  : Scene with body frames at the centres of mass
    frames : its joint frames, see scene/consistency.py
    parts  : elements of its joints
    """
    if any(_leaves_plane(switch) for switch in switches_of(scene)):
        return None
    poses = {body.name: body.pose for body in scene.bodies} | {WORLD_NAME: np.eye(4)}
    axes = [(poses[joint.child] @ F_b)[:3, 2] for joint, (_, F_b) in zip(scene.joints, frames)]
    axes = np.reshape(axes, (-1, 3))
    types = np.array([joint.type for joint in scene.joints], dtype=str)
    turns, slides = np.isin(types, TURNS), np.isin(types, SLIDES)
    for normal in _candidates(axes[turns], axes[slides]):
        normal_to = np.abs(np.cross(axes, normal)).max(axis=1) <= PARALLEL
        within = np.abs(axes @ normal) <= PARALLEL
        joints = np.flatnonzero((types == "fixed") | (turns & normal_to) | (slides & within)).tolist()
        if len(joints) >= len(scene.bodies) and _connect(scene, joints):
            cut = (part for j, of in enumerate(parts) if j not in joints for part in of)
            return (normal, joints) if all(part.kind == PAIR for part in cut) else None
    return None


def _leaves_plane(switch):
    """True if stops or friction need a model in space: loads, for one, have components normal to the plane."""
    by_load = switch.friction is not None and switch.friction.by_load[1] > 0.0
    return by_load or switch.kind in (CONE, DISTANCE)


def _candidates(turns, slides):
    """Candidates for the unit normal of the plane; world axes are exact.

    turns, slides : (k, 3) axes of the joints that rotate, and of those that slide
    """
    found = turns
    if not len(turns):
        found = np.eye(3)[::-1]
        if len(slides):
            across = np.cross(slides[0], [*slides[1:], *np.eye(3)])
            found = np.concatenate([found, across[np.linalg.norm(across, axis=1) > 0.5]])
    found = found / np.linalg.norm(found, axis=1)[:, None]
    near = np.round(found)
    exact = np.abs(found - near).max(axis=1) <= PARALLEL
    found[exact] = near[exact]
    largest = np.abs(found).argmax(axis=1)[:, None]
    found = found * np.sign(np.take_along_axis(found, largest, axis=1)) + 0.0
    normals = []
    while len(found):
        normals.append(found[0])
        found = found[np.abs(found - found[0]).max(axis=1) > PARALLEL]
    return normals


def _connect(scene, joints):
    """True if these joints connect every body to the world."""
    reached, last = {WORLD_NAME}, 0
    pairs = [{scene.joints[j].parent, scene.joints[j].child} for j in joints]
    while len(reached) > last:
        last = len(reached)
        for pair in pairs:
            if reached & pair:
                reached |= pair
    return len(reached) == len(scene.bodies) + 1


def plane_axes(normal):
    """Axes of the plane as columns (3, 3), right-handed, the normal last; world axes if possible."""
    k = int(np.abs(normal).argmin())
    if np.abs(normal).max() == 1.0:
        # A permutation: no round-off.
        k = (int(np.abs(normal).argmax()) + 1) % 3
    first = np.eye(3)[k] - normal[k] * normal
    first /= np.linalg.norm(first)
    return np.column_stack([first, np.cross(normal, first), normal]) + 0.0


def align(pose):
    """Make the pose of a body in its link exact, in place, if the normal is an axis of the body.

    Then a body with the axes of the plane does not leave it even by round-off.
    """
    near = np.round(pose[2, :3])
    if np.abs(pose[2, :3] - near).max() <= PARALLEL:
        pose[2, :3] = near
        pose[:2, np.abs(near).argmax()] = 0.0


def frame_in_plane(kind, axis_frame, normal):
    """Frame (4, 4), relative to that of a joint, with the normal as z axis.

    kind       : type of the joint; the axis of a prismatic joint becomes the x axis
    axis_frame : rotation (3, 3) of the joint frame in the world
    """
    if kind in TURNS:
        return np.eye(4) if axis_frame[:, 2] @ normal > 0.0 else FLIP
    across = axis_frame.T @ normal
    across[2] = 0.0
    across /= np.linalg.norm(across)
    frame = np.eye(4)
    x = np.array([0.0, 0.0, 1.0])
    frame[:3, :3] = np.column_stack([x, np.cross(across, x), across])
    return frame
