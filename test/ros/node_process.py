# SPDX-License-Identifier: Apache-2.0
"""Simulation nodes in separate processes, and a client node in this process, for the tests.

Everything runs in one ROS domain that no other test run on this machine has.
"""

import fcntl
import gc
import json
import logging
import math
import os
import re
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import pytest
import rclpy
from geometry_msgs.msg import WrenchStamped
from rcl_interfaces.msg import Log
from rcl_interfaces.srv import SetParameters
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from scene_files import text_of
from std_msgs.msg import String
from std_srvs.srv import Trigger
from waiting import PATIENCE, wait_for

from liegroup_core.forces.commands import Command
from liegroup_sim_ros.commands import push
from liegroup_sim_ros.commands.main import main
from liegroup_sim_ros.node import node as nodes
from liegroup_sim_ros.signals import Signals

# Two free bodies without gravity: a push has a closed form. `cube` tumbles, `puck` is at rest.
SCENE = text_of("two_bodies.yaml")

UNDISCOVERED = 10.0  # s
LATCHED = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def _free_domain():
    """(ROS domain, lock file): no other test run on this machine uses it, and no ROS node is in it."""
    for k in range(100):
        number = 1 + (os.getpid() + k) % 100
        try:
            lock = open(Path(tempfile.gettempdir()) / f"liegroup_sim_ros_domain_{number}", "w")
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            with socket.socket(type=socket.SOCK_DGRAM) as first:
                first.bind(("", 7410 + 250 * number))  # port of a domain's first participant, RTPS 2.5, 9.6.2.4
            return number, lock
        except OSError:  # taken; or the file of another user
            continue
    raise RuntimeError("all ROS domains from 1 to 100 are used by other nodes")


DOMAIN, _LOCK = _free_domain()
# No shared memory, which LOCALHOST always has: a process that is killed may leave it locked, and others wait for it.
DDS = {
    "ROS_DOMAIN_ID": str(DOMAIN),
    "ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT",
    "FASTRTPS_DEFAULT_PROFILES_FILE": str(Path(__file__).with_name("loopback.xml")),
}
ENVIRONMENT = {
    **os.environ,
    **DDS,
    "PYTHONUNBUFFERED": "1",
    # rclpy's warning of an answer that nobody receives: its client is not discovered yet, see `call`.
    "PYTHONWARNINGS": "ignore:failed to send response:RuntimeWarning",
}
NODE = "import sys; from liegroup_sim_ros.node.entry import main; sys.exit(main())"
PUSH = "import sys; from liegroup_sim_ros.commands.main import main; sys.exit(main())"


def python(code, *arguments, env=None, under=()):
    """Python process in its own session, so that signals reach only this process.

    under : command line that the command line of the process is appended to
    """
    return subprocess.Popen(
        [*under, sys.executable, "-c", code, *map(str, arguments)],
        env={**ENVIRONMENT, **(env or {})},
        start_new_session=True,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )


def path_with(folder):
    """{"PYTHONPATH": value} with which a process finds the package in a folder."""
    return {"PYTHONPATH": os.pathsep.join(filter(None, (str(folder), os.environ.get("PYTHONPATH"))))}


def own_context():
    """rclpy Context of this process in the domain of the tests."""
    os.environ.update(DDS)
    context = rclpy.Context()
    context.init()
    return context


class NodeProcess:
    """Simulation node, stopped by `with`. parameters: {name: value}; under: as in `python`."""

    running = []

    def __init__(self, parameters, remap=(), env=None, under=()):
        arguments = [f"{name}:={value}" for name, value in parameters.items()]
        self.process = python(
            NODE,
            "--ros-args",
            *(a for p in arguments for a in ("-p", p)),
            *(a for r in remap for a in ("-r", r)),
            env=env,
            under=under,
        )
        # What it logs is read at its end: a full pipe would stop it.
        fcntl.fcntl(self.process.stderr, fcntl.F_SETPIPE_SZ, 2**20)

    def __enter__(self):
        self.running.append(self)
        return self

    def __exit__(self, *_):
        self.running.remove(self)
        if self.process.poll() is None:
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.communicate()

    def send(self, number):
        os.killpg(self.process.pid, number)

    def wait(self):
        """(exit code, stderr) of a process that is ending."""
        _, errors = self.process.communicate(timeout=PATIENCE)
        return self.process.returncode, errors

    def end(self, number=signal.SIGINT, code=0):
        """Send a signal; returns what the node has logged, after checking its exit code."""
        self.send(number)
        found, errors = self.wait()
        assert found == code and "Traceback" not in errors, errors
        return errors


