# SPDX-License-Identifier: Apache-2.0
"""Watch over the step of a run: whether it is small enough for the motion that it is asked for.

Every so often a step h is compared with two steps h/2 from the same state; with error control,
with a step of smaller tolerances. Of a method of order p the difference is 1 - 2^-p of the error of
the step. The largest over all bodies of
    angle + way / l + max(angular velocity, velocity / l) / Omega
is added up over the steps since the look before. l is the mechanism's size, or how far its bodies
have gone if that is more; Omega is the rate at which the motion turns or changes its direction, so
far: errors of velocities act for about that long. Where nothing takes or gives energy, what it is
off by acts for ever: bodies whose kinetic energy is off by the part e run on by e/2 of their way,
which is added too. A sum that is some part of the motion so far is a doubt. So it is where a
component of the velocity that was small has become large, as at a separatrix, and the errors of the
steps, each as a part of what the component was then, add up to such a part. Errors that grow
otherwise, as in chaos, are not in it: it is about the steps, not about the motion.

A look takes two steps and some 60 us. It is made after steps that double in number, more often
where the sum is not far from a doubt or would not be if errors grew on as they do, and before a
step in which a spring may turn over, and where a glance finds that the energy has leapt; it changes
nothing in the run, to the bit. What it says and what it does not: docs/explanation/robustness.md.
"""

import math

import numpy as np

from liegroup_core.compiling import SameTypes
from liegroup_core.forces.schedule import NEVER
from liegroup_core.formulations.absolute.invariants import energy
from liegroup_core.integrators.methods import METHODS
from liegroup_core.status import OK

from .joint_watch import mechanism_size
from .middle_axis import MiddleAxis

# The sum is a doubt beyond this part of the motion: of how far bodies have gone, which counts as
# one radian at the most and, in the first steps, at the least.
PART, FIRST_STEPS = 0.02, 32
# Sums of less may be rounding. They are an error of the step if that falls with it as the order
# says, within this factor, at so many looks one after the other.
ROUNDING, LIKE_ORDER, LOOKS = 1e-11, 2.0, 3
# Of the energies, what is rounding.
ENERGY_ROUNDING = 1e-12
# A component of the velocity is small below this part of the fastest, rounding below the other.
# Where a small one would be in doubt if it grew, looks are this part of the steps so far apart.
SMALL, NONE, OFTEN = 0.05, 1e-12, 16
# Steps to the next look: a part of those that the sum needs for a doubt, at this error a step; or,
# if that has grown since the look before, growing on as fast.
AHEAD = 0.25
# Tolerances of error control that are compared with.
TIGHTER = 0.03
# A step is recommended that keeps the sum at this part of a doubt over the time so far, or over
# that of so many steps; it is the step halved so often.
AIM, LEAST_STEPS, HALVINGS = 0.1, 100, 24
# Steps between glances at the energy of mechanisms with loops, which have singular poses.
GLANCE = 500

MUCH = "take a much smaller step"
# Advice where one step, or what it does to an invariant, decides what comes after.
PASSED = (
    "the ends of a spring passed each other, where its line turns faster than the step can "
    "follow; take rkmk54, which takes steps as small as that needs, or a much smaller step"
)
LEAPT = (
    "the energy has leapt, as where a step passes a singular pose of the joints and goes on with "
    "other velocities; take a smaller step, or a method with stabilisation projection"
)
BACK = (
    "a body came back to its middle axis of inertia, where the least error decides how it "
    "turns on; take a smaller step, or a method of higher order"
)


