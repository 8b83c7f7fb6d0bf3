# SPDX-License-Identifier: Apache-2.0
"""Robots as scenes: a robot file alone, or a YAML file that refers to a robot file and adds to it.

robot: arm.urdf
start: {shoulder: 0.4}
forces:
  - {name: spring, type: torsional_spring_damper, joint: elbow, stiffness: 5}
"""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, WithJsonSchema

from liegroup_core.errors import SceneError
from liegroup_core.fields.values import Described, Flag, Name, Number, Text, Vector3, suggestion
from liegroup_core.joints.coupling import Coupling
from liegroup_core.joints.motion import Motion
from liegroup_core.robots.chains import base_of
from liegroup_core.robots.description import MISSING_MESHES, WORLD
from liegroup_core.robots.ground import Ground
from liegroup_core.robots.held_joints import Servos
from liegroup_core.robots.mapping import scene_parts
from liegroup_core.robots.options import BASES, MAPPED, Options
from liegroup_core.robots.read import SUFFIXES, read_robot
from liegroup_core.robots.resources import beside
from liegroup_core.robots.starts import Start
from liegroup_core.robots.text import scene_text

from .description import FORCES, JOINTS, SENSORS, entries_of, list_of
from .drive import Drive
from .yaml_text import Lines, read_yaml


def _mapped(value):
    if value is None:
        return {}
    if not isinstance(value, Mapping):
        raise ValueError("must be a mapping of joints to numbers, such as {elbow: 0.5}")
    return value


# {joint: number}; a key without a value is an empty mapping.
ByJoint = Annotated[dict[str, Number], BeforeValidator(_mapped)]


def _start(value):
    """Start of a mapping of keys to values, for links and joints with several coordinates."""
    return Start.model_validate(value) if isinstance(value, Mapping) else value


# {joint: number, or link or joint: Start}
Starts = Annotated[
    dict[str, Annotated[Number | Start, BeforeValidator(_start)]],
    BeforeValidator(_mapped),
    WithJsonSchema({"type": "object"}),
]


def _motions(value):
    if value is None:
        return {}
    if not isinstance(value, Mapping):
        raise ValueError("must be a mapping of joints to motions, or to nothing")
    return value


def _arguments(value):
    """Arguments of xacro as {name: text}."""
    if value is None:
        return {}
    if not isinstance(value, Mapping):
        raise ValueError("must be a mapping of names to values, such as {length: 0.5}")
    found = {}
    for name, each in value.items():
        if not isinstance(each, (str, bool, int, float)):
            raise ValueError(f"must have one text, number or truth value for {name!r:.60}")
        found[name] = {True: "true", False: "false"}[each] if isinstance(each, bool) else str(each)
    return found


Arguments = Annotated[
    dict[str, str],
    BeforeValidator(_arguments),
    WithJsonSchema({"type": "object", "additionalProperties": {"type": ["string", "number", "boolean"]}}),
]


def _ground(value):
    if value is None:
        raise ValueError("must be a mapping, such as {} or {height: 0.1}")
    return value


class RobotFile(Described):
    """YAML file with additions to a robot file."""

    robot: Text = Field(description="path of a URDF, xacro, SDF or MJCF file, relative to this file")
    name: Name | None = Field(None, description="name of the scene; default: that of the robot")
    description: Text | None = Field(None, description="free text")
    gravity: Vector3 | None = Field(
        None, description="gravity in m/s^2, world axes; default: that of the file, or 9.81 along -z"
    )
    base: Literal[BASES] | None = Field(
        None,
        description="fixed: the root link is fixed to the world; floating: it moves freely; default: "
        "fixed for URDF, as given in the file for SDF and MJCF",
    )
    pose: Text | None = Field(
        None, description="name of a pose at the start: a keyframe of MJCF, a group state of SRDF"
    )
    srdf: Text | None = Field(None, description="path of an SRDF file with group states, relative to this file")
    xacro: Arguments = Field({}, description="arguments of a xacro file, by name")
    start: Starts = Field(
        {},
        description="joint coordinates at the start, rad or m; for a floating link, or a joint with several "
        "coordinates, a mapping: see start of a link",
    )
    start_velocity: ByJoint = Field(
        {}, description="joint velocities at the start, rad/s or m/s; default: 0, or those of the keyframe"
    )
    lock: ByJoint = Field({}, description="joints that do not move, and their coordinates, rad or m")
    keep: list_of(Text) = Field(
        (),
        description="fixed joints that are not merged, so that their reactions are known; fixed joints "
        "with a force_torque sensor are never merged",
    )
    stops: list_of(Text) = Field(
        ("all",), description="joints whose limits are stops; default: all that start within them; []: none"
    )
    friction: list_of(Text) = Field(("all",), description="joints whose dry friction acts; default: all; []: none")
    actuators: Flag = Field(True, description="false: the servos and motors of an MJCF file do not act")
    driven: Annotated[dict[str, Motion | None], BeforeValidator(_motions)] = Field(
        {}, description="driven joints, each with its motion, or without a value to keep its velocity at the start"
    )
    only: list_of(Text) = Field((), description="links to keep, with the chains that lead to them; default: all")
    joints: entries_of(JOINTS) = Field((), description="additional joints between links, which close loops")
    couplings: list_of(Coupling) = Field((), description="couplings of the robot's joints")
    forces: entries_of(FORCES) = Field((), description="forces, which refer to links and joints of the robot")
    sensors: entries_of(SENSORS) = Field((), description="sensors, which refer to links and joints of the robot")
    roll: ByJoint = Field({}, description="radius in m of the wheels at these joints, which roll on z = 0 of the world")
    drive: Drive | None = Field(None, description="wheels that the node commands by ~/cmd_vel")
    ground: Annotated[Ground | None, BeforeValidator(_ground)] = Field(
        None,
        description="horizontal plane that the collision shapes touch, {} for its defaults; default: none. A floating "
        "URDF robot without a start of a link stands on it",
    )
    servos: Servos | None = Field(None, description="servos that hold joints at their start; default: none")


