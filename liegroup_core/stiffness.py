# SPDX-License-Identifier: Apache-2.0
"""Choice between an explicit and an implicit method, by their cost, in a simulation to an accuracy.

Stiff forces, as of a hard spring or a strong damper, limit the substeps of an explicit method by stability, even
if the motion is slow. The companion of the running error shows it: its tolerances are larger, but its substeps
are hardly longer. An implicit method has no such limit, but takes more evaluations for a substep, and is of lower
order. So the cheaper method is found by trial in this case, and at the start if the first step is expensive: the
companion takes some steps with each method, and returns. Both are one-step methods under the same control, so that
nothing else changes.

A trial ends as soon as it costs more than it could save. The cost of the steps then follows from the last substep,
because substeps grow after a start. The next trial follows when the run has cost as much as both trials, because
the start of a motion says little about the rest; later ones wait for up to WAIT times that, and are as much longer:
in a short one an implicit method has hardly grown its substeps.
Cost counts evaluations of the accelerations, not time, so that a repeated run is bit-identical.
"""

import math

from liegroup_core.errors import SimulationError
from liegroup_core.methods.table import METHODS

EXPLICIT, IMPLICIT = 0, 1  # numbers of the methods in the integrators
STIFF = "radau5"
# Evaluations in the first FIRST steps of the companion, above which both methods are tried at once.
DEAR, FIRST = 1000.0, 4
# Evaluations of the simulation per one of the companion, below which stability limits the explicit method.
# If tolerances limit it, the ratio is that of the substeps, 1.5, or less, as the companion rejects more; if stability
# does, about 1. Where a stiff motion follows another one, between both, the order is lower and the ratio above 1.5.
ALIKE = 1.25
# Least evaluations of the companion of which the ratio is taken: then it differs by a tenth between two times, which
# UNLIKE allows. And in a trial: a substep more or less changes them by a twentieth.
SEEN, UNLIKE, TRIAL = 1000.0, 1.1, 240.0
WORTH, WAIT = 0.7, 16.0  # fraction of the present cost below which a change pays
MOST = 12_000.0  # evaluations in a trial
PART = 1e-3  # of the steps of a trial: with less, its last substep is one of the start, and says nothing about the rest


class MethodChoice:
    """Sets the method of an engine and of its companion at checkpoints; see RunningError."""

    KEPT = ("_waiting", "_wait", "_begun", "_steps", "_spent")

    def __init__(self, running):
        self._running = running
        self._engine, self._companion = running.engine, running.companion
        self._integrators = running.integrators
        ours, theirs = METHODS[self._engine.method], METHODS[STIFF]
        self._names = ours.name, theirs.name
        # The substeps of both engines must differ by the same ratio.
        looser = running.ratio ** (theirs.power - ours.power)
        for integrator, factor in zip(self._integrators, (1.0, looser)):
            integrator.add(theirs, factor)
        self.restart()

    def restart(self):
        """Restart with the explicit method, because the state was set."""
        self._waiting, self._wait, self._begun = 0.0, 1.0, False
        self._continue()

    def _continue(self):
        self._name_method()
        self._running.weigh()
        self._count()

    def _name_method(self):
        self._engine.method = self._names[self._integrators[0].chosen]

    def _count(self):
        self._counted = [integrator.evaluations for integrator in self._integrators]
        self._steps = self._companion.steps

    @property
    def _spent(self):
        """Evaluations of the simulation and of its companion since the last checkpoint."""
        return [i.evaluations - before for i, before in zip(self._integrators, self._counted)]

    @_spent.setter
    def _spent(self, spent):
        self._name_method()
        self._counted = [i.evaluations - before for i, before in zip(self._integrators, spent)]

    def start(self):
        """Try both if the start is expensive; call it when the companion may have started.

        returns whether this is the start
        """
        if self._begun or not self._running.begun:
            return False
        self._begun = True
        if self._cost(EXPLICIT, DEAR, FIRST) > DEAR:
            self._choose(FIRST)
        self._count()
        return True

    def update(self):
        """Change the method if that pays; call it at a checkpoint."""
        steps, (ours, theirs) = self._companion.steps - self._steps, self._spent
        if theirs < SEEN and self._integrators[0].chosen == EXPLICIT:
            return  # by then a substep more or less matters
        self._waiting -= theirs
        most = UNLIKE * self._running.ratio  # up to which tolerances alone limit the explicit method
        alone = ALIKE * theirs <= ours <= most * theirs
        if self._waiting <= 0.0 and (not alone or self._integrators[0].chosen == IMPLICIT):
            self._choose(max(1, math.ceil(TRIAL * self._wait * steps / theirs)) if theirs else 1)
        self._count()

    def leave(self):
        """Continue with the explicit method, as the implicit one fails; returns whether that was the present one."""
        if self._integrators[0].chosen == EXPLICIT:
            return False
        self._take(EXPLICIT)
        self._continue()
        return True

    def _take(self, number):
        self._engine.choose(number)
        self._companion.choose(number)

    def _choose(self, steps):
        """Try both methods for some steps from the present state on, and continue with the cheaper one."""
        before, chosen = self._spent[1], self._integrators[0].chosen
        present = self._cost(chosen, MOST, steps)
        if self._cost(1 - chosen, min(MOST, WORTH * present), steps) < WORTH * present:
            self._take(1 - chosen)
        self._waiting = self._wait * (self._spent[1] - before)
        self._wait = min(WAIT, 2.0 * self._wait)
        self._continue()

    def _cost(self, number, most, steps):
        """Evaluations that steps of the companion take with a method, from the first `most` of them.

        inf if it has taken less than PART of them, or the method fails.
        """
        integrator, before, begun = self._integrators[1], self._spent[1], self._companion.steps
        chosen, passes, kept = integrator.chosen, integrator.passes, self._companion.snapshot()
        self._companion.inputs.freeze()  # a repeated run knows commands earlier
        integrator.passes = False
        self._companion.choose(number)
        integrator.limit_evaluations(most)
        try:
            self._companion.advance(steps)
            part = 1.0
        except SimulationError:
            part = (self._companion.steps - begun + integrator.part) / steps
        finally:
            integrator.limit_evaluations()
            integrator.passes = passes
            self._companion.restore(kept)
            self._companion.choose(chosen)
        return (self._spent[1] - before) / part if part > PART else math.inf
