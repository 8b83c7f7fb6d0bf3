# SPDX-License-Identifier: Apache-2.0
"""Run of one scene: simulation thread, topics and recording. ~/reload replaces it."""

import gc
import logging
import os
from concurrent.futures import wait

from liegroup_core import SceneError, Simulation, load_scene
from liegroup_core.robots.access import served_from, tree_of
from liegroup_core.scene.load import example_scenes
from liegroup_sim_ros.numbers import counted
from liegroup_sim_ros.playback.branch import Branches
from liegroup_sim_ros.playback.rerun import ReplayError
from liegroup_sim_ros.recording import RecordingError, attachments
from liegroup_sim_ros.recording.checkpoints import Checkpoints
from liegroup_sim_ros.recording.read import read_recording
from liegroup_sim_ros.recording.write import Recorder
from liegroup_sim_ros.serving import lockstep
from liegroup_sim_ros.serving.outputs import Outputs
from liegroup_sim_ros.serving.simulation_thread import SimulationServer

from . import standard_services
from .answers import begin
from .joint_command_topics import JointCommandTopics
from .machine_topics import MachineTopics
from .parameters import AUTO, NodeParameterError, answering, bodies_of, fitting_step
from .qos import QosOverrides
from .streams import NodeStreams
from .wrench_topics import WrenchTopics

log = logging.getLogger("liegroup_core")

# With an accuracy, a new file starts only at multiples of these steps: there the two runs of the estimate
# (liegroup_core.running_error) are at the same time, so acting wrenches can be recorded again for both.
PART_STEPS = 12
# Longest delay until the main thread checks for signals, s.
ATTENTION = 0.1


class Interrupted(Exception):
    """SIGINT or SIGTERM arrived before the simulation was ready."""


