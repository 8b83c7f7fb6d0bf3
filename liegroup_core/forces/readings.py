# SPDX-License-Identifier: Apache-2.0
"""What laws can read: quantities of the catalogue that follow from positions and velocities, and their derivatives.

A quantity is OWNER.PART, with the names of observables/quantities.py. TABLE has those of joints and bodies, OF_SENSOR
the numbers of each type of sensor, in their order, None for one that depends on accelerations. A Reading says what it
is, in terms that the kernels here evaluate and differentiate.
"""

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from liegroup_core.compiling import kernel
from liegroup_core.lie.so3 import so3_to_quaternion
from liegroup_core.lie.vec3 import add3, cross3, dot3, load3, load9, matmul3, matrix3, matvec3, sub3, tmatvec3, vector3

from . import axis
from .points import point, point_velocity, turning

# What it is
POSITION, RATE, PLACE, ATTITUDE, SPIN, SPEED, PLACE_RATE, WORLD_SPIN, DIRECTION, DISTANCE, DISTANCE_RATE = range(11)
ORIGIN, UNIT = (0.0, 0.0, 0.0), np.eye(3)


INPUT = np.dtype(
    [  # see Reading
        ("what", "i8"),
        ("component", "i8"),
        ("to", "i8"),  # register
        ("body", "i8"),
        ("other", "i8"),
        ("point", "f8", (3,)),
        ("other_point", "f8", (3,)),
        ("axes", "f8", (9,)),
        ("direction", "f8", (3,)),
        ("offset", "f8"),
        ("resolution", "f8"),
        ("angle", "i8"),  # index of the unwrapped angle, or -1
        ("unit", "i8"),  # first of the registers with the unit wrenches of the joint, see axis.keep_unit
        *axis.FIELDS,
    ],
    align=True,
)


class Reading(NamedTuple):
    """Number of a state."""

    what: int
    joint: str = ""
    body: str = ""  # or the parent, which may be the world
    other: str = ""  # child of a distance
    component: int = 0  # of a place or a quaternion
    point: Iterable[float] = ORIGIN  # m, in the frame of the body
    other_point: Iterable[float] = ORIGIN
    axes: np.ndarray = UNIT  # of a frame in the body, whose attitude or velocity it is
    direction: Iterable[float] = ORIGIN  # in the axes of the body, of a velocity
    offset: float = 0.0  # added
    resolution: float = 0.0  # it is rounded down to multiples of this; 0: exact
    sensor: str = ""  # whose noise is added
    number: int = 0  # of the sensor


_OF_BODY = (
    {name: Reading(PLACE, component=k) for k, name in enumerate("xyz")}
    | {f"q{name}": Reading(ATTITUDE, component=k) for k, name in enumerate("xyzw")}
    | {f"w{name}": Reading(SPIN, direction=tuple(UNIT[k])) for k, name in enumerate("xyz")}
    | {f"v{name}": Reading(SPEED, direction=tuple(UNIT[k])) for k, name in enumerate("xyz")}
    | {f"d{name}": Reading(PLACE_RATE, component=k) for k, name in enumerate("xyz")}
    | {f"o{name}": Reading(WORLD_SPIN, component=k) for k, name in enumerate("xyz")}
)
# Of contacts: the vector that is given as a point, in world axes.
_OF_CONTACT = {f"n{name}": Reading(DIRECTION, component=k) for k, name in enumerate("xyz")}
TABLE = {"joint": {"position": Reading(POSITION), "velocity": Reading(RATE)}, "body": _OF_BODY}
POINTS = tuple(part for part, reading in _OF_BODY.items() if reading.what in (PLACE, SPEED, PLACE_RATE))


def _frame(sensor):
    """(axes (3, 3), origin (3,) m) of the frame of a sensor in its body."""
    pose = np.eye(4) if sensor.frame is None else sensor.frame.pose
    return pose[:3, :3], tuple(pose[:3, 3])


def _quaternion(sensor):
    axes, _ = _frame(sensor)
    return [Reading(ATTITUDE, body=sensor.body, component=k, axes=axes) for k in range(4)]


def _velocities(sensor, what, offsets=ORIGIN):
    axes, origin = _frame(sensor)
    return [
        Reading(what, body=sensor.body, point=origin, direction=tuple(axes[:, k]), offset=offsets[k]) for k in range(3)
    ]


def _of_pose(sensor):
    _, origin = _frame(sensor)
    places = [Reading(PLACE, body=sensor.body, component=k, point=origin) for k in range(3)]
    return [*places, *_quaternion(sensor), *_velocities(sensor, SPEED), *_velocities(sensor, SPIN)]


