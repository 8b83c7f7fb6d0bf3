# SPDX-License-Identifier: Apache-2.0
"""Commands of other threads to the simulation thread: pause, step, reset, states, snapshots.

They are executed between two outputs, in the simulation thread; those that keep or change the state first go on
to the end of the step.
"""

import math
import time
from typing import NamedTuple

from liegroup_core import Sample, SceneError
from liegroup_core.errors import LieGroupSimError
from liegroup_sim_ros.messages import events
from liegroup_sim_ros.numbers import counted
from liegroup_sim_ros.recording import attachments

from .lockstep import aligned

MOST_SNAPSHOTS = 1000
# {name for SimulationServer.call: method}
COMMANDS = {
    "pause": "_pause",
    "resume": "_resume",
    "reset": "_reset",
    "step": "_step",
    "repeat": "_repeat",
    "advance": "_advance_paused",
    "stepped": "_stepped",
    "place": "_place",
    "save": "_save",
    "restore": "_restore",
    "present": "_present",
    "set": "_set",
    "speed": "_speed",
    "watch": "_watch",
    "accuracy": "_accuracy",
    "plan_outputs": "_plan_outputs",
    "lockstep": "_set_lockstep",
    "clear": "_clear",
    "sample": "_sample",
    "hold": "_hold",
}


class CommandError(LieGroupSimError):
    """The current state does not allow the command; one line of text."""


class Moment(NamedTuple):
    """Result of the command "sample"."""

    stamp_ns: int
    sample: Sample
    state: str  # of the server


