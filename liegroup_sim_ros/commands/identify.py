# SPDX-License-Identifier: Apache-2.0
"""`liegroup_sim identify`: numbers of a scene from a bag, with intervals. No ROS."""

import math
import sys

import numpy as np
from rich.console import Console
from rich.table import Table
from rich.text import Text

from liegroup_core import SimulationError
from liegroup_core.identification import identify
from liegroup_core.scene.load import scene_as_written
from liegroup_core.study.sweep.parameters import path_of, range_of
from liegroup_sim_ros.numbers import shown
from liegroup_sim_ros.recording.errors import OutputError

from .compare import LogError, add_log, check_log, log_of, show
from .robot_options import robot_scene
from .states import stopped

HEAD = ("number", "in the scene", "found", "95 % interval")


def add_arguments(parser):
    """Arguments of the subcommand."""
    parser.description = (
        "Find numbers of a scene from a bag by weighted least squares, with intervals, correlations and combinations "
        "that the bag does not show."
    )
    parser.add_argument(
        "--vary",
        nargs="+",
        required=True,
        metavar="NAME[=...]",
        help="numbers of the scene, as of `liegroup_sim sweep`; NAME=LOW:HIGH limits one, NAME=MEAN~DEVIATION is what "
        "is known of it",
    )
    parser.add_argument(
        "--hold-out",
        type=float,
        default=0.0,
        metavar="SHARE",
        help="share of the segments that only validate, 0 to 0.9",
    )
    parser.add_argument("--out", metavar="FILE", help="write the scene with the numbers found; it must not exist")
    add_log(parser)


def run(args):
    """Run the subcommand; returns the exit code."""
    check_log(args)
    if not 0.0 <= args.hold_out <= 0.9:
        raise LogError(f"--hold-out must be from 0 to 0.9, got {args.hold_out:g}")
    scene = robot_scene(args.scene, args)
    names, limits, priors = _varied(scene, args.vary)
    log = log_of(args, scene)
    try:
        with Console(stderr=True).status("identifying"):
            found = identify(scene, log, names, limits, priors, args.segment, args.hold_out, args.workers)
    except SimulationError as error:
        return stopped(error)
    if args.out is not None:
        _write(args.out, found, ", ".join(args.bag))
    if args.json != "-":
        _print(found, Console(file=sys.stdout))
    show(found.comparison, args, found.scene, _figures(found))
    return 0


def _varied(scene, texts):
    """Names, limits (q, 2) and priors (q, 2) of the numbers to find. Raises ParameterError, LogError."""
    written = scene_as_written(scene.text, scene.source)
    names, limits, priors = [], [], []
    for text in texts:
        name, _, rest = text.partition("=")
        limit, prior = (-math.inf, math.inf), (0.0, math.inf)
        if rest:
            given = range_of(written, text)
            if given.kind == "choice":
                raise LogError(f"--vary {text}: give NAME, NAME=LOW:HIGH or NAME=MEAN~DEVIATION")
            limit, prior = (limit, given.numbers) if given.kind == "normal" else (given.numbers, prior)
        names.append(path_of(written, name.strip()))
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
        "correlation": np.where(np.isfinite(found.correlation), found.correlation, 0.0).tolist(),
        "unknown": found.unknown,
        "held_out": None if found.held_out is None else list(found.held_out),
    }


def _print(found, console):
    table = Table(box=None, padding=(0, 2, 0, 0))
    for name in HEAD:
        table.add_column(name)
    for path, before, value, (low, high) in zip(found.paths, found.before, found.values, found.intervals):
        interval = f"{low:.6g} to {high:.6g}" if math.isfinite(low) else "the bag does not show it"
        table.add_row(Text(path), f"{before:.6g}", f"{value:.6g}", interval)
    console.print(table)
    for one in found.unknown:
        parts = " ".join(f"{weight:+.2g} {path}" for path, weight in one.items())
        console.print(Text(f"the bag does not show this combination of relative changes: {parts}", style="yellow"))
    if found.held_out is not None:
        before, after = found.held_out
        console.print(
            Text(f"segments left out: rms of residuals {shown(before)} of the noise before, {shown(after)} after")
        )


def _write(path, found, bag):
    """Write the scene with comments on what was found."""
    lines = [
        f"# {name}: {value:.9g} ± {shown(deviation)}, {before:.9g} before, from {bag}"
        for name, value, deviation, before in zip(found.paths, found.values, found.deviations, found.before)
    ]
    try:
        with open(path, "x", encoding="utf-8") as file:
            file.write("\n".join(lines) + "\n" + found.scene.text)
    except FileExistsError:
        raise OutputError(f"{path}: the file already exists; remove it or choose another name") from None
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror}") from None
