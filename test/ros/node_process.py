# SPDX-License-Identifier: Apache-2.0
"""Simulation nodes in separate processes, and a client node in this process, for the tests.

Everything runs in one ROS domain that no other test run on this machine has.
"""

import fcntl
import json
import math
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import rclpy
from geometry_msgs.msg import WrenchStamped
from rcl_interfaces.srv import SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from std_msgs.msg import String
from std_srvs.srv import Trigger

from liegroup_core.forces.commands import Command

# Two free bodies without gravity: a push has a closed form. `cube` tumbles, `puck` is at rest.
SCENE = """
name: two_bodies
gravity: [0, 0, 0]
bodies:
  - {name: puck, mass: 2.0, inertia: [0.3, 0.35, 0.4]}
  - {name: cube, mass: 1.0, inertia: [0.5, 0.9, 1.2], position: [5, 0, 0],
     angular_velocity: [0.4, 1.1, 0.3], linear_velocity: [0.1, 0.2, 0.3]}
"""

PATIENCE = 30.0  # s; for what takes at most 3 s on an idle machine
COMPILING = 180.0  # s; the first start on a machine compiles
UNDISCOVERED = 10.0  # s


def _free_domain():
    """(ROS domain, lock file) that no other test run on this machine uses."""
    for k in range(100):
        number = 1 + (os.getpid() + k) % 100
        try:
            lock = open(Path(tempfile.gettempdir()) / f"liegroup_sim_ros_domain_{number}", "w")
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return number, lock
        except OSError:  # taken; or the file of another user
            continue
    raise RuntimeError("all ROS domains from 1 to 100 are used by other test runs")


DOMAIN, _LOCK = _free_domain()
ENVIRONMENT = {
    **os.environ,
    "ROS_DOMAIN_ID": str(DOMAIN),
    "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
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
    os.environ.update({key: ENVIRONMENT[key] for key in ("ROS_DOMAIN_ID", "ROS_AUTOMATIC_DISCOVERY_RANGE")})
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

    def listen(self, topic, message_class, qos=200):
        """A list that grows with the messages of a topic."""
        messages = []
        self.node.create_subscription(message_class, topic, messages.append, qos)
        return messages

    def given(self, node, qos=200):
        """Given of the commands of a node as they come."""
        given = Given()
        self.node.create_subscription(String, f"{node}/inputs", given.take, qos)
        return given

    def until(self, condition, seconds=PATIENCE, what="what was waited for"):
        """Spin until condition() is true, and return that; fail after so many seconds."""
        end = time.monotonic() + seconds
        while not (result := condition()):
            for node in NodeProcess.running:
                assert node.process.poll() is None, node.process.communicate()[1]
            assert time.monotonic() < end, f"{what} did not happen within {seconds} s"
            self._executor.spin_once(timeout_sec=0.05)
        return result

    def spin(self, seconds):
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self._executor.spin_once(timeout_sec=0.02)

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
        self.until(client.service_is_ready, COMPILING, f"service {name}")
        futures, sent = [], -math.inf

        def answered():
            nonlocal sent
            if not futures or time.monotonic() > sent + again:
                futures.append(client.call_async(request or service.Request()))
                sent = time.monotonic()
            return next((future for future in futures if future.done()), None)

        return self.until(answered, what=f"answer of {name}").result()

    def set(self, node, **values):
        """Result of setting one parameter, or more."""
        request = SetParameters.Request(
            parameters=[Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
        )
        return self.call(f"{node}/set_parameters", SetParameters, request).results[-1]

    def pusher(self, node, topic="wrench"):
        """push(frame_id, torque, force, stamp_ns) for a node, connected both ways."""
        publisher = self.node.create_publisher(WrenchStamped, f"{node}/{topic}", 100)
        self.until(publisher.get_subscription_count, COMPILING, f"subscription of {node}")

        def push(body, torque=(0.0, 0.0, 0.0), force=(0.0, 0.0, 0.0), stamp_ns=0):
            message = WrenchStamped()
            message.header.frame_id = body
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 10**9)
            for vector, values in ((message.wrench.torque, torque), (message.wrench.force, force)):
                vector.x, vector.y, vector.z = values
            publisher.publish(message)

        return push


def stamp_ns(stamp):
    return stamp.sec * 10**9 + stamp.nanosec


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
