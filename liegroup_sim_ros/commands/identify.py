# SPDX-License-Identifier: Apache-2.0
"""`liegroup_sim identify`: numbers of a scene from a bag, with intervals. No ROS."""

import math
import sys
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.text import Text

from liegroup_core import SimulationError
from liegroup_core.identification import Move, identify, plan
from liegroup_core.layout import make_layout
from liegroup_core.linear.channels import WRENCH
from liegroup_core.scene.load import scene_as_written
from liegroup_core.scene.parameters import path_of, range_of, unchecked
from liegroup_sim_ros.logs.load import outputs_of
from liegroup_sim_ros.logs.map import load_map
from liegroup_sim_ros.numbers import shown
from liegroup_sim_ros.recording.errors import OutputError
from liegroup_sim_ros.recording.write_tables import close_new, new_file
from liegroup_sim_ros.report.compare_page import NUMBERS, number_remarks
from liegroup_sim_ros.report.tables import TextTable, table_of
from liegroup_sim_ros.report.terminal import printed, working

from .compare import LogError, add_log, check_log, log_of, show
from .robot_options import robot_scene
from .states import refuse_repeated, stopped

INPUTS = ("effort", "target", "target_velocity", *WRENCH)  # ends of the names of inputs, of which factors vary
USUAL_NOISE = 1e-3  # rad or m, of measured positions without a map
MOST_SECONDS = 60.0  # of a motion that is planned


def add_arguments(parser):
    """Arguments of the subcommand."""
    parser.description = (
        "Find numbers of a scene from a bag by weighted least squares, with intervals, correlations and combinations "
        "that the bag does not show. With --plan: the motion whose bag would show them best."
    )
    parser.add_argument(
        "--vary",
        nargs="+",
        required=True,
        metavar="NAME[=...]",
        help="numbers of the scene, as of `liegroup_sim sweep`, and inputs (JOINT.effort), whose factor varies; "
        "NAME=LOW:HIGH limits one, NAME=MEAN~DEVIATION is what "
        "is known of it",
    )
    parser.add_argument(
        "--hold-out",
        type=float,
        default=0.0,
        metavar="SHARE",
        help="share of the log, at its end, that only validates, 0 to 0.9",
    )
    parser.add_argument("--out", metavar="FILE", help="write the scene with the numbers found; it must not exist")
    parser.add_argument(
        "--plan",
        metavar="FILE",
        help="instead of a bag: write a motion (*.csv) of the joints of --move that would show the numbers best",
    )
    parser.add_argument(
        "--move",
        nargs="+",
        default=[],
        metavar="JOINT=LOW:HIGH[:SPEED]",
        help="limits of the motion: positions and speed, rad or m, and per s",
    )
    parser.add_argument("--duration", type=float, default=5.0, metavar="S", help="of the motion (default: %(default)g)")
    add_log(parser, "*")


def run(args):
    """Run the subcommand; returns the exit code."""
    check_log(args)
    if args.plan is not None:
        return _plan(args)
    if not args.bag:
        raise LogError("give a bag, or --plan FILE")
    if not 0.0 <= args.hold_out <= 0.9:
        raise LogError(f"--hold-out must be from 0 to 0.9, got {args.hold_out:g}")
    scene = robot_scene(args.scene, args)
    names, limits, priors = _varied(scene, args.vary)
    log = log_of(args, scene)
    try:
        with working("identifying") as tell:
            found = identify(scene, log, names, limits, priors, args.hold_out, args.workers, tell)
    except SimulationError as error:
        return stopped(error)
    if args.out is not None:
        _write(args.out, found, ", ".join(args.bag))
    figures = _figures(found)
    if args.json != "-":
        _print(figures, Console(file=sys.stdout))
    show(found.comparison, args, found.scene, figures)
    return 0


def _plan(args):
    """Write and print a motion."""
    if Path(args.plan).suffix != ".csv":
        raise LogError(f"{args.plan}: the name must end in .csv")
    if args.bag or not args.move:
        raise LogError("--plan takes no bag, and --move JOINT=LOW:HIGH")
    if not 0.5 <= args.duration <= MOST_SECONDS:
        raise LogError(f"--duration must be from 0.5 to {MOST_SECONDS:g} s, got {args.duration:g}")
    scene = robot_scene(args.scene, args)
    names, _, _ = _varied(scene, args.vary)
    measured = _measured(args.map, scene)
    moves = [_move(text) for text in args.move]
    refuse_repeated("--move", [move.joint for move in moves])
    file, is_written = new_file(args.plan, "x", encoding="utf-8"), False
    try:
        with Console(stderr=True).status("planning"):
            found = plan(scene, names, moves, measured, args.duration, workers=args.workers)
        file.write(_motion_of(found))
        is_written = True
    except SimulationError as error:
        return stopped(error)
    finally:
        close_new(file, args.plan, remove=not is_written)
    rows, heads = [], ("number", "value", "deviation", *(f"{joint} alone" for joint in found.alone))
    for k, (path, value) in enumerate(zip(found.paths, found.values)):
        each = [found.deviations, *found.alone.values()]
        rows.append((path, f"{value:.6g}", *(shown(one[k]) if np.isfinite(one[k]) else "-" for one in each)))
    Console(file=sys.stdout).print(printed(TextTable(None, heads, rows, len(heads))))
    return 0


