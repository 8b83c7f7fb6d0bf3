# SPDX-License-Identifier: Apache-2.0
"""Additions of a user to a robot: start values, locked joints, closing joints, forces."""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from liegroup_core.errors import SceneError
from liegroup_core.fields.curve import slope
from liegroup_core.fields.values import suggestion

from .description import ONE_COORDINATE
from .starts import FORBIDDEN, Start

BASES = ("fixed", "floating")
ALL = "all"  # instead of the names of joints
MAPPED = ("base", "lock", "keep", "only", "xacro")  # what decides which body a link of the file is, and where in it
BEYOND = 1e-9  # rad or m, of a limit: round-off
MANY = 100  # couplings, above which chains of them are followed only in the order of the file


@dataclass
class Options:
    """Additions to a robot file; names are those of the file.

    base      : fixed or floating root links; None: default of the format
    pose      : name of a pose of the file (keyframe, group state)
    start     : {joint: coordinate, rad or m, or link or joint: Start}; replaces 0 or the value of the pose
    start_velocity : {joint: velocity}, rad/s or m/s; replaces 0 or the value of the pose
    lock      : {joint: coordinate} of locked joints
    keep      : fixed joints that are not merged
    driven    : {joint: joints.motion.Motion, or None for its start velocity} of driven joints
    stops     : joints whose limits are stops; ALL for all that are not driven and start within their limits
    friction  : joints whose dry friction acts, or ALL
    actuators : whether the actuators of the file act
    only      : links whose chains to the root are kept; empty: all
    joints    : [joint of a scene], between links; its frames are in the frames of the links
    couplings : [coupling of a scene, with names of joints of the robot]
    forces    : [force of a scene], with names of links and joints of the robot
    sensors   : [sensor of a scene], with names of links and joints of the robot
    srdf      : path of an SRDF file with poses
    xacro     : {name: text} arguments of a xacro file
    roll      : {joint: radius in m} of wheels, links that roll about the axis of their joint on z = 0 of the world
    drive     : scene.drive.Drive with names of joints of the robot, or None
    ground    : ground.Ground that the collision shapes touch, or None
    servos    : held_joints.Servos of the joints that servos hold, or None
    gravity, name, description : of the scene; None: from the robot file
    joint_label : format of an entry of `joints` in error messages, with its index
    place     : function: path inside the additions -> text at the start of an error message
    """

    base: str | None = None
    pose: str | None = None
    start: dict = field(default_factory=dict)
    start_velocity: dict = field(default_factory=dict)
    lock: dict = field(default_factory=dict)
    keep: list = field(default_factory=list)
    driven: dict = field(default_factory=dict)
    stops: list = field(default_factory=lambda: [ALL])
    friction: list = field(default_factory=lambda: [ALL])
    actuators: bool = True
    only: list = field(default_factory=list)
    joints: list = field(default_factory=list)
    couplings: list = field(default_factory=list)
    forces: list = field(default_factory=list)
    sensors: list = field(default_factory=list)
    srdf: object = None
    xacro: dict = field(default_factory=dict)
    roll: dict = field(default_factory=dict)
    drive: object = None
    ground: object = None
    servos: object = None
    gravity: list | None = None
    name: str | None = None
    description: str | None = None
    joint_label: str = "--close"
    place: object = None

    @property
    def led(self):
        """{joint} of those with a servo or a motion of the user."""
        return {each.joint for each in self.forces if each.type in ("servo", "linear_servo")} | self.driven.keys()

    @property
    def mapped(self):
        """{key: value} of MAPPED, JSON types."""
        return {key: getattr(self, key) for key in MAPPED}

    def error(self, path, message):
        """SceneError at an entry of the additions."""
        head = self.place(path) if self.place else ""
        return SceneError(f"{head}{message}", path)

    def unknown(self, path, what, name, known):
        """SceneError for a name that the robot does not have."""
        hint = suggestion(name, sorted(known)) if known else "the robot has none"
        return self.error(path, f"{what} {str(name)!r:.60} is not in the robot; {hint}")

    def coordinates(self, robot):
        """{joint: coordinate at the start}; refuses unknown joints and joints without exactly one coordinate."""
        types = {joint.name: joint.type for joint in robot.joints}
        values = dict.fromkeys(types, 0.0) | robot.start
        if self.srdf is not None and self.pose is None:
            known = ", ".join(sorted(robot.poses)[:12]) or "none"
            raise self.error(("srdf",), f"srdf needs a pose: give one of its group states ({known})")
        if self.pose is not None:
            if self.pose not in robot.poses:
                raise self.unknown(("pose",), "pose", self.pose, robot.poses)
            values |= {name: value for name, value in robot.poses[self.pose].items() if name in types}
        several = {name: state[0] for name, state in self._several(robot, types).items()}
        given = robot.locked | self._given("start", types) | several | self._given("lock", types)
        of_pose = robot.start | robot.poses.get(self.pose, {})
        found = _followed([*robot.couplings, *robot.relations], values | given, given, of_pose.keys() - given.keys())
        coupled = {name for each in robot.couplings for name in (each.first, each.second)} & of_pose.keys()
        for name in sorted(coupled - given.keys()):
            if abs(found[name] - of_pose[name]) > BEYOND * (1.0 + abs(found[name])):
                robot.remark(f'coordinates that a coupling moves in the pose "{self.pose}"', name)
        return found

    def velocities(self, robot, at):
        """{joint: velocity at the start}; refuses unknown joints and joints without exactly one coordinate.

        at : {joint: coordinate at the start}
        """
        types = {joint.name: joint.type for joint in robot.joints}
        values = dict.fromkeys(types, 0.0) | robot.start_velocity
        values |= {name: value for name, value in robot.velocities.get(self.pose, {}).items() if name in types}
        several = {name: state[1] for name, state in self._several(robot, types).items()}
        given = self._given("start_velocity", types) | several
        of_pose = (robot.start_velocity.keys() | robot.velocities.get(self.pose, {}).keys()) - given.keys()
        # Rates follow as coordinates do, by the slopes.
        slopes = [
            replace(each, ratio=slope(each, at[each.second]), offset=0.0, curve=())
            for each in (*robot.couplings, *robot.relations)
        ]
        return _followed(slopes, values | given, given, of_pose)

    def _given(self, key, types):
        """{joint: number} of one of the additions."""
        values = {}
        for name, value in (self.numbers if key == "start" else getattr(self, key)).items():
            if name not in types:
                raise self.unknown((key, name), f"{key}: joint", name, types)
            if value and types[name] not in ONE_COORDINATE:
                raise self.error(
                    (key, name),
                    f'{key}: joint "{name}" is {types[name]}: only joints with one coordinate '
                    f"({', '.join(ONE_COORDINATE)}) take a value; start takes a mapping such as "
                    "{rotation_vector: [0.1, 0, 0]} for others",
                )
            values[name] = float(value)
        return values

    @property
    def numbers(self):
        """The part of `start` for joints with one coordinate."""
        return {name: value for name, value in self.start.items() if not isinstance(value, Start)}

    def _several(self, robot, types):
        """{joint: ((4, 4), (6,))}: start of the joints with several coordinates that have a Start."""
        found = {}
        for name, start in self.start.items():
            kind = types.get(name)
            if kind not in FORBIDDEN or not isinstance(start, Start):
                continue
            if name in self.lock:
                raise self.error(("start", name), f'start: joint "{name}" is locked: omit one of the two')
            pose = robot.poses.get(self.pose, {}).get(name, np.eye(4))
            twist = robot.velocities.get(self.pose, {}).get(name, np.zeros(6))
            pose, twist = found[name] = start.over(pose, twist)
            wrong = FORBIDDEN[kind](pose[:3, :3], pose[:3, 3], twist[:3], twist[3:])
            if np.abs(wrong).max() > BEYOND * (1.0 + np.abs(pose[:3, 3]).max() + np.abs(twist).max()):
                raise self.error(
                    ("start", name),
                    f'start: joint "{name}" is {kind} and does not allow this: correct its position, rotation '
                    "or velocities, which are those of its child frame in its parent frame",
                )
        return found

    def placed_links(self, robot):
        """{link: Start} of the links that a Start places; refuses unknown names, and joints with one coordinate."""
        types = {joint.name: joint.type for joint in robot.joints}
        found = {k: v for k, v in self.start.items() if isinstance(v, Start) and types.get(k) not in FORBIDDEN}
        for name in found:
            if name in robot.links:
                continue
            if name not in types:
                raise self.unknown(("start", name), "start: joint or link", name, types.keys() | robot.links.keys())
            child = next(joint.child for joint in robot.joints if joint.name == name)
            what = f'place its child link "{child}"' if types[name] == "floating" else "give it a number"
            raise self.error(("start", name), f'start: joint "{name}" is {types[name]}: {what}')
        return found

    def check_placed(self, placed, kept):
        """Refuse a Start of a link that does not float, or the second one of a floating part."""
        for name in placed:
            if name not in kept:
                raise self.error(
                    ("start", name),
                    f'start: link "{name}" does not float, or another link with a start holds it: give base: floating '
                    "(--base floating), or values for joints",
                )

    def check_kept(self, kept):
        """Refuse a start value of a joint that is cut; kept: names of joints."""
        for name in self.numbers:
            if name not in kept:
                raise self.error(
                    ("start", name), f'start: joint "{name}" is cut: keep its links with only, or omit its value'
                )

    def check_start(self, values):
        """Refuse a start value of a joint that is locked at another value, directly or by a coupling.

        values : {joint: coordinate at the start}
        """
        for name, value in self.numbers.items():
            if abs(value - values[name]) > 1e-9 * (1.0 + abs(value)):
                raise self.error(
                    ("start", name),
                    f'start: joint "{name}" is {value:g}, but it is locked at {values[name]:g}: omit one of the two',
                )

    def check_driven(self, moving, joints):
        """Refuse driven joints that do not move or cannot be driven; moving : {joint: type}, joints : all names."""
        for name in self.driven:
            if name not in moving and name in joints:
                raise self.error(("driven", name), f'driven: joint "{name}" does not move: it is fixed, locked or cut')
            if name not in moving:
                raise self.unknown(("driven", name), "driven: moving joint", name, moving)
            if moving[name] not in ONE_COORDINATE:
                raise self.error(
                    ("driven", name),
                    f'driven: joint "{name}" is {moving[name]}: only joints with one coordinate '
                    f"({', '.join(ONE_COORDINATE)}) can be driven",
                )

    def with_switches(self, moving, values, couplings=()):
        """({joint: its limits}, {joint: its friction}) as keys of a scene; refuses joints that have none.

        The keys are {} for a coupled joint whose limits or friction act on the joint that it follows.

        moving : [RobotJoint] that move;  values : {joint: coordinate at the start};  couplings : of them
        """
        found = {"stops": {}, "friction": {}}
        for joint in moving:
            lower, upper = (joint.data.get(key) for key in ("lower", "upper"))
            if joint.type in ONE_COORDINATE and joint.name not in self.driven:
                if _is_range(lower, upper):
                    stops = {"lower": lower, "upper": upper}
                    stops = {k: v for k, v in stops.items() if v is not None} | joint.stop
                    if joint.name in self.stops or is_within(joint, values[joint.name]):
                        found["stops"][joint.name] = stops
                if joint.data.get("friction", 0.0) > 0.0:
                    found["friction"][joint.name] = {"coulomb": joint.data["friction"]}
        for key, known in found.items():
            names = getattr(self, key)
            for name in names:
                if name in known or name == ALL:
                    continue
                if name not in {joint.name for joint in moving}:
                    raise self.unknown((key,), f"{key}: moving joint", name, known)
                what = "limits" if key == "stops" else "friction"
                raise self.error(
                    (key,),
                    f'{key}: joint "{name}" cannot have {key}; joints with one coordinate and {what} in '
                    f"the file can, unless driven: {', '.join(sorted(known)) or 'there are none'}",
                )
            if ALL not in names:
                found[key] = {name: known[name] for name in names}
        for coupling in couplings * len(couplings) if len(couplings) < MANY else couplings:
            self._move_to_leader(coupling, values, found["stops"], found["friction"])
        return found["stops"], found["friction"]

    def _move_to_leader(self, coupling, values, stops, friction):
        """Replace limits and friction of a coupled joint by the same ones of the joint that it follows.

        Two stops, or two joints at rest, would act at once on one motion. Joints that the user named keep theirs.
        """
        first, second, ratio = coupling.first, coupling.second, coupling.ratio
        if not ratio or coupling.curve or first == second or second in self.driven:
            return
        rigid = [name not in self.stops and "stiffness" not in stops.get(name, {}) for name in (first, second)]
        if stops.get(first) and all(rigid):
            offset = values[first] - ratio * values[second] if coupling.offset is None else coupling.offset
            ends = {key: (stops[first][key] - offset) / ratio for key in ("lower", "upper") if key in stops[first]}
            if ratio < 0.0:
                ends = {"upper" if key == "lower" else "lower": value for key, value in ends.items()}
            own = stops.get(second, {})
            lower = max(ends.get("lower", -math.inf), own.get("lower", -math.inf))
            upper = min(ends.get("upper", math.inf), own.get("upper", math.inf))
            # Round-off of the file's numbers must not exclude the start.
            lower, upper = min(lower, values[second]), max(upper, values[second])
            if lower < upper:
                stops[first] = {}
                stops[second] = {k: v for k, v in (("lower", lower), ("upper", upper)) if math.isfinite(v)}
        if friction.get(first) and not {first, second} & set(self.friction):
            more = abs(ratio) * friction[first]["coulomb"]
            friction[first] = {}
            friction[second] = {"coulomb": friction.get(second, {}).get("coulomb", 0.0) + more}

    def check_velocities(self, moving):
        """Refuse a velocity of a joint that does not move."""
        for name, value in self.start_velocity.items():
            if value and name not in moving:
                raise self.error(
                    ("start_velocity", name),
                    f'start_velocity: joint "{name}" does not move: unlock it, or omit its velocity',
                )


