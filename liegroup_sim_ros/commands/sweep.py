# SPDX-License-Identifier: Apache-2.0
"""`liegroup_sim sweep`: runs of a scene with sampled parameters, written to Parquet. No ROS.

Finished runs are saved batch by batch, so that an interrupted sweep can be continued.
"""

import math
import sys

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from liegroup_core import load_scene
from liegroup_core.control import read_setup
from liegroup_core.scene.consistency import AT_POSES, AT_VELOCITIES
from liegroup_core.scene.load import scene_as_written
from liegroup_core.scene.parameters import ParameterError, parameters
from liegroup_core.settings import checked
from liegroup_core.study.sweep.file import SweepFile
from liegroup_core.study.sweep.sweep import LARGEST, OK, Sweep, describe
from liegroup_core.study.trade.cache import PACKAGES
from liegroup_sim_ros.numbers import counted
from liegroup_sim_ros.recording.attachments import versions
from liegroup_sim_ros.report.sweep_tables import print_sweep
from liegroup_sim_ros.version import __version__

from .arguments import add_parallel
from .run import RunError, add_control, divides, given_settings, whole_steps
from .setting_options import add_settings

EXIT_ALL_FAILED, EXIT_INTERRUPTED = 1, 130
MOST_PARTS = 1000  # maximum number of steps in the period of --keep, for an accuracy


def add_arguments(parser):
    """Arguments of the subcommand."""
    parser.description = (
        "Sample parameters and initial states of a scene from ranges (Latin hypercube), run "
        "all samples in parallel, write the results to Parquet, and show how they vary and "
        "what they depend on."
    )
    parser.epilog = "Finished runs are saved batch by batch: after Ctrl-C, the same command continues."
    parser.add_argument("scene", metavar="SCENE", help="path of a scene or robot file, or name of an example scene")
    parser.add_argument(
        "--vary",
        nargs="+",
        action="extend",
        default=[],
        metavar="NAME=RANGE",
        help="a number of the scene, such as bodies.top.mass (you can shorten a name to its "
        "ending if that is unambiguous), and its range: LOW:HIGH, LOW:HIGH:log, "
        "MEAN~DEVIATION or A,B,C",
    )
    parser.add_argument(
        "--list", action="store_true", help="list all parameters with their values in the scene, and exit"
    )
    parser.add_argument("--samples", type=int, metavar="N", help="number of runs")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="seed of the sampling (default: %(default)s)")
    parser.add_argument(
        "--duration", type=float, metavar="S", help="simulated time of each run in s, a multiple of the step"
    )
    parser.add_argument("--out", metavar="FOLDER", help="output: a folder of Parquet files, *.parquet")
    parser.add_argument(
        "--keep",
        type=float,
        metavar="S",
        help="save the states with this period, and check energy and joints there (default: "
        "check every tenth of the run, save the last state)",
    )
    parser.add_argument(
        "--assemble",
        action="store_true",
        help="assemble: correct the sampled poses and velocities so that they satisfy the joints",
    )
    parser.add_argument(
        "--reactions",
        action="store_true",
        help="add the largest reactions of all joints at the times of --keep (nan: undetermined)",
    )
    parser.add_argument(
        "--record",
        nargs="+",
        default=[],
        metavar="NAME",
        help="save more than the states, at the end and at the times of --keep; names as of `liegroup_sim run "
        "--columns`",
    )
    parser.add_argument(
        "--gradient",
        nargs="+",
        default=[],
        metavar="OUTPUT",
        help="add the derivatives of outputs at the end by all varied numbers: "
        "names as of `liegroup_sim run --columns`",
    )
    add_control(parser)
    add_parallel(parser)
    parser.add_argument(
        "--show",
        nargs="+",
        metavar="COLUMN",
        help="columns of the result tables (default: the states of up to two bodies, the energy and the joints)",
    )
    add_settings(parser)