def _motion_of(found):
    """Text of the table of a Plan."""
    parts = ("position", "velocity", "effort")
    columns = [f"{joint}.{part}" for joint in found.joints for part in parts]
    rows = np.stack([found.positions, found.rates, found.efforts], axis=2).reshape(len(found.times), -1)
    text = [",".join(["time", *columns])]
    text += [",".join(map(repr, [time, *row])) for time, row in zip(found.times.tolist(), rows.tolist())]
    return "\n".join(text) + "\n"


def _move(text):
    """Move of JOINT=LOW:HIGH[:SPEED]. Raises LogError."""
    joint, _, rest = text.partition("=")
    try:
        numbers = [float(part) for part in rest.split(":")]
    except ValueError:
        numbers = []
    if not (joint and 2 <= len(numbers) <= 3 and np.isfinite(numbers).all()):
        raise LogError(f"--move {text}: give JOINT=LOW:HIGH or JOINT=LOW:HIGH:SPEED")
    return Move(joint, *numbers)


def _measured(path, scene):
    """{output: standard deviation}: those of a map, or positions of all joints."""
    if path is None:
        return {f"{joint}.position": USUAL_NOISE for joint in make_layout(scene).coordinates.names}
    found = {}
    for entry in load_map(path).measurements:
        if entry.noise is None:
            raise LogError(f"{path}: {entry.output}: a plan needs its noise")
        found |= dict.fromkeys(outputs_of(entry.output, scene), entry.noise)
    return found


def _varied(scene, texts):
    """Names, limits (q, 2) and priors (q, 2) of the numbers to find. Raises ParameterError, LogError."""
    written = scene_as_written(scene.text, scene.source)
    names, limits, priors = [], [], []
    for text in texts:
        name, _, rest = text.partition("=")
        limit, prior = (-math.inf, math.inf), (0.0, math.inf)
        is_input = name.strip().rpartition(".")[2] in INPUTS
        if rest:
            given = unchecked(text) if is_input else range_of(written, text)
            if given.kind == "choice":
                raise LogError(f"--vary {text}: give NAME, NAME=LOW:HIGH or NAME=MEAN~DEVIATION")
            limit, prior = (limit, given.numbers) if given.kind == "normal" else (given.numbers, prior)
        names.append(name.strip() if is_input else path_of(written, name.strip()))
        limits.append(limit)
        priors.append(prior)
    return names, np.array(limits), np.array(priors)


def _figures(found):
    """JSON types of what was found."""
    finite = np.where(np.isfinite(found.deviations), found.deviations, np.nan)
    return {
        "numbers": [
            {
                "name": path,
                "before": float(before),
                "value": float(value),
                "deviation": None if np.isnan(deviation) else float(deviation),
                "interval": None if np.isnan(deviation) else [float(x) for x in interval],
            }
            for path, before, value, deviation, interval in zip(
                found.paths, found.before, found.values, finite, found.intervals
            )
        ],
        "in_reach": found.is_in_reach,
        "robust": found.is_robust,
        "correlation": np.where(np.isfinite(found.correlation), found.correlation, 0.0).tolist(),
        "unknown": found.unknown,
        "held_out": None if found.held_out is None else list(found.held_out),
    }


def _print(figures, console):
    console.print(printed(table_of(NUMBERS, figures["numbers"])))
    for text in number_remarks(figures):
        console.print(Text(text, style="yellow"))


def _write(path, found, bag):
    """Write the scene with comments on what was found."""
    lines = [
        f"# {name}: {value:.9g} ± {shown(deviation)}, {before:.9g} before, from {bag}"
        for name, value, deviation, before in zip(found.paths, found.values, found.deviations, found.before)
    ]
    try:
        with new_file(path, "x", encoding="utf-8") as file:
            file.write("\n".join(lines) + "\n" + found.scene.text)
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror}") from None
