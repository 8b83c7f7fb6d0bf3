# SPDX-License-Identifier: Apache-2.0
"""Packed messages equal the real ROS serialization byte for byte; decoding of many messages.

ROS leaves the alignment gap between frame id and numbers as it was in memory; ours is zero, so
that equal messages are equal bytes. The gap alone is left out of the comparison.
"""

import json
import struct

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped, TwistStamped, WrenchStamped
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.serialization import serialize_message
from rosbags.typesys import Stores, get_typestore
from rosgraph_msgs.msg import Clock
from scene_files import cases
from std_msgs.msg import String

from liegroup_core.forces.commands import Command
from liegroup_sim_ros.messages import inputs, schemas
from liegroup_sim_ros.messages.codecs import (
    ClockCodec,
    MessageError,
    PoseStampedCodec,
    TwistStampedCodec,
    WrenchStampedCodec,
    decode_rows,
)

STAMPS = st.integers(0, (2**31 - 1) * 1_000_000_000 + 999_999_999)
FRAMES = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=40)
FLOATS = st.floats(allow_nan=False)
TYPES = cases("messages_types")


def floats(count):
    return st.lists(FLOATS, min_size=count, max_size=count)


def stamped(message, stamp_ns, frame_id):
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 1_000_000_000)
    message.header.frame_id = frame_id
    return message


def assign(target, values):
    for name, value in zip(target.get_fields_and_field_types(), values):
        setattr(target, name, value)


def without_gap(payload):
    """Payload with the alignment gap (up to 7 bytes after the frame id) set to zero."""
    end = 16 + int.from_bytes(payload[12:16], "little")
    start = 4 + (end - 4 + 7) // 8 * 8
    return payload[:end] + bytes(start - end) + payload[start:]


def pose_message(stamp_ns, frame_id, position, quaternion):
    message = stamped(PoseStamped(), stamp_ns, frame_id)
    assign(message.pose.position, position)
    assign(message.pose.orientation, quaternion)
    return without_gap(serialize_message(message))


def twist_message(stamp_ns, frame_id, twist):
    message = stamped(TwistStamped(), stamp_ns, frame_id)
    assign(message.twist.angular, twist[:3])
    assign(message.twist.linear, twist[3:])
    return without_gap(serialize_message(message))


def wrench_message(stamp_ns, frame_id, wrench):
    message = stamped(WrenchStamped(), stamp_ns, frame_id)
    assign(message.wrench.torque, wrench[:3])
    assign(message.wrench.force, wrench[3:])
    return without_gap(serialize_message(message))


@settings(deadline=None)
@given(STAMPS, FRAMES, floats(3), floats(4))
def test_pose_is_what_ros_serializes(stamp_ns, frame_id, position, quaternion):
    expected = pose_message(stamp_ns, frame_id, position, quaternion)
    codec = PoseStampedCodec(frame_id)
    assert codec.encode(stamp_ns, position, quaternion) == expected
    assert codec.encode(np.int64(stamp_ns), np.array(position), np.array(quaternion)) == expected


@settings(deadline=None)
@given(STAMPS, FRAMES, floats(6))
def test_twist_and_wrench_are_what_ros_serializes(stamp_ns, frame_id, values):
    assert TwistStampedCodec(frame_id).encode(stamp_ns, values) == twist_message(stamp_ns, frame_id, values)
    assert WrenchStampedCodec(frame_id).encode(stamp_ns, np.array(values)) == wrench_message(stamp_ns, frame_id, values)


@pytest.mark.parametrize("length", range(41))
def test_frame_ids_of_every_length_modulo_alignment(length):
    frame_id = "abcdefghij"[: length % 10] + "x" * (length - length % 10)
    assert len(frame_id) == length
    expected = pose_message(7, frame_id, [1.0, 2.0, 3.0], [0.1, 0.2, 0.3, 0.4])
    assert PoseStampedCodec(frame_id).encode(7, (1, 2, 3), (0.1, 0.2, 0.3, 0.4)) == expected


@settings(deadline=None)
@given(STAMPS)
def test_clock_is_what_ros_serializes(stamp_ns):
    message = Clock()
    message.clock.sec, message.clock.nanosec = divmod(stamp_ns, 1_000_000_000)
    assert ClockCodec.encode(stamp_ns) == serialize_message(message)


