# SPDX-License-Identifier: Apache-2.0
"""Simulation thread: paces and advances the simulation, executes commands, calls the outputs.

No other thread accesses the simulation. Commands and wrenches arrive from other threads and take
effect between two steps. Samples, clock, applied wrenches, events and diagnostics go to an output
object (Outputs in outputs.py). Stamps are simulated time in integer nanoseconds and increase
monotonically: a reset restarts the step count, but the stamps continue one step after the last one.
Imports no ROS.
"""

import logging
import math
import threading
import time
from concurrent.futures import Future
from functools import partial
from itertools import groupby
from operator import attrgetter, itemgetter

from liegroup_core import SimulationError
from liegroup_core.forces.commands import MOTION, TARGET
from liegroup_core.pacing import Pacer
from liegroup_sim_ros.messages import events
from liegroup_sim_ros.messages.joint_modes import JointReports

from .figures import Saturation, error_figures, pacing_figures
from .inbox import Inbox
from .real_time import RealTime
from .simulation_commands import COMMANDS, CommandError, SimulationCommands

log = logging.getLogger("liegroup_core")

DIAGNOSTICS_PERIOD = 1.0  # s of wall time
HALTING = 0.05  # s between two attempts to halt the simulation
_start_ns = attrgetter("start_ns")
IDLE_TICK = 0.01  # s of simulated time between two ticks if no output has a period


