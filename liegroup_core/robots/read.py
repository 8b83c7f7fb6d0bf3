# SPDX-License-Identifier: Apache-2.0
"""Robot of a file: the format is known by the root element."""

import os
from pathlib import Path

from .apart import run_apart
from .description import listed, refusal
from .mjcf import robot_of_mjcf
from .sdf import robot_of_sdf
from .urdf import robot_of_urdf
from .xml import Reader, read_xml, root_tag

SUFFIXES = (".urdf", ".xacro", ".sdf", ".world", ".xml", ".mjcf")


def is_robot_file(path):
    """True for the file of a robot: by its suffix, or because it is XML."""
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
            states = _group_states(srdf)
            known = {joint.name for joint in robot.joints}
            for pose, values in states.items():
                unknown = sorted(values.keys() - known)
                if unknown:
                    raise refusal(
                        srdf,
                        0,
                        f'group state "{pose}": the robot has no joint {listed(unknown)}: correct it',
                    )
            robot.poses |= states
    except OSError as error:
        raise refusal(
            error.filename or path, 0, f"cannot be read: {error.strerror or error}"
        ) from None
    return robot


def _read(path, arguments):
    root = read_xml(path)
    if root.tag == "robot":
        if Path(path).suffix == ".xacro" or any("xacro}" in each.tag for each in root.iter()):
            given = [f"{name}:={value}" for name, value in arguments.items()]
            text = run_apart("xacro", path, given)
            # Lines are those of the expanded text.
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
        f"has the root element <{root.tag:.40}>; a robot's file has <robot> (URDF), <sdf> or <mujoco>",
    )


def _refuse_arguments(path, arguments):
    """Raise SceneError for arguments of a file that takes none."""
    if arguments:
        raise refusal(
            path, 0, f"is no xacro file and takes no arguments: omit {listed(list(arguments))}"
        )


def _group_states(path):
    """{name: {joint: coordinate}} of the group states of an SRDF file."""
    reader, root = Reader(path), read_xml(path)
    found = {}
    for state in root.iterfind("group_state"):
        values = found.setdefault(reader.name(state), {})
        for joint in state.iterfind("joint"):
            name, text = reader.name(joint), joint.get("value")
            if text is None:
                raise reader.error(joint, f'joint "{name}" has no value: give one')
            if len(text.split()) == 1:  # joints with several values float
                values[name] = reader.number(joint, text, f'value of joint "{name}"')
    return found
