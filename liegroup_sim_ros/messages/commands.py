# SPDX-License-Identifier: Apache-2.0
"""Commands for joints: decoding of sensor_msgs/JointState, encoding of what acts. Imports no ROS."""

import math
from typing import NamedTuple

from .cdr import Template, stamp
from .codecs import Fields, MessageError

JOINT_STATE = "sensor_msgs/msg/JointState"
_STAMP_END = 12  # offset of the frame id in the payload


class JointValues(NamedTuple):
    """Content of a JointState; each of the last three has a number per name, or is empty."""

    stamp_ns: int
    names: tuple
    position: tuple  # rad or m
    velocity: tuple  # rad/s or m/s
    effort: tuple  # N m or N

    def complete(self):
        """Itself. Raises MessageError unless every name has a position and a velocity."""
        if any(len(part) != len(self.names) for part in (self.position, self.velocity)):
            raise MessageError(
                f"{JOINT_STATE}: the number of values differs from the number of joints"
            )
        return self


class JointStateDecoder:
    """Decoder of JointState; names that repeat from message to message are decoded once.

    most : largest number of names
    """

    def __init__(self, most=100_000):
        self._most = most
        self._known = b"", (), 0  # bytes of frame id and names, the names, where the values begin

    def decode(self, payload):
        """JointValues of one payload. Raises MessageError; lengths are not compared."""
        fields = Fields(JOINT_STATE, payload)
        stamp_ns = fields.stamp_ns()
        known, names, end = self._known
        if end and payload[:2] + payload[_STAMP_END:end] == known:
            fields.skip_to(end)
        else:
            fields.text()
            count = fields.number("I")
            if count > self._most:
                raise MessageError(
                    f"{JOINT_STATE}: {count} names, at most {self._most} can be right"
                )
            names = tuple(fields.text() for _ in range(count))
            self._known = payload[:2] + payload[_STAMP_END : fields.at], names, fields.at
        values = [fields.numbers("d", fields.number("I")) for _ in range(3)]
        return JointValues(stamp_ns, names, *values)


def joint_labels(joints, robot):
    """[name in messages] of joints of a scene: of a robot the name in its file.

    robot : RobotNames, or None
    """
    return list(joints) if robot is None else [robot.joints.get(joint, joint) for joint in joints]


def servo_targets(layout):
    """Function (stamp_ns, [(position, velocity)]) -> serialized JointState of all servos.

    Servos are in the order of `layout.servos`; efforts are NaN.
    """
    labels = joint_labels(layout.servos, layout.scene.robot)
    count = len(labels)
    template = Template()
    template.header("")
    template.put("I", count)
    for label in labels:
        template.string(label)
    for _ in ("position", "velocity"):
        template.put("I", count)
        template.slot(f"{count}d")
    template.put("I", count)
    template.put(f"{count}d", *[math.nan] * count)

    def encode(stamp_ns, targets):
        position, velocity = zip(*targets)
        return template.pack(stamp(stamp_ns), position, velocity)

    return encode
