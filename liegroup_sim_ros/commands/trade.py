# SPDX-License-Identifier: Apache-2.0
"""`liegroup_sim trade`: accuracy against cost of a scene, measured on this machine. No ROS.

Each measurement is cached immediately, so that an interrupted run can be continued.
"""

import json
import sys

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from liegroup_core import SimulationError, load_scene
from liegroup_core.errors import LieGroupSimError
from liegroup_core.methods.table import CONFIGURATION_GROUPS, METHODS
from liegroup_core.settings import SETTINGS
from liegroup_core.study.trade.trade import BUDGET, Trade
from liegroup_sim_ros.report.files import check_files, write_file, write_text
from liegroup_sim_ros.report.trade_figures import document_part, print_trade

from .arguments import add_parallel

STABILISATIONS = SETTINGS["stabilisation"].choices
FORMAT = 1  # of the JSON document, config/trade.schema.json


class TradeError(LieGroupSimError):
    """The trade-off cannot be measured; one line of text, exit code 2."""


def add_arguments(parser):
    """Arguments of the subcommand."""
    parser.description = (
        "Run a scene with many methods, steps, groups and stabilisations. Measure the error "
        "of each against an independent reference solution and its cost in CPU time. Report "
        "the Pareto front, and the cheapest configuration for errors of 1e-3, 1e-6 and 1e-9."
    )
    parser.epilog = "Each measurement is cached immediately: after Ctrl-C, the same command continues."
    parser.add_argument(
        "scenes", metavar="SCENE", nargs="+", help="path of a scene or robot file, or name of an example scene"
    )
    parser.add_argument(
        "--horizon",
        type=float,
        metavar="S",
        help="simulated time in s over which errors are measured (default: derived from the scene, at most 10)",
    )
    parser.add_argument("--methods", nargs="+", metavar="NAME", help="methods (default: all that are applicable)")
    parser.add_argument(
        "--groups",
        nargs="+",
        metavar="NAME",
        help=f"groups: {', '.join(CONFIGURATION_GROUPS)} (default: all that are applicable)",
    )
    parser.add_argument(
        "--stabilisation",
        nargs="+",
        metavar="KIND",
        help=f"stabilisations: {', '.join(STABILISATIONS)} (default: none projection)",
    )
    parser.add_argument(
        "--steps",
        nargs="+",
        type=float,
        metavar="S",
        help="step sizes in s (default: from a tenth of the horizon down to the round-off limit)",
    )
    parser.add_argument(
        "--budget",
        type=float,
        default=BUDGET,
        metavar="S",
        help="limit of CPU time per run in s (default: %(default)g)",
    )
    add_parallel(parser)
    parser.add_argument("--json", metavar="FILE", help="write all measurements as JSON")
    parser.add_argument("--html", metavar="PAGE", help="write a self-contained HTML report")
    parser.add_argument(
        "--png",
        metavar="FILE",
        help="write the plot of one scene as an image: *.png, *.pdf or *.svg (needs matplotlib)",
    )


def run(args):
    """Run the subcommand; returns the exit code. Raises SceneError, TradeError, TasksError."""
    _check(args)
    scenes = [load_scene(name) for name in args.scenes]
    parts = [document_part(measured(scene, args)) for scene in scenes]
    if args.json:
        write_text(args.json, document(parts))
    if args.html or args.png:
        from liegroup_sim_ros.report.trade_page import make_page, write_picture

        if args.html:
            write_text(args.html, make_page(parts))
        if args.png:
            write_file(args.png, lambda path: write_picture(parts[0], path))
    # Print after writing the files, because the reader of stdout may end early, as in `| head`.
    for part in parts:
        print_trade(part, Console(file=sys.stdout))
    return 0


def measured(scene, args):
    """Measure the Trade of a scene with a progress bar; args : parsed arguments."""
    console = Console(stderr=True)
    try:
        with console.status("") as status:
            trade = Trade(scene, args.horizon, tell=lambda text: status.update(f"{scene.name}: {text}"))
        with Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            TextColumn("{task.completed:.0f}/{task.total:.0f} ladders"),
            TimeElapsedColumn(),
            TextColumn("{task.fields[status_text]}"),
            console=console,
        ) as progress:
            task = progress.add_task(scene.name, total=1, status_text="")
            for cell, (done, total) in trade.measure(
                args.methods,
                args.groups,
                args.stabilisation,
                args.steps,
                args.budget,
                args.scheduler,
                args.workers,
                lambda text: progress.update(task, status_text=text),
            ):
                progress.update(task, completed=done, total=total, status_text=f"{cell['method']} {cell['step']:g} s")
            progress.update(task, completed=progress.tasks[task].total, status_text="")
        trade.keep_only(args.methods, args.groups, args.stabilisation, args.steps)
        return trade
    except SimulationError as error:
        raise TradeError(f"{scene.name}: {error}") from None
    except ValueError as error:  # includes SceneError
        raise TradeError(str(error)) from None


def document(parts):
    """JSON text of several scenes; its schema is config/trade.schema.json."""
    return json.dumps({"format": FORMAT, "scenes": parts}, indent=1, allow_nan=False) + "\n"


def _check(args):
    """Raise TradeError or ReportError for wrong arguments, before the work."""
    for given, known, what in (
        (args.methods, METHODS, "method"),
        (args.groups, CONFIGURATION_GROUPS, "group"),
        (args.stabilisation, STABILISATIONS, "stabilisation"),
    ):
        for name in given or ():
            if name not in known:
                raise TradeError(f"unknown {what} {name!r}; choose one of: {', '.join(known)}")
    if not args.budget > 0.0:
        raise TradeError(f"--budget must be a positive number of seconds, got {args.budget:g}")
    if args.png and len(args.scenes) > 1:
        raise TradeError("--png requires exactly one scene")
    check_files(args.json, args.html, picture=args.png)
