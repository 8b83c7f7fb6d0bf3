# SPDX-License-Identifier: Apache-2.0
"""Interpretation and refusal of wrench messages; no ROS node runs here."""

import struct

import numpy as np
import pytest
from geometry_msgs.msg import PointStamped, WrenchStamped
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import serialize_message
from scene_files import cases

from liegroup_sim_ros.messages.codecs import WrenchStampedCodec
from liegroup_sim_ros.serving.counted_input import FARTHEST, MOST, Refusal
from liegroup_sim_ros.serving.wrench_input import WrenchInput, source_prefix

NOW = 5 * 10**9
WRENCH = (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)


def read(frame, kind="wrench", body=None, wrench=WRENCH, stamp_ns=0, held=0, prefix=""):
    payload = WrenchStampedCodec(frame).encode(stamp_ns, wrench)
    return WrenchInput(["top", "left"], "map/world", prefix).read(payload, kind, body, NOW, held)


@pytest.mark.parametrize("kind, body, frame, source, axes", cases("the_frame_id_selects_body_source_and_axes"))
def test_the_frame_id_selects_body_source_and_axes(kind, body, frame, source, axes):
    push = read(frame, kind, body)
    assert (push.source, push.axes, push.values) == (source, axes, WRENCH)
    assert push.name == (body or frame.partition("/")[0])


@pytest.mark.parametrize("kind, body, frame, source, axes", cases("body_frames_have_a_prefix"))
def test_body_frames_have_a_prefix(kind, body, frame, source, axes):
    push = read(frame, kind, body, prefix="map/")
    assert (push.source, push.axes) == (source, axes)
    for wrong in (frame.replace("map/", "") + "s", frame.replace("map/", "mat/"), "top"):
        with pytest.raises(Refusal, match="map/top"):
            read(wrong, kind, body, prefix="map/")


@pytest.mark.parametrize(
    "target, ended", [("", {"top/", "top/a/", "left/"}), ("top", {"top/", "top/a/"}), ("top/a", {"top/a/"})]
)
def test_clear_ends_the_wrenches_of_a_body_a_source_or_all(target, ended):
    prefix = source_prefix("persistent", target)
    sources = {source_prefix("persistent", t)[len("persistent/") :] for t in ("top", "top/a", "left")}
    assert {s for s in sources if f"persistent/{s}".startswith(prefix)} == ended


@pytest.mark.parametrize(
    "changed, reason",
    [
        ({"frame": ""}, "no_frame"),
        ({"frame": "/top"}, "no_frame"),
        ({"frame": "tops"}, "unknown_frame"),
        ({"frame": "map/world"}, "unknown_frame"),
        ({"frame": "left", "kind": "body", "body": "top"}, "unknown_frame"),
        ({"frame": "map", "kind": "body", "body": "top"}, "unknown_frame"),
        ({"frame": "top/" + "x" * 65}, "unknown_frame"),
        ({"frame": "top", "wrench": (*WRENCH[:5], float("nan"))}, "not_finite"),
        ({"frame": "top", "stamp_ns": NOW + FARTHEST + 1}, "stamp_too_far"),
        ({"frame": "top", "held": MOST}, "too_many"),
    ],
)
def test_refusals_are_one_line(changed, reason):
    with pytest.raises(Refusal) as caught:
        read(**changed)
    assert caught.value.reason == reason and caught.value.is_told
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 300


@given(st.binary(max_size=200))
def test_arbitrary_bytes_do_not_crash_the_reader(payload):
    reader = WrenchInput(["top"], "world")
    for prefix in (b"", b"\0\1\0\0" + struct.pack("<iII", 1, 2, 4) + b"top\0"):
        try:
            push = reader.read(prefix + payload, "wrench", None, NOW, 0)
            assert push.name == "top"
        except Refusal:
            pass
    assert reader.accepted + sum(reader.refused.values()) == 2


@given(
    st.lists(st.floats(), min_size=6, max_size=6),
    st.integers(0, 2 * 10**18),
    st.text(st.characters(codec="utf-8", exclude_characters="\0")),
)
def test_a_message_serialized_by_ros_is_decoded(values, stamp_ns, frame):
    message = WrenchStamped()
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 10**9)
    message.header.frame_id = frame
    for vector, part in ((message.wrench.torque, values[:3]), (message.wrench.force, values[3:])):
        vector.x, vector.y, vector.z = part
    stamp, frame_id, wrench = WrenchStampedCodec.decode_one(serialize_message(message))
    assert (stamp, frame_id) == (stamp_ns, frame)
    assert struct.pack("6d", *wrench) == struct.pack("6d", *values)


def test_a_point_in_the_world_pulls_at_a_body_or_a_merged_link():
    """With a spring of 1 Hz for the mass of the body, and 0.7 of critical damping."""
    place = np.eye(4)
    place[:3, 3] = 0.5, 0.0, 0.0
    reader = WrenchInput(["tool"], "world", "a/", {"tool": "tool"}, {"tcp": ("tool", place)}, {"tool": 2.0})
    message = PointStamped()
    message.point.x, message.point.y, message.point.z = 1.0, 2.0, 3.0
    omega = 2 * np.pi
    for frame, point, source in (("a/tool", None, "pull/tool/"), ("a/tcp/me", (0.5, 0.0, 0.0), "pull/tool/(tcp)/me/")):
        message.header.frame_id = frame
        pull = reader.read_pull(serialize_message(message), NOW, 0)
        assert (pull.kind, pull.name, pull.point, pull.source) == ("pull", "tool", point, source)
        assert pull.values == pytest.approx((2 * omega**2, 2 * 0.7 * omega * 2, 1, 2, 3, 0, 0, 0, 0))
    for wrong, value in (("tool", 1.0), ("a/tool", float("nan"))):
        message.header.frame_id, message.point.x = wrong, value
        with pytest.raises(Refusal):
            reader.read_pull(serialize_message(message), NOW, 0)


def test_a_body_is_also_named_by_the_link_of_its_robots_file():
    reader = WrenchInput(["crank_left"], "world", "a/", {"crank_left": "crank-left", "world": "world"})
    assert reader.body_and_name("a/crank-left/me") == ("crank_left", "me")
    assert reader.body_and_name("a/crank_left") == ("crank_left", "")
    assert reader.body_and_name("a/world") == (None, "")


def test_a_merged_link_has_its_axes_and_its_origin():
    """A wrench on it adds to one on its body, and ends by its own name."""
    place = np.eye(4)
    place[:3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    place[:3, 3] = 0.5, 0.0, 0.0
    reader = WrenchInput(["tool"], "world", "a/", {"tool": "tool"}, {"tcp": ("tool", place)})
    push, own = (
        reader.read(WrenchStampedCodec(frame).encode(0, WRENCH), "wrench", None, NOW, 0)
        for frame in ("a/tcp/me", "a/tool")
    )
    # z x and y turned by a quarter, and (0.5, 0, 0) x (-5, 4, 6).
    assert (push.name, push.axes) == ("tool", "body")
    assert push.values == (-2.0, 1.0 - 3.0, 3.0 + 2.0, -5.0, 4.0, 6.0)
    assert own.values == WRENCH and own.source != push.source
    assert reader.body_and_name("a/tcp") == ("tool", "(tcp)")
    assert push.source.startswith(source_prefix("wrench", "tool/(tcp)"))
