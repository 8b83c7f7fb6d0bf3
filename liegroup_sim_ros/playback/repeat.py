# SPDX-License-Identifier: Apache-2.0
"""Repetition of a recorded run from its initial state and wrenches, compared bit for bit."""

import numpy as np
import scipy

from liegroup_core import SimulationError
from liegroup_core.forces.instants import NS
from liegroup_core.observables.along import quaternions
from liegroup_core.reference import Trajectory, distance

from .rerun import Rerun

# Tolerance, in steps, when samples are matched to whole steps of another step size.
ROUNDING = 1e-6


class Repeat:
    """Repetition of a recorded simulation that compares every number of every sample.

    simulation : Simulation with the recorded settings, or with other settings to measure their effect
    work       : limit of its steps, see rerun.WorkLimit
    """

    def __init__(self, recording, simulation, work=None):
        self._simulation, self._rerun = simulation, Rerun(recording, simulation, work)
        self._stretch = None
        self._samples = self._identical = 0
        self._first, self._stopped = None, None
        self._largest = np.zeros(4)  # m, rad, rad/s, m/s

    def add(self, block):
        """Simulate and compare the samples of a Block."""
        if block.stretch is not self._stretch:
            self._stretch, self._broken = block.stretch, False
            self._rerun.begin(block.stretch)
        self._samples += len(block.steps)
        if self._broken:
            return
        pose, twist = self._states(block)
        k = len(pose)
        offsets = self._simulation.layout.offsets
        if not offsets.none:  # sample by sample, as in the recorded run: same round-off
            for row in range(k):
                pose[row], twist[row] = offsets.to_bodies(pose[row], twist[row])
        quaternion = quaternions(pose)
        same = (
            _same(quaternion, block.quaternion[:k])
            & _same(pose[..., 9:], block.position[:k])
            & _same(twist, block.twist[:k])
        )
        identical = same.all(axis=1)
        self._identical += int(identical.sum())
        if identical.all():
            return
        if self._first is None:
            row = int(np.argmin(identical))
            self._first = {"at_s": float(block.log_times[row]), "body": block.stretch.bodies[int(np.argmin(same[row]))]}
        rotation = scipy.spatial.transform.Rotation.from_quat(quaternion.reshape(-1, 4)).as_matrix()
        apart = distance(
            Trajectory(None, rotation.reshape(k, -1, 3, 3), pose[..., 9:], twist),
            Trajectory(None, block.rotation[:k], block.position[:k], block.twist[:k]),
        )
        self._largest = np.maximum(
            self._largest, [part.max() for part in (apart.position, apart.angle, apart.angular, apart.linear)]
        )

    def _states(self, block):
        """States of the simulation at the samples of a block, (k, n, 12) and (k, n, 6)."""
        simulation, stretch = self._simulation, block.stretch
        exact_steps = block.steps * self._rerun.ratio
        steps = np.rint(exact_steps)
        inside = np.abs(exact_steps - steps) > ROUNDING * max(1.0, self._rerun.ratio)
        steps = np.where(inside, np.floor(exact_steps), steps).astype(np.int64)
        n = len(stretch.bodies)
        pose, twist = np.empty((len(steps), n, 12)), np.empty((len(steps), n, 6))
        done = 0
        try:
            for step, time, between in zip(steps.tolist(), block.times.tolist(), inside.tolist()):
                self._rerun.advance_to(step, between)
                if between:
                    self._rerun.apply_changes(time)
                    simulation.reach(simulation.instant_of(round(time * NS)))
                pose[done], twist[done] = simulation.state()
                done += 1
        except SimulationError as error:
            self._stopped = self._stopped or str(error)
            self._broken = True
        return pose[:done], twist[:done]

    def figures(self):
        """Number of bit-identical samples, and the largest differences of the others."""
        return {
            "samples": self._samples,
            "identical": self._identical,
            "first_difference": self._first,
            "stopped": self._stopped,
            "largest_difference": dict(
                zip(("position_m", "angle_rad", "angular_rad_s", "linear_m_s"), map(float, self._largest))
            ),
        }


def _same(one, other):
    """(k, n) bool: whether all numbers of a body are bit-identical."""
    return (np.ascontiguousarray(one).view(np.int64) == np.ascontiguousarray(other).view(np.int64)).all(axis=2)
