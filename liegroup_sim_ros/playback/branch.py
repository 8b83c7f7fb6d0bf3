# SPDX-License-Identifier: Apache-2.0
"""Branches of a recorded run: simulations that continue from any instant of it, with other inputs.

A branch sets the state of the last checkpoint before the instant and repeats the run from there with the
recorded inputs. An unedited branch is bit-identical with the recording, on the same kind of machine with
the same versions.
"""

import math

import numpy as np

from liegroup_core import SimulationError
from liegroup_core.scene.load import scene_from_text
from liegroup_sim_ros.recording.check import check_settings
from liegroup_sim_ros.recording.motion import RecordedMotion

from .rerun import ReplayError, Rerun, make_simulation

ROUNDING = 1e-6  # of a step, when a time is matched to steps
REST = 0.02  # s, in which a driven joint comes to rest when its commands end


class Branches:
    """Simulations that continue a Recording from any instant.

    other : settings that replace recorded ones, see rerun.make_simulation
    simulation : Simulation that all branches share; each sets its state
    Raises RecordingError, SceneError, ReplayError
    """

    def __init__(self, recording, **other):
        scene = scene_from_text(recording.scene_text, source=f"{recording.path}: scene.yaml")
        check_settings(recording, scene)
        try:
            self.simulation = make_simulation(scene, recording.settings, **other)
        except (ValueError, TypeError) as error:
            raise ReplayError(f"{recording.path}: cannot be continued: {error}") from None
        self._recording, self._rerun = recording, Rerun(recording, self.simulation)
        self._stretches = RecordedMotion(recording).all
        self._begins = [stretch.begin_ns for stretch in self._stretches]
        first = self._stretches[0]
        self._begins[0] = first.base_ns + round(first.start * first.step * 1e9)
        self.first_ns, self.last_ns = self._begins[0], recording.last_ns

    def at(self, time, inputs=False):
        """Simulation at an instant of the recording, and the stamp of its state in ns.

        time   : s, as the time stamps of the recording, rounded to whole ns
        inputs : True: inputs recorded later act, too. False: all wrenches end here, and driven
                 joints that were commanded come to rest within REST
        Raises ReplayError for a time outside the recording or a run that cannot be repeated.
        """
        if not math.isfinite(time * 1e9) or not (
            self.first_ns <= round(time * 1e9) <= max(self.first_ns, self.last_ns)
        ):
            raise ReplayError(
                f"{self._recording.path}: {time:g} s is not in the recording, which is from "
                f"{self.first_ns * 1e-9:.9g} to {self.last_ns * 1e-9:.9g} s"
            )
        stamp = round(time * 1e9)
        number = int(np.searchsorted(self._begins, stamp, "right")) - 1
        stretch, begin = self._stretches[number], self._begins[number]
        steps = math.floor((stamp - stretch.base_ns) / (stretch.step * 1e9) + ROUNDING)
        reached = [mark for mark in self._recording.checkpoints if begin <= mark <= stamp]
        checkpoint = self._recording.checkpoint(reached[-1]) if reached else None
        try:
            self._rerun.begin(stretch, checkpoint)
            self._rerun.advance_to(steps, True)
            self._rerun.apply_changes((stamp - stretch.base_ns) * 1e-9)
            self.simulation.reach(self.simulation.instant_of(stamp - stretch.base_ns))
        except SimulationError as error:
            raise ReplayError(f"{self._recording.path}: cannot be repeated: {error}") from None
        if inputs:
            self._rerun.apply_changes(math.inf)
        else:
            for source in list(self.simulation.wrench_sources):
                self.simulation.clear_wrenches(source)
            for joint in self.simulation.commanded_motions:
                self.simulation.command_motion(joint, [REST], None, [0.0])
        return self.simulation, stretch.base_ns + self.simulation.time_ns
