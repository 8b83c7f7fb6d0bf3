# SPDX-License-Identifier: Apache-2.0
"""The simulation node and its services.

Topics, services and parameters: docs/reference/node.md. The simulation runs in its own thread
(simulation_thread.py). The main thread runs the callbacks and shuts everything down in order.
"""

import contextlib
import logging
import os
import subprocess
import sys
import traceback
from importlib.util import find_spec

import rclpy
from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from rclpy.utilities import remove_ros_args
from std_srvs.srv import Trigger

from liegroup_core import SceneError
from liegroup_sim_ros.recording.write import RecorderError

from . import own_services, standard_services
from .answers import AnsweringNode
from .parameters import RATES, NodeParameterError, answering, read_parameters, watch_parameters
from .scene_run import ATTENTION, Interrupted, SceneRun, begin_simulation, make_simulation, served_folders
from .standard_codes import FAILED, Refused

try:
    # A callback takes a fifth of the CPU time that it takes with rclpy's default executor.
    from rclpy.experimental import EventsExecutor as Executor
except ImportError:
    Executor = SingleThreadedExecutor

# Errors that a user can correct.
WRONG_INPUT = (NodeParameterError, SceneError, RecorderError, ParameterException, NameValidationException)

# Longest time that a thread waits for the interpreter lock, s. Python's default of 5 ms would delay
# a tick whenever a callback runs.
SWITCH = 1e-4
TYPES_PERIOD = 2.0  # s between two looks at the types of topics in other nodes
EXIT_OK, EXIT_DEFECT, EXIT_WRONG_INPUT = 0, 1, 2
EXIT_UNRECORDED = 1  # the recording failed or was removed


class LogHandler(logging.Handler):
    """Handler that passes records of Python's logging to the node's logger and to /rosout."""

    def __init__(self, logger):
        super().__init__()
        self._logger = logger

    def emit(self, record):
        """Log one record."""
        text = record.getMessage()
        # One call per severity: rclpy's logger refuses several severities from one line of code.
        if record.levelno >= logging.ERROR:
            self._logger.error(text)
        elif record.levelno >= logging.WARNING:
            self._logger.warning(text)
        else:
            self._logger.info(text)


class SimNode(AnsweringNode):
    """Simulation node: parameters, services, and the running scene. Raises WRONG_INPUT."""

    def __init__(self, signals):
        self.signals = signals
        # This node publishes the simulated time: with use_sim_time it would subscribe to itself.
        try:
            super().__init__(
                "sim_node",
                automatically_declare_parameters_from_overrides=True,
                parameter_overrides=[Parameter("use_sim_time", value=False)],
            )
        except ValueError as error:  # such as `step: []` in a file
            empty = [
                name for name, parameter in getattr(self, "_parameter_overrides", {}).items() if parameter.value is None
            ]
            raise NodeParameterError(f"parameter {empty[0]}: has no value" if empty else str(error)) from None
        for name in ("liegroup_core", "liegroup_sim_ros"):
            logging.getLogger(name).addHandler(LogHandler(self.get_logger()))
        self.is_recorded = True  # False once a recording is incomplete
        self._values = values = read_parameters(self)
        self._loading = False
        simulation, start_ns = make_simulation(values, signals)
        self.folders = served_folders(values, simulation.scene)
        with _refused_by_rcl():
            self.scene_run = SceneRun(self, values, simulation, paused=values.start_paused, start_ns=start_ns)
        for name, parameter in (
            ("pause", ""),
            ("resume", ""),
            ("reset", ""),
            ("save_snapshot", "snapshot"),
            ("restore_snapshot", "snapshot"),
        ):
            self.create_service(Trigger, f"~/{name}", self._command(name, parameter))
        self.create_service(Trigger, "~/step", lambda *_: standard_services.take_steps(self.ask, values.step_count))
        self.create_service(Trigger, "~/reload", self._serve_reload)
        own_services.offer(self)
        standard_services.offer(self, values.world_frame)
        watch_parameters(self, self._prepare_parameter, self._set_parameter)
        self._other_types = set()  # topics that another node has with another type, as far as that was logged
        self.create_timer(TYPES_PERIOD, self._tell_other_types)
        self.scene_run.start()

    def _command(self, name, parameter):
        """Callback of a service that executes a command, with the value of `parameter` unless that is ""."""
        command = name.removesuffix("_snapshot")

        def serve(*_):
            return self.ask(command, *([getattr(self._values, parameter)] if parameter else []))

        return serve

    async def _serve_reload(self, *_):
        return (await self.load(lambda: None))[1]

    async def load(self, make_scene, paused=None):
        """Replace the running scene; returns (Scene, state of its run). If Refused, the previous one continues.

        make_scene : function that returns a Scene, or None for the parameter's one; called in another thread
        paused     : whether it starts paused; None: as the previous one
        """
        if self._loading:
            raise Refused(FAILED, "another scene is being loaded: try again later")
        self._loading = True
        try:
            return await self._replace(make_scene, paused)
        except WRONG_INPUT as error:
            text = " ".join(str(error).split())
            raise Refused(FAILED, f"the previous scene continues: {text}") from None
        finally:
            self._loading = False

    async def _replace(self, make_scene, paused):
        simulation = await self.wait(begin_simulation(self._values, self.folders, make_scene))
        before, was_running = self.scene_run, await self.ask("hold")
        try:
            after = SceneRun(
                self, self._values, simulation, before, paused=not was_running if paused is None else paused
            )
        except WRONG_INPUT:
            if was_running:
                await self.ask("resume")
            raise
        self.is_recorded &= before.close()
        self.scene_run = after
        after.start()
        server = after.server
        return (simulation.scene, f"{simulation.scene.name} at {server.stamp_ns * 1e-9:.9g} s, {server.state}")

    def set_scene(self, path):
        """Set the parameter `scene`: ~/reload loads this path from now on."""
        self.set_parameters([Parameter("scene", value=path)])

    def _tell_other_types(self):
        """Warn once of each topic of this node that another node has with another type: the two never meet."""
        here = None
        for topic, types in self.get_topic_names_and_types():
            if len(types) > 1 and topic not in self._other_types:
                here = here or {each.topic_name: each.msg_type for each in (*self.publishers, *self.subscriptions)}
                if topic in here:
                    self._other_types.add(topic)
                    own = "{0}/msg/{1}".format(here[topic].__module__.partition(".")[0], here[topic].__name__)
                    others = ", ".join(sorted(set(types) - {own}))
                    self.get_logger().warning(f"{topic}: another node has it as {others}, this one as {own}")

    def _prepare_parameter(self, name, value):
        run = self.scene_run
        if name == "publish_rate" and run.recorder is not None and not self._values.record_rate:
            raise NodeParameterError("parameter publish_rate: cannot change while the node records: start with it")
        if name == "accuracy" and run.simulation.promise is None:
            raise NodeParameterError("parameter accuracy: this run has a method, not an accuracy")
        if name in RATES and value:
            run.outputs.prepare(name)
        if name == "lockstep":
            run.check_lockstep(answering(value))

    def _set_parameter(self, name, value):
        setattr(self._values, name, value)
        call = self.scene_run.server.call
        if name in RATES:
            self._values.rates[name] = value
            call("plan_outputs")
        elif name == "lockstep":
            call("lockstep", answering(value))
        elif name == "lockstep_timeout":
            self.scene_run.server.lockstep.timeout = value
        elif name == "accuracy":
            call("accuracy", value)
        elif name == "real_time_factor":
            call("speed", value)
        elif name == "command_jump":
            call("watch", value > 0.0)
        elif name == "arrow_scale":
            self.scene_run.outputs.set_arrow_scale(value)


