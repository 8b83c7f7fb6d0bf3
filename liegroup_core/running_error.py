# SPDX-License-Identifier: Apache-2.0
"""Running estimate of the global error of a simulation, from a companion with a larger step.

The companion follows the simulation with steps of q h, q = 4/3, under the same wrenches. The error of
a method of order p then follows from the distance d = |x_h - x_qh| of the two states:

    order seen     : d / (q^p - 1), the errors being c h^p and c (q h)^p
    order not seen : about d, the two errors being independent of each other

The estimate is SAFETY times a geometric mean of the two, with the weight SEEN on the first. For
q = 4/3 they are close enough to each other (a factor of 2 for p = 4, 9 for p = 8) that nothing has to
be decided. For q = 2 the factor is 15 and 255: whether the order is seen has to be found from a third
run, and is often found wrongly.

The two meet every OURS steps. An estimate is that of the last meeting, or FADING times the largest of
the last checkpoints if that is more: a distance may pass through zero where the error does not.
Checkpoints, every EVERY steps and more often at the start, depend on the step count alone, so that a
repeated run has bit-identical estimates. If the companion cannot continue, the estimate is infinite
from then on. Before the first meeting it is NaN.

Coverage, that is estimate against true error: benchmarks/coverage.py,
test/verification/test_running_error.py.
"""

import math

import numpy as np

from .compiling import kernel
from .engine import BAUMGARTE_STEPS, Engine
from .errors import SimulationError
from .integrators.methods import METHODS
from .lie.vec3 import dot3, load3, load9, sub3, tmatmul3
from .monitor.joint_watch import mechanism_size

OURS, THEIRS = 4, 3  # steps of the simulation and of its companion in the same time
RATIO = OURS / THEIRS
EVERY = 128  # steps between checkpoints, a multiple of OURS
WINDOW, FADING = 4, 0.5  # checkpoints
SAFETY, SEEN = 2.0, 0.7
# Of the mechanism's size, and rad: an error of this size makes a motion unpredictable.
UNPREDICTABLE = 0.1


@kernel
def distances(pose, twist, other_pose, other_twist, out):
    """Distances of two states per body, out (n, 4): m, rad, m/s, rad/s; twists in body axes."""
    for i in range(len(pose)):
        d = sub3(load3(pose, i, 9), load3(other_pose, i, 9))
        r = tmatmul3(load9(pose, i, 0), load9(other_pose, i, 0))
        x, y, z = 0.5 * (r[7] - r[5]), 0.5 * (r[2] - r[6]), 0.5 * (r[3] - r[1])
        w = sub3(load3(twist, i, 0), load3(other_twist, i, 0))
        v = sub3(load3(twist, i, 3), load3(other_twist, i, 3))
        out[i, 0] = math.sqrt(dot3(d, d))
        out[i, 1] = math.atan2(math.sqrt(x * x + y * y + z * z), 0.5 * (r[0] + r[4] + r[8] - 1.0))
        out[i, 2] = math.sqrt(dot3(v, v))
        out[i, 3] = math.sqrt(dot3(w, w))


class RunningError:
    """Estimate of the global error of an Engine; `follow` keeps it up to date.

    engine : Engine, whose state `follow` reads
    """

    def __init__(self, engine):
        self._engine = engine
        order = METHODS[engine.method].order
        self._factor = SAFETY / (RATIO**order - 1.0) ** SEEN
        self._size = mechanism_size(engine.layout.model) or 1.0
        self._companion = self._make_companion(RATIO * engine.step, RATIO**order)
        n = len(engine.layout.body_names)
        self._distance = np.zeros((n, 4))
        self._window = np.zeros((WINDOW, n, 4))
        self._compare()  # compiles it
        self.restart()

    def _make_companion(self, step, looser):
        """Engine of the same method with another step, and looser tolerances of error control."""
        engine = self._engine
        options = dict(engine.options)
        for name in {"rtol", "atol"} & options.keys():
            options[name] *= looser
        time = engine.baumgarte_time
        if engine.stabilisation == "baumgarte":
            time = max(step, BAUMGARTE_STEPS * engine.step if time is None else time)
        return Engine(
            engine.scene,
            engine.method,
            step,
            engine.group,
            engine.stabilisation,
            time,
            watch=False,
            quiet=True,
            **options,
        )

    def restart(self):
        """Forget the error so far: the state was set."""
        self._set_at = self._engine.steps
        self._start = None  # step at which the companion started
        self._alive = True
        self._distance[:] = self._window[:] = 0.0
        self._checkpoints = 0
        self.predictable_until = math.inf

    def next_stop(self, steps, end):
        """First step after `steps` at which `follow` must be called on the way to step `end`.

        The next checkpoint, otherwise the last meeting before the end.
        """
        if self._start is None:
            return min(end, (steps // OURS + 1) * OURS)
        checkpoint, meeting = self._next_checkpoint(steps), end // OURS * OURS
        return checkpoint if checkpoint <= end else meeting if meeting > steps else end

    def _next_checkpoint(self, steps):
        period, done = OURS, steps - self._start
        while period < EVERY and period <= done:
            period *= 2
        return self._start + (done // period + 1) * period

    def changed(self, changes):
        """Tell the companion of changes of the wrenches: [AppliedWrench]."""
        if self._start is not None and self._alive:
            for change in changes:
                self._companion.apply_wrench(
                    change.body, change.wrench, change.time, source=change.axes, axes=change.axes
                )

    def follow(self):
        """Advance the companion to the present step if they can meet, and estimate the error."""
        steps = self._engine.steps
        if not self._alive or steps % OURS:
            return
        if self._start is None:
            self._begin(steps)
            return
        try:
            self._companion.advance(steps // OURS * THEIRS - self._companion.steps)
        except SimulationError:
            self._alive = False
            self._distance[:] = np.inf
            self.predictable_until = min(self.predictable_until, self._engine.time)
            return
        self._compare()
        if steps == self._next:
            self._next = self._next_checkpoint(steps)
            self._keep()

    def _begin(self, steps):
        """Start the companion at the state of the engine."""
        engine, companion = self._engine, self._companion
        companion.set_state(*engine.state(), steps // OURS * THEIRS, engine.sample().angles)
        for body, axes, wrench in engine.acting():
            companion.apply_wrench(body, wrench, source=axes, axes=axes)
        self._start = steps
        self._next = self._next_checkpoint(steps)

    def _compare(self):
        distances(*self._engine.at_bodies(), *self._companion.at_bodies(), self._distance)

    def _keep(self):
        """Store the distance of a checkpoint."""
        self._window[self._checkpoints % WINDOW] = self._distance
        self._checkpoints += 1
        position, angle = self._factor * self._distance[:, :2].max(axis=0)
        if position > UNPREDICTABLE * self._size or angle > UNPREDICTABLE:
            self.predictable_until = min(self.predictable_until, self._engine.time)

    def errors(self):
        """(n, 4) estimates of the errors of the bodies: m, rad, m/s, rad/s."""
        if not self._checkpoints and self._alive and self._engine.steps != self._set_at:
            return np.full_like(self._distance, np.nan)
        return self._factor * np.maximum(self._distance, FADING * self._window.max(axis=0))
