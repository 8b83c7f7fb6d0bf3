# SPDX-License-Identifier: Apache-2.0
"""Robot description independent of the file format (URDF, SDF or MJCF).

SI units, radians, poses as (4, 4) matrices. The axis of a joint is the z axis of its two frames. The
axes of a universal joint are x of the parent's frame and y of the child's. At coordinate 0 the two
frames of a joint coincide.
"""

import difflib
import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from liegroup_core.errors import SceneError
from liegroup_core.fields.curve import other_at, rise
from liegroup_core.fields.values import suggestion
from liegroup_core.lie.groups import SE3, SO3, UNKNOWN_TURN, within_a_turn

WORLD = "world"
MISSING_MESHES = "missing mesh files"  # in notes
FORBIDDEN_MESHES = "mesh files outside of the robot file's tree, which only --allow-files reads"
NOT_DRAWN = "visuals that are not drawn"
# Elements whose unknown parts may change the motion. For a joint these are children, such as a misspelt <origin>.
MOTION = {"inertial", "mass", "inertia", "axis", "axis2", "dynamics", "mimic"}
LONGEST_MESSAGE = 1500  # characters; names in it can be long
# {joint type: number of coordinates}; a closing joint adds none, because its coordinates follow from the others.
COORDINATES = {
    "fixed": 0,
    "revolute": 1,
    "prismatic": 1,
    "screw": 1,
    "universal": 2,
    "cylindrical": 2,
    "spherical": 3,
    "planar": 3,
    "floating": 6,
}
# Types of joints with exactly one coordinate.
ONE_COORDINATE = ("revolute", "prismatic", "screw")


@dataclass
class Visual:
    """Shape that a viewer draws.

    kind  : box, cylinder, capsule, ellipsoid, sphere or mesh; of a collision shape also others
    size  : m: edges (x, y, z); (radius, length); (radius, length without caps); radii (x, y, z);
            (radius,); for a mesh its scale (x, y, z)
    pose  : (4, 4) in the frame of the link
    mesh  : address of the mesh file, as in the robot file; "" for an asset
    color : red, green, blue, opacity from 0 to 1; None if the file gives none
    asset : number of a mesh of MuJoCo's compiled model, whose triangles are drawn; -1: those of the file
    """

    kind: str
    size: tuple
    pose: np.ndarray
    mesh: str = ""
    color: tuple | None = None
    asset: int = -1


@dataclass
class Collision:
    """Shape of a link for contacts; what is wrong with it is an error only if it is read.

    line     : line of the file; 0 if unknown
    shape    : function () -> its Visual, or None if it is no known shape
    friction : function () -> coefficient of friction; None if the file gives none
    """

    line: int
    shape: Callable
    friction: Callable | None = None


@dataclass
class Link:
    """Rigid link.

    mass    : kg; 0 if the file gives no inertia
    com     : (3,) m, centre of mass in the frame of the link
    inertia : (3, 3) kg m^2 about the centre of mass, axes of the link
    pose    : (4, 4) in the world when all joint coordinates are 0; of a floating link at the start
    twist   : (6,) of a floating link at the start, angular first, axes of the link, rad/s and m/s
    lacks   : (line, text) if its inertia has no <mass> or no <inertia>
    weight  : fraction of gravity that acts on it
    line    : line of the file; 0 if unknown
    """

    name: str
    line: int = 0
    mass: float = 0.0
    com: np.ndarray = field(default_factory=lambda: np.zeros(3))
    inertia: np.ndarray = field(default_factory=lambda: np.zeros((3, 3)))
    pose: np.ndarray = field(default_factory=lambda: np.eye(4))
    twist: np.ndarray = field(default_factory=lambda: np.zeros(6))
    visuals: list = field(default_factory=list)
    collisions: list = field(default_factory=list)
    lacks: tuple | None = None
    weight: float = 1.0

    @property
    def moves_nothing(self):
        """True if the link has neither mass nor inertia."""
        return self.mass == 0.0 and not self.inertia.any()


