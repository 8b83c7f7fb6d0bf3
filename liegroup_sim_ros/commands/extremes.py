# SPDX-License-Identifier: Apache-2.0
"""`liegroup_sim extremes`: where each method stops, as a table, a heat map and JSON. No ROS.

Exit code 0 when no answer is silently wrong, 1 when one is, 2 for wrong input, 130 after Ctrl-C.
"""

import json
import math
import sys
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeElapsedColumn
from rich.table import Table
from rich.text import Text

from liegroup_core import load_scene
from liegroup_core.errors import LieGroupSimError
from liegroup_core.integrators.methods import METHODS
from liegroup_core.study.extremes.extremes import VERDICTS, Kept, axes_of, counts, silent, survey
from liegroup_sim_ros.report.extremes_page import SIGNS, shown, write_page

EXIT_SILENT, EXIT_INTERRUPTED = 1, 130
WIDTH = 200  # characters that no table needs: none is cut
SHORTEST = 1e-3  # s, a step of the runs at other velocities
STYLES = dict(zip(VERDICTS, ("green", "yellow", "blue", "cyan", "dim", "bold white on red")))
NOTE = (
    "accurate: error below 5 % of the motion; flagged: wrong, with a warning; "
    "refused: no step taken, with a reason; stopped: ended early with an error; "
    "unjudged: the reference is not accurate enough; silent: wrong without a "
    "warning"
)


class ExtremesError(LieGroupSimError):
    """The map cannot be made; one line of text, exit code 2."""


def add_arguments(parser):
    """Arguments of the subcommand."""
    parser.description = (
        "Stress-test every method on built-in problems or on your scene, and compare each run "
        "with a reference solution."
    )
    parser.epilog = "Results are cached as they come: after Ctrl-C the same command continues."
    parser.add_argument(
        "scene",
        metavar="SCENE",
        nargs="?",
        help="path of a scene file, or name of an example scene; default: built-in problems "
        "(docs/extremes.md)",
    )
    parser.add_argument(
        "--horizon",
        type=float,
        default=8.0,
        metavar="S",
        help="simulated time for a SCENE in s (default: %(default)g)",
    )
    parser.add_argument("--axes", nargs="+", metavar="NAME", help="test only these axes")
    parser.add_argument(
        "--methods",
        nargs="+",
        metavar="NAME",
        default=list(METHODS),
        help="test only these methods",
    )
    parser.add_argument("--quick", action="store_true", help="test a few values of each axis")
    parser.add_argument("--long", action="store_true", help="include runs of 1e7 steps")
    parser.add_argument(
        "--workers", type=int, metavar="N", help="number of processes (default: one per core)"
    )
    parser.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="scheduler of a Dask cluster, such as tcp://host:8786",
    )
    parser.add_argument("--png", metavar="FILE", help="write the heat map as an image")
    parser.add_argument("--json", metavar="FILE", help="write all cells as JSON")
    parser.add_argument("--markdown", metavar="FILE", help="write the map as Markdown tables")


def run(args):
    """Run the subcommand; returns the exit code. Raises ExtremesError, SceneError, TasksError."""
    axes, kept = _wanted(args)
    console = Console(file=sys.stdout)
    found = {axis.name: [] for axis in axes}
    try:
        with Progress(
            BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), console=Console(stderr=True)
        ) as bar:
            task = bar.add_task("")
            for total, axis, cells, complete in survey(
                axes, args.quick, tuple(args.methods), args.scheduler, args.workers, kept
            ):
                bar.update(task, total=total, advance=1)
                found[axis.name] += cells
                if complete:
                    _print_axis(axis, found[axis.name], args.methods, console)
    except KeyboardInterrupt:
        print(
            "liegroup_sim: interrupted; finished cells are saved, the same command continues",
            file=sys.stderr,
        )
        return EXIT_INTERRUPTED
    cells = [
        cell
        for axis in axes
        for value in axis.values
        for cell in found[axis.name]
        if cell["value"] == value
    ]
    _print_end(cells, console)
    try:
        if args.json:
            Path(args.json).write_text(
                json.dumps(as_json(axes, cells), indent=1, allow_nan=False) + "\n", encoding="utf-8"
            )
        if args.markdown:
            write_page(axes, cells, args.methods, args.markdown)
        if args.png:
            from liegroup_sim_ros.report.heat_map import write_heat_map

            write_heat_map(axes, cells, args.methods, args.png)
    except OSError as error:
        raise ExtremesError(f"{error.filename}: cannot be written: {error.strerror}") from None
    except ImportError as error:
        raise ExtremesError(f"{error.name} is needed to draw: pip install {error.name}") from None
    return EXIT_SILENT if silent(cells) else 0


