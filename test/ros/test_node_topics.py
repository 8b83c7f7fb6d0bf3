# SPDX-License-Identifier: Apache-2.0
"""Optional topics of a running node with separate rates, reload, and content of recordings.

The frames of its bodies have a prefix, as those of one robot of several.
"""

import importlib.util
import zlib
from pathlib import Path

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import (
    PoseArray,
    PoseStamped,
    PoseWithCovarianceStamped,
    TwistStamped,
    VelocityStamped,
    WrenchStamped,
)
from mcap.reader import make_reader
from nav_msgs.msg import Odometry
from node_process import NodeProcess, figures_of, on_grid, push_command, refusal, stamp_ns, stamp_of
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from scene_files import cases, text_of
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Float64MultiArray, String
from visualization_msgs.msg import Marker, MarkerArray

from liegroup_core.layout import make_layout
from liegroup_core.scene.load import scene_from_text
from liegroup_sim_ros.analysis.analyse import analyse
from liegroup_sim_ros.messages.samples import OPTIONAL
from liegroup_sim_ros.messages.topics import MOST_OWN
from liegroup_sim_ros.playback.branch import Branches
from liegroup_sim_ros.playback.resimulate import resimulate
from liegroup_sim_ros.recording.read import read_recording

STEP_NS = 1_000_000
NODE, PREFIX = "/shown", "robot1/"
# Steps from one message to the next; they have no common period but the step.
PERIODS = cases("node_topics_periods")
ARM = text_of("arm_node_topics.yaml")


class Shown:
    """Running node and the messages on its topics, by rate parameter."""

    def __init__(self, client):
        self.messages = {
            "publish_rate": client.listen(f"{NODE}/lower/pose", PoseStamped),
            "odometry_rate": client.listen(f"{NODE}/lower/odometry", Odometry),
            "pose_with_covariance_rate": client.listen(f"{NODE}/lower/pose_with_covariance", PoseWithCovarianceStamped),
            "velocity_rate": client.listen(f"{NODE}/lower/velocity", VelocityStamped),
            "joint_state_rate": client.listen(f"{NODE}/joint_states", JointState),
            "sensor_rate": client.listen(f"{NODE}/imu/imu", Imu),
            "reaction_rate": client.listen(f"{NODE}/elbow/wrench", WrenchStamped),
            "contact_rate": client.listen(f"{NODE}/pad/wrench", WrenchStamped),
            "marker_rate": client.listen(f"{NODE}/markers", MarkerArray),
            "state_rate": client.listen(f"{NODE}/state", DiagnosticArray),
        }
        self.poses = client.listen(f"{NODE}/poses", PoseArray)
        self.twist = client.listen(f"{NODE}/lower/twist", TwistStamped)
        self.clock = client.listen("/clock", Clock)
        self.events = client.events(NODE)
        client.until(lambda: all(self.messages.values()) and self.clock and self.events, "one message of each")

    def stamps(self, name):
        return [stamp_of(message) for message in self.messages[name]]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("shown")


@pytest.fixture(scope="module")
def node(client, folder):
    scene = folder / "arm.yaml"
    scene.write_text(ARM)
    rates = {name: 1000.0 / steps for name, steps in PERIODS.items()}
    with NodeProcess(
        {
            "scene": scene,
            "record": folder / "run.mcap",
            "arrow_scale": 0.1,
            "world_frame": "map",
            "frame_prefix": PREFIX,
            "body_topics": "lower",
            **rates,
        },
        remap=[f"__node:={NODE[1:]}"],
    ) as process:
        yield Shown(client)
        assert "tf2_msgs" not in process.end()  # nothing is said of a default that is not possible


def test_every_topic_has_its_own_rate(client, node):
    begin = max(node.stamps(name)[-1] for name in node.messages)
    client.until_stamp(begin + 1000 * STEP_NS, *node.messages.values())
    for name in node.messages:
        stamps = [stamp for stamp in node.stamps(name) if begin < stamp]
        assert on_grid(stamps, PERIODS[name] * STEP_NS), name
        assert stamps[0] % (PERIODS[name] * STEP_NS) == 0
    assert on_grid([stamp_of(message) for message in node.clock], 5 * STEP_NS)