def output_of(process):
    """stdout of a process that ends with exit code 0."""
    output, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0, errors
    return output


def refusal(capfd, parameters):
    """Line with which a node refuses its parameters, before anything else; it runs in this process."""
    own_context().try_shutdown()  # for the ROS domain of the tests
    capfd.readouterr()
    loggers = [logging.getLogger(name) for name in ("liegroup_core", "liegroup_sim_ros")]
    handlers, interval = [logger.handlers[:] for logger in loggers], sys.getswitchinterval()
    arguments = [part for name, value in parameters.items() for part in ("-p", f"{name}:={value}")]
    try:
        with Signals() as signals:
            assert nodes.run(["sim_node", "--ros-args", *arguments], signals) == nodes.EXIT_WRONG_INPUT
    finally:
        sys.setswitchinterval(interval)
        for logger, before in zip(loggers, handlers):
            logger.handlers[:] = before
        gc.collect()  # two nodes of one name would be a warning
    lines = [line for line in capfd.readouterr().err.splitlines() if not line.startswith("[INFO]")]
    assert len(lines) == 1, lines
    (line,) = lines
    assert line.startswith("sim_node: ")
    return line


class Client:
    """ROS node in this process that subscribes, calls services and publishes wrenches."""

    def __init__(self):
        self._context = own_context()
        self.node = rclpy.create_node("test_client", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._clients = {}

    def close(self):
        self._executor.shutdown()
        self.node.destroy_node()
        self._context.try_shutdown()

    def listen(self, topic, message_class, qos=10_000):
        """A list that grows with the messages of a topic."""
        messages = []
        self.node.create_subscription(message_class, topic, messages.append, qos)
        return messages

    def events(self, node):
        """A list that grows with the events of a node, from its start."""
        return self.listen(f"{node}/events", Log, LATCHED)

    def given(self, node, qos=10_000):
        """Given of the commands of a node as they come."""
        given = Given()
        self.node.create_subscription(String, f"{node}/inputs", given.take, qos)
        return given

    def until(self, condition, what="what was waited for"):
        """Spin until condition() is true, and return that; fail if a node ends."""
        return wait_for(condition, what, self.turn)

    def turn(self):
        """Run the callbacks of what has come, or wait a moment; fail if a node has ended."""
        for node in NodeProcess.running:
            assert node.process.poll() is None, node.process.communicate()[1]
        self._executor.spin_once(timeout_sec=0.05)

    def until_stamp(self, stamp, *topics):
        """Spin until the last message of each list has a stamp in ns, or a later one."""
        self.until(lambda: all(m and stamp_of(m[-1]) >= stamp for m in topics), f"stamp {stamp}")

    def pass_time(self, messages, seconds):
        """Spin until the stamps of a list of messages are later by so many s of simulated time."""
        self.until(lambda: messages)
        self.until_stamp(stamp_of(messages[-1]) + round(seconds * 1e9), messages)

    def call(self, name, service=Trigger, request=None, again=math.inf):
        """Response of a service.

        again : s after which the request is sent again. A process that was killed is still discovered
                for a while, and its service never answers
        """
        if name not in self._clients:
            self._clients[name] = self.node.create_client(service, name)
            # The answer to the first request is lost if the service has not yet discovered the client.
            again = min(again, UNDISCOVERED)
        client = self._clients[name]
        self.until(client.service_is_ready, f"service {name}")
        futures, sent = [], -math.inf

        def answered():
            nonlocal sent
            if not futures or time.monotonic() > sent + again:
                futures.append(client.call_async(request or service.Request()))
                sent = time.monotonic()
            return next((future for future in futures if future.done()), None)

        return self.until(answered, what=f"answer of {name}").result()

    def command(self, name):
        """Stamp in ns at which a node has executed a service such as /node/pause."""
        response = self.call(name)
        assert response.success, response.message
        return stamp_in(response.message)

    def set(self, node, **values):
        """Result of setting one parameter, or more."""
        request = SetParameters.Request(
            parameters=[Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
        )
        return self.call(f"{node}/set_parameters", SetParameters, request).results[-1]

    def publisher(self, topic, message_class):
        """Function that publishes a message and returns when all subscribers have it: services come after it."""
        # Subscribers acknowledge at once only what fills the history.
        publisher = self.node.create_publisher(message_class, topic, 1)
        self.until(publisher.get_subscription_count, f"subscription of {topic}")

        def publish(message):
            publisher.publish(message)
            assert publisher.wait_for_all_acked(Duration(seconds=PATIENCE))

        return publish

    def pusher(self, node, topic="wrench"):
        """push(frame_id, torque, force, stamp_ns) for a node, as `publisher`."""
        publish = self.publisher(f"{node}/{topic}", WrenchStamped)

        def push_one(body, torque=(0.0, 0.0, 0.0), force=(0.0, 0.0, 0.0), stamp_ns=0):
            message = WrenchStamped()
            message.header.frame_id = body
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 10**9)
            for vector, values in ((message.wrench.torque, torque), (message.wrench.force, force)):
                vector.x, vector.y, vector.z = values
            publish(message)

        return push_one


def push_command(*arguments):
    """Run `liegroup_sim push` in this process, with all the time that a slow node needs for its answers."""
    with pytest.MonkeyPatch.context() as patch:
        for name in ("ANSWER", "DISCOVERY"):
            patch.setattr(push, name, PATIENCE)
        return main(["push", *map(str, arguments)])


def stamp_ns(stamp):
    return stamp.sec * 10**9 + stamp.nanosec


def stamp_of(message):
    """Stamp in ns of any message of a node."""
    if hasattr(message, "markers"):
        message = message.markers[0]
    found = message.header.stamp if hasattr(message, "header") else getattr(message, "clock", None) or message.stamp
    return stamp_ns(found)


def stamp_in(text):
    """Stamp in ns in the answer to a command, such as "paused at 0.19 s"."""
    return round(float(re.search(r" (?:at|from) ([0-9.e-]+) s", text)[1]) * 1e9)


def on_grid(stamps, period):
    """Whether stamps increase by multiples of a period in ns, and some by one: others may be lost on their way."""
    steps = [after - before for before, after in zip(stamps, stamps[1:])]
    return min(steps) == period and not any(step % period for step in steps)


def figures_of(diagnostics):
    """{name: text} of a DiagnosticArray."""
    return {pair.key: pair.value for pair in diagnostics.status[0].values}


class Order(NamedTuple):
    """A command of ~/inputs with stamps in ns; end: None if it acts until it is replaced."""

    kind: str
    name: str
    values: tuple
    start: int
    end: int | None
    source: str
    axes: str
    point: tuple | None


class Given(list):
    """The Orders of a node as they come; `present`: those of the last message with all that act or wait."""

    present = None

    def take(self, message):
        entries = json.loads(message.data)
        base, commands = entries["base_ns"], map(Command.from_json, entries["commands"])
        orders = [
            Order(c.kind, c.name, c.values, base + c.start_ns, c.end_ns and base + c.end_ns, c.source, c.axes, c.point)
            for c in commands
        ]
        if entries["all"]:
            self.present = orders
        else:
            self.extend(orders)


def values(message):
    """(body, (torque, force), stamp in ns) of a WrenchStamped."""
    torque, force = message.wrench.torque, message.wrench.force
    return (
        message.header.frame_id,
        (torque.x, torque.y, torque.z, force.x, force.y, force.z),
        stamp_ns(message.header.stamp),
    )
