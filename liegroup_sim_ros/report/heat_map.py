# SPDX-License-Identifier: Apache-2.0
"""Robustness map as an image: a panel for each axis, a row for each method."""

import math

from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from liegroup_core.study.extremes.extremes import VERDICTS

from .extremes_page import shown

COLOURS = ("#8fcf9b", "#f2c14e", "#9db8d9", "#4f81bd", "#d9d9d9", "#d11f1f")
ACROSS = 4  # panels per row


def write_heat_map(axes, cells, methods, path):
    """Write the cells of all axes to a file, *.png, *.pdf or *.svg."""
    across = min(ACROSS, len(axes))
    rows = math.ceil(len(axes) / across)
    figure = Figure(figsize=(1.4 + 4.1 * across, 0.7 + 3.6 * rows), layout="constrained")
    panels = figure.subplots(rows, across, squeeze=False, sharey=True)
    place = {(cell["axis"], cell["value"], cell["method"]): VERDICTS.index(cell["verdict"]) for cell in cells}
    colours = ListedColormap(COLOURS)
    colours.set_bad("white")
    for axis, panel in zip(axes, panels.flat):
        values = [value for value in axis.values if any(key[:2] == (axis.name, value) for key in place)]
        grid = [[place.get((axis.name, value, method), math.nan) for value in values] for method in methods]
        if values:
            panel.imshow(
                grid,
                cmap=colours,
                aspect="auto",
                interpolation="nearest",
                norm=BoundaryNorm([k - 0.5 for k in range(len(VERDICTS) + 1)], len(VERDICTS)),
            )
        panel.set_title(axis.title + (f", {axis.unit}" if axis.unit else ""), fontsize=8)
        panel.set_xticks(range(len(values)), list(map(shown, values)), fontsize=6, rotation=90)
        panel.set_yticks(range(len(methods)), methods, fontsize=6)
    for panel in list(panels.flat)[len(axes) :]:
        panel.set_axis_off()
    figure.legend(
        handles=[Patch(color=colour, label=name) for name, colour in zip(VERDICTS, COLOURS)],
        loc="outside lower center",
        ncols=len(VERDICTS),
        fontsize=8,
    )
    figure.savefig(path, dpi=110)
