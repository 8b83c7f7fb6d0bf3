# SPDX-License-Identifier: Apache-2.0
"""Poses and twists of all bodies in one message each: geometry_msgs/PoseArray, and a labelled matrix.

Bodies are in the order of the scene. The rows of the twists have their names, see matrices.py; the
columns are linear first, as in TwistStamped.
"""

from . import matrices
from .cdr import Template, stamp
from .codecs import Fields, MessageError

TYPE = "geometry_msgs/msg/PoseArray"
POSE = 7  # numbers: position, quaternion
UNITS = *("m/s",) * 3, *("rad/s",) * 3  # of the columns of twists
STAMP = slice(4, 12)  # bytes of a message


def pose_encoder(count, world_frame):
    """Function (bytes of a stamp, bytes of the numbers of all bodies) -> serialized message."""
    template = Template()
    template.header(world_frame)
    template.put("I", count)
    template.slot(f"{POSE * count}d")
    head = template.pack(stamp(0), [0.0] * POSE * count)[: -8 * POSE * count]
    before, after = head[: STAMP.start], head[STAMP.stop :]
    return lambda time, numbers: before + time + after + numbers


def twist_encoder(names):
    """Function bytes of the numbers of all bodies -> serialized message."""
    count = len(UNITS) * len(names)
    return matrices.encoder(names, UNITS)([0.0] * count)[: -8 * count].__add__


def decode_poses(rows, names, world_frame):
    """(m, 7 n) numbers of messages of one size about n bodies, given as rows (m, size) uint8. Raises MessageError."""

    def numbers(payload):
        fields = Fields(TYPE, payload)
        fields.stamp_ns()
        frame, count = fields.text(), fields.number("I")
        if frame != world_frame or count != len(names):
            raise MessageError(f"{TYPE}: {count} poses in {frame!r:.60}, not {len(names)} in {world_frame!r:.60}")
        return fields.numbers("d", POSE * count)

    return matrices.last_numbers(rows, POSE * len(names), numbers, STAMP)


def decode_twists(rows, names, _world_frame):
    """(m, 6 n) numbers, angular first, of messages of one size. Raises MessageError."""
    values = matrices.decode_rows(rows, names, UNITS).reshape(len(rows), len(names), 2, 3)
    return values[:, :, ::-1].reshape(len(rows), -1)
