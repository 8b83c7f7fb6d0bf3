# SPDX-License-Identifier: Apache-2.0
"""Bags of logs, written by rosbags: what `ros2 bag record` would have recorded."""

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_JAZZY)
TYPES = STORE.types
START_NS = 1_700_000_000 * 10**9


def header(time_ns, frame=""):
    """std_msgs/Header."""
    stamp = TYPES["builtin_interfaces/msg/Time"](sec=time_ns // 10**9, nanosec=time_ns % 10**9)
    return TYPES["std_msgs/msg/Header"](stamp=stamp, frame_id=frame)


def write_bag(path, topics, plugin=StoragePlugin.MCAP):
    """Write a bag of {topic: (type, [(ns, message)])}."""
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        connections = {name: writer.add_connection(name, kind, typestore=STORE) for name, (kind, _) in topics.items()}
        rows = [
            (time_ns, name, STORE.serialize_cdr(message, kind))
            for name, (kind, messages) in topics.items()
            for time_ns, message in messages
        ]
        for time_ns, name, data in sorted(rows, key=lambda row: row[0]):
            writer.write(connections[name], time_ns, data)


def topics_of(log):
    """Topics of a Log: one JointState, and the efforts in one Float64MultiArray, whose times are those of recording."""
    (measured,) = log.measured
    joints = list(dict.fromkeys(name.rpartition(".")[0] for name in measured.channels))[::-1]
    column = {name: values for name, values in zip(measured.channels, measured.values.T)}
    states = []
    for k, time in enumerate(measured.times):
        time_ns = START_NS + round(time * 1e9)
        parts = [np.array([column[f"{joint}.{part}"][k] for joint in joints]) for part in ("position", "velocity")]
        message = TYPES["sensor_msgs/msg/JointState"](header(time_ns), joints, *parts, np.zeros(0))
        states.append((time_ns + 1_000_000, message))
    layout = TYPES["std_msgs/msg/MultiArrayLayout"]([], 0)
    values = np.array([each.values for each in log.inputs]).T
    efforts = [
        (START_NS + round(time * 1e9), TYPES["std_msgs/msg/Float64MultiArray"](layout, row))
        for time, row in zip(log.inputs[0].times, values)
    ]
    return {
        "/joint_states": ("sensor_msgs/msg/JointState", states),
        "/effort_controller/commands": ("std_msgs/msg/Float64MultiArray", efforts),
    }
