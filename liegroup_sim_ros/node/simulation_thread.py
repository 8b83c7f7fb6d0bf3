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
from itertools import groupby
from operator import attrgetter
from typing import NamedTuple

from liegroup_core import Sample, SceneError, SimulationError
from liegroup_core.errors import LieGroupSimError
from liegroup_core.forces.schedule import AppliedMotion, AppliedTarget, AppliedWrench
from liegroup_core.pacing import SLOW, Pacer
from liegroup_sim_ros.messages import events
from liegroup_sim_ros.recording import attachments

from .joint_command_input import Motion, Target
from .trajectory import Follower

log = logging.getLogger("liegroup_core")

DIAGNOSTICS_PERIOD = 1.0  # s of wall time
# Of a core, what the integration may take in real time, and what it may take with the messages;
# checked over so much wall time, in s. If they take more, the accuracy is raised by a factor, up to
# the largest one.
SHARE, SHARE_OF_ALL, SHARE_PERIOD = 0.5, 0.9, 0.2
COARSER, COARSEST = 10.0, 0.1
# No accuracy takes less than one substep per step. It is raised only above so many, and only if one
# per step, with the messages, would take less than so much of a core.
WORTH, REACHABLE = 1.2, 1.0
_time_ns = attrgetter("time_ns")
MOST_SNAPSHOTS = 1000
IDLE_TICK = 0.01  # s of simulated time between two ticks if no output has a period


class CommandError(LieGroupSimError):
    """The current state does not allow the command; one line of text."""


class Moment(NamedTuple):
    """What the command "sample" returns."""

    stamp_ns: int
    sample: Sample
    state: str  # of the server


