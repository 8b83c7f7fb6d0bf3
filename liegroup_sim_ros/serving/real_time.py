# SPDX-License-Identifier: Apache-2.0
"""Real-time check: shares of a core that a run takes, and a coarser accuracy if real time needs it."""

from collections import deque

from liegroup_core.methods.table import METHODS
from liegroup_core.pacing import SLOW
from liegroup_core.reports import cause_of_cost
from liegroup_sim_ros.messages import events

# Largest share of a core for the integration in real time, and for integration and messages together; wall
# time between two checks, s. Above a share, the accuracy becomes coarser by the factor COARSER, up to COARSEST.
SHARE, SHARE_OF_ALL, SHARE_PERIOD = 0.5, 0.9, 0.2
COARSER, COARSEST = 10.0, 0.1
# Substeps grow with the power 1 / order of the accuracy, but each step has at least one. So the accuracy
# becomes coarser only above WORTH substeps per step, and only if the coarsest accuracy, with the messages,
# would take less than REACHABLE of a core.
WORTH, REACHABLE = 1.2, 1.0
# It becomes coarser only if the integration takes at least this share of the time of both.
MAIN = 0.5
# A cost, before or after, is the least of JUDGED periods, because disturbances add to it. The previous
# accuracy returns unless at least the share GAIN of the expected gain is measured: 12 % of the cost at
# order 8. A cost that does not depend on the accuracy varies by a few percent.
JUDGED, GAIN = 3, 0.5


def helps(before, after, expected):
    """Whether a coarser accuracy helps: costs in s of CPU time per s of simulated time.

    expected : expected ratio of the costs
    """
    return after <= before * (1.0 - GAIN * (1.0 - expected))


class RealTime:
    """Shares of a core that a simulation takes.

    simulation : liegroup_core.Simulation
    pacer      : Pacer
    settle     : function that advances to the end of the present step, where the accuracy may change; false after a
                 fault

    share, share_of_messages : shares of a core that the integration, and messages with recording, take in
                               real time, in the last SHARE_PERIOD; 0 before the first
    factor : real-time factor between the last two calls of `slow`
    """

    def __init__(self, simulation, pacer, settle=lambda: True):
        self._simulation, self._pacer, self._settle = simulation, pacer, settle
        self.share = self.share_of_messages = 0.0
        self.factor, self._most = 0.0, (0.0, 0.0)
        self.restart()

    def restart(self):
        """Restart the measurements after a state was set; the accuracy is the requested one again."""
        # s of CPU time per s of simulated time, of the last periods at this accuracy
        self._costs = deque(maxlen=JUDGED)
        self._costs_of_messages = deque(maxlen=JUDGED)
        # While a coarser accuracy is judged: the previous one, its cost, and the expected ratio.
        self._trial = None
        self._helpless = False  # True: a coarser accuracy does not help
        self._begin()

    def _begin(self):
        self._measure()
        self._slow = False  # at the last call of `slow`

    def forget(self):
        """Restart the measurements, with shares of 0, after a change of the requested factor."""
        self._begin()
        self.share = self.share_of_messages = 0.0

    def _measure(self):
        # s of CPU time, and of simulated time
        self._cpu = self._cpu_of_messages = self._advanced = 0.0
        self._substeps_before = self._simulation.substeps[1]

    def add(self, advanced, integration, messages):
        """Count simulated time in s, and the CPU time in s that its integration and its messages took.

        returns the text of an event if the accuracy was changed, otherwise None
        """
        self._cpu += integration
        self._cpu_of_messages += messages
        self._advanced += advanced
        factor = self._pacer.factor
        # The second condition ends the period of a run that is much too slow.
        if factor > 0.0 and (self._advanced >= SHARE_PERIOD * factor or self._cpu >= SHARE_PERIOD):
            return self._keep_to_real_time()
        return None

    def _keep_to_real_time(self):
        """Make the accuracy coarser if real time requires it, and if that helps."""
        in_real_time = self._pacer.factor / self._advanced
        self.share = self._cpu * in_real_time
        self.share_of_messages = self._cpu_of_messages * in_real_time
        self._most = max(self._most, (self.share, self.share_of_messages), key=sum)
        self._costs.append(self._cpu / self._advanced)
        self._costs_of_messages.append(self._cpu_of_messages / self._advanced)
        simulation = self._simulation
        steps = self._advanced / simulation.step
        substeps = max(1.0, (simulation.substeps[1] - self._substeps_before) / steps)
        self._measure()
        if self._trial is not None:
            return self._judge()
        promise = simulation.promise
        if not promise or self._helpless or len(self._costs) < JUDGED:
            return None
        share = min(self._costs) * self._pacer.factor
        share_of_messages = min(self._costs_of_messages) * self._pacer.factor
        if not (share > SHARE or share + share_of_messages > SHARE_OF_ALL):
            return None
        accuracy, given = min(COARSEST, COARSER * promise["accuracy"]), promise["accuracy"]
        least = share_of_messages + share * self._ratio(substeps, given, COARSEST)
        mainly = share >= MAIN * (share + share_of_messages)
        if given < COARSEST and substeps > WORTH and least < REACHABLE and mainly and self._settle():
            self._trial = given, min(self._costs), self._ratio(substeps, given, accuracy)
            self._costs.clear()
            simulation.set_accuracy(accuracy)
            return events.accuracy(accuracy, simulation.time, given, share, share_of_messages)
        return None

    def _ratio(self, substeps, given, coarser):
        """Expected ratio of the costs of two accuracies."""
        longer = (coarser / given) ** (1.0 / METHODS[self._simulation.method].order)
        return 1.0 / min(substeps, longer)

    def _judge(self):
        """Return to the previous accuracy if the coarser one does not help."""
        if len(self._costs) < JUDGED:
            return None
        accuracy, before, expected = self._trial
        after, self._trial = min(self._costs), None
        if helps(before, after, expected) or not self._settle():
            return None
        self._helpless = True
        self._costs.clear()
        coarser = self._simulation.promise["accuracy"]
        self._simulation.set_accuracy(accuracy)
        return events.accuracy_returns(
            accuracy,
            self._simulation.time,
            coarser,
            before * self._pacer.factor,
            after * self._pacer.factor,
            self.share_of_messages,
        )

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
            self.factor,
            factor,
            self._simulation.time,
            *most,
            promise and promise["accuracy"],
            self._helpless or bool(promise) and promise["accuracy"] >= COARSEST,
            cause_of_cost(self._simulation),
        )
