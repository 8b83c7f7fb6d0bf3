# SPDX-License-Identifier: Apache-2.0
"""Source of a page: a simulation in this process, without ROS, with the simulation thread of the node.

A recording has the topics of a node, and is read, analysed and repeated like one of a node.
"""

import math
import threading
from concurrent.futures import TimeoutError as Late
from types import SimpleNamespace

from liegroup_core import Simulation
from liegroup_core.forces.commands import EFFORT, MOVE, PULL, TARGET, Command
from liegroup_sim_ros.recording import attachments
from liegroup_sim_ros.recording.checkpoints import Checkpoints
from liegroup_sim_ros.recording.write import Recorder
from liegroup_sim_ros.serving.outputs import Outputs, Streams
from liegroup_sim_ros.serving.simulation_thread import SimulationServer

from .server import ViewError
from .source import Source, Status, ViewFrame, settings_text

NAME = "/view"  # of the node in a recording
SOURCE = "view"  # of wrenches and efforts
RATE = 100.0  # Hz, of frames that are recorded
ANSWER = 5.0  # s, longest time for a command
MOVING = 0.02  # s, in which a driven joint reaches a commanded value
MARKS, MOST_MARKS = 0.25, 400  # s between two kept states; then every second one goes
MOST_COMMANDS = 100_000  # kept for branches; then half of them go, with the states before them


class _Outputs(Outputs):
    """Outputs that tell the page of events."""

    tell = keep_commands = staticmethod(lambda *_: None)

    def event(self, stamp_ns, name, text, failed=False, is_logged=False):
        """Record an event of the run."""
        super().event(stamp_ns, name, text, failed, is_logged)
        self.tell(stamp_ns, name, text)

    def given(self, commands):
        """Keep Commands, for branches."""
        self.keep_commands(commands)


