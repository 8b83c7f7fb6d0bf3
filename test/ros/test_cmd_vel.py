# SPDX-License-Identifier: Apache-2.0
"""A mobile robot that is driven by ~/cmd_vel, over DDS: its path, its stop, and the repetition of its recording."""

import signal

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped, TwistStamped
from node_process import COMPILING, NodeProcess, stamp_ns

from liegroup_core import SceneError
from liegroup_core.layout import make_layout
from liegroup_core.scene.load import load_scene, scene_from_text
from liegroup_sim_ros.playback.resimulate import resimulate
from liegroup_sim_ros.recording.read import read_recording

NODE = "/rover"


def test_rates_of_wheels_follow_from_the_scene():
    """Radius 0.1 m and track 0.34 m; an axis that points to the right turns the other way."""
    scene = load_scene("diff_drive")
    found = make_layout(scene).wheels.at(0.5, 2.0)
    assert found["left"] == pytest.approx((0.5 - 2.0 * 0.17) / 0.1) and found["right"] == pytest.approx(8.4)
    name = "name: right\n    type: revolute\n    parent: base\n    child: right_wheel\n    child_frame: "
    turned = scene.text.replace(f"{name}*lateral", f"{name}{{rotation_vector: [1.5707963267948966, 0, 0]}}")
    assert turned != scene.text
    assert make_layout(scene_from_text(turned, source="t")).wheels.at(0.5, 2.0)["right"] == pytest.approx(-8.4)


@pytest.mark.parametrize(
    "drive, text",
    [
        ("{left: left, right: rigth}", 'drive: right: unknown joint "rigth"; did you mean "right"?'),
        ("{left: left, right: socket}", 'drive: joint "socket" is a spherical joint, not revolute'),
        ("{left: [], right: right}", "drive: left has no joint"),
        ("{left: [left, right], right: right}", "drive: a joint is on both sides"),
    ],
)
def test_wrong_drives_are_refused(drive, text):
    with pytest.raises(SceneError, match=text.replace("?", r"\?")):
        scene_from_text(load_scene("diff_drive").text.replace("{left: left, right: right}", drive), source="t")


def test_a_robot_drives_a_circle_and_stops_without_commands(client, tmp_path):
    poses = client.listen(f"{NODE}/base/pose", PoseStamped)
    twists = client.listen(f"{NODE}/base/twist", TwistStamped)
    given = {"scene": "diff_drive", "record": tmp_path / "run.mcap", "publish_rate": 60.0}
    with NodeProcess(given, remap=[f"__node:={NODE[1:]}"]) as process:
        publisher = client.node.create_publisher(TwistStamped, f"{NODE}/cmd_vel", 10)
        client.until(lambda: poses and publisher.get_subscription_count(), COMPILING, "the node")
        message = TwistStamped()
        message.twist.linear.x, message.twist.angular.z = 0.5, 1.0
        end = stamp_ns(poses[-1].header.stamp) + 3 * 10**9
        while stamp_ns(poses[-1].header.stamp) < end:
            publisher.publish(message)
            client.spin(0.05)
        moving = twists[-1].twist
        places = np.array(
            [(m.pose.position.x, m.pose.position.y) for m in poses if stamp_ns(m.header.stamp) > end - 10**9]
        )
        client.until(lambda: stamp_ns(poses[-1].header.stamp) > end + 2 * 10**9)
        message.twist.linear.x = float("nan")
        publisher.publish(message)
        client.spin(0.3)
        process.send(signal.SIGINT)
        code, errors = process.wait()
    assert code == 0 and "the velocity of left is not finite" in errors, errors
    # Radius v / w of the middle between the wheels, to the slip of the servos' speed.
    assert moving.linear.x == pytest.approx(0.5, rel=0.02) and moving.angular.z == pytest.approx(1.0, rel=0.02)
    rows = np.column_stack([2.0 * places, np.ones(len(places))])
    x, y, rest = np.linalg.lstsq(rows, (places**2).sum(axis=1), rcond=None)[0]
    assert np.sqrt(rest + x * x + y * y) == pytest.approx(0.5, rel=0.02)
    stopped = [m.twist for m in twists if stamp_ns(m.header.stamp) > end + 1_500_000_000]
    assert abs(stopped[-1].linear.x) < 1e-3 and abs(stopped[-1].angular.z) < 1e-3
    same = resimulate(read_recording(tmp_path / "run.mcap"))
    assert same["identical"] == same["samples"] > 100
