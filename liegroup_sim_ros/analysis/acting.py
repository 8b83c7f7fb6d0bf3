# SPDX-License-Identifier: Apache-2.0
"""Inputs that act at a time of a recorded run: wrenches, efforts, servo targets, motions, modes of joints."""

from typing import NamedTuple

import numpy as np

from liegroup_core.forces.commands import Commands
from liegroup_core.forces.instants import StepGrid
from liegroup_core.forces.timetable import acting_at, just_after
from liegroup_core.inputs import Inputs
from liegroup_core.observables.along import Along
from liegroup_core.observables.sample import NONE_ACT
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
        return self._along.of(block.pose, block.twist)


class ActingInputs(NamedTuple):
    """Inputs at one time, see Sample."""

    external: np.ndarray  # (n, COLUMNS)
    efforts: dict  # {joint: N m or N} commanded
    acting: np.ndarray  # mask of the scene's applied wrenches
    targets: np.ndarray  # (k, 2) targets of the servos
    motions: np.ndarray  # (d, 7) of the driven joints
    modes: np.ndarray  # (s, 5) of the joints with stops or friction


class Acting:
    """Inputs that act in the stretches of a recording, see motion.Stretch."""

    def __init__(self, layout, step):
        self._layout = layout
        self._inputs = Inputs(layout, StepGrid(step), layout.targets.copy(), None)
        self._last = ()

    def at(self, stretch, time):
        """ActingInputs at a time in s since step 0."""
        layout, inputs = self._layout, self._inputs
        acting = tuple(c._replace(start_ns=0, end_ns=None) for c in stretch.acting_at(time / stretch.step))
        if acting != self._last:
            inputs.commands, self._last = Commands(acting), acting
        rows, modes = layout.model.forces.applied_wrench, stretch.modes_at(time / stretch.step)
        return ActingInputs(
            inputs.external.copy(),
            inputs.schedule.efforts,
            acting_at(rows, just_after(time)) if len(rows) else NONE_ACT,
            inputs.targets.copy(),
            layout.motions_at(just_after(time), inputs.commanded),
            layout.no_modes if modes is None else modes,
        )

    def complete(self, sample, stretch):
        """Give a Sample of a stretch what acts at its time."""
        given = self.at(stretch, sample.time)
        sample.external, sample.joint_efforts, sample.targets = given.external, given.efforts, given.targets
        sample.motions, sample.switching = given.motions, given.modes

    def changes(self, stretch):
        """Sorted times in s since step 0 at which any input or mode of a stretch may change."""
        start, end, _ = stretch.inputs.spans()
        rows = self._layout.model.forces.applied_wrench
        modes = stretch.joint_modes
        found = [
            *(stretch.seconds_of(part) for part in (start, end)),
            *(changes.times for changes in stretch.changes.values()),
            [] if modes is None else (modes.stamp_ns - stretch.base_ns) * 1e-9,
            *(rows[name] for name in ("start", "end")),
            *(motions[:, 0] for motions in self._layout.motions.values()),
        ]
        return np.unique(np.concatenate(found))
