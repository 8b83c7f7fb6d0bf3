# SPDX-License-Identifier: Apache-2.0
"""Whether a run keeps real time: shares of a core that it takes, and a coarser accuracy if it must."""

from liegroup_core.integrators.methods import METHODS
from liegroup_core.pacing import SLOW
from liegroup_sim_ros.messages import events

# Of a core, what the integration may take in real time, and what it may take with the messages;
# checked over so much wall time, in s. If they take more, the accuracy is made coarser by a factor, up to
# the largest one.
SHARE, SHARE_OF_ALL, SHARE_PERIOD = 0.5, 0.9, 0.2
COARSER, COARSEST = 10.0, 0.1
# No accuracy takes less than one substep per step, and substeps become longer by the power 1 / order of
# the accuracy. It is raised only above so many per step, and only if the coarsest one, with the
# messages, would take less than so much of a core.
WORTH, REACHABLE = 1.2, 1.0


class RealTime:
    """Shares of a core that a simulation takes.

    simulation : liegroup_core.Simulation
    pacer      : Pacer

    share, share_of_messages : of the integration, and of messages and recording, in real time, in the
                               last SHARE_PERIOD; 0 before the first
    factor : real-time factor between the last two calls of `slow`
    """

    def __init__(self, simulation, pacer):
        self._simulation, self._pacer = simulation, pacer
        self.share = self.share_of_messages = 0.0
        self.factor, self._most = 0.0, (0.0, 0.0)
        self.restart()

    def restart(self):
        """Begin to measure: a state was set."""
        self._measure()
        self._slow = False  # at the last call of `slow`

    def forget(self):
        """Begin to measure, without shares: the requested factor was changed."""
        self.restart()
        self.share = self.share_of_messages = 0.0

    def _measure(self):
        # s of CPU time for s of simulated time
        self._cpu = self._cpu_of_messages = self._advanced = 0.0
        self._substeps_before = self._simulation.substeps[1]

    def add(self, steps, integration, messages):
        """Count steps, and the CPU time in s that they and their messages took.

        returns the text of an event if the accuracy was raised, otherwise None
        """
        self._cpu += integration
        self._cpu_of_messages += messages
        self._advanced += steps * self._simulation.step
        factor = self._pacer.factor
        # A run that is much too slow is not waited for.
        if factor > 0.0 and (self._advanced >= SHARE_PERIOD * factor or self._cpu >= SHARE_PERIOD):
            return self._keep_to_real_time()
        return None

    def _keep_to_real_time(self):
        """Raise the accuracy if real time requires it, and if it helps."""
        before = self._needs_more_time()
        in_real_time = self._pacer.factor / self._advanced
        self.share = self._cpu * in_real_time
        self.share_of_messages = self._cpu_of_messages * in_real_time
        self._most = max(self._most, (self.share, self.share_of_messages), key=sum)
        simulation = self._simulation
        steps = self._advanced / simulation.step
        substeps = (simulation.substeps[1] - self._substeps_before) / steps
        self._measure()
        promise = simulation.promise
        # Twice in succession: once may be a disturbance.
        if not promise or not (before and self._needs_more_time()):
            return None
        longer = (COARSEST / promise["accuracy"]) ** (1.0 / METHODS[simulation.method].order)
        fewer = 1.0 / min(max(1.0, substeps), longer)
        least = self.share_of_messages + self.share * fewer
        if promise["accuracy"] < COARSEST and substeps > WORTH and least < REACHABLE:
            accuracy = min(COARSEST, COARSER * promise["accuracy"])
            simulation.set_accuracy(accuracy)
            return events.accuracy(
                accuracy, simulation.time, promise["accuracy"], self.share, self.share_of_messages
            )
        return None

    def _needs_more_time(self):
        return self.share > SHARE or self.share + self.share_of_messages > SHARE_OF_ALL

    def slow(self, running):
        """Text of an event if real time is not kept for two calls in succession, otherwise None."""
        self.factor = self._pacer.recent_factor()
        factor = self._pacer.factor
        before, self._slow = self._slow, running and 0.0 < self.factor < SLOW * factor
        most, self._most = self._most, (0.0, 0.0)
        if not (before and self._slow):
            return None
        promise = self._simulation.promise
        return events.slow(
            self.factor, factor, self._simulation.time, *most, promise and promise["accuracy"]
        )
