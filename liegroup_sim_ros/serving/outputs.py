# SPDX-License-Identifier: Apache-2.0
"""Output of a simulation to ROS topics and to a recording; each message is encoded once.

Topics, types and frames: docs/reference/node.md. Stamps are simulated time in ns. A topic with
rate 0 is not created, and nothing is computed for it.
"""

import contextlib
import functools
import logging
import time

from liegroup_core.errors import LieGroupSimError
from liegroup_core.forces.commands import LOADS
from liegroup_core.forces.kinds import target_values
from liegroup_core.joint_events import has_impacts
from liegroup_core.joints.motion import FROM_SCENE
from liegroup_sim_ros.messages import (
    commands,
    description,
    diagnostics,
    estimates,
    inputs,
    joint_modes,
    law_states,
    topics,
)
from liegroup_sim_ros.messages import samples as sample_messages
from liegroup_sim_ros.messages.codecs import ClockCodec, LogCodec
from liegroup_sim_ros.messages.markers import Markers, markers

from .rates import Output

log = logging.getLogger("liegroup_core")

# Longest time to wait at the end for acknowledgements of the last messages of all topics, s. Subscribers
# acknowledge a topic with fewer messages than its depth only at the next heartbeat of DDS, seconds later.
LAST_WORDS = 0.5
FOR_VIEWERS = ("marker_rate", "tf_rate")  # rates of topics that need not answer inputs at once


class NodeParameterError(LieGroupSimError):
    """Invalid parameter of the node; one line of text, exit code 2."""


class Stream:
    """One topic of a recording; a node's subclass publishes it, too.

    topic        : resolved name
    message_type : such as "geometry_msgs/msg/PoseStamped"
    qos          : as in schemas.qos_profile
    depth        : messages that the topic keeps
    """

    def __init__(self, topic, message_type, qos="reliable", depth=10):
        self.topic, self._type, self._qos, self.depth = topic, message_type, qos, depth
        self._write = self._channel = None
        self.is_recorded = True

    def record_to(self, recorder):
        """Record all messages that are sent from now on."""
        self._channel = recorder.add_channel(self.topic, self._type, self._qos, self.depth)
        self._write = recorder.write

    def send(self, stamp_ns, data):
        """Publish and record a serialized message."""
        self.publish(data)
        self.record(stamp_ns, data)

    def publish_only(self, _, data):
        """As `publish`, with the arguments of `send`."""
        self.publish(data)

    def publish(self, data):
        """Publish a serialized message, without recording it."""

    def record(self, stamp_ns, data):
        """Record a serialized message, without publishing it."""
        if self._write is not None and self.is_recorded:
            self._write(self._channel, stamp_ns, data)

    def listeners(self):
        """Number of subscribers."""
        return 0

    def wait(self, seconds):
        """Wait until all reliable subscribers have all messages, at most for `seconds`."""

    def close(self):
        """End the topic."""


class _InOrder:
    """Recorder whose messages wait while `waiting` is a list."""

    def __init__(self, recorder):
        self._recorder, self.waiting = recorder, None
        self.add_channel, self.save = recorder.add_channel, recorder.save

    def write(self, *message):
        if self.waiting is None:
            self._recorder.write(*message)
        else:
            self.waiting.append(message)


class Streams:
    """Topics of a recording; a node's subclass publishes them, too.

    name : fully qualified name of the node
    """

    def __init__(self, name):
        self.name = name

    def make(self, topic, message_type, qos="reliable", depth=10):
        """Stream of a topic, as in topics.Topic."""
        return Stream(self.resolved(topic), message_type, qos, depth)

    def resolved(self, topic):
        """Fully qualified name of a topic."""
        return topics.Topic(topic, "").resolved(self.name)

    def report(self, text):
        """Log a failure."""
        log.error(text)


