# SPDX-License-Identifier: Apache-2.0
"""Inputs that act at a time of a recorded run: wrenches, efforts, servo targets, motions, modes of joints."""

import numpy as np

from liegroup_core.forces.instants import StepGrid, just_after
from liegroup_core.inputs import Inputs
from liegroup_core.observables.along import Along
from liegroup_sim_ros.playback.rerun import Starts


def sample_of(layout, stretch, k):
    """Sample of the kept sample k of a Stretch, without what acts."""
    pose = np.concatenate([stretch.rotation[k].reshape(-1, 9), stretch.position[k]], axis=1)
    return layout.sample(pose, stretch.twist[k], float(stretch.times[k]), near=stretch.angles[k])


class AlongStretches:
    """Observables of the samples of a recording; angles of springs are unwrapped from the start of each stretch.

    starts : Starts of the recording
    """

    def __init__(self, recording, layout):
        self._along, self.starts, self._stretch = Along(layout), Starts(recording, layout), None

    def of(self, block):
        """As Along.of, of the next Block of a RecordedMotion."""
        if block.stretch is not self._stretch:
            self._stretch = block.stretch
            self._along.restart(self.starts.of(block.stretch)[2])
        found = self._along.of(block.pose, block.twist)
        if block.laws is not None:
            angles = found[3]
            angles[:, angles.shape[1] - block.laws.shape[1] :] = block.laws[:, :, 0]
        return found


class ActingInputs:
    """Inputs that act in the stretches of a recording, see motion.Stretch."""

    def __init__(self, layout, step):
        self._layout, self._grid = layout, StepGrid(step)
        self._inputs = Inputs(layout, self._grid, layout.targets.copy(), layout.motions_at(0.0))

    def at(self, stretch, time):
        """(Acting, {joint: commanded effort}, modes as Sample.switching) at a time in s since step 0."""
        commands = (c._replace(start_ns=0, end_ns=None) for c in stretch.acting_at(time / stretch.step))
        self._inputs.show(tuple(commands), self._grid.instant(just_after(time)))
        modes = stretch.modes_at(time / stretch.step)
        modes = self._layout.no_modes if modes is None else modes
        return self._inputs.acting.copy(), self._inputs.schedule.efforts, modes

    def complete(self, sample, stretch):
        """Give a Sample of a stretch what acts at its time."""
        sample.acting, sample.joint_efforts, sample.switching = self.at(stretch, sample.time)

    def changes(self, stretch):
        """Sorted times in s since step 0 at which any input or mode of a stretch may change."""
        start, end, _ = stretch.inputs.spans()
        modes = stretch.joint_modes
        found = [
            *(stretch.seconds_of(part) for part in (start, end)),
            *(changes.times for changes in stretch.changes.values()),
            [] if modes is None else (modes.stamp_ns - stretch.base_ns) * 1e-9,
            [time for *times, _ in self._layout.commands for time in times],
        ]
        return np.unique(np.concatenate(found))
