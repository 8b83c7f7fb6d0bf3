# SPDX-License-Identifier: Apache-2.0
"""Plots of an analysis as an image for papers, drawn by matplotlib."""

import math
import textwrap
from html import unescape

from matplotlib.figure import Figure

from .plots import centre_paths, difference_plot, make_plots

KINDS = (".png", ".pdf", ".svg")
WIDTH, ROW = 7.0, 2.4  # inch: text width of a page, height of a row of two plots
LINE, SHORT = 34, 12  # characters: line of a label; longest name for which a single curve needs no legend
COLOURS = {
    "--blue": "#2a6fd6",
    "--orange": "#cf6a12",
    "--green": "#16875a",
    "--violet": "#7049c0",
    "--red": "#d63a3a",
    "--grey": "#6b7480",
    "--teal": "#1394a8",
    "--pink": "#c2468f",
    "--olive": "#8a8418",
}
STYLES = {"solid": "-", "dot": ":", "dash": "--"}


def write_picture(analysis, path, comparison=None):
    """Write the plots of an Analysis to a file: *.png with 300 dpi, *.pdf or *.svg.

    comparison : (figures, curve), see comparison.differences
    raises OSError; ValueError if there is nothing to draw
    """
    plots = make_plots(analysis)
    if comparison:
        plots += difference_plot(comparison[1])
    if not plots:
        raise ValueError("no sample is finite: there is nothing to plot")
    count = len(plots) + 1
    rows = math.ceil(count / 2)
    figure = Figure(figsize=(WIDTH, ROW * rows), layout="constrained")
    _paths(figure.add_subplot(rows, 2, 1, projection="3d"), analysis)
    for k, (title, _, plot) in enumerate(plots, 2):
        _plane(figure.add_subplot(rows, 2, k), title, plot)
    # matplotlib would interpret a name with $ as a formula.
    with_names = [text for axes in figure.axes for text in axes.findobj(_is_text)]
    for text in with_names:
        text.set_parse_math(False)
    figure.savefig(path, dpi=300)


def _is_text(artist):
    return hasattr(artist, "set_parse_math") and "$" in artist.get_text()


def _plane(axes, title, plot):
    layout = plot["layout"]
    axes.set_title(title, fontsize=8.5)
    log = layout["yaxis"].get("type") == "log"
    traces = [trace for trace in plot["data"] if trace.get("visible", True)]
    for trace in traces:
        line = trace["line"]
        y = [math.nan if v is None or log and v <= 0.0 else v for v in trace["y"]]
        alone = [k for k, size in enumerate(trace.get("marker", {}).get("size", ())) if size]
        axes.plot(
            [math.nan if v is None else v for v in trace["x"]],
            y,
            lw=0.9,
            color=COLOURS[line["color"]],
            ls=STYLES[line["dash"]],
            **({"marker": ".", "markevery": alone} if alone else {}),
            label=_label(trace["name"]),
        )
    if log:
        axes.set_yscale("log")
        if "range" in layout["yaxis"]:
            axes.set_ylim(*(10.0**edge for edge in layout["yaxis"]["range"]))
    for shape in layout["shapes"]:
        if shape["type"] == "rect":
            axes.axvspan(shape["x0"], shape["x1"], color=COLOURS["--red"], alpha=0.18, lw=0)
            continue
        ends = [shape["x0"], shape["x1"]], [shape["y0"], shape["y1"]]
        whole = {("paper", "y"): axes.get_yaxis_transform, ("x", "paper"): axes.get_xaxis_transform}
        into = whole.get((shape["xref"], shape["yref"]), lambda: axes.transData)()
        axes.plot(*ends, transform=into, color=COLOURS[shape["line"]["color"]], lw=0.7, ls=":")
    axes.set_xlabel("time / s", fontsize=8)
    axes.set_ylabel(layout["yaxis"]["title"]["text"], fontsize=8)
    axes.tick_params(labelsize=7)
    axes.grid(True, lw=0.3)
    axes.yaxis.get_offset_text().set_fontsize(7)
    if len(traces) > 1 or len(traces[0]["name"]) > SHORT:
        axes.legend(fontsize=6, frameon=False)


def _paths(axes, analysis):
    axes.set_title("Paths of the centres of mass", fontsize=8.5)
    paths = centre_paths(analysis)
    for (body, path), colour in zip(paths.items(), list(COLOURS.values())[:4] * len(paths)):
        axes.plot(*path.T, lw=0.9, color=colour, label=_label(body))
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_box_aspect(None, zoom=0.9)  # space for the axis labels, which the layout ignores
    for name in "xyz":
        getattr(axes, f"set_{name}label")(f"{name} / m", fontsize=7, labelpad=-2)
        getattr(axes, f"{name}axis").set_tick_params(pad=-1)
    axes.locator_params(nbins=4)
    axes.tick_params(labelsize=6.5)
    if 1 < len(paths) <= 8:
        axes.legend(fontsize=6.5, frameon=False)


def _label(name):
    """Wrapped name, with a space before a leading underscore: matplotlib omits such names from legends."""
    name = textwrap.fill(unescape(name), LINE)
    return f" {name}" if name.startswith("_") else name
