# SPDX-License-Identifier: Apache-2.0
"""Joints, couplings and forces that a user adds between links or joints of a robot."""

import numpy as np

from liegroup_core.lie.groups import SE3

from .description import ONE_COORDINATE, WORLD, Relation, RobotJoint
from .names import scene_name

# {key of a force with a point: key of the link that the point is fixed to}
POINTS = {"parent_point": "parent", "child_point": "child", "point": "body"}
SAME_AXES = 1e-12  # of rotation matrices that differ by round-off


def added_joints(options, grouping):
    """[RobotJoint] of the added joints, which close loops.

    An omitted frame coincides with the other frame at the start.
    """
    names = {joint.name for joint in grouping.robot.joints}
    found = [_joint(options, grouping, i, given, names) for i, given in enumerate(options.joints)]
    return found + [_wheel(options, grouping, name, radius) for name, radius in options.roll.items()]


def _wheel(options, grouping, name, radius):
    """RobotJoint with which the child of a joint rolls on the plane z = 0 of the world."""
    joints = {joint.name: joint for joint in grouping.robot.joints}
    if name not in joints:
        raise options.unknown(("roll", name), "roll: joint", name, joints)
    joint = joints[name]
    if joint.type != "revolute":
        raise options.error(("roll", name), f'roll: joint "{name}" is {joint.type}: only revolute joints turn a wheel')
    if grouping.of_link[joint.child] is grouping.world:
        raise options.error(("roll", name), f'roll: the child of joint "{name}" does not move')
    if grouping.of_link[joint.parent] is grouping.world:
        raise options.error(
            ("roll", name),
            f'roll: the axis of joint "{name}" is fixed to the world, where its child cannot roll: give base: floating '
            "(--base floating)",
        )
    return RobotJoint(
        scene_name(f"{name}_contact"),
        "wheel",
        WORLD,
        joint.child,
        np.eye(4),
        joint.child_frame,
        closes=True,
        radius=radius,
    )


def added_drive(options, parts):
    """Drive of the scene as a mapping, with names of its joints, or None; options.drive has those of the robot."""
    if options.drive is None:
        return None
    names = {file: name for (key, name), file in parts.names.items() if key == "joints"}
    sides = {}
    for side in ("left", "right"):
        for name in getattr(options.drive, side):
            if name not in names:
                raise options.unknown(("drive", side), f"drive: {side}: joint", name, names)
        sides[side] = [names[name] for name in getattr(options.drive, side)]
    return sides | ({} if options.drive.radius is None else {"radius": options.drive.radius})


def _joint(options, grouping, i, given, names):
    which = options.joint_label.format(i)
    if given.name in names:
        raise options.error(
            ("joints", i, "name"), f'{which}: the robot has a joint with the name "{given.name}": choose another'
        )
    _check_ends(options, grouping, ("joints", i), which, given)
    frames, poses = {}, {}
    for end in ("parent", "child"):
        link, frame = getattr(given, end), getattr(given, f"{end}_frame")
        group = grouping.of_link[link]
        poses[end] = group.pose @ group.places[link]
        frames[end] = None if frame is None else frame.pose
    for end, other in (("parent", "child"), ("child", "parent")):
        if frames[end] is None:
            frames[end] = SE3.inverse(poses[end]) @ poses[other] @ frames[other]
    return RobotJoint(
        given.name,
        given.type,
        given.parent,
        given.child,
        frames["parent"],
        frames["child"],
        closes=True,
        pitch=getattr(given, "pitch", 0.0),
        length=getattr(given, "length", None),
        radius=getattr(given, "radius", None),
        mu=getattr(given, "mu", None),
        frictionless=getattr(given, "frictionless", None),
        coordinate=given.coordinate,
        rate=given.rate,
        data=dict(given.data or {}),
    )


def _check_ends(options, grouping, place, which, given):
    """Refuse an entry with unknown links, or with two links that do not move relative to each other."""
    ends = [end for end in ("parent", "child", "body") if hasattr(given, end)]
    for end in ends:
        if getattr(given, end) not in grouping.of_link:
            name = getattr(given, end)
            raise options.unknown((*place, end), f"{which}: {end}", name, grouping.of_link)
    links = [getattr(given, end) for end in ends]
    groups = [grouping.of_link[link] for link in links]
    if len(groups) == 2 and groups[0] is groups[1]:
        raise options.error(place, f"{which}: {links[0]} and {links[1]} move as one body: choose other links")
    if ends == ["body"] and groups[0] is grouping.world:
        raise options.error((*place, "body"), f"{which}: {links[0]} does not move: choose another link")