class Outputs:
    """All topics of a simulation; SimulationServer calls its methods.

    streams   : Streams
    layout    : Layout of the scene
    own       : bodies with topics of their own
    values    : parameters
    figures   : function that returns {name: number or text}, added to the diagnostics
    Raises NodeParameterError for a topic whose message type is not installed.

    after                    : functions (stamp_ns, sample), called with the samples, after all messages
    at_steps                 : functions of the stamp of a step, called before the first message at it or after it
    attending                : functions of the stamp, called with the diagnostics, once a second
    targets                  : {joint: (position, velocity)} of the servos that were commanded
    motions                  : {joint: (7,)} of the driven joints that were commanded
    impulses                 : [(Stream, encoder)] of the joints, if they are published
    """

    def __init__(self, streams, layout, own, values, figures):
        self._made, self._figures = streams, figures
        self._name = f"{streams.name}: simulation"
        self._layout, self._own, self._values, self._recorder = layout, own, values, None
        self._streams, self._static = [], []
        self.after, self.at_steps, self.attending = [], [], []
        self.has_sample = False  # whether the present file of the recording has one
        self._senders = {}  # {rate: its functions (stamp_ns, sample)}
        self._topics = topics.of_motion(layout.body_names, own, lambda topic: streams.resolved(topic.name))
        self._inputs = self._stream(*topics.INPUTS)
        self._sent = 0  # messages of ~/inputs since the last one with all commands
        self._servos, self.targets = layout.servos, {}
        if self._servos:
            self._targets = self._stream(*topics.SERVO_TARGETS)
            self._encode_targets = commands.servo_targets(layout)
            idle = target_values(layout.model.forces).tolist()
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
        self._events = self._stream(*topics.EVENTS)
        # For listeners only; the recording contains the scene.
        self._texts = []
        for topic, text in (
            (topics.DESCRIPTION, description.robot_description(layout.scene)),
            (topics.BODIES, " ".join(layout.body_names)),
            (topics.SCENE, layout.scene.text),
        ):
            self._texts.append(streams.make(*topic))
            self._texts[-1].publish(description.encoded(text))
        self._diagnostics = self._stream(*topics.DIAGNOSTICS)
        self._clock = self._state = self._marker_stream = None
        self._markers = Markers(layout, values.world_frame, values.arrow_scale)
        for name, rate in values.rates.items():
            if rate:
                self.prepare(name)

    def prepare(self, name):
        """Create the topics of a rate, once. Raises NodeParameterError."""
        if name in self._senders:
            return
        if name == "record_rate":
            self.prepare("publish_rate")
            return
        layout, values = self._layout, self._values
        if name == "publish_rate":
            senders = self._samples()
        elif name == "clock_rate":
            self._clock, senders = self._stream(*topics.CLOCK), []
        elif name == "state_rate":
            self._state, senders = self._stream(*topics.STATE), []
        else:
            optional = {name: make for name, (make, _) in sample_messages.OPTIONAL.items()}
            optional["tf_rate"] = functools.partial(sample_messages.transforms, which=values.tf_links)
            optional["marker_rate"] = lambda *_: markers(self._markers)
            try:
                entries = optional[name](layout, values.world_frame, values.frame_prefix)
            except ValueError as error:
                raise NodeParameterError(f"parameter {name}: {error}") from None
            if "/BODY/" in sample_messages.OPTIONAL.get(name, ("", ""))[1]:
                entries = [each for body, each in zip(layout.body_names, entries) if body in self._own]
                if not entries:
                    raise NodeParameterError(
                        f"parameter {name}: no body has topics of its own: name some in body_topics"
                    )
            senders = [self._optional(name, *entry) for entry in entries]
        if name == "reaction_rate" and has_impacts(layout.scene):
            self.impulses = [
                (self._stream(topic, message_type, depth=topics.IMPULSES_KEPT), encode)
                for topic, message_type, encode in sample_messages.impulses(layout, values.frame_prefix)
            ]
        if name in ("reaction_rate", "sensor_rate") or name == "joint_state_rate" and layout.motions:
            layout.reactions.warm_up()  # efforts of driven joints are reactions
        if name in ("reaction_rate", "sensor_rate") and not self._static:
            with contextlib.suppress(ImportError):  # wrenches need no tf2_msgs
                self._static.append(self._made.make(*topics.STATIC_TRANSFORMS))
                self._static[0].publish(sample_messages.fixed_frames(layout, values.frame_prefix))
        self._senders[name] = senders

    @property
    def timed(self):
        """[Output] with the present rates, in the order of the calls; without ~/state."""
        rates = self._values.rates
        calls = [(name, send) for name, senders in self._senders.items() for send in senders]
        calls += [("publish_rate", each) for each in self.after]
        clock = [Output(rates["clock_rate"], self._send_clock, False, False)]  # after all that has its time
        states = [Output(rates[name], send, answers=name not in FOR_VIEWERS) for name, send in calls]
        return [output for output in (*states, *clock) if output.rate]

    def listeners(self):
        """Number of subscribers of each topic."""
        return [stream.listeners() for stream in self._streams]

    def publish_again(self, outputs, stamp_ns, sample):
        """Publish again what some Outputs have sent with a stamp, and do not record it again."""
        for stream in self._streams:
            stream.is_recorded = False
        for output in outputs:
            output.send(stamp_ns, sample)
        for stream in self._streams:
            stream.is_recorded = True

    @property
    def state_rate(self):
        """Rate of ~/state in Hz, 0: none."""
        return self._values.rates["state_rate"]

    def hold(self):
        """Let the messages that are sent from now on wait for their place in the recording."""
        self._had_sample, self.has_sample = self.has_sample, False
        if self._recorder is not None:
            self._recorder.waiting = []

    def release(self):
        """End `hold`; returns the function that records what waits."""
        recorder, has_sample = self._recorder, self.has_sample
        self.has_sample, waiting = self._had_sample, []
        if recorder is not None:
            waiting, recorder.waiting = recorder.waiting, None

        def record():
            self.has_sample |= has_sample
            for message in waiting:
                recorder.write(*message)

        return record

    def save(self):
        """Bring all that is recorded to the disk."""
        if self._recorder is not None:
            self._recorder.save()

    def at_step(self, stamp_ns):
        """Call the functions for a step."""
        for call in self.at_steps:
            call(stamp_ns)

    def add(self, topic):
        """Stream of another Topic."""
        return self._stream(*topic)

    def _stream(self, *arguments, **options):
        stream = self._made.make(*arguments, **options)
        if self._recorder is not None:
            stream.record_to(self._recorder)
        self._streams.append(stream)
        return stream

    def _samples(self):
        values, bodies = self._values, self._layout.body_names
        found, encode = sample_messages.motion(bodies, self._own, values.world_frame, values.frame_prefix)
        streams, encoders = [self._stream(*topic) for topic in found], [encode]
        if values.estimate:
            errors, encode_errors = self._stream(*topics.ERRORS), estimates.encoder(bodies)
            self._topics["errors"] = errors.topic
            streams.append(errors)
            encoders.append(lambda stamp_ns, sample: [encode_errors(sample)])
        if self._layout.states:
            laws, encode_laws = self._stream(*topics.LAWS), law_states.encoder(self._layout)
            self._topics["laws"] = laws.topic
            streams.append(laws)
            encoders.append(lambda stamp_ns, sample: [encode_laws(sample)])

        def sender(calls, records=True):
            def send(stamp_ns, sample):
                self.has_sample = self.has_sample or records
                data = [each for encode in encoders for each in encode(stamp_ns, sample)]
                for call, each in zip(calls, data):
                    call(stamp_ns, each)

            return [send]

        (self._record_sample,) = recording = sender([stream.record for stream in streams])
        if not values.rates["record_rate"]:
            return sender([stream.send for stream in streams])
        self._senders["record_rate"] = recording
        return sender([stream.publish_only for stream in streams], records=False)

    def _optional(self, parameter, topic, message_type, encode):
        # For viewers that start while the simulation is paused.
        qos = "transient_local" if parameter == "marker_rate" else "reliable"
        try:
            stream = self._stream(topic, message_type, qos=qos)
        except ImportError:
            package = message_type.partition("/")[0]
            raise NodeParameterError(
                f"parameter {parameter}: {package} is not installed; set the rate to 0, or "
                f"install it (apt: ros-jazzy-{package.replace('_', '-')})"
            ) from None
        if parameter == "marker_rate":
            self._marker_stream = stream
        return lambda stamp_ns, sample: stream.send(stamp_ns, encode(stamp_ns, sample))

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
        self._recorder = _InOrder(recorder)
        for stream in self._streams:
            stream.record_to(self._recorder)

    def close(self, stamp_ns=None):
        """Destroy all publishers; with the last stamp, delete the markers in viewers first."""
        if stamp_ns is not None:
            if self._marker_stream is not None:
                self._marker_stream.publish(self._markers.encode_end(stamp_ns))
            # A subscriber drops messages that arrive after it knows that the publisher is gone.
            end = time.monotonic() + LAST_WORDS
            for stream in self._streams:
                stream.wait(max(0.0, end - time.monotonic()))
        for stream in (*self._streams, *self._static, *self._texts):
            stream.close()

    def _send_clock(self, stamp_ns, _):
        self._clock.send(stamp_ns, ClockCodec.encode(stamp_ns))

    def given(self, commands):
        """Take notice of all Commands that were given since the last call."""

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
        commands = [c for part in present.as_they_end for c in part if c.kind in LOADS]
        self._inputs.publish(inputs.encode(base_ns, commands, everything=True))
        self._sent = 0

    def servo_targets(self, stamp_ns, changed):
        """Publish the targets of all servos from this stamp on.

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

    def complete(self, stamp_ns, sample):
        """Record a sample if the file has none, at the end of a recording."""
        if not self.has_sample:
            self._record_sample(stamp_ns, sample)

    def record_acting(self, stamp_ns, sample):
        """Record targets, motions and modes at the start of a new file, without publishing them."""
        self.has_sample = False
        if self.targets:
            self._targets.record(stamp_ns, self._targets_now(stamp_ns))
        if self.motions:
            self._motion_stream.record(stamp_ns, self._motions_now())
        if self._joint_modes:
            self._joint_modes.record(stamp_ns, self._encode_modes(sample.switching))

    def event(self, stamp_ns, name, text, failed=False, is_logged=False):
        """Publish an event of the run; log it as well if it is a failure and not logged yet."""
        if failed and not is_logged:
            self._made.report(text)
        self._events.send(stamp_ns, LogCodec.encode(stamp_ns, LogCodec.ERROR if failed else LogCodec.INFO, name, text))

    def state(self, stamp_ns, figures):
        """Publish ~/state: the figures of the diagnostics, in simulated time."""
        self._state.send(stamp_ns, self._encoded(stamp_ns, figures))

    def diagnostics(self, stamp_ns, figures):
        """Publish /diagnostics: figures of the simulation thread and of the node."""
        self._diagnostics.send(stamp_ns, self._encoded(stamp_ns, figures))
        for attend in self.attending:
            attend(stamp_ns)
        if figures["state"] != "running":
            self.publish_clock(stamp_ns)

    def publish_clock(self, stamp_ns):
        """Publish /clock again, for subscribers that missed it; the recording has it already."""
        if self._clock is not None:
            self._clock.publish(ClockCodec.encode(stamp_ns))

    def _encoded(self, stamp_ns, figures):
        return diagnostics.encode(stamp_ns, self._name, {**figures, **self._figures()})
