# SPDX-License-Identifier: Apache-2.0
"""CDR codecs of the ROS messages that are sent at simulation rate or decoded.

Plain CDR (encapsulation 00 01, little endian): stamp and frame id of std_msgs/Header, then float64
values at the next multiple of 8 bytes after the 4-byte encapsulation. For one frame id every
offset is fixed, so a message is a few pieces of bytes and a list of messages is one numpy view;
both use `_offset_of_values`. `encode` returns the bytes of
rclpy.serialization.serialize_message (test_messages.py), except for the padding after the frame
id: Fast CDR leaves it uninitialised, here it is zero. Equal messages are therefore equal bytes, and
recordings can be compared.

Numbers are any sequence; an array's .tolist() packs three times faster than the array. Stamps are
int nanoseconds. Quaternions are x, y, z, w. Six-vectors are angular first here, (omega, v) and
(torque, force), and linear first in the messages; only this file and samples.py swap them. Decoders
also accept big-endian messages and mixed frame ids, as other recorders may write them. Anything
else raises MessageError, one line of text.

Source: OMG DDS-RTPS 2.3 section 10 (encapsulation), CORBA 3.3 part 2, section 9.3 (CDR).
"""

import struct

import numpy as np

_LITTLE_ENDIAN = b"\x00\x01\x00\x00"
BYTE_ORDER = {b"\x00\x00": ">", b"\x00\x01": "<"}
_STAMP = struct.Struct("<iI").pack
_SIX, _SEVEN = struct.Struct("<6d").pack, struct.Struct("<7d").pack
_STAMP_BYTES = slice(4, 12)
_FRAME_ID = 16  # offset of the frame id's characters in the payload
_ANGULAR_FIRST = [3, 4, 5, 0, 1, 2]  # linear first <-> angular first; its own inverse


class MessageError(ValueError):
    """The payload is not a message of the expected type; one line of text."""


class Fields:
    """Sequential decoder of the fields of a message, for rare messages.

    name, payload : message type and its bytes in plain CDR
    All methods raise MessageError if the bytes end too early.
    """

    def __init__(self, name, payload):
        self._name, self._payload, self._at = name, payload, len(_LITTLE_ENDIAN)
        self._order = BYTE_ORDER.get(payload[:2])
        if self._order is None:
            raise MessageError(f"{name}: a message is not plain CDR")

    @property
    def at(self):
        """Offset of the next field in the payload."""
        return self._at

    def skip_to(self, at):
        """Continue at another offset in the payload."""
        self._at = at

    def number(self, form):
        """One number, `form` as in struct."""
        return self.numbers(form, 1)[0]

    def numbers(self, form, count):
        """A tuple of numbers of one kind."""
        size = struct.calcsize("<" + form)
        self._at += (len(_LITTLE_ENDIAN) - self._at) % size if count else 0
        if count * size > len(self._payload) - self._at:
            raise MessageError(f"{self._name}: a message is truncated or of another type: {len(self._payload)} bytes")
        values = struct.unpack_from(f"{self._order}{count}{form}", self._payload, self._at)
        self._at += count * size
        return values

    def count(self, most, what):
        """Number of entries that follow. Raises MessageError if it exceeds `most`."""
        count = self.number("I")
        if count > most:
            raise MessageError(f"{self._name}: {count} {what}, more than the limit of {most}")
        return count

    def text(self):
        """A string."""
        size = self.number("I")
        if size > len(self._payload) - self._at:
            raise MessageError(f"{self._name}: a message is truncated or of another type: {len(self._payload)} bytes")
        self._at += size
        return self._payload[self._at - size : self._at].rstrip(b"\0").decode(errors="replace")

    def stamp_ns(self):
        """A builtin_interfaces/Time in ns."""
        return self.number("i") * 1_000_000_000 + self.number("I")


def pack_stamp(stamp_ns):
    """The 8 bytes of a stamp, for `encode_packed`: once for all messages of an instant."""
    return _STAMP(*divmod(stamp_ns, 1_000_000_000))


class _StampedCodec:
    """Message of a header, in one frame, and float64 values; six values are angular first.

    Codec(frame_id).encode(stamp_ns, six values) -> bytes
    .encode_packed(pack_stamp(stamp_ns), the bytes of the values, linear first) -> bytes
    """

    COUNT = 6

    def __init__(self, frame_id):
        self.encode_packed = _packer(frame_id)

    def encode(self, stamp_ns, values):
        return self.encode_packed(pack_stamp(stamp_ns), _SIX(*values[3:], *values[:3]))

    @classmethod
    def decode_one(cls, payload):
        """(stamp in ns, frame id, values) of one message. Raises MessageError."""
        order = BYTE_ORDER.get(payload[:2])
        if order is None:
            raise MessageError(f"{cls.TYPE}: a message is not plain CDR: it starts with 0x{payload[:2].hex()}")
        try:
            sec, nanosec, frame_size = struct.unpack_from(f"{order}iII", payload, 4)
            values = struct.unpack_from(f"{order}{cls.COUNT}d", payload, _offset_of_values(frame_size))
        except struct.error:
            text = f"a message is truncated or of another type: {len(payload)} bytes"
            raise MessageError(f"{cls.TYPE}: {text}") from None
        frame_id = payload[_FRAME_ID : _FRAME_ID + frame_size - 1].decode(errors="replace")
        return sec * 1_000_000_000 + nanosec, frame_id, values if cls.COUNT != 6 else values[3:] + values[:3]


