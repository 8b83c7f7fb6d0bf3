# SPDX-License-Identifier: Apache-2.0
"""CDR of the few ROS messages that leave at simulation rate; no ROS is imported here.

Plain CDR (encapsulation 00 01, little endian): stamp and frame id of std_msgs/Header, then float64
values on the next multiple of 8 bytes, counted from behind the 4-byte encapsulation. For one frame
id every offset is fixed, so a message is one `struct` call and a list of messages is one numpy
view; both come from `_offset_of_values`. `encode` gives the bytes of
rclpy.serialization.serialize_message (test_messages.py), but for the gap behind the frame id: Fast
CDR leaves there what was in memory, here it is zero, so that equal messages are equal bytes and
recordings can be compared.

Numbers may come as any sequence; an array's .tolist() packs three times faster than the array.
Stamps are int nanoseconds. Quaternions are x, y, z, w. Six-vectors are angular first here,
(omega, v) and (torque, force), and linear first in the messages: the swap is made in this file
only. Decoding also takes big-endian messages and mixed frame ids, as other recorders may write
them; anything else raises MessageError, one line of text.

Source: OMG DDS-RTPS 2.3 section 10 (encapsulation), CORBA 3.3 part 2, section 9.3 (CDR).
"""

import struct
from typing import NamedTuple

import numpy as np

_LITTLE_ENDIAN = b"\x00\x01\x00\x00"
_BYTE_ORDER = {b"\x00\x00": ">", b"\x00\x01": "<"}
_FRAME_ID = 16                                 # offset of the frame id's characters in the payload
_ANGULAR_FIRST = [3, 4, 5, 0, 1, 2]            # linear first <-> angular first; its own inverse


class MessageError(ValueError):
    """A payload that is not a message of the expected type; one line of text."""


class Poses(NamedTuple):
    stamp_ns: np.ndarray        # (n,) int64, ns
    frame_id: np.ndarray        # (n,) str objects
    position: np.ndarray        # (n, 3) m, in frame_id
    quaternion: np.ndarray      # (n, 4) x, y, z, w


class Twists(NamedTuple):
    stamp_ns: np.ndarray        # (n,) int64, ns
    frame_id: np.ndarray        # (n,) str objects
    twist: np.ndarray           # (n, 6) (omega, v), rad/s and m/s, in frame_id


class Wrenches(NamedTuple):
    stamp_ns: np.ndarray        # (n,) int64, ns
    frame_id: np.ndarray        # (n,) str objects
    wrench: np.ndarray          # (n, 6) (torque, force), N m and N, in frame_id


class PoseStampedCodec:
    """geometry_msgs/msg/PoseStamped in one frame.

    PoseStampedCodec("world").encode(stamp_ns, position, quaternion) -> bytes
    PoseStampedCodec.decode(payloads) -> Poses
    """

    TYPE = "geometry_msgs/msg/PoseStamped"

    def __init__(self, frame_id):
        self._pack = _packer(frame_id, 7)

    def encode(self, stamp_ns, position, quaternion):
        return self._pack(*divmod(stamp_ns, 1_000_000_000), *position, *quaternion)

    @classmethod
    def decode(cls, payloads):
        stamp_ns, frame_id, values = _decode(cls.TYPE, payloads, 7)
        return Poses(stamp_ns, frame_id, values[:, :3], values[:, 3:])


class TwistStampedCodec:
    """geometry_msgs/msg/TwistStamped in one frame; `twist6` is (omega, v).

    TwistStampedCodec(body).encode(stamp_ns, twist6) -> bytes
    TwistStampedCodec.decode(payloads) -> Twists
    """

    TYPE = "geometry_msgs/msg/TwistStamped"

    def __init__(self, frame_id):
        self._pack = _packer(frame_id, 6)

    def encode(self, stamp_ns, twist6):
        return self._pack(*divmod(stamp_ns, 1_000_000_000), *twist6[3:], *twist6[:3])

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
        self._pack = _packer(frame_id, 6)

    def encode(self, stamp_ns, wrench6):
        return self._pack(*divmod(stamp_ns, 1_000_000_000), *wrench6[3:], *wrench6[:3])

    @classmethod
    def decode(cls, payloads):
        stamp_ns, frame_id, values = _decode(cls.TYPE, payloads, 6)
        return Wrenches(stamp_ns, frame_id, values[:, _ANGULAR_FIRST])

    @classmethod
    def decode_one(cls, payload):
        """(stamp in ns, frame id, (torque, force)) of one message, a tenth of the time."""
        try:
            order = _BYTE_ORDER[payload[:2]]
            sec, nanosec, frame_size = struct.unpack_from(f"{order}iII", payload, 4)
            values = struct.unpack_from(f"{order}6d", payload, _offset_of_values(frame_size))
        except (KeyError, struct.error):
            raise MessageError(f"{cls.TYPE}: not plain CDR, cut short or of another type"
                               ) from None
        frame_id = payload[_FRAME_ID:_FRAME_ID + frame_size - 1].decode(errors="replace")
        return sec * 1_000_000_000 + nanosec, frame_id, values[3:] + values[:3]


class ClockCodec:
    """rosgraph_msgs/msg/Clock: a stamp and nothing else.

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


def _offset_of_values(frame_size):
    """Where the float64 values start in the payload; frame_size counts the closing NUL."""
    end = _FRAME_ID + frame_size
    return end + (4 - end) % 8                 # alignment counts from behind the encapsulation


def _packer(frame_id, nvalues):
    """Function (sec, nanosec, *values) -> payload for one frame id."""
    frame = frame_id.encode() + b"\0"
    padding = _offset_of_values(len(frame)) - _FRAME_ID - len(frame)
    pack = struct.Struct(f"<4siII{len(frame)}s{padding}x{nvalues}d").pack

    def pack_message(sec, nanosec, *values):
        return pack(_LITTLE_ENDIAN, sec, nanosec, len(frame), frame, *values)

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
    for (encapsulation, frame_size, size), index in layouts.items():
        order = _BYTE_ORDER.get(encapsulation)
        if order is None:
            raise MessageError(f"{type_name}: message {index[0]} is not plain CDR: "
                               f"it starts with 0x{encapsulation.hex()}")
        frame_size = int.from_bytes(frame_size, "little" if order == "<" else "big")
        start = _offset_of_values(frame_size)
        if frame_size < 1 or size < start + 8 * nvalues:
            raise MessageError(f"{type_name}: message {index[0]} is cut short or of another type: "
                               f"{size} bytes")
        rows = np.frombuffer(b"".join([payloads[i] for i in index]), dtype=np.dtype({
            "names": ["sec", "nanosec", "frame_id", "values"],
            "formats": [f"{order}i4", f"{order}u4", f"S{frame_size}", (f"{order}f8", nvalues)],
            "offsets": [4, 8, _FRAME_ID, start],
            "itemsize": size}))
        stamp_ns[index] = rows["sec"].astype(np.int64) * 1_000_000_000 + rows["nanosec"]
        values[index] = rows["values"]
        names, which = np.unique(rows["frame_id"], return_inverse=True)
        frame_id[index] = np.array([name.decode(errors="replace") for name in names],
                                   dtype=object)[which]
    return stamp_ns, frame_id, values
