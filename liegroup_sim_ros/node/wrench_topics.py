# SPDX-License-Identifier: Apache-2.0
"""Subscriptions to the wrench topics: messages are decoded and passed to the simulation."""

from geometry_msgs.msg import WrenchStamped
from rclpy.qos import QoSProfile
from std_msgs.msg import String

from liegroup_sim_ros.messages.links import link_of_body, merged_links

from .counted_input import Refusal
from .wrench_input import WrenchInput, source_prefix

# Depth of the queues; DDS drops the oldest message of a full queue. At 10 kHz this covers a delay of
# 1 s. A busy machine often delays a process by more than 0.1 s.
DEPTH = 10_000


class WrenchTopics:
    """All wrench topics of a scene.

    node   : rclpy Node
    layout : Layout of the scene
    own    : bodies with topics of their own
    values : parameters; wrench_hold and wrench_timeout are read for every message
    step   : s, of the simulation
    server : SimulationServer
    qos    : QosOverrides
    """

    def __init__(self, node, layout, own, values, step, server, qos):
        self._node, self._values, self._step, self._server = node, values, step, server
        links = link_of_body(layout.scene)
        merged = merged_links(layout.scene)
        self.input = WrenchInput(layout.body_names, values.world_frame, values.frame_prefix, links, merged)
        self._qos, self._subscriptions = qos, []
        self._subscribe("~/wrench", "wrench")
        self._subscribe("~/wrench/persistent", "persistent")
        for body in own:
            self._subscribe(f"~/{body}/wrench", "body", body)
        self._subscriptions.append(node.create_subscription(String, "~/wrench/clear", self._clear, DEPTH))

    def _subscribe(self, topic, kind, body=None):
        # Raw bytes: decoding them takes a few microseconds, less than creating a message object.
        self._subscriptions.append(
            self._node.create_subscription(
                WrenchStamped,
                topic,
                lambda payload: self._receive(payload, kind, body),
                QoSProfile(depth=DEPTH),
                raw=True,
                qos_overriding_options=self._qos.options(self._node, topic, "subscription"),
            )
        )

    def _receive(self, payload, kind, body):
        try:
            push = self.input.read(payload, kind, body, self._server.stamp_ns, self._server.inputs_held)
        except Refusal as refusal:
            self._log(refusal)
            return
        values = self._values
        hold = "until_replaced" if kind == "persistent" else values.wrench_hold
        self._server.push(
            [push], {"one_step": self._step, "timeout": values.wrench_timeout, "until_replaced": None}[hold]
        )

    def _clear(self, message):
        body, name = self.input.body_and_name(message.data)
        if message.data and body is None:
            try:
                self.input.refuse_clear(message.data)
            except Refusal as refusal:
                self._log(refusal)
            return
        target = f"{body}/{name}" if name else body
        self._server.clear(source_prefix("persistent", target if message.data else ""))

    def _log(self, refusal):
        if refusal.is_told:
            self._node.get_logger().warning(str(refusal))

    def figures(self):
        """Figures of the wrench topics for the diagnostics."""
        return self.input.figures()

    def close(self):
        """Destroy the subscriptions."""
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
