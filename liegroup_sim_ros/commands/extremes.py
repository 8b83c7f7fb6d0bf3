# SPDX-License-Identifier: Apache-2.0
"""`liegroup_sim extremes`: robustness map of the methods as table, heat map and JSON. No ROS.

Exit code 0 without undetected errors, 1 if there are some, 2 for wrong input, 130 after Ctrl-C.
"""

import math
import sys

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeElapsedColumn

from liegroup_core import load_scene
from liegroup_core.errors import LieGroupSimError
from liegroup_core.study.extremes.extremes import METHOD_NAMES, Kept, axes_of, silent, survey
from liegroup_sim_ros.report.extremes_page import write_page
from liegroup_sim_ros.report.extremes_tables import document, print_axis, print_end
from liegroup_sim_ros.report.files import check_files, write_file, write_text

from .arguments import add_parallel

EXIT_SILENT, EXIT_INTERRUPTED = 1, 130
SHORTEST = 1e-3  # s, the step of runs with scaled velocities


class ExtremesError(LieGroupSimError):
    """Wrong arguments; one line of text, exit code 2."""


def add_arguments(parser):
    """Arguments of the subcommand."""
    parser.description = (
        "Stress-test every method on built-in problems or on your scene, and compare each run "
        "with a reference solution."
    )
    parser.epilog = "Each result is cached immediately: after Ctrl-C, the same command continues."
    parser.add_argument(
        "scene",
        metavar="SCENE",
        nargs="?",
        help="path of a scene or robot file, or name of an example scene; default: built-in problems "
        "(docs/explanation/robustness.md)",
    )
    parser.add_argument(
        "--horizon", type=float, default=8.0, metavar="S", help="simulated time for a SCENE in s (default: %(default)g)"
    )
    parser.add_argument("--axes", nargs="+", metavar="NAME", help="test only these axes")
    parser.add_argument(
        "--methods", nargs="+", metavar="NAME", default=list(METHOD_NAMES), help="test only these methods"
    )
    parser.add_argument("--quick", action="store_true", help="test a few values of each axis")
    parser.add_argument("--long", action="store_true", help="include runs of 1e7 steps")
    add_parallel(parser)
    parser.add_argument("--png", metavar="FILE", help="write the heat map as an image")
    parser.add_argument("--json", metavar="FILE", help="write all cells as JSON")
    parser.add_argument("--markdown", metavar="FILE", help="write the map as Markdown tables")


def run(args):
    """Run the subcommand; returns the exit code. Raises ExtremesError, SceneError, TasksError."""
    axes, cache = _wanted(args)
    console = Console(file=sys.stdout)
    cells_of = {axis.name: [] for axis in axes}
    try:
        with Progress(BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), console=Console(stderr=True)) as bar:
            task = bar.add_task("")
            for total, axis, cells, complete in survey(
                axes, args.quick, tuple(args.methods), args.scheduler, args.workers, cache
            ):
                bar.update(task, total=total, advance=1)
                cells_of[axis.name] += cells
                if complete:
                    print_axis(axis, cells_of[axis.name], args.methods, console)
    except KeyboardInterrupt:
        print("liegroup_sim: interrupted; finished cells are saved, the same command continues", file=sys.stderr)
        return EXIT_INTERRUPTED
    cells = [cell for axis in axes for value in axis.values for cell in cells_of[axis.name] if cell["value"] == value]
    if args.json:
        write_text(args.json, document(axes, cells))
    if args.markdown:
        write_file(args.markdown, lambda path: write_page(axes, cells, args.methods, path))
    if args.png:
        from liegroup_sim_ros.report.heat_map import write_heat_map  # needs matplotlib

        write_file(args.png, lambda path: write_heat_map(axes, cells, args.methods, path))
    # Print after writing the files, because the reader of stdout may end early, as in `| head`.
    print_end(cells, console)
    return EXIT_SILENT if silent(cells) else 0


def _wanted(args):
    """(axes, cache of results) for checked arguments."""
    unknown = [name for name in args.methods if name not in METHOD_NAMES]
    if unknown:
        raise ExtremesError(f"unknown method {unknown[0]!r}; choose one of: {', '.join(METHOD_NAMES)}")
    if not (math.isfinite(args.horizon) and args.horizon >= SHORTEST):
        raise ExtremesError(f"--horizon must be at least {SHORTEST:g} s, got {args.horizon:g}")
    check_files(args.json, args.markdown, picture=args.png)
    cache = Kept.of(args.scene and load_scene(args.scene), args.horizon)
    axes = _axes(args)
    if args.quick:
        axes = tuple(axis for axis in axes if axis.quick)
        if not axes:
            raise ExtremesError(f"--quick does not include {', '.join(args.axes)}; remove --quick")
    return axes, cache


def _axes(args):
    axes = axes_of(args.scene, args.horizon, args.long)
    if not args.axes:
        if args.scene and len(axes) == 1:
            print(
                f"liegroup_sim: {args.scene} is initially at rest, so there are no velocities to vary", file=sys.stderr
            )
        return axes
    names = [axis.name for axis in axes]
    for name in args.axes:
        if name == "speed" and args.scene and name not in names:
            raise ExtremesError(f"axis 'speed': {args.scene} is initially at rest, so there are no velocities to vary")
        if name not in names and name in [axis.name for axis in axes_of(long=True)]:
            raise ExtremesError(
                f"axis {name!r} is "
                + (
                    "not available for a SCENE; choose one of: " + ", ".join(names)
                    if args.scene
                    else "only available with --long"
                )
            )
        if name not in names:
            raise ExtremesError(f"unknown axis {name!r}; choose one of: {', '.join(names)}")
    return tuple(axis for axis in axes if axis.name in args.axes)