def _wanted(args):
    """The axes asked for, checked, and what is kept of them."""
    unknown = [name for name in args.methods if name not in METHODS]
    if unknown:
        raise ExtremesError(f"unknown method {unknown[0]!r}; choose one of: {', '.join(METHODS)}")
    if args.workers is not None and args.workers < 1:
        raise ExtremesError(f"--workers must be at least 1, got {args.workers}")
    if not (math.isfinite(args.horizon) and args.horizon >= SHORTEST):
        raise ExtremesError(f"--horizon must be at least {SHORTEST:g} s, got {args.horizon:g}")
    if args.png and Path(args.png).suffix not in (".png", ".pdf", ".svg"):
        raise ExtremesError(f"{args.png}: the name must end in .png, .pdf or .svg")
    for path in filter(None, (args.json, args.markdown, args.png)):
        if Path(path).is_dir() or not Path(path).absolute().parent.is_dir():
            raise ExtremesError(f"{path}: cannot be written: give a file in an existing folder")
    kept = Kept.of(args.scene and load_scene(args.scene), args.horizon)
    axes = _axes(args)
    if args.quick:
        axes = tuple(axis for axis in axes if axis.quick)
        if not axes:
            raise ExtremesError(f"--quick does not include {', '.join(args.axes)}; remove --quick")
    return axes, kept


def _axes(args):
    axes = axes_of(args.scene, args.horizon, args.long)
    if not args.axes:
        if args.scene and len(axes) == 1:
            print(
                f"liegroup_sim: {args.scene} is initially at rest, so there are no velocities "
                "to vary",
                file=sys.stderr,
            )
        return axes
    names = [axis.name for axis in axes]
    for name in args.axes:
        if name == "speed" and args.scene and name not in names:
            raise ExtremesError(
                f"axis 'speed': {args.scene} is initially at rest, so there are no velocities "
                "to vary"
            )
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


def as_json(axes, cells):
    """What --json holds: axes, numbers of verdicts, cells."""
    return {
        "schema": 1,
        "axes": [
            {"name": axis.name, "title": axis.title, "unit": axis.unit, "values": list(axis.values)}
            for axis in axes
        ],
        "counts": counts(cells),
        "cells": [{key: _finite(value) for key, value in cell.items()} for cell in cells],
    }


def _finite(value):
    """JSON has no infinity: an error that is not finite is null."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _print_axis(axis, cells, methods, console):
    values = [value for value in axis.values if any(cell["value"] == value for cell in cells)]
    by_place = {(cell["method"], cell["value"]): cell["verdict"] for cell in cells}
    console.print(
        Text(axis.title + (f", {axis.unit}" if axis.unit else ""), style="bold"), soft_wrap=True
    )
    table = Table(box=None, padding=(0, 1, 0, 0))
    table.add_column("", no_wrap=True)
    for value in values:
        table.add_column(shown(value), justify="center", no_wrap=True)
    for method in methods:
        row = [by_place.get((method, value)) for value in values]
        if any(row):
            table.add_row(
                Text(method),
                *(
                    Text(SIGNS[verdict], style=STYLES[verdict]) if verdict else Text("")
                    for verdict in row
                ),
            )
    console.print(table, width=WIDTH, crop=False)
    console.print()


def _print_end(cells, console):
    console.print(
        Text(", ".join(f"{SIGNS[name]} {name} {number}" for name, number in counts(cells).items()))
    )
    console.print(Text(NOTE, style="dim"))
    for cell in silent(cells):
        console.print(
            Text(
                f"! {cell['axis']} {shown(cell['value'])}, {cell['method']}: undetected error "
                f"of {cell['error']:.2g} of the motion",
                style="bold red",
            )
        )
