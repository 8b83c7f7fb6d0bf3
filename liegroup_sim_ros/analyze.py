# SPDX-License-Identifier: Apache-2.0
"""`liegroup_sim analyze`: how wrong is a recorded run? As a table, as JSON, as a page.

Everything is computed from the file alone: from the recorded poses and twists, the scene and the
initial state it carries, and the wrenches that were applied. No ROS is needed.
"""
import json
import math
import sys
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from liegroup_core import SimulationError
from liegroup_core.scene.load import scene_from_text
from liegroup_core.model.joint_watch import mechanism_size
from liegroup_core.simulation import make_layout

from .recording import RecordingError, read_recording
from .report import invariants
from .report.motion import read_motion
from .report.replay import reference_error, repeat
from .report.summary import find_problems, print_table, verdict


class AnalysisError(Exception):
    """The analysis cannot be written; one line of text, exit code 2."""


@dataclass(frozen=True, eq=False)
class Analysis:
    """What was found.

    figures : numbers and texts, JSON types only, but a number may be NaN or infinite
    curves  : arrays for plots, see report/page.py
    """

    figures: dict
    curves: dict
    scene: object
    recording: object
    motion: object


def analyse(recording, reference=True, tell=lambda text: None):
    """Analysis of a Recording.

    reference : False leaves out the comparison with an independent integration
    tell      : function that is told what is done now
    raises RecordingError, SceneError
    """
    scene = scene_from_text(recording.scene_text, source=f"{recording.path}: scene.yaml")
    _check(recording, scene)
    motion = read_motion(recording)
    if not motion.stretches:
        tell("no sample with finite numbers")
    layout = make_layout(scene)
    figures = _run_figures(recording, motion)
    curves = {}
    if motion.stretches:
        tell("energy, momentum and joints")
        figures["energy"], curves["energy"] = invariants.energy(layout, motion)
        figures["momentum"], curves["momentum"] = invariants.momentum(scene, motion)
        figures["joints"], figures["joint_samples"], curves["joints"] = invariants.joints(
            layout, motion)
        figures["mechanism_size"] = mechanism_size(layout.model)
        tell("simulating again")
        figures["repeat"] = _or_reason(repeat, scene, recording, motion)
        if reference:
            tell("integrating independently (the first time on a machine also compiles)")
            found = _or_reason(reference_error, scene, recording, motion)
            figures["reference"], curves["reference"] = (
                found if isinstance(found, tuple) else (found, None))
    figures["problems"] = find_problems(figures)
    figures["verdict"] = verdict(figures)
    return Analysis(figures, curves, scene, recording, motion)


def _check(recording, scene):
    """Raise RecordingError where parts of a recording do not belong together."""
    lacking = [key for key in ("scene", "method", "group", "step", "steps_per_sample",
                               "world_frame") if key not in recording.settings]
    if lacking:
        raise RecordingError(f"{recording.path}: its settings lack {', '.join(lacking)}")
    if recording.bodies != tuple(body.name for body in scene.bodies):
        raise RecordingError(f"{recording.path}: its initial state is for other bodies than its "
                             "scene has")


def _or_reason(function, *arguments):
    """The function's result, or why there is none: a method or a joint that is not known here."""
    try:
        return function(*arguments)
    except (SimulationError, ValueError) as error:
        return {"failed": " ".join(str(error).split())}