class SimulationCommands:
    """Commands of a SimulationServer, its subclass. Each returns one line of text; `call` lists exceptions."""

    def _refuse_if_faulted(self):
        if self.state == "faulted":
            raise CommandError("the simulation has stopped with an error: call ~/reset first")

    def _settle(self):
        """Go on to the end of the step, whose state is exact."""
        self._finish_step()
        self._refuse_if_faulted()

    def _pause(self):
        self._refuse_if_faulted()
        if self.state == "paused":
            return "already paused"
        self._settle()
        self.state = "paused"
        self.pacer.stop()
        self._event("pause", f"paused at step {self._simulation.steps}")
        return f"paused at {self._seconds():.9g} s"

    def _resume(self):
        self._refuse_if_faulted()
        if self.state == "running":
            return "already running"
        self.state = "running"
        self.lockstep.forget_wait()
        self.pacer.start(self._seconds())
        self._event("resume", f"running from step {self._simulation.steps}")
        return f"running from {self._seconds():.9g} s"

    def _reset(self):
        self._simulation.reset()
        return self._restart("reset", "initial state, step 0", "initial state")

    def _place(self, poses, twists, joints, reason):
        self._refuse_if_faulted()
        self._settle()
        try:
            self._simulation.place(poses, twists, joints)
        except (SceneError, ValueError) as error:
            raise CommandError(str(error)) from None
        entries = attachments.state(self._simulation, self._next_stamp())
        return self._restart("state", events.state(reason, entries), reason)

    def _save(self, name):
        self._refuse_if_faulted()
        if name not in self._snapshots and len(self._snapshots) >= MOST_SNAPSHOTS:
            raise CommandError(f"there are {MOST_SNAPSHOTS} snapshots already: save under the name of one of them")
        self._settle()
        self._snapshots[name] = self._present()[1:]
        self._event("save", f"{name}, step {self._simulation.steps}")
        return f"saved {name!r} at {self._seconds():.9g} s, step {self._simulation.steps}"

    def _restore(self, name):
        snapshot = self._snapshots.get(name)
        if snapshot is None:
            known = ", ".join(sorted(self._snapshots)) or "none, call ~/save_snapshot first"
            raise CommandError(f"unknown snapshot {name!r}; saved are: {known}")
        return self._set(snapshot, f"snapshot {name}", f"snapshot {name!r}")

    def _present(self):
        """(stamp in ns, state, followed trajectories), of which `_set` takes the last two."""
        self._finish_step()
        self._inbox.deliver(self._base_ns, self._simulation.time)
        return self.stamp_ns, self._simulation.snapshot(), self._inbox.snapshot()

    def _set(self, snapshot, reason, shown=None):
        state, followed = snapshot
        self._simulation.restore(state)
        entries = attachments.state(self._simulation, self._next_stamp())
        result = self._restart("state", events.state(reason, entries), shown or reason)
        self._inbox.restore(followed)
        return result

    def _next_stamp(self):
        """Stamp of a state that was set: one step after the last one, so that no stamp occurs twice.

        In lockstep it may be later: controllers find their times by the stamps.
        """
        after = self.stamp_ns + max(1, round(self._simulation.step * 1e9))
        return aligned(self.lockstep.rates.values(), after, self._simulation.time_ns)

    def _restart(self, name, text, result):
        """Continue from a state that was set in the simulation; send the event and all outputs."""
        self._send_reports("finish")
        self._rates.restart()
        self._step_seen = None
        self.stamp_ns = self._next_stamp()
        self._base_ns = self.stamp_ns - self._simulation.time_ns
        self._inbox.discard()
        self.lockstep.discard()
        self._said.clear()
        self._real_time.restart()
        self._event(name, text)
        self._send_reports("begin")
        self._send_present()
        self._send_outputs(self.stamp_ns, everything=True)
        self._reference_energy = self._simulation.sample().energy
        if self.state == "faulted":
            self.state = self._state_before_fault
        if self.state == "running":
            self.pacer.start(self._seconds())
        return f"{result} at {self._seconds():.9g} s, {self.state}"

    def _step(self, count):
        done, reached = self._advance_paused(count)
        text = self._stepped(done)
        if not reached:
            raise CommandError(f"stopped after {done} of {counted(count, 'step')}")
        return text

    def _repeat(self, commands, count):
        for command in commands:
            command.repeat(self._simulation)
        return self._step(count) if count else "no step"

    def _advance_paused(self, count, seconds=math.inf):
        """Take steps while paused, for at most `seconds` of wall time; returns (steps taken, no error)."""
        self._refuse_if_faulted()
        if self.state != "paused":
            raise CommandError("the simulation is running: call ~/pause first")
        first, end = self._simulation.steps, time.monotonic() + seconds
        reached = self._advance(count, lambda: time.monotonic() >= end)
        return self._simulation.steps - first, reached

    def _stepped(self, done):
        """Send all outputs and the event after steps that were taken while paused."""
        if self.state != "faulted":
            self._send_outputs(self._stamp(self._simulation.steps), everything=True)
        steps = counted(done, "step")
        self._event("step", f"{steps}, at step {self._simulation.steps}")
        return f"{steps}, at {self._seconds():.9g} s"

    def _speed(self, factor):
        self.pacer.factor = factor
        self._real_time.forget()
        self._said.discard(("slow", ""))
        if self.state == "running":
            self.pacer.start(self._seconds())
        self._event("speed", f"real-time factor {factor:g}")
        return f"real-time factor {factor:g}"

    def _plan_outputs(self):
        self._plan()
        if self._output.impulses:
            self._simulation.drain_impacts()  # the simulation collects impacts from here on
        return "the rates of the topics have changed"

    def _set_lockstep(self, rates):
        self.lockstep.set(rates)
        self._plan()
        return "the topics of the lockstep have changed"

    def _accuracy(self, accuracy):
        self._finish_step()
        if self.stamp_ns != (stamp_ns := self._stamp(self._simulation.steps)):
            self._send_outputs(stamp_ns)  # a recording repeats the change at the stamp of its event
        try:
            self._simulation.set_accuracy(accuracy)
        except ValueError as error:
            raise CommandError(str(error)) from None
        if self._simulation.accurate_until == math.inf:
            self._said.discard("inaccurate")
        text = events.accuracy_requested(accuracy, self._simulation.time)
        self._real_time.forget()
        self._event("accuracy", text)
        return text

    def _watch(self, watching):
        self._watching = watching
        self.positions = None
        if watching:
            self._keep_positions(self._simulation.sample())
        return "positions are kept" if watching else "positions are not kept"

    def _clear(self, prefix):
        for source in self._simulation.wrench_sources:
            if source.startswith(prefix):
                self._simulation.clear_wrenches(source)
        return f"wrenches of {prefix} end with the next step"

    def _sample(self):
        return Moment(self.stamp_ns, self._sample_now(), self.state)

    def _hold(self):
        if self.state == "faulted":  # keep a later reset from starting it again
            running, self._state_before_fault = self._state_before_fault == "running", "paused"
            return running
        running = self.state == "running"
        self._pause()
        return running
