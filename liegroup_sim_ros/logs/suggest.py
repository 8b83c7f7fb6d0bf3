# SPDX-License-Identifier: Apache-2.0
"""Suggested map of a bag: what its topics are in a scene, by their types and names."""

import json
import math
from functools import partial
from types import SimpleNamespace

from .bag import BagError, listed, number_of
from .load import fields_of

STAMPED = {"geometry_msgs/msg/PoseStamped": "pose", "geometry_msgs/msg/TwistStamped": "twist"}
PARTS = ("position", "velocity", "effort")
TARGETS = {"position": "target", "velocity": "target_velocity"}
COMMANDS = "command", "target"  # parts of the names of topics with values that act


def suggest(bag, scene, layout):
    """(text of a map, [note on topics that are left out]) of a Bag and a scene with its Layout."""
    inputs, measurements, notes = [], [], []
    joints = [name for name in layout.coordinates.names]
    efforts = [name for name in layout.unit_efforts if name not in layout.motions]
    moved = {*layout.servos, *(joint for joint, _ in layout.law_efforts)}
    commanded = [
        topic
        for topic, kind in bag.topics.items()
        if kind == "std_msgs/msg/Float64MultiArray" and any(part in topic for part in COMMANDS)
    ]
    for topic, kind in bag.topics.items():
        try:
            first = next(bag.messages(topic), None)
            parts = _joint_parts(bag.messages(topic)) if kind == "sensor_msgs/msg/JointState" else {}
            frames = _frames(bag.messages(topic)) if kind == "tf2_msgs/msg/TFMessage" and "static" not in topic else ()
        except BagError as error:
            notes.append(f"{topic}: {error}")
            continue
        if first is None:
            continue
        before = len(inputs) + len(measurements)
        if kind == "sensor_msgs/msg/JointState" and any(part in topic for part in COMMANDS):
            for joint, name in _matched(list(layout.servos), list(parts)).items():
                for part, what in TARGETS.items():
                    if part in parts[name]:
                        inputs.append((f"{joint}.{what}", topic, f"{part}[{name}]"))
        elif kind == "sensor_msgs/msg/JointState":
            named = _matched(joints, list(parts))
            for joint, name in named.items():
                own, given = parts[name], [each for each, *_ in inputs]
                if joint in layout.motions:
                    if f"{joint}.motion" not in given:
                        inputs.append((f"{joint}.motion", topic, f"position[{name}]"))
                    if "effort" in own:
                        measurements.append((f"{joint}.effort", topic, f"effort[{name}]"))
                    continue
                for part in ("position", "velocity"):
                    if part in own:
                        measurements.append((f"{joint}.{part}", topic, f"{part}[{name}]"))
                if "effort" in own and joint in moved:
                    notes.append(f"{topic}: effort of {name}: a servo or law of the scene makes it: left out")
                elif "effort" in own and joint in efforts and not commanded and f"{joint}.effort" not in given:
                    inputs.append((f"{joint}.effort", topic, f"effort[{name}]"))
            if others := [name for name in parts if name not in named.values()]:
                missing = listed(each for each in joints if each not in named)
                notes.append(f"{topic}: not in the scene: {listed(others)}; not in the bag: {missing}")
                continue
        elif topic in commanded:
            targets, size = list(layout.servos), len(first["data"])
            what, names = ("target", targets) if len(targets) == size else ("effort", efforts[:size])
            inputs += [(f"{joint}.{what}", topic, f"data[{k}]") for k, joint in enumerate(names)]
            notes.append(f"{topic}: has no names: check the order of the joints")
        elif kind == "sensor_msgs/msg/Imu":
            measurements += [(name, topic, "") for name in _sensors(scene, "imu", topic, first)]
        elif kind == "geometry_msgs/msg/WrenchStamped":
            sensors = _sensors(scene, "force_torque", topic, first)
            measurements += [(name, topic, "") for name in sensors]
            body = first["header"]["frame_id"]
            if not sensors and body in layout.body_names:
                inputs.append((f"{body}.wrench", topic, ""))
        elif kind in STAMPED:
            what = STAMPED[kind]
            measurements += [(f"{body}.{what}", topic, what) for body in _named(layout.body_names, topic)]
        elif kind == "nav_msgs/msg/Odometry":
            body = first["child_frame_id"]
            if body in layout.body_names:
                measurements += [(f"{body}.pose", topic, "pose.pose"), (f"{body}.twist", topic, "twist.twist")]
        elif kind == "tf2_msgs/msg/TFMessage":
            for body in layout.body_names:
                if body in frames and not any(name == f"{body}.pose" for name, *_ in measurements):
                    measurements.append((f"{body}.pose", topic, f"transforms[{body}].transform"))
        if len(inputs) + len(measurements) == before:
            names = bag.names(topic)
            own = f"; its names: {listed(names)}" if names else ""
            notes.append(f"{topic} ({kind}): nothing more of the scene found in it{own}")
    known = partial(_is_known, bag, scene, notes)
    return _text([*filter(known, inputs)], [*filter(known, measurements)]), notes


