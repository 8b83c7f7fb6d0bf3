# SPDX-License-Identifier: Apache-2.0
"""Subscriptions to the wrench topics: messages are decoded and passed to the simulation."""

from functools import partial

from geometry_msgs.msg import PointStamped, WrenchStamped
from std_msgs.msg import String

from liegroup_sim_ros.messages.links import link_of_body, merged_links
from liegroup_sim_ros.serving.wrench_input import WrenchInput, source_prefix

from .input_topics import InputTopics

# Depth of the queues; DDS drops the oldest message of a full queue. At 10 kHz this covers a delay of
# 1 s. A busy machine often delays a process by more than 0.1 s.
DEPTH = 10_000


class WrenchTopics(InputTopics):
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
        super().__init__(node, qos, server)
        self._values, self._step = values, step
        links = link_of_body(layout.scene)
        merged = merged_links(layout.scene)
        masses = {body.name: body.mass for body in layout.scene.bodies}
        names, frames = layout.body_names, (values.world_frame, values.frame_prefix)
        self.input = WrenchInput(names, *frames, links, merged, masses)
        of_all = [("wrench/persistent", "persistent", None), ("wrench", None, None)]
        for topic, kind, body in (*of_all, *((f"{body}/wrench", "body", body) for body in own)):
            read = partial(self._read, kind=kind, body=body)
            self._subscribe(topic, WrenchStamped, read, DEPTH, divides=kind is None)
        self._subscriptions.append(node.create_subscription(String, "~/wrench/clear", self._clear, DEPTH))
        self._subscribe("pull", PointStamped, self._pull, DEPTH)

    def _read(self, payload, topic, asked, kind, body):
        server, values = self._server, self._values
        now_ns = asked.stamp_ns if asked else server.stamp_ns
        wrench = self.input.read(payload, kind or topic, body, now_ns, server.inputs_held)
        hold = "until_replaced" if kind == "persistent" else "period" if asked else values.wrench_hold
        seconds = {"one_step": self._step, "timeout": values.wrench_timeout, "period": asked and asked.hold}.get(hold)
        return partial(server.push, [wrench], seconds)

    def _pull(self, payload, _, asked):
        server, seconds = self._server, asked.hold if asked else self._values.wrench_timeout
        now_ns = asked.stamp_ns if asked else server.stamp_ns
        return partial(server.push, [self.input.read_pull(payload, now_ns, server.inputs_held)], seconds)

    def _clear(self, message):
        body, name = self.input.body_and_name(message.data)
        if message.data and body is None:
            self._attempt(self.input.refuse_clear, message.data)
            return
        target = f"{body}/{name}" if name else body
        self._server.clear(source_prefix("persistent", target if message.data else ""))

    def figures(self):
        """Figures of the wrench topics for the diagnostics."""
        return self.input.figures()
