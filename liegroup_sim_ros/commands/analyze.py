# SPDX-License-Identifier: Apache-2.0
"""`liegroup_sim analyze`: numerical error of recordings as table, JSON, HTML report and exit code.

One recording is reported in full, several in one line each.
"""

import sys
import time

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from liegroup_core.errors import LieGroupSimError
from liegroup_sim_ros.analysis.analyse import REFERENCE_SECONDS, REFERENCE_STEPS, analyse
from liegroup_sim_ros.analysis.bounds import find_exceeded
from liegroup_sim_ros.analysis.comparison import differences
from liegroup_sim_ros.analysis.document import document
from liegroup_sim_ros.recording.addresses import AddressError, expand
from liegroup_sim_ros.recording.read import read_recording
from liegroup_sim_ros.report.files import check_files, write_file, write_text
from liegroup_sim_ros.report.many import analyse_many
from liegroup_sim_ros.report.page import make_page, page_part
from liegroup_sim_ros.report.shapes import shapes_from
from liegroup_sim_ros.report.terminal import print_comparison, print_overview, print_table

from .arguments import count, not_negative

EXIT_EXCEEDED = 1
NOTICE = 10.0  # s of the reference integration, after which a line tells how far it is


class AnalysisError(LieGroupSimError):
    """Wrong arguments, or recordings that cannot be analysed; one line of text, exit code 2."""


def add_arguments(parser):
    """Arguments of the subcommand."""
    parser.description = (
        "Analyse recordings: error against a reference integration, "
        "recorded estimates of the error, drift of energy and momentum, constraint residuals, "
        "bitwise re-simulation, real-time figures, lost messages."
    )
    parser.epilog = "Exit code: 0; 1 if a given bound is exceeded or cannot be judged; 2 if a recording cannot be read."
    parser.add_argument(
        "logs",
        metavar="LOG",
        nargs="+",
        help="recording (*.mcap), folder of them, pattern, or address such as s3://bucket/*.mcap",
    )
    parser.add_argument("--compare", metavar="LOG", help="also report the distance to this recording")
    parser.add_argument("--html", metavar="PAGE", help="write a self-contained HTML report")
    parser.add_argument(
        "--robot",
        metavar="FILE",
        help="draw the visuals of this file in the report of --html: the robot file of the "
        "recording, or the scene file that refers to it (meshes need trimesh)",
    )
    parser.add_argument(
        "--plot",
        nargs="+",
        action="extend",
        default=[],
        metavar="NAME",
        help="also plot quantities in the report of --html, by their names as of `liegroup_sim run --columns`",
    )
    parser.add_argument("--bodies", dest="plot", action="append_const", const="positions", help="as --plot positions")
    parser.add_argument(
        "--png",
        metavar="FILE",
        help="write the plots of one recording as an image: *.png, *.pdf or *.svg (needs matplotlib)",
    )
    parser.add_argument("--json", metavar="FILE", help="write all figures as JSON")
    parser.add_argument(
        "--max-error",
        type=not_negative,
        metavar="X",
        help="fail if an error or its recorded estimate is larger, or none is known: position in m, attitude in rad",
    )
    parser.add_argument(
        "--max-drift",
        type=not_negative,
        metavar="X",
        help="fail if a drift is larger: energy relative to the largest kinetic energy, "
        "momenta relative to the sum of the bodies' largest momenta",
    )
    parser.add_argument(
        "--no-reference",
        action="store_true",
        help="skip the comparison with a reference solution; the recorded estimate of the error remains",
    )
    parser.add_argument(
        "--reference-seconds",
        type=not_negative,
        default=REFERENCE_SECONDS,
        metavar="S",
        help="simulated time covered by the reference integration in s; inf: all (default: %(default)g)",
    )
    parser.add_argument(
        "--reference-steps",
        type=count,
        default=REFERENCE_STEPS,
        metavar="N",
        help="maximum number of steps of the reference integration, which stops there "
        "(default: %(default)d, some minutes)",
    )
    parser.add_argument("--scheduler", metavar="ADDRESS", help="scheduler of a Dask cluster, such as tls://host:8786")


