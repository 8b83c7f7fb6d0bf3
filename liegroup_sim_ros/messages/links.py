# SPDX-License-Identifier: Apache-2.0
"""Links of a scene, and the URDF joints between them, for /tf and ~/robot_description.

A robot has the links of its file; in other scenes bodies are links. In URDF the axis of a joint passes
through the origin of the child's frame, so a hinge with another axis needs an additional link.
"""

from typing import NamedTuple

import numpy as np

from liegroup_core.joints.linkage import inverse
from liegroup_core.observables.along import quaternions
from liegroup_core.scene.consistency import resolve_frames

WORLD = "world"
URDF_TYPES = {"revolute": "continuous", "prismatic": "prismatic", "fixed": "fixed"}
# Distance of an axis from an origin that counts as zero, relative to the largest coordinate: round-off.
BESIDE = 1e-14


def places_of(poses):
    """[[x, y, z, qx, qy, qz, qw]] of poses (k, 4, 4)."""
    rows = np.hstack([poses[:, :3, :3].reshape(-1, 9), poses[:, :3, 3]])
    return np.hstack([rows[:, 9:], quaternions(rows)]).tolist()


def placer(layout, owners, local):
    """Function sample -> places_of frames (k, 4, 4) in bodies or the world, whose names are the owners."""
    # The world has the index after the last body.
    number = {body: i for i, body in enumerate(layout.body_names)}
    owners, local = [number.get(name, len(number)) for name in owners], np.array(local)
    return lambda sample: places_of(np.concatenate([sample.pose_matrices, np.eye(4)[None]])[owners] @ local)


class UrdfJoint(NamedTuple):
    """Joint of a URDF: child pose = parent pose, then `origin` (4, 4), then the motion along or about `axis`."""

    name: str
    type: str
    parent: str
    child: str
    origin: np.ndarray
    axis: np.ndarray | None = None
    data: dict | None = None


def link_of_body(scene):
    """{body or world: link whose frame is that of the body}."""
    names = {body.name: body.name for body in scene.bodies} | {WORLD: WORLD}
    return names if scene.robot is None else names | scene.robot.links


def merged_links(scene):
    """{link: (its body, (4, 4) pose in the body frame)} of moving links with a frame other than the body's."""
    if scene.robot is None:
        return {}
    own = {*link_of_body(scene).values(), *(body.name for body in scene.bodies)}
    return {
        link: (body, place) for link, (body, place) in scene.robot.frames.items() if body != WORLD and link not in own
    }


def links_and_joints(scene):
    """({link: (body or world, (4, 4) pose in the frame of the body)}, [UrdfJoint]) of a scene.

    The joints form a tree from the world: joints with one angle or displacement, named as in
    ~/joint_states, and fixed joints. Links that these do not reach are floating.
    """
    robot = scene.robot
    links = {body.name: (body.name, np.eye(4)) for body in scene.bodies}
    main, labels = link_of_body(scene), {}
    if robot is not None:
        links, labels = dict(robot.frames), robot.joints
        if robot.text:
            return links, []
    tree = [
        UrdfJoint(f"{link}_fixed", "fixed", main[body], link, place)
        for link, (body, place) in links.items()
        if link != main[body]
    ]
    beside = {}
    for joint, (A, B) in zip(scene.joints, resolve_frames(scene)):
        if joint.type in URDF_TYPES:
            beside.setdefault(joint.parent, []).append((joint, joint.child, A, B, 1.0))
            beside.setdefault(joint.child, []).append((joint, joint.parent, B, A, -1.0))
    reached = set()
    for start in (WORLD, *(body.name for body in scene.bodies)):
        if start in reached:
            continue
        if start != WORLD:
            name = _unused(f"{main[start]}_to_world", {joint.name for joint in tree})
            tree.append(UrdfJoint(name, "floating", WORLD, main[start], np.eye(4)))
        reached.add(start)
        pending = [start]
        for near in pending:
            for joint, far, A, B, sign in beside.get(near, ()):
                if far not in reached:
                    reached.add(far)
                    pending.append(far)
                    label = labels.get(joint.name, joint.name)
                    tree += _joint(links, joint, label, (main[near], main[far]), far, A, B, sign)
    return links, tree


def _joint(links, joint, label, ends, body, A, B, sign):
    """UrdfJoints of a joint with frames A and B in its near and far link; adds a link if it is needed."""
    near, far = ends
    axis, at = sign * B[:3, 2], B[:3, 3]
    kind, data = URDF_TYPES[joint.type], joint.data or {}
    if kind == "fixed":
        return [UrdfJoint(label, kind, near, far, A @ inverse(B))]
    if kind == "prismatic" or np.abs(np.cross(at, axis)).max() <= BESIDE * np.abs(at).max():
        return [UrdfJoint(label, kind, near, far, A @ inverse(B), axis, data)]
    middle = _unused(f"{label}_frame", links)
    links[middle] = (body, B)
    return [
        UrdfJoint(label, kind, near, middle, A, np.array([0.0, 0.0, sign]), data),
        UrdfJoint(f"{middle}_fixed", "fixed", middle, far, inverse(B)),
    ]


def _unused(name, taken):
    while name in taken:
        name += "_"
    return name
