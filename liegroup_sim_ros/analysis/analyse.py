# SPDX-License-Identifier: Apache-2.0
"""Numerical error of one recorded run: figures and curves.

The recording is the only input. It contains poses and twists, scene, initial state and applied wrenches.
No ROS is needed. The samples are read once, in blocks, so memory does not grow with the length of the
run.
"""

import math
from dataclasses import dataclass

import numpy as np

from liegroup_core import SimulationError
from liegroup_core.forces.commands import EFFORT
from liegroup_core.forces.kinds import count
from liegroup_core.layout import make_layout
from liegroup_core.scene.load import scene_from_text
from liegroup_sim_ros.numbers import counted
from liegroup_sim_ros.playback.repeat import Repeat
from liegroup_sim_ros.playback.rerun import ReplayError, WorkLimit, make_simulation
from liegroup_sim_ros.playback.resimulate import platform_changes
from liegroup_sim_ros.recording.check import check_settings
from liegroup_sim_ros.recording.motion import RecordedMotion
from liegroup_sim_ros.recording.read import RecordingError

from .acting import AlongStretches
from .balance import Balance
from .columns import columns_along
from .estimate import Estimate
from .invariants import Energy, Joints, Momentum
from .joint_events import joint_events
from .local_error import local_error
from .promise import Promise
from .reference import ReferenceError
from .timing import number, timing_figures
from .verdict import find_problems, find_warnings, verdict

# Default simulated time that the reference integration covers, s.
REFERENCE_SECONDS = 60.0
# Default maximum number of its steps, which takes about three minutes with seven bodies.
# heavy_top needs 3 000 for 60 s, four_bar 9 400.
REFERENCE_STEPS = 50_000
# Maximum number of steps and substeps of the re-simulation, and its increase per sample: some minutes.
REPEAT_STEPS, REPEAT_STEPS_PER_SAMPLE = 5_000_000, 1000
MOST_PUSHES = 1000  # largest number of intervals with an applied wrench or effort in the figures


@dataclass(frozen=True, eq=False)
class Analysis:
    """Result of an analysis.

    figures : numbers and texts as JSON types, except that numbers may be NaN or infinite
    curves  : arrays for plots, see report/plots.py
    """

    figures: dict
    curves: dict
    layout: object
    recording: object
    motion: object

    @property
    def scene(self):
        """Scene of the recording."""
        return self.layout.scene

    def columns(self, names, most=None):
        """Columns of the Catalogue along the run, see columns.columns_along."""
        return columns_along(self.layout, self.motion, names, most)

    def to_pandas(self, names):
        """pandas DataFrame of columns of the Catalogue at all kept samples, with the time in s as index.

        names : such as "energy", "top.x", "reactions", see `liegroup_sim run --columns`
        raises ImportError without pandas, SceneError for an unknown name
        """
        import pandas

        times, columns, values = self.columns(names, most=math.inf)
        known = np.isfinite(times)  # not between stretches
        return pandas.DataFrame(values[known], pandas.Index(times[known], name="time_s"), columns.labels)


def analyse(
    recording,
    reference=True,
    tell=lambda text: None,
    reference_seconds=REFERENCE_SECONDS,
    reference_steps=REFERENCE_STEPS,
    covered=lambda seconds, total: None,
):
    """Analyse a Recording; returns an Analysis.

    reference         : whether to compare with a reference solution
    tell              : function that is called with the progress, one line of text
    reference_seconds : simulated time in s that a reference integration covers
    reference_steps   : maximum number of steps of a reference integration, which stops there
    covered           : function that is called with the simulated time that a reference integration has covered,
                        and with all that it has to cover at most, s
    raises RecordingError, SceneError
    """
    scene = scene_from_text(recording.scene_text, source=f"{recording.path}: scene.yaml")
    check_settings(recording, scene)
    layout = make_layout(scene)
    motion = RecordedMotion(recording, layout)
    limits = reference_seconds, reference_steps
    total = min(
        reference_seconds, motion.expected * recording.settings["step"] * (recording.settings["steps_per_sample"] or 1)
    )
    parts = _Parts(
        scene, recording, layout, motion, reference, *limits, lambda seconds: covered(min(seconds, total), total)
    )
    done = 0
    for block in motion.blocks(parts.angles):
        parts.add(block)
        done += len(block.steps)
        tell(
            f"{done} of {counted(motion.expected, 'sample')}"
            + (" (the first time on a machine also compiles)" if not done else "")
        )
    figures = _run_figures(recording, motion)
    figures["joint_events"], marks = joint_events(recording, layout, motion)
    curves = {}
    if motion.stretches:
        tell("energy, momentum, joints and errors")
        parts.finish(figures, curves)
        curves["joint_events"] = marks
    figures["problems"] = find_problems(figures)
    figures["warnings"] = find_warnings(figures, recording.events)
    figures["verdict"] = verdict(figures)
    return Analysis(figures, curves, layout, recording, motion)


