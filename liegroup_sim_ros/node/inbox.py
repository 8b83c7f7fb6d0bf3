# SPDX-License-Identifier: Apache-2.0
"""What other threads want of the simulation: wrenches, commands of joints, and trajectories.

They wait here until the simulation thread takes them before its next block of steps. Imports no ROS.
"""

import logging
import threading

from .joint_command_input import Motion, Target
from .trajectory import Follower

log = logging.getLogger("liegroup_core")


class Inbox:
    """Inputs that wait for the simulation thread.

    simulation    : liegroup_core.Simulation
    follow_period : s, for which wanted values of a trajectory are constant
    motion_time   : s, in which a driven joint comes to rest
    wake          : function that wakes the simulation thread

    replaced : number of accepted inputs that never acted: a later one of the same source and start
               replaced them, or a state was set, before the simulation thread took them
    """

    def __init__(self, simulation, follow_period, motion_time, wake):
        self._simulation, self._wake = simulation, wake
        self._follower = Follower(simulation, follow_period, motion_time)
        self._lock = threading.Lock()
        self._pushes = {}  # key -> (Push or command, duration, function that refuses it)
        self._trajectory = None
        self.replaced = 0

    # From other threads:

    def push(self, pushes, duration, refuse=log.warning):
        """Apply wrenches or commands; each replaces the previous one of its source.

        pushes   : [Push, JointEffort, Target or Motion], which all start with the same step
        duration : s of simulated time, None: until the next one of this source
        refuse   : function of one line of text, called if one cannot be applied when it starts
        """
        # While the simulation is paused, a later command with the same start replaces the earlier
        # one, so that the queue is bounded.
        with self._lock:
            first = not self._pushes
            for push in pushes:
                if self._pushes.pop(push.key, None) is not None:
                    self.replaced += 1
                self._pushes[push.key] = push, duration, refuse
        if first:  # once for each delivery: a storm does not wake the thread for every message
            self._wake()

    def follow(self, trajectory, refuse=log.warning):
        """Follow a Trajectory; it replaces one that waits, and the present one when it starts.

        refuse : function of one line of text, called if it cannot be followed when it starts
        """
        with self._lock:
            self.replaced += self._trajectory is not None
            self._trajectory = trajectory, refuse
        self._wake()

    def clear(self, prefix):
        """Forget the wrenches of all sources whose names start with `prefix`."""
        with self._lock:
            for key in [key for key in self._pushes if key[1].startswith(prefix)]:
                del self._pushes[key]

    def __len__(self):
        return len(self._pushes)

    # In the simulation thread:

    def acts_before(self, stamp_ns):
        """Whether an input waits that starts before a stamp."""
        if not self._pushes and self._trajectory is None:
            return False
        with self._lock:
            starts = [push.start_ns for push, *_ in self._pushes.values()]
            if self._trajectory is not None:
                starts.append(self._trajectory[0].stamp_ns)
        return any(not start or start < stamp_ns for start in starts)

    def deliver(self, base_ns, until):
        """Give everything to the simulation, and the wanted values of a trajectory up to a time in s.

        base_ns : stamp of step 0
        """
        if self._pushes:
            self._apply(base_ns)
        if self._trajectory is not None:
            with self._lock:
                (trajectory, self._follower.refuse), self._trajectory = self._trajectory, None
            start = (trajectory.stamp_ns - base_ns) * 1e-9
            self._follower.follow(trajectory, max(start, self._simulation.time))
        if not self._follower.is_idle:
            self._follower.command(until)

    def _apply(self, base_ns):
        with self._lock:
            pushes, self._pushes = self._pushes, {}
        for push, duration, refuse in pushes.values():
            start = (push.start_ns - base_ns) * 1e-9 if push.start_ns else None
            try:
                push.apply(self._simulation, start, duration)
            except ValueError as error:  # the state is not that of its arrival
                refuse(str(error))
                continue
            if isinstance(push, (Target, Motion)):
                self._follower.release(push.joint, start or self._simulation.time)

    def discard(self):
        """Forget everything: a state was set."""
        with self._lock:
            self.replaced += len(self._pushes) + (self._trajectory is not None)
            self._pushes.clear()
            self._trajectory = None
        self._follower.clear()

    def snapshot(self):
        """Copy of the trajectories that are followed or wait, for `restore`."""
        return self._follower.snapshot()

    def restore(self, snapshot):
        """Follow what a snapshot had."""
        self._follower.restore(snapshot)
