# SPDX-License-Identifier: Apache-2.0
"""Joints and forces that a user adds to a robot: keys of a scene, between links of the robot."""

import numpy as np

from liegroup_core.errors import SceneError
from liegroup_core.fields.frames import Frame
from liegroup_core.lie.groups import SE3

from .description import ONE_COORDINATE, WORLD, Coupling, RobotJoint

# {key of a force with a point: key of the link that it is fixed to}
POINTS = {"parent_point": "parent", "child_point": "child", "point": "body"}


def added_joints(options, grouping):
    """[RobotJoint] of the joints of the additions, which close loops.

    A frame that is omitted is where the other one is at the start.
    """
    return [_joint(options, grouping, i, entry) for i, entry in enumerate(options.joints)]


def _joint(options, grouping, i, entry):
    which, frames = options.joint_label.format(i), {}
    for end in ("parent", "child"):
        link = entry.get(end)
        if link not in grouping.of_link:
            raise options.unknown(("joints", i, end), f"{which}: {end}", link, grouping.of_link)
        if entry.get(f"{end}_frame") is not None:
            try:
                frames[end] = Frame.model_validate(entry[f"{end}_frame"]).pose
            except SceneError as error:
                raise options.error(("joints", i, f"{end}_frame"), f"{which}: {error}") from None
            except ValueError:
                raise options.error(
                    ("joints", i, f"{end}_frame"),
                    f"{which}: {end}_frame must be a frame: position, and axis or quaternion",
                ) from None
    poses = {
        end: grouping.of_link[entry[end]].pose @ grouping.of_link[entry[end]].places[entry[end]]
        for end in ("parent", "child")
    }
    for end, other in (("parent", "child"), ("child", "parent")):
        if end not in frames:
            if other not in frames:
                raise options.error(
                    ("joints", i), f"{which}: parent_frame or child_frame is missing"
                )
            frames[end] = SE3.inverse(poses[end]) @ poses[other] @ frames[other]
    parent, child = entry["parent"], entry["child"]
    F_a, F_b = frames["parent"], frames["child"]
    if grouping.of_link[child] is grouping.world:
        if grouping.of_link[parent] is grouping.world:
            raise options.error(
                ("joints", i), f"{which}: neither {parent} nor {child} moves: name other links"
            )
        if entry.get("type") in ("universal",):
            raise options.error(
                ("joints", i, "child"), f"{which}: {child} does not move: exchange the ends"
            )
        parent, child, F_a, F_b = child, parent, F_b, F_a
    if grouping.of_link[parent] is grouping.of_link[child]:
        raise options.error(
            ("joints", i), f"{which}: {parent} and {child} move as one body: name other links"
        )
    known = {"name", "type", "parent", "child", "parent_frame", "child_frame", "pitch", "length"}
    for key in entry:
        if key not in known:
            raise options.error(
                ("joints", i, key), f"{which}: unknown key {key!r:.40} of a closing joint"
            )
    name = entry.get("name")
    if not isinstance(name, str):
        raise options.error(("joints", i), f"{which}: name is missing: give one")
    return RobotJoint(
        name,
        entry.get("type"),
        parent,
        child,
        F_a,
        F_b,
        closes=True,
        pitch=entry.get("pitch", 0.0),
        length=entry.get("length"),
    )


def added_couplings(options, robot):
    """[Coupling] of the additions, with their place there as line. Raises SceneError."""
    types = {joint.name: joint.type for joint in robot.joints}
    for i, entry in enumerate(options.couplings):
        for end in ("joint", "other"):
            name, place = getattr(entry, end), ("couplings", i, end)
            if name not in types:
                raise options.unknown(place, f"couplings[{i}]: {end}", name, types)
            if types[name] not in ONE_COORDINATE:
                raise options.error(
                    place,
                    f'couplings[{i}]: joint "{name}" is {types[name]}: only joints with one '
                    f"coordinate ({', '.join(ONE_COORDINATE)}) can be coupled",
                )
    return [
        Coupling(entry.name, entry.joint, entry.other, entry.ratio, entry.offset, ("couplings", i))
        for i, entry in enumerate(options.couplings)
    ]


def added_forces(options, grouping, parts):
    """[keys of a scene's force] with links and points in the frames of bodies."""
    links = {file: scene for (kind, scene), file in parts.names.items() if kind == "bodies"}
    joints = {file: scene for (kind, scene), file in parts.names.items() if kind == "joints"}
    found = []
    for i, entry in enumerate(options.forces):
        entry = dict(entry)
        places = {}
        for end in ("parent", "child", "body"):
            if end not in entry:
                continue
            name = entry[end]
            if name not in grouping.of_link:
                raise options.unknown(
                    ("forces", i, end), f"forces[{i}]: {end}", name, grouping.of_link
                )
            group = grouping.of_link[name]
            places[end] = group.places[name]
            entry[end] = WORLD if group is grouping.world else links[group.links[0]]
        if "joint" in entry:
            if entry["joint"] not in joints:
                raise options.unknown(
                    ("forces", i, "joint"), f"forces[{i}]: joint", entry["joint"], joints
                )
            entry["joint"] = joints[entry["joint"]]
        for key, end in POINTS.items():
            if key in entry or (key == "point" and "force" in entry and end in places):
                point = np.asarray(entry.get(key, (0.0, 0.0, 0.0)), dtype=float)
                entry[key] = places[end][:3, :3] @ point + places[end][:3, 3]
        if "body" in entry and entry.get("axes", "body") == "body":
            for key in ("force", "torque"):
                if key in entry:
                    entry[key] = places["body"][:3, :3] @ np.asarray(entry[key], dtype=float)
        found.append(entry)
    return found