def _is_known(bag, scene, notes, entry):
    """Whether each number of an entry is in some message of its topic; else a note."""
    name, topic, path = entry
    missing = fields_of(SimpleNamespace(output=name, field=path), scene, bag.topics[topic])
    for message in bag.messages(topic):
        missing = [field for field in missing if math.isnan(number_of(field(message)))]
        if not missing:
            return True
    notes.append(f"{topic}: no message has a number {missing[0].text}: without {name}")
    return False


def _joint_parts(messages):
    """{name: its PARTS with a number in some message}; several drivers may publish on one topic."""
    found = {}
    for message in messages:
        known = [(part, [not math.isnan(each) for each in message[part]]) for part in PARTS]
        for k, name in enumerate(message["name"]):
            found.setdefault(name, set()).update(part for part, of in known if any(of[k : k + 1]))
    return found


def _frames(messages):
    """Frames that move in the world."""
    return {
        each["child_frame_id"]
        for message in messages
        for each in message["transforms"]
        if each["header"]["frame_id"] in ("world", "map", "odom")
    }


def _matched(joints, names):
    """{joint: its name in a bag}: the same, or the only one that differs in its prefix, such as r1/wheel."""
    found = {}
    for joint in joints:
        same = joint in names
        alike = [name for name in names if _end(name) == _end(joint) and name not in joints]
        alone = [other for other in joints if _end(other) == _end(joint) and other not in names] == [joint]
        if same or len(alike) == 1 and alone:
            found[joint] = joint if same else alike[0]
    return found


def _end(name):
    return name.rpartition("/")[2]


def _sensors(scene, kind, topic, message):
    """Names of the sensors of a kind that a message may come from: named by its frame or topic, or the only one."""
    known = [sensor.name for sensor in scene.sensors if sensor.type == kind]
    frame = message["header"]["frame_id"]
    found = [name for name in known if name == frame] or _named(known, topic)
    return found or (known if len(known) == 1 else [])


def _named(names, topic):
    """The name that is a part of a topic, if there is one."""
    parts = topic.split("/")
    return [name for name in names if name in parts][:1]


def _text(inputs, measurements):
    lines = []
    for key, what, entries in (("inputs", "input", inputs), ("measurements", "output", measurements)):
        if not entries:
            lines.append(f"{key}: []")
            continue
        lines.append(f"{key}:")
        for name, topic, field in entries:
            path = f", field: {json.dumps(field)}" if field else ""
            lines.append(f"  - {{{what}: {json.dumps(name)}, topic: {json.dumps(topic)}{path}}}")
    lines.append("clocks: []  # delays in s that are known, such as {topic: /imu, delay: 0.004}; others are estimated")
    return "\n".join(lines) + "\n"