@dataclass
class RobotJoint:
    """Joint between two links, or between the world and a link.

    type          : joint type of a scene; floating for no joint
    parent_frame  : (4, 4) in the frame of the parent; child_frame: in the frame of the child
    closes        : True for a joint outside of the file's tree
    damping       : N m s/rad or N s/m
    stiffness, rest  : of the spring: N m/rad or N/m, and the coordinate where its effort is 0
    rotor         : {"inertia": kg m^2, "ratio": of the gear} of the rotor that turns with it; {} for none
    stop          : {"stiffness": N m/rad or N/m, "damping": N m s/rad or N s/m} of compliant stops
    coordinate, rate : start values that assembly keeps, rad or m, rad/s or m/s; None: free
    efforts       : (least, largest) sum of the efforts of actuators, N m or N
    data          : {name: number} that the simulation does not use: lower, upper, ...
    """

    name: str
    type: str
    parent: str
    child: str
    parent_frame: np.ndarray
    child_frame: np.ndarray
    line: int = 0
    closes: bool = False
    pitch: float = 0.0
    length: float | None = None
    radius: float | None = None
    mu: float | None = None
    frictionless: bool | None = None
    damping: float = 0.0
    stiffness: float = 0.0
    rest: float = 0.0
    rotor: dict = field(default_factory=dict)
    stop: dict = field(default_factory=dict)
    coordinate: float | None = None
    rate: float | None = None
    efforts: tuple = (-math.inf, math.inf)
    data: dict = field(default_factory=dict)

    @property
    def direction(self):
        """(6,) twist of the child's joint frame relative to the parent's, own axes, at joint velocity 1; or 0."""
        turns, slides = self.type in ("revolute", "screw"), self.type == "prismatic"
        return np.array([0.0, 0.0, turns, 0.0, 0.0, self.pitch * turns + slides])

    def motion(self, value):
        """(4, 4) pose of the child's frame in the parent's at a coordinate, rad or m; or such a pose itself."""
        return value if isinstance(value, np.ndarray) else SE3.exp(value * self.direction)

    def turned(self, value):
        """Whole turns in an angle, rad: a scene unwraps angles of forces and couplings from (-pi, pi]; 0 of a slide."""
        return 0.0 if self.type == "prismatic" else value - within_a_turn(value, UNKNOWN_TURN)

    def twist(self, value):
        """(6,) twist of the child's frame relative to the parent's, own axes, at a velocity; or such a twist itself."""
        return value if isinstance(value, np.ndarray) else value * self.direction


@dataclass
class Relation:
    """Relation of joint coordinates, first = offset + ratio second + a_2 second^2 + ...; see fields/curve.py.

    offset : None: computed from the start values;  curve : (a_2, ...)
    further : {joint: c} of further terms c q, of a relation of more than two joints
    backlash : as in a scene; {} for a rigid relation
    """

    name: str
    first: str
    second: str
    ratio: float
    offset: float | None
    line: int = 0
    curve: tuple = ()
    further: dict = field(default_factory=dict)
    backlash: dict = field(default_factory=dict)

    @property
    def terms(self):
        """{joint: its coefficient c} of sum c q = offset; the curve is that of `second`."""
        shares = {self.second: self.ratio} | self.further
        bent = any(self.curve)
        return {self.first: 1.0} | {name: -c for name, c in shares.items() if c or (bent and name == self.second)}

    def rest(self, values):
        """Sum of the further terms at {joint: coordinate}."""
        return sum(c * values[name] for name, c in self.further.items())

    def solved(self, name, values):
        """Coordinate of one of its joints at {joint: coordinate} of the others; of `second` the nearest one."""
        if name == self.second:
            return other_at(self, values[self.first] - self.rest(values), values[name])
        wanted = rise(self, values[self.second]) + self.rest(values) + self.offset
        return wanted if name == self.first else values[name] + (values[self.first] - wanted) / self.further[name]


@dataclass
class RobotSensor:
    """Sensor of a link or joint.

    type   : sensor type of a scene
    link   : link that it is fixed to, or None; joint: joint that it measures, or None
    frame  : (4, 4) in the frame of the link, or of the joint's child; None: the joint frame
    values : other keys of the sensor in a scene
    points : [(link, (3,) point)], the two ends of a distance
    """

    name: str
    type: str
    line: int = 0
    link: str | None = None
    joint: str | None = None
    frame: np.ndarray | None = None
    values: dict = field(default_factory=dict)
    points: list = field(default_factory=list)