def _of_imu(sensor):
    return [*_quaternion(sensor), *_velocities(sensor, SPIN, sensor.angular_velocity_bias), None, None, None]


def _of_distance(sensor):
    ends = {"body": sensor.parent, "other": sensor.child}
    ends |= {"point": sensor.parent_point, "other_point": sensor.child_point}
    return [Reading(DISTANCE, **ends), Reading(DISTANCE_RATE, **ends)]


OF_SENSOR = {
    "encoder": lambda sensor: [Reading(POSITION, joint=sensor.joint, resolution=sensor.resolution or 0.0)],
    "pose": _of_pose,
    "imu": _of_imu,
    "distance": _of_distance,
    "force_torque": lambda sensor: [None] * 6,
}


def readings_of(sensor):
    """[Reading or None] of the numbers of a sensor."""
    rows = OF_SENSOR[sensor.type](sensor)
    return [row and row._replace(sensor=sensor.name, number=k) for k, row in enumerate(rows)]


def reading(quantity, joints, sensors, point=None):
    """Reading of a valid quantity of a joint, a body or a sensor.

    joints : names;  sensors : {name: sensor};  point : m, of a body
    """
    owner, _, part = quantity.rpartition(".")
    if owner in sensors:
        return readings_of(sensors[owner])[number_of(sensors[owner], part)]
    if owner in joints and part in TABLE["joint"]:
        return TABLE["joint"][part]._replace(joint=owner)
    found = (_OF_BODY | _OF_CONTACT)[part]._replace(body=owner)
    return found if point is None else found._replace(point=point)


def names_of(bodies, moves, sensors):
    """Names of the quantities that laws can read; moves : names of the joints with one coordinate."""
    names = [f"{joint}.{part}" for joint in moves for part in TABLE["joint"]]
    names += [f"{body}.{part}" for body in bodies for part in TABLE["body"]]
    for each in sensors:
        numbers = [k for k, row in enumerate(readings_of(each)) if row is not None]
        names += [f"{each.name}.{each.parts[k].partition(' [')[0]}" for k in numbers]
        names += [f"{each.name}.{k}" for k in numbers]
    return names


def number_of(sensor, part):
    """Place of a number of a sensor, by this place or by what it is, such as wx of an IMU."""
    return int(part) if part.isdigit() else [text.partition(" [")[0] for text in sensor.parts].index(part)


def varies(sensor, number):
    """Whether a number of a sensor has noise or a resolution: then only a law with a period can read it."""
    noise = getattr(sensor, "noise", ())
    return number < len(noise) and noise[number] > 0.0 or getattr(sensor, "resolution", None) is not None


def input_row(found, to, index, angles, unit, motion):
    """Record of INPUT of a Reading.

    to, unit : registers;  index : {body: number};  angles : {joint: index of its angle}
    motion : axis.fields of its joint
    """
    bodies = [index[body] if body else -1 for body in (found.body, found.other)]
    where = found.point, found.other_point, np.ravel(found.axes), found.direction
    row = found.what, found.component, to, *bodies, *where, found.offset, found.resolution
    return *row, angles.get(found.joint, -1), unit, *motion


@kernel
def _velocity(row, twist):
    """Velocity of the point of an input in the axes of its body."""
    body = row["body"]
    return add3(load3(twist, body, 3), cross3(load3(twist, body, 0), vector3(row["point"])))


@kernel
def _apart(row, pose):
    """Vector from the point of the parent to that of the child, world axes, and its length."""
    begin = point(pose, row["body"], vector3(row["point"]))
    apart = sub3(point(pose, row["other"], vector3(row["other_point"])), begin)
    return apart, math.sqrt(dot3(apart, apart))


@kernel
def _apart_rate(row, pose, twist):
    """Rate of this vector; for moves in place of the twist, its displacement."""
    begin = point_velocity(pose, twist, row["body"], vector3(row["point"]))
    return sub3(point_velocity(pose, twist, row["other"], vector3(row["other_point"])), begin)


@kernel
def _point_change(row, pose, twist, moves, rates, is_child):
    """Change of the velocity of the point of the child or parent along displacements, world axes."""
    body, place = row["body"], vector3(row["point"])
    if is_child:
        body, place = row["other"], vector3(row["other_point"])
    return add3(
        point_velocity(pose, rates, body, place),
        cross3(turning(pose, moves, body), point_velocity(pose, twist, body, place)),
    )


