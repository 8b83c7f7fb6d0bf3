# SPDX-License-Identifier: Apache-2.0
"""Running estimate of the global error of a simulation, from a companion with a larger step.

The companion is a second run under the same wrenches with steps of q h, q = 4/3, or 6/5 for orders from 8.
With error control its tolerances are larger, so that its substeps are q times as long, q = 4/3, or sqrt(2) for an
implicit method and with an accuracy. error_estimate.py derives the error from the distance of the two.

The estimate is at least a fraction of this distance. The fraction is below 1 where, as measured, the distance
is more often far above the error than below it: with order 8, whose errors fall faster than h^8 before they
are round-off, and with error control, whose substeps sometimes differ by more than q.

The two meet every 4 or 6 steps. If an estimate is read in between, the companion advances to the present time,
by whole steps and a part of one. Checkpoints follow after MEETINGS meetings, more
often at the start. They depend only on the step count, so that a repeated run has bit-identical estimates.

With an accuracy the round-off of the companion is larger by the same factor as its tolerances, q^8 = 2^BITS. If
steps are so small that all error is round-off, as near a separatrix, two runs of the same precision differ by the
error of either, and the estimate would be less than half of their distance.

With an accuracy both run ahead (methods/munthe_kaas/ahead.py): their substeps follow their tolerances alone, and
their states at any time are those of interpolants, whose errors are part of the distance. Checkpoints follow after
up to SUBSTEPS substeps, and earlier where the distance grows fast. In between, the two are compared when an estimate
is read, and PART of the horizon after the last look; an estimate above the accuracy makes that a checkpoint, too.
An event is a common time of both. Up to it the companion takes smaller steps, and after it a smaller one first,
because equal steps have equal errors. There the companion's error may be the smaller one, so that with events all of
the distance counts. So it does once a substep was near a singular pose, or had an error far above the expected one, as
where a force jumps: there the order is not seen. A substep that would be the same for both is divided by the companion
(error_control.DIVIDED).

Instants of sampled laws end many steps of both, so that errors of the companion would be larger in some and smaller in
others, and could cancel. There, without error control, its steps are half as long, and the distance is the error.

With error control and without an accuracy, the companion takes one step for four of the simulation. With equal
steps the last substep, which ends with the step, would often make the substeps of both equal. Its substeps are at
most 4/3 of a step, because it would step over contacts that the simulation meets. In parts of steps, which changes of
the inputs end, it is more accurate than the simulation, and all of the distance counts (error_control.unlike).

If the companion cannot continue, the estimate is infinite from then on. Before the first meeting it is NaN.

Errors common to both runs at any step are invisible: see methods/added_inertia.py, and endless impacts that
become plastic although they would continue (LOST_REBOUND). Then the estimate is infinite.

Coverage, that is estimate against true error: benchmarks/estimate_coverage.py,
test/verification/test_running_error.py.
"""

import math
from fractions import Fraction

import numpy as np

from liegroup_core.compiling import SameTypes, warm_up
from liegroup_core.engine import BAUMGARTE_STEPS, Engine
from liegroup_core.error_estimate import UNPREDICTABLE, ErrorEstimate
from liegroup_core.errors import SimulationError
from liegroup_core.methods.added_inertia import AddedInertia
from liegroup_core.methods.munthe_kaas.error_control import BITS, RATIO
from liegroup_core.methods.table import METHODS
from liegroup_core.observables.distances import distances
from liegroup_core.settings import of_engine

HIGH = 8  # order from which the steps of both are more similar
FIRST_MEETINGS, MEETINGS = 2, 48  # between two checkpoints, from the second one on
SUBSTEPS = 32  # between checkpoints with an accuracy, at most
# Growth of the distance between two checkpoints with an accuracy, up to which the next one comes later, and above which
# it comes earlier.
CALM, FAST = 2.0, 4.0
LAG = 4  # steps after which the companion follows with an accuracy, which spreads its work; past changes at once
PART = 0.05  # of the horizon, between two looks at the estimate: errors may rise and fall between checkpoints
# rad, or relative to the characteristic length: above it, a rebound that became plastic makes the estimate
# infinite. Bouncing that comes to rest by itself is far below it when its impacts are that dense.
LOST = "the second run, which shows the error, cannot go on"  # where the estimate is infinite
LOST_REBOUND = 1e-7
PARTS = 2  # of a companion's step with sampled laws, and up to an event, whose size does not depend on other steps
# Fraction of the distance that counts if the order is not seen.
LEAST, LEAST_HIGH = 1.0, 0.75
CONTROLLED = 0.5  # the same with error control
EVENTS = 1.0  # with events: up to one the companion takes smaller steps, and the distance is the error
EXPLICIT_RATIO = 4.0 / 3.0  # q of given tolerances of an explicit method; else RATIO


