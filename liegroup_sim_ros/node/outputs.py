# SPDX-License-Identifier: Apache-2.0
"""Output of a simulation to ROS topics and to a recording; each message is encoded once.

Topics, types and frames: docs/reference/node.md. Stamps are simulated time in ns. A topic with
rate 0 is not created, and nothing is computed for it.
"""

import contextlib
import functools
import importlib
import time

from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from liegroup_core.forces.commands import EFFORT, WRENCH
from liegroup_core.forces.kinds import wanted_values
from liegroup_core.joint_events import has_impacts
from liegroup_core.joints.motion import FROM_SCENE
from liegroup_sim_ros.messages import commands, description, diagnostics, estimates, inputs, joint_modes, topics
from liegroup_sim_ros.messages import samples as sample_messages
from liegroup_sim_ros.messages.codecs import ClockCodec, LogCodec
from liegroup_sim_ros.messages.markers import Markers, markers

from .parameters import ParameterError

# Longest time to wait at the end for acknowledgements of the last messages of all topics, s. Subscribers
# acknowledge a topic with fewer messages than its depth only at the next heartbeat of DDS, seconds later.
LAST_WORDS = 0.5


class Stream:
    """One topic: its publisher and, when recording, its channel.

    overrides    : QosOverrides
    message_type : such as "geometry_msgs/msg/PoseStamped"
    qos          : as in schemas.qos_profile
    depth        : messages that the topic keeps
    """

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
        # Publisher.publish would enter this context for every message, which doubles the time.
        self._handle = self._publisher.handle
        self._handle.__enter__()
        self._publish = self._handle.publish_raw
        best_effort = profile.reliability == ReliabilityPolicy.BEST_EFFORT
        self._type, self._qos = message_type, "best_effort" if best_effort else qos
        self.depth = profile.depth
        self._write = self._channel = None

    @property
    def topic(self):
        """Resolved name of the topic."""
        return self._publisher.topic_name

    def record_to(self, recorder):
        """Record all messages that are published from now on."""
        self._channel = recorder.add_channel(self.topic, self._type, self._qos, self.depth)
        self._write = recorder.write

    def send(self, stamp_ns, data):
        """Publish and record a serialized message."""
        self._publish(data)
        if self._write is not None:
            self._write(self._channel, stamp_ns, data)

    def publish(self, data):
        """Publish a serialized message, without recording it."""
        self._publish(data)

    def record(self, stamp_ns, data):
        """Record a serialized message, without publishing it."""
        if self._write is not None:
            self._write(self._channel, stamp_ns, data)

    def wait(self, seconds):
        """Wait until all reliable subscribers have all messages, at most for `seconds`."""
        with contextlib.suppress(RuntimeError):  # not supported by some middlewares
            self._publisher.wait_for_all_acked(Duration(seconds=seconds))

    def close(self):
        """Destroy the publisher."""
        self._handle.__exit__(None, None, None)
        self._node.destroy_publisher(self._publisher)