def _run_figures(recording, motion):
    """What was run, how it kept to the wall clock, and what is in the file."""
    settings = recording.settings
    last = recording.diagnostics[-1][1] if recording.diagnostics else {}
    timing = dict(recording.pacing) if recording.pacing else _timing_so_far(last)
    timing["factor_wanted"] = _number(last.get("real_time_factor_wanted",
                                               timing.get("real_time_factor_wanted")))
    pushes = [{"body": body, "from_s": stretch.base_ns * 1e-9 + first * stretch.step,
               "to_s": stretch.base_ns * 1e-9 + end * stretch.step if math.isfinite(end) else None}
              for stretch in motion.stretches for first, end, body in stretch.pushed]
    seconds = sum(float(s.times[-1] - s.times[0]) for s in motion.stretches)
    return {
        "log": str(recording.path), "scene": settings["scene"], "bodies": list(recording.bodies),
        "method": settings["method"], "group": settings["group"], "step": settings["step"],
        "wall_start": settings.get("wall_start"), "versions": settings.get("versions", {}),
        "sim_seconds": seconds, "samples": motion.samples, "missing_samples": motion.missing,
        "not_finite_samples": motion.not_finite, "first_not_finite_s": motion.first_not_finite,
        "resets": sum(event.name == "reset" for event in recording.events),
        "faults": [event.text for event in recording.events if event.name == "fault"],
        "pushes": pushes, "wrench_changes": len(recording.applied_wrench),
        "wrenches_refused": _number(last.get("wrenches_refused")),
        "recorder_lost": _number(last.get("recorder_lost")),
        "messages": recording.topics, "lost_messages": recording.lost,
        "complete": recording.complete, "file_problem": recording.problem, "timing": timing,
    }


def _timing_so_far(last):
    """What the last diagnostics say, for a run that did not come to its end."""
    return {"ticks": _number(last.get("ticks")), "overruns": _number(last.get("overruns")),
            "reanchored": _number(last.get("reanchored")),
            "real_time_factor": _number(last.get("real_time_factor")),
            "lateness_us": {key: _number(last.get(f"lateness_{key}_us"))
                            for key in ("p50", "p99", "max")}}


def _number(text):
    """A number out of the diagnostics, or None."""
    try:
        return float(text)
    except (TypeError, ValueError):
        return None


def as_json(figures):
    """Text of the figures; NaN and infinity become texts, so that nobody takes them for fine."""
    def plain(value):
        if isinstance(value, dict):
            return {str(key): plain(entry) for key, entry in value.items()}
        if isinstance(value, (list, tuple)):
            return [plain(entry) for entry in value]
        return str(value) if isinstance(value, float) and not math.isfinite(value) else value

    return json.dumps(plain(figures), indent=1, allow_nan=False) + "\n"


def add_parser(subparsers):
    """Add `analyze` to the subcommands of a command line."""
    parser = subparsers.add_parser(
        "analyze", help="say how wrong a recorded run is",
        description="Analyse a recording: drift of energy, momentum and joints, error against an "
        "independent integration, bit-for-bit repetition, real-time figures.")
    parser.add_argument("log", metavar="LOG", help="recording (*.mcap)")
    parser.add_argument("--html", metavar="PAGE", help="write a self-contained page")
    parser.add_argument("--json", metavar="FILE", help="write all figures")
    parser.add_argument("--no-reference", action="store_true",
                        help="leave out the comparison with an independent integration")
    parser.set_defaults(run=run)


def run(args):
    """Run the subcommand; returns the exit code. Raises RecordingError, SceneError."""
    write_analysis(args.log, html=args.html, json_file=args.json,
                   reference=not args.no_reference)
    return 0


def write_analysis(log, html=None, json_file=None, reference=True):
    """Analyse a recording, print the table, write page and figures; returns the Analysis."""
    for path in filter(None, (html, json_file)):
        if Path(path).is_dir() or not Path(path).absolute().parent.is_dir():
            raise AnalysisError(f"{path}: cannot be written: give a file in an existing folder")
    with Console(stderr=True).status("reading") as status:
        analysis = analyse(read_recording(log), reference, status.update)
        try:
            if json_file:
                Path(json_file).write_text(as_json(analysis.figures), encoding="utf-8")
            if html:
                from .report.page import make_page      # plotly takes a second to import
                Path(html).write_text(make_page(analysis), encoding="utf-8")
        except OSError as error:
            raise AnalysisError(f"{error.filename}: cannot be written: {error.strerror}") from None
    print_table(analysis.figures, Console(file=sys.stdout))
    return analysis