def test_every_optional_topic_is_in_these_tests_and_in_the_reference():
    page = (Path(__file__).parents[2] / "docs" / "reference" / "node.md").read_text("utf-8")
    for rate, (_, topic) in OPTIONAL.items():
        assert rate in PERIODS or rate == "tf_rate"  # tf2_msgs may be missing
        assert f"* `{topic}`" in page
    assert f"more than {MOST_OWN} bodies" in page


def test_topics_agree_at_the_same_stamp(client, node):
    names = ("publish_rate", "odometry_rate", "pose_with_covariance_rate", "velocity_rate", "joint_state_rate")
    topics = [node.messages[name] for name in (*names, "marker_rate")] + [node.poses, node.twist]

    def common():
        return set.intersection(*({stamp_of(message) for message in messages[2:]} for messages in topics))

    stamp = max(client.until(common))
    pose, odometry, with_covariance, velocity, joints, markers, poses, twist_stamped = (
        next(m for m in messages if stamp_of(m) == stamp) for messages in topics
    )
    twist, lower = twist_stamped.twist, f"{PREFIX}lower"
    assert odometry.pose.pose == pose.pose == poses.poses[1]
    assert with_covariance.pose == odometry.pose
    assert odometry.twist.twist == velocity.velocity == twist
    assert twist_stamped.header.frame_id == odometry.child_frame_id == lower
    assert (velocity.header.frame_id, velocity.body_frame_id) == (lower, lower)
    assert velocity.reference_frame_id == "map" and {
        m.header.frame_id for m in (pose, odometry, with_covariance, poses, markers.markers[0])
    } == {"map"}
    # In the plane: the second angle is that between the two bodies.
    turn = [2.0 * np.arctan2(p.orientation.y, p.orientation.w) for p in poses.poses]
    assert joints.name == ["shoulder", "elbow"]
    for angle, expected in zip(joints.position, (turn[0], turn[1] - turn[0])):
        assert np.remainder(angle - expected + np.pi, 2 * np.pi) - np.pi == pytest.approx(0.0, abs=1e-9)
    assert joints.velocity[0] + joints.velocity[1] == pytest.approx(twist.angular.y, abs=1e-9)
    assert markers.markers[1].pose.position == pose.pose.position


def test_the_noise_of_sensors_is_repeated_from_the_recording(client, node):
    """White noise of seed and time: the re-simulated state gives the same message."""
    scene = scene_from_text(ARM)
    twists = {stamp_ns(m.header.stamp): m.twist for m in node.twist}
    message = [m for m in node.messages["sensor_rate"] if stamp_of(m) in twists][-1]
    angular = twists[stamp_of(message)]
    key = [0, zlib.crc32(b"imu")]
    bits = np.random.Philox(key=key, counter=[0, 0, 0, stamp_of(message)])
    noise = np.random.Generator(bits).standard_normal(10) * scene.sensors[0].noise
    w, true = message.angular_velocity, angular.angular
    assert (w.x, w.y, w.z) == (true.x + noise[4], true.y + noise[5], true.z + noise[6])


def test_reactions_are_those_of_the_same_state(client, node):
    """Of the recorded pose and twist, whose matrices have another round-off than the state."""
    stamps = set(node.stamps("publish_rate")) & {stamp_ns(m.header.stamp) for m in node.twist}
    message = next(m for m in node.messages["reaction_rate"] if stamp_of(m) in stamps)
    assert message.header.frame_id == f"{PREFIX}elbow_reaction"
    poses = next(m for m in node.poses if stamp_of(m) == stamp_of(message)).poses
    joints = next(m for m in node.messages["joint_state_rate"] if stamp_of(m) == stamp_of(message))
    layout = make_layout(scene_from_text(ARM))
    rate, pose, twist = 0.0, np.zeros((2, 12)), np.zeros((2, 6))
    for i, (p, velocity) in enumerate(zip(poses, joints.velocity)):
        q = p.orientation
        pose[i, :9] = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix().ravel()
        pose[i, 9:] = p.position.x, p.position.y, p.position.z
        rate += velocity
        twist[i, 1] = rate
    # Velocities of the centres of mass from the rates: the arm is two rods of 1 m in a plane.
    twist[0, 3:] = np.cross(twist[0, :3], (0.5, 0.0, 0.0))
    tip = pose[0, :9].reshape(3, 3) @ (2.0 * twist[0, 3:])
    back = pose[1, :9].reshape(3, 3).T @ tip
    twist[1, 3:] = back + np.cross(twist[1, :3], (0.0, 0.0, -0.5))
    expected = layout.sample(pose, twist).reactions["elbow"]
    w = message.wrench
    found = (w.torque.x, w.torque.y, w.torque.z, w.force.x, w.force.y, w.force.z)
    assert found == pytest.approx(expected.tolist(), rel=1e-9, abs=1e-9)