class Outputs:
    """All published topics of a simulation; SimulationServer calls its methods.

    node      : rclpy Node
    layout    : Layout of the scene
    values    : parameters
    figures   : function that returns {name: number or text}, added to the diagnostics
    overrides : QosOverrides
    Raises ParameterError for a topic whose message type is not installed.

    timed                    : [(steps between messages, send(stamp_ns, sample))]
    attending                : functions of the stamp, called with the diagnostics, once a second
    clock_steps, state_steps : steps between messages of /clock and ~/state, 0: none
    targets                  : {joint: (position, velocity)} of the servos that were commanded
    motions                  : {joint: (7,)} of the driven joints that were commanded
    impulses                 : [(Stream, encoder)] of the joints, if they are published
    """

    def __init__(self, node, layout, values, figures, overrides):
        self._node, self._figures, self._overrides = node, figures, overrides
        self._name = f"{node.get_fully_qualified_name()}: simulation"
        self._streams = []
        self.timed, self.attending = [], []
        self.clock_steps = values.steps["clock_rate"]
        self.state_steps = values.steps["state_rate"]
        bodies, world_frame = layout.body_names, values.world_frame
        self._topics = {"pose": {}, "twist": {}}
        if values.steps["publish_rate"]:
            self._add_samples(bodies, values)
        self._inputs = self._stream(*topics.INPUTS)
        self._sent = 0  # messages of ~/inputs since the last one with all commands
        self._servos, self.targets = layout.servos, {}
        if self._servos:
            self._targets = self._stream(*topics.SERVO_TARGETS)
            self._encode_targets = commands.servo_targets(layout)
            idle = wanted_values(layout.model.forces).tolist()
            self._idle = dict(zip(self._servos, idle))
        self._driven, self.motions = tuple(layout.motions), {}
        if self._driven:
            self._motion_stream = self._stream(*topics.MOTIONS)
            self._encode_motions = commands.motions(layout)
        self._joint_modes = None
        if layout.switches:
            self._joint_modes = self._stream(*topics.JOINT_MODES)
            self._encode_modes = joint_modes.encoder(layout)
        self.impulses = []
        if values.steps["reaction_rate"] and has_impacts(layout.scene):
            self.impulses = [
                (self._stream(topic, message_type, depth=topics.IMPULSES_KEPT), encode)
                for topic, message_type, encode in sample_messages.impulses(layout, values.frame_prefix)
            ]
        self._events = self._stream(*topics.EVENTS)
        # For viewers only; the recording contains the scene.
        self._description = Stream(node, overrides, *topics.DESCRIPTION)
        self._description.publish(description.encoded(description.robot_description(layout.scene)))
        self._diagnostics = self._stream(*topics.DIAGNOSTICS)
        self._clock = self._state = self._marker_stream = None
        if self.clock_steps:
            self._clock = self._stream(*topics.CLOCK)
        if self.state_steps:
            self._state = self._stream(*topics.STATE)
        self._markers = Markers(layout, world_frame, values.arrow_scale)
        optional = {name: make for name, (make, _) in sample_messages.OPTIONAL.items()}
        optional["tf_rate"] = functools.partial(sample_messages.transforms, which=values.tf_links)
        optional["marker_rate"] = lambda *_: markers(self._markers)
        for name, make in optional.items():
            if values.steps[name]:
                try:
                    entries = make(layout, world_frame, values.frame_prefix)
                except ValueError as error:
                    raise ParameterError(f"parameter {name}: {error}") from None
                self._add_optional(name, entries, values.steps[name])
        self._static = []
        if values.steps["reaction_rate"] or values.steps["sensor_rate"]:
            layout.reactions.warm_up()
            with contextlib.suppress(ImportError):  # wrenches need no tf2_msgs
                self._static.append(Stream(node, overrides, *topics.STATIC_TRANSFORMS))
                frames = sample_messages.fixed_frames(layout, values.frame_prefix)
                self._static[0].publish(frames)

    def _stream(self, *arguments, **options):
        self._streams.append(Stream(self._node, self._overrides, *arguments, **options))
        return self._streams[-1]

    def _add_samples(self, bodies, values):
        encode = sample_messages.poses_and_twists(bodies, values.world_frame, values.frame_prefix)
        table, steps = [], values.steps["publish_rate"]
        for body in bodies:
            pose = self._stream(*topics.pose(body))
            twist = self._stream(*topics.twist(body))
            self._topics["pose"][body], self._topics["twist"][body] = pose.topic, twist.topic
            table.append((pose.send, twist.send))

        def send(stamp_ns, sample):
            for (send_pose, send_twist), (pose, twist) in zip(table, encode(stamp_ns, sample)):
                send_pose(stamp_ns, pose)
                send_twist(stamp_ns, twist)

        self.timed.append((steps, send))
        if values.estimate:
            errors, encode_errors = self._stream(*topics.ERRORS), estimates.encoder(bodies)
            self._topics["errors"] = errors.topic
            self.timed.append((steps, lambda stamp_ns, sample: errors.send(stamp_ns, encode_errors(sample))))

    def _add_optional(self, parameter, entries, steps):
        for topic, message_type, encode in entries:
            # For viewers that start while the simulation is paused.
            qos = "transient_local" if parameter == "marker_rate" else "reliable"
            try:
                stream = self._stream(topic, message_type, qos=qos)
            except ImportError:
                package = message_type.partition("/")[0]
                raise ParameterError(
                    f"parameter {parameter}: {package} is not installed; set the rate to 0, or "
                    f"install it (apt: ros-jazzy-{package.replace('_', '-')})"
                ) from None
            self.timed.append(
                (
                    steps,
                    lambda stamp_ns, sample, stream=stream, encode=encode: stream.send(
                        stamp_ns, encode(stamp_ns, sample)
                    ),
                )
            )
            if parameter == "marker_rate":
                self._marker_stream = stream

    def topics(self):
        """Resolved names, as in a recording's settings."""
        return {
            **self._topics,
            "inputs": self._inputs.topic,
            **({"servo_targets": self._targets.topic} if self._servos else {}),
            **({"motions": self._motion_stream.topic} if self._driven else {}),
            **({"joint_modes": self._joint_modes.topic} if self._joint_modes else {}),
            "events": self._events.topic,
            "clock": self._clock.topic if self._clock else None,
            "diagnostics": self._diagnostics.topic,
        }

    def set_arrow_scale(self, value):
        """Set the length of the arrows in ~/markers, m per N and per N m."""
        self._markers.arrow_scale = value

    def record_to(self, recorder):
        """Record all topics from now on."""
        for stream in self._streams:
            stream.record_to(recorder)

    def close(self, stamp_ns=None):
        """Destroy all publishers; with the last stamp, delete the markers in viewers first."""
        if stamp_ns is not None:
            if self._marker_stream is not None:
                self._marker_stream.publish(self._markers.encode_end(stamp_ns))
            # A subscriber drops messages that arrive after it knows that the publisher is gone.
            end = time.monotonic() + LAST_WORDS
            for stream in self._streams:
                stream.wait(max(0.0, end - time.monotonic()))
        for stream in (*self._streams, *self._static, self._description):
            stream.close()

    def clock(self, stamp_ns):
        """Publish /clock."""
        self._clock.send(stamp_ns, ClockCodec.encode(stamp_ns))

    def inputs(self, stamp_ns, base_ns, commands, present):
        """Publish Commands of wrenches and efforts, given at this stamp.

        base_ns : stamp of step 0
        present : function that returns the Commands that act or wait now
        """
        self._inputs.send(stamp_ns, inputs.encode(base_ns, commands))
        self._sent += 1
        if self._sent >= self._inputs.depth // 2:
            self.all_inputs(base_ns, present())

    def all_inputs(self, base_ns, present):
        """Publish the Commands that act or wait; a recording has them in its states.

        Late subscribers receive the history of the topic, so it must always contain such a message.
        """
        commands = [c for part in present for c in part if c.kind in (WRENCH, EFFORT)]
        self._inputs.publish(inputs.encode(base_ns, commands, everything=True))
        self._sent = 0

    def servo_targets(self, stamp_ns, changed):
        """Publish the wanted values of all servos from this stamp on.

        changed : {joint: (position, velocity)}; empty: all servos return to the values of the scene
        """
        self.targets = self.targets | changed if changed else {}
        self._targets.send(stamp_ns, self._targets_now(stamp_ns))

    def prescribed(self, stamp_ns, changed, anew=False):
        """Publish the motions of all driven joints from this stamp on.

        changed : {joint: (7,)} commanded motions, see liegroup_core/joints/motion.py
        anew    : True: all other joints return to the motions of the scene
        """
        self.motions = {**({} if anew else self.motions), **changed}
        self._motion_stream.send(stamp_ns, self._motions_now())

    def _motions_now(self):
        rows = [self.motions.get(joint, FROM_SCENE) for joint in self._driven]
        return self._encode_motions([float(number) for row in rows for number in row])

    def _targets_now(self, stamp_ns):
        return self._encode_targets(stamp_ns, (self._idle | self.targets).values())

    def joint_modes(self, stamp_ns, data):
        """Publish the modes of all joints with stops or friction, a serialized message."""
        self._joint_modes.send(stamp_ns, data)

    def impact(self, stamp_ns, array):
        """Publish the impulses (J, 6) of all joints at an impact."""
        for (stream, encode), impulse in zip(self.impulses, array):
            stream.send(stamp_ns, encode(stamp_ns, impulse))

    def record_acting(self, stamp_ns, sample):
        """Record wanted values, motions and modes at the start of a new file, without publishing them."""
        if self.targets:
            self._targets.record(stamp_ns, self._targets_now(stamp_ns))
        if self.motions:
            self._motion_stream.record(stamp_ns, self._motions_now())
        if self._joint_modes:
            self._joint_modes.record(stamp_ns, self._encode_modes(sample.switching))

    def event(self, stamp_ns, name, text, failed=False, is_logged=False):
        """Publish an event of the run; log it as well if it is a failure and not logged yet."""
        if failed and not is_logged:
            self._node.get_logger().error(text)
        self._events.send(stamp_ns, LogCodec.encode(stamp_ns, LogCodec.ERROR if failed else LogCodec.INFO, name, text))

    def state(self, stamp_ns, figures):
        """Publish ~/state: the figures of the diagnostics, in simulated time."""
        self._state.send(stamp_ns, self._encoded(stamp_ns, figures))

    def diagnostics(self, stamp_ns, figures):
        """Publish /diagnostics: figures of the simulation thread and of the node."""
        self._diagnostics.send(stamp_ns, self._encoded(stamp_ns, figures))
        for attend in self.attending:
            attend(stamp_ns)
        if figures["state"] != "running" and self._clock is not None:
            # For subscribers that start while the simulation is paused; the recording has it already.
            self._clock.publish(ClockCodec.encode(stamp_ns))

    def _encoded(self, stamp_ns, figures):
        return diagnostics.encode(stamp_ns, self._name, {**figures, **self._figures()})