@kernel
def _over(a, length):
    """Quotient by a length; NaN for zero."""
    return a / length if length > 0.0 else math.nan


@kernel
def _turned(q, turn, k):
    """Component k of the derivative of a quaternion (x, y, z, w) along a rotation vector in body axes."""
    x, y, z, w = q
    if k == 0:
        return 0.5 * (w * turn[0] + y * turn[2] - z * turn[1])
    if k == 1:
        return 0.5 * (w * turn[1] + z * turn[0] - x * turn[2])
    if k == 2:
        return 0.5 * (w * turn[2] + x * turn[1] - y * turn[0])
    return -0.5 * (x * turn[0] + y * turn[1] + z * turn[2])


@kernel
def read_all(inputs, angle, pose, twist, registers):
    """Write the values of inputs (k,) to their registers; angle : (a,) rad, unwrapped angles after the last step."""
    for e in range(len(inputs)):
        row = inputs[e]
        what, k, body, value = row["what"], row["component"], row["body"], row["offset"]
        if what == POSITION:
            value = axis.coordinate(row, pose, angle[row["angle"]] if row["angle"] >= 0 else 0.0)
        elif what == RATE:
            value = axis.rate(row, axis.kept_unit(registers, row["unit"]), twist)
        elif what == PLACE:
            value = point(pose, body, vector3(row["point"]))[k]
        elif what == ATTITUDE:
            value = so3_to_quaternion(matmul3(load9(pose, body, 0), matrix3(row["axes"])))[k]
        elif what == SPIN:
            value += dot3(vector3(row["direction"]), load3(twist, body, 0))
        elif what == SPEED:
            value += dot3(vector3(row["direction"]), _velocity(row, twist))
        elif what == PLACE_RATE:
            value = point_velocity(pose, twist, body, vector3(row["point"]))[k]
        elif what == WORLD_SPIN:
            value = turning(pose, twist, body)[k]
        elif what == DIRECTION:
            value = matvec3(load9(pose, body, 0), vector3(row["point"]))[k]
        else:
            apart, length = _apart(row, pose)
            value = length
            if what == DISTANCE_RATE:
                value = _over(dot3(apart, _apart_rate(row, pose, twist)), length)
        if row["resolution"] > 0.0:
            value = row["resolution"] * math.floor(value / row["resolution"])
        registers[row["to"], 0] = value


@kernel
def read_changes(inputs, pose, twist, moves, rates, registers):
    """Write the derivatives of inputs (k,) along displacements to their registers, see kinds.add_changes."""
    for e in range(len(inputs)):
        row = inputs[e]
        what, k, body, value = row["what"], row["component"], row["body"], 0.0
        if what == POSITION:
            value = axis.rate(row, axis.kept_unit(registers, row["unit"]), moves)
        elif what == RATE:
            value = axis.rate_change(row, axis.kept_unit(registers, row["unit"]), pose, twist, moves, rates)
        elif what == PLACE:
            value = point_velocity(pose, moves, body, vector3(row["point"]))[k]
        elif what == ATTITUDE:
            axes = matrix3(row["axes"])
            q = so3_to_quaternion(matmul3(load9(pose, body, 0), axes))
            value = _turned(q, tmatvec3(axes, load3(moves, body, 0)), k)
        elif what == SPIN:
            value = dot3(vector3(row["direction"]), load3(rates, body, 0))
        elif what == SPEED:
            value = dot3(vector3(row["direction"]), _velocity(row, rates))
        elif what == PLACE_RATE:
            value = _point_change(row, pose, twist, moves, rates, False)[k]
        elif what == WORLD_SPIN:
            turned = cross3(turning(pose, moves, body), turning(pose, twist, body))
            value = add3(turning(pose, rates, body), turned)[k]
        elif what == DIRECTION:
            arm = matvec3(load9(pose, body, 0), vector3(row["point"]))
            value = cross3(turning(pose, moves, body), arm)[k]
        else:
            apart, length = _apart(row, pose)
            moved = _apart_rate(row, pose, moves)
            if length > 0.0:
                value = dot3(apart, moved) / length
                if what == DISTANCE_RATE:
                    rate = _apart_rate(row, pose, twist)
                    change = sub3(
                        _point_change(row, pose, twist, moves, rates, True),
                        _point_change(row, pose, twist, moves, rates, False),
                    )
                    value = (dot3(moved, rate) + dot3(apart, change) - value * dot3(apart, rate) / length) / length
        registers[row["to"], 1] = value
