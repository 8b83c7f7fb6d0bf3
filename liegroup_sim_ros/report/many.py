# SPDX-License-Identifier: Apache-2.0
"""Analysis of many recordings in parallel, with the parts of their HTML report.

The recordings are distributed over the cores of this machine, or by Dask over a cluster.
"""

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

from liegroup_core.errors import LieGroupSimError
from liegroup_core.study import tasks
from liegroup_sim_ros.analysis import analyse
from liegroup_sim_ros.recording import read_recording

from .page import MOST_PARTS, page_part


def analyse_log(log, options, plots=None):
    """(figures, part of the HTML report) of one recording.

    options : keyword arguments of analyse
    plots   : None for no report, else whether its part has plots
    returns ({"log", "failed"}, ...) for a recording that cannot be analysed
    """
    try:
        analysis = analyse(read_recording(log), **options)
    except LieGroupSimError as error:
        figures = {"log": str(log), "failed": " ".join(str(error).split())}
        return figures, {"figures": figures}
    return analysis.figures, None if plots is None else page_part(analysis, plots)


def analyse_many(logs, options, scheduler=None, page=False):
    """([figures], [part of the HTML report]) in the order of the recordings, see analyse_log.

    scheduler : address of a Dask cluster; None: the cores of this machine
    page      : whether an HTML report is needed; its first MOST_PARTS recordings have plots
    """
    work = [(log, options, k < MOST_PARTS if page else None) for k, log in enumerate(logs)]
    with Progress(
        TextColumn("analysing"), BarColumn(), MofNCompleteColumn(), console=Console(stderr=True), auto_refresh=False
    ) as progress:
        task = progress.add_task("", total=len(logs))
        results = {}
        for k, result in tasks.run(_analyse_work, work, scheduler):
            results[k] = result
            progress.advance(task)
            progress.refresh()
    return tuple(list(part) for part in zip(*(results[k] for k in range(len(work)))))


def _analyse_work(work):
    return analyse_log(*work)