def _is_range(lower, upper):
    """Whether limits, None for none, leave a joint a range."""
    return (lower is not None or upper is not None) and (lower is None or upper is None or lower < upper)


def is_within(joint, value):
    """Whether a coordinate of a RobotJoint is within its limits, up to round-off."""
    lower, upper = (joint.data.get(key) for key in ("lower", "upper"))
    return (lower is None or value >= lower - BEYOND) and (upper is None or value <= upper + BEYOND)


def _followed(couplings, values, given, of_pose):
    """Values of joints, with coupled values computed from the given ones or from the coupling's `second`.

    values : {joint: coordinate or velocity}; given : names of joints that keep their value
    of_pose : names of joints that keep it unless a coupling with another value contradicts it
    """
    left = [entry for entry in couplings if {entry.first, entry.second, *entry.further} <= values.keys()]
    left = [entry for entry in left if entry.offset is not None]
    known, fixed = {*given, *of_pose}, set(given)
    while left:
        # First couplings with a fixed joint, then with a known one; of these, those whose `second` follows no other.
        firsts = {entry.first for entry in left}
        ready = [e for e in left if {e.first, e.second} & fixed]
        ready = ready or [e for e in left if {e.first, e.second} & known] or left
        entry = next((e for e in ready if e.second not in firsts), ready[0])
        left.remove(entry)
        if entry.first not in known or (entry.second in known and entry.first not in fixed):
            values[entry.first] = entry.solved(entry.first, values)
        elif entry.second not in fixed and any((entry.ratio, *entry.curve)):
            values[entry.second] = entry.solved(entry.second, values)
        known |= {entry.first, entry.second}
        fixed |= {entry.first, entry.second}
    return values