def test_a_contact_is_a_wrench_an_arrow_and_figures(client, node):
    """The pad presses with 4 N along y, at (0.3, -0.1, 0) m of a body that turns about y."""
    message = node.messages["contact_rate"][-1]
    force, torque = message.wrench.force, message.wrench.torque
    assert message.header.frame_id == f"{PREFIX}lower"
    assert (force.x, force.y, force.z) == pytest.approx((0.0, 4.0, 0.0), abs=1e-9)
    assert (torque.x, torque.y, torque.z) == pytest.approx((0.0, 0.0, 1.2), abs=1e-9)
    markers = node.messages["marker_rate"][-1].markers
    (body,), (arrow,), (plane,) = (
        [m for m in markers if (m.ns, m.id) == key] for key in (("bodies", 1), ("contacts", 0), ("planes", 0))
    )
    q, p = body.pose.orientation, body.pose.position
    place = Rotation.from_quat([q.x, q.y, q.z, q.w]).apply([0.3, -0.1, 0.0]) + [p.x, p.y, p.z]
    ends = np.array([[end.x, end.y, end.z] for end in arrow.points])
    assert arrow.action == Marker.ADD and ends == pytest.approx(np.array([place, place + [0.0, 0.4, 0.0]]), abs=1e-9)
    (points,) = (m for m in markers if m.ns == "points")
    assert points.action == Marker.ADD and points.type == Marker.SPHERE_LIST and len(points.colors) == 1
    assert [points.points[0].x, points.points[0].y, points.points[0].z] == pytest.approx(place.tolist(), abs=1e-9)
    q, p = plane.pose.orientation, plane.pose.position
    up = Rotation.from_quat([q.x, q.y, q.z, q.w]).apply([0.0, 0.0, 0.5 * plane.scale.z])
    assert up == pytest.approx([0.0, 0.5 * plane.scale.z, 0.0]) and p.y + up[1] == pytest.approx(0.3)
    figures = figures_of(node.messages["state_rate"][-1])
    assert (figures["contacts_pressing"], figures["deepest_contact"]) == ("1", "pad")
    assert float(figures["contact_depth_m"]) == pytest.approx(0.4)


def test_an_applied_wrench_is_shown_as_an_arrow(client, node):
    push = client.pusher(NODE, "wrench/persistent")
    push("lower", force=(0.0, 3.0, 0.0))  # no frame of this node
    push(f"{PREFIX}lower", force=(0.0, 2.0, 0.0))

    def arrow():
        return next(
            (
                m
                for m in node.messages["marker_rate"][-1].markers
                if (m.ns, m.id, m.action) == ("forces", 1, Marker.ADD)
            ),
            None,
        )

    assert client.until(arrow, what="an arrow").points[1].y == pytest.approx(0.2)
    assert client.set(NODE, arrow_scale=0.5).successful
    client.until(lambda: arrow().points[1].y == 1.0)
    push(f"{PREFIX}lower")
    client.until(lambda: arrow() is None)
    client.until(
        lambda: (
            "1"
            == next(
                pair.value
                for pair in node.messages["state_rate"][-1].status[0].values
                if pair.key == "wrenches_refused_unknown_frame"
            )
        )
    )


def test_push_on_the_command_line_finds_the_topic_prefix(node, capsys):
    assert push_command("lower", "--force", 0, 1, 0, "--duration", 0.1, "--node", NODE) == 0
    assert "applied from" in capsys.readouterr().out


def test_state_contains_the_values_of_the_diagnostics(node):
    figures = {pair.key: pair.value for pair in node.messages["state_rate"][-1].status[0].values}
    assert figures["state"] == "running" and float(figures["sim_time_s"]) > 0.0
    # The elbow opens with the error of RKMK4, of order (omega h)^4 = 1e-9 per second at 6 rad/s.
    assert 0.0 <= float(figures["constraint_residual"]) < 1e-6


def test_topics_without_a_rate_are_not_published(client, node):
    names = dict(client.node.get_topic_names_and_types())
    assert {f"{NODE}/poses", f"{NODE}/lower/pose", f"{NODE}/lower/wrench"} <= names.keys()
    assert not {"/tf", f"{NODE}/upper/pose", f"{NODE}/upper/wrench"} & names.keys()


