# SPDX-License-Identifier: Apache-2.0
"""The simulation node and its callbacks.

Topics, services and parameters: docs/node.md. The simulation has a thread of its own
(server.py); the main thread runs the callbacks and ends everything in order.
"""
import concurrent.futures
import contextlib
import logging
import os
import sys
import threading
import traceback

import rclpy
from geometry_msgs.msg import WrenchStamped
from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args
from std_srvs.srv import Trigger

from liegroup_core import SceneError, Simulation, load_scene

from . import attachments
from .outputs import Outputs
from .parameters import ParameterError, read_parameters, watch_parameters
from .recorder import Recorder, RecorderError
from .server import CommandError, SimulationServer
from .wrench_input import Refusal, WrenchInput

# What a user can mend.
WRONG_INPUT = (ParameterError, SceneError, RecorderError, ParameterException,
               NameValidationException)

# How long the main thread may not notice that it shall end, s.
ATTENTION = 0.1
EXIT_OK, EXIT_DEFECT, EXIT_WRONG_INPUT = 0, 1, 2


class Interrupted(Exception):
    """A signal to end that came before the simulation was ready."""


class LogHandler(logging.Handler):
    """Passes records of Python's logging to the node's logger, and so to /rosout."""

    def __init__(self, logger):
        super().__init__()
        self._logger = logger

    def emit(self, record):
        """Log one record."""
        text = record.getMessage()
        # One call for each severity: rclpy's logger refuses one call with several of them.
        if record.levelno >= logging.ERROR:
            self._logger.error(text)
        elif record.levelno >= logging.WARNING:
            self._logger.warning(text)
        else:
            self._logger.info(text)


class SimNode(Node):
    """The node and everything that belongs to it. Raises WRONG_INPUT."""

    def __init__(self, signals):
        # This node makes the simulated time: use_sim_time would make it its own listener.
        super().__init__("sim_node", automatically_declare_parameters_from_overrides=True,
                         parameter_overrides=[Parameter("use_sim_time", value=False)])
        self._signals = signals
        self._recorder = None
        for name in ("liegroup_core", __package__):
            logging.getLogger(name).addHandler(LogHandler(self.get_logger()))
        self._values = values = read_parameters(self)
        if not values.scene:
            raise ParameterError("parameter scene: is empty; give a scene file, such as "
                                 "--ros-args -p scene:=heavy_top")
        simulation = _unless_interrupted(lambda: _make_simulation(values), signals)
        bodies = simulation.layout.body_names
        self._wrench_input = WrenchInput(bodies)
        outputs = Outputs(self, bodies, values.world_frame, values.clock_steps > 0, self._figures)
        with _refused_by_rcl():
            self.create_subscription(
                WrenchStamped, "~/wrench", self._take_wrench, QoSProfile(depth=100),
                qos_overriding_options=QoSOverridingOptions.with_default_policies())
        for name in ("pause", "resume", "reset", "step"):
            self.create_service(Trigger, f"~/{name}", self._command(name))
        watch_parameters(self, self._set_parameter)
        self.server = SimulationServer(simulation, outputs, values.sample_steps,
                                       values.clock_steps, values.real_time_factor,
                                       values.start_paused)
        # Everything else is in order: open the file.
        if values.record:
            self._recorder = Recorder(values.record, attachments.at_start(
                simulation, self.get_fully_qualified_name(), values.world_frame,
                values.sample_steps, outputs.topics()))
            outputs.record_to(self._recorder)
        self.server.start()
        self.get_logger().info(
            f"{simulation.scene.name}: {len(bodies)} bodies, {simulation.method}, "
            f"step {simulation.step:g} s, {self.server.state}"
            + (f", recording to {self._recorder.path}" if self._recorder else ""))

    def _command(self, name):
        def serve(_, response):
            arguments = (self._values.step_count,) if name == "step" else ()
            response.success, response.message = self._ask(name, *arguments)
            return response
        return serve

    def _ask(self, name, *arguments):
        """(success, text) of a command, once it is done."""
        future = self.server.call(name, *arguments)
        while not concurrent.futures.wait([future], ATTENTION).done:
            if self._signals.received or not self.server.is_alive():
                return False, "the node is ending"
        try:
            return True, future.result()
        except CommandError as error:
            return False, str(error)
        except concurrent.futures.CancelledError:
            return False, "the node is ending"

    def _set_parameter(self, name, value):
        setattr(self._values, name, value)
        if name == "real_time_factor":
            self._ask("speed", value)

    def _take_wrench(self, message):
        try:
            body, wrench, start_ns = self._wrench_input.read(message, self.server.stamp_ns)
        except Refusal as refusal:
            if refusal.first:
                self.get_logger().warning(str(refusal))
            return
        duration = {"one_step": self._values.step, "timeout": self._values.wrench_timeout,
                    "until_replaced": None}[self._values.wrench_hold]
        self.server.push(body, wrench, start_ns, duration)

    def _figures(self):
        """What the diagnostics say beside the server's figures."""
        refused = self._wrench_input.refused
        recorder = self._recorder
        return {
            "wrenches_accepted": self._wrench_input.accepted,
            "wrenches_refused": sum(refused.values()),
            **{f"wrenches_refused_{reason}": count for reason, count in refused.items()},
            "recorder_queued": recorder.queued if recorder else 0,
            "recorder_written": recorder.written if recorder else 0,
            "recorder_lost": recorder.lost if recorder else 0,
            "recorder_failure": (recorder.failure or "") if recorder else "",
        }

    def close(self):
        """End the simulation, then the recording."""
        self.server.stop()
        if self._recorder is not None:
            self._recorder.add_attachment("pacing.json", *attachments.as_json(
                self.server.pacer.report()))
            self._recorder.close()
            if self._recorder.failure is None:
                self.get_logger().info(f"recorded {self._recorder.written} messages in "
                                       f"{self._recorder.path}")


