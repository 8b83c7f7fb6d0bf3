# SPDX-License-Identifier: Apache-2.0
"""Sensors of SDF elements, also those in the <gazebo> elements of URDF: imu and force_torque.

Source: http://sdformat.org/spec, sensor. Noise that the sensors of a scene do not have is left out with a
note. The node determines rates and topics.
"""

import numpy as np

from liegroup_core.lie.groups import SE3

from .description import RobotSensor, place
from .sdf_frames import text_of

AXES = "xyz"
NOISES = "noise of sensors that a scene does not have"


def link_sensor(reader, robot, element, link, pose):
    """Append an imu on a link; other sensors are left out. pose : (4, 4) in the frame of the link."""
    name = element.get("name") or f"{link}_sensor"
    if element.get("type") != "imu":
        robot.leave_out("sensor of links", element.get("name") or link)
        return
    values, own = {}, element.find("imu")
    for tag, key in (("angular_velocity", "angular_velocity"), ("linear_acceleration", "acceleration")):
        found = None if own is None else own.find(tag)
        deviation, mean = _noise(reader, robot, found, name)
        if deviation:
            values[f"{key}_noise"] = deviation
        if mean.any():
            values[f"{key}_bias"] = mean
    if own is not None and own.find("noise") is not None:  # SDF versions up to 1.4
        robot.leave_out(NOISES, name)
    robot.sensors.append(RobotSensor(name, "imu", element.sourceline, link, None, pose, values))


def joint_sensor(reader, robot, element, joint, pose):
    """Append a force_torque sensor in a RobotJoint; other sensors are left out.

    pose : (4, 4) of the sensor in the frame of the child; the torque is about its origin, whatever its axes are
    """
    name = element.get("name") or f"{joint.name}_sensor"
    if element.get("type") != "force_torque":
        robot.leave_out("sensor of joints", name)
        return
    own = element.find("force_torque")
    axes, direction = (
        (None if own is None else text_of(own, key)) or default
        for key, default in (("frame", "child"), ("measure_direction", "child_to_parent"))
    )
    R = np.eye(3) if axes == "child" else None
    if axes == "sensor":
        R = pose[:3, :3]
    elif axes == "parent" and joint.type == "fixed":
        R = (joint.child_frame @ SE3.inverse(joint.parent_frame))[:3, :3]
    if R is None or direction not in ("child_to_parent", "parent_to_child"):
        robot.leave_out(f"force_torque sensors with {axes} axes or {direction}", name)
        return
    values = {"acts_on": "parent"} if direction == "child_to_parent" else {}
    if joint.type != "fixed":
        values["measures"] = "transmitted"
    for tag in ("torque", "force"):
        found = None if own is None else own.find(tag)
        deviation, mean = _noise(reader, robot, found, name)
        if deviation:
            values[f"{tag}_noise"] = deviation
        if mean.any():
            robot.leave_out(NOISES, name)
    robot.sensors.append(
        RobotSensor(
            name, "force_torque", element.sourceline, joint=joint.name, frame=place(pose[:3, 3], R), values=values
        )
    )


def _noise(reader, robot, element, name):
    """(standard deviation, means (3,)) of the noise of three axes; other noise is left out."""
    deviations, means = np.zeros(3), np.zeros(3)
    for k, axis in enumerate(AXES):
        noise = None if element is None else element.find(f"{axis}/noise")
        if noise is None or noise.get("type", "none") == "none":
            continue
        others = [part.tag for part in noise if part.tag not in ("mean", "stddev", "precision")]
        numbers = {part.tag: reader.number(part, part.text, f"<{part.tag}>") for part in noise}
        if noise.get("type") != "gaussian" or any(numbers[tag] for tag in others):
            robot.leave_out(NOISES, name)
        if noise.get("type") == "gaussian":
            deviations[k], means[k] = numbers.get("stddev", 0.0), numbers.get("mean", 0.0)
    if np.ptp(deviations) > 0.0 or (deviations < 0.0).any():
        robot.leave_out(NOISES, name)
        return 0.0, means
    return float(deviations[0]), means