def test_use_sim_time_is_refused(client, node):
    refused = client.set(NODE, use_sim_time=True)
    assert not refused.successful and "publishes the simulated time" in refused.reason
    assert client.set(NODE, use_sim_time=False).successful


def test_a_late_subscriber_gets_time_and_scene_while_paused(client, node):
    stamp = client.command(f"{NODE}/pause")
    client.until(lambda: stamp_of(node.events[-1]) == stamp)
    clock = client.listen("/clock", Clock, QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT))
    shown = client.listen(
        f"{NODE}/markers", MarkerArray, QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    )
    client.until(lambda: len(clock) >= 2 and shown)
    (paused,) = {stamp_ns(message.clock) for message in clock}
    assert (node.events[-1].name, stamp_ns(node.events[-1].stamp)) == ("pause", paused)
    assert paused - PERIODS["marker_rate"] * STEP_NS < stamp_of(shown[-1]) <= paused
    assert client.call(f"{NODE}/resume").success
    client.until(lambda: stamp_ns(clock[-1].clock) > paused)


def test_reload_starts_a_new_scene_with_new_topics_and_a_new_file(client, node, folder, scene):
    """Must run after the tests above, since it changes the scene of the shared node."""
    assert client.set(NODE, scene="no_such_scene").successful
    refused = client.call(f"{NODE}/reload")
    assert not refused.success and "no_such_scene" in refused.message
    (folder / "run_part2.mcap").touch()  # in the way of the next part
    assert client.set(NODE, scene=str(scene), body_topics="all").successful
    refused = client.call(f"{NODE}/reload")
    assert not refused.success and "already exists" in refused.message
    (folder / "run_part2.mcap").unlink()
    assert client.set(NODE, body_topics="lower").successful
    count = len(node.messages["publish_rate"])
    client.until(lambda: len(node.messages["publish_rate"]) > count + 5)  # goes on
    assert client.set(NODE, scene=str(scene)).successful
    poses = client.listen(f"{NODE}/puck/pose", PoseStamped)
    given = client.given(NODE)
    refused = client.call(f"{NODE}/reload")
    assert not refused.success and "body_topics: the scene has no body 'lower'" in refused.message
    assert client.set(NODE, body_topics="auto").successful
    assert client.call(f"{NODE}/reload").success
    client.until(lambda: len(poses) > 5)
    last = node.stamps("publish_rate")[-1]
    begin = stamp_ns(poses[0].header.stamp)
    assert begin > last
    clock = np.array([stamp_ns(message.clock) for message in node.clock])
    assert (np.diff(clock) >= 0).all()
    # Else the bodies of the scene before would stay in sight.
    (deleted,) = (m for m in node.messages["marker_rate"] if m.markers[0].action == Marker.DELETEALL)
    assert len(deleted.markers) == 1 and deleted.markers[0].header.frame_id == "map"
    assert [event.name for event in node.events].count("stop") == 1
    push = client.pusher(NODE, "puck/wrench")
    push(f"{PREFIX}puck", force=(0.0, 2.0, 0.0))
    client.until(lambda: given)
    assert [order.name for order in given] == ["puck"]
    client.until(
        lambda: (
            f"{NODE}/lower/pose" not in dict(client.node.get_topic_names_and_types())
            or not client.node.get_publishers_info_by_topic(f"{NODE}/lower/pose")
        )
    )
    # The part that is finished, and the one that is being written, are whole in themselves.
    first = read_recording(folder / "run.mcap")
    assert first.complete and first.bodies == ("upper", "lower") and first.lost == {}
    assert first.events[-1].name == "stop"
    assert client.call(f"{NODE}/reload").success  # the same again
    client.until(lambda: (folder / "run_part3.mcap").exists())
    second = read_recording(folder / "run_part2.mcap")
    assert second.complete and second.bodies == ("puck", "cube")
    assert "run.mcap" in second.events[0].text and second.events[0].name == "start"
    begin = second.initial_state["stamp_ns"]
    assert second.events[0].stamp_ns == begin > first.events[-1].stamp_ns
    assert second.pose["puck"].stamp_ns[0] == begin
    same = resimulate(second)
    assert same["identical"] == same["samples"] > 5


