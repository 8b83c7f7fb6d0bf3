# SPDX-License-Identifier: Apache-2.0
"""Additions of a user to a robot: start values, locked joints, closing joints, forces."""

from dataclasses import dataclass, field

from liegroup_core.errors import SceneError
from liegroup_core.fields.values import suggestion

from .description import ONE_COORDINATE

BASES = ("fixed", "floating")
ALL = "all"  # instead of the names of joints


@dataclass
class Options:
    """Additions to a robot file; names are those of the file.

    base      : fixed or floating root links; None: default of the format
    pose      : name of a pose of the file (keyframe, group state)
    start     : {joint: coordinate}, rad or m; replaces 0 or the value of the pose
    start_velocity : {joint: velocity}, rad/s or m/s; replaces 0 or the value of the pose
    lock      : {joint: coordinate} of locked joints
    keep      : fixed joints that are not merged
    driven    : {joint: joints.motion.Motion, or None for its start velocity} of driven joints
    stops     : joints whose limits are rigid stops, or ALL for all joints that are not driven
    friction  : joints whose dry friction acts, or ALL
    only      : links whose chains to the root are kept; empty: all
    joints    : [joint of a scene], between links; its frames are in the frames of the links
    couplings : [coupling of a scene, with names of joints of the robot]
    forces    : [force of a scene], with names of links and joints of the robot
    sensors   : [sensor of a scene], with names of links and joints of the robot
    srdf      : path of an SRDF file with poses
    xacro     : {name: text} arguments of a xacro file
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
    stops: list = field(default_factory=list)
    friction: list = field(default_factory=list)
    only: list = field(default_factory=list)
    joints: list = field(default_factory=list)
    couplings: list = field(default_factory=list)
    forces: list = field(default_factory=list)
    sensors: list = field(default_factory=list)
    srdf: object = None
    xacro: dict = field(default_factory=dict)
    gravity: list | None = None
    name: str | None = None
    description: str | None = None
    joint_label: str = "--close"
    place: object = None

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
        values = dict.fromkeys(types, 0.0)
        if self.srdf is not None and self.pose is None:
            known = ", ".join(sorted(robot.poses)[:12]) or "none"
            raise self.error(("srdf",), f"srdf needs a pose: give one of its group states ({known})")
        if self.pose is not None:
            if self.pose not in robot.poses:
                raise self.unknown(("pose",), "pose", self.pose, robot.poses)
            values |= {name: value for name, value in robot.poses[self.pose].items() if name in types}
        given = robot.locked | self._given("start", types) | self._given("lock", types)
        known = given.keys() | robot.poses.get(self.pose, {}).keys()
        return _followed(robot.couplings, values | given, known)

    def velocities(self, robot):
        """{joint: velocity at the start}; refuses unknown joints and joints without exactly one coordinate."""
        types = {joint.name: joint.type for joint in robot.joints}
        values = dict.fromkeys(types, 0.0)
        values |= {name: value for name, value in robot.velocities.get(self.pose, {}).items() if name in types}
        given = self._given("start_velocity", types)
        known = given.keys() | robot.velocities.get(self.pose, {}).keys()
        return _followed(robot.couplings, values | given, known, rates=True)

    def _given(self, key, types):
        """{joint: number} of one of the additions."""
        values = {}
        for name, value in getattr(self, key).items():
            if name not in types:
                raise self.unknown((key, name), f"{key}: joint", name, types)
            if value and types[name] not in ONE_COORDINATE:
                raise self.error(
                    (key, name),
                    f'{key}: joint "{name}" is {types[name]}: only joints with one coordinate '
                    f"({', '.join(ONE_COORDINATE)}) take a value",
                )
            values[name] = float(value)
        return values

    def check_kept(self, kept):
        """Refuse a start value of a joint that is cut; kept: names of joints."""
        for name in self.start:
            if name not in kept:
                raise self.error(
                    ("start", name), f'start: joint "{name}" is cut: keep its links with only, or omit its value'
                )

    def check_start(self, values):
        """Refuse a start value of a joint that is locked at another value, directly or by a coupling.

        values : {joint: coordinate at the start}
        """
        for name, value in self.start.items():
            if abs(value - values[name]) > 1e-9 * (1.0 + abs(value)):
                raise self.error(
                    ("start", name),
                    f'start: joint "{name}" is {value:g}, but it is locked at {values[name]:g}: omit one of the two',
                )

    def check_driven(self, moving):
        """Refuse driven joints that do not move or cannot be driven; moving : {joint: type}."""
        for name in self.driven:
            if name not in moving:
                raise self.unknown(("driven", name), "driven: moving joint", name, moving)
            if moving[name] not in ONE_COORDINATE:
                raise self.error(
                    ("driven", name),
                    f'driven: joint "{name}" is {moving[name]}: only joints with one coordinate '
                    f"({', '.join(ONE_COORDINATE)}) can be driven",
                )

    def with_switches(self, moving):
        """({joint: its limits}, {joint: its friction}) as keys of a scene; refuses joints that have none.

        moving : [RobotJoint] that move
        """
        found = {"stops": {}, "friction": {}}
        for joint in moving:
            lower, upper = (joint.data.get(key) for key in ("lower", "upper"))
            if joint.type in ONE_COORDINATE and joint.name not in self.driven:
                if (lower is not None or upper is not None) and lower != upper:
                    stops = {"lower": lower, "upper": upper}
                    stops = {k: v for k, v in stops.items() if v is not None} | joint.stop
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
        return found["stops"], found["friction"]

    def check_velocities(self, moving):
        """Refuse a velocity of a joint that does not move."""
        for name, value in self.start_velocity.items():
            if value and name not in moving:
                raise self.error(
                    ("start_velocity", name),
                    f'start_velocity: joint "{name}" does not move: unlock it, or omit its velocity',
                )


def _followed(couplings, values, given, rates=False):
    """Values of joints, with coupled values computed from the given ones or from the coupling's `second`.

    values : {joint: coordinate, or velocity if `rates`}; given : names of joints that keep their value
    """
    left = [entry for entry in couplings if {entry.first, entry.second} <= values.keys()]
    left = [entry for entry in left if rates or entry.offset is not None]
    known = set(given)
    while left:
        # First couplings with a known joint, then couplings whose `second` follows no other joint.
        firsts = {entry.first for entry in left}
        entry = next(
            (e for e in left if {e.first, e.second} & known), next((e for e in left if e.second not in firsts), left[0])
        )
        left.remove(entry)
        offset = 0.0 if rates else entry.offset
        if entry.first not in known:
            values[entry.first] = entry.ratio * values[entry.second] + offset
        elif entry.second not in known and entry.ratio:
            values[entry.second] = (values[entry.first] - offset) / entry.ratio
        known |= {entry.first, entry.second}
    return values
