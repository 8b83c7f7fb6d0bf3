# SPDX-License-Identifier: Apache-2.0
"""Source of a page: a recording, with its whole time line."""

import functools

import numpy as np

from liegroup_core.layout import make_layout
from liegroup_core.scene.load import scene_from_text
from liegroup_sim_ros.analysis.acting import ActingInputs, AlongStretches, sample_of
from liegroup_sim_ros.analysis.promise import allowed
from liegroup_sim_ros.analysis.reference import ReferenceError
from liegroup_sim_ros.playback.branch import Branches
from liegroup_sim_ros.recording.check import check_settings
from liegroup_sim_ros.recording.motion import RecordedMotion
from liegroup_sim_ros.recording.read import read_recording

from .local import Local
from .server import ViewError
from .source import History, Source, Status, ViewFrame, settings_text


class Recorded(Source):
    """A recording, by its path or address. Raises LieGroupSimError."""

    is_live, polled, takes = False, False, frozenset(("reference",))

    def __init__(self, path):
        self.recording = recording = read_recording(str(path))
        scene = scene_from_text(recording.scene_text, source=f"{path}: scene.yaml")
        check_settings(recording, scene)
        super().__init__(make_layout(scene), f"{scene.name}, {path}")
        motion, along = RecordedMotion(recording, self.layout), AlongStretches(recording, self.layout)
        for _ in motion.blocks(lambda block: along.of(block)[3]):
            pass
        self._owners, promise = {}, recording.settings.get("promise")
        self._acting = ActingInputs(self.layout, recording.settings["step"])
        if not motion.stretches:
            raise ViewError(f"{path}: {recording.problem or 'it has no samples'}")
        for stretch in motion.stretches:
            for k, time in enumerate(stretch.log_times.tolist()):
                self.history.add(self._frame(stretch, k, time, promise))
        settings = recording.settings
        self.how = settings_text(settings["method"], promise and promise["accuracy"], settings["step"])
        for event in recording.events:
            self.tell(event.stamp_ns * 1e-9, event.name, event.text)

    def _frame(self, stretch, k, time, promise):
        sample = sample_of(self.layout, stretch, k)
        sample.errors = None if stretch.errors is None else stretch.errors[k]
        self._owners[time] = stretch
        wanted = promise and float(allowed(promise, stretch, stretch.times[k : k + 1])[0])
        return ViewFrame(time, sample, wanted and (wanted * self.layout.size, wanted))

    def dressed(self, frame):
        """The ViewFrame with the wrenches and efforts that act."""
        if "acting" not in vars(frame.sample):
            self._acting.complete(frame.sample, self._owners[frame.time])
        return frame

    def frame(self):
        """The first frame; a page shows those of the history."""
        return self.history.frames[0]

    def status(self):
        """Status."""
        return Status("recorded", None, None, self.recording.problem or "")

    def reference(self):
        """(History of the reference integration with the recorded inputs, one line)."""
        history, motion = History(), RecordedMotion(self.recording, self.layout)
        integration = ReferenceError(
            self.layout, self.recording, len(self.history.times), keep=functools.partial(self._keep, history)
        )
        for block in motion.blocks():
            integration.add(block)
        figures, _ = integration.figures()
        if not history.times:
            raise ViewError(figures.get("stopped") or "the reference integration has no sample")
        return history, figures.get("stopped") or "the pale motion is the reference integration"

    def _keep(self, history, log_times, exact):
        for k, time in enumerate(log_times.tolist()):
            pose = np.concatenate([exact.rotation[k].reshape(-1, 9), exact.position[k]], axis=1)
            history.add(ViewFrame(time, self.layout.sample(pose, exact.twist[k], float(exact.times[k])), None))

    def branch(self, time):
        """Simulation that continues from an instant, without the recorded inputs after it."""
        simulation, stamp_ns = Branches(self.recording).at(time)
        return Local(simulation, f"branch at {time:.6g} s", start_ns=stamp_ns, paused=True)
