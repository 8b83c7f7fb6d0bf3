# SPDX-License-Identifier: Apache-2.0
"""Subscriptions to inputs of a node: serialized messages, and a log of those that are refused."""

from rclpy.qos import QoSProfile

from liegroup_sim_ros.serving.counted_input import Refusal


class InputTopics:
    """Base class of the topics of inputs; node : rclpy Node, qos : QosOverrides."""

    def __init__(self, node, qos):
        self._node, self._qos, self._subscriptions = node, qos, []

    def _subscribe(self, topic, message_class, read, depth):
        # Raw bytes: decoding them takes a few microseconds, less than creating a message object.
        self._subscriptions.append(
            self._node.create_subscription(
                message_class,
                topic,
                lambda payload: self._attempt(read, payload),
                QoSProfile(depth=depth),
                raw=True,
                qos_overriding_options=self._qos.options(self._node, topic, "subscription"),
            )
        )

    def _attempt(self, read, argument):
        """Call a function and log the Refusal that it raises."""
        try:
            read(argument)
        except Refusal as refusal:
            if refusal.is_told:
                self._node.get_logger().warning(str(refusal))

    def close(self):
        """Destroy the subscriptions."""
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