class SimulationServer(threading.Thread):
    """Thread that runs a simulation in real time.

    simulation : liegroup_core.Simulation; only this thread uses it from `start` to its end
    output     : Outputs, or an object with the attributes timed, clock_steps, state_steps, acting,
                 targets, motions and the methods clock, state, applied_wrench, servo_targets,
                 prescribed, event, diagnostics
    factor     : real-time factor, 0: as fast as possible
    follow_period : s, for which wanted values of a trajectory are constant
    motion_time   : s, in which a driven joint comes to rest
    paused     : start paused
    base_ns    : stamp of step 0
    origin     : text of the event `start` besides the name of the scene
    watching   : keep `positions`, {joint: rad or m} after the last block of steps

    The state is "running", "paused" or "faulted". After a SimulationError the last valid state is
    kept, and only a reset continues. `failure` is the exception that ended the thread, or None.
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
        self._timed = [
            *output.timed,
            *([(output.state_steps, self._send_state)] if output.state_steps else []),
        ]
        self._sent_ns = [None] * len(self._timed)  # stamp of the last message of each
        periods = {steps for steps, _ in self._timed} | {output.clock_steps} - {0}
        # A period that is a multiple of another one needs no ticks of its own.
        self._periods = [
            period
            for period in periods
            if not any(period % other == 0 for other in periods - {period})
        ] or [max(1, round(IDLE_TICK / simulation.step))]
        self._wake = threading.Event()
        self._lock = threading.Lock()
        self._commands = []  # (Future, bound method, arguments)
        self._follower = Follower(simulation, follow_period, motion_time)
        self._trajectory = None
        self._wrenches = {}  # key -> (Push or command, duration, function that refuses it)
        self._stopping = False
        self._snapshots = {}
        self._base_ns = base_ns
        self._origin = origin
        self._factor_seen = 0.0  # achieved real-time factor at the last diagnostics
        self._said = set()  # events that are sent once
        self._measure_shares()
        self._share = self._share_of_messages = 0.0  # of a core, in real time
        self._slow = False  # at the last diagnostics
        self._servos = bool(simulation.layout.servos)
        self._saturated, self._saturations = set(), 0  # servos at their limit; how often reached
        self._watching = False
        self._watch(watching)
        self._reference_energy = None  # J, at the last known instant without an applied wrench
        self.pacer = Pacer(factor, sleep=self._wake.wait)
        self.state = "paused" if paused else "running"
        self._state_before_fault = self.state
        self.stamp_ns = self._stamp(simulation.steps)
        self.failure = None

    # From other threads:

    def call(self, command, *arguments):
        """Submit a command; returns its Future.

        Commands: "pause", "resume", "reset", "step" (count), "speed" (factor), "clear" (prefix of
        sources), "watch" (whether `positions` are kept), "place" (poses, twists, joints, reason; see
        Engine.place), "save" and "restore" (name of a snapshot), "sample", "hold". The result is one
        line of text, with two exceptions: "sample" returns a Moment, and "hold" returns whether the
        simulation was running. "hold" is a pause
        that also works after a fault. A "step" in several parts is "advance" (count) for each of
        them, then "stepped" (steps of all). The exception of the Future is CommandError. The Future
        is cancelled if the thread ends first.
        """
        future = Future()
        method = {
            "pause": self._pause,
            "resume": self._resume,
            "reset": self._reset,
            "step": self._step,
            "advance": self._advance_paused,
            "stepped": self._stepped,
            "place": self._place,
            "save": self._save,
            "restore": self._restore,
            "speed": self._speed,
            "watch": self._watch,
            "clear": self._clear,
            "sample": self._sample,
            "hold": self._hold,
        }[command]
        with self._lock:
            self._commands.append((future, method, arguments))
        self._wake.set()
        return future

    def push(self, pushes, duration, refuse=log.warning):
        """Apply wrenches or commands; each replaces the previous one of its source.

        pushes   : [Push, JointEffort, Target or Motion], which all start with the same step
        duration : s of simulated time, None: until the next one of this source
        refuse   : function of one line of text, called if one cannot be applied when it starts
        """
        # While the simulation is paused, a later command with the same start replaces the earlier
        # one, so that the queue is bounded.
        with self._lock:
            for push in pushes:
                self._wrenches.pop(push.key, None)
                self._wrenches[push.key] = push, duration, refuse

    def check_motion(self, joint, start_ns, *points):
        """Raise BeyondLimits for points to which a driven joint cannot move; see command_motion.

        start_ns : stamp at which the motion starts; 0: now
        """
        start = (start_ns - self._base_ns) * 1e-9 if start_ns else None
        self._simulation.check_motion(joint, *points, start=start)

    def check_jump(self, joint, position):
        """Raise BeyondLimits for a wanted position to which a servo cannot jump."""
        before = self._simulation.wanted_position(joint)
        self._simulation.layout.limits[joint].check_jump(before, position)

    def follow(self, trajectory, refuse=log.warning):
        """Follow a Trajectory; it replaces one that waits, and the present one when it starts.

        refuse : function of one line of text, called if it cannot be followed when it starts
        """
        self._follower.refuse = refuse
        self._trajectory = trajectory

    def clear(self, prefix):
        """End the wrenches of all sources whose names start with `prefix`."""
        with self._lock:  # wrenches that arrive later are not cleared
            for key in [key for key in self._wrenches if key[1].startswith(prefix)]:
                del self._wrenches[key]
        self.call("clear", prefix)

    @property
    def wrenches_held(self):
        """Number of wrenches and efforts that act now or start later."""
        return self._simulation.wrench_count + len(self._wrenches)

    def stop(self):
        """End the thread after the current tick and join it."""
        self._stopping = True
        self._wake.set()
        if self.is_alive():
            self.join()

    # In the simulation thread:

    def run(self):
        """Run until `stop`; another exception is stored in `failure`."""
        try:
            self._begin()
            while not self._stopping:
                if self._wake.is_set():  # set after each command is queued
                    self._wake.clear()
                    self._execute_commands()
                self._tick_or_wait()
            self.pacer.stop()
            self._event("stop", f"stopped at step {self._simulation.steps}")
        except Exception as error:
            self.failure = error
        finally:
            with self._lock:
                self._stopping = True
                for future, _, _ in self._commands:
                    future.cancel()

    def _begin(self):
        scene = self._simulation.scene.name
        steps = self._simulation.steps
        self._event("start", f"{scene} at step {steps}, {self.state}{self._origin}")
        self._send_changes(self.stamp_ns, self._simulation.acting())
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
            if self.pacer.wait(self._stamp(tick) * 1e-9, idle):
                self._advance_to(tick)
        else:
            self._wake.wait(idle)
        if time.monotonic() >= self._next_diagnostics:
            self._factor_seen = self.pacer.recent_factor()
            self._tell_of_real_time()
            self._output.diagnostics(self.stamp_ns, self._figures(self._simulation.sample()))
            self._next_diagnostics = max(
                self._next_diagnostics + DIAGNOSTICS_PERIOD, time.monotonic()
            )

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

    def _advance(self, end):
        """Advance to step `end` and send all outputs before it; True if `end` was reached."""
        while self._simulation.steps < end and not self._stopping:
            if not self._advance_to(min(end, self._next_tick())):
                return False
        return self._simulation.steps == end

    def _advance_to(self, tick):
        """Advance to the next step with outputs and send them; False after a fault."""
        if self._wrenches:
            self._apply_wrenches()
        if self._trajectory is not None or not self._follower.is_idle:
            self._follow_until(tick)
        began, first = time.thread_time(), self._simulation.steps
        try:
            self._simulation.advance(tick - first)
        except SimulationError as error:
            self._fault(str(error))
            return False
        integrated = time.thread_time()
        self._cpu += integrated - began
        self._advanced += (tick - first) * self._simulation.step
        self._send_outputs()
        self._cpu_of_messages += time.thread_time() - integrated
        factor = self.pacer.factor
        # A run that is much too slow is not waited for.
        enough = self._advanced >= SHARE_PERIOD * factor or self._cpu >= SHARE_PERIOD
        if self.state == "running" and factor > 0.0 and enough:
            self._keep_to_real_time()
        return True

    def _measure_shares(self):
        """Begin to measure what the integration and the messages take."""
        # s of CPU time for s of simulated time
        self._cpu = self._cpu_of_messages = self._advanced = 0.0
        self._substeps_before = self._simulation.substeps[1]

    def _keep_to_real_time(self):
        """Raise the accuracy if real time requires it, and if it helps."""
        before = self._needs_more_time()
        in_real_time = self.pacer.factor / self._advanced
        self._share = self._cpu * in_real_time
        self._share_of_messages = self._cpu_of_messages * in_real_time
        steps = self._advanced / self._simulation.step
        substeps = (self._simulation.substeps[1] - self._substeps_before) / steps
        self._measure_shares()
        promise = self._simulation.promise
        # Twice in succession: once may be a disturbance.
        if not promise or not (before and self._needs_more_time()):
            return
        least = self._share_of_messages + self._share / max(1.0, substeps)
        if promise["accuracy"] < COARSEST and substeps > WORTH and least < REACHABLE:
            accuracy = min(COARSEST, COARSER * promise["accuracy"])
            self._simulation.set_accuracy(accuracy)
            if self._simulation.accurate_until == math.inf:
                self._said.discard("inaccurate")
            text = events.accuracy(
                accuracy,
                self._simulation.time,
                promise["accuracy"],
                self._share,
                self._share_of_messages,
            )
            log.warning(text)
            self._event("accuracy", text)

    def _needs_more_time(self):
        return self._share > SHARE or self._share + self._share_of_messages > SHARE_OF_ALL

    def _apply_wrenches(self):
        with self._lock:
            wrenches, self._wrenches = self._wrenches, {}
        for push, duration, refuse in wrenches.values():
            start = (push.start_ns - self._base_ns) * 1e-9 if push.start_ns else None
            try:
                push.apply(self._simulation, start, duration)
            except ValueError as error:  # the state is not that of its arrival
                refuse(str(error))
                continue
            if isinstance(push, (Target, Motion)):
                self._follower.release(push.joint, start or self._simulation.time)

    def _follow_until(self, tick):
        trajectory, self._trajectory = self._trajectory, None
        if trajectory is not None:
            start = (trajectory.stamp_ns - self._base_ns) * 1e-9
            self._follower.follow(trajectory, max(start, self._simulation.time))
        self._follower.command(tick * self._simulation.step)

    def _send_outputs(self, everything=False):
        """Send the outputs of the current step, in the order of their stamps."""
        steps = self._simulation.steps
        for time_ns, changes in groupby(self._simulation.drain_applied(), _time_ns):
            self._send_changes(self._base_ns + time_ns, list(changes))
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
        if self._servos and sample is not None:
            self._tell_of_saturation(sample)

    def _keep_positions(self, sample):
        coordinates = sample.joint_coordinates
        states = sample.prescribed | coordinates  # screws have no other coordinates
        self.positions = {joint: position for joint, (position, *_) in states.items()}

    def _tell_of_saturation(self, sample):
        """Count servos that reach their limit; send an event for the first time of each."""
        saturated = set(sample.saturated)
        for joint in sorted(saturated - self._saturated):
            self._saturations += 1
            if ("saturated", joint) not in self._said:
                self._said.add(("saturated", joint))
                text = events.saturated(sample.servo_efforts[joint], joint, self._simulation.time)
                log.warning(text)
                self._event("saturated", text)
        self._saturated = saturated

    def _tell_of_the_error(self):
        """Send an event when the estimate exceeds the accuracy, and when it is large."""
        for name, text in events.reports(self._simulation):
            if name not in self._said:
                self._said.add(name)
                self._event(name, text)

    def _tell_of_real_time(self):
        """Send an event and log a warning once real time is not kept for two diagnostics."""
        factor = self.pacer.factor
        before, self._slow = self._slow, 0.0 < self._factor_seen < SLOW * factor
        if self.state != "running":
            self._slow = False
        if before and self._slow and "slow" not in self._said:
            self._said.add("slow")
            promise = self._simulation.promise
            text = events.slow(
                self._factor_seen,
                factor,
                self._simulation.time,
                self._share,
                self._share_of_messages,
                promise and promise["accuracy"],
            )
            log.warning(text)
            self._event("slow", text)

    def _send_state(self, stamp_ns, sample):
        self._output.state(stamp_ns, self._figures(sample))

    def _send_changes(self, stamp_ns, changes):
        """Send the wrenches, wanted values of servos, and motions that act from a stamp on."""
        targets, motions = {}, {}
        for change in changes:
            if isinstance(change, AppliedTarget):
                targets[change.joint] = change.position, change.velocity
            elif isinstance(change, AppliedMotion):
                motions[change.joint] = change.motion
            else:
                self._send_wrench(stamp_ns, change.body, change.wrench, change.axes)
        if targets:
            self._output.servo_targets(stamp_ns, targets)
        if motions:
            self._output.prescribed(stamp_ns, motions)
        if targets or motions:
            self._reference_energy = None

    def _send_wrench(self, stamp_ns, body, wrench, axes):
        self._output.applied_wrench(stamp_ns, body, wrench, axes)
        self._reference_energy = None

    def _event(self, name, text, failed=False):
        self._output.event(self.stamp_ns, name, text, failed)

    def _fault(self, text):
        self._send_outputs(everything=True)
        self._state_before_fault = self.state
        self.state = "faulted"
        self.pacer.stop()
        self._event("fault", f"{text}; the last valid state is kept, ~/reset restarts", True)

    def _refuse_if_faulted(self):
        if self.state == "faulted":
            raise CommandError("the simulation has stopped with an error: call ~/reset first")

    # Commands:

    def _pause(self):
        self._refuse_if_faulted()
        if self.state == "paused":
            return "already paused"
        self.state = "paused"
        self.pacer.stop()
        self._event("pause", f"paused at step {self._simulation.steps}")
        return f"paused at {self._seconds():.9g} s"

    def _resume(self):
        self._refuse_if_faulted()
        if self.state == "running":
            return "already running"
        self.state = "running"
        self.pacer.start(self._seconds())
        self._event("resume", f"running from step {self._simulation.steps}")
        return f"running from {self._seconds():.9g} s"

    def _reset(self):
        self._simulation.reset()
        return self._restart("reset", "initial state, step 0", "initial state")

    def _place(self, poses, twists, joints, reason):
        self._refuse_if_faulted()
        try:
            self._simulation.place(poses, twists, joints)
        except (SceneError, ValueError) as error:
            raise CommandError(str(error)) from None
        entries = attachments.state(self._simulation, self._next_stamp())
        return self._restart("state", events.state(reason, entries), reason)

    def _save(self, name):
        self._refuse_if_faulted()
        if name not in self._snapshots and len(self._snapshots) >= MOST_SNAPSHOTS:
            raise CommandError(
                f"there are {MOST_SNAPSHOTS} snapshots already: save under the name of one of them"
            )
        if self._wrenches:
            self._apply_wrenches()
        if self._trajectory is not None:
            self._follow_until(self._simulation.steps)
        self._snapshots[name] = self._simulation.snapshot(), self._follower.snapshot()
        self._event("save", f"{name}, step {self._simulation.steps}")
        return f"saved {name!r} at {self._seconds():.9g} s, step {self._simulation.steps}"

    def _restore(self, name):
        snapshot = self._snapshots.get(name)
        if snapshot is None:
            known = ", ".join(sorted(self._snapshots)) or "none, call ~/save_snapshot first"
            raise CommandError(f"unknown snapshot {name!r}; saved are: {known}")
        state, followed = snapshot
        self._simulation.restore(state)
        entries = attachments.state(self._simulation, self._next_stamp())
        text = events.state(f"snapshot {name}", entries)
        result = self._restart("state", text, f"snapshot {name!r}")
        self._follower.restore(followed)
        return result

    def _next_stamp(self):
        """Stamp of a state that was set: one step after the last one, so that no stamp occurs twice."""
        return self.stamp_ns + max(1, round(self._simulation.step * 1e9))

    def _restart(self, name, text, result):
        """Continue from a state that was set in the simulation; send the event and all outputs."""
        self.stamp_ns = self._next_stamp()
        self._base_ns = self.stamp_ns - self._simulation.time_ns
        with self._lock:
            self._wrenches.clear()
        self._trajectory = None
        self._follower.clear()
        self._said.clear()
        self._measure_shares()
        self._slow = False
        self._event(name, text)
        acting = self._simulation.acting()
        going_on = {(c.body, c.axes) for c in acting if isinstance(c, AppliedWrench)}
        if self._output.motions:
            self._output.prescribed(self.stamp_ns, {}, anew=True)
        for body, axes in self._output.acting.keys() - going_on:
            self._send_wrench(self.stamp_ns, body, (0.0,) * 6, axes)
        self._send_changes(self.stamp_ns, acting)
        self._send_outputs(everything=True)
        self._reference_energy = self._simulation.sample().energy
        if self.state == "faulted":
            self.state = self._state_before_fault
        if self.state == "running":
            self.pacer.start(self._seconds())
        return f"{result} at {self._seconds():.9g} s, {self.state}"

    def _step(self, count):
        first = self._simulation.steps
        reached = self._advance_paused(count)
        done = self._simulation.steps - first
        text = self._stepped(done)
        if not reached:
            raise CommandError(f"stopped after {done} of {count} steps")
        return text

    def _advance_paused(self, count):
        """Take steps while paused; True if all were taken."""
        self._refuse_if_faulted()
        if self.state != "paused":
            raise CommandError("the simulation is running: call ~/pause first")
        return self._advance(self._simulation.steps + count)

    def _stepped(self, done):
        """Send all outputs and the event after steps that were taken while paused."""
        if self.state != "faulted":
            self._send_outputs(everything=True)
        steps = f"{done} step{'s' if done != 1 else ''}"
        self._event("step", f"{steps}, at step {self._simulation.steps}")
        return f"{steps}, at {self._seconds():.9g} s"

    def _speed(self, factor):
        self.pacer.factor = factor
        self._measure_shares()
        self._share = self._share_of_messages = 0.0
        self._slow = False
        self._said.discard("slow")
        if self.state == "running":
            self.pacer.start(self._seconds())
        self._event("speed", f"real-time factor {factor:g}")
        return f"real-time factor {factor:g}"

    def _watch(self, watching):
        self._watching = watching
        if watching:
            self._keep_positions(self._simulation.sample())
        return "positions are kept" if watching else "positions are not kept"

    def _clear(self, prefix):
        for source in self._simulation.wrench_sources:
            if source.startswith(prefix):
                self._simulation.clear_wrenches(source)
        return f"wrenches of {prefix} end with the next step"

    def _sample(self):
        return Moment(self.stamp_ns, self._simulation.sample(), self.state)

    def _hold(self):
        if self.state == "faulted":  # a reset would let it run again
            running, self._state_before_fault = self._state_before_fault == "running", "paused"
            return running
        running = self.state == "running"
        self._pause()
        return running

    def _error_figures(self, sample):
        """Largest estimated errors of all bodies; nothing without an estimate."""
        if sample.errors is None:
            return {}
        position, attitude = sample.errors[:, :2].max(axis=0).tolist()
        return {
            "position_error_m": position,
            "attitude_error_rad": attitude,
            # By position, then by attitude; none while all are unknown.
            "worst_body": max(zip(sample.errors.tolist(), sample.body_names))[1]
            if math.isfinite(position)
            else "",
            "predictable_until_s": self._simulation.predictable_until,
            **self._accuracy_figures(),
        }

    def _servo_figures(self, sample):
        if not self._servos:
            return {}
        return {
            "servos_saturated": ", ".join(sample.saturated),
            "servo_saturations": self._saturations,
        }

    def _accuracy_figures(self):
        promise = self._simulation.promise
        if promise is None:
            return {}
        return {
            "accuracy": promise["accuracy"],
            "accuracy_horizon_s": promise["horizon"],
            "accurate_until_s": self._simulation.accurate_until,
        }

    def _figures(self, sample):
        """{name: number or text} for the diagnostics; each name ends with its unit."""
        pacing = self.pacer.report()
        if self._output.acting:
            drift = math.nan  # an applied wrench changes the energy
        else:
            if self._reference_energy is None:
                self._reference_energy = sample.energy
            drift = sample.energy - self._reference_energy
        return {
            "state": self.state,
            "sim_time_s": self._seconds(),
            "steps": sample.steps,
            "real_time_factor_wanted": self.pacer.factor,
            "real_time_factor": self._factor_seen if self.state == "running" else 0.0,
            "lateness_p50_us": pacing["lateness_us"]["p50"],
            "lateness_p99_us": pacing["lateness_us"]["p99"],
            "lateness_max_us": pacing["lateness_us"]["max"],
            "ticks": pacing["ticks"],
            "overruns": pacing["overruns"],
            "reanchored": pacing["reanchored"],
            "integration_share_of_core": self._share,
            "messages_share_of_core": self._share_of_messages,
            "energy_J": sample.energy,
            "energy_drift_J": drift,
            "constraint_residual": sample.constraint_residual,
            **self._error_figures(sample),
            **self._servo_figures(sample),
            "wrenches_held": self.wrenches_held,
        }
