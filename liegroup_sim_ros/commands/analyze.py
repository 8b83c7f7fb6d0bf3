# SPDX-License-Identifier: Apache-2.0
"""`liegroup_sim analyze`: how wrong are recorded runs? As table, JSON, page and exit code.

One log is told in full; of many each gets a line. Many are spread over dask, where it is
installed: over the cores of this machine, or over a cluster by the address of its scheduler.
"""

import json
import math
import sys
from importlib.util import find_spec
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

from liegroup_core.errors import LieGroupSimError
from liegroup_core.study import tasks
from liegroup_sim_ros.analysis.analyse import REFERENCE_SECONDS, analyse, plain
from liegroup_sim_ros.analysis.comparison import differences
from liegroup_sim_ros.recording.addresses import AddressError, expand
from liegroup_sim_ros.recording.read import RecordingError, read_recording
from liegroup_sim_ros.report.terminal import print_comparison, print_overview, print_table

FORMAT = 1  # of the JSON document, config/analysis.schema.json
EXIT_EXCEEDED, EXIT_WRONG_INPUT = 1, 2


class AnalysisError(LieGroupSimError):
    """The analysis cannot be made or written; one line of text, exit code 2."""


def add_arguments(parser):
    """Arguments of the subcommand."""
    parser.description = (
        "Analyse recordings: error against the exact solution or an independent integration, "
        "drift of energy and momentum, constraint residuals, bitwise re-simulation, real-time "
        "figures, lost messages."
    )
    parser.epilog = (
        "Exit code: 0; 1 if a given bound is exceeded or cannot be judged; 2 if a recording "
        "cannot be read."
    )
    parser.add_argument(
        "logs",
        metavar="LOG",
        nargs="+",
        help="recording (*.mcap), folder of them, pattern, or address such as s3://bucket/*.mcap",
    )
    parser.add_argument(
        "--compare", metavar="LOG", help="also report the distance to this recording"
    )
    parser.add_argument("--html", metavar="PAGE", help="write a self-contained HTML report")
    parser.add_argument(
        "--png",
        metavar="FILE",
        help="write the plots of one recording as an image: *.png, *.pdf or *.svg (needs "
        "matplotlib)",
    )
    parser.add_argument("--json", metavar="FILE", help="write all figures as JSON")
    parser.add_argument(
        "--max-error",
        type=_bound,
        metavar="X",
        help="fail if an error is larger: position in m, attitude in rad",
    )
    parser.add_argument(
        "--max-drift",
        type=_bound,
        metavar="X",
        help="fail if a drift is larger: energy relative to the largest kinetic energy, "
        "momenta relative to the sum of the bodies' largest momenta",
    )
    parser.add_argument(
        "--no-reference",
        action="store_true",
        help="skip the comparison with a reference integration",
    )
    parser.add_argument(
        "--reference-seconds",
        type=_bound,
        default=REFERENCE_SECONDS,
        metavar="S",
        help="simulated time covered by the reference integration in s; inf: all (default: "
        "%(default)g)",
    )
    parser.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="scheduler of a Dask cluster, such as tcp://host:8786",
    )


def _bound(text):
    value = float(text)
    if not value >= 0.0:
        raise ValueError
    return value


def run(args):
    """Run the subcommand; returns the exit code. Raises RecordingError, SceneError and others."""
    try:
        logs = expand(args.logs)
    except AddressError as error:
        raise AnalysisError(str(error)) from None
    if args.no_reference and args.max_error is not None:
        raise AnalysisError("--max-error requires the reference: remove --no-reference")
    if args.compare and (len(logs) > 1 or args.scheduler):
        raise AnalysisError("--compare requires exactly one recording and no --scheduler")
    if args.png and (len(logs) > 1 or args.scheduler):
        raise AnalysisError("--png requires exactly one recording and no --scheduler")
    _check_writable(args.json, args.html, args.png)
    _check_picture(args.png)
    options = {"reference": not args.no_reference, "reference_seconds": args.reference_seconds}
    comparison, parts = None, []
    if len(logs) == 1 and not args.scheduler:
        analysis = _analyse_one(logs[0], options)
        found = [analysis.figures]
        if args.compare:
            with Console(stderr=True).status("comparing"):
                comparison = differences(read_recording(logs[0]), read_recording(args.compare))
            print_comparison(comparison[0], Console(file=sys.stdout))
        if args.png:
            _draw(analysis, args.png, comparison)
        if args.html:
            from liegroup_sim_ros.report.page import page_part  # plotly takes a second to import

            parts = [page_part(analysis)]
    else:
        found, parts = analyse_many(logs, options, args.scheduler, bool(args.html))
        print_overview(found, Console(file=sys.stdout))
    exceeded = find_exceeded(found, args.max_error, args.max_drift)
    if args.html:
        from liegroup_sim_ros.report.page import make_page

        bounds = [
            f"largest {what} {value:g}"
            for what, value in (("error", args.max_error), ("drift", args.max_drift))
            if value is not None
        ]
        _write(args.html, make_page(parts, comparison, exceeded, bounds))
    if args.json:
        _write(
            args.json,
            document(found, comparison and comparison[0], args.max_error, args.max_drift, exceeded),
        )
    failed = [entry for entry in found if "failed" in entry]
    if failed:
        rest = f" (and {len(failed) - 1} more)" if len(failed) > 1 else ""
        raise AnalysisError(f"{failed[0]['failed']}{rest}")
    if exceeded:
        print(f"liegroup_sim: {'; '.join(exceeded)}", file=sys.stderr)
        return EXIT_EXCEEDED
    return 0


