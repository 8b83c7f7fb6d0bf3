# SPDX-License-Identifier: Apache-2.0
"""Subscriptions to inputs of a node: serialized messages, and a log of those that are refused."""

import time
from functools import partial

from rclpy.qos import QoSProfile

from liegroup_sim_ros.serving.counted_input import Refusal


class InputTopics:
    """Base class of the topics of inputs.

    node   : rclpy Node
    qos    : QosOverrides
    server : SimulationServer

    stamped : {topic: how to subscribe to TOPIC/NAME, None: not}, the topics whose messages begin with a header
    """

    def __init__(self, node, qos, server):
        self._node, self._qos, self._server, self._subscriptions = node, qos, server, []
        self.stamped = {}

    def _subscribe(self, topic, message_class, read, depth, is_stamped=True, divides=False):
        """Subscribe to a topic of the node.

        read    : function (payload, topic, Asked or None) that returns the function that gives the commands of a
                  message, or raises Refusal; Asked: what it answers in lockstep, which is when they act and how long
        divides : whether TOPIC/NAME may be topics as well
        """
        if is_stamped:
            self.stamped[topic] = (message_class, read, depth) if divides else None
        # Raw bytes: decoding them takes a few microseconds, less than creating a message object.
        self._subscriptions.append(
            self._node.create_subscription(
                message_class,
                f"~/{topic}",
                partial(self._attempt, self._take, topic, read),
                QoSProfile(depth=depth),
                raw=True,
                qos_overriding_options=self._qos.options(self._node, f"~/{topic}", "subscription"),
            )
        )

    def offer(self, topic):
        """Whether a topic can answer in lockstep; of one that divides, TOPIC/NAME is created."""
        if topic not in (*self.stamped, "wrench/clear") and (how := self.stamped.get(topic.rpartition("/")[0])):
            self._subscribe(topic, *how)
        return topic in self.stamped

    def _take(self, topic, read, payload):
        lockstep, machine = self._server.lockstep, self._server.machine
        if machine is not None:
            machine.arrived = machine.arrived or time.time_ns()
        if topic in lockstep.rates:
            lockstep.receive(topic, payload, lambda payload, asked: read(payload, topic, asked))
        else:
            read(payload, topic, None)()

    def _attempt(self, take, *arguments):
        """Call a function and log the Refusal that it raises."""
        try:
            take(*arguments)
        except Refusal as refusal:
            if refusal.is_told:
                self._node.get_logger().warning(str(refusal))

    def close(self):
        """Destroy the subscriptions."""
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