def test_everything_published_is_recorded(client, node, folder):
    """In the file before the reload: every topic, on its time grid, without a gap."""
    with open(folder / "run.mcap", "rb") as stream:
        stamps = {}
        for _, channel, message in make_reader(stream).iter_messages():
            stamps.setdefault(channel.topic, []).append(message.log_time)
    for topic, name in (
        ("lower/pose", "publish_rate"),
        ("lower/odometry", "odometry_rate"),
        ("lower/pose_with_covariance", "pose_with_covariance_rate"),
        ("lower/velocity", "velocity_rate"),
        ("poses", "publish_rate"),
        ("twists", "publish_rate"),
        ("joint_states", "joint_state_rate"),
        ("markers", "marker_rate"),
        ("state", "state_rate"),
    ):
        assert set(np.diff(stamps[f"{NODE}/{topic}"])) == {PERIODS[name] * STEP_NS}, topic


@pytest.mark.skipif(importlib.util.find_spec("tf2_msgs") is not None, reason="tf2_msgs is installed here")
def test_tf_is_refused_where_its_message_type_is_missing(client, node, scene, capfd):
    """A node without a rate of it, as the shared one, has started without a word about it."""
    assert "/tf" not in dict(client.node.get_topic_names_and_types())
    answer = client.set(NODE, tf_rate=20.0)
    assert not answer.successful and "tf2_msgs is not installed" in answer.reason
    line = refusal(capfd, {"scene": scene, "tf_rate": 10.0})
    assert line.startswith("sim_node: parameter tf_rate: tf2_msgs is not installed")


@pytest.mark.turn(3)
def test_a_large_scene_has_two_topics_for_all_bodies(client, tmp_path):
    """A free body moves as its velocities say; wrenches, analysis, re-simulation and branches need no other topics."""
    count, name, path = MOST_OWN + 20, "/large", tmp_path / "run.mcap"
    (tmp_path / "large.yaml").write_text(
        "name: large\ngravity: [0, 0, 0]\nbodies:\n"
        + "".join(
            f"  - {{name: b{k}, mass: 2, inertia: [1, 1, 1], position: [{k}, 0, 0], linear_velocity: [0, {k}, 0]}}\n"
            for k in range(count)
        )
    )
    with NodeProcess({"scene": tmp_path / "large.yaml", "record": path}, remap=["__node:=large"]) as process:
        poses = client.listen(f"{name}/poses", PoseArray)
        twists = client.listen(f"{name}/twists", Float64MultiArray)
        latched = client.listen(
            f"{name}/bodies", String, QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        )
        client.until(lambda: len(poses) > 10 and len(twists) > 10 and latched)
        names = dict(client.node.get_topic_names_and_types())
        assert not [topic for topic in names if topic.startswith(f"{name}/b") and topic != f"{name}/bodies"]
        bodies = twists[-1].layout.dim[0].label.split(" ")
        assert bodies == [f"b{k}" for k in range(count)]
        assert latched[-1].data.split() == bodies
        seconds = stamp_of(poses[-1]) * 1e-9
        for k, pose in enumerate(poses[-1].poses):
            assert (pose.position.x, pose.position.y) == pytest.approx((k, k * seconds), abs=1e-12 * count)
        assert push_command("b3", "--force", 0, 0, 1, "--duration", 0.1, "--node", name) == 0
        client.until(lambda: np.reshape(twists[-1].data, (count, 6))[:, 2].any(), "motion")
        moved = np.reshape(twists[-1].data, (count, 6))[:, 2]
        assert np.flatnonzero(moved).tolist() == [3]
        process.end()
    recording = read_recording(path)
    assert recording.complete and recording.lost == {} and recording.bodies == tuple(bodies)
    same = resimulate(recording)
    assert same["identical"] == same["samples"] > 20
    assert analyse(recording).figures["missing_samples"] == 0
    # The message is the recorded one, and a branch goes through the same states.
    last, stamp = poses[-1].poses, stamp_of(poses[-1])
    branch, at_ns = Branches(recording).at(stamp * 1e-9, True)
    sample = branch.sample()
    assert at_ns == stamp
    for body, pose in zip(bodies, last, strict=True):
        track, (place, turn) = recording.pose[body], (pose.position, pose.orientation)
        (row,) = np.flatnonzero(track.stamp_ns == stamp)
        assert [place.x, place.y, place.z] == track.position[row].tolist() == sample.positions[body].tolist()
        assert [turn.x, turn.y, turn.z, turn.w] == track.quaternion[row].tolist() == sample.quaternions[body].tolist()
