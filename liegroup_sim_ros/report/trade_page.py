# SPDX-License-Identifier: Apache-2.0
"""Work-precision diagram of a trade-off: as a self-contained HTML report and as an image."""

from html import escape

import numpy as np

from liegroup_core.settings import SETTINGS

from .page import frame, plot_card, table, unbroken
from .plots import BASE, COLOURS, label
from .trade_figures import headline, reference_text, setting, tables

DASHES = ("solid", "dash", "dot", "longdashdot")  # with 6 colours, enough combinations for all methods
SYMBOLS = ("circle", "square", "triangle-up", "diamond", "triangle-down", "cross")
HEIGHT = 560  # px
CLOSE = np.array([0.15, 0.05])  # of the width and the height of the plot: labels of closer stars would overlap
MARKS = ("o", "s", "^", "D", "v", "P")
LINES = ("-", "--", ":", "-.")
TO_ACCURACY = "to an accuracy"
COST, ERROR = ("CPU time, s per simulated second", "error, rad or relative to the characteristic length")


def curves(part):
    """[(method, cells)]: Pareto front of each method, from cheap to accurate."""
    fronts = {}
    for cell in sorted(
        (cell for cell in part["cells"] if not cell["stopped"]), key=lambda cell: (cell["cost_us"], cell["error"])
    ):
        front = fronts.setdefault(cell["method"], [])
        if not front or cell["error"] < front[-1]["error"]:
            front.append(cell)
    return sorted(fronts.items())


def accuracy_text(entry):
    """Label of a simulation to an accuracy."""
    return f"accuracy {entry['accuracy']:g}" + (
        ", the default" if entry["accuracy"] == SETTINGS["accuracy"].default else ""
    )


def _stars(part):
    """[((cost, error), label)] of the simulations to an accuracy, by cost; the last of close stars has all labels."""
    known = part["reference"]["known"]

    def place(entry):
        return entry["cost_us"] * 1e-6, max(entry["error"], known)

    stars = sorted((place(entry), f"{entry['accuracy']:g}") for entry in part["to_accuracy"])
    every = [*(at for at, _ in stars), *(place(cell) for _, cells in curves(part) for cell in cells)]
    with np.errstate(divide="ignore", invalid="ignore"):  # a cost or an error of zero is not shown
        logarithms = np.log10(np.array(every).reshape(-1, 2))
        shown = logarithms[np.isfinite(logarithms).all(axis=1)]
        extent = np.ptp(shown, axis=0) if len(shown) else np.zeros(2)
        for k in range(len(stars) - 1):
            (at, text), (after, more) = stars[k : k + 2]
            if (np.abs(logarithms[k + 1] - logarithms[k]) < CLOSE * extent).all():
                stars[k : k + 2] = (at, ""), (after, f"{text}, {more}")
    return stars


