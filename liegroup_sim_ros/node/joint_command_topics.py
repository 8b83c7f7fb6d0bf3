# SPDX-License-Identifier: Apache-2.0
"""Subscription to ~/joint_commands: commands are decoded and passed to the simulation."""

from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState

from .counted_input import Refusal
from .joint_command_input import JointCommandInput
from .wrench_topics import DEPTH

TOPIC = "~/joint_commands"


class JointCommandTopics:
    """Topic for commands, if the scene has a joint with one coordinate.

    node   : rclpy Node
    layout : Layout of the scene
    values : parameters; command_timeout and command_stamps are read for every message
    server : SimulationServer
    qos    : QosOverrides
    """

    def __init__(self, node, layout, values, server, qos):
        self._node, self._values, self._server = node, values, server
        self.input = JointCommandInput(layout)
        self._subscription = None
        if layout.coordinates.names:
            self._subscription = node.create_subscription(
                JointState,
                TOPIC,
                self._receive,
                QoSProfile(depth=DEPTH),
                raw=True,
                qos_overriding_options=qos.options(node, TOPIC, "subscription"),
            )

    def _receive(self, payload):
        server, lasting = self._server, self._values.command_timeout or None
        try:
            commands = self.input.read(
                payload, server.stamp_ns, server.wrenches_held, lasting, self._values.command_stamps
            )
        except Refusal as refusal:
            if refusal.first:
                self._node.get_logger().warning(str(refusal))
            return
        server.push(commands, lasting)

    def figures(self):
        """Figures of the topic for the diagnostics; none without the topic."""
        return self.input.figures() if self._subscription is not None else {}

    def close(self):
        """Destroy the subscription."""
        if self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
