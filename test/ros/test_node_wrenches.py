# SPDX-License-Identifier: Apache-2.0
"""Wrench topics of a running node: axes, sums, sources, persistence, and killed publishers."""

import os
import signal

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped, TwistStamped
from node_process import NodeProcess, python, stamp_of
from rclpy.qos import DurabilityPolicy, QoSProfile
from scipy.spatial.transform import Rotation
from std_msgs.msg import String

STEP_NS = 1_000_000
NODE = "/pushed"
KEPT = 40  # messages of ~/inputs for late subscribers
COMMANDER = """
import rclpy, time
from geometry_msgs.msg import WrenchStamped
rclpy.init()
node = rclpy.create_node("commander")
publisher = node.create_publisher(WrenchStamped, "/pushed/wrench", 10)
message = WrenchStamped()
message.header.frame_id, message.wrench.force.y = "puck", 1.0
while True:
    publisher.publish(message)
    time.sleep(0.02)
"""


class Pushed:
    """Running node, publishers of wrenches, and the commands that it reports."""

    def __init__(self, client):
        self.client = client
        self.given = client.given(NODE)
        self.pose = client.listen(f"{NODE}/cube/pose", PoseStamped)
        self.twist = client.listen(f"{NODE}/cube/twist", TwistStamped)
        self.puck = client.listen(f"{NODE}/puck/twist", TwistStamped)
        self.to = {
            topic: client.pusher(NODE, topic) for topic in ("wrench", "wrench/persistent", "puck/wrench", "cube/wrench")
        }
        self.clear = client.node.create_publisher(String, f"{NODE}/wrench/clear", 10)
        client.until(lambda: self.pose and self.twist and self.clear.get_subscription_count(), "poses and twists")

    def forces(self, body):
        """x of the total force of all sources on a body at rest, in body and in world axes, after each command."""
        acting, history = {}, []
        for order in self.given:
            if order.kind == "clear" and order.source in acting:
                del acting[order.source]
            elif order.name == body:
                acting[order.source] = order.values[3]
            else:
                continue
            history.append(sum(acting.values()))
        return history

    def until_forces(self, body, expected):
        self.client.until(lambda: len(self.forces(body)) >= len(expected), what=f"{expected} on {body}")
        assert self.forces(body) == expected

    def world_velocity(self):
        """Velocity of the cube in world axes after the last message of both kinds."""
        rotation, linear = self.rotation(), self.twist[-1].twist.linear
        return rotation @ [linear.x, linear.y, linear.z]

    def rotation(self):
        q = self.pose[-1].pose.orientation
        return Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()


@pytest.fixture(scope="module")
def process(client, scene):
    with NodeProcess(
        {
            "scene": scene,
            "method": "rkmk4",
            "step": 1e-3,
            "wrench_hold": "until_replaced",
            f"qos_overrides.{NODE}/inputs.publisher.depth": KEPT,
        },
        remap=[f"__node:={NODE[1:]}"],
    ) as process:
        yield process, Pushed(client)
        process.end(signal.SIGTERM)


@pytest.fixture
def node(client, process):
    pushed = process[1]
    pushed.given.present = None
    client.until_stamp(client.command(f"{NODE}/reset"), pushed.pose, pushed.twist)
    client.until(lambda: pushed.given.present is not None)
    assert client.call(f"{NODE}/resume").success
    pushed.given.clear()
    return pushed


def test_a_late_subscriber_learns_what_acts(client, node):
    node.to["wrench/persistent"]("cube/late", force=(7.0, 0.0, 0.0))
    node.until_forces("cube", [7.0])
    late = client.given(NODE, QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL))
    client.until(lambda: late and late[-1] == node.given[-1], what="what acts")
    assert late[-1][1:3] == ("cube", (0.0, 0.0, 0.0, 7.0, 0.0, 0.0))
    node.clear.publish(String(data="cube/late"))
    node.until_forces("cube", [7.0, 0.0])


def test_a_late_subscriber_learns_what_acts_behind_many_changes(client, node):
    """More changes on one body than the topic keeps do not displace what acts on another."""
    node.to["wrench/persistent"]("cube/late", force=(7.0, 0.0, 0.0))
    node.until_forces("cube", [7.0])
    for change in range(1, KEPT + 100):
        node.to["puck/wrench"]("puck", force=(change * 1e-6, 0.0, 0.0))
        client.until(lambda: node.given[-1].values[3] == change * 1e-6)
    late = client.given(NODE, QoSProfile(depth=KEPT, durability=DurabilityPolicy.TRANSIENT_LOCAL))
    acting = "cube", (0.0, 0.0, 0.0, 7.0, 0.0, 0.0)
    client.until(lambda: acting in [order[1:3] for order in late.present or ()], what="what acts on the cube")


