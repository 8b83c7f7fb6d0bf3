# SPDX-License-Identifier: Apache-2.0
"""Source of a page: a running node, by its topics and services alone, on this machine or another one."""

import logging
import math
import threading
import time

import numpy as np
from scipy.spatial.transform import Rotation

from liegroup_core import Simulation
from liegroup_core.errors import SceneError
from liegroup_core.forces.commands import LOADS, MOTION, Command
from liegroup_core.forces.instants import StepGrid
from liegroup_core.inputs import Inputs
from liegroup_core.joints.motion import FROM_SCENE
from liegroup_core.layout import make_layout
from liegroup_core.scene.load import scene_from_text
from liegroup_sim_ros.messages import arrays, estimates, inputs, joint_modes, law_states, machine, topics
from liegroup_sim_ros.messages.codecs import Fields, LogCodec, PoseStampedCodec, TwistStampedCodec
from liegroup_sim_ros.messages.commands import JointStateDecoder, decode_motions, joint_labels
from liegroup_sim_ros.messages.diagnostics import decode as decode_figures
from liegroup_sim_ros.messages.machine import AHEAD, RATIOS

from .local import Local
from .server import ViewError
from .source import Source, Status, ViewFrame, allowed

log = logging.getLogger("liegroup_core")

DISCOVERY, ANSWER = 10.0, 3.0  # s
PULL_NAME = "view"  # of the pulls of the hand
GRID = 1e-6  # s, of the times at which wrenches act; only drawing depends on it
STATES = {
    "start": "running",
    "pause": "paused",
    "resume": "running",
    "fault": "faulted",
    "stop": "ended",
}  # after an event
TRIGGERS = {"pause": "pause", "resume": "resume", "step": "step", "reset": "reset"}


