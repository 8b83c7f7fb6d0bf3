# SPDX-License-Identifier: Apache-2.0
"""Reading of a robot file; the root element determines the format."""

import os
from pathlib import Path

import numpy as np

from liegroup_core.lie.groups import SO3

from .access import is_permitted, trees
from .apart import run_apart
from .description import WORLD, listed, place, refusal
from .mjcf import robot_of_mjcf
from .resources import packages_around
from .sdf import robot_of_sdf
from .urdf import robot_of_urdf
from .xml import Reader, read_xml, root_tag

SUFFIXES = (".urdf", ".xacro", ".sdf", ".world", ".xml", ".mjcf")


def is_robot_file(path):
    """True if a file is a robot file: it has such a suffix, or it is XML."""
    return Path(path).suffix.lower() in SUFFIXES or bool(root_tag(path))


def read_robot(path, srdf=None, arguments=None):
    """Robot of a URDF, xacro, SDF or MJCF file. Raises SceneError.

    srdf      : path of an SRDF file with poses, or None
    arguments : {name: text} of a xacro file
    """
    if not os.path.isfile(path):
        raise refusal(path, 0, "is not a file: give the path of a URDF, xacro, SDF or MJCF file")
    try:
        robot = _read(path, arguments or {})
        if srdf is not None:
            _add_group_states(robot, srdf)
    except OSError as error:
        raise refusal(error.filename or path, 0, f"cannot be read: {error.strerror or error}") from None
    return robot


def _read(path, arguments):
    root = read_xml(path)
    if root.tag == "robot":
        if Path(path).suffix == ".xacro" or any("xacro}" in each.tag for each in root.iter()):
            given = [f"{name}:={value}" for name, value in arguments.items()]
            near = [folder for folder in packages_around(path).values() if is_permitted(folder)]
            text = run_apart("xacro", path, given, [*trees(path), *near])
            # Line numbers refer to the expanded text.
            file = f"{path} (expanded)"
            return robot_of_urdf(read_xml(file, text), file, text)
        _refuse_arguments(path, arguments)
        text = Path(path).read_text(encoding="utf-8", errors="replace")
        return robot_of_urdf(root, path, text)
    _refuse_arguments(path, arguments)
    if root.tag == "mujoco":
        return robot_of_mjcf(root, path)
    if root.tag == "sdf":
        return robot_of_sdf(root, path)
    raise refusal(
        path,
        root.sourceline,
        f"has the root element <{root.tag:.40}>; a robot file has <robot> (URDF), <sdf> or <mujoco>",
    )


def _refuse_arguments(path, arguments):
    """Raise SceneError if arguments are given for a file that is not xacro."""
    if arguments:
        raise refusal(path, 0, f"is not a xacro file and takes no arguments: omit {listed(list(arguments))}")


def _add_group_states(robot, path):
    """Add the group states of an SRDF file to a robot: joint coordinates, and poses of the root link.

    A floating joint of the root is a virtual joint of the SRDF file, or a joint that the robot does not have.
    """
    reader, root = Reader(path), read_xml(path)
    types = {joint.name: joint.type for joint in robot.joints}
    virtual = {joint.get("name") for joint in root.iterfind("virtual_joint") if joint.get("type") == "floating"}
    for state in root.iterfind("group_state"):
        pose = reader.name(state)
        values = robot.poses.setdefault(pose, {})
        unknown = []
        for joint in state.iterfind("joint"):
            name, text = reader.name(joint), joint.get("value")
            if text is None:
                raise reader.error(joint, f'joint "{name}" has no value: give one')
            count = len(text.split())
            if count == 1:
                values[name] = reader.number(joint, text, f'value of joint "{name}"')
                unknown += [name] if name not in types else []
            elif name in virtual or (name not in types and count == 7):
                link = robot.roots[0] if robot.roots else WORLD
                robot.root_poses[pose] = {link: (_pose_of_root(reader, joint, name, text), np.zeros(6))}
            else:
                robot.leave_out("values of several coordinates", f"{name} in {pose}", changes_motion=True)
        if unknown:
            raise refusal(
                path, 0, f'group state "{pose}": the robot has no joint {listed(sorted(set(unknown)))}: correct it'
            )


def _pose_of_root(reader, element, name, text):
    """(4, 4) pose from the text "x y z qx qy qz qw"."""
    numbers = reader.numbers(element, text, 7, f'value of floating joint "{name}"')
    length = np.linalg.norm(numbers[3:])
    if not length > 1e-12:
        raise reader.error(element, f'the quaternion of joint "{name}" must not be zero: numbers are x y z qx qy qz qw')
    return place(numbers[:3], SO3.from_quaternion(numbers[3:] / length))
