# SPDX-License-Identifier: Apache-2.0
"""Sensors of a robot, from its file or added by the user, as sensors of the scene.

A fixed joint with a force-torque sensor is kept: its links are not merged.
"""

import numpy as np

from liegroup_core.fields.frames import Frame

from .description import ONE_COORDINATE, WORLD, RobotSensor, frame_keys
from .names import unique_names

ENDS = ("parent", "child", "parent_point", "child_point")


def kept_fixed_joints(robot, options):
    """Names of the fixed joints that are not merged: those of `keep` and those with a force-torque sensor.

    Raises SceneError if `keep` contains an unknown joint or a joint that is not fixed.
    """
    types = {joint.name: joint.type for joint in robot.joints}
    for i, name in enumerate(options.keep):
        if name not in types:
            raise options.unknown(("keep", i), "keep: joint", name, types)
        if types[name] != "fixed":
            raise options.error(
                ("keep", i), f'keep: joint "{name}" is {types[name]}, and only fixed joints are merged: omit this name'
            )
    measured = [sensor.joint for sensor in robot.sensors if sensor.type == "force_torque"]
    measured += [each.joint for each in options.sensors if each.type == "force_torque"]
    return {*options.keep, *(name for name in measured if types.get(name) == "fixed")}


def check_kept(options, moving):
    """Refuse a joint of `keep` that is cut or has no mass behind it; moving: names of joints of the scene."""
    for i, name in enumerate(options.keep):
        if name not in moving:
            raise options.error(
                ("keep", i), f'keep: joint "{name}" is cut or has no mass behind it, so it transmits nothing: omit it'
            )


def add_sensors(robot, options, grouping, parts, body_of):
    """Append the sensors of a robot and of a user to SceneParts."""
    joints = {file: scene for (kind, scene), file in parts.names.items() if kind == "joints"}
    taken = {entry["name"] for entry in (*parts.bodies, *parts.joints, *parts.couplings, *parts.forces)} | {
        WORLD,
        *robot.links,
    }  # /tf has frames of links and sensors, so their names must differ
    for i, each in enumerate(options.sensors):
        if each.name in robot.links:
            raise options.error(
                ("sensors", i, "name"),
                f'sensors[{i}] "{each.name}": the robot has a link with this name: choose another',
            )
    own = [each.name for each in options.sensors]
    found = [(robot_sensor, None) for robot_sensor in robot.sensors]
    found += [(_given(each), i) for i, each in enumerate(options.sensors)]
    names = unique_names([each.name for each in robot.sensors], {*taken, *own}) + own
    for name, (sensor, i) in zip(names, found):
        entry, why = _entry(robot, grouping, joints, body_of, sensor)
        if entry is None:
            if i is not None:
                raise options.error(("sensors", i), f'sensors[{i}] "{sensor.name}": {why}')
            robot.leave_out(f"{sensor.type} sensors: {why}", sensor.name)
            continue
        comment = "added" if i is not None else f"line {sensor.line}" if sensor.line else f"of the {robot.kind} file"
        entry = {"name": name, "type": sensor.type} | entry | sensor.values
        parts.add("sensors", entry, sensor.line if i is None else ("sensors", i), comment)


def _entry(robot, grouping, joints, body_of, sensor):
    """(keys of the sensor in a scene, ""), or (None, reason why it is omitted)."""
    if sensor.points:
        return _between(grouping, body_of, sensor)
    if sensor.link is not None:
        group = grouping.of_link.get(sensor.link)
        if group is None:
            return None, f"link {sensor.link!r:.60} does not exist or is cut"
        if group is grouping.world:
            return None, f"link {sensor.link} does not move"
        frame = group.places[sensor.link] @ sensor.frame
        keys = frame_keys(frame)
        always = sensor.type == "pose"
        return {"body": body_of[id(group)]} | ({"frame": keys} if keys or always else {}), ""
    if sensor.joint not in joints:
        return None, f"joint {sensor.joint} is merged, locked or cut"
    joint = next(each for each in robot.joints if each.name == sensor.joint)
    entry = {"joint": joints[sensor.joint]}
    if sensor.type == "encoder":
        if joint.type not in ONE_COORDINATE:
            return None, f"joint {sensor.joint} does not have exactly one coordinate"
        return entry, ""
    if grouping.of_link[joint.child] is grouping.world:
        return None, f"joint {sensor.joint} has the world as child"
    if sensor.frame is not None:
        place = grouping.of_link[joint.child].places[joint.child]
        entry["frame"] = frame_keys(place @ sensor.frame)
    return entry, ""


def _between(grouping, body_of, sensor):
    """As `_entry`, for a distance between points of two links."""
    ends = []
    for link, point in sensor.points:
        group = grouping.of_link.get(link)
        if group is None:
            return None, f"link {link!r:.60} does not exist or is cut"
        place = group.places[link]
        ends.append((body_of[id(group)], place[:3, :3] @ point + place[:3, 3]))
    if ends[0][0] == ends[1][0]:
        return None, "its links move as one body"
    if ends[1][0] == WORLD:  # the second end of a sensor must be on a body, and not in the world
        ends.reverse()
    (parent, first), (child, second) = ends
    return {"parent": parent, "parent_point": first, "child": child, "child_point": second}, ""


def _given(sensor):
    """RobotSensor for a sensor of the additions, which refers to links and joints of the robot."""
    placed = ("name", "type", "body", "joint", "frame", *ENDS)
    keys = [key for key in type(sensor).model_fields if key in sensor.model_fields_set]
    frame = getattr(sensor, "frame", None)
    if frame is None and hasattr(sensor, "body"):
        frame = Frame()
    return RobotSensor(
        sensor.name,
        sensor.type,
        link=getattr(sensor, "body", None),
        joint=getattr(sensor, "joint", None),
        frame=None if frame is None else frame.pose,
        values={key: getattr(sensor, key) for key in keys if key not in placed},
        points=[
            (getattr(sensor, end), np.array(getattr(sensor, f"{end}_point")))
            for end in ENDS[:2]
            if hasattr(sensor, end)
        ],
    )