class StepWatch:
    """Looks at steps of an integrator on the way; says what is wrong, once.

    on : False: it does not
    """

    def __init__(self, layout, method, step, integrator, on=True):
        self._integrator, self._method, self._step = integrator, method, step
        self._model = layout.model
        self._has_loops = bool(layout.model.pivot_floor.any())
        self._conservative = all(
            getattr(force, "damping", 1.0) == 0.0 for force in layout.scene.forces
        )
        self._size = mechanism_size(layout.model) or 1.0
        self._share = 1.0 - 0.5 ** METHODS[method].order
        self._controlled = getattr(integrator, "controlled", False)
        self._middle_axis = MiddleAxis(layout, step)
        self._energy_at = SameTypes(energy)
        # With error control the step becomes as small as it has to be.
        self._on = on
        self._waits = (
            on
            and not self._controlled
            and any(
                force.type == "spring_damper" and (force.damping > 0.0 or force.rest_length > 0.0)
                for force in layout.scene.forces
            )
        )
        self.restart(0, None)

    def restart(self, steps, pose):
        """Another state: what the steps before did does not count."""
        self._first = self._last = self._waits_from = steps
        self._next = steps if self._on else NEVER
        self._met, self._leapt, self._seen = None, None, steps
        self._start = None if pose is None else pose.copy()
        self._sum = self._error = self._extent = 0.0
        self._speed = self._change = self._turning = self._fastest = self._rate = 0.0
        self._kinetic, self._energy, self._off = 0.0, None, 0.0
        self._tiny = 0
        self._peak = self._relative = self._ratio = self._small = None
        self._delicate = False
        self._kept = None
        self._keeps_energy, self._pushed = self._conservative, False
        self._middle_axis.restart()

    def pushed(self):
        """A wrench from outside has come or gone: the energy is no more what it was."""
        self._keeps_energy, self._pushed = False, True

    def next_look(self, steps):
        """The step after this one at whose start to look."""
        if self._waits and steps < self._waits_from < self._next < NEVER:
            return self._waits_from
        if self._has_loops and self._keeps_energy and self._next < NEVER:
            return max(min(self._next, (steps // GLANCE + 1) * GLANCE), steps + 1)
        return max(self._next, steps + 1)

    def rest(self):
        """No more looks until there is another state: what is wrong has been said."""
        self._next = NEVER

    def waits(self, steps):
        """Whether to end a call before a step in which a spring may turn over."""
        return self._waits and self._waits_from <= steps and self._next < NEVER

    def met(self, steps):
        """The next step is such a one: look at it, but not at all of them."""
        if self._next < NEVER:
            self._next = self._met = steps
            self._waits_from = steps + (steps - self._first) // OFTEN

    def begins(self, steps, pose, twist):
        """Called where a step of the run begins; True when this step is to be looked at."""
        if steps < self._next:
            return False
        integrator = self._integrator
        self._kept = (
            pose.copy(),
            twist.copy(),
            integrator.work.angle.copy(),
            [array.copy() for array in integrator.memory],
        )
        return True

    def glance(self, steps, pose, twist):
        """Look at the next step where the energy is off by much: it has leapt since the last look.

        So it does where a step passes a singular pose and goes on with other velocities.
        """
        if (
            self._has_loops
            and steps % GLANCE == 0
            and self._next < NEVER
            and self._energy is not None
            and self._energy_error(pose, twist) > PART
        ):
            self._next = self._leapt = steps

    def ends(self, steps, pose, twist, external):
        """Called after that step, at a step count; a line of text, or None if all is well."""
        start_pose, start_twist, _, _ = self._kept
        self._follow(start_twist, pose, twist)
        error = self._compare(self._step, pose, twist, external)
        since = steps - self._last
        if self._last == self._first:
            self._error = error
        before = self._error
        off, self._off = self._off, self._energy_error(pose, twist)
        along = max(self._turning, self._fastest / self._way) * self._step
        if self._met == steps - 1:
            # It is this one step's error, not that of those before and after.
            self._sum += error
            error = before
        self._sum += 0.5 * since * (self._error + error + (off + self._off) * along)
        self._error, self._last = error, steps
        done = steps - self._first
        motion = self._extent if done > FIRST_STEPS else 1.0
        limit = PART * motion
        grown = self._grown(steps, done, pose, twist)
        back = 0.0 if self._pushed else self._middle_axis.look(twist)
        if max(grown, back) > PART > self._sum:
            self._sum, limit = max(grown, back), PART
        small = limit < self._sum <= ROUNDING
        if small:
            self._tiny = self._tiny + 1 if self._falls(error, external) else 0
        if not self._sum <= limit and (not small or self._tiny >= LOOKS):
            self._next = NEVER
            advice = (
                PASSED
                if self._met == steps - 1
                else LEAPT
                if self._leapt == steps - 1
                else BACK
                if back == self._sum
                else self._advice(external, limit, done)
            )
            return self._text(limit, advice)
        left = AHEAD * float(limit - self._sum) / error if error > 0.0 else math.inf
        if error > before > 0.0 and limit > self._sum:
            growth = math.log(error / before) / since
            left = min(left, math.log1p(growth * (limit - self._sum) / error) / growth * AHEAD)
        if not self._pushed:
            left = min(left, self._middle_axis.steps_to(PART))
        if small:
            left = done // OFTEN
        if self._delicate:
            left = min(left, done // OFTEN)
        self._next = steps - 1 + int(max(1, min(left, done)))
        return None

    def _follow(self, before, pose, twist):
        """Take up how far the bodies have gone and how fast."""
        change = np.abs(twist - before)
        self._turning = max(self._turning, float(np.abs(twist[:, :3]).max()))
        self._fastest = max(self._fastest, float(np.abs(twist[:, 3:]).max()))
        self._speed = max(self._turning, self._fastest / self._size)
        self._change = max(
            self._change,
            change[:, :3].max() / self._step,
            change[:, 3:].max() / (self._size * self._step),
        )
        self._rate = max(self._turning, self._change / self._speed if self._speed > 0.0 else 0.0)
        turned, way = _apart(self._start, pose)
        self._way = max(way, self._size)
        self._extent = min(1.0, max(self._extent, turned, way / self._size))

    def _compare(self, h, pose, twist, external):
        """Error of a step h from the state kept; pose and twist are its end, or None."""
        end = (pose, twist) if h == self._step else self._take(h, 1, external)
        if self._controlled:
            self._integrator.tighten(TIGHTER)
            fine = self._take(h, 1, external)
            self._integrator.tighten(1.0)
            if fine is None:
                return 0.0  # tolerances next to rounding: nothing is smaller
        else:
            fine = self._take(0.5 * h, 2, external)
        if end is None or fine is None:
            return math.inf
        turned, way = _apart(fine[0], end[0])
        self._change_of_twist = change = np.abs(fine[1] - end[1])
        error = turned + way / self._way
        if self._rate > 0.0:
            error += max(change[:, :3].max(), change[:, 3:].max() / self._way) / self._rate
        return float(error) / self._share

    def _grown(self, steps, done, pose, twist):
        """Errors of a component that was small and is not any more, as parts of it, added up.

        Or, if that is more, of components across the axis that a body spins about, such a part of
        the angle by which they have tilted it: a slow precession is a small velocity all the time.
        """
        if done <= FIRST_STEPS or not self._speed > 0.0 or self._met == steps - 1:
            return 0.0
        since, self._seen = steps - self._seen, steps
        size = np.abs(twist)
        part = size / self._speed
        part[:, 3:] /= self._way
        if self._peak is None:
            self._peak, self._small = size, part < SMALL
            self._relative = np.zeros_like(size)
            fastest = size[:, :3].max(axis=1, keepdims=True)
            self._across = self._small[:, :3] & (size[:, :3] < SMALL * fastest)
            self._spins = size[:, :3].argmax(axis=1)
            self._ratio = _parts(self._change_of_twist, size)
            return 0.0
        np.maximum(self._peak, size, out=self._peak)
        ratio = _parts(self._change_of_twist, self._peak)
        self._relative += 0.5 * since / self._share * (self._ratio + ratio)
        self._ratio = ratio
        may_grow = self._small & (part > NONE)
        self._delicate = bool((may_grow & (self._relative + done * ratio > PART)).any())
        grown = self._relative[self._small & (part > SMALL)].max(initial=0.0)
        return max(float(grown), self._tilted(pose))

    def _tilted(self, pose):
        """Errors of the angles by which spinning bodies have tilted, rad."""
        counts = (
            self._across & (self._relative[:, :3] > PART) & (self._peak[:, :3] > NONE * self._speed)
        )
        if not counts.any():
            return 0.0
        wrong = -np.expm1(-self._relative[:, :3]) * counts
        bodies = np.arange(len(pose))
        axes, starts = (
            given[:, :9].reshape(-1, 3, 3)[bodies, :, self._spins] for given in (pose, self._start)
        )
        sine = np.linalg.norm(np.cross(axes, starts), axis=1)
        across = np.where(self._across, self._peak[:, :3], 0.0)
        share = _parts(across, np.broadcast_to(across.max(axis=1, keepdims=True), across.shape))
        return float((wrong * share * sine[:, None]).max())

    def _falls(self, error, external):
        """Whether the error of the step kept falls with the step as the order says, twice."""
        due = 2.0 ** (METHODS[self._method].order + 1)
        for h in (0.5 * self._step, 0.25 * self._step):
            finer = self._compare(h, None, None, external)
            if not due / LIKE_ORDER < error / (finer or math.inf) < due * LIKE_ORDER:
                return False
            error = finer
        return True

    def _energy_error(self, pose, twist):
        """Half of what the energy is off by, as a part of the largest kinetic energy so far."""
        if not self._keeps_energy:
            return 0.0
        bodies = self._model.bodies
        momentum = np.einsum("nij,nj->ni", bodies["inertia"].reshape(-1, 3, 3), twist[:, :3])
        self._kinetic = max(
            self._kinetic,
            0.5
            * float(
                (momentum * twist[:, :3]).sum() + bodies["mass"] @ (twist[:, 3:] ** 2).sum(axis=1)
            ),
        )
        now = self._energy_of(self._integrator.work.angle, pose, twist)
        if self._energy is None:
            start_pose, start_twist, angle, _ = self._kept
            self._energy = self._energy_of(angle, start_pose, start_twist)
        off = abs(now - self._energy) - ENERGY_ROUNDING * (abs(now) + abs(self._energy))
        return 0.5 * off / self._kinetic if off > 0.0 and self._kinetic > 0.0 else 0.0

    def _energy_of(self, angle, pose, twist):
        pose, twist = pose.view(), twist.view()
        # As in a Sample: one compiled function serves both, and none is compiled on the way.
        pose.flags.writeable = twist.flags.writeable = False
        return self._energy_at(self._model, angle, pose, twist)

    def _take(self, h, steps, external):
        """State after steps from the one kept, or None; nothing of the run is changed."""
        integrator = self._integrator
        work = integrator.work
        report, angle = work.report.copy(), work.angle.copy()
        memory = [array.copy() for array in integrator.memory]
        pose, twist, old_angle, old_memory = self._kept
        pose, twist = pose.copy(), twist.copy()
        work.angle[:] = old_angle
        work.report[3] = 0.0
        for array, old in zip(integrator.memory, old_memory):
            array[...] = old
        _, status = integrator.advance(h, steps, pose, twist, external)
        work.report[:], work.angle[:] = report, angle
        for array, old in zip(integrator.memory, memory):
            array[...] = old
        return (pose, twist) if status == OK else None

    def _text(self, limit, advice):
        share = self._sum if limit == PART else self._sum / self._extent
        size = f"{100.0 * min(share, 1.0):.2g} % of " + (
            "a radian" if limit == PART else "the motion"
        )
        begin = f"{self._method}, step {self._step:g} s: by t = {self._step * self._last:.6g} s "
        wrong = (
            f"its errors may have added up to {size}"
            if self._sum < math.inf
            else "a step has no likeness to two of half its size"
        )
        return f"{begin}{wrong}: {advice}"

    def _advice(self, external, limit, done):
        if self._controlled:
            return "take smaller rtol and atol, or a smaller step"
        time = max(done, LEAST_STEPS) * self._step
        h = self._step
        keeps = f"keep that to {100 * AIM * PART:.2g} % for {time:.3g} s; take those"
        if getattr(self._integrator, "swings_in", False):  # one such step tells nothing
            h *= (AIM * limit * h / (self._error * time)) ** (1.0 / METHODS[self._method].order)
            return f"steps of {h:.2g} s would, by its order, {keeps}" if h > 0.0 else MUCH
        for _ in range(HALVINGS):
            h *= 0.5
            if self._compare(h, None, None, external) * time <= AIM * limit * h:
                return f"from here steps of {h:.2g} s would {keeps}"
        return MUCH


def _parts(change, size):
    """Changes over sizes; none where there is no size."""
    return np.divide(change, size, out=np.zeros_like(size), where=size > 0.0)


def _apart(one, other):
    """Largest distance of poses (n, 12): rad, m."""
    gap = np.abs(one - other)
    return min(float(gap[:, :9].max()), math.pi), float(gap[:, 9:].max())
