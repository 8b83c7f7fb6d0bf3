# SPDX-License-Identifier: Apache-2.0
"""Watch over the step of a run: whether it is small enough for the motion that it is asked for.

Every so often a step h is compared with two steps h/2 from the same state. Of a method of order p
the difference is 1 - 2^-p of the error of the step. Its parts, over all bodies the largest of
    d = angle + way / L + (angular velocity + velocity / L) / Omega
are added up over the steps since the look before. L is the mechanism's size, Omega the rate at which
the motion turns or changes its direction, so far: errors of velocities act for about that long.
A sum that is some part of the motion so far is a doubt. Errors that grow by themselves, as in chaos,
are not in it: it is said of the steps, not of the motion.

A look takes two steps and some 30 us. It is made in steps that double in number, more often where
the sum is not far from a doubt, and changes nothing in the run, to the bit.
"""
import math

import numpy as np

from ..wrenches import NEVER
from ..integrators.methods import METHODS
from ..integrators.status import OK
from ..model.joint_watch import mechanism_size

# The sum is a doubt beyond this part of the motion: of how far bodies have gone, which counts as
# one radian at the most and, in the first steps, at the least.
PART, FIRST_STEPS = 0.02, 32
# Sums of less are rounding.
ROUNDING = 1e-11
# Steps to the next look: a part of those that the sum needs for a doubt, at this error a step.
AHEAD = 0.25
# A step is recommended at which the sum would have been this part of a doubt; so often halved.
AIM, HALVINGS = 0.1, 24


class StepWatch:
    """Looks at steps of an integrator on the way; says what is wrong, once."""

    def __init__(self, layout, method, step, integrator):
        self._integrator, self._method, self._step = integrator, method, step
        self._size = mechanism_size(layout.model) or 1.0
        self._share = 1.0 - 0.5 ** METHODS[method].order
        self.restart(0, None)

    def restart(self, steps, pose):
        """Another state: what the steps before did does not count."""
        self._first = self._last = self._next = steps
        self._start = None if pose is None else pose.copy()
        self._sum = self._error = self._extent = 0.0
        self._speed = self._change = self._turning = 0.0
        self._kept = None

    def next_look(self, steps):
        """The step after this one at whose start to look."""
        return max(self._next, steps + 1)

    def before(self, steps, pose, twist):
        """Called where a step of the run begins; True when this step is to be looked at."""
        if steps < self._next:
            return False
        integrator = self._integrator
        self._kept = (pose.copy(), twist.copy(), integrator.work.angle.copy(),
                      [array.copy() for array in integrator.memory])
        return True

    def after(self, steps, pose, twist, external):
        """Called after that step, at a step count; returns a line of text, or None if all is well."""
        start_pose, start_twist, _, _ = self._kept
        self._follow(start_twist, pose, twist)
        error = self._compare(self._step, pose, twist, external)
        since = steps - self._last
        self._sum += 0.5 * (self._error + error) * since if self._last > self._first else (
            error * since)
        self._error, self._last = error, steps
        done = steps - self._first
        motion = self._extent if done > FIRST_STEPS else 1.0
        limit = max(PART * motion, ROUNDING)
        if not self._sum <= limit:
            self._next = NEVER
            return self._text(external, limit, done)
        left = AHEAD * (limit - self._sum) / error if error > 0.0 else math.inf
        self._next = steps - 1 + int(max(1, min(left, done)))
        return None

    def _follow(self, before, pose, twist):
        """Take up how far the bodies have gone and how fast."""
        w, v = np.abs(twist[:, :3]).max(), np.abs(twist[:, 3:]).max() / self._size
        change = np.abs(twist - before)
        self._turning = max(self._turning, w)
        self._speed = max(self._speed, w, v)
        self._change = max(self._change, change[:, :3].max() / self._step,
                           change[:, 3:].max() / (self._size * self._step))
        turned, way = _apart(self._start, pose)
        self._way = max(way, self._size)
        self._extent = min(1.0, max(self._extent, turned, way / self._size))

    def _compare(self, h, pose, twist, external):
        """Error of a step h from the state kept; pose and twist are its end, or None."""
        end = (pose, twist) if h == self._step else self._take(h, 1, external)
        fine = self._take(0.5 * h, 2, external)
        if end is None or fine is None:
            return math.inf
        turned, way = _apart(fine[0], end[0])
        change = np.abs(fine[1] - end[1])
        rate = max(self._turning, self._change / self._speed if self._speed > 0.0 else 0.0)
        error = turned + way / self._way
        if rate > 0.0:
            error += max(change[:, :3].max(), change[:, 3:].max() / self._way) / rate
        return error / self._share

    def _take(self, h, steps, external):
        """State after steps from the one kept, or None; nothing of the run is changed."""
        integrator = self._integrator
        work = integrator.work
        report, angle = work.report.copy(), work.angle.copy()
        memory = [array.copy() for array in integrator.memory]
        pose, twist, old_angle, old_memory = self._kept
        pose, twist = pose.copy(), twist.copy()
        work.angle[:] = old_angle
        for array, old in zip(integrator.memory, old_memory):
            array[...] = old
        _, status = integrator.advance(h, steps, pose, twist, external)
        work.report[:], work.angle[:] = report, angle
        for array, old in zip(integrator.memory, memory):
            array[...] = old
        return (pose, twist) if status == OK else None

    def _text(self, external, limit, done):
        size = f"{100.0 * min(self._sum, 1.0):.2g} % of a radian" if limit == PART else (
            f"{100.0 * min(self._sum / self._extent, 1.0):.2g} % of what the motion is so far")
        begin = f"{self._method}, step {self._step:g} s: by t = {self._step * self._last:.6g} s "
        wrong = (f"its errors may have added up to {size}" if self._sum < math.inf else
                 "a step has no likeness to two of half its size")
        return f"{begin}{wrong}: {self._advice(external, limit, done)}"

    def _advice(self, external, limit, done):
        if METHODS[self._method].family == "rkmk" and len(self._integrator.memory):
            return "take smaller rtol and atol, or a smaller step"
        aim = AIM * limit / (done * self._step)         # error per time
        h = self._step
        for _ in range(HALVINGS):
            h *= 0.5
            if self._compare(h, None, None, external) <= aim * h:
                return f"from here steps of {h:.2g} s would keep that ten times smaller; take those"
        return "take a much smaller step"


def _apart(one, other):
    """Largest distance of poses (n, 12): rad, m."""
    gap = np.abs(one - other)
    return min(float(gap[:, :9].max()), math.pi), float(gap[:, 9:].max())
