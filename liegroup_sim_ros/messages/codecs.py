# SPDX-License-Identifier: Apache-2.0
"""CDR codecs of the ROS messages that are sent at simulation rate or decoded; imports no ROS.

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
from typing import NamedTuple

import numpy as np

_LITTLE_ENDIAN = b"\x00\x01\x00\x00"
_BYTE_ORDER = {b"\x00\x00": ">", b"\x00\x01": "<"}
_STAMP = struct.Struct("<iI").pack
_SIX, _SEVEN = struct.Struct("<6d").pack, struct.Struct("<7d").pack
_FRAME_ID = 16  # offset of the frame id's characters in the payload
_ANGULAR_FIRST = [3, 4, 5, 0, 1, 2]  # linear first <-> angular first; its own inverse


class MessageError(ValueError):
    """The payload is not a message of the expected type; one line of text."""


class Poses(NamedTuple):
    stamp_ns: np.ndarray  # (n,) int64, ns
    frame_id: np.ndarray  # (n,) str objects
    position: np.ndarray  # (n, 3) m, in frame_id
    quaternion: np.ndarray  # (n, 4) x, y, z, w


class Twists(NamedTuple):
    stamp_ns: np.ndarray  # (n,) int64, ns
    frame_id: np.ndarray  # (n,) str objects
    twist: np.ndarray  # (n, 6) (omega, v), rad/s and m/s, in frame_id


class Wrenches(NamedTuple):
    stamp_ns: np.ndarray  # (n,) int64, ns
    frame_id: np.ndarray  # (n,) str objects
    wrench: np.ndarray  # (n, 6) (torque, force), N m and N, in frame_id


class Fields:
    """Sequential decoder of the fields of a message, for rare messages.

    name, payload : message type and its bytes in plain CDR
    All methods raise MessageError if the bytes end too early.
    """

    def __init__(self, name, payload):
        self._name, self._payload, self._at = name, payload, len(_LITTLE_ENDIAN)
        self._order = _BYTE_ORDER.get(payload[:2])
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


class PoseStampedCodec:
    """geometry_msgs/msg/PoseStamped in one frame.

    PoseStampedCodec("world").encode(stamp_ns, position, quaternion) -> bytes
    .encode_packed(pack_stamp(stamp_ns), the 56 bytes of position and quaternion) -> bytes
    PoseStampedCodec.decode(payloads) -> Poses
    """

    TYPE = "geometry_msgs/msg/PoseStamped"

    def __init__(self, frame_id):
        self.encode_packed = _packer(frame_id)

    def encode(self, stamp_ns, position, quaternion):
        return self.encode_packed(pack_stamp(stamp_ns), _SEVEN(*position, *quaternion))

    @classmethod
    def decode(cls, payloads):
        stamp_ns, frame_id, values = _decode(cls.TYPE, payloads, 7)
        return Poses(stamp_ns, frame_id, values[:, :3], values[:, 3:])


class TwistStampedCodec:
    """geometry_msgs/msg/TwistStamped in one frame; `twist6` is (omega, v).

    TwistStampedCodec(body).encode(stamp_ns, twist6) -> bytes
    .encode_packed(pack_stamp(stamp_ns), the 48 bytes of v and omega, linear first) -> bytes
    TwistStampedCodec.decode(payloads) -> Twists
    """

    TYPE = "geometry_msgs/msg/TwistStamped"

    def __init__(self, frame_id):
        self.encode_packed = _packer(frame_id)

    def encode(self, stamp_ns, twist6):
        return self.encode_packed(pack_stamp(stamp_ns), _SIX(*twist6[3:], *twist6[:3]))

    @classmethod
    def decode(cls, payloads):
        stamp_ns, frame_id, values = _decode(cls.TYPE, payloads, 6)
        return Twists(stamp_ns, frame_id, values[:, _ANGULAR_FIRST])


class WrenchStampedCodec:
    """geometry_msgs/msg/WrenchStamped in one frame; `wrench6` is (torque, force).

    WrenchStampedCodec(body).encode(stamp_ns, wrench6) -> bytes
    WrenchStampedCodec.decode(payloads) -> Wrenches
    WrenchStampedCodec.decode_one(payload) -> (stamp_ns, frame_id, wrench6)
    """

    TYPE = "geometry_msgs/msg/WrenchStamped"

    def __init__(self, frame_id):
        self.encode_packed = _packer(frame_id)

    def encode(self, stamp_ns, wrench6):
        return self.encode_packed(pack_stamp(stamp_ns), _SIX(*wrench6[3:], *wrench6[:3]))

    @classmethod
    def decode(cls, payloads):
        stamp_ns, frame_id, values = _decode(cls.TYPE, payloads, 6)
        return Wrenches(stamp_ns, frame_id, values[:, _ANGULAR_FIRST])

    @classmethod
    def decode_one(cls, payload):
        """(stamp in ns, frame id, (torque, force)) of one message; ten times faster."""
        try:
            order = _BYTE_ORDER[payload[:2]]
            sec, nanosec, frame_size = struct.unpack_from(f"{order}iII", payload, 4)
            values = struct.unpack_from(f"{order}6d", payload, _offset_of_values(frame_size))
        except (KeyError, struct.error):
            raise MessageError(f"{cls.TYPE}: not plain CDR, truncated or of another type") from None
        frame_id = payload[_FRAME_ID : _FRAME_ID + frame_size - 1].decode(errors="replace")
        return sec * 1_000_000_000 + nanosec, frame_id, values[3:] + values[:3]


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


def _decode(type_name, payloads, nvalues):
    """Stamps (n,), frame ids (n,) and values (n, nvalues) of a list of payloads."""
    # Messages with the same byte order, frame id length and size share one layout.
    layouts = {}
    for i, payload in enumerate(payloads):
        layouts.setdefault((payload[:2], payload[12:_FRAME_ID], len(payload)), []).append(i)
    stamp_ns = np.empty(len(payloads), dtype=np.int64)
    frame_id = np.empty(len(payloads), dtype=object)
    values = np.empty((len(payloads), nvalues))
    for (_, _, size), index in layouts.items():
        same = np.frombuffer(b"".join([payloads[i] for i in index]), dtype=np.uint8)
        stamp_ns[index], names, which, values[index] = _decode_same(type_name, same.reshape(len(index), size), nvalues)
        frame_id[index] = np.array(names, dtype=object)[which]
    return stamp_ns, frame_id, values


def decode_rows(codec, rows):
    """Decode payloads of one size, as the rows of an array.

    codec : PoseStampedCodec, TwistStampedCodec or WrenchStampedCodec
    rows  : (n, size) uint8
    returns stamps (n,) ns, distinct frame ids (list), their index for each message (n,), and values:
    (n, 7) position and quaternion, or (n, 6) angular first. Raises MessageError
    """
    nvalues = 7 if codec is PoseStampedCodec else 6
    heads = rows[:, [0, 1, *range(12, _FRAME_ID)]] if rows.shape[1] >= _FRAME_ID else rows[:, :0]
    if (heads == heads[:1]).all():
        stamp_ns, names, which, values = _decode_same(codec.TYPE, rows, nvalues)
    else:
        stamp_ns, frame_id, values = _decode(codec.TYPE, [row.tobytes() for row in rows], nvalues)
        names, which = np.unique(frame_id.astype(str), return_inverse=True)
        names = names.tolist()
    return stamp_ns, names, which, values if nvalues == 7 else values[:, _ANGULAR_FIRST]


def _decode_same(type_name, rows, nvalues):
    """Stamps (n,), distinct frame ids, their index for each message (n,), values, of payloads of one layout."""
    size = rows.shape[1]
    encapsulation = rows[0, :2].tobytes()
    order = _BYTE_ORDER.get(encapsulation)
    if order is None:
        raise MessageError(f"{type_name}: a message is not plain CDR: it starts with 0x{encapsulation.hex()}")
    frame_size = int.from_bytes(rows[0, 12:_FRAME_ID].tobytes(), "little" if order == "<" else "big")
    start = _offset_of_values(frame_size)
    if frame_size < 1 or size < start + 8 * nvalues:
        raise MessageError(f"{type_name}: a message is truncated or of another type: {size} bytes")
    rows = np.ascontiguousarray(rows).view(
        np.dtype(
            {
                "names": ["sec", "nanosec", "frame_id", "values"],
                "formats": [f"{order}i4", f"{order}u4", (np.uint8, frame_size), (f"{order}f8", nvalues)],
                "offsets": [4, 8, _FRAME_ID, start],
                "itemsize": size,
            }
        )
    )[:, 0]
    frames = rows["frame_id"]
    if (frames == frames[:1]).all():
        distinct, which = frames[:1], np.zeros(len(rows), dtype=np.int64)
    else:
        distinct, which = np.unique(frames, axis=0, return_inverse=True)
    names = [name.tobytes().partition(b"\0")[0].decode(errors="replace") for name in distinct]
    stamp_ns = rows["sec"].astype(np.int64) * 1_000_000_000 + rows["nanosec"]
    return stamp_ns, names, which.reshape(-1), rows["values"].astype(float)