def test_wrenches_of_different_sources_add(client, node):
    """Only the same source replaces or ends a wrench."""
    expected = [0.0]
    for topic, frame, force in (
        ("wrench", "puck", 1.0),
        ("wrench", "puck/left", 2.0),
        ("puck/wrench", "puck", 4.0),
        ("puck/wrench", "world/fan", 8.0),
        ("wrench/persistent", "puck", 16.0),
        ("wrench/persistent", "puck/b", 32.0),
    ):
        node.to[topic](frame, force=(force, 0.0, 0.0))
        expected.append(expected[-1] + force)
        node.until_forces("puck", expected[1:])
    for topic, frame, change in (
        ("wrench", "puck", -1.0),
        ("wrench", "puck/left", -2.0),
        ("puck/wrench", "world", 0.0),
        ("puck/wrench", "world/fan", -8.0),
    ):
        node.to[topic](frame)
        if change:
            expected.append(expected[-1] + change)
            node.until_forces("puck", expected[1:])
        else:  # world and puck are axes of one source on this topic
            expected.append(expected[-1] - 4.0)
            node.until_forces("puck", expected[1:])
    assert expected[-1] == 48.0
    assert node.forces("cube") == []


def test_persistent_wrenches_last_until_they_are_cleared(client, node):
    for frame in ("puck", "puck/b", "cube"):
        node.to["wrench/persistent"](frame, force=(1.0, 0.0, 0.0))
    client.until(lambda: len(node.forces("puck")) + len(node.forces("cube")) >= 2)
    client.until(lambda: node.forces("puck")[-1] == 2.0)
    node.to["wrench"]("puck", force=(8.0, 0.0, 0.0))
    client.until(lambda: node.forces("puck")[-1] == 10.0)
    for target, left in (("nobody", 10.0), ("puck/b", 9.0), ("puck", 8.0)):
        node.clear.publish(String(data=target))
        client.until(lambda: node.forces("puck")[-1] == left)
    assert node.forces("cube") == [1.0]
    node.to["wrench/persistent"]("puck", force=(1.0, 0.0, 0.0))
    client.until(lambda: node.forces("puck")[-1] == 9.0)
    node.clear.publish(String())
    client.until(lambda: node.forces("puck")[-1] == 8.0 and node.forces("cube") == [1.0, 0.0])


def test_force_in_world_axes_keeps_its_direction(client, node):
    """On a tumbling cube the velocity changes by F t / m.

    Seen from the body it rotates by w h = 1.3e-3 in every step. RKMK4 has an error of (w h)^5 / 120
    of it there, below round-off: 500 roundings of velocities below 10 m/s.
    """
    client.until_stamp(client.command(f"{NODE}/pause"), node.pose, node.twist)
    before, force = node.world_velocity(), np.array([3.0, 0.0, -4.0])
    assert client.set(NODE, step_count=500).successful
    node.to["cube/wrench"]("world", force=force.tolist(), stamp_ns=1)
    client.until_stamp(client.command(f"{NODE}/step"), node.pose, node.twist)
    client.until(lambda: node.given)
    velocity = node.world_velocity() - before
    assert np.abs(velocity - force * 0.5 / 1.0).max() < 500 * 10 * 2.2e-16 * 8
    assert (node.given[0].name, node.given[0].axes, node.given[0].values) == ("cube", "world", (0, 0, 0, *force))


def test_the_wrench_of_a_killed_publisher_ends(client, node):
    assert client.set(NODE, wrench_hold="timeout").successful
    commander = python(COMMANDER)
    try:
        client.until(lambda: len(node.given) > 20, "pushes")
    finally:
        os.killpg(commander.pid, signal.SIGKILL)
        commander.communicate()
    client.until(lambda: stamp_of(node.pose[-1]) > node.given[-1].end + 200 * STEP_NS, "the end of the last push")
    assert {order.end - order.start for order in node.given} == {100 * STEP_NS}
    held = node.given[-1].end - node.given[0].start
    speed = client.until(lambda: next((m for m in node.puck if stamp_of(m) > node.given[-1].end), None)).twist.linear
    assert 0.0 < speed.y <= 1.0 / 2.0 * held * 1e-9 * (1.0 + 1e-12)  # a gap between two messages makes it less
    client.until(lambda: stamp_of(node.puck[-1]) > node.given[-1].end + 200 * STEP_NS)
    assert node.puck[-1].twist.linear.y == speed.y
    assert client.set(NODE, wrench_hold="until_replaced").successful