@dataclass
class Robot:
    """Whole robot.

    file     : path for error messages;  kind: URDF, SDF or MJCF
    roots    : root links of the file's tree; `base` fixes them or lets them float
    free     : True if the roots float unless a joint holds them, as in SDF and MJCF
    gravity  : (3,) m/s^2, or None if the file has none
    remarks  : {what: [names]}: decisions of the import
    left_out : {what: [names]}: omitted parts that do not change the motion
    changes  : {what: [names]}: omitted parts that change the motion
    start    : {joint: coordinate} at the start, unless a pose or a user gives another; start_velocity: its velocities
    poses    : {name of a pose: {joint: coordinate}}; velocities: {its name: {joint: velocity}}; of joints with
               several coordinates the (4, 4) pose of the child's frame in the parent's, and its (6,) twist
    root_poses : {name of a pose: {root link: ((4, 4) pose, (6,) twist in its axes)}}, used if it floats
    loose    : [Relation] with backlash
    tendons  : [tendons.Tendon]
    actuators: [actuators.Actuator];  commands: {name of a pose: {actuator: (control, activation)}}
    locked   : {joint: coordinate} of joints that do not move
    text     : URDF text of the robot, "" for other kinds
    fixtures : [Visual] of the world, besides those of links
    planes   : [(name, (4, 4) pose whose z axis is its normal, coefficient of friction)] of the world that links touch
    """

    name: str
    file: str
    kind: str
    links: dict = field(default_factory=dict)
    joints: list = field(default_factory=list)
    couplings: list = field(default_factory=list)
    relations: list = field(default_factory=list)
    loose: list = field(default_factory=list)
    sensors: list = field(default_factory=list)
    tendons: list = field(default_factory=list)
    actuators: list = field(default_factory=list)
    commands: dict = field(default_factory=dict)
    roots: list = field(default_factory=list)
    free: bool = False
    gravity: tuple | None = None
    remarks: dict = field(default_factory=dict)
    left_out: dict = field(default_factory=dict)
    changes: dict = field(default_factory=dict)
    start: dict = field(default_factory=dict)
    start_velocity: dict = field(default_factory=dict)
    poses: dict = field(default_factory=dict)
    velocities: dict = field(default_factory=dict)
    root_poses: dict = field(default_factory=dict)
    locked: dict = field(default_factory=dict)
    text: str = ""
    fixtures: list = field(default_factory=list)
    planes: list = field(default_factory=list)

    def size(self, base):
        """(number of links, number of joint coordinates of the tree); base: see robots.options.Options.

        A part that no joint connects to the world has six more coordinates, those of a free body.
        """
        part = {name: name for name in (WORLD, *self.links)}

        def part_of(name):
            while part[name] != name:
                part[name] = part[part[name]]
                name = part[name]
            return name

        ends = [(WORLD, name, 0) for name in self.roots if base == "fixed"]
        ends += [
            (joint.parent, joint.child, COORDINATES[joint.type])
            for joint in self.joints
            if not joint.closes and joint.type != "floating"
        ]
        coordinates = 0
        for parent, child, own in ends:
            first, second = part_of(parent), part_of(child)
            if first != second:  # otherwise it closes a loop
                part[second] = first
                coordinates += own
        parts = {part_of(name) for name in part}
        return len(part) - 1, coordinates + COORDINATES["floating"] * (len(parts) - 1)

    def joint(self, name):
        """RobotJoint with this name, or None."""
        return next((joint for joint in self.joints if joint.name == name), None)

    def error(self, line, message):
        """SceneError at a line of the file."""
        return refusal(self.file, line, message)

    def check_couplings(self):
        """Raise SceneError for a coupling of unknown joints, and for cyclic mimic joints."""
        types = {joint.name: joint.type for joint in self.joints}
        for coupling in self.couplings:
            for name in (coupling.first, coupling.second):
                if name not in types:
                    raise self.error(
                        coupling.line,
                        f'joint "{coupling.first}" mimics "{coupling.second}": joint {name!r:.60} '
                        f"does not exist; {suggestion(name, sorted(types))}",
                    )
            for name in (coupling.first, coupling.second):
                if types[name] not in (*ONE_COORDINATE, "fixed"):
                    raise self.error(
                        coupling.line,
                        f'joint "{coupling.first}" mimics "{coupling.second}": joint "{name}" is '
                        f"{types[name]}, and only joints with one coordinate can be coupled",
                    )
        for coupling in self.couplings:
            if types[coupling.first] == "fixed":
                self.leave_out("couplings of fixed joints, which cannot follow", coupling.first)
        self.couplings = [each for each in self.couplings if types[each.first] != "fixed"]
        mimics = {coupling.first: coupling for coupling in self.couplings}
        for coupling in self.couplings:
            seen, name = [coupling.first], coupling.second
            while name in mimics and name not in seen:
                seen.append(name)
                name = mimics[name].second
            if name in seen:
                raise self.error(
                    coupling.line,
                    f"joints mimic each other in a circle: {' -> '.join([*seen[:6], name])}; "
                    "one of them must not mimic another joint",
                )

    def remark(self, what, name):
        """Note a decision of the import about a part of the file."""
        self.remarks.setdefault(what, []).append(name)

    def start_at(self, joint, value, rate=False):
        """Set the coordinate of a RobotJoint at the start, or its velocity."""
        if value and joint.type in ONE_COORDINATE:
            (self.start_velocity if rate else self.start)[joint.name] = value
            self.remark(f"start {'velocities' if rate else 'values'} of the file", f"{joint.name} = {value:.6g}")
        elif value:
            self.leave_out(f"start values of {joint.type} joints", joint.name, changes_motion=True)

    def leave_out(self, what, name, changes_motion=False):
        """Note a part of the file that the scene omits."""
        names = (self.changes if changes_motion else self.left_out).setdefault(what, [])
        if name not in names:
            names.append(name)

    def leave_out_unknown(self, root, known):
        """Note elements and attributes that the format does not define, such as misspelt ones.

        In elements that define the motion, they are noted as changes of the motion.

        known : {tag: (children, attributes)}, each separated by blanks; other elements are not checked
        """
        known = {tag: [set(part.split()) for part in parts] for tag, parts in known.items()}
        for element in root.iter(*known):
            children, attributes = known[element.tag]
            odd = [f"<{part.tag}>" for part in element if part.tag not in children]
            odd += [key for key in element.keys() if key not in attributes]
            parent = element.getparent()
            drawn = element.tag == "origin" and parent is not None and parent.tag == "visual"
            for name in odd:
                if "}" not in name:  # other tools use their own namespaces
                    options = children if name.startswith("<") else attributes
                    hint = meant(name.strip("<>"), options)
                    where = f"{name} in <{element.tag}> of line {element.sourceline}{hint}"
                    moves = (
                        element.tag in MOTION
                        or (element.tag == "origin" and not drawn)
                        or (element.tag == "joint" and name.startswith("<"))
                        or (element.tag == "limit" and bool(hint))  # <limit> has parts without an effect, too
                    )
                    self.leave_out(f"unknown parts of the {self.kind} file", where, moves)