class Local(Source):
    """A Simulation that runs in real time.

    record   : path of a recording, "" for none
    start_ns : stamp of its present state
    Raises RecorderError for a file that cannot be written
    """

    polled = False
    takes = frozenset(
        ("pause", "resume", "step", "reset", "speed", "accuracy", "place", "save", "restore", "push")
        + ("effort", "servo", "driven", "back", "method")
    )

    def __init__(self, simulation, title, record="", start_ns=0, paused=False, factor=1.0):
        super().__init__(simulation.layout, title)
        sample = simulation.sample()
        self._simulation, self._newest = simulation, ViewFrame(start_ns * 1e-9, sample, sample.bound)
        self._zero = start_ns * 1e-9 - simulation.time  # s, that the page shows at step 0
        self.history.add(self._newest)
        rates = {"publish_rate": RATE, "record_rate": 0.0, "state_rate": 0.0, "clock_rate": 0.0}
        with_errors = sample.errors is not None
        values = SimpleNamespace(
            rates=rates, world_frame="world", frame_prefix="", arrow_scale=1.0, estimate=with_errors, tf_links="all"
        )
        outputs = _Outputs(Streams(NAME), self.layout, self.layout.body_names, values, dict)
        outputs.tell, outputs.keep_commands = self._tell, self._keep_commands
        outputs.after.append(self._keep)
        self.server = SimulationServer(
            simulation, outputs, factor, paused, start_ns - simulation.time_ns, motion_time=MOVING
        )
        self._recorder = None
        if record:
            state = "paused" if paused else "running"
            every = attachments.steps_per_sample(RATE, simulation.step)
            start = attachments.at_start(simulation, NAME, "world", every, outputs.topics(), start_ns, state=state)
            self._recorder = Recorder(record, start, continues=False)
            checkpoints = Checkpoints(self._recorder, simulation)
            outputs.at_steps.append(checkpoints.add_if_due)
            outputs.record_to(self._recorder)
        self._marks, self._marked, self._marking, self._commands = [], -math.inf, threading.Lock(), []
        self._every = MARKS
        self._mark_now()
        self.server.start()

    def _keep(self, stamp_ns, sample):
        """Keep the newest sample, in the simulation thread."""
        self._newest = ViewFrame(self._zero + sample.time, sample, sample.bound)
        self.history.add(self._newest)

    def _keep_commands(self, commands):
        with self._marking:
            self._commands += commands
            if len(self._commands) > MOST_COMMANDS:
                self._commands = self._commands[MOST_COMMANDS // 2 :]
                self._marks = [mark for mark in self._marks if mark[0] > self._commands[0].start_ns]

    def _tell(self, stamp_ns, name, text):
        """Tell of an event of the simulation thread; what comes before it repeats no state after it."""
        at_ns = stamp_ns - self.server._base_ns
        if name in ("reset", "state"):
            with self._marking:
                self._marks = [mark for mark in self._marks if mark[0] < at_ns]
                self._commands = [each for each in self._commands if each.start_ns < at_ns]
        if name in ("reset", "state", "accuracy"):
            self._mark_now()
        self.tell(self._zero + at_ns * 1e-9, name, text)

    def frame(self):
        """Newest ViewFrame."""
        found = self._newest
        if not 0.0 <= found.time - self._marked < self._every:
            self._mark_now()
        return found

    def _mark_now(self):
        self._marked = self._newest.time
        self.server.call("present").add_done_callback(self._mark)

    def _mark(self, future):
        """Keep (simulated time in ns, state of "present") of a Future, in the simulation thread."""
        if future.cancelled() or future.exception() is not None:
            return
        with self._marking:
            if len(self._marks) >= MOST_MARKS:
                self._marks, self._every = self._marks[::2], 2.0 * self._every
            self._marks.append((self._simulation.time_ns, *future.result()[1:]))

    @property
    def accuracy(self):
        """Present accuracy as text."""
        return f"{self._simulation.accuracy or 1e-6:g}"

    @property
    def how(self):
        """Method and accuracy or step."""
        simulation = self._simulation
        return settings_text(simulation.method, simulation.accuracy, simulation.step)

    def status(self):
        """Status."""
        server = self.server
        if server.failure is not None:
            return Status("faulted", None, None, f"the simulation thread ended: {server.failure}")
        factor = server._real_time.factor if server.state == "running" else 0.0
        lost = self._recorder.failure if self._recorder is not None and self._recorder.failure else ""
        return Status(server.state, factor, None, lost)

    def ask(self, command, *arguments):
        """Carry out a command of `takes`; returns one line of text. Raises LieGroupSimError."""
        if command == "place":
            joints = {joint: (position, None) for joint, position in arguments[0].items()}
            arguments = {}, {}, joints, " and ".join(f"{joint}/position" for joint in joints)
        elif command in ("effort", "servo", "driven"):
            return self._command(command, *arguments)
        elif command == "back":
            return self._back(*arguments)
        return self._answer(command, *arguments)

    def _answer(self, command, *arguments):
        try:
            return self.server.call(command, *arguments).result(ANSWER)
        except Late:
            raise ViewError(f"{command}: no answer within {ANSWER:g} s; a step takes long") from None

    def _command(self, kind, joint, value):
        value = float(value)
        command = {
            "effort": Command(EFFORT, joint, (value,), source=f"{SOURCE}/{joint}"),
            "servo": Command(TARGET, joint, (value, 0.0)),
            "driven": Command(MOVE, joint, (value, 0.0, MOVING)),
        }[kind]
        try:
            self.server.check(command)
        except ValueError as error:
            raise ViewError(str(error)) from None
        self.server.push([command], None, self._refused)
        return f"{joint}: {kind} {value:g}"

    def _refused(self, text):
        self.tell(self.server.stamp_ns * 1e-9, "refused", text)

    def pull(self, body, values, seconds, point):
        """Pull at a point of a body for a simulated time; values : of a Command."""
        source, point = f"{SOURCE}/{body}", tuple(map(float, point))
        command = Command(PULL, body, tuple(map(float, values)), None, None, source, point=point)
        self.server.push([command], seconds, self._refused)

    def release(self, body):
        """End the pull."""
        self.server.clear(f"{SOURCE}/{body}")

    def _back(self, time_s):
        """Return to the state of a time that the page shows, rounded down to a step; returns this time.

        The last state kept before it is set, and the motion from there repeated with its commands.
        """
        self._answer("pause")
        step, until_ns = self._simulation.step, round((time_s - self._zero) * 1e9) + 1
        with self._marking:
            found = [mark for mark in self._marks if mark[0] <= until_ns]
            if not found:
                raise ViewError("no state was kept before this time")
            since_ns, *state = found[-1]
            commands = [command for command in self._commands if since_ns <= command.start_ns <= until_ns]
        self._answer("set", state, f"state at {self._zero + since_ns * 1e-9:.6g} s")
        steps = math.floor(until_ns * 1e-9 / step + 1e-6) - self._simulation.steps
        self._answer("repeat", commands, max(0, steps))
        return self._zero + self._simulation.time

    def with_method(self, method, step, time=None):
        """Simulation that continues the last state that was kept before a time, or the present one."""
        self._answer("pause")
        before = self._simulation
        start_ns = round((self._zero + before.time if time is None else self._back(time)) * 1e9)
        simulation = Simulation(before.scene, method, step, quiet=True)
        simulation.start_from(before)
        if self._recorder is not None:
            self.tell(start_ns * 1e-9, "stop", "the recording ends: it has one method")
        return Local(simulation, before.scene.name, start_ns=start_ns, paused=True)

    def close(self):
        """End the simulation and its recording."""
        self.server.stop()
        if self._recorder is not None:
            self._recorder.add_attachment("pacing.json", *attachments.as_json(self.server.pacer.report()))
            self._recorder.close()