class PoseStampedCodec(_StampedCodec):
    """geometry_msgs/msg/PoseStamped; the values are position and quaternion."""

    TYPE, COUNT = "geometry_msgs/msg/PoseStamped", 7

    def encode(self, stamp_ns, position, quaternion):
        return self.encode_packed(pack_stamp(stamp_ns), _SEVEN(*position, *quaternion))


class PointStampedCodec(_StampedCodec):
    """geometry_msgs/msg/PointStamped, which is decoded only."""

    TYPE, COUNT = "geometry_msgs/msg/PointStamped", 3


class TwistStampedCodec(_StampedCodec):
    """geometry_msgs/msg/TwistStamped; the values are (omega, v)."""

    TYPE = "geometry_msgs/msg/TwistStamped"


class WrenchStampedCodec(_StampedCodec):
    """geometry_msgs/msg/WrenchStamped; the values are (torque, force)."""

    TYPE = "geometry_msgs/msg/WrenchStamped"


class ClockCodec:
    """rosgraph_msgs/msg/Clock, which contains only a stamp.

    ClockCodec.encode(stamp_ns) -> bytes
    """

    TYPE = "rosgraph_msgs/msg/Clock"
    _pack = struct.Struct("<4siI").pack

    @classmethod
    def encode(cls, stamp_ns):
        return cls._pack(_LITTLE_ENDIAN, *divmod(stamp_ns, 1_000_000_000))


class LogCodec:
    """rcl_interfaces/msg/Log of one event, without file, function and line.

    LogCodec.encode(stamp_ns, level, name, text) -> bytes
    LogCodec.decode_one(payload) -> (stamp_ns, level, name, text)
    """

    TYPE = "rcl_interfaces/msg/Log"
    INFO, ERROR = 20, 40

    @classmethod
    def encode(cls, stamp_ns, level, name, text):
        data = struct.pack("<iIB", *divmod(stamp_ns, 1_000_000_000), level)
        for string in (name, text, "", ""):
            characters = string.encode() + b"\0"
            data += bytes(-len(data) % 4) + struct.pack("<I", len(characters)) + characters
        return _LITTLE_ENDIAN + data + bytes(-len(data) % 4) + struct.pack("<I", 0)

    @classmethod
    def decode_one(cls, payload):
        """(stamp in ns, level, name, text) of one message. Raises MessageError."""
        fields = Fields(cls.TYPE, payload)
        return fields.stamp_ns(), fields.number("B"), fields.text(), fields.text()


def _offset_of_values(frame_size):
    """Offset of the float64 values in the payload; frame_size includes the closing NUL."""
    end = _FRAME_ID + frame_size
    return end + (4 - end) % 8  # alignment counts from the end of the encapsulation


def _packer(frame_id):
    """Function (bytes of the stamp, bytes of the float64 values) -> payload for one frame id."""
    frame = frame_id.encode() + b"\0"
    padding = _offset_of_values(len(frame)) - _FRAME_ID - len(frame)
    middle = struct.pack("<I", len(frame)) + frame + bytes(padding)

    def pack_message(stamp, values):
        return _LITTLE_ENDIAN + stamp + middle + values

    return pack_message


def decode_rows(codec, rows):
    """Decode payloads of one size, as the rows of an array.

    codec : PoseStampedCodec, TwistStampedCodec or WrenchStampedCodec
    rows  : (n, size) uint8
    returns stamps (n,) ns, distinct frame ids (list) and values: (n, 7) position and quaternion, or (n, 6) angular
    first. Raises MessageError
    """
    _, frame_id, first = codec.decode_one(rows[0].tobytes())
    order = BYTE_ORDER[rows[0, :2].tobytes()]
    at = rows.shape[1] - 8 * codec.COUNT  # in messages of ROS the values come last
    heads = np.delete(rows[:, :at], _STAMP_BYTES, axis=1)
    values = np.ascontiguousarray(rows[:, at:]).view(f"{order}f8").astype(float)
    values = values if codec.COUNT == 7 else values[:, _ANGULAR_FIRST]
    if (heads == heads[:1]).all() and values[0].tobytes() == np.array(first).tobytes():
        stamps = np.ascontiguousarray(rows[:, _STAMP_BYTES]).view([("sec", f"{order}i4"), ("nanosec", f"{order}u4")])
        return stamps["sec"][:, 0].astype(np.int64) * 1_000_000_000 + stamps["nanosec"][:, 0], [frame_id], values
    stamps, frames, values = zip(*(codec.decode_one(row.tobytes()) for row in rows))
    return np.array(stamps), sorted(set(frames)), np.array(values)