class _Notice:
    """One line of progress on stderr, if it is no terminal and the reference integration takes long."""

    def __init__(self, console):
        self._begin, self._is_due = None, not console.is_terminal

    def __call__(self, text):
        now = time.monotonic()
        self._begin = self._begin or now
        if self._is_due and now - self._begin > NOTICE:
            self._is_due = False
            print(f"liegroup_sim: {text} after {NOTICE:g} s; --reference-seconds ends it earlier", file=sys.stderr)


def _shapes(file, analysis):
    """Triangles of the bodies of an Analysis, from a robot file; None without a file. Prints remarks."""
    if file is None:
        return None
    shapes, remarks = shapes_from(file, analysis.scene, analysis.recording.settings.get("robot"))
    for remark in remarks:
        print(f"liegroup_sim: --robot {file}: {remark}", file=sys.stderr)
    return shapes


def run(args):
    """Run the subcommand; returns the exit code. Raises RecordingError, SceneError and others."""
    try:
        logs = expand(args.logs)
    except AddressError as error:
        raise AnalysisError(str(error)) from None
    many = len(logs) > 1 or args.scheduler
    for option in ("compare", "png", "robot", "plot"):
        if many and getattr(args, option):
            raise AnalysisError(f"--{option} requires exactly one recording and no --scheduler")
    check_files(args.json, args.html, picture=args.png)
    options = {
        "reference": not args.no_reference,
        "reference_seconds": args.reference_seconds,
        "reference_steps": args.reference_steps,
    }
    comparison, parts = None, []
    if many:
        found, parts = analyse_many(logs, options, args.scheduler, bool(args.html))
    else:
        console = Console(stderr=True)
        columns = TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn()
        with Progress(*columns, console=console, disable=not console.is_terminal, transient=True) as bar:
            task, notice = bar.add_task("reading", total=None), _Notice(console)

            def covered(seconds, total):
                text = f"reference: {seconds:.3g} of {total:.3g} s"
                bar.update(task, description=text, completed=seconds, total=total)
                notice(text)

            recording = read_recording(logs[0])
            analysis = analyse(
                recording, tell=lambda text: bar.update(task, description=text), covered=covered, **options
            )
            if args.compare:
                bar.update(task, description="comparing")
                comparison = differences(recording, read_recording(args.compare))
        found = [analysis.figures]
        if args.png:
            from liegroup_sim_ros.report.picture import write_picture  # needs matplotlib

            write_file(args.png, lambda path: write_picture(analysis, path, comparison))
        if args.html:
            parts = [page_part(analysis, shapes=_shapes(args.robot, analysis), columns=args.plot)]
    exceeded = find_exceeded(found, args.max_error, args.max_drift)
    if args.html:
        bounds = [
            f"largest {what} {value:g}"
            for what, value in (("error", args.max_error), ("drift", args.max_drift))
            if value is not None
        ]
        write_text(args.html, make_page(parts, comparison, exceeded, bounds))
    differing = comparison and comparison[0]
    if args.json:
        write_text(args.json, document(found, differing, args.max_error, args.max_drift, exceeded))
    # Print after writing the files, because the reader of stdout may end early, as in `| head`.
    console = Console(file=sys.stdout)
    if many:
        print_overview(found, console)
    else:
        print_table(found[0], console)
    if differing:
        print_comparison(differing, console)
    failed = [entry for entry in found if "failed" in entry]
    if failed:
        more = f" (and {len(failed) - 1} more)" if len(failed) > 1 else ""
        raise AnalysisError(f"{failed[0]['failed']}{more}")
    if exceeded:
        print(f"liegroup_sim: {'; '.join(exceeded)}", file=sys.stderr)
        return EXIT_EXCEEDED
    return 0
