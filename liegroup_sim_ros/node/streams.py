# SPDX-License-Identifier: Apache-2.0
"""Topics of a node: published by rclpy, and recorded."""

import contextlib
import importlib

from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from liegroup_sim_ros.serving.outputs import Stream, Streams


class NodeStreams(Streams):
    """Topics of an rclpy Node with QosOverrides."""

    def __init__(self, node, overrides):
        super().__init__(node.get_fully_qualified_name())
        self._node, self._overrides = node, overrides

    def make(self, *topic, **options):
        """NodeStream of a topic. Raises ImportError if its message type is not installed."""
        return NodeStream(self._node, self._overrides, *topic, **options)

    def resolved(self, topic):
        """Fully qualified name of a topic, with remappings."""
        return self._node.resolve_topic_name(topic)

    def report(self, text):
        """Log a failure."""
        self._node.get_logger().error(text)


class NodeStream(Stream):
    """One topic: its publisher and, when recording, its channel."""

    def __init__(self, node, overrides, topic, message_type, qos="reliable", depth=10):
        profile = QoSProfile(depth=depth)
        if qos == "transient_local":
            profile.durability = DurabilityPolicy.TRANSIENT_LOCAL
        package, _, name = message_type.split("/")
        message_class = getattr(importlib.import_module(f"{package}.msg"), name)
        self._node = node
        self._publisher = node.create_publisher(
            message_class, topic, profile, qos_overriding_options=overrides.options(node, topic, "publisher")
        )
        best_effort = profile.reliability == ReliabilityPolicy.BEST_EFFORT
        found = "best_effort" if best_effort else qos
        super().__init__(self._publisher.topic_name, message_type, found, profile.depth)
        # Publisher.publish would enter this context for every message, which doubles the time.
        self._handle = self._publisher.handle
        self._handle.__enter__()
        self.publish = self._handle.publish_raw

    def listeners(self):
        """Number of subscribers."""
        return self._publisher.get_subscription_count()

    def wait(self, seconds):
        """Wait until all reliable subscribers have all messages, at most for `seconds`."""
        with contextlib.suppress(RuntimeError):  # not supported by some middlewares
            self._publisher.wait_for_all_acked(Duration(seconds=seconds))

    def close(self):
        """Destroy the publisher."""
        self._handle.__exit__(None, None, None)
        self._node.destroy_publisher(self._publisher)
