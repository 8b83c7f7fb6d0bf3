# SPDX-License-Identifier: Apache-2.0
"""Node `replay`: publishes the topics of a recording and /clock; supports pause and seek.

Services (std_srvs/Trigger) have the names of `ros2 bag play`: ~/pause ~/resume ~/toggle_paused
~/play_next. Parameters: `rate` in simulated seconds per second; setting `position` seeks to a time
in s after the first message.
"""

import importlib
import math
import os
import select
import signal
import sys
import time

import rclpy
from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.duration import Duration
from rclpy.exceptions import InvalidTopicNameException
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Trigger

from liegroup_core.pacing import Pacer
from liegroup_sim_ros.messages.codecs import ClockCodec
from liegroup_sim_ros.messages.schemas import SchemaError, definition
from liegroup_sim_ros.numbers import counted
from liegroup_sim_ros.signals import handled

from .player_file import PlayError

try:
    from rclpy.experimental import EventsExecutor as Executor
except ImportError:
    Executor = SingleThreadedExecutor

POLL = 0.01  # s between two checks of services and keys
ACKNOWLEDGED = 2.0  # s to wait for the acknowledgement of the last messages
BACK = 5.0  # s, seek distance of the left cursor key
FASTER = 1.1  # factor on the rate of the up cursor key
LARGEST_RATE = 1e6  # simulated seconds per second
_KEYS = {b" ": "toggle_paused", b"\x1b[A": "faster", b"\x1b[B": "slower", b"\x1b[C": "play_next", b"\x1b[D": "back"}


def play(file, args):
    """Publish a PlayFile; returns the exit code. Raises PlayError, RecordingError."""
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    try:
        player = Player(file, args.rate, args.start, args.loop, args.start_paused, args.clock_rate)
        # The handler sets a flag: an exception may be lost in a callback. SIGINT has a handler too,
        # because a shell starts background processes with SIGINT ignored.
        for number in handled():
            signal.signal(number, player.interrupt)
        with Keys(player):
            code = player.run()
        messages, topics = (counted(player.published, "message"), counted(len(player.topics), "topic"))
        print(f"{file.path}: {messages} of {topics} published")
        return code
    finally:
        rclpy.try_shutdown()


