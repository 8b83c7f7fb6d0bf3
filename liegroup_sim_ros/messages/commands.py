# SPDX-License-Identifier: Apache-2.0
"""Commands for joints: decoding of the messages, encoding of the values that act."""

import math
import struct
from typing import NamedTuple

from . import matrices
from .cdr import Template, stamp
from .codecs import BYTE_ORDER, Fields, MessageError

JOINT_STATE = "sensor_msgs/msg/JointState"
TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
ARRAY = matrices.TYPE
MOST_POINTS = 10_000
MOST_DIMENSIONS = 100
_STAMP_END = 12  # offset of the frame id in the payload


class JointValues(NamedTuple):
    """Content of a JointState; each of the last three has a number per name, or is empty."""

    stamp_ns: int
    names: tuple
    position: tuple  # rad or m
    velocity: tuple  # rad/s or m/s
    effort: tuple  # N m or N

    def complete(self):
        """Return self. Raises MessageError unless every name has a position and a velocity."""
        if any(len(part) != len(self.names) for part in (self.position, self.velocity)):
            raise MessageError(f"{JOINT_STATE}: the number of values differs from the number of joints")
        return self


class JointStateDecoder:
    """Decoder of JointState; names that repeat from message to message are decoded once.

    most : largest number of names
    """

    def __init__(self, most=100_000):
        self._most = most
        self._known = b"", (), 0  # bytes of frame id and names, the names, where the values begin
        # Of the last message, for the next one of the same size: function that unpacks all numbers, and their counts.
        self._unpack, self._counts, self._size = None, (), 0

    def decode(self, payload):
        """JointValues of one payload. Raises MessageError; does not compare the lengths of the fields."""
        known, names, end = self._known
        is_known = end and payload[:2] + payload[_STAMP_END:end] == known
        if is_known and len(payload) == self._size:
            numbers = self._unpack(payload)
            a, b, c = self._counts
            if (numbers[2], numbers[3 + a], numbers[4 + a + b]) == self._counts:
                values = numbers[3 : 3 + a], numbers[4 + a : 4 + a + b], numbers[5 + a + b :]
                return JointValues(numbers[0] * 1_000_000_000 + numbers[1], names, *values)
        fields = Fields(JOINT_STATE, payload)
        stamp_ns = fields.stamp_ns()
        if is_known:
            fields.skip_to(end)
        else:
            fields.text()
            names = tuple(fields.text() for _ in range(fields.count(self._most, "names")))
            self._known = payload[:2] + payload[_STAMP_END : fields.at], names, fields.at
        values = [fields.numbers("d", fields.count(self._most, "numbers")) for _ in range(3)]
        self._counts, self._size = tuple(map(len, values)), len(payload)
        self._unpack = _unpacker(BYTE_ORDER[payload[:2]], self._known[2], self._counts)
        return JointValues(stamp_ns, names, *values)


def _unpacker(order, at, counts):
    """Function that unpacks stamp, then count and numbers of each field, of a JointState; at : of the first."""
    form = f"{order}4xiI{at - _STAMP_END}x"
    for count in counts:
        gap = -at % 4
        form, at = f"{form}{gap}xI", at + gap + 4
        if count:
            gap = (4 - at) % 8  # counts from the end of the encapsulation
            form, at = f"{form}{gap}x{count}d", at + gap + 8 * count
    return struct.Struct(form).unpack_from


class Point(NamedTuple):
    """Point of a JointTrajectory; each of the first four has a number per joint, or is empty."""

    position: tuple  # rad or m
    velocity: tuple  # rad/s or m/s
    acceleration: tuple  # rad/s^2 or m/s^2
    effort: tuple  # N m or N
    time_ns: int  # since the start


def decode_trajectory(payload, most):
    """(stamp in ns, names, [Point]) of a JointTrajectory. Raises MessageError.

    most : largest number of names
    """
    fields = Fields(TRAJECTORY, payload)
    stamp_ns = fields.stamp_ns()
    fields.text()
    names = tuple(fields.text() for _ in range(fields.count(most, "names")))
    points = []
    for _ in range(fields.count(MOST_POINTS, "points")):
        numbers = [fields.numbers("d", fields.count(most, "numbers")) for _ in range(4)]
        points.append(Point(*numbers, fields.stamp_ns()))
    return stamp_ns, names, points


def decode_array(payload, most=100_000):
    """The numbers of a Float64MultiArray; its layout is ignored. Raises MessageError.

    most : largest length
    """
    fields = Fields(ARRAY, payload)
    for _ in range(fields.count(MOST_DIMENSIONS, "dimensions")):
        fields.text()
        fields.numbers("I", 2)
    fields.number("I")
    return fields.numbers("d", fields.count(most, "numbers"))


def joint_labels(joints, robot):
    """[name in messages] of joints of a scene; for a robot, the names in its file.

    robot : RobotNames, or None for other scenes
    """
    return list(joints) if robot is None else [robot.joints.get(joint, joint) for joint in joints]


# Columns of ~/motions: s, then rad or m and their derivatives.
MOTION_COLUMNS = ("origin", *(f"c{k}" for k in range(6)))


def motions(layout):
    """Function (numbers of all motions (d, 7)) -> serialized Float64MultiArray; see matrices.py.

    Driven joints are in the order of `layout.motions`; an infinite origin means the motion of the scene.
    """
    return matrices.encoder(joint_labels(layout.motions, layout.scene.robot), MOTION_COLUMNS)


def decode_motions(payload):
    """(names of the driven joints, numbers of all motions (d, 7)). Raises MessageError."""
    return matrices.decode(payload, MOTION_COLUMNS)[::2]


def joint_state_template(labels):
    """Template of a JointState; its slots are the stamp, positions, velocities and efforts."""
    template, count = Template(), len(labels)
    template.header("")
    template.put("I", count)
    for label in labels:
        template.string(label)
    for _ in ("position", "velocity", "effort"):
        template.put("I", count)
        template.slot(f"{count}d")
    return template


def servo_targets(layout):
    """Function (stamp_ns, [(position, velocity)]) -> serialized JointState of all servos.

    Servos are in the order of `layout.servos`; efforts are NaN.
    """
    labels = joint_labels(layout.servos, layout.scene.robot)
    pack, none = joint_state_template(labels).pack, [math.nan] * len(labels)
    return lambda stamp_ns, targets: pack(stamp(stamp_ns), *zip(*targets), none)