class RunningError:
    """Estimate of the global error of an Engine; `update` keeps it up to date.

    engine  : Engine, whose state `update` reads
    horizon : s, of an accuracy: checkpoints follow the number of substeps; None: no accuracy

    estimate : ErrorEstimate
    lost     : cause of an infinite estimate, in words
    calm_until : step before which `update` has nothing to do
    """

    KEPT = (
        *("_set_at", "_start", "_next", "_block", "_substeps", "_alive", "_failed"),
        *("_origin", "estimate", "_companion", "lost"),
    )

    def __init__(self, engine, horizon=None):
        self.engine = engine
        self._by_work = by_work = horizon is not None
        self._look = max(1, int(PART * horizon / engine.step)) if by_work else 0
        self._lag = 1 if engine.layout.switches else LAG
        method = METHODS[engine.method]
        order, controlled = method.order, method.controlled
        # Steps of the engine and of its companion in the same time.
        self.ours, self._theirs = (1, 1) if by_work else (4, 1) if controlled else (4, 3) if order < HIGH else (6, 5)
        if controlled:
            ratio = RATIO if by_work or method.implicit else EXPLICIT_RATIO
            least = EVENTS if by_work and engine._switching is not None else CONTROLLED
        else:
            ratio, least = self.ours / self._theirs, LEAST if order < HIGH else LEAST_HIGH
        self.ratio, self.size = ratio, engine.layout.size
        if len(engine.layout.model.forces.laws.held) and not controlled:
            self._theirs *= PARTS
        step = self.ours / self._theirs * engine.step
        self._companion = self._make_companion(step, ratio**method.power if controlled else 1.0)
        if controlled and not by_work:
            self._companion.limit_substeps(EXPLICIT_RATIO * engine.step, ratio)
        elif by_work:  # at the start, where substeps grow by the same factor, those of the two must not be equal
            self._companion.limit_substeps(ratio * engine.step)
        if by_work:
            for integrator, bits in zip(self.integrators, (0, BITS)):
                integrator.follow_accuracy(self.size, bits)
            warm_up(self._touch)
        n = len(engine.layout.body_names)
        self.estimate = ErrorEstimate(n, self.size, ratio, order, least)
        # Pose from which the motion of bodies is measured, and distances between two meetings.
        self._origin, self._at_rest = np.zeros((n, 12)), np.zeros((n, 6))
        self._seen = np.zeros((n, 4))
        self._distances = SameTypes(distances)
        self._added = AddedInertia.of(METHODS[engine.method], engine.layout.model)
        self._compare()  # compiles it, as does the next call
        self._watch_motion()
        self.restart()

    def _touch(self):
        """Call the kernel that runs ahead once, so that it is not compiled during a run."""
        for engine in (self.engine, self._companion):
            engine._integrate(engine.now, engine.step, 0, engine.now)
            engine._integrator.restart()

    def _make_companion(self, step, looser):
        """Engine of the same method with another step, and looser tolerances of error control."""
        engine = self.engine
        options = dict(engine.options)
        for name in {"rtol", "atol"} & options.keys():
            options[name] *= looser
        time = engine.baumgarte_time
        if engine.stabilisation == "baumgarte":
            time = max(step, BAUMGARTE_STEPS * engine.step if time is None else time)
        options |= of_engine(engine) | {"step": step, "baumgarte_time": time}
        companion = Engine(engine.scene, engine.method, quiet=True, layout=engine.layout, **options)
        if engine._switching is not None or not METHODS[engine.method].controlled:
            companion.events.divide(PARTS)
        companion.inputs.log = None  # nothing reads it
        companion.events.leave_contacts_out()
        return companion

    def restart(self):
        """Clear the estimate, because the state was set."""
        self._set_at = self.engine.steps
        self._start, self._next = -1, 0  # steps at which the companion started (-1: not yet), and meets next
        self._block = self._substeps = 0  # steps to the next checkpoint, substeps at the last one
        self._alive, self._failed, self.lost = True, False, LOST
        self.estimate.restart(self.engine.time)
        self.restored()

    def next_stop(self, steps, end):
        """First step after `steps` at which `update` must be called on the way to step `end`.

        The next checkpoint, otherwise the last meeting before the end.
        """
        if not self._alive:
            return end
        if not self.begun:
            return min(end, (steps // self.ours + 1) * self.ours)
        if self._by_work:
            return min(self._next, end, (steps // self._look + 1) * self._look)
        if self._next <= end:
            return self._next
        meeting = end // self.ours * self.ours
        return meeting if meeting > steps else end

    def _next_checkpoint(self, steps):
        if self._by_work:
            return steps + self._block
        period, done = FIRST_MEETINGS * self.ours, steps - self._start
        if done == 0:
            return self._start + self.ours
        while period < MEETINGS * self.ours and period <= done:
            period = min(4 * period, MEETINGS * self.ours)
        return self._start + (done // period + 1) * period

    def update(self):
        """Advance the companion to the present step if they can meet, and estimate the error."""
        self._meet_at(steps := self.engine.steps)
        self.calm_until = 0
        if self._by_work and self.begun and self._alive:
            other = self._companion
            enough = max(other.steps + self._lag, int(other.lead[0]) + 1)
            self.calm_until = min(enough, self._next, (steps // self._look + 1) * self._look)

    def _meet_at(self, steps):
        engine = self.engine
        # Between checkpoints the companion only advances, which spreads its work.
        between = self._by_work and self.begun and steps != self._next
        follows = between and self._companion.changes_before(steps)
        if between and not follows and steps - self._companion.steps < self._lag:
            return
        if engine.events.lost_rebound > LOST_REBOUND and not self._failed:
            self._failed, self.lost = True, "impacts without end became plastic"
        if not self._alive or steps % self.ours:
            return
        if not self.begun:
            self._begin(steps)
            return
        meeting = steps // self.ours * self._theirs
        if self._companion.steps == meeting and steps != self._next:
            return
        if between and not follows and self._companion.covers_step(meeting):
            return
        if not self._failed:
            try:
                self._send(self._companion.instant_inside(meeting, 0))
            except SimulationError as error:
                self._fail(error)
        if not self._failed and self._companion.steps < meeting:
            return  # it was halted, too
        if steps != self._next:
            return  # which meetings there are depends on the calls
        if self._failed:
            self._alive = False
            self._lead()
            self.estimate.set_infinite()
            self._keep()
            return
        self.weigh()
        self._compare()
        if self._added is not None:
            since = steps - self._set_at
            if self._added.wrong_turn(engine._twist, engine.step, since) > UNPREDICTABLE:
                self.lost = "the added inertia of a body changes its rotation"
                self.estimate.set_infinite()
        self._keep()
        if self._by_work:
            self._adapt()
        self._next = self._next_checkpoint(steps)

    def weigh(self):
        """Count all of a distance where the order is not seen.

        With an accuracy: with an implicit method, whose interpolant has low order, once a force jumped, and once a
        singular pose was near. With given tolerances: once the companion took a part of a step. Call it at checkpoints:
        between them a run may be ahead.
        """
        if self._by_work:
            present = self.integrators[0]
            self.estimate.whole = present.chosen != 0 or present.jumps > 0  # 0: the explicit method
        elif METHODS[self.engine.method].controlled:
            self.estimate.whole = self.integrators[1].jumps > 0

    def make_checkpoint(self):
        """Make the present step, which is before the next checkpoint, a checkpoint."""
        self._block -= self._next - self.engine.steps
        self._next = self.engine.steps
        self.update()

    def meet(self):
        """Bring the companion to the present time, so that a state depends on its time alone."""
        if self._by_work and not self.begun:
            self.update()
        if self._alive and self.begun and not self._failed:
            try:
                self._follow()
                self._companion.settle()
            except SimulationError:
                self._companion.now = self._companion.base  # wherever it stood before

    def _fail(self, error):
        """The companion has ended: what another attempt finds depends on this one."""
        self._failed, self.lost = True, f"{LOST}: {error}"
        self._companion.now = self._companion.base  # wherever it stood before

    def _send(self, instant):
        """Advance the companion to an Instant of its own. Raises SimulationError."""
        other = self._companion
        if instant > other.now and not other.serves(instant.step):
            other._stand(other.base, other.base)  # an error names the last valid state, not that of a read
        other._go(instant)

    def _follow(self):
        """Advance the companion to the present time. Raises SimulationError."""
        now, other = self.engine.now, self._companion
        if not self._by_work:  # its steps are others
            whole, part = divmod(now.step * self._theirs, self.ours)
            if now.offset:
                now = other.instant_of(self.engine.time_ns)
            else:
                now = other.instant_inside(whole, Fraction(part, self.ours))
        try:
            self._send(now)
        except SimulationError as error:
            # Else the part of a step up to this time failed, which no other one depends on.
            if other.base.step < now.step or other.inputs.schedule.next_after(other.base) < now:
                self._fail(error)
            raise

    def _adapt(self):
        """Set the number of steps to the next checkpoint from the substeps since the last one."""
        substeps = self.engine.substeps[0]
        work, self._substeps = substeps - self._substeps, substeps
        growth = self.estimate.growth
        longest = 2 * self._block if growth < CALM else self._block if growth < FAST else self._block // 2
        if longest * work > SUBSTEPS * self._block:
            longest = SUBSTEPS * self._block // work
        self._block = max(1, longest)

    def _begin(self, steps):
        """Start the companion at the state of the engine."""
        engine = self.engine
        begin = engine.now if self._by_work else self._companion.instant_inside(steps // self.ours * self._theirs, 0)
        self._companion.start_from(engine, begin)
        # Substeps count from the start, where those for states after it, which may have been read, do not count.
        self._start, self._block, self._substeps = steps, self.ours, 0
        self._lead()
        self._origin[:] = engine.here()[0]
        self._watch_motion()
        self._next = self._next_checkpoint(steps)

    def _compare(self):
        self.estimate.largest = self._measure(self._companion.here(), self.estimate.distance)

    def _measure(self, other, out):
        """Distances of the engine from another state; returns the largest m and rad."""
        own = self.engine
        return self._distances(own.layout.offsets.com, *own.here()[:2], *other[:2], out)

    def _now(self):
        """Distances at the present time, to which the companion advances, and their largest m and rad."""
        now = self.engine.now
        if not (self._alive and self.begun):
            return self.estimate.distance, self.estimate.largest
        if self._seen_at != now:
            if self._companion.is_halted:  # it does not get there
                self._seen[:] = math.nan
                return self._seen, (math.nan, math.nan)
            self._seen_largest = self._look_there(self._seen)
            self._seen_at = now
        return self._seen, self._seen_largest

    def _look_there(self, out):
        if self._failed:
            out[:] = math.inf
            return math.inf, math.inf
        try:
            self._follow()
            return self._measure(self._companion.here(), out)
        except SimulationError:
            out[:] = math.inf
            return math.inf, math.inf

    def error_ahead(self):
        """Estimated error after one step more with the present tolerances; inf if it cannot be computed.

        NaN after SUBSTEPS substeps or fewer: a checkpoint after them is early enough; and after events, which are the
        same for both.
        """
        engine, ended = self.engine, (self._failed, self.lost)
        with engine._aside(Engine.MOTION), self._companion._aside(Engine.MOTION):
            before, events = engine.substeps[0], engine.event_count
            try:
                Engine._go(engine, engine.instant_inside(engine.steps + 1, 0))
            except SimulationError:
                return math.inf
            if engine.substeps[0] - before <= SUBSTEPS or engine.event_count > events:
                return math.nan
            found = self.estimate.largest_error(self._look_there(np.empty_like(self._seen)))
            self._failed, self.lost = ended  # of an attempt
            return found

    def _watch_motion(self):
        """Update the largest distance of each body from its start, and its largest velocities."""
        self._measure((self._origin, self._at_rest), self._seen)
        self._seen_at = None
        self.estimate.note_motion(self._seen)

    def _keep(self):
        """Make the present meeting a checkpoint."""
        if not self._by_work:
            self._watch_motion()
        self.estimate.keep(self.engine.time)

    @property
    def first_step(self):
        """Step at which the two first meet after the state was set."""
        return (-(-self._set_at // self.ours) + 1) * self.ours

    @property
    def looks(self):
        """Whether a run that is ahead is at a time for a look, after its last checkpoint."""
        steps = self.engine.steps
        goes_on = self.begun and self._alive and self._by_work
        return goes_on and steps % self._look == 0 and steps > self._next - self._block

    @property
    def begun(self):
        """Whether the companion has started from the state that was set."""
        return self._start >= 0

    @property
    def companion(self):
        """Engine of the companion."""
        return self._companion

    @property
    def integrators(self):
        """Integrators of the engine and of its companion."""
        return self.engine._integrator, self._companion._integrator

    @property
    def largest(self):
        """Largest estimated error of a pose, relative to the characteristic length or in rad."""
        if self._unknown:
            return math.nan
        return self.estimate.largest_error(self._now()[1])

    def restored(self):
        """Continue after `set_kept`, at the same state of the engine."""
        self._seen_at, self.calm_until = None, 0
        self._lead()

    def _lead(self):
        """Pass new commands to the companion if it has started and goes on."""
        self.engine.inputs.follower = self._companion.inputs if self.begun and self._alive else None

    def errors(self):
        """(n, 4) estimates of the errors of the bodies: m, rad, m/s, rad/s."""
        return self._nothing() if self._unknown else self.estimate.errors(self._now()[0])

    def _nothing(self):
        return np.full_like(self._seen, np.nan)

    @property
    def _unknown(self):
        """Whether the two have not met since the state was set; up to then both may take the same part of a step."""
        now = self.engine.now
        since = now > self.engine.instant_inside(self._set_at, 0)
        return self._alive and since and not self._by_work and now.step < self.first_step