class Remote(Source):
    """The node with a name, such as /sim_node. Raises ViewError if it is not found or ROS is missing."""

    takes = frozenset(
        ("pause", "resume", "step", "reset", "speed", "accuracy", "place", "save", "restore", "push")
        + ("effort", "servo", "driven")
    )

    def __init__(self, name):
        try:
            import rclpy
            from rclpy.executors import SingleThreadedExecutor
        except ImportError as error:
            raise ViewError(f"ROS 2 is needed to view a node: {error}") from None

        self._rclpy, self._name = rclpy, "/" + name.strip("/")
        self._context = rclpy.Context()
        self._context.init(args=[])
        self._node = rclpy.create_node("liegroup_sim_view", context=self._context, use_global_arguments=False)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._spinning = threading.Thread(target=self._spin, name="view", daemon=True)
        self._scene_text, self._found = None, threading.Event()
        self._subscribe(topics.SCENE, self._take_scene)
        self._ending = self._is_told = False
        self._spinning.start()
        try:
            if not self._found.wait(DISCOVERY):
                raise ViewError(
                    f"no simulation node {self._name} found within {DISCOVERY:g} s: check that it is running with the "
                    "same ROS_DOMAIN_ID, and give its name with --node"
                )
            try:
                scene = scene_from_text(self._scene_text, source=f"{self._name}/scene")
            except SceneError as error:
                raise ViewError(f"the scene of {self._name} is not one of this version: {error}") from None
            super().__init__(make_layout(scene), f"{scene.name}, {self._name}")
            self._listen()
        except BaseException:
            self.close()
            raise

    def _spin(self):
        while not self._ending and self._context.ok():
            try:
                self._executor.spin_once(timeout_sec=0.1)
            except Exception as error:  # a message of another version ends nothing
                if not self._ending and not self._is_told:
                    self._is_told = True
                    log.error("view: a message could not be read: %s: %s", type(error).__name__, error)

    def _subscribe(self, topic, take):
        """Subscribe to the serialized messages of a Topic."""
        import importlib

        from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

        package, _, name = topic.type.split("/")
        profile = QoSProfile(depth=max(topic.depth, 10), reliability=ReliabilityPolicy.BEST_EFFORT)
        if topic.qos == "transient_local":
            profile = QoSProfile(depth=topic.depth, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        kind = getattr(importlib.import_module(f"{package}.msg"), name)
        self._node.create_subscription(kind, topic.resolved(self._name), take, profile, raw=True)

    def _take_scene(self, payload):
        self._scene_text = Fields(topics.SCENE.type, payload).text()
        self._found.set()

    def _listen(self):
        """Subscribe to everything that is shown."""
        layout = self.layout
        names = layout.body_names
        self._state, self._figures = Status("running", None, None, ""), {}
        self._newest, self._arrived, self._errors, self._laws = None, 0.0, None, None
        self._changed_ns = -1  # stamp of the last event that changed the state
        self._least, self._late = math.inf, 0.0  # s: smallest and present delay of a frame
        self._pose = np.tile(np.array([1.0, 0, 0, 0, 1.0, 0, 0, 0, 1.0, 0, 0, 0]), (len(names), 1))
        self._twist, self._stamps = np.zeros((len(names), 6)), [[-1, -1] for _ in names]
        self._targets = layout.targets.copy()
        self._grid = StepGrid(GRID)
        self._inputs = Inputs(layout, self._grid, layout.targets.copy(), layout.motions_at(0.0))
        self._commands, self._base_ns = {}, 0
        self._services, self._parameters, self._publishers = {}, None, {}
        known = dict(self._node.get_topic_names_and_types())
        if topics.POSES.resolved(self._name) in known:
            self._subscribe(topics.POSES, self._take_poses)
            self._subscribe(topics.TWISTS, self._take_twists)
        else:
            for i, body in enumerate(names):
                self._subscribe(topics.pose(body), lambda payload, i=i: self._take_pose(payload, i))
                self._subscribe(topics.twist(body), lambda payload, i=i: self._take_twist(payload, i))
        self._modes, self._motions = layout.no_modes, np.tile(FROM_SCENE, (len(layout.motions), 1))
        if layout.servos:
            self._decode_targets = JointStateDecoder(len(layout.servos)).decode
            self._subscribe(topics.SERVO_TARGETS, self._take_targets)
        if layout.motions:
            self._subscribe(topics.MOTIONS, self._take_motions)
        if layout.switches:
            self._subscribe(topics.JOINT_MODES, self._take_modes)
        if layout.states:
            self._subscribe(topics.LAWS, self._take_laws)
        self._ratios, self.compares = (), topics.MACHINE.resolved(self._name) in known
        if self.compares:
            self._subscribe(topics.MACHINE, self._take_machine)
        self._subscribe(topics.ERRORS, self._take_errors)
        self._subscribe(topics.INPUTS, self._take_inputs)
        self._subscribe(topics.EVENTS, self._take_event)
        self._subscribe(topics.STATE, self._take_state)

    def _take_pose(self, payload, i):
        self._stamps[i][0], _, values = PoseStampedCodec.decode_one(payload)
        self._set_pose(i, values)
        self._complete()

    def _take_twist(self, payload, i):
        self._stamps[i][1], _, self._twist[i] = TwistStampedCodec.decode_one(payload)
        self._complete()

    def _set_pose(self, i, values):
        self._pose[i, :9] = Rotation.from_quat(values[3:]).as_matrix().ravel()
        self._pose[i, 9:] = values[:3]

    def _take_poses(self, payload):
        fields = Fields(arrays.TYPE, payload)
        stamp = fields.stamp_ns()
        frame = fields.text()
        rows = arrays.decode_poses(np.frombuffer(payload, np.uint8)[None], self.layout.body_names, frame)
        for i, values in enumerate(rows.reshape(-1, 7)):
            self._set_pose(i, values)
        self._stamps = [[stamp, stamp] for _ in self._stamps]

    def _take_twists(self, payload):
        rows = arrays.decode_twists(np.frombuffer(payload, np.uint8)[None], self.layout.body_names, "")
        self._twist[:] = rows.reshape(-1, 6)
        self._complete()

    def _complete(self):
        """Keep a ViewFrame if all bodies have the same stamp."""
        stamp = self._stamps[0][0]
        if any(one != stamp or other != stamp for one, other in self._stamps):
            return
        seconds = (stamp - self._base_ns) * 1e-9
        near = None if self._newest is None else self._newest.sample.angles.copy()
        if near is not None and self._laws is not None:
            near[-len(self._laws) :] = self._laws
        sample = self.layout.sample(self._pose, self._twist, seconds, near=near)
        sample.errors, sample.acting = self._errors, self._acting(stamp)
        sample.joint_efforts = dict(self._inputs.schedule.efforts)
        sample.switching = self._modes
        accuracy, bound = self._figures.get("accuracy"), None
        if accuracy is not None:
            bound = allowed(self.layout, accuracy, self._figures["accuracy_horizon_s"], seconds)
        self._newest, self._arrived = ViewFrame(seconds, sample, bound, self._ratios), time.monotonic()
        late = self._arrived - stamp * 1e-9
        self._least = min(self._least, late)
        self._late = late - self._least

    def _acting(self, stamp):
        """Acting at a stamp."""
        time_ns = stamp - self._base_ns
        acting = [
            command._replace(start_ns=0, end_ns=None)
            for command in list(self._commands.values())
            if command.start_ns <= time_ns and (command.end_ns is None or time_ns < command.end_ns)
        ]
        rows = zip(self.layout.motions, self._motions.tolist())
        acting += [Command(MOTION, joint, tuple(row), 0) for joint, row in rows if math.isfinite(row[0])]
        self._inputs.show(tuple(acting), self._grid.marked(max(0, time_ns)))
        return self._inputs.acting.copy()._replace(targets=self._targets)

    def _take_targets(self, payload):
        _, _, position, velocity, _ = self._decode_targets(payload)
        self._targets = np.column_stack([position, velocity])

    def _take_motions(self, payload):
        self._motions = np.reshape(decode_motions(payload)[1], self._motions.shape)

    def _take_modes(self, payload):
        values = joint_modes.decode(payload)[1]
        self._modes = joint_modes.switching(np.reshape(values, (len(self._modes), -1)))

    def _take_laws(self, payload):
        self._laws = law_states.decode_rows(np.frombuffer(payload, np.uint8)[None], self.layout.states)[0]

    def _take_errors(self, payload):
        rows = estimates.decode_rows(np.frombuffer(payload, np.uint8)[None], self.layout.body_names)
        self._errors = rows.reshape(-1, 4)

    def _take_machine(self, payload):
        rows = machine.decode(payload).values()
        self._ratios = tuple(max((row[name] for row in rows if row[name] >= 0.0), default=math.nan) for name in RATIOS)

    @property
    def how(self):
        """How far ahead a machine is predicted, one line; "": there is none, or it is not known."""
        figures = self._figures
        if "machine_horizon_s" not in figures:
            return ""
        tolerance, horizon = figures["machine_tolerance"], figures["machine_horizon_s"]
        found = f"{tolerance:g} rad or m for {horizon:g} s" + (" or more" if horizon >= AHEAD[-1] else "")
        return f"the machine is predicted within {found}"

    def _take_inputs(self, payload):
        self._base_ns, commands = inputs.decode(payload)
        for command in commands:
            if command.kind in LOADS:
                self._commands[command.kind, command.source, command.name] = command
        if len(self._commands) > 1000:
            self._commands = dict(list(self._commands.items())[-500:])

    def _take_event(self, payload):
        stamp, _, name, text = LogCodec.decode_one(payload)
        self.tell((stamp - self._base_ns) * 1e-9, name, text)
        state = "paused" if name == "start" and ", paused" in text else STATES.get(name)
        if state is not None:  # ~/state is silent in pauses
            self._figures, self._changed_ns = {**self._figures, "state": state}, stamp
            self._least = math.inf  # wall and simulated time have another distance now

    def _take_state(self, payload):
        stamp, figures = decode_figures(payload)
        known = {"state": self._figures["state"]} if stamp <= self._changed_ns else {}  # an event has overtaken it
        self._figures = {**_numbers(figures), **known}

    def frame(self):
        """Newest ViewFrame."""
        return self._newest

    def status(self):
        """Status."""
        figures, silent = self._figures, time.monotonic() - self._arrived
        state = figures.get("state", "running")
        text = next((f"machine: {figures[k]}" for k in ("machine_departs", "machine_note") if figures.get(k)), "")
        if self._newest is not None and silent > 2.0 and state == "running":
            text = f"no message for {silent:.0f} s"
        return Status(state, figures.get("real_time_factor"), self._late, text)

    def _call(self, service, kind, request):
        """Response of a service. Raises ViewError."""
        client = self._services.get(service)
        if client is None:
            client = self._services[service] = self._node.create_client(kind, f"{self._name}/{service}")
        if not client.wait_for_service(timeout_sec=ANSWER):
            raise ViewError(f"{self._name} has no service ~/{service}")
        future, done = client.call_async(request), threading.Event()
        future.add_done_callback(lambda _: done.set())
        if not done.wait(ANSWER):
            raise ViewError(f"{self._name} does not answer")
        return future.result()

    def ask(self, command, *arguments):
        """Carry out a command of `takes`; returns one line of text. Raises ViewError."""
        from std_srvs.srv import Trigger

        if command in TRIGGERS:
            answer = self._call(TRIGGERS[command], Trigger, Trigger.Request())
            if not answer.success:
                raise ViewError(answer.message)
            return answer.message
        if command == "speed":
            return self._set(real_time_factor=float(arguments[0]))
        if command == "accuracy":
            return self._set(accuracy=float(arguments[0]))
        if command in ("save", "restore"):
            self._set(snapshot=str(arguments[0]))
            answer = self._call(f"{command}_snapshot", Trigger, Trigger.Request())
            if not answer.success:
                raise ViewError(answer.message)
            return answer.message
        if command == "place":
            return self._own("set_state", {f"{self._label(j)}/position": float(q) for j, q in arguments[0].items()})
        return self._command(command, *arguments)

    def _label(self, joint):
        return joint_labels([joint], self.layout.scene.robot)[0]

    def _set(self, **values):
        from rcl_interfaces.srv import SetParameters
        from rclpy.parameter import Parameter

        request = SetParameters.Request()
        request.parameters = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
        for result in self._call("set_parameters", SetParameters, request).results:
            if not result.successful:
                raise ViewError(result.reason)
        return ", ".join(f"{name} {value}" for name, value in values.items())

    def _own(self, service, values):
        """Call ~/set_state or ~/apply_pull."""
        from rcl_interfaces.srv import SetParametersAtomically
        from rclpy.parameter import Parameter

        request = SetParametersAtomically.Request()
        request.parameters = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
        result = self._call(service, SetParametersAtomically, request).result
        if not result.successful:
            raise ViewError(result.reason)
        return result.reason

    def _command(self, kind, joint, value):
        from sensor_msgs.msg import JointState

        limits = self.layout.limits.get(joint)
        if limits is not None:  # a refusal of the node is in its log only
            try:
                (limits.check_effort if kind == "effort" else limits.check_position)(float(value))
            except ValueError as error:
                raise ViewError(str(error)) from None
        publisher = self._publishers.get("joints")
        if publisher is None:
            publisher = self._node.create_publisher(JointState, f"{self._name}/joint_commands", 10)
            self._publishers["joints"] = publisher
            end = time.monotonic() + ANSWER
            while not publisher.get_subscription_count() and time.monotonic() < end:
                time.sleep(0.02)
        message = JointState(name=[self._label(joint)])
        setattr(message, "effort" if kind == "effort" else "position", [float(value)])
        publisher.publish(message)
        return f"{joint}: {kind} {value:g}"

    def pull(self, body, values, seconds, point):
        """Pull at a point of a body for a simulated time; values : of a Command."""
        k, c, *rest, turning = map(float, values)
        given = {"stiffness": k, "damping": c, "to": rest[:3], "torque": rest[3:], "turning_damping": turning}
        given |= {"body": body, "point": [float(x) for x in point], "duration": float(seconds), "name": PULL_NAME}
        self._own("apply_pull", given)

    def release(self, body):
        """End the pull: it lasts a moment only."""
        self.pull(body, [0.0] * 9, 1e-6, [0.0] * 3)

    def branch(self, time_s):
        """Simulation in this process from a pose and twist that were received, with the accuracy of the node."""
        frame = self.history.at(time_s)
        accuracy = self._figures.get("accuracy")
        simulation = Simulation(self.layout.scene, quiet=True, **({"accuracy": accuracy} if accuracy else {}))
        names = self.layout.body_names
        try:
            simulation.place(dict(zip(names, frame.sample.pose_matrices)), dict(zip(names, frame.sample.twist)))
        except ValueError as error:
            raise ViewError(str(error)) from None
        return Local(simulation, f"branch at {frame.time:.6g} s", start_ns=round(frame.time * 1e9), paused=True)

    def close(self):
        """Leave the node alone."""
        self._ending = True
        if self._spinning.is_alive():
            self._spinning.join(2.0)
        self._executor.shutdown(2.0)  # what it waited for must not be in use when the node goes
        self._node.destroy_node()
        self._context.try_shutdown()


def _numbers(figures):
    """{name: number or text} of a status without the units in its names."""
    found = {}
    for name, text in figures.items():
        try:
            found[name] = float(text)
        except ValueError:
            found[name] = text
    return found
