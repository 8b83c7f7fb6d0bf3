# SPDX-License-Identifier: Apache-2.0
"""`liegroup_sim figures`: Figs. 6.2 and 6.4 to 6.9 of the chapter, drawn from runs made here.

The tables beside them compare with independent implementations of the same methods. Figs. 6.6 to
6.9 are in rotation_figures.py. What the pictures show, and which claims of the chapter hold, is in
docs/explanation/figures.md. No ROS.
"""

import logging
import sys
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from liegroup_core.errors import LieGroupSimError
from liegroup_core.integrators.methods import GROUPS
from liegroup_sim_ros.chapter.joint_runs import STEPS, four_bar_runs, heavy_top_runs
from liegroup_sim_ros.chapter.rotation_figures import count_runs, make_rotation_figures
from liegroup_sim_ros.numbers import GROUPS as GROUP_NAMES

# Largest errors of an independent implementation, m: of the top's ball joint over 6 s, and of the
# four-bar's joints 1 to 4 over 1 s, or 0.15 s at the largest step.
TOP_ELSEWHERE = {"se3": (8.0e-15, 3.9e-15, 1.5e-14), "so3xr3": (7.499e-3, 7.985e-7, 8.031e-11)}
FOUR_BAR_ELSEWHERE = {
    "se3": (
        (1.6e-13, 3.67e-4, 8.07e-4, 1.1e-16),
        (7.3e-16, 3.59e-4, 3.86e-6, 4.6e-15),
        (2.4e-15, 3.56e-8, 7.39e-10, 3.1e-15),
    ),
    "so3xr3": (
        (8.9e-4, 4.35e-4, 9.26e-4, 1.89e-4),
        (1.03e-4, 1.98e-4, 7.52e-5, 2.61e-5),
        (1.06e-8, 2.00e-8, 7.53e-9, 2.69e-9),
    ),
}

COLOURS = ("#b3432b", "#2c6e9b", "#3f8f4f")  # of the step sizes
TABLE_WIDTH = 160
LOWEST = 1e-17  # m; what is exactly zero is not drawn

NOTE = (
    "none: no solution at this step (RATTLE), or a step that is refused (RKMK4, where a stage "
    "turns by nearly a full turn).\nElsewhere: independent implementations; what differs from "
    "them and why is in docs/explanation/figures.md."
)


class FiguresError(LieGroupSimError):
    """The figures cannot be made; one line of text, exit code 2."""


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
        import matplotlib  # noqa: F401  before the work
        import mpmath  # noqa: F401  for the exact motions
    except ImportError as error:
        raise FiguresError(f"{error.name} is needed to draw: pip install {error.name}") from None
    out = Path(args.out)
    try:
        out.mkdir(parents=True, exist_ok=True)
        with _Progress(2 * len(GROUPS) * len(STEPS) + count_runs()) as say:
            paths, table = make_figures(out, say)
            more_paths, tables = make_rotation_figures(out, say)
    except OSError as error:
        raise FiguresError(f"{error.filename}: cannot be written: {error.strerror}") from None
    console = Console(file=sys.stdout)
    for each in (table, *tables):  # whole, in a narrow terminal too
        console.print(each, width=max(console.width, TABLE_WIDTH), crop=False)
    console.print(NOTE, soft_wrap=True, highlight=False)
    print(*paths, *more_paths, sep="\n")
    return 0


class _Progress(logging.Handler):
    """A bar of so many runs, and the warnings of each above it, with its name."""

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
        self._runs, self._made, self._name = runs, -1, ""

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
        self._made, self._name = self._made + 1, name
        self._bar.update(self._task, completed=self._made, description=name)

    def emit(self, record):
        figure = self._name.partition(",")[0]
        self._bar.console.print(
            f"{figure}: {record.getMessage()}",
            style="yellow",
            markup=False,
            highlight=False,
            soft_wrap=True,
        )


def make_figures(out, say=lambda text: None):
    """Make the pictures in a folder; returns (their paths, table of the largest errors).

    say : is called with the name of each run before it is made
    """
    top, bars = heavy_top_runs(say), four_bar_runs(say)
    joints = bars["se3", STEPS[0]].joints
    paths = [
        _draw(out / "fig_6_2.png", top, [(0, "spherical joint of the heavy top")]),
        _draw(out / "fig_6_4.png", bars, [(j, f"joint {j + 1}: {joints[j]}") for j in (0, 1)]),
        _draw(out / "fig_6_5.png", bars, [(j, f"joint {j + 1}: {joints[j]}") for j in (2, 3)]),
    ]
    return paths, make_table(top, bars)


def make_table(top, bars):
    """Largest errors of all runs and, below each, those of an independent implementation."""
    table = Table(
        title="Largest position error of a joint, m",
        box=None,
        padding=(0, 1, 0, 0),
        title_justify="left",
    )
    for column in ("group", "step", "", "top", *(f"joint {j}" for j in range(1, 5))):
        table.add_column(column, no_wrap=True)
    for group in GROUPS:
        for i, step in enumerate(STEPS):
            here = (*top[group, step].gap.max(axis=0), *bars[group, step].gap.max(axis=0))
            elsewhere = TOP_ELSEWHERE[group][i], *FOUR_BAR_ELSEWHERE[group][i]
            table.add_row(
                GROUP_NAMES[group], f"{step:g} s", "here", *(f"{error:.2e}" for error in here)
            )
            table.add_row(
                "", "", "elsewhere", *(f"{error:.2e}" for error in elsewhere), style="dim"
            )
    return table


def _draw(path, runs, panels):
    """One row of panels for each group, one column for each joint; a curve for each step size."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4.6 * max(len(panels), 1.5), 6.4), layout="constrained", dpi=120)
    axes = figure.subplots(len(GROUPS), len(panels), sharex=True, sharey=True, squeeze=False)
    for row, group in zip(axes, GROUPS):
        for axis, (joint, title) in zip(row, panels):
            for step, colour in zip(STEPS, COLOURS):
                made = runs[group, step]
                times, gap = made.times[1:], made.gap[1:, joint]  # closed at the start
                axis.semilogy(
                    times[gap > LOWEST],
                    gap[gap > LOWEST],
                    color=colour,
                    linewidth=1.0,
                    label=f"h = {step:g} s",
                    marker="." if len(gap) < 50 else "",
                    markersize=4,
                )
            axis.set_title(f"{title}, {GROUP_NAMES[group].replace('R^3', 'R³')}", fontsize=10)
            axis.grid(True, which="major", color="#dddddd", linewidth=0.6)
            axis.set_ylim(LOWEST, 1e-1)
    for axis in axes[-1]:
        axis.set_xlabel("time, s")
    for axis in axes[:, 0]:
        axis.set_ylabel("position error, m")
    figure.legend(
        *axes[0, 0].get_legend_handles_labels(),
        loc="outside upper center",
        fontsize=9,
        ncols=3,
        frameon=False,
    )
    figure.savefig(path)
    return path