@settings(max_examples=50, deadline=None)
@given(st.lists(st.tuples(STAMPS, FRAMES, floats(7)), max_size=20))
def test_decoding_mixed_frames_returns_the_encoded_numbers(rows):
    for codec, size, message in (
        (
            PoseStampedCodec,
            7,
            lambda stamp_ns, frame_id, values: pose_message(stamp_ns, frame_id, values[:3], values[3:]),
        ),
        (TwistStampedCodec, 6, twist_message),
        (WrenchStampedCodec, 6, wrench_message),
    ):
        same = {}
        for stamp_ns, frame_id, values in rows:
            payload = message(stamp_ns, frame_id, values[:size])
            stamp, name, numbers = codec.decode_one(payload)
            # Bits, not values: -0.0 and subnormal numbers must survive.
            assert (stamp, name) == (stamp_ns, frame_id) and np.array(numbers).tobytes() == np.array(
                values[:size]
            ).tobytes()
            same.setdefault(len(payload), []).append((payload, stamp_ns, frame_id, values[:size]))
        for group in same.values():
            payloads, *expected, values = zip(*group)
            stamps, names, numbers = decode_rows(codec, as_rows(payloads))
            assert stamps.dtype == np.int64 and [tuple(stamps.tolist()), sorted(set(expected[1]))] == [
                expected[0],
                names,
            ]
            assert numbers.tobytes() == np.array(values).tobytes()


def as_rows(payloads):
    return np.array([np.frombuffer(payload, np.uint8) for payload in payloads])


def test_decoding_accepts_big_endian_and_trailing_bytes():
    big = struct.pack(">4siII5s7x6d", b"\0\0\0\0", 3, 4, 5, b"body\0", *range(6))
    little = TwistStampedCodec("body").encode(3_000_000_004, (3, 4, 5, 0, 1, 2))
    for payloads in ([big, little], [little + b"\0\0\0\0"] * 2):
        stamps, names, values = decode_rows(TwistStampedCodec, as_rows(payloads))
        assert stamps.tolist() == [3_000_000_004] * 2 and names == ["body"]
        assert values.tolist() == [[3, 4, 5, 0, 1, 2]] * 2


@pytest.mark.parametrize(
    "damage, said",
    [
        (lambda data: data[:-1], "a message is truncated or of another type"),
        (lambda data: data[:10], "a message is truncated"),
        (lambda data: b"", "a message is not plain CDR"),
        (lambda data: b"\x00\x07" + data[2:], "a message is not plain CDR: it starts with 0x0007"),
        (lambda data: data[:12] + b"\xff\xff\xff\xff" + data[16:], "a message is truncated"),
    ],
)
def test_a_damaged_payload_is_refused_in_one_line(damage, said):
    good = PoseStampedCodec("world").encode(0, (0, 0, 0), (0, 0, 0, 1))
    with pytest.raises(MessageError, match=said) as caught:
        decode_rows(PoseStampedCodec, as_rows([damage(good)]))
    assert "\n" not in str(caught.value) and "PoseStamped" in str(caught.value)


@pytest.mark.parametrize("msg_type", TYPES)
def test_definition_and_hash_agree_with_an_independent_implementation(msg_type):
    """rosbags has its own message definitions, parser and REP 2011 hash."""
    from rosbags.typesys import get_types_from_msg

    store = get_typestore(Stores.ROS2_JAZZY)
    parsed = get_types_from_msg(schemas.definition(msg_type), msg_type)
    fields = {name: store.fielddefs[name] for name in parsed}
    assert {name: [f[0] for f in parsed[name][1]] for name in parsed} == {
        name: [f[0] for f in fields[name][1]] for name in fields
    }
    assert schemas.type_hash(msg_type) == store.hash_rihs01(msg_type)


def test_definitions_have_the_separators_that_readers_expect():
    parts = schemas.definition("geometry_msgs/msg/PoseStamped").split("\n" + "=" * 80 + "\n")
    assert [part.split("\n", 1)[0] for part in parts[1:]] == [
        "MSG: geometry_msgs/Pose",
        "MSG: geometry_msgs/Point",
        "MSG: geometry_msgs/Quaternion",
        "MSG: std_msgs/Header",
        "MSG: builtin_interfaces/Time",
    ]


@pytest.mark.parametrize("msg_type", ["no_such_msgs/msg/Thing", "geometry_msgs/msg/NoSuchThing"])
def test_a_missing_message_type_is_refused_in_one_line(msg_type):
    with pytest.raises(schemas.SchemaError, match="is not installed") as caught:
        schemas.definition(msg_type)
    assert "\n" not in str(caught.value)


NAMES = st.one_of(FRAMES, st.just('"values":[]'))
TIMES = st.one_of(st.none(), st.integers(0, 10**18), st.floats(0.0, 1e18))
COMMANDS = st.builds(
    Command,
    st.sampled_from(["wrench", "effort", "pull"]),
    NAMES,
    st.lists(st.floats(allow_nan=False, allow_infinity=False), max_size=9).map(tuple),
    TIMES,
    TIMES,
    NAMES,
    st.sampled_from(["body", "world"]),
    st.one_of(st.none(), st.tuples(*[st.floats(-1.0, 1.0)] * 3)),
)


@given(st.lists(COMMANDS, max_size=3), st.booleans())
def test_inputs_are_the_json_of_their_commands(commands, everything):
    entries = {"base_ns": 5, "all": everything, "commands": [command.as_json() for command in commands]}
    text = json.dumps(entries, separators=(",", ":"))
    assert inputs.encode(5, commands, everything) == serialize_message(String(data=text))