class SceneRun:
    """Simulation with its topics and its recording. Raises NodeParameterError, RecorderError.

    node       : rclpy Node
    values     : parameters
    simulation : liegroup_core.Simulation
    before     : paused SceneRun that this one replaces; stamps and recording continue, the latter
                 in a new file. None: the first one
    paused     : start paused
    start_ns   : stamp of its state, if it is the first one
    """

    def __init__(self, node, values, simulation, before=None, paused=False, start_ns=0):
        self._node = node
        self.simulation = simulation
        self.recorder = self.commands = self.machine = None
        layout = simulation.layout
        self._values, self._more = values, {}
        origin, path, part, bag = "", values.record, 1, values.record_metadata or None
        if before is not None:
            start_ns = before.server.stamp_ns + max(1, round(simulation.step * 1e9))
            origin = ", loaded"
            if before.recorder is not None:
                origin += f"; the previous recording is {before.recorder.path.name}"
                part, bag = before.recorder.part + 1, before.recorder.bag
                path = before.recorder.part_path(part)
                self._more = {"part": part, "previous": before.recorder.path.name}
        frames = [values.frame_prefix + body for body in layout.body_names]
        if not values.world_frame or f"{values.world_frame}/".startswith(tuple(f"{frame}/" for frame in frames)):
            raise NodeParameterError(
                f"parameter world_frame: must differ from all body names, got {values.world_frame!r}"
            )
        if values.frame_prefix.startswith("/"):
            raise NodeParameterError(
                "parameter frame_prefix: must not start with a slash (tf2 frames have none), "
                f"got {values.frame_prefix!r}"
            )
        qos = QosOverrides(values.qos)
        own = bodies_of(values.body_topics, layout.body_names)
        self.outputs = Outputs(NodeStreams(node, qos), layout, own, values, self._figures)
        if path and (values.record_split_size or values.record_split_duration):
            self.outputs.at_steps.append(self._divide_if_due)
        self._is_failure_told = False
        if path:
            self.outputs.at_steps.append(self._add_checkpoint)
            self.outputs.attending.append(self._tell_failure)
        rates = answering(values.lockstep)
        start_ns = lockstep.aligned(rates.values(), start_ns, simulation.time_ns)
        self.server = SimulationServer(
            simulation,
            self.outputs,
            values.real_time_factor,
            paused,
            start_ns - simulation.time_ns,
            origin,
            values.trajectory_period,
            values.motion_time,
            values.command_jump > 0.0,
            rates,
            values.lockstep_timeout,
        )
        self.wrenches = WrenchTopics(node, layout, own, values, simulation.step, self.server, qos)
        try:
            self.commands = JointCommandTopics(node, layout, values, self.server, qos)
            if values.machine:
                self.machine = MachineTopics(node, simulation.scene, layout, values, self.outputs, self.server)
            self.check_lockstep(rates)
        except NodeParameterError:
            self._close_topics()
            raise
        if before is None:  # a reloaded scene may lack the bodies of these parameters
            qos.check()
        # Last, so that a failure of an earlier step leaves no file.
        if path:
            try:
                self.recorder = Recorder(
                    path,
                    self._attachments(start_ns, "paused" if paused else "running"),
                    flush_interval=values.record_flush_interval,
                    max_size=values.record_split_size,
                    max_duration=round(values.record_split_duration * 1e9),
                    part=part,
                    bag=bag,
                )
                self._checkpoints = Checkpoints(self.recorder, simulation)
                self.outputs.record_to(self.recorder)
            except Exception:
                self._close_topics()
                raise

    def check_lockstep(self, rates):
        """Create missing topics that must answer. Raises NodeParameterError for those that cannot."""
        step, offers = self.simulation.step, (self.wrenches, self.commands)
        for topic in rates:
            if not any(topics.offer(topic) for topics in offers):
                known = ", ".join(name for topics in offers for name in topics.stamped)
                raise NodeParameterError(
                    f"parameter lockstep: ~/{topic} is no input with time stamps: choose from {known}; "
                    "joint_commands and wrench also as joint_commands/NAME"
                )
        if topic := lockstep.unfitting(rates, step):
            raise NodeParameterError(
                f"parameter lockstep: the period of {topic}, {1.0 / rates[topic]:.9g} s, must be a multiple of the "
                f"step, {step:.9g} s: choose another rate or step"
            )
        start_ns = self.server.stamp_ns - self.simulation.time_ns
        if lockstep.aligned(rates.values(), start_ns, 0) != start_ns:
            raise NodeParameterError("parameter lockstep: a state was set since the start: start the node with it")

    def start(self):
        """Start the simulation thread and log the configuration."""
        # Exclude existing objects from later garbage collections: one would delay a step by 0.1 s, and by
        # 1 s after kernels were compiled.
        gc.unfreeze()
        gc.collect()
        gc.freeze()
        self.server.start()
        if self.machine is not None:
            self.machine.machine.start()
        simulation = self.simulation
        self._node.get_logger().info(
            f"{simulation.scene.name}: {counted(len(simulation.layout.body_names), 'body')}, "
            + (
                f"accuracy {simulation.promise['accuracy']:g} in {simulation.promise['horizon']:g} s"
                if simulation.promise
                else f"{simulation.method}, step {simulation.step:g} s"
            )
            + f", {self.server.state}"
            + (f", recording to {self.recorder.path}" if self.recorder else "")
        )

    def _attachments(self, stamp_ns, state):
        """Attachments that make a file self-contained, with the current state."""
        values = self._values
        return attachments.at_start(
            self.simulation,
            self._node.get_fully_qualified_name(),
            values.world_frame,
            attachments.steps_per_sample(values.record_rate or values.publish_rate, self.simulation.step),
            self.outputs.topics(),
            stamp_ns,
            state=state,
            parameters={name: value for name, value in vars(values).items() if name not in ("rates", "qos")},
            frame_prefix=values.frame_prefix,
            **self._more,
        )

    def _divide_if_due(self, stamp_ns):
        """Continue the recording in a new file if one is due; runs in the simulation thread."""
        recorder, simulation = self.recorder, self.simulation
        if recorder is not None and recorder.is_part_due(stamp_ns):
            if simulation.promise and simulation.steps % PART_STEPS:
                return
            self._attach_pacing()
            self._more = {"part": recorder.part + 1, "previous": recorder.path.name, "sequences": recorder.sequences}
            recorder.divide(stamp_ns, self._attachments(stamp_ns, self.server.state))
            self.outputs.record_acting(stamp_ns, simulation.sample())

    def _add_checkpoint(self, stamp_ns):
        self._checkpoints.add_if_due(stamp_ns)

    def _tell_failure(self, stamp_ns):
        """Publish that the recording has failed, once; the recorder has logged it."""
        if self.recorder is not None and self.recorder.failure and not self._is_failure_told:
            self._is_failure_told = True
            self.outputs.event(stamp_ns, "unrecorded", self.recorder.failure, True, is_logged=True)

    def _attach_pacing(self):
        self.recorder.add_attachment("pacing.json", *attachments.as_json(self.server.pacer.report()))

    def _figures(self):
        """Figures of the diagnostics besides those of the simulation thread."""
        recorder = self.recorder
        return {
            **self.wrenches.figures(),
            **self.commands.figures(),
            **(self.machine.machine.figures if self.machine else {}),
            "recorder_queued": recorder.queued if recorder else 0,
            "recorder_written": recorder.written if recorder else 0,
            "recorder_lost": recorder.lost if recorder else 0,
            "recorder_failure": (recorder.failure or "") if recorder else "",
        }

    def close(self):
        """Close the simulation, the recording and the topics; returns whether the recording is complete."""
        self.server.stop()
        if self.recorder is not None:
            self.outputs.complete(self.server.last_stamp_ns, self.simulation.sample())
            self._attach_pacing()
            self.recorder.close()
            if self.recorder.failure is None:
                self._node.get_logger().info(
                    f"recorded {counted(self.recorder.written, 'message')} in {self.recorder.path}"
                )
            self._tell_failure(self.server.stamp_ns)
        self._close_topics(self.server.stamp_ns)
        return self.recorder is None or self.recorder.failure is None

    def _close_topics(self, stamp_ns=None):
        self.wrenches.close()
        if self.commands is not None:
            self.commands.close()
        if self.machine is not None:
            self.machine.close()
        self.outputs.close(stamp_ns)