def meant(word, options):
    """Hint with the option that is most similar to a misspelt word, or ""."""
    close = difflib.get_close_matches(word, options, n=1, cutoff=0.7)
    return f" (did you mean {close[0]}?)" if close else ""


def refusal(file, line, message, kind=SceneError):
    """Error of class `kind` at a line of a file."""
    if len(message) > LONGEST_MESSAGE:
        message = f"{message[:LONGEST_MESSAGE]}..."
    return kind(f"{file}:{line}: {message}" if line else f"{file}: {message}")


def place(position=(0.0, 0.0, 0.0), rotation=None):
    """(4, 4) pose."""
    pose = np.eye(4)
    pose[:3, 3] = position
    if rotation is not None:
        pose[:3, :3] = rotation
    return pose


def frame_keys(pose):
    """Keys of a scene for a pose (4, 4); {} for the identity. Round-off is replaced by zero."""
    keys = {}
    if pose[:3, 3].any():
        keys["position"] = pose[:3, 3]
    if not np.array_equal(pose[:3, :3], np.eye(3)):
        found = SO3.to_quaternion(pose[:3, :3])
        keys["quaternion"] = np.where(np.abs(found) <= 1e-16, 0.0, found)
    return keys


def rotation_of_rpy(roll, pitch, yaw):
    """(3, 3) rotation Rz(yaw) Ry(pitch) Rx(roll), the convention of URDF and SDF."""
    (cr, cp, cy), (sr, sp, sy) = np.cos((roll, pitch, yaw)), np.sin((roll, pitch, yaw))
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def listed(names):
    """Text that lists names in a note."""
    return ", ".join(names)


def rpy_of_rotation(R):
    """Roll, pitch and yaw in rad of a rotation (3, 3); if they are not unique, yaw is 0."""
    level = math.hypot(R[0, 0], R[1, 0])
    pitch = math.atan2(-R[2, 0], level)
    if level < 1e-9:
        return math.atan2(-R[1, 2], R[1, 1]), pitch, 0.0
    return math.atan2(R[2, 1], R[2, 2]), pitch, math.atan2(R[1, 0], R[0, 0])