class RobotNames:
    """Correspondence between the names of a robot file and those of its scene.

    links, joints : {name in the scene: name in the file}
    frames        : {link of the file: (name of its body or world, (4, 4) pose in the body's frame)}
    still         : {joint of the file with one coordinate that is locked: rad or m}
    visuals       : {link of the file: [robots.description.Visual]}; fixtures: those of the world
    text          : URDF text, "" for other formats
    file          : path of the robot file
    size          : (links, joint coordinates) of the file
    options       : robots.options.Options
    missing       : mesh files that do not exist, each with its link
    """

    def __init__(self, robot, parts, size, options):
        self.links = {scene: file for (key, scene), file in parts.names.items() if key == "bodies"}
        self.joints = {scene: file for (key, scene), file in parts.names.items() if key == "joints"}
        self.frames, self.still = parts.frames, parts.still
        self.visuals = {name: link.visuals for name, link in robot.links.items()}
        self.fixtures = robot.fixtures
        self.text, self.file = robot.text, robot.file
        self.size, self.options = size, options
        self.missing = tuple(robot.left_out.get(MISSING_MESHES, ()))

    def drawn(self):
        """(body or world, (4, 4) pose in its frame, Visual) of all visuals."""
        for link, (body, place) in self.frames.items():
            yield from ((body, place @ visual.pose, visual) for visual in self.visuals.get(link, ()))
        yield from ((WORLD, visual.pose, visual) for visual in self.fixtures)


class _Origins:
    """File and line that a place of a scene comes from: _Origins(...)(place) is "file:line".

    file  : the robot file
    lines : {(list, index) or (list, index, key): line of the file, or path inside the additions}
    names : {(list, name in the scene): name in the file}
    added : function: path inside the additions -> "file:line"; None without a file of additions
    """

    def __init__(self, file, lines, names, added):
        self._file, self._lines, self._added = file, lines, added
        self._renamed = {scene: given for (_, scene), given in names.items() if scene != given}

    def __call__(self, place):
        line = self._line(place)
        if isinstance(line, tuple):
            return self._added(line + tuple(place[2:])) if self._added else self._file
        return f"{self._file}:{line}" if line else self._file

    def _line(self, place):
        return self._lines.get(tuple(place[:3]), self._lines.get(tuple(place[:2]), 0))

    def located(self, error):
        """SceneError with file and line, the names used in the file, and the index of an entry in the additions."""
        place, text = error.place or (), str(error)
        line = self._line(place)
        if isinstance(line, tuple):
            own = "{}[{}]".format(*line)
            if self._added is None:
                own = "--close" if line[0] == "joints" else f"--{line[0].replace('_', '-')}"
            text = text.replace("{}[{}]".format(*place[:2]), own, 1)
        if self._renamed:
            text = re.sub(r"\w+", lambda word: self._renamed.get(word[0], word[0]), text)
        return SceneError(f"{self(place)}: {text}", error.place)


def robot_text(path, options=None, added_line=None):
    """(text of the scene, its values, function: place -> "file:line", RobotNames).

    added_line : function: path inside the additions -> "file:line"
    """
    options = options or Options()
    robot = read_robot(path, options.srdf, options.xacro)
    size = robot.size(base_of(robot, options, []))
    parts = scene_parts(robot, options)
    text = scene_text(parts)

    where = _Origins(robot.file, parts.lines, parts.names, added_line)
    return text, read_yaml(text, str(path)).value, where, RobotNames(robot, parts, size, options)


def options_from(mapped):
    """Options of what Options.mapped gave and a recording kept. Raises SceneError."""
    given = RobotFile(robot="", **{key: value for key, value in mapped.items() if key in MAPPED and value is not None})
    return Options(**{key: getattr(given, key) for key in MAPPED})


def robot_beside(root, source):
    """As `robot_text`, for a YAML file with the key robot; root: YamlNode of its text."""
    at = Lines(source, root)
    try:
        given = RobotFile(**root.value)
    except SceneError as error:
        raise at.located(error) from None
    options = Options(
        base=given.base,
        pose=given.pose,
        start=given.start,
        start_velocity=given.start_velocity,
        lock=given.lock,
        keep=list(given.keep),
        stops=list(given.stops),
        friction=list(given.friction),
        actuators=given.actuators,
        driven=given.driven,
        only=list(given.only),
        joints=list(given.joints),
        joint_label="joints[{}]",
        couplings=list(given.couplings),
        forces=list(given.forces),
        sensors=list(given.sensors),
        roll=given.roll,
        drive=given.drive,
        ground=given.ground,
        servos=given.servos,
        gravity=given.gravity,
        name=given.name,
        description=given.description,
        srdf=given.srdf and beside(source, given.srdf),
        xacro=given.xacro,
        place=lambda path: f"{at(path)}: ",
    )
    path = Path(beside(source, given.robot))
    if not path.is_file():
        found = sorted(file.name for file in path.parent.glob("*") if file.suffix.lower() in SUFFIXES)
        hint = suggestion(path.name, found) if found else "give the path of a URDF, xacro, SDF or MJCF file"
        raise at.located(SceneError(f"robot: {given.robot} is not a file; {hint}", place=("robot",)))
    return robot_text(path, options, at)