class _Parts:
    """Computes all figures that depend on the samples, block by block."""

    def __init__(self, scene, recording, layout, motion, reference, seconds, steps, covered):
        self._scene, self._recording, self._layout = scene, recording, layout
        self._motion = motion
        expected = motion.expected
        self._along = AlongStretches(recording, layout)
        angles = self._along.starts.of(motion.first)[2]
        if angles is not None and len(angles) != count(layout.model.forces):
            raise RecordingError(
                f"{recording.path}: the number of its torsional springs does not match the "
                f"{counted(len(angles), 'angle')} of its initial state"
            )
        self._energy, self._joints = Energy(layout, expected), Joints(layout, expected)
        self._momentum = Momentum(scene, expected)
        self._balance = _Guarded(lambda: Balance(layout, recording, expected))
        self._guarded = {
            "repeat": _Guarded(
                lambda: Repeat(
                    recording,
                    make_simulation(scene, recording.settings),
                    WorkLimit(REPEAT_STEPS + REPEAT_STEPS_PER_SAMPLE * expected),
                )
            )
        }
        self._promise, self._estimated = (Promise(recording.settings.get("promise")) for _ in range(2))
        self._estimate = Estimate(self._estimated)
        if reference:
            self._guarded["reference"] = _Guarded(
                lambda: ReferenceError(
                    layout, recording, expected, seconds, self._promise, self._estimate, steps, tell=covered
                )
            )

    def angles(self, block):
        """Angles of the torsional springs; called before `add` with the same Block."""
        self._found = self._along.of(block)
        return self._found[3]

    def add(self, block):
        energies, stored, residual, angles = self._found
        self._energy.add(block, energies, stored[:, 0])
        self._balance.add(block, stored, angles)
        self._momentum.add(block)
        self._joints.add(block, residual, angles)
        self._estimate.add(block)
        for part in self._guarded.values():
            part.add(block)

    def finish(self, figures, curves):
        figures["energy"] = self._energy.figures(self._motion)
        found = self._balance.figures()
        figures["balance"], curves["balance"] = found if isinstance(found, tuple) else (found, None)
        figures["momentum"], curves["momentum"] = self._momentum.figures(self._motion)
        figures["joints"], figures["joint_samples"], curves["joints"] = self._joints.figures()
        figures["mechanism_size"] = self._layout.size
        figures["repeat"] = self._guarded["repeat"].figures()
        if "failed" not in figures["repeat"]:
            figures["repeat"]["platform"] = platform_changes(self._recording.settings)
        if "reference" in self._guarded:
            found = self._guarded["reference"].figures()
            figures["reference"], curves["reference"] = found if isinstance(found, tuple) else (found, None)
        by_reference = "failed" not in figures.get("reference", {"failed": None})
        checked, by = (self._promise, "reference") if by_reference else (self._estimated, "estimate")
        figures["promise"] = checked.figures(by)
        figures["estimate"] = self._estimate.figures()
        try:
            figures["local"] = local_error(self._scene, self._recording, self._motion, self._layout)
        except NO_RESULT as error:
            figures["local"] = _failed(error)


# Errors for an unknown method or joint type, options of another version, or a singular configuration.
NO_RESULT = (SimulationError, ReplayError, ValueError, TypeError)


def _failed(error):
    return {"failed": " ".join(str(error).split())}


class _Guarded:
    """Wrapper of a part of the analysis that may fail; `figures` then returns the reason."""

    def __init__(self, make):
        self._failure = None
        self._part = self._try(make)

    def _try(self, function, *arguments):
        if self._failure is None:
            try:
                return function(*arguments)
            except NO_RESULT as error:
                self._failure = _failed(error)
        return None

    def add(self, *arguments):
        self._try(lambda: self._part.add(*arguments))

    def figures(self):
        result = self._try(lambda: self._part.figures())
        return self._failure or result


def _run_figures(recording, motion):
    """Figures of the configuration, the real-time behaviour and the contents of the file."""
    settings = recording.settings
    last = recording.diagnostics[-1][1] if recording.diagnostics else {}
    intervals = [(stretch, push) for stretch in motion.stretches for push in stretch.pushed]
    pushes = [
        {
            "joint" if kind == EFFORT else "body": name,
            "from_s": stretch.base_ns * 1e-9 + first * stretch.step,
            "to_s": stretch.base_ns * 1e-9 + end * stretch.step if math.isfinite(end) else None,
        }
        for stretch, (first, end, kind, name) in intervals[:MOST_PUSHES]
    ]
    events = {}
    for event in recording.events:
        events[event.name] = events.get(event.name, 0) + 1
    return {
        "log": str(recording.path),
        "scene": settings["scene"],
        "bodies": list(recording.bodies),
        "method": settings["method"],
        "group": settings["group"],
        "step": settings["step"],
        "stabilisation": settings.get("stabilisation") or "none",
        "options": settings.get("options") or {},
        "wall_start": settings.get("wall_start"),
        "versions": settings.get("versions") or {},
        "sim_seconds": sum(stretch.seconds for stretch in motion.stretches),
        "samples": motion.samples,
        "missing_samples": motion.missing,
        "not_finite_samples": motion.not_finite,
        "first_not_finite_s": motion.first_not_finite,
        "resets": sum(event.name == "reset" for event in recording.events),
        "faults": [event.text for event in recording.events if event.name == "fault"],
        "events": events,
        "pushes": pushes,
        "push_count": len(intervals),
        "wrench_commands": len(recording.inputs),
        "wrenches_refused": number(last.get("wrenches_refused")),
        "recorder_lost": number(last.get("recorder_lost")),
        "messages": recording.topics,
        "lost_messages": recording.lost,
        "complete": recording.complete,
        "file_problem": recording.problem,
        "timing": timing_figures(recording, motion),
    }