def write_analysis(log, html, json_file):
    """Analyse one recording, print the table, write page and figures; returns the Analysis."""
    from liegroup_sim_ros.report.page import make_page, page_part

    _check_writable(html, json_file)
    analysis = _analyse_one(log, {})
    _write(html, make_page([page_part(analysis)]))
    _write(json_file, document([analysis.figures]))
    return analysis


def _analyse_one(log, options):
    """Analysis of a log, told on the terminal."""
    with Console(stderr=True).status("reading") as status:
        analysis = analyse(read_recording(log), tell=status.update, **options)
    print_table(analysis.figures, Console(file=sys.stdout))
    return analysis


def _check_picture(path):
    """Raise AnalysisError, before the work, for a picture that cannot be drawn."""
    if not path:
        return
    if not path.lower().endswith((".png", ".pdf", ".svg")):
        raise AnalysisError(f"{path}: the name must end in .png, .pdf or .svg")
    if find_spec("matplotlib") is None:
        raise AnalysisError("--png needs matplotlib: pip install 'liegroup_sim_ros[figures]'")


def _draw(analysis, path, comparison):
    from liegroup_sim_ros.report.picture import write_picture

    try:
        write_picture(analysis, path, comparison)
    except OSError as error:
        raise AnalysisError(f"{path}: cannot be written: {error.strerror}") from None
    except ValueError as error:
        raise AnalysisError(f"{path}: {error}") from None


def document(found, comparison=None, max_error=None, max_drift=None, exceeded=()):
    """The JSON text of figures; its schema is config/analysis.schema.json."""
    return (
        json.dumps(
            plain(
                {
                    "format": FORMAT,
                    "logs": found,
                    "comparison": comparison,
                    "bounds": {
                        "max_error": max_error,
                        "max_drift": max_drift,
                        "exceeded": list(exceeded),
                    },
                }
            ),
            indent=1,
            allow_nan=False,
        )
        + "\n"
    )


def find_exceeded(found, max_error=None, max_drift=None):
    """One text for every bound that a log exceeds, or of which that cannot be told."""
    exceeded = []
    for figures in found:
        if "failed" in figures:
            continue
        log = figures["log"]
        if max_error is not None:
            reference = figures.get("reference", {"failed": "there is no reference"})
            if "failed" in reference:
                exceeded.append(f"{log}: its error is unknown: {reference['failed']}")
            else:
                exceeded += [
                    f"{log}: {text}"
                    for name in ("position", "angle")
                    if (text := _too_large(reference[name], max_error))
                ]
        if max_drift is not None:
            drifts = _relative_drifts(figures)
            if not drifts:
                exceeded.append(
                    f"{log}: it has no drift to check, neither energy nor momentum is conserved"
                )
            exceeded += [
                f"{log}: relative drift {drift:.3g} of {name} exceeds {max_drift:g}"
                for name, drift in drifts
                if not drift <= max_drift
            ]
    return exceeded


def _too_large(error, bound):
    """None, or that an error is above a bound, or that the reference cannot tell."""
    unit = error["unit"]
    if not error["max"] <= bound:
        return f"error {error['max']:.3g} {unit} exceeds {bound:g}"
    if not error["max"] + error["uncertainty"] <= bound:
        return (
            f"error {error['max']:.3g} {unit} may exceed {bound:g}: the reference "
            f"uncertainty is {error['uncertainty']:.3g} {unit}"
        )
    return None


def _relative_drifts(figures):
    """[(of what, drift in parts of its size)] of all that the scene keeps."""
    if "energy" not in figures:
        return [("the motion", math.nan)]  # no sample is finite
    drifts = [("the energy", figures["energy"]["relative_drift"])]
    drifts += [
        ("the " + entry["component"], entry["relative_drift"]) for entry in figures["momentum"]
    ]
    return [(name, drift) for name, drift in drifts if drift is not None]


def analyse_log(log, options, page=None):
    """(figures of one log, what a page has of it); what a worker does.

    figures are {"log", "failed"} of one that cannot be analysed
    page : None without a page, else whether it has plots
    """
    try:
        analysis = analyse(read_recording(log), **options)
    except (RecordingError, LieGroupSimError) as error:
        figures = {"log": str(log), "failed": " ".join(str(error).split())}
        return figures, {"figures": figures}
    if page is None:
        return analysis.figures, None
    from liegroup_sim_ros.report.page import page_part

    return analysis.figures, page_part(analysis, page)


def analyse_many(logs, options, scheduler=None, page=False):
    """([figures], [what a page has]) in the order of the logs, by dask where it is installed.

    Both as analyse_log returns them.
    """
    drawn = None
    if page:
        from liegroup_sim_ros.report.page import MOST_PARTS as drawn
    work = [(log, options, None if drawn is None else k < drawn) for k, log in enumerate(logs)]
    with Progress(
        TextColumn("analysing"),
        BarColumn(),
        MofNCompleteColumn(),
        console=Console(stderr=True),
        auto_refresh=False,
    ) as progress:
        task = progress.add_task("", total=len(logs))
        found = {}
        for k, result in tasks.run(_analyse_work, work, scheduler):
            found[k] = result
            progress.advance(task)
            progress.refresh()
    return tuple(list(part) for part in zip(*(found[k] for k in range(len(work)))))


def _analyse_work(work):
    return analyse_log(*work)


def _check_writable(*paths):
    for path in filter(None, paths):
        if Path(path).is_dir() or not Path(path).absolute().parent.is_dir():
            raise AnalysisError(f"{path}: cannot be written: give a file in an existing folder")


def _write(path, text):
    try:
        Path(path).write_text(text, encoding="utf-8")
    except OSError as error:
        raise AnalysisError(f"{path}: cannot be written: {error.strerror}") from None
