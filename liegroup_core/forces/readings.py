# SPDX-License-Identifier: Apache-2.0
"""What laws can read: quantities of the catalogue that follow from positions and velocities, and their derivatives.

A quantity is OWNER.PART, with the names of observables/quantities.py. TABLE has those of joints and bodies, OF_SENSOR
the numbers of each type of sensor, in their order, None for one that depends on accelerations. A Reading says what it
is, in terms that the kernels of law.py evaluate and differentiate.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

POSITION, RATE, PLACE, ATTITUDE, SPIN, SPEED, DISTANCE, DISTANCE_RATE = range(8)  # what a reading is
ORIGIN, UNIT = (0.0, 0.0, 0.0), np.eye(3)


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
)
TABLE = {"joint": {"position": Reading(POSITION), "velocity": Reading(RATE)}, "body": _OF_BODY}
POINTS = tuple(part for part, reading in _OF_BODY.items() if reading.what in (PLACE, SPEED))


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
    found = TABLE["body"][part]._replace(body=owner)
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
