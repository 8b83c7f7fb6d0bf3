# SPDX-License-Identifier: Apache-2.0
"""`liegroup_sim figures`: compute and draw Figs. 6.2 and 6.4 to 6.9 of the chapter. Needs no ROS.

The tables compare the largest errors with those of independent implementations of the same methods.
docs/explanation/figures.md discusses the figures and the claims of the chapter.
"""

import logging
import sys
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from liegroup_core.errors import LieGroupSimError
from liegroup_sim_ros.chapter.joint_figures import count_joint_runs, make_joint_figures
from liegroup_sim_ros.chapter.rotation_figures import count_runs, make_rotation_figures

TABLE_WIDTH = 160

NOTE = (
    "none: no solution at this step (RATTLE), or the step is refused (RKMK4, if a stage rotates "
    "by almost 2 pi).\nhere: this package; elsewhere: independent implementations. "
    "docs/explanation/figures.md explains the differences."
)


class FiguresError(LieGroupSimError):
    """The figures cannot be drawn; one line of text, exit code 2."""


def add_arguments(parser):
    """Arguments of the subcommand."""
    parser.description = (
        "Compute and draw Figs. 6.2 and 6.4 to 6.9 of the chapter: the constraint residuals "
        "of the heavy top and the planar four-bar for three step sizes on both groups, and "
        "the errors of the rotation methods for the free body and the Lagrangian top. Print "
        "the largest errors."
    )
    parser.add_argument(
        "--out",
        default="figures_out",
        metavar="DIR",
        help="folder for the images; earlier ones are overwritten (default: %(default)s)",
    )


def run(args):
    """Run the subcommand; returns the exit code. Raises FiguresError."""
    try:
        import matplotlib  # noqa: F401  checked before the runs
        import mpmath  # noqa: F401  for the exact solutions
    except ImportError as error:
        raise FiguresError(f"{error.name} is needed to draw: pip install {error.name}") from None
    out = Path(args.out)
    try:
        out.mkdir(parents=True, exist_ok=True)
        with _Progress(count_joint_runs() + count_runs()) as say:
            paths, table = make_joint_figures(out, say)
            more_paths, tables = make_rotation_figures(out, say)
    except OSError as error:
        raise FiguresError(f"{error.filename}: cannot be written: {error.strerror}") from None
    console = Console(file=sys.stdout)
    for result in (table, *tables):  # do not crop them in a narrow terminal
        console.print(result, width=max(console.width, TABLE_WIDTH), crop=False)
    console.print(NOTE, soft_wrap=True, highlight=False)
    print(*paths, *more_paths, sep="\n")
    return 0


class _Progress(logging.Handler):
    """Progress bar over the runs; warnings are printed above it with the name of the run."""

    def __init__(self, runs):
        super().__init__(logging.WARNING)
        self._bar = Progress(
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TextColumn("{task.description}", markup=False),
            console=Console(stderr=True),
        )
        self._task = self._bar.add_task("", total=runs)
        self._runs, self._done, self._name = runs, -1, ""

    def __enter__(self):
        logging.getLogger("liegroup_core").addHandler(self)
        self._bar.start()
        return self._say

    def __exit__(self, *failure):
        if failure == (None, None, None):
            self._bar.update(self._task, completed=self._runs, description="done")
        self._bar.stop()
        logging.getLogger("liegroup_core").removeHandler(self)

    def _say(self, name):
        self._done, self._name = self._done + 1, name
        self._bar.update(self._task, completed=self._done, description=name)

    def emit(self, record):
        figure = self._name.partition(",")[0]
        self._bar.console.print(
            f"{figure}: {record.getMessage()}", style="yellow", markup=False, highlight=False, soft_wrap=True
        )
