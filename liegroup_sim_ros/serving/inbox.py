# SPDX-License-Identifier: Apache-2.0
"""Queue of inputs from other threads to the simulation: wrenches, joint commands, and trajectories.

The simulation thread takes them before its next block of steps.
"""

import logging
import threading

from liegroup_core.forces.commands import MOVE, NS, TARGET

from .trajectory import Follower

log = logging.getLogger("liegroup_core")


class Inbox:
    """Inputs that wait for the simulation thread.

    simulation    : liegroup_core.Simulation
    follow_period : s, during which targets of a trajectory are constant
    motion_time   : s, in which a driven joint comes to rest
    wake          : function that wakes the simulation thread

    replaced : number of accepted inputs that never acted: before the simulation thread took them, a
               later one with the same source and start replaced them, or a state was set
    """

    def __init__(self, simulation, follow_period, motion_time, wake):
        self._simulation, self._wake = simulation, wake
        self._follower = Follower(simulation, follow_period, motion_time)
        self._lock = threading.Lock()
        self._commands = {}  # key -> (Command, duration, function that refuses it)
        self._trajectory = None
        self.replaced = 0

    # From other threads:

    def push(self, commands, duration, refuse=log.warning):
        """Give Commands, which all start at the same stamp; each replaces the previous one of its source.

        duration : s of simulated time, None: until the next one of this source
        refuse   : function, called with one line of text if an input cannot be applied when it starts
        """
        # While the simulation is paused, a later command with the same start replaces the earlier
        # one, so that the queue is bounded.
        with self._lock:
            waiting = [command.start_ns or 0 for command, *_ in self._commands.values()]
            starts = [command.start_ns or 0 for command in commands]
            for command in commands:
                if self._commands.pop(command.key, None) is not None:
                    self.replaced += 1
                self._commands[command.key] = command, duration, refuse
        # Only if none that waits starts as early: a burst does not wake the thread for every message.
        if starts and (not waiting or min(starts) < min(waiting)):
            self._wake()

    def follow(self, trajectory, refuse=log.warning):
        """Follow Waypoints. It replaces a waiting one now, and the current one when it starts.

        refuse : function, called with one line of text if it cannot be followed when it starts
        """
        with self._lock:
            self.replaced += self._trajectory is not None
            self._trajectory = trajectory, refuse
        self._wake()

    def clear(self, prefix):
        """Discard waiting wrenches of all sources whose names start with `prefix`."""
        with self._lock:
            kept = [entry for entry in self._commands.items() if not entry[1][0].source.startswith(prefix)]
            self._commands = dict(kept)

    def __len__(self):
        return len(self._commands)

    # In the simulation thread:

    def acts_before(self, stamp_ns):
        """Whether a waiting input starts before a stamp."""
        if not self._commands and self._trajectory is None:
            return False
        with self._lock:
            starts = [command.start_ns for command, *_ in self._commands.values()]
            if self._trajectory is not None:
                starts.append(self._trajectory[0].stamp_ns)
        return any(not start or start < stamp_ns for start in starts)

    def deliver(self, base_ns, until):
        """Pass all waiting inputs to the simulation, and the targets of the followed trajectory.

        base_ns : stamp of step 0
        until   : s, time up to which targets are passed
        """
        if self._commands:
            self._give(base_ns)
        if self._trajectory is not None:
            with self._lock:
                (trajectory, self._follower.refuse), self._trajectory = self._trajectory, None
            start = (trajectory.stamp_ns - base_ns) * 1e-9
            self._follower.follow(trajectory, max(start, self._simulation.time))
        if not self._follower.is_idle:
            self._follower.command(until)

    def _give(self, base_ns):
        with self._lock:
            commands, self._commands = self._commands, {}
        for command, duration, refuse in commands.values():
            command = command.since(base_ns)
            try:
                self._simulation.inputs.give(command, duration)
            except ValueError as error:  # the state has changed since it arrived
                refuse(str(error))
                continue
            if command.kind in (TARGET, MOVE):
                start_ns = command.start_ns
                self._follower.release(command.name, self._simulation.time if start_ns is None else start_ns / NS)

    def discard(self):
        """Discard all inputs, because a state was set."""
        with self._lock:
            self.replaced += len(self._commands) + (self._trajectory is not None)
            self._commands.clear()
            self._trajectory = None
        self._follower.clear()

    def snapshot(self):
        """Copy of the followed and the waiting trajectory, for `restore`."""
        return self._follower.snapshot()

    def restore(self, snapshot):
        """Continue the trajectories of a snapshot."""
        self._follower.restore(snapshot)