def make_simulation(values, signals):
    """Create the simulation that the parameters describe; returns it, and the stamp of its state.

    signals : Signals
    raises SceneError, NodeParameterError; Interrupted as soon as `signals.received` is true

    Compiling may take half a minute. It runs in its own thread, because an exception from a signal
    handler can get lost in the compiler's callbacks.
    """
    if not (values.scene or values.continue_from):
        raise NodeParameterError(
            "parameter scene is empty; give a scene, such as --ros-args -p scene:=heavy_top. In a parameter file it "
            "stands under ros__parameters, and that under /** or the name of the node"
        )
    future = begin(_make, values, None)
    while not wait([future], ATTENTION).done:
        if signals.received:
            raise Interrupted
    return future.result()


def begin_simulation(values, folders, make_scene):
    """Create a simulation in a thread; returns its Future.

    folders    : from which files may be read, with subfolders
    make_scene : function that returns a Scene, or None for the scene of the parameter
    """

    def work():
        with served_from(folders):
            return _make(values, make_scene())[0]

    return begin(work)


def served_folders(values, scene):
    """Folders from which requests may load files, with their subfolders.

    Those of the parameter world_folders, the tree of the scene that the node was started with, and the
    example scenes.
    """
    folders = [folder for folder in values.world_folders.split(os.pathsep) if folder]
    robot = scene.robot.file.removesuffix(" (expanded)") if scene.robot else ""
    for file in (scene.source, robot):
        if os.path.isfile(file):
            folders += [tree_of(file), tree_of(os.path.realpath(file))]
    examples = {path.parent for path in example_scenes().values()}
    return list(dict.fromkeys([*map(str, folders), *map(str, sorted(examples))]))


def _make(values, scene):
    start_ns = 0
    if values.continue_from and not (scene or values.scene):
        simulation, start_ns = _continued(values)
    else:
        simulation = _from_scene(values, scene)
    if standard_services.is_installed():
        # Compile now: at the first request it would delay steps.
        simulation.layout.reactions.warm_up()
    return simulation, start_ns


def _continued(values):
    """(simulation, stamp) of the recording to continue."""
    try:
        recording = read_recording(values.continue_from)
        # An accuracy always has an estimate; with a method the parameter decides.
        other = {} if recording.settings.get("promise") else {"estimate": values.estimate}
        branches = Branches(recording, quiet=False, **other)
        simulation, stamp_ns = branches.at(values.continue_at, values.continue_inputs)
    except (RecordingError, ReplayError) as error:
        raise NodeParameterError(f"parameter continue_from: {error}") from None
    return simulation, stamp_ns


def _from_scene(values, scene):
    scene = scene or load_scene(values.scene, allow_files=os.sep == values.world_folders)
    for note in scene.differences:
        log.warning("%s: %s", scene.name, note)
    if values.method == AUTO:
        chosen = {"accuracy": values.accuracy, "horizon": values.accuracy_horizon}
    else:
        chosen = {"method": values.method, "estimate": values.estimate}
    stabilisation = None if values.stabilisation == AUTO else values.stabilisation
    step = values.step or fitting_step(values)  # a method always has one
    try:
        return Simulation(scene, step=step, group=values.group, stabilisation=stabilisation, **chosen)
    except SceneError:
        raise
    except ValueError as error:
        raise NodeParameterError(f"parameter accuracy, method, step or group: {error}") from None
