# SPDX-License-Identifier: Apache-2.0
"""Output of a simulation to ROS topics and to a recording: one message, encoded once, to both.

Topics, types and frames are in docs/node.md. Stamps are simulated time in ns.
"""
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped, TwistStamped, WrenchStamped
from rcl_interfaces.msg import Log
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import serialize_message
from rclpy.time import Time
from rosgraph_msgs.msg import Clock

from liegroup_core.pacing import SLOW

from .messages import ClockCodec, PoseStampedCodec, TwistStampedCodec, WrenchStampedCodec


class Stream:
    """One topic: its publisher and, when recording, its channel.

    qos : as in schemas.qos_profile
    """

    def __init__(self, node, topic, message_class, qos="reliable", depth=10):
        profile = QoSProfile(depth=depth)
        if qos == "transient_local":
            profile.durability = DurabilityPolicy.TRANSIENT_LOCAL
        self._publisher = node.create_publisher(message_class, topic, profile)
        package = message_class.__module__.split(".")[0]
        self._type = f"{package}/msg/{message_class.__name__}"
        self._qos, self._depth = qos, depth
        self._record = None

    @property
    def topic(self):
        """The topic's resolved name."""
        return self._publisher.topic_name

    def record_to(self, recorder):
        """From now on, record what is published."""
        channel = recorder.add_channel(self.topic, self._type, self._qos, self._depth)
        self._record = lambda stamp_ns, data: recorder.write(channel, stamp_ns, data)

    def send(self, stamp_ns, data):
        """Publish and record a serialized message."""
        self._publisher.publish(data)
        if self._record is not None:
            self._record(stamp_ns, data)


class Outputs:
    """All topics of a simulation; the methods are what SimulationServer calls.

    node        : rclpy Node
    bodies      : names of the bodies
    world_frame : frame id of the poses
    clock       : whether /clock is published
    figures     : function that returns {name: number or text}, added to the diagnostics
    """

    def __init__(self, node, bodies, world_frame, clock, figures):
        self._name = node.get_fully_qualified_name()
        self._figures = figures
        self._logger = node.get_logger()
        self._pose = {b: Stream(node, f"~/{b}/pose", PoseStamped) for b in bodies}
        self._twist = {b: Stream(node, f"~/{b}/twist", TwistStamped) for b in bodies}
        # Many bodies may be pushed at one step.
        self._applied = Stream(node, "~/applied_wrench", WrenchStamped, depth=100)
        self._events = Stream(node, "~/events", Log, qos="transient_local")
        self._diagnostics = Stream(node, "/diagnostics", DiagnosticArray)
        self._clock = Stream(node, "/clock", Clock, depth=1) if clock else None
        encode_pose = PoseStampedCodec(world_frame).encode
        self._bodies = [(b, self._pose[b].send, encode_pose,
                         self._twist[b].send, TwistStampedCodec(b).encode) for b in bodies]
        self._encode_wrench = {b: WrenchStampedCodec(b).encode for b in bodies}

    def topics(self):
        """Resolved names, as in a recording's settings."""
        return {"pose": {b: stream.topic for b, stream in self._pose.items()},
                "twist": {b: stream.topic for b, stream in self._twist.items()},
                "applied_wrench": self._applied.topic,
                "events": self._events.topic,
                "clock": self._clock.topic if self._clock else None,
                "diagnostics": self._diagnostics.topic}

    def record_to(self, recorder):
        """From now on, record all topics."""
        for stream in (*self._pose.values(), *self._twist.values(), self._applied, self._events,
                       self._diagnostics, self._clock):
            if stream is not None:
                stream.record_to(recorder)

    def sample(self, stamp_ns, sample):
        """Poses and twists of all bodies."""
        positions, quaternions, twists = sample.positions, sample.quaternions, sample.twists
        for body, send_pose, encode_pose, send_twist, encode_twist in self._bodies:
            send_pose(stamp_ns, encode_pose(stamp_ns, positions[body], quaternions[body]))
            send_twist(stamp_ns, encode_twist(stamp_ns, twists[body]))

    def clock(self, stamp_ns):
        """/clock."""
        self._clock.send(stamp_ns, ClockCodec.encode(stamp_ns))

    def applied_wrench(self, stamp_ns, body, wrench):
        """The total wrench (torque, force) on a body from this stamp on."""
        self._applied.send(stamp_ns, self._encode_wrench[body](stamp_ns, wrench))

    def event(self, stamp_ns, name, text, failed=False):
        """Something that happened to the run; what ends it is logged, too."""
        if failed:
            self._logger.error(text)
        message = Log(stamp=Time(nanoseconds=stamp_ns).to_msg(), name=name, msg=text,
                      level=Log.ERROR if failed else Log.INFO)
        self._events.send(stamp_ns, serialize_message(message))

    def diagnostics(self, stamp_ns, figures):
        """The server's figures and those of the node."""
        figures = {**figures, **self._figures()}
        level, text = _judge(figures)
        status = DiagnosticStatus(
            level=level, name=f"{self._name}: simulation", message=text,
            values=[KeyValue(key=key, value=value if isinstance(value, str) else f"{value:.9g}")
                    for key, value in figures.items()])
        message = DiagnosticArray(status=[status])
        message.header.stamp = Time(nanoseconds=stamp_ns).to_msg()
        self._diagnostics.send(stamp_ns, serialize_message(message))


def _judge(figures):
    """Level and one line about the state."""
    if figures["state"] == "faulted":
        return DiagnosticStatus.ERROR, "stopped by an error: see ~/events, call ~/reset"
    if figures.get("recorder_failure"):
        return DiagnosticStatus.ERROR, figures["recorder_failure"]
    wanted, achieved = figures["real_time_factor_wanted"], figures["real_time_factor"]
    if figures["state"] == "running" and 0.0 < achieved < SLOW * wanted:
        return DiagnosticStatus.WARN, f"too slow: real-time factor {achieved:.3g} of {wanted:.3g}"
    return DiagnosticStatus.OK, figures["state"]