class SimulationServer(SimulationCommands, threading.Thread):
    """Thread that runs a simulation in real time.

    simulation : liegroup_core.Simulation; only this thread uses it from `start` to its end
    output     : Outputs, or an object with the attributes timed, clock_steps, state_steps, targets,
                 motions, impulses and the methods clock, state, inputs, all_inputs, servo_targets,
                 prescribed, event, diagnostics; joint_modes if joints have stops or friction; impact
                 if impulses is not empty
    factor     : real-time factor, 0: as fast as possible
    follow_period : s, during which wanted values of a trajectory are constant
    motion_time   : s, in which a driven joint comes to rest
    paused     : start paused
    base_ns    : stamp of step 0
    origin     : text of the event `start` besides the name of the scene
    watching   : keep `positions`, {joint: rad or m} after the last block of steps; else they are None

    The state is "running", "paused" or "faulted". After a SimulationError the last valid state is
    kept until a reset. `failure` is the exception that ended the thread, or None.
    """

    def __init__(
        self,
        simulation,
        output,
        factor=1.0,
        paused=False,
        base_ns=0,
        origin="",
        follow_period=2e-3,
        motion_time=0.02,
        watching=False,
    ):
        super().__init__(name="simulation", daemon=True)
        self._simulation = simulation
        self._output = output
        self._wake = threading.Event()
        self._lock = threading.Lock()
        self._commands = []  # (Future, bound method, arguments)
        self._inbox = Inbox(simulation, follow_period, motion_time, self._wake.set)
        self._unseen = None  # stamp in s from which inputs act that no sample shows yet
        self._plan()
        self._stopping = False
        self._snapshots = {}
        self._base_ns = base_ns
        self._origin = origin
        self._said = set()  # events that are sent once
        self._saturation = Saturation(simulation)
        has_modes = simulation.layout.switches
        self._reports = JointReports(simulation) if has_modes else None
        self._watching = False
        self._watch(watching)
        self._reference_energy = None  # J, at the last known instant without an applied wrench
        self.pacer = Pacer(factor, sleep=self._wake.wait)
        self._real_time = RealTime(simulation, self.pacer)
        self.state = "paused" if paused else "running"
        self._state_before_fault = self.state
        self.stamp_ns = self._stamp(simulation.steps)
        self.failure = None

    # From other threads:

    def call(self, command, *arguments):
        """Submit a command; returns its Future.

        Commands: "pause", "resume", "reset", "step" (count), "speed" (factor), "clear" (prefix of
        sources), "watch" (whether `positions` are kept), "place" (poses, twists, joints, reason; see
        Engine.place), "save" and "restore" (name of a snapshot), "set" (a state of "present", reason), "accuracy"
        (a number), "plan_outputs" (after a change of their rates), "sample", "present", "hold". The result is one
        line of text, with three exceptions: "sample" returns a Moment, "present" the stamp and the state, and
        "hold" whether the simulation was running. "hold" is a pause that also
        works after a fault. A "step" in several parts is "advance" (count, s of wall time) for each of them,
        then "stepped" (steps of all). The exception of the Future is CommandError. The Future is cancelled if
        the thread ends first.
        """
        future = Future()
        method = getattr(self, COMMANDS[command])
        with self._lock:
            self._commands.append((future, method, arguments))
        self._wake.set()
        return future

    @property
    def push(self):
        """Method of the Inbox."""
        return self._inbox.push

    @property
    def follow(self):
        """Method of the Inbox."""
        return self._inbox.follow

    def check_motion(self, joint, start_ns, *points):
        """Raise BeyondLimits for points to which a driven joint cannot move; see command_motion.

        start_ns : stamp at which the motion starts; 0: now
        """
        start = (start_ns - self._base_ns) * 1e-9 if start_ns else None
        self._simulation.check_motion(joint, *points, start=start)

    def check_jump(self, joint, position):
        """Raise BeyondLimits for a wanted position to which a servo cannot jump."""
        self._simulation.check_jump(joint, position)

    def clear(self, prefix):
        """End the wrenches of all sources whose names start with `prefix`."""
        self._inbox.clear(prefix)  # wrenches that arrive later are not cleared
        self.call("clear", prefix)

    @property
    def inputs_held(self):
        """Number of wrenches and commands of joints that act now or start later."""
        return self._simulation.input_count + len(self._inbox)

    def stop(self):
        """End the thread and join it; a long step is aborted."""
        self._stopping = True
        self._wake.set()
        while self.is_alive():
            self._simulation.halt()  # repeatedly: the thread may have started to advance since
            self.join(HALTING)

    # In the simulation thread:

    def run(self):
        """Run until `stop`; an unexpected exception ends the thread and is stored in `failure`."""
        try:
            self._begin()
            while not self._stopping:
                if self._wake.is_set():  # set after each command is queued
                    self._wake.clear()
                    self._execute_commands()
                self._tick_or_wait()
            self.pacer.stop()
            self._send_reports("finish")
            self._event("stop", f"stopped at step {self._simulation.steps}")
        except Exception as error:
            self.failure = error
        finally:
            with self._lock:
                self._stopping = True
                for future, _, _ in self._commands:
                    future.cancel()

    def _plan(self):
        """Take over the periods of the outputs."""
        output = self._output
        self._timed = [*output.timed, *([(output.state_steps, self._send_state)] if output.state_steps else [])]
        self._sent_ns = [None] * len(self._timed)  # stamp of the last message of each
        periods = {steps for steps, _ in self._timed} | {output.clock_steps} - {0}
        # A period that is a multiple of another one needs no ticks of its own.
        self._periods = [
            period for period in periods if not any(period % other == 0 for other in periods - {period})
        ] or [max(1, round(IDLE_TICK / self._simulation.step))]
        self._sample_steps = output.sample_steps

    def _begin(self):
        scene = self._simulation.scene.name
        steps = self._simulation.steps
        self._event("start", f"{scene} at step {steps}, {self.state}{self._origin}")
        self._send_present()
        self._send_reports("begin")
        if self._output.impulses:
            self._simulation.drain_impacts()  # the simulation collects impacts from here on
        self._send_outputs(everything=steps > 0)
        self._reference_energy = self._simulation.sample().energy
        self._next_diagnostics = time.monotonic() + DIAGNOSTICS_PERIOD
        if self.state == "running":
            self.pacer.start(self._seconds())

    def _tick_or_wait(self):
        """Advance to the next tick if it is due; else wait for it, a command or the diagnostics."""
        idle = max(0.0, self._next_diagnostics - time.monotonic())
        if self.state == "running":
            tick = self._next_tick()
            if self._unseen is None and self._inbox.acts_before(self._stamp(tick)):
                self._unseen = self._seconds()
            # The next sample after an input is sent at once, at most one period early.
            if self.pacer.wait(self._stamp(tick) * 1e-9, idle, self._unseen):
                if tick % self._sample_steps == 0:
                    self._unseen = None
                self._advance_to(tick)
        else:
            self._wake.wait(idle)
        if time.monotonic() >= self._next_diagnostics:
            slow = self._real_time.slow(self.state == "running")
            if slow:
                self._warn_once("slow", slow)
            self._output.diagnostics(self.stamp_ns, self._figures(self._simulation.sample()))
            self._next_diagnostics = max(self._next_diagnostics + DIAGNOSTICS_PERIOD, time.monotonic())

    def _execute_commands(self):
        with self._lock:
            commands, self._commands = self._commands, []
        for future, method, arguments in commands:
            try:
                future.set_result(method(*arguments))
            except CommandError as error:
                future.set_exception(error)

    def _stamp(self, steps):
        return self._base_ns + round(steps * self._simulation.step * 1e9)

    def _seconds(self):
        return self.stamp_ns * 1e-9

    def _next_tick(self):
        """Next step with an output; ticks stay on their grid after single steps."""
        steps = self._simulation.steps
        return min([(steps // period + 1) * period for period in self._periods])

    def _advance(self, end, enough):
        """Advance towards step `end` and send all outputs before it, until `enough()`.

        returns False if an error or the end of the thread stopped it
        """
        while self._simulation.steps < end:
            if not self._advance_to(min(end, self._next_tick()), enough):
                return False
            if enough():
                break
        return not self._stopping

    def _advance_to(self, tick, enough=lambda: False):
        """Advance to step `tick` and send its outputs, unless `enough()` before; returns False after a fault."""
        self._inbox.deliver(self._base_ns, tick * self._simulation.step)
        if changes := self._send_commands():
            self._send_changes(self.stamp_ns, changes)
        began, first = time.thread_time(), self._simulation.steps
        try:
            self._simulation.advance(tick - first, lambda: self._stopping or enough())
        except SimulationError as error:
            self._fault(str(error))
            return False
        if self._simulation.steps < tick:
            return not self._stopping
        integrated = time.thread_time()
        self._send_outputs()
        sent = time.thread_time()
        if self.state == "running":
            text = self._real_time.add(tick - first, integrated - began, sent - integrated)
            if text:
                if self._simulation.accurate_until == math.inf:
                    self._said.discard("inaccurate")
                log.warning(text)
                self._event("accuracy", text)
        return True

    def _send_outputs(self, everything=False):
        """Send the outputs of the current step, in the order of their stamps."""
        steps = self._simulation.steps
        due = [
            (round(time_ns), partial(self._send_changes, self._base_ns + round(time_ns), list(changes)))
            for time_ns, changes in groupby(self._send_commands(), _start_ns)
        ]
        if self._reports is not None:
            due += [(r.time_ns, partial(self._send_report, r)) for r in self._reports.drain()]
            if self._output.impulses:
                due += [
                    (i.time_ns, partial(self._output.impact, self._base_ns + i.time_ns, i.array))
                    for i in self._simulation.drain_impacts()
                ]
            due.sort(key=itemgetter(0))
        for _, send in due:
            send()
        self.stamp_ns = self._stamp(steps)
        self._tell_of_the_error()
        period = self._output.clock_steps
        if period and (everything or steps % period == 0):
            self._output.clock(self.stamp_ns)
        sample = None
        for i, (period, send) in enumerate(self._timed):
            if (everything or steps % period == 0) and self._sent_ns[i] != self.stamp_ns:
                self._sent_ns[i] = self.stamp_ns
                sample = sample or self._simulation.sample()
                send(self.stamp_ns, sample)
        if self._watching:
            sample = sample or self._simulation.sample()
            self._keep_positions(sample)
        if sample is not None:
            for joint in self._saturation.reached(sample):
                effort, now = sample.servo_efforts[joint], self._simulation.time
                self._warn_once("saturated", events.saturated(effort, joint, now), joint)

    def _send_report(self, report):
        """Send a Report on joints with stops or friction."""
        stamp_ns = self._base_ns + report.time_ns
        if report.modes is not None:
            self._output.joint_modes(stamp_ns, report.modes)
        if report.line is not None:
            self._output.event(stamp_ns, "joint", report.line)

    def _send_reports(self, which):
        if self._reports is not None:
            for report in getattr(self._reports, which)():
                self._send_report(report)

    def _keep_positions(self, sample):
        coordinates = sample.joint_coordinates
        states = sample.prescribed | coordinates  # driven screws are only in `prescribed`
        self.positions = {joint: position for joint, (position, *_) in states.items()}

    def _warn_once(self, name, text, about=""):
        """Log a warning and send an event, once per `name` and `about`."""
        if (name, about) not in self._said:
            self._said.add((name, about))
            log.warning(text)
            self._event(name, text)

    def _tell_of_the_error(self):
        """Send an event when the estimate exceeds the accuracy, and when it is large."""
        for name, text in events.reports(self._simulation):
            if name not in self._said:
                self._said.add(name)
                self._event(name, text)

    def _send_state(self, stamp_ns, sample):
        self._output.state(stamp_ns, self._figures(sample))

    def _send_commands(self):
        """Send the wrenches and efforts that were commanded since the last call; returns the other inputs."""
        given = self._simulation.drain_applied()
        commands = [command for command in given if command.kind not in (TARGET, MOTION)]
        if commands:
            self._output.inputs(self.stamp_ns, self._base_ns, commands, lambda: self._simulation.inputs.commands)
            self._reference_energy = None
        return [command for command in given if command.kind in (TARGET, MOTION)]

    def _send_changes(self, stamp_ns, changes):
        """Send the wanted values of servos and the motions that act from a stamp on."""
        targets, motions = {}, {}
        for change in changes:
            (targets if change.kind == TARGET else motions)[change.name] = change.values
        if targets:
            self._output.servo_targets(stamp_ns, targets)
        if motions:
            self._output.prescribed(stamp_ns, motions)
        self._reference_energy = None

    def _send_present(self):
        """Send what acts in a state that was set."""
        inputs = self._simulation.inputs
        self._simulation.drain_applied()  # it is part of the state
        self._output.all_inputs(self._base_ns, inputs.commands)
        targets, motions = inputs.targets, inputs.motions
        if targets:
            self._output.servo_targets(self.stamp_ns, targets)
        if motions or self._output.motions:
            self._output.prescribed(self.stamp_ns, motions, anew=True)
        self._reference_energy = None

    def _event(self, name, text, failed=False):
        self._output.event(self.stamp_ns, name, text, failed)

    def _fault(self, text):
        self._send_outputs(everything=True)
        self._state_before_fault = self.state
        self.state = "faulted"
        self.pacer.stop()
        self._event("fault", f"{text}; the last valid state is kept, ~/reset restarts", True)

    def _figures(self, sample):
        """{name: number or text} for the diagnostics; each name ends with its unit."""
        if self._simulation.inputs.has_wrenches:
            drift = math.nan  # an applied wrench changes the energy
        else:
            if self._reference_energy is None:
                self._reference_energy = sample.energy
            drift = sample.energy - self._reference_energy
        return {
            "state": self.state,
            "sim_time_s": self._seconds(),
            "steps": sample.steps,
            **pacing_figures(self.pacer, self._real_time.factor if self.state == "running" else 0.0, self._real_time),
            "energy_J": sample.energy,
            "energy_drift_J": drift,
            "constraint_residual": sample.constraint_residual,
            **error_figures(self._simulation, sample),
            **self._saturation.figures(sample),
            **({"joint_events": self._simulation.event_count} if self._reports else {}),
            "wrenches_held": self.inputs_held,
            "inputs_replaced": self._inbox.replaced,
        }
