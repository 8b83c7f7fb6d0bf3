# SPDX-License-Identifier: Apache-2.0
"""Subscriptions to the topics of a real machine, and what is published of its comparison with the scene."""

import importlib

from rclpy.qos import qos_profile_sensor_data
from rclpy.serialization import deserialize_message

from liegroup_core.errors import SceneError
from liegroup_sim_ros.logs.map import load_map
from liegroup_sim_ros.messages import topics
from liegroup_sim_ros.messages.codecs import MessageError
from liegroup_sim_ros.serving.machine import RealMachine

from .parameters import NodeParameterError

LOOK = 0.5  # s between two looks for topics that nobody has offered yet
MAPS = (".yaml", ".yml")


def _resolved(node, name):
    """Fully qualified name of a topic."""
    try:
        return node.resolve_topic_name(name)
    except RuntimeError as error:  # RCLError, with a place in its source
        reason = str(error).partition(": ")[2].partition(", at ")[0]
        raise NodeParameterError(f"parameter machine: Invalid topic name {name!r:.60}: {reason}") from None


class MachineTopics:
    """Topics of the parameter `machine`, and ~/machine.

    node, scene, layout, values : rclpy Node, Scene with its Layout, parameters
    outputs, server : Outputs, SimulationServer
    Raises NodeParameterError for a map that cannot be read, or does not fit the scene.
    """

    def __init__(self, node, scene, layout, values, outputs, server):
        names, given = values.machine.replace(",", " ").split(), None
        try:
            if values.machine.endswith(MAPS):
                given = load_map(values.machine)
                names = [each.topic for each in (*given.inputs, *given.measurements)]
            self.machine = RealMachine(scene, layout, given, values, _decoded)
            self._wanted = {_resolved(node, name): name for name in names}
        except SceneError as error:
            raise NodeParameterError(f"parameter machine: {' '.join(str(error).split())}") from None
        self._node, self._outputs, self._stream, self._subscriptions = node, outputs, outputs.add(topics.MACHINE), []
        self._timer = node.create_timer(LOOK, self._look)
        outputs.at_steps.append(self._publish)
        outputs.after.append(self.machine.watch)
        server.machine = self.machine
        server.call("plan_outputs")  # with `watch`

    def _look(self):
        """Subscribe to the topics that exist."""
        for topic, types in self._node.get_topic_names_and_types():
            name = self._wanted.pop(topic, None)
            if name is None:
                continue
            try:
                message_class = _class_of(types[0])
            except (ImportError, AttributeError):
                self._node.get_logger().warning(f"machine: {types[0]} of {topic} is not installed")
                continue
            take = self._taker(name, types[0])
            profile = qos_profile_sensor_data
            self._subscriptions.append(self._node.create_subscription(message_class, topic, take, profile, raw=True))
        if not self._wanted:
            self._timer.cancel()

    def _taker(self, name, kind):
        return lambda payload: self.machine.take(name, kind, payload)

    def _publish(self, stamp_ns):
        for message, text in self.machine.news():
            self._stream.send(stamp_ns, message)
            if text:
                self._node.get_logger().warning(text)
                self._outputs.event(stamp_ns, "machine", text)

    def close(self):
        """End the comparison, and destroy the subscriptions."""
        self.machine.stop()
        self._node.destroy_timer(self._timer)
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)


def _class_of(kind):
    package, _, name = kind.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), name)


def _decoded(kind, payload):
    """{field: value} of a message. Raises MessageError."""
    try:
        return _fields(deserialize_message(payload, _class_of(kind)))
    except Exception as error:  # of the middleware
        raise MessageError(f"{kind}: {error}") from None


def _fields(value):
    """A message as dictionaries, lists, numbers and texts."""
    if hasattr(value, "get_fields_and_field_types"):
        return {name: _fields(getattr(value, name)) for name in value.get_fields_and_field_types()}
    if isinstance(value, (str, bytes, int, float)):
        return value
    values = value.tolist() if hasattr(value, "tolist") else value
    return [_fields(each) for each in values]
