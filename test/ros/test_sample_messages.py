# SPDX-License-Identifier: Apache-2.0
"""Messages packed from templates equal the ROS serialization byte for byte, with right content.

ROS leaves alignment gaps as they were in memory, ours are zero. Where the gaps are is found here
by walking through the message (`gaps`), independently of the code under test.
"""

import copy
import math
import struct
from types import SimpleNamespace

import numpy as np
import pytest
from builtin_interfaces.msg import Duration
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import (
    Point,
    PoseArray,
    PoseStamped,
    PoseWithCovarianceStamped,
    TwistStamped,
    VelocityStamped,
    WrenchStamped,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from nav_msgs.msg import Odometry
from rcl_interfaces.msg import Log
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.typesys import Stores, get_typestore
from scene_files import cases, text_of
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Float32MultiArray, Float64, Float64MultiArray, Int64MultiArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
from visualization_msgs.msg import Marker, MarkerArray

from liegroup_core import load_scene
from liegroup_core.forces.external import no_wrenches, set_wrench
from liegroup_core.layout import make_layout
from liegroup_core.scene.load import scene_from_text
from liegroup_core.simulation import Simulation
from liegroup_sim_ros.messages import arrays, diagnostics, estimates
from liegroup_sim_ros.messages import samples as sample_messages
from liegroup_sim_ros.messages.cdr import Template
from liegroup_sim_ros.messages.codecs import LogCodec, MessageError
from liegroup_sim_ros.messages.markers import Markers

FORMS = {"boolean": "B", "octet": "c", "uint8": "B", "int8": "b", "uint16": "H", "int32": "i", "uint32": "I"}
FORMS |= {"float": "f", "double": "d", "int64": "q", "uint64": "Q"}
SIZES = {kind: struct.calcsize(form) for kind, form in FORMS.items()}
STAMP = 12_345_678_901

SCENE = text_of("shapes.yaml")


@pytest.fixture(scope="module")
def layout():
    return make_layout(scene_from_text(SCENE, "shapes"))


@pytest.fixture(scope="module")
def sample(layout):
    """State that is neither the initial one nor consistent with the joints."""
    random = np.random.default_rng(7)
    rotations = Rotation.random(4, random_state=7).as_matrix().reshape(4, 9)
    return layout.sample(np.hstack([rotations, random.normal(size=(4, 3))]), random.normal(size=(4, 6)))


def gaps(message, offset=0):
    """(offsets of alignment bytes, end) of a message, after the encapsulation header."""
    found = []

    def primitive(size, at):
        start = -(-at // size) * size
        found.extend(range(at, start))
        return start + size

    def value(kind, content, at):
        if kind == "string":
            return primitive(4, at) + len(content.encode()) + 1
        if kind in SIZES:
            return primitive(SIZES[kind], at)
        inner, at = gaps(content, at)
        found.extend(inner)
        return at

    for name, kind in message.get_fields_and_field_types().items():
        content = getattr(message, name)
        if kind.startswith("sequence<") or kind.endswith("]"):
            if kind.startswith("sequence<"):
                offset, kind = primitive(4, offset), kind[9:-1]
            else:
                kind = kind.partition("[")[0]
            for item in content:
                offset = value(kind, item, offset)
        else:
            offset = value(kind, content, offset)
    return found, offset


def as_ros_serializes(payload, message_class):
    """Deserialized payload; asserts that ROS serializes it to the same bytes."""
    message = deserialize_message(payload, message_class)
    assert_same_bytes(payload, message)
    return message


def assert_same_bytes(payload, message):
    """Assert equal length and bytes, except alignment gaps and reserved bytes after the end."""
    expected = bytearray(serialize_message(message))
    found, end = gaps(message)
    assert len(payload) == len(expected)
    for offset in (*found, *range(end, len(expected) - 4)):
        expected[4 + offset] = 0
    assert payload == bytes(expected)


def template_of(message, template=None):
    """Template with the fields of a message as constants."""
    template = template or Template()

    def put(kind, items):
        if kind in FORMS:
            template.put(f"{len(items)}{FORMS[kind]}", *items)
            return
        for item in items:
            if kind == "string":
                template.string(item)
            else:
                template_of(item, template)

    for name, kind in message.get_fields_and_field_types().items():
        content = getattr(message, name)
        if kind.startswith("sequence<"):
            template.put("I", len(content))
            put(kind[9:-1], content)
        elif kind.endswith("]"):
            put(kind.partition("[")[0], content)
        else:
            put(kind, [content])
    return template


TEXT = st.text("ab", max_size=9)
SOME = st.lists(st.floats(-9, 9), max_size=2)
AFTER = st.builds(Duration, sec=st.integers(0, 9))
VALUES = dict.fromkeys(("positions", "velocities", "accelerations", "effort"), SOME)
POINTS = st.builds(JointTrajectoryPoint, time_from_start=AFTER, **VALUES)


@given(
    st.one_of(
        st.builds(JointState, name=st.lists(TEXT, max_size=3), position=SOME, velocity=SOME, effort=SOME),
        st.builds(JointTrajectory, joint_names=st.lists(TEXT, max_size=2), points=st.lists(POINTS, max_size=3)),
        st.builds(Float64MultiArray, data=SOME),
        st.builds(Int64MultiArray, data=st.lists(st.integers(-9, 9), max_size=2)),
        st.builds(Float32MultiArray, data=SOME),
        st.builds(DiagnosticStatus, name=TEXT, message=TEXT, hardware_id=TEXT),
        st.builds(Marker, ns=TEXT, text=TEXT, points=st.lists(st.builds(Point), max_size=2)),
    )
)
def test_templates_of_any_message_with_empty_sequences_and_texts(message):
    assert_same_bytes(template_of(message).pack(), message)


def numbers(message, names):
    return [getattr(message, name) for name in names]


def twist_of(twist):
    return numbers(twist.angular, "xyz") + numbers(twist.linear, "xyz")


def check_pose(pose, matrix):
    """Exact position; rotations computed in two ways differ by a few eps."""
    assert numbers(pose.position, "xyz") == pytest.approx(matrix[:3, 3].tolist(), abs=1e-14)
    rotation = Rotation.from_quat(numbers(pose.orientation, "xyzw")).as_matrix()
    assert np.abs(rotation - matrix[:3, :3]).max() < 1e-14


def only(topics):
    ((topic, message_type, encode),) = topics
    return topic, message_type, encode


def motion(layout, sample, own, *frames):
    """{topic: message} of the poses and twists."""
    topics, encode = sample_messages.motion(layout.body_names, own, *frames)
    kinds = {kind.__name__: kind for kind in (PoseStamped, TwistStamped, PoseArray, Float64MultiArray)}
    return {
        topic.name: as_ros_serializes(data, kinds[topic.type.rpartition("/")[2]])
        for topic, data in zip(topics, encode(STAMP, sample), strict=True)
    }


def test_pose_and_twist_of_every_body(layout, sample):
    messages = motion(layout, sample, layout.body_names, "odom", "left/")
    assert len(messages) == 2 * len(layout.body_names)
    for body in layout.body_names:
        pose, twist = messages[f"~/{body}/pose"], messages[f"~/{body}/twist"]
        assert (pose.header.frame_id, twist.header.frame_id) == ("odom", f"left/{body}")
        for header in (pose.header, twist.header):
            assert (header.stamp.sec, header.stamp.nanosec) == divmod(STAMP, 10**9)
        check_pose(pose.pose, sample.poses[body])
        assert numbers(pose.pose.orientation, "xyzw") == sample.quaternions[body].tolist()
        assert twist_of(twist.twist) == sample.twists[body].tolist()


def test_odometry_and_velocity(layout, sample):
    topics = (encoders(layout, "map", "left/") for encoders in (sample_messages.odometry, sample_messages.velocities))
    for body, (topic, kind, encode), (*_, velocity) in zip(layout.body_names, *topics, strict=True):
        assert (topic, kind) == (f"~/{body}/odometry", "nav_msgs/msg/Odometry")
        message = as_ros_serializes(encode(STAMP, sample), Odometry)
        assert (message.header.frame_id, message.child_frame_id) == ("map", f"left/{body}")
        assert (message.header.stamp.sec, message.header.stamp.nanosec) == (12, 345_678_901)
        check_pose(message.pose.pose, sample.poses[body])
        assert twist_of(message.twist.twist) == sample.twists[body].tolist()
        assert not message.pose.covariance.any() and not message.twist.covariance.any()
        message = as_ros_serializes(velocity(STAMP, sample), VelocityStamped)
        assert (
            message.header.frame_id == message.body_frame_id == f"left/{body}" and message.reference_frame_id == "map"
        )
        assert twist_of(message.velocity) == sample.twists[body].tolist()


def test_covariances_are_squares_of_the_estimated_errors(layout, sample):
    errors = 0.5 ** np.arange(4.0 * len(layout.body_names)).reshape(-1, 4)
    estimated = copy.copy(sample)
    estimated.errors = errors
    for i, (_, _, encode) in enumerate(sample_messages.odometry(layout, "map")):
        message = as_ros_serializes(encode(STAMP, estimated), Odometry)
        position, attitude, linear, angular = errors[i] ** 2
        for found, variances in (
            (message.pose.covariance, (position, attitude)),
            (message.twist.covariance, (linear, angular)),
        ):
            assert np.array_equal(np.reshape(found, (6, 6)), np.diag(np.repeat(variances, 3)))


@pytest.mark.parametrize("errors, bound, pose, twist", cases("variances_of_unknown_errors_are_finite"))
def test_variances_of_unknown_errors_are_finite(layout, sample, errors, bound, pose, twist):
    """Before the first estimate those of poses are what the accuracy allows."""
    estimated = copy.copy(sample)
    estimated.errors, estimated.bound = np.full((len(layout.body_names), 4), errors), bound
    for _, _, encode in sample_messages.odometry(layout, "map"):
        message = as_ros_serializes(encode(STAMP, estimated), Odometry)
        for found, variances in ((message.pose, pose), (message.twist, (twist, twist))):
            expected = np.diag(np.repeat(variances, 3))
            assert np.array_equal(np.reshape(found.covariance, (6, 6)), expected)


@pytest.mark.parametrize("settings", [{"accuracy": 1e-6}, {"method": "rkmk4", "step": 1e-3}])
def test_all_messages_of_a_run_have_finite_variances(settings):
    simulation = Simulation(scene_from_text(SENSED), **settings)
    ((*_, odometry),) = sample_messages.odometry(simulation.layout, "map")
    sensors = {topic: encode for topic, _, encode in sample_messages.sensors(simulation.layout, "")}
    found = []
    for _ in range(10):
        simulation.advance(1)
        sample = simulation.sample()
        message = deserialize_message(odometry(STAMP, sample), Odometry)
        mark = deserialize_message(sensors["~/mark/odometry"](STAMP, sample), Odometry)
        imu = deserialize_message(sensors["~/imu/imu"](STAMP, sample), Imu)
        for covariance in (message.pose, message.twist, mark.pose, mark.twist):
            assert np.isfinite(covariance.covariance).all()
        assert np.isfinite(imu.orientation_covariance).all()
        found.append(message.pose.covariance[0])
    if simulation.promise:
        assert max(found) < (simulation.promise["accuracy"] * simulation.promise["length"]) ** 2
    else:  # the first errors are not known
        assert found[0] == 1e10 > found[-1]


def test_a_pose_with_covariance_is_that_of_the_odometry(layout, sample):
    estimated = copy.copy(sample)
    estimated.errors = 0.5 ** np.arange(4.0 * len(layout.body_names)).reshape(-1, 4)
    kinds = sample_messages.poses_with_covariance, sample_messages.odometry
    topics = (encoders(layout, "map", "left/") for encoders in kinds)
    for body, (topic, kind, encode), (_, _, odometry) in zip(layout.body_names, *topics, strict=True):
        assert topic == f"~/{body}/pose_with_covariance"
        assert kind == "geometry_msgs/msg/PoseWithCovarianceStamped"
        for each in (sample, estimated):
            message = as_ros_serializes(encode(STAMP, each), PoseWithCovarianceStamped)
            both = deserialize_message(odometry(STAMP, each), Odometry)
            assert message.header == both.header and message.pose == both.pose


@pytest.mark.parametrize("little_endian", [True, False])
def test_estimated_errors_are_decoded_to_the_same_bits(layout, sample, little_endian):
    bodies, estimated, store = (layout.body_names, copy.copy(sample), get_typestore(Stores.ROS2_JAZZY))
    encode, payloads, written = estimates.encoder(bodies), [], []
    for k in range(3):
        estimated.errors = np.random.default_rng(k).normal(size=(len(bodies), 4))
        estimated.errors[k] = np.nan, np.inf, 0.0, -0.0
        message = as_ros_serializes(encode(estimated), Float64MultiArray)
        assert np.array(message.data).tobytes() == estimated.errors.tobytes()
        assert [(d.label, d.size, d.stride) for d in message.layout.dim] == [
            ("plain brick ball bar", 4, 16),
            ("m rad m/s rad/s", 4, 4),
        ]
        same = store.deserialize_cdr(encode(estimated), estimates.TYPE)
        payload = store.serialize_cdr(same, estimates.TYPE, little_endian=little_endian)
        payloads.append(np.frombuffer(payload, dtype=np.uint8))
        written.append(estimated.errors.ravel())
    found = estimates.decode_rows(np.array(payloads), bodies)
    assert found.tobytes() == np.array(written).tobytes()
    for others in (bodies[:3], ("a", *bodies[1:]), bodies[::-1], ()):
        with pytest.raises(MessageError, match="other bodies"):
            estimates.decode_rows(np.array(payloads), others)
    with pytest.raises(MessageError, match="truncated"):
        estimates.decode_rows(np.array(payloads)[:, :-8], bodies)


@pytest.mark.parametrize("own", [(), (1,)])
def test_arrays_of_all_bodies(layout, sample, own):
    """Unless all bodies have topics of their own, the arrays have all; their numbers are those of the single topics."""
    bodies = layout.body_names
    single = motion(layout, sample, bodies, "map")
    messages = motion(layout, sample, [bodies[k] for k in own], "map")
    poses, twists = messages.pop("~/poses"), messages.pop("~/twists")
    assert messages == {
        name: message for name, message in single.items() if name.split("/")[1] in [bodies[k] for k in own]
    }
    assert poses.header == single[f"~/{bodies[0]}/pose"].header
    assert poses.poses == [single[f"~/{body}/pose"].pose for body in bodies]
    rows, columns = twists.layout.dim
    assert rows.label.split(" ") == list(bodies) and columns.label == "m/s m/s m/s rad/s rad/s rad/s"
    assert (rows.size, columns.size) == (len(bodies), 6)
    for body, row in zip(bodies, np.reshape(twists.data, (-1, 6)).tolist()):
        twist = single[f"~/{body}/twist"].twist
        assert row == numbers(twist.linear, "xyz") + numbers(twist.angular, "xyz")


def test_arrays_of_other_bodies_or_frames_are_refused(layout, sample):
    bodies = layout.body_names
    _, encode = sample_messages.motion(bodies, (), "map")
    poses, twists = (np.frombuffer(data, dtype=np.uint8)[None] for data in encode(STAMP, sample))
    numbers = arrays.decode_poses(poses, bodies, "map"), arrays.decode_twists(twists, bodies, "map")
    assert np.array_equal(np.hstack(numbers)[0, :7], sample.rows[0, :7])
    assert np.array_equal(numbers[1].reshape(sample.twist.shape), sample.twist)
    for decode, rows, names, world in (
        (arrays.decode_poses, poses, bodies, "odom"),
        (arrays.decode_poses, poses, bodies[1:], "map"),
        (arrays.decode_poses, poses[:, :-8], bodies, "map"),
        (arrays.decode_twists, twists, bodies[::-1], "map"),
        (arrays.decode_twists, twists[:, :9], bodies, "map"),
    ):
        with pytest.raises(MessageError):
            decode(rows, names, world)


def test_joint_states(layout, sample):
    _, _, encode = only(sample_messages.joint_states(layout, "world"))
    message = as_ros_serializes(encode(STAMP, sample), JointState)
    assert message.name == ["pin", "rail"]
    assert list(zip(message.position, message.velocity)) == [sample.joint_coordinates[name] for name in ("pin", "rail")]
    assert np.isnan(message.effort).tolist() == [True, True]  # nothing is commanded


def test_joint_states_have_the_efforts_that_act():
    """And angle and rate, bitwise, through the same code path as in the node."""
    simulation = Simulation(scene_from_text(SCENE, "shapes"), "rkmk4", 1e-3)
    simulation.apply_effort("rail", -2.5)
    simulation.advance(1)
    _, _, encode = only(sample_messages.joint_states(simulation.layout, "world"))
    sample = simulation.sample()
    message = as_ros_serializes(encode(simulation.time_ns, sample), JointState)
    assert np.isnan(message.effort[0]) and message.effort[1] == -2.5
    assert dict(zip(message.name, zip(message.position, message.velocity))) == sample.joint_coordinates


def test_joint_states_of_a_scene_without_such_joints():
    """Readers accept different padding after empty sequences, so there is no topic."""
    assert sample_messages.joint_states(make_layout(load_scene("heavy_top")), "world") == []


@pytest.mark.parametrize("length", range(9))
def test_names_of_every_length(layout, sample, length):
    """Frame ids, namespaces and joint names end at every offset relative to the alignment."""
    world, prefix = "w" * length, "p" * length
    for own in (layout.body_names, ()):
        motion(layout, sample, own, world, prefix)
    for topics, message_class in (
        (sample_messages.odometry, Odometry),
        (sample_messages.poses_with_covariance, PoseWithCovarianceStamped),
        (sample_messages.velocities, VelocityStamped),
    ):
        for _, _, encode in topics(layout, world, prefix):
            as_ros_serializes(encode(STAMP, sample), message_class)
    encoder = Markers(layout, world, 0.1)
    as_ros_serializes(encoder.encode(STAMP, sample), MarkerArray)
    as_ros_serializes(encoder.encode_end(STAMP), MarkerArray)
    store = get_typestore(Stores.ROS2_JAZZY)
    _, kind, encode = only(sample_messages.transforms(layout, world, prefix))
    payload = encode(STAMP, sample)
    assert bytes(store.serialize_cdr(store.deserialize_cdr(payload, kind), kind)) == payload
    for count in range(1, 4):
        names = ["j" * length + str(k) for k in range(count)]
        joints = SimpleNamespace(coordinates=SimpleNamespace(names=names), scene=SimpleNamespace(robot=None))
        _, _, encode = only(sample_messages.joint_states(joints, world))
        state = SimpleNamespace(joint_coordinates={name: (0.5, 2.0) for name in names}, all_efforts={})
        message = as_ros_serializes(encode(STAMP, state), JointState)
        assert (message.name, message.velocity.tolist()) == (names, [2.0] * count)


def test_transforms_are_what_an_independent_library_serializes(layout, sample):
    """tf2_msgs need not be installed; rosbags has its definition."""
    topic, kind, encode = only(sample_messages.transforms(layout, "world", "left/"))
    store = get_typestore(Stores.ROS2_JAZZY)
    payload = encode(STAMP, sample)
    message = store.deserialize_cdr(payload, kind)
    assert topic == "/tf" and bytes(store.serialize_cdr(message, kind)) == payload
    for body, transform in zip(layout.body_names, message.transforms, strict=True):
        assert (transform.header.frame_id, transform.child_frame_id) == ("world", f"left/{body}")
        assert transform.header.stamp.nanosec == 345_678_901
        assert numbers(transform.transform.translation, "xyz") == sample.positions[body].tolist()
        assert numbers(transform.transform.rotation, "xyzw") == sample.quaternions[body].tolist()


def test_markers(layout, sample):
    world = (0.0, 3.0, 0.0, 1.0, -2.0, 4.0)
    sample = copy.copy(sample)
    sample.__dict__.pop("external_wrenches", None)
    sample.acting = sample.acting._replace(external=no_wrenches(layout.offsets))
    for body, wrench, axes in (
        ("plain", (0.0, 0.0, 2.0, 3.0, 0.0, -1.0), "body"),
        ("ball", world, "world"),
        ("ball", (0.0, 0.0, 0.0, 5.0, 0.0, 0.0), "body"),
    ):
        set_wrench(sample.acting.external, layout.body_names.index(body), wrench, axes)
    encoder = Markers(layout, "world", 0.1)
    message = as_ros_serializes(encoder.encode(STAMP, sample), MarkerArray)
    found = {(marker.ns, marker.id): marker for marker in message.markers}
    assert len(found) == len(message.markers) == 4 + 2 + 4 + 4
    assert {marker.header.frame_id for marker in message.markers} == {"world"}
    # A box of 21.6 kg with edges 0.1, 0.2 and 0.4 m has these moments; in ascending order of them
    # the edges are 0.4, 0.2 and 0.1 m.
    plain, brick, ball, bar = (found["bodies", i] for i in range(4))
    kinds = [Marker.CUBE, Marker.CUBE, Marker.SPHERE, Marker.CYLINDER]
    assert [marker.type for marker in (plain, brick, ball, bar)] == kinds
    assert sorted(numbers(plain.scale, "xyz")) == pytest.approx([0.1, 0.2, 0.4], rel=1e-12)
    assert numbers(plain.pose.position, "xyz") == pytest.approx(
        (sample.poses["plain"] @ [0.1, 0.2, 0.3, 1.0])[:3].tolist()
    )
    axes = Rotation.from_quat(numbers(plain.pose.orientation, "xyzw")).as_matrix()
    longest = axes[:, int(np.argmax(numbers(plain.scale, "xyz")))]
    assert abs(longest @ sample.poses["plain"][:3, 2]) == pytest.approx(1.0, abs=1e-12)
    assert numbers(brick.scale, "xyz") == [0.1, 0.2, 0.4]
    local = np.eye(4)
    local[:3, :3] = Rotation.from_rotvec([0, 0, 0.7]).as_matrix()
    local[2, 3] = 0.2
    check_pose(brick.pose, sample.poses["brick"] @ local)
    assert numbers(ball.scale, "xyz") == [0.6] * 3
    assert bar.scale.z == 2.0 and bar.scale.x == bar.scale.y == 0.02  # not thinner: 2 mm
    pin = found["joints", 0]
    assert numbers(pin.pose.position, "xyz") == pytest.approx((sample.poses["brick"] @ [0, 0, 0.5, 1.0])[:3].tolist())
    force, torque = found["forces", 0], found["torques", 0]
    assert numbers(force.points[1], "xyz") == pytest.approx([0.3, 0.0, -0.1])
    assert numbers(torque.points[1], "xyz") == pytest.approx([0.0, 0.0, 0.2])
    assert (force.action, torque.action) == (Marker.ADD, Marker.ADD)
    assert found["forces", 1].action == found["torques", 3].action == Marker.DELETE
    turn = sample.poses["ball"][:3, :3]  # arrows are drawn in body axes
    tip = numbers(found["forces", 2].points[1], "xyz")
    assert turn @ tip == pytest.approx(0.1 * (np.array(world[3:]) + 5.0 * turn[:, 0]))
    tip = numbers(found["torques", 2].points[1], "xyz")
    assert turn @ tip == pytest.approx(0.1 * np.array(world[:3]))
    check_pose(force.pose, sample.poses["plain"])
    (end,) = as_ros_serializes(encoder.encode_end(STAMP), MarkerArray).markers
    assert (end.action, end.header.frame_id) == (Marker.DELETEALL, "world")


@given(
    st.floats(allow_nan=False),
    st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=30),
    st.sampled_from(["running", "faulted"]),
)
@settings(max_examples=50)
def test_diagnostics(number, text, state):
    figures = {"state": state, "real_time_factor_wanted": 1.0, "real_time_factor": 0.5, "number": number, text: text}
    message = as_ros_serializes(diagnostics.encode(STAMP, "/node: simulation", figures), DiagnosticArray)
    (status,) = message.status
    assert status.name == "/node: simulation"
    assert status.level == (b"\x01" if state == "running" else b"\x02")
    values = {pair.key: pair.value for pair in status.values}
    assert list(values) == list(figures) and values[text] == text
    if math.isfinite(number) and text != "number":
        assert float(values["number"]) == pytest.approx(number, rel=1e-8)


@pytest.mark.parametrize("broken, text", cases("diagnostics_warn_if_what_was_promised_does_not_hold"))
def test_diagnostics_warn_if_what_was_promised_does_not_hold(broken, text):
    figures = {"state": "running", "accurate_until_s": math.inf, "predictable_until_s": math.inf}
    figures |= {"real_time_factor_wanted": 1.0, "real_time_factor": 1.0}
    message = diagnostics.encode(STAMP, "/node: simulation", figures | broken)
    (status,) = as_ros_serializes(message, DiagnosticArray).status
    assert status.message == text
    assert status.level == (b"\x01" if broken else b"\x00")


@given(st.integers(0, 10**18), st.text(st.characters(codec="utf-8", exclude_characters="\0")))
@settings(max_examples=50)
def test_log(stamp_ns, text):
    message = as_ros_serializes(LogCodec.encode(stamp_ns, LogCodec.ERROR, "fault", text), Log)
    assert (message.level, message.name, message.msg) == (40, "fault", text)
    assert (message.stamp.sec, message.stamp.nanosec) == divmod(stamp_ns, 10**9)


def test_a_template_requires_every_slot():
    template = Template()
    template.slot("2d")
    with pytest.raises(ValueError):
        template.pack()


SENSED = text_of("sensed_sample_messages.yaml")


def test_sensors_are_encoded_with_their_noise_and_the_estimated_errors():
    simulation = Simulation(scene_from_text(SENSED), "rkmk4", 1e-3)
    simulation.advance(20)
    sample = simulation.sample()
    position, attitude, speed, spin = sample.error["rod"]
    entries = sample_messages.sensors(simulation.layout, "map", "left/")
    values = {name: numbers.tolist() for name, numbers in sample.sensors.items()}
    classes = [Imu, WrenchStamped, JointState, Odometry, Float64]
    imu, cell, disc, mark, wire = (
        as_ros_serializes(encode(STAMP, sample), message_class)
        for (_, _, encode), message_class in zip(entries, classes, strict=True)
    )
    assert {topic: kind for topic, kind, _ in entries} == {
        "~/imu/imu": "sensor_msgs/msg/Imu",
        "~/cell/wrench": "geometry_msgs/msg/WrenchStamped",
        "~/disc/joint_state": "sensor_msgs/msg/JointState",
        "~/mark/odometry": "nav_msgs/msg/Odometry",
        "~/wire/distance": "std_msgs/msg/Float64",
    }
    assert imu.header.frame_id == "left/imu" and cell.header.frame_id == "left/cell"
    assert numbers(imu.orientation, "xyzw") == values["imu"][:4]
    assert numbers(imu.angular_velocity, "xyz") == values["imu"][4:7]
    assert numbers(imu.linear_acceleration, "xyz") == values["imu"][7:]
    for found, variance in (
        (imu.orientation_covariance, attitude**2),
        (imu.angular_velocity_covariance, 0.01**2 + spin**2),
        (imu.linear_acceleration_covariance, 0.1**2),
    ):
        assert np.array_equal(np.reshape(found, (3, 3)), variance * np.eye(3))
    wrench = numbers(cell.wrench.torque, "xyz") + numbers(cell.wrench.force, "xyz")
    assert wrench == values["cell"]
    assert disc.name == ["hinge"] and list(disc.position) == values["disc"]
    assert math.isnan(disc.velocity[0]) and math.isnan(disc.effort[0])
    assert (mark.header.frame_id, mark.child_frame_id) == ("map", "left/mark")
    assert numbers(mark.pose.pose.position, "xyz") == values["mark"][:3]
    assert numbers(mark.twist.twist.angular, "xyz") == values["mark"][10:]
    expected = np.repeat([0.02**2 + position**2, attitude**2], 3)
    assert np.array_equal(np.reshape(mark.pose.covariance, (6, 6)), np.diag(expected))
    expected = np.repeat([speed**2, spin**2], 3)
    assert np.array_equal(np.reshape(mark.twist.covariance, (6, 6)), np.diag(expected))
    assert wire.data == values["wire"][0]


def test_fixed_frames_of_joints_and_sensors():
    layout = make_layout(scene_from_text(SENSED))
    message = get_typestore(Stores.ROS2_JAZZY).deserialize_cdr(
        sample_messages.fixed_frames(layout, "left/"), "tf2_msgs/msg/TFMessage"
    )
    found = {each.child_frame_id: each for each in message.transforms}
    assert found.keys() == {f"left/{name}" for name in ("hinge_reaction", "imu", "cell", "mark")}
    assert {each.header.frame_id for each in message.transforms} == {"left/rod"}
    assert numbers(found["left/imu"].transform.translation, "xyz") == [0.0, 0.0, -0.5]
    for name in ("hinge_reaction", "cell"):
        turned = numbers(found[f"left/{name}"].transform.rotation, "xyzw")
        assert Rotation.from_quat(turned).apply([0, 0, 1]) == pytest.approx([0, 1, 0], abs=1e-15)
