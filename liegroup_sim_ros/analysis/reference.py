# SPDX-License-Identifier: Apache-2.0
"""Global error of a recorded run: distance to a reference integration.

It is independent of the engine (liegroup_core.reference) and starts at the recorded initial
state of each stretch. A stretch is a part of the recording between resets or set states.
"""

import numpy as np

from liegroup_core.errors import SimulationError
from liegroup_core.forces.commands import PULL, WRENCH
from liegroup_core.reference import JointChange, PullSpan, Reference, Trajectory, WrenchSpan, distance
from liegroup_core.reference.trajectory import MOST_STEPS
from liegroup_sim_ros.numbers import counted, shown
from liegroup_sim_ros.playback.rerun import Starts

from .drift import MOST_POINTS, extremes

# (name in Distance, unit)
QUANTITIES = (("position", "m"), ("attitude", "1"), ("angle", "rad"), ("angular", "rad/s"), ("linear", "m/s"))


class Errors:
    """Largest and final errors of trajectories, and their curves.

    promise  : analysis.promise.Promise that checks these errors, or None
    estimate : analysis.estimate.Estimate that is compared with these errors, or None
    """

    def __init__(self, expected, promise=None, estimate=None):
        self._promise, self._estimate = promise, estimate
        self._every = -(-expected // MOST_POINTS)
        self._max = dict.fromkeys((name for name, _ in QUANTITIES), 0.0)
        self._final, self._known = {}, dict(self._max)
        self._curves = {}

    def add(self, stretch, times, log_times, error, uncertainty, estimates=None):
        """Add error and uncertainty, two Distances at k times of a Stretch.

        estimates : (k, n, 4) recorded estimates of the error, or None
        """
        if self._promise is not None:
            self._promise.add(stretch, times, error, uncertainty)
        if estimates is not None:
            if stretch.start != 0:  # estimates then include earlier parts of the run; this error does not
                estimates = np.full_like(estimates, np.nan)
            if self._estimate is not None:
                self._estimate.compare(estimates, error, uncertainty)
        for name, _ in QUANTITIES:
            values, known = getattr(error, name), getattr(uncertainty, name)
            self._max[name] = float(np.maximum(self._max[name], values.max()))
            self._known[name] = float(np.maximum(self._known[name], known.max()))
            self._final[name] = float(values[-1].max())
        worst = error.position.max(axis=1), error.angle.max(axis=1)
        rows = np.union1d(*(extremes(part, self._every) for part in worst))
        self._curves.setdefault(id(stretch), []).append(
            tuple(
                part[rows]
                for part in (
                    log_times,
                    *worst,
                    uncertainty.position.max(axis=1),
                    uncertainty.angle.max(axis=1),
                    *(() if estimates is None else estimates.max(axis=1).T[:2]),
                )
            )
        )

    def figures(self, **more):
        """(figures, [(times, position error, angle error, uncertainty of the two)]).

        If estimates of both errors were recorded, they are the last two entries of a curve.
        """
        found = {
            name: {
                "unit": unit,
                "max": self._max[name],
                "final": self._final.get(name, 0.0),
                "uncertainty": self._known[name],
            }
            for name, unit in QUANTITIES
        }
        curves = [tuple(np.concatenate(part) for part in zip(*parts)) for parts in self._curves.values()]
        return found | more, curves


class ReferenceError:
    """Distance to a reference integration, with its uncertainty.

    The uncertainty is the distance between reference integrations with two tolerances.

    seconds : simulated time to cover, summed over all stretches
    steps   : maximum number of its steps, summed over all stretches
    promise, estimate : see Errors
    keep    : function that gets (log times, Trajectory) of the reference, or None
    tell    : function that is called with the simulated time covered so far, s
    """

    def __init__(
        self,
        layout,
        recording,
        expected,
        seconds=np.inf,
        promise=None,
        estimate=None,
        steps=MOST_STEPS,
        keep=None,
        tell=lambda seconds: None,
    ):
        self._scene, self._starts = layout.scene, Starts(recording, layout)
        self._unit_efforts = layout.unit_efforts
        self._left, self._judged = seconds, 0.0
        self._steps = self._steps_left = steps
        self._stopped, self._keep, self._tell = None, keep, tell
        self._errors = Errors(expected, promise, estimate)
        self._stretch = self._reference = None

    def add(self, block):
        """Add a Block."""
        stretch = block.stretch
        if stretch is not self._stretch:
            if self._reference is not None:
                self._steps_left -= self._reference.steps
            self._stretch, self._start = stretch, stretch.start * stretch.step
            self._end = self._start + self._left
            self._reference = None
        times = block.times
        k = int(np.searchsorted(times, self._end, "right"))
        if k == 0 or self._stopped:
            return
        if self._reference is None:
            changes = self._wrenches(stretch) + self._changes(stretch)
            pose, twist, angles = self._starts.of(stretch)
            self._reference = Reference(
                self._scene, pose, twist, changes, self._start, angles=angles, most_steps=self._steps_left
            )
        exact, uncertainty = self._reference.up_to_limit(
            times[:k], lambda time: self._tell(self._judged + time - self._start)
        )
        if len(exact.times) < k:
            k = len(exact.times)
            at = stretch.base_ns * 1e-9 + (float(times[k - 1]) if k else self._start)
            reason = self._reference.stopped
            if self._reference.steps >= self._steps_left:
                limit = counted(self._steps, "step")
                reason = (
                    f"the reference integration reached its limit of {limit}; use --reference-steps for a larger one"
                )
            self._stopped = f"the error is known up to {shown(at, 's')} only: {reason}"
            if k == 0:
                return
        reached = float(times[k - 1])
        self._left, self._judged = self._end - reached, self._judged + reached - self._start
        self._start = reached
        error = distance(Trajectory(times[:k], block.rotation[:k], block.position[:k], block.twist[:k]), exact)
        if self._keep is not None:
            self._keep(block.log_times[:k], exact)
        estimates = None if block.errors is None else block.errors[:k]
        self._errors.add(stretch, times[:k], block.log_times[:k], error, uncertainty, estimates)

    def _wrenches(self, stretch):
        """[WrenchSpan and PullSpan] of a stretch that start before the end of the reference."""
        found = []
        start, end, numbers = stretch.inputs.spans()
        for first, last, k in zip(stretch.seconds_of(start), stretch.seconds_of(end), numbers.tolist()):
            if first > self._end:
                break
            command = stretch.inputs[k]
            if command.kind == WRENCH:
                found.append(WrenchSpan(first, last, command.name, command.values, command.axes, command.point))
                continue
            if command.kind == PULL:
                stiffness, damping, *rest = command.values
                given = rest[:3], stiffness, damping, command.point, rest[3:6], rest[6]
                found.append(PullSpan(first, last, command.name, *given))
                continue
            for body, unit in self._unit_efforts[command.name]:
                wrench = tuple((command.values[0] * unit).tolist())
                found.append(WrenchSpan(first, last, stretch.bodies[body], wrench))
        return found

    def _changes(self, stretch):
        """[JointChange] of a stretch up to the end of the reference."""
        found = []
        for joints, times, values in stretch.changes.values():
            when = stretch.in_steps(times) * stretch.step
            upto = int(np.searchsorted(when, self._end, "right"))
            for time, rows in zip(when[:upto].tolist(), values[:upto].tolist()):
                found += [
                    JointChange(time, joint, tuple(row)) for joint, row in zip(joints, rows) if np.isfinite(row[0])
                ]
        return found

    def figures(self):
        """(figures, curves), see Errors. Raises SimulationError if no error is known."""
        if self._stopped and not self._judged:
            raise SimulationError(self._stopped)
        return self._errors.figures(kind="integration", seconds=self._judged, stopped=self._stopped)