def added_couplings(options, robot):
    """[Relation] of the additions; `line` is the path inside the additions. Raises SceneError."""
    types = {joint.name: joint.type for joint in robot.joints}
    for i, entry in enumerate(options.couplings):
        ends = (("joint", entry.joint), ("other", entry.other), *(("terms", name) for name in entry.terms))
        for end, name in ends:
            place = ("couplings", i, end)
            if name not in types:
                raise options.unknown(place, f"couplings[{i}]: {end}", name, types)
            if types[name] not in ONE_COORDINATE:
                raise options.error(
                    place,
                    f'couplings[{i}]: joint "{name}" is {types[name]}: only joints with one '
                    f"coordinate ({', '.join(ONE_COORDINATE)}) can be coupled",
                )
    keys = ("name", "joint", "other", "ratio", "offset")
    given = [(e, e.backlash.model_dump(exclude_none=True) if e.backlash else {}) for e in options.couplings]
    return [
        Relation(*(getattr(e, key) for key in keys), ("couplings", i), e.curve, e.terms, backlash)
        for i, (e, backlash) in enumerate(given)
    ]


def added_forces(options, grouping, parts):
    """[keys of a force of a scene]: the added forces, with bodies for links and points in body frames."""
    links = {file: scene for (kind, scene), file in parts.names.items() if kind == "bodies"}
    joints = {file: scene for (kind, scene), file in parts.names.items() if kind == "joints"}
    still = {joint.name for joint in grouping.robot.joints} - joints.keys()

    def joint_of(place, which, name):
        if name in still:
            raise options.error(place, f'{which}: joint "{name}" is fixed or locked')
        if name not in joints:
            raise options.unknown(place, f"{which}: joint", name, joints)
        return joints[name]

    found = []
    for i, given in enumerate(options.forces):
        which, place = f'forces[{i}] "{given.name}"', ("forces", i)
        if given.type == "law":
            found.append(_law(options, grouping, place, which, given, links, joint_of))
            continue
        _check_ends(options, grouping, place, which, given)
        keys = {"name", "type"} | given.model_fields_set
        entry = {key: getattr(given, key) for key in type(given).model_fields if key in keys}
        if "joint" in entry:
            entry["joint"] = joint_of((*place, "joint"), which, given.joint)
        for key, end in POINTS.items():
            if hasattr(given, key):
                pose = grouping.of_link[getattr(given, end)].places[getattr(given, end)]
                entry[key] = pose[:3, :3] @ getattr(given, key) + pose[:3, 3]
        if getattr(given, "axes", "") == "body":
            pose = grouping.of_link[given.body].places[given.body]
            for key in ("force", "torque"):
                entry[key] = pose[:3, :3] @ getattr(given, key)
        for end in ("parent", "child", "body"):
            if end in entry:
                group = grouping.of_link[entry[end]]
                entry[end] = WORLD if group is grouping.world else links[group.links[0]]
        if entry.get("child") == WORLD:  # in a scene, the child of a force must be a body
            for key in ("", "_point"):
                ends = (f"parent{key}", f"child{key}")
                entry |= dict(zip(ends, [entry[end] for end in reversed(ends)]))
        found.append(entry)
    return found


def _law(options, grouping, place, which, given, links, joint_of):
    """Keys of a law of a scene, with the joints and bodies of the scene in its inputs and outputs."""
    entry = given.model_dump(exclude_unset=True) | {"type": "law"}

    def at_link(place, which, name, point, in_its_axes):
        """(body, point in its frame) of a point of a link."""
        if name not in grouping.of_link:
            raise options.unknown(place, which, name, grouping.of_link)
        group = grouping.of_link[name]
        if group is grouping.world:
            raise options.error(place, f"{which} {name} does not move: choose another link")
        pose, body = group.places[name], links[group.links[0]]
        if in_its_axes and np.abs(pose[:3, :3] - np.eye(3)).max() > SAME_AXES:
            raise options.error(place, f"{which} {name} is part of {body}, which has other axes: take {body}")
        return body, pose[:3, :3] @ (np.zeros(3) if point is None else point) + pose[:3, 3]

    for name, each in given.inputs.items():
        owner, _, part = each.quantity.rpartition(".")
        at = (*place, "inputs", name)
        if part in ("position", "velocity"):
            entry["inputs"][name]["quantity"] = f"{joint_of(at, which, owner)}.{part}"
        elif part[:-1] in ("", "q", "w", "v") and part[-1:] in tuple("xyzw") and owner in grouping.of_link:
            body, point = at_link(at, f"{which}: inputs.{name}: link", owner, each.point, part not in tuple("xyz"))
            entry["inputs"][name] = {"quantity": f"{body}.{part}"}
            if part[:-1] in ("", "v"):
                entry["inputs"][name]["point"] = point
    for k, each in enumerate(given.outputs):
        at = (*place, "outputs", k)
        if each.body is None:
            entry["outputs"][k]["joint"] = joint_of((*at, "joint"), which, each.joint)
        else:
            body, point = at_link((*at, "body"), f"{which}: body", each.body, each.point, each.axes == "body")
            entry["outputs"][k].update(body=body, point=point)
    return entry