def make_plot(part):
    """Work-precision diagram of a scene for plotly.js: error over cost."""
    known = part["reference"]["known"]
    traces = []
    for k, (method, cells) in enumerate(curves(part)):
        colour = COLOURS[k % len(COLOURS)]
        traces.append(
            {
                "type": "scatter",
                "mode": "lines+markers",
                "name": label(method),
                "x": [cell["cost_us"] * 1e-6 for cell in cells],
                "y": [max(cell["error"], known) for cell in cells],
                "text": [label(setting(cell)) for cell in cells],
                "line": {"color": colour, "width": 1.4, "dash": DASHES[k // len(COLOURS) % len(DASHES)]},
                "marker": {"color": colour, "size": 6, "symbol": SYMBOLS[k % len(SYMBOLS)]},
                "hovertemplate": "%{text}<br>error %{y:.3g}, %{x:.3g} s per s",
            }
        )
    front = [part["cells"][k] for k in part["front"]]
    traces.append(
        {
            "type": "scatter",
            "mode": "lines",
            "name": "Pareto front",
            "x": [cell["cost_us"] * 1e-6 for cell in front],
            "y": [max(cell["error"], known) for cell in front],
            "line": {"color": "--text", "width": 5, "dash": "solid"},
            "opacity": 0.25,
            "hoverinfo": "skip",
        }
    )
    traces.append(
        {
            "type": "scatter",
            "mode": "markers+text",
            "name": TO_ACCURACY,
            "x": [x for (x, _), _ in _stars(part)],
            "y": [y for (_, y), _ in _stars(part)],
            "text": [text for _, text in _stars(part)],
            "textposition": "top right",
            "cliponaxis": False,
            "hovertext": [accuracy_text(e) for e in sorted(part["to_accuracy"], key=lambda e: e["cost_us"])],
            "marker": {"color": "--text", "size": 12, "symbol": "star"},
            "hovertemplate": "%{hovertext}<br>error %{y:.3g}, %{x:.3g} s per s",
        }
    )
    axis = {
        "type": "log",
        "exponentformat": "power",
        "gridcolor": "--grid",
        "zerolinecolor": "--grid",
        "linecolor": "--grid",
        "automargin": True,
    }
    lines = [
        {
            "type": "line",
            "xref": xref,
            "yref": yref,
            "x0": x0,
            "x1": x1,
            "y0": y0,
            "y1": y1,
            "line": {"color": colour, "width": 1, "dash": "dot"},
        }
        for xref, yref, x0, x1, y0, y1, colour in (
            ("x", "paper", 1, 1, 0, 1, "--red"),
            ("paper", "y", 0, 1, known, known, "--grey"),
        )
    ]
    return {
        "data": traces,
        "layout": {
            "xaxis": {**axis, "title": {"text": COST, "standoff": 6}},
            "yaxis": {**axis, "title": {"text": ERROR, "standoff": 8}},
            "shapes": lines,
            "margin": {"l": 8, "r": 8, "t": 30, "b": 8},
            "height": HEIGHT,
            "hovermode": "closest",
            **BASE,
        },
    }


def make_page(parts):
    """HTML of the page (about 5 MB, including plotly.js)."""
    body = "" if len(parts) == 1 else f"<header><h1>{len(parts)} scenes</h1></header>"
    for k, part in enumerate(parts):
        tag = "h1" if len(parts) == 1 else "h2"
        body += (
            f"<{tag}>{escape(part['scene'])}: accuracy against cost</{tag}><p "
            f'class="verdict">{unbroken(headline(part))}</p><p class="soft">Errors against '
            f"{unbroken(reference_text(part))}. Processor: "
            f'{escape(_processor(part))}.</p><div class="cards" data-part="{k}">'
            + plot_card(
                "Work and precision",
                "Pareto front of each method; stars: requested accuracy; red: real time on one core; grey: "
                "reference uncertainty",
            )
            + "</div>"
            + "".join(f'<div class="cards">{table(each)}</div>' for each in tables(part))
        )
    title = f"{', '.join((part['scene'] for part in parts))}: accuracy against cost"
    return frame(title, body, [{"plots": [make_plot(part)], "view": None} for part in parts])


def _processor(part):
    return ", ".join(sorted({cell["cpu"] for cell in part["cells"]}))


def write_picture(part, path):
    """Write the plot of a scene to a file: *.png with 300 dpi, *.pdf or *.svg. Raises OSError."""
    from matplotlib.figure import Figure

    from .picture import COLOURS as INKS

    known, inks = part["reference"]["known"], list(INKS.values())
    figure = Figure(figsize=(7.0, 4.8), layout="constrained")
    axes = figure.add_subplot()
    front = [part["cells"][k] for k in part["front"]]
    axes.plot(
        [cell["cost_us"] * 1e-6 for cell in front],
        [max(cell["error"], known) for cell in front],
        color="black",
        lw=5,
        alpha=0.18,
        label="Pareto front",
    )
    for k, (method, cells) in enumerate(curves(part)):
        axes.plot(
            [cell["cost_us"] * 1e-6 for cell in cells],
            [max(cell["error"], known) for cell in cells],
            lw=0.9,
            ms=3,
            color=inks[k % len(inks)],
            marker=MARKS[k % len(MARKS)],
            ls=LINES[k // len(inks) % len(LINES)],
            label=method,
        )
    for place, text in _stars(part):
        axes.plot(*place, "*", ms=8, color="black")
        axes.annotate(text, place, (4, 3), textcoords="offset points", fontsize=5.5)
    axes.axvline(1.0, color=INKS["--red"], lw=0.8, ls=":")
    axes.axhline(known, color=INKS["--grey"], lw=0.8, ls=":")
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlabel(COST, fontsize=8)
    axes.set_ylabel(ERROR, fontsize=8)
    axes.tick_params(labelsize=7)
    axes.grid(True, lw=0.3)
    title = axes.set_title(
        f"{part['scene']}, {part['horizon']:g} s; errors against the reference integration", fontsize=8.5
    )
    title.set_parse_math(False)
    axes.legend(fontsize=6, frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
    figure.savefig(path, dpi=300)