@contextlib.contextmanager
def _refused_by_rcl():
    """Make a ParameterError of what ROS itself does not accept in the arguments."""
    try:
        yield
    except RuntimeError as error:           # its class is private to rclpy
        raise ParameterError(str(error).partition(", at /")[0]) from None


def _unless_interrupted(function, signals):
    """Result of a function that may compile for half a minute; raises Interrupted.

    It has a thread of its own because an exception out of a signal handler may be lost in it: the
    compiler has callbacks that no exception passes.
    """
    future = concurrent.futures.Future()

    def work():
        try:
            future.set_result(function())
        except Exception as error:
            future.set_exception(error)

    threading.Thread(target=work, daemon=True).start()
    while not concurrent.futures.wait([future], ATTENTION).done:
        if signals.received:
            raise Interrupted
    return future.result()


def _make_simulation(values):
    scene = load_scene(values.scene)
    try:
        return Simulation(scene, values.method, values.step, values.group,
                          values.stabilisation)
    except SceneError:
        raise
    except ValueError as error:
        raise ParameterError(f"parameter method, step or group: {error}") from None


def run(args, signals):
    """Run the node; `args` as sys.argv. Returns the exit code."""
    try:
        with _refused_by_rcl():
            left = remove_ros_args(args)[1:]
            rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
        if left:
            raise ParameterError(f"unknown argument {left[0]!r}; parameters are given as "
                                 "--ros-args -p NAME:=VALUE")
        node = SimNode(signals)
        try:
            return _spin(node, signals)
        finally:
            node.close()
    except Interrupted:
        rclpy.try_shutdown()
        os._exit(EXIT_OK)                   # without waiting for the compiler's thread
    except WRONG_INPUT as error:
        print(f"sim_node: {' '.join(str(error).split())}", file=sys.stderr)
        return EXIT_WRONG_INPUT
    finally:
        rclpy.try_shutdown()


def _spin(node, signals):
    """Run the callbacks until a signal comes or the simulation thread ends; the exit code."""
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    while not signals.received and node.server.is_alive():
        executor.spin_once(timeout_sec=ATTENTION)
    if node.server.failure is not None:
        defect = "".join(traceback.format_exception(node.server.failure))
        node.get_logger().fatal(f"the simulation thread was ended by a defect:\n{defect}")
        return EXIT_DEFECT
    return EXIT_OK