@contextlib.contextmanager
def _refused_by_rcl():
    """Convert errors of ROS about its arguments to NodeParameterError."""
    try:
        yield
    except RuntimeError as error:  # a subclass that is private to rclpy
        text = str(error).partition(", at /")[0]
        if type(error).__name__ == "UnknownROSArgsError":  # its text only lists the arguments
            text = f"unknown ROS arguments: {text}"
        raise NodeParameterError(text) from None


def run(args, signals):
    """Run the node; `args` as sys.argv. Returns the exit code."""
    try:
        with _refused_by_rcl():
            left = remove_ros_args(args)[1:]
            rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
        if left:
            raise NodeParameterError(f"unknown argument {left[0]!r}; give parameters as --ros-args -p NAME:=VALUE")
        sys.setswitchinterval(SWITCH)
        node = SimNode(signals)
        page = _page(node)
        try:
            code = _spin(node, signals)
        finally:
            if page is not None:
                page.terminate()
            node.is_recorded &= node.scene_run.close()
        return code if node.is_recorded else code or EXIT_UNRECORDED
    except Interrupted:
        rclpy.try_shutdown()
        os._exit(EXIT_OK)  # without waiting for the compiler's thread
    except WRONG_INPUT as error:
        print(f"sim_node: {' '.join(str(error).split())}", file=sys.stderr)
        return EXIT_WRONG_INPUT
    finally:
        rclpy.try_shutdown()


def _page(node):
    """Process of the page for the browser, if the parameter `view` asks for it. Raises NodeParameterError."""
    if not node.get_parameter("view").value:
        return None
    if find_spec("viser") is None:
        raise NodeParameterError("parameter view: needs the package viser: pip install 'liegroup_sim_ros[view]'")
    command = [sys.executable, "-P", "-m", "liegroup_sim_ros.commands.main", "view"]
    return subprocess.Popen([*command, "--node", node.get_fully_qualified_name()], stdin=subprocess.DEVNULL)


def _spin(node, signals):
    """Run the callbacks until a signal arrives or the simulation thread ends; returns the exit code."""
    executor = Executor()
    executor.add_node(node)
    while not signals.received and node.scene_run.server.is_alive():
        # All callbacks of this time in one call: `spin_once` adds 10 us to each.
        executor.spin_until_future_complete(Future(), timeout_sec=ATTENTION)
    node.end_waits()
    failure = node.scene_run.server.failure
    if failure is not None:
        defect = "".join(traceback.format_exception(failure))
        node.get_logger().fatal(f"the simulation thread ended with an unexpected error:\n{defect}")
        return EXIT_DEFECT
    return EXIT_OK