def run(args):
    """Run the subcommand; returns the exit code.

    Raises SceneError, ParameterError, RunError, SweepFileError, TasksError.
    """
    scene = load_scene(args.scene)
    if args.list:
        for name, value in parameters(scene_as_written(scene.text)).items():
            print(name if value is None else f"{name} {value!r}")
        return 0
    for name in ("samples", "duration", "out"):
        if getattr(args, name) is None:
            raise RunError(f"--{name} is missing")
    console = Console(stderr=True)
    with console.status("starting (the first run of a kind of mechanism compiles for about 20 s)"):
        sweep, description = _sweep_of(scene, args)
    args.show = args.show and [_shown(name, sweep.columns) for name in args.show]
    unknown = [name for name in args.show or () if sweep.columns.get(name) != "float"]
    if unknown:
        raise RunError(
            f"--show: no numeric column {unknown[0]}; choose from: "
            + ", ".join(name for name, kind in sweep.columns.items() if kind == "float")
        )
    with SweepFile(args.out, description).writing() as file:
        interrupted = _run_missing(sweep, file, args, console)
        if interrupted:
            print(
                f"liegroup_sim: interrupted; {args.out} has {sweep.samples - len(file.missing)} of "
                f"{counted(sweep.samples, 'run')}, the same command runs the others",
                file=sys.stderr,
            )
            return EXIT_INTERRUPTED
        statuses = print_sweep(file, args.show, Console(file=sys.stdout))
    if not args.assemble and any(hint in status for status in statuses for hint in (AT_POSES, AT_VELOCITIES)):
        print("liegroup_sim: the sampled initial states violate the joints; --assemble corrects them", file=sys.stderr)
    return 0 if OK in statuses else EXIT_ALL_FAILED


def _shown(name, columns):
    """Column with a name, or with the name that it had before 0.3."""
    former = LARGEST + {"joints": "constraint_residual"}.get(name, name)
    return former if name not in columns and former in columns else name


def _sweep_of(scene, args):
    """(Sweep, description for the file) from the arguments."""
    settings = given_settings(args)
    try:
        if args.keep is not None and args.step is None and "method" not in settings:
            settings["step"] = _step_of_both(settings["step"], args.duration, args.keep)
        step = checked("step", settings.get("step"))
        every = None if args.keep is None else whole_steps(args.keep, step, "--keep")
        sweep = Sweep.of(
            scene,
            args.vary,
            args.samples,
            whole_steps(args.duration, step),
            args.seed,
            every,
            args.assemble,
            settings,
            reactions=args.reactions,
            record=args.record,
            gradient=args.gradient,
            control=read_setup(args.control) if args.control else (),
        )
    except (ParameterError, RunError):
        raise
    except ValueError as error:  # includes SceneError
        raise RunError(str(error)) from None
    found = versions()
    return sweep, describe(sweep) | {
        "version": __version__,
        "versions": {name: found.get(name) for name in ("python", *PACKAGES[:3])},
    }


def _step_of_both(step, duration, keep):
    """Longest step up to a given one that divides both a duration and the period of --keep."""
    whole_steps(keep, keep, "--keep")  # raises RunError for an invalid period
    least = max(1, math.ceil(keep / step * (1.0 - 1e-6)))  # as whole_steps rounds
    for parts in range(least, max(least, MOST_PARTS) + 1):
        if divides(keep / parts, duration):
            return keep / parts
    raise RunError(
        f"--keep {keep:g} s: no suitable step divides it and --duration {duration:g} s; choose a part of the duration"
    )


def _run_missing(sweep, file, args, console):
    """Run the missing samples; returns True after Ctrl-C."""
    missing = file.missing
    if not len(missing):
        return False
    done, failed = sweep.samples - len(missing), 0
    if done:
        print(f"liegroup_sim: {args.out} has {done} of {counted(sweep.samples, 'run')} already", file=sys.stderr)
    with Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.completed:.0f}/{task.total:.0f} runs"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[status_text]}"),
        console=console,
    ) as progress:
        task = progress.add_task(sweep.name, total=sweep.samples, completed=done, status_text="")
        try:
            for columns in sweep.run(missing, args.scheduler, args.workers):
                file.add(columns)
                failed += sum(status != "ok" for status in columns["status"])
                progress.update(task, advance=len(columns["run"]), status_text=f"{failed} failed" if failed else "")
        except KeyboardInterrupt:
            return True
    return False
