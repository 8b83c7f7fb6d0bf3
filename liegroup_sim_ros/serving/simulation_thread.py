# SPDX-License-Identifier: Apache-2.0
"""Simulation thread: paces and advances the simulation, executes commands, calls the outputs.

No other thread accesses the simulation. Commands and wrenches arrive from other threads and take
effect between two outputs. Samples, clock, applied wrenches, events and diagnostics go to an output
object (Outputs in outputs.py), each at its own rate. Stamps are simulated time in integer nanoseconds and
increase monotonically: a reset restarts the step count, but the stamps continue one step after the last one.
Between two steps, outputs have interpolated states.
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
from liegroup_core.threads import wake_on_time
from liegroup_sim_ros.messages import events
from liegroup_sim_ros.messages.joint_modes import JointReports, has_reports

from .figures import Saturation, contact_figures, error_figures, pacing_figures
from .inbox import Inbox
from .lockstep import LOOK, Lockstep
from .rates import Output, Rates
from .real_time import RealTime
from .simulation_commands import COMMANDS, CommandError, SimulationCommands
from .wake import Wake

log = logging.getLogger("liegroup_core")

DIAGNOSTICS_PERIOD = 1.0  # s of wall time
HALTING = 0.05  # s between two attempts to halt the simulation
_start_ns = attrgetter("start_ns")


class SimulationServer(SimulationCommands, threading.Thread):
    """Thread that runs a simulation in real time.

    simulation : liegroup_core.Simulation; only this thread uses it from `start` to its end
    output     : Outputs, or an object with the attributes timed, state_rate, targets, motions, impulses and
                 the methods hold, release, at_step, state, inputs, all_inputs, servo_targets, prescribed, event and
                 diagnostics;
                 joint_modes if joints have stops or friction; impact if impulses is not empty; listeners,
                 publish_clock, publish_again and save with a lockstep
    factor     : real-time factor, 0: as fast as possible
    follow_period : s, during which targets of a trajectory are constant
    motion_time   : s, in which a driven joint comes to rest
    paused     : start paused
    base_ns    : stamp of step 0
    origin     : text of the event `start` besides the name of the scene
    watching   : keep `positions`, {joint: rad or m} after the last block of steps; else they are None
    lockstep, lockstep_timeout : arguments rates and timeout of the Lockstep, an attribute

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
        lockstep=None,
        lockstep_timeout=0.0,
    ):
        super().__init__(name="simulation", daemon=True)
        self._simulation = simulation
        self._output = output
        self._wake = Wake()
        self._lock = threading.Lock()
        self._commands = []  # (Future, bound method, arguments)
        self._inbox = Inbox(simulation, follow_period, motion_time, self._wake.set)
        self.lockstep = Lockstep(self._wake.set, lockstep, lockstep_timeout)
        self._unseen = None  # stamp in s from which inputs act that no sample shows yet
        self._plan()
        self._stopping = False
        self._snapshots = {}
        self._base_ns = base_ns
        self._origin = origin
        self._said = set()  # events that are sent once
        self._saturation = Saturation(simulation)
        self._reports = JointReports(simulation) if has_reports(simulation.layout) else None
        self._watching = False
        self._watch(watching)
        self._reference_energy = None  # J, at the last known instant without an applied wrench
        self.pacer = Pacer(factor, sleep=self._wake.wait)
        self._real_time = RealTime(simulation, self.pacer, self._finish_step)
        self.state = "paused" if paused else "running"
        self._state_before_fault = self.state
        self.stamp_ns = base_ns + simulation.time_ns
        self._step_seen = None  # at the last call of `at_step`
        self.failure = None
        self.machine = None  # RealMachine beside it, which notes when commands arrive

    # From other threads:

    def call(self, command, *arguments):
        """Submit a command; returns its Future.

        Commands: "pause", "resume", "reset", "step" (count), "speed" (factor), "clear" (prefix of
        sources), "watch" (whether `positions` are kept), "place" (poses, twists, joints, reason; see
        Engine.place), "save" and "restore" (name of a snapshot), "set" (a state of "present", reason), "accuracy"
        (a number), "repeat" (Commands, and a number of steps after them), "plan_outputs" (after a change of their
        rates), "lockstep" (rates of its topics), "sample", "present", "hold". The result is one
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

    def check(self, command):
        """Raise BeyondLimits for a Command that cannot be followed from the present state."""
        self._simulation.inputs.check(command.since(self._base_ns))

    def check_motion(self, joint, start_ns, *points):
        """Raise BeyondLimits for points to which a driven joint cannot move; see command_motion.

        start_ns : stamp at which the motion starts; 0: now
        """
        start = (start_ns - self._base_ns) * 1e-9 if start_ns else None
        self._simulation.check_motion(joint, *points, start=start)

    def check_jump(self, joint, position):
        """Raise BeyondLimits for a target position to which a servo cannot jump."""
        self._simulation.check_jump(joint, position)

    def clear(self, prefix):
        """End the wrenches of all sources whose names start with `prefix`."""
        self._inbox.clear(prefix)  # wrenches that arrive later are not cleared
        self.call("clear", prefix)

    @property
    def last_stamp_ns(self):
        """Stamp of the state, after the end of the thread."""
        return self._base_ns + self._simulation.time_ns

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
        self._simulation.end_halt()  # a last state within a step is computed as any other

    # In the simulation thread:

    def run(self):
        """Run until `stop`; an unexpected exception ends the thread and is stored in `failure`."""
        wake_on_time()
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
        """Take over the rates of the outputs."""
        output = self._output
        self._rates = Rates(
            [
                # First, because an answer may arrive before all outputs are sent.
                *(Output(rate, partial(self._ask, topic), False, False) for topic, rate in self.lockstep.rates.items()),
                *output.timed,
                *([Output(output.state_rate, self._send_state, answers=False)] if output.state_rate else []),
            ]
        )

    def _begin(self):
        scene = self._simulation.scene.name
        steps = self._simulation.steps
        self._event("start", f"{scene} at step {steps}, {self.state}{self._origin}")
        self._send_present()
        self._send_reports("begin")
        if self._output.impulses:
            self._simulation.drain_impacts()  # the simulation collects impacts from here on
        self._send_outputs(self.stamp_ns, everything=True)
        self._reference_energy = self._simulation.sample().energy
        self._next_diagnostics = time.monotonic() + DIAGNOSTICS_PERIOD
        if self.state == "running":
            self.pacer.start(self._seconds())

    def _tick_or_wait(self):
        """Advance to the next tick if it is due; else wait for it, a command or the diagnostics."""
        idle = max(0.0, self._next_diagnostics - time.monotonic())
        if self.state == "running" and not (self.lockstep.missing and self._wait_for_answers(idle)):
            tick = self._next_tick()
            if self._unseen is None and self._inbox.acts_before(tick):
                self._unseen = self._seconds()
            # The next sample after an input is sent at once, at most one period early.
            if self.pacer.wait(tick * 1e-9, idle, self._unseen) and self._advance_to(tick):
                self._keep_to_real_time()
        elif self.state != "running":
            self._wake.wait(idle)
        if time.monotonic() >= self._next_diagnostics:
            slow = self._real_time.slow(self.state == "running")
            if slow:
                self._warn_once("slow", slow)
            self._output.diagnostics(self.stamp_ns, self._figures(self._sample_now()))
            self._next_diagnostics = max(self._next_diagnostics + DIAGNOSTICS_PERIOD, time.monotonic())

    def _ask(self, topic, stamp_ns, _):
        self.lockstep.ask(topic, stamp_ns, stamp_ns - self._base_ns)

    def _wait_for_answers(self, longest):
        """Wait for answers to the present state, at most `longest` s; returns whether some are missing.

        Raises CommandError if the time limit ends the wait of a step that a command takes.
        """
        text, ended, again = self.lockstep.wait(self._wake.wait, longest, self._output.listeners)
        if text:
            if not ended:
                log.warning(text)
            self._event("lockstep", text, ended)
        if again == "clock":
            self._output.publish_clock(self.stamp_ns)
        elif again:
            self._output.publish_again(self._rates.sent_at(self.stamp_ns), self.stamp_ns, self._simulation.sample())
        if ended and self.state != "running":
            raise CommandError(text)
        if ended:
            self.state = "paused"
            self.pacer.stop()
        return ended or bool(self.lockstep.missing)

    def _execute_commands(self):
        with self._lock:
            commands, self._commands = self._commands, []
        for future, method, arguments in commands:
            try:
                future.set_result(method(*arguments))
            except CommandError as error:
                future.set_exception(error)

    def _stamp(self, steps):
        return self._base_ns + self._simulation.step_ns(steps)

    def _seconds(self):
        return self.stamp_ns * 1e-9

    def _next_tick(self):
        """Stamp of the next output; they stay on their multiples after single steps."""
        return self._base_ns + self._rates.after(self.stamp_ns - self._base_ns)

    def _advance(self, count, enough):
        """Advance a number of steps and send all outputs before their end, until `enough()`.

        returns False if an error or the end of the thread stopped it
        """
        simulation = self._simulation
        last = simulation.steps + count
        while simulation.steps < last:
            if not self._advance_to(min(self._stamp(last), self._next_tick()), enough):
                return False
            if enough():
                break
        return not self._stopping

    def _finish_step(self):
        """Advance to the end of the present step, if outputs were sent in it; returns False after a fault."""
        simulation = self._simulation
        while self.stamp_ns > self._stamp(simulation.steps):
            if not self._advance_to(min(self._stamp(simulation.steps + 1), self._next_tick())):
                return False
        return not self._stopping

    def _advance_to(self, tick, enough=lambda: False):
        """Advance to a stamp and send its outputs, unless `enough()` before; returns False after a fault."""
        simulation = self._simulation
        instant = simulation.instant_of(tick - self._base_ns)
        began, before = time.thread_time(), self.stamp_ns
        if instant.offset and simulation.steps < instant.step:
            # Recordings are divided, and their checkpoints are, at the end of a step.
            if not self._advance_to(self._stamp(instant.step), enough):
                return False
            if simulation.steps < instant.step:
                return not self._stopping
        while self.lockstep.missing:  # in steps that a command takes
            if self._stopping or enough():
                return not self._stopping
            self._wake.clear()
            try:
                self._wait_for_answers(LOOK)
            finally:
                self._wake.set()  # there may be other commands
        for give in self.lockstep.take():
            give()
        self._inbox.deliver(self._base_ns, instant.time)
        sample = None
        try:
            simulation.reach(instant, lambda: self._stopping or enough())
            if simulation.now < instant:
                for send in self._causes():
                    send()
                return not self._stopping
            if instant.offset and (self._watching or self._rates.need_state(tick - self._base_ns)):
                sample = simulation.sample()
        except SimulationError as error:
            simulation.fall_back()
            if not self._stopping:
                self._fault(str(error))
            return False
        integrated = time.thread_time()
        self._send_outputs(tick, sample)
        self._spent = (tick - before) * 1e-9, integrated - began, time.thread_time() - integrated
        return True

    def _keep_to_real_time(self):
        """Make the accuracy coarser, and say so, if the last advance shows that real time requires it."""
        text = self._real_time.add(*self._spent)
        if text:
            if self._simulation.accurate_until == math.inf:
                self._said.discard("inaccurate")
            log.warning(text)
            self._event("accuracy", text)

    def _send_outputs(self, stamp_ns, sample=None, everything=False):
        """Send the outputs up to a stamp, in the order of their stamps.

        sample : of this stamp, within the present step; None: the stamp is that of the step
        """
        causes, self.stamp_ns = self._causes(), stamp_ns
        self._output.hold()  # a controller in lockstep computes while the rest is sent and recorded
        for output in self._rates.due(stamp_ns - self._base_ns, stamp_ns, everything):
            if output.of_state:
                sample = sample or self._simulation.sample()
                if output.answers:
                    self._unseen = None
            output.send(stamp_ns, sample)
        record = self._output.release()
        for send in causes:
            send()
        if self._simulation.steps != self._step_seen:
            self._step_seen = self._simulation.steps
            self._output.at_step(self._stamp(self._step_seen))
        self._tell_of_the_error()
        record()
        if self._watching:
            sample = sample or self._simulation.sample()
            self._keep_positions(sample)
        if sample is not None:
            for joint in self._saturation.reached(sample):
                text = events.saturated(sample.servo_efforts[joint], joint, sample.time)
                self._warn_once("saturated", text, joint)
            for joint in sample.slipping:
                self._warn_once("slip", events.slips(sample.contacts[joint], joint, sample.time), joint)
        if self.lockstep.rates:
            self._output.save()  # a state that is answered is not lost, however the process ends

    def _send_report(self, report):
        """Send a Report on joints and contacts."""
        stamp_ns = self._base_ns + report.time_ns
        if report.modes is not None:
            self._output.joint_modes(stamp_ns, report.modes)
        if report.line is not None:
            self._output.event(stamp_ns, report.name, report.line)

    def _send_reports(self, which):
        if self._reports is not None:
            for report in getattr(self._reports, which)():
                self._send_report(report)

    def _keep_positions(self, sample):
        self.positions = {joint: position for joint, (position, _) in sample.joint_coordinates.items()}

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

    def _causes(self):
        """Functions that send what was commanded and has happened since the last call, in order."""
        given = self._simulation.drain_applied()
        self._output.given(given)
        if given:
            self._reference_energy = None
        commands = [command for command in given if command.kind not in (TARGET, MOTION)]
        changes = groupby([command for command in given if command.kind in (TARGET, MOTION)], _start_ns)
        due = [
            (round(time_ns), partial(self._send_changes, self._base_ns + round(time_ns), list(entries)))
            for time_ns, entries in changes
        ]
        if self._reports is not None:
            due += [(r.time_ns, partial(self._send_report, r)) for r in self._reports.drain()]
            if self._output.impulses:
                due += [
                    (i.time_ns, partial(self._output.impact, self._base_ns + i.time_ns, i.array))
                    for i in self._simulation.drain_impacts()
                ]
            due.sort(key=itemgetter(0))
        present = partial(getattr, self._simulation.inputs, "commands")
        first = [partial(self._output.inputs, self.stamp_ns, self._base_ns, commands, present)] if commands else []
        return [*first, *(send for _, send in due)]

    def _send_changes(self, stamp_ns, changes):
        """Send the targets of servos and the motions that act from a stamp on."""
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
        targets, motions = inputs.targets_by_joint, inputs.motions_by_joint
        if targets:
            self._output.servo_targets(self.stamp_ns, targets)
        if motions or self._output.motions:
            self._output.prescribed(self.stamp_ns, motions, anew=True)
        self._reference_energy = None

    def _event(self, name, text, failed=False):
        self._output.event(self.stamp_ns, name, text, failed)

    def _sample_now(self):
        """Sample of the last stamp."""
        return self._simulation.sample()

    def _fault(self, text):
        if self.last_stamp_ns >= self.stamp_ns:
            self._send_outputs(self.last_stamp_ns, everything=True)
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
            **({"joint_events": self._simulation.event_count} if self._simulation.layout.switches else {}),
            **contact_figures(sample),
            "wrenches_held": self.inputs_held,
            "inputs_replaced": self._inbox.replaced,
            **self.lockstep.figures(),
        }