class Player:
    """The node and its position in the file."""

    def __init__(self, file, rate, start, loop, paused, clock_rate):
        self._file, self._loop = file, loop
        self._node = rclpy.create_node("replay")
        self._executor = Executor()
        self._executor.add_node(self._node)
        self._publishers, self.topics = {}, []
        for topic in dict.fromkeys(file.topics.values()):
            self._add_publisher(topic)
        self._clock = None
        if not file.has_clock and clock_rate > 0.0:
            self._clock = self._node.create_publisher(Clock, "/clock", 1)
            self._clock_period = max(1, round(1e9 / clock_rate))
        self.published, self.paused, self._interrupted = 0, paused, False
        self._pacer = Pacer(rate)
        self._seek_to = file.first_ns + round(start * 1e9)
        self._next = None  # (stamp, messages) to publish next
        self._now_ns = self._seek_to
        self._polled = 0.0
        for name in ("pause", "resume", "toggle_paused", "play_next"):
            self._node.create_service(Trigger, f"~/{name}", self._callback(name))
        for name, value, text in (
            ("rate", rate, "simulated seconds per second; 0: as fast as possible"),
            ("position", start, "seek to this time, s after the first message"),
        ):
            self._node.declare_parameter(name, float(value), ParameterDescriptor(description=text, dynamic_typing=True))
        self._node.add_on_set_parameters_callback(self._check)
        self._node.add_post_set_parameters_callback(self._set)

    def _add_publisher(self, topic):
        package, *_, name = topic.type.split("/")
        try:
            # Raises SchemaError unless the type of the recording belongs to an interface package.
            definition(topic.type)
            message = getattr(importlib.import_module(f"{package}.msg"), name)
        except (ImportError, AttributeError, SchemaError):
            print(f"liegroup_sim: {topic.name} is omitted: {topic.type} is not installed", file=sys.stderr)
            return
        profile = QoSProfile(
            depth=topic.depth,
            reliability=ReliabilityPolicy.RELIABLE if topic.reliable else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if topic.latched else DurabilityPolicy.VOLATILE,
        )
        try:
            self._publishers[topic] = self._node.create_publisher(message, topic.name, profile)
        except (InvalidTopicNameException, ValueError, RuntimeError) as error:
            raise PlayError(
                f"{self._file.path}: cannot publish topic {topic.name!r:.60}: {' '.join(str(error).split())[:120]}"
            ) from None
        self.topics.append(topic.name)

    # Commands; they are executed between two messages.

    def _callback(self, name):
        def serve(_, response):
            response.success, response.message = True, self.command(name)
            return response

        return serve

    def command(self, name):
        """Execute the command of a key or a service; returns one line of text."""
        if name == "toggle_paused":
            name = "resume" if self.paused else "pause"
        if name in ("pause", "resume"):
            self.paused = name == "pause"
            self._restart_pacing()
        elif name == "play_next":
            if not self.paused:
                return "not paused: call pause first"
            self._publish_next()
        elif name == "back":
            self.seek((self._now_ns - self._file.first_ns) * 1e-9 - BACK)
        else:
            self._pacer.factor *= FASTER if name == "faster" else 1.0 / FASTER
            self._restart_pacing()
        return (
            f"{'paused' if self.paused else 'playing'} at "
            f"{(self._now_ns - self._file.first_ns) * 1e-9:.9g} s, rate "
            f"{self._pacer.factor:g}"
        )

    def seek(self, position):
        """Continue from a time, s after the first message."""
        self._seek_to = self._file.first_ns + round(max(0.0, position) * 1e9)
        self._now_ns = self._seek_to

    def _check(self, parameters):
        limits = {"rate": LARGEST_RATE, "position": self._file.seconds}
        for parameter in parameters:
            value, most = parameter.value, limits.get(parameter.name)
            if most is None:
                continue
            if (
                isinstance(value, bool)
                or not isinstance(value, (int, float))
                or not (math.isfinite(value) and 0.0 <= value <= most)
            ):
                return SetParametersResult(
                    successful=False, reason=f"{parameter.name} must be a number from 0 to {most:g}"
                )
        return SetParametersResult(successful=True)

    def _set(self, parameters):
        for parameter in parameters:
            if parameter.name == "rate":
                self._pacer.factor = float(parameter.value)
                self._restart_pacing()
            elif parameter.name == "position":
                self.seek(float(parameter.value))

    # Publishing:

    def interrupt(self, *_):
        """Handle a signal: `run` returns soon."""
        self._interrupted = True

    def run(self):
        """Publish until the end of the file; returns the exit code: 0, or 130 after a signal."""
        while self._seek_to is not None:
            start_ns, self._seek_to = self._seek_to, None
            self._messages = self._file.messages(start_ns)
            self._load_next()
            self._restart_pacing()
            self._publish_all()
            if self._seek_to is None and self._loop and self._next is None:
                self._seek_to = self._file.first_ns
            if self._interrupted:
                return 130
        for publisher in self._publishers.values():
            if not self._interrupted:
                publisher.wait_for_all_acked(Duration(seconds=ACKNOWLEDGED))
        return 130 if self._interrupted else 0

    def _publish_all(self):
        """Publish until the end of the file, a seek or a signal."""
        while self._next is not None and self._seek_to is None and not self._interrupted:
            now = time.monotonic()
            if self.paused or now - self._polled > POLL:
                self._polled = now
                self._executor.spin_once(timeout_sec=POLL if self.paused else 0.0)
                self.keys.poll()
                continue
            if self._pacer.wait(self._due_ns() * 1e-9, POLL):
                self._publish_next()

    def _due_ns(self):
        """Stamp of the next output: /clock of this node, or recorded messages."""
        stamp = self._next[0]
        if self._clock is None:
            return stamp
        return min(stamp, (self._now_ns // self._clock_period + 1) * self._clock_period)

    def _publish_next(self):
        if self._next is None:
            return
        due = self._due_ns()
        self._now_ns = due
        if self._clock is not None:
            self._clock.publish(ClockCodec.encode(due))
            if due < self._next[0]:
                return
        for topic, payload in self._next[1]:
            publisher = self._publishers.get(topic)
            if publisher is not None:
                publisher.publish(payload)
                self.published += 1
        self._load_next()

    def _load_next(self):
        self._next = next(self._messages, None)

    def _restart_pacing(self):
        """Start pacing at the current position."""
        if self.paused:
            self._pacer.stop()
        else:
            self._pacer.start(self._now_ns * 1e-9)


class Keys:
    """Keys of the terminal, if stdin is one; a `with` block restores its settings."""

    def __init__(self, player):
        self._player, self._before = player, None
        player.keys = self

    def __enter__(self):
        if sys.stdin is not None and sys.stdin.isatty():
            import termios
            import tty

            self._before = termios.tcgetattr(sys.stdin)
            tty.setcbreak(sys.stdin)
        return self

    def __exit__(self, *_):
        if self._before is not None:
            import termios

            termios.tcsetattr(sys.stdin, termios.TCSADRAIN, self._before)

    def poll(self):
        """Execute the command of a pressed key."""
        if self._before is None or not select.select([sys.stdin], [], [], 0)[0]:
            return
        pressed = os.read(sys.stdin.fileno(), 64)
        if pressed in _KEYS:
            print(self._player.command(_KEYS[pressed]), file=sys.stderr)
