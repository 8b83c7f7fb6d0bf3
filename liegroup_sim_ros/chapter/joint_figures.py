# SPDX-License-Identifier: Apache-2.0
"""Figs. 6.2, 6.4 and 6.5 of the chapter: position errors of the joints, on three groups.

The table compares the largest errors with those of an independent implementation. Needs matplotlib.
"""

import numpy as np
from rich.table import Table

from liegroup_sim_ros.numbers import GROUPS as GROUP_NAMES

from .joint_runs import GROUPS, STEPS, four_bar_runs, heavy_top_runs

# Largest errors of an independent implementation, m: spherical joint of the top over 6 s,
# joints 1 to 4 of the four-bar over 1 s (0.15 s at the largest step).
TOP_INDEPENDENT = {"se3": (8.0e-15, 3.9e-15, 1.5e-14), "so3xr3": (7.499e-3, 7.985e-7, 8.031e-11)}
FOUR_BAR_INDEPENDENT = {
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
LOWEST = 1e-17  # m, lower limit of the log axis; exact zeros are not drawn


def count_joint_runs():
    """Number of runs in make_joint_figures."""
    return 2 * len(GROUPS) * len(STEPS)


def make_joint_figures(out, say=lambda text: None):
    """Draw Figs. 6.2, 6.4 and 6.5 in a folder; returns (paths, table of the largest errors).

    say : function that is called with the name of each run before it starts
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
    """Table of the largest errors of all runs, each row followed by that of an independent implementation."""
    table = Table(title="Largest position error of a joint, m", box=None, padding=(0, 1, 0, 0), title_justify="left")
    for column in ("group", "step", "", "top", *(f"joint {j}" for j in range(1, 5))):
        table.add_column(column, no_wrap=True)
    for group in GROUPS:
        for i, step in enumerate(STEPS):
            own = (*top[group, step].gap.max(axis=0), *bars[group, step].gap.max(axis=0))
            table.add_row(GROUP_NAMES[group], f"{step:g} s", "here", *(f"{error:.2e}" for error in own))
            if group not in TOP_INDEPENDENT:
                continue
            independent = TOP_INDEPENDENT[group][i], *FOUR_BAR_INDEPENDENT[group][i]
            table.add_row("", "", "elsewhere", *(f"{error:.2e}" for error in independent), style="dim")
    return table


def _draw(path, runs, panels):
    """Draw a row of panels for each group, a column for each joint and a curve for each step size."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4.6 * max(len(panels), 1.5), 3.2 * len(GROUPS)), layout="constrained", dpi=120)
    axes = figure.subplots(len(GROUPS), len(panels), sharex=True, sharey=True, squeeze=False)
    for row, group in zip(axes, GROUPS):
        for axis, (joint, title) in zip(row, panels):
            for step, colour in zip(STEPS, COLOURS):
                run = runs[group, step]
                times, gap = (run.times[1:], run.gap[1:, joint])  # without the start, where the error is zero
                axis.semilogy(
                    times,
                    np.where(gap > LOWEST, gap, np.nan),
                    color=colour,
                    linewidth=1.0,
                    label=f"h = {step:g} s",
                    marker=".",
                    markersize=4 if len(gap) < 50 else 1,
                )
            axis.set_title(f"{title}, {GROUP_NAMES[group].replace('R^3', 'R³')}", fontsize=10)
            axis.grid(True, which="major", color="#dddddd", linewidth=0.6)
            axis.set_ylim(LOWEST, 1e-1)
    for axis in axes[-1]:
        axis.set_xlabel("time, s")
    for axis in axes[:, 0]:
        axis.set_ylabel("position error, m")
    figure.legend(
        *axes[0, 0].get_legend_handles_labels(), loc="outside upper center", fontsize=9, ncols=3, frameon=False
    )
    figure.savefig(path)
    return path
