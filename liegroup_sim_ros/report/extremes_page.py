# SPDX-License-Identifier: Apache-2.0
"""Robustness map as Markdown: counts, undetected errors, and a table of verdicts per axis."""

import statistics

from liegroup_core.study.extremes.extremes import VERDICTS, counts, silent
from liegroup_sim_ros.numbers import counted

SIGNS = dict(zip(VERDICTS, ".fxs?!"))


def write_page(axes, cells, methods, path):
    """Write the map as Markdown."""
    with open(path, "w", encoding="utf-8") as file:
        file.write("\n".join(_lines(axes, cells, methods)) + "\n")


def shown(value):
    """Value of an axis with enough digits to distinguish it from other values, such as 1.000001 from 1."""
    short = f"{value:g}"
    return short if float(short) == value else f"{value:.7g}"


def _lines(axes, cells, methods):
    yield "# Robustness map"
    yield ""
    yield ("Written by `liegroup_sim extremes`. docs/explanation/robustness.md explains the signs and the verdicts.")
    yield ""
    yield "| sign | verdict | cells |"
    yield "|---|---|---|"
    for name, number in counts(cells).items():
        yield f"| {SIGNS[name]} | {name} | {number} |"
    yield ""
    yield from _numbers(cells)
    for axis in axes:
        yield from _table(axis, [cell for cell in cells if cell["axis"] == axis.name], methods)


def _numbers(cells):
    wrong = silent(cells)
    yield (counted(len(wrong), "undetected error") + (":" if wrong else "."))
    for cell in wrong:
        yield (f"* {cell['axis']} {shown(cell['value'])}, {cell['method']}: error {cell['error']:.2g} of the motion")
    flagged = [cell for cell in cells if cell["verdict"] == "flagged"]
    only_estimate = [cell for cell in flagged if not cell["says"]]
    warned = sorted(cell["error"] for cell in cells if cell["verdict"] == "accurate" and cell["says"])
    yield ""
    yield (
        f"Flagged by the estimated error alone: {len(only_estimate)} of "
        f"{counted(len(flagged), 'flagged cell')}. Without it their errors would be undetected."
    )
    if warned:
        yield (
            f"Accurate with a warning: {counted(len(warned), 'cell')}; their errors are between "
            f"{warned[0]:.1g} and {warned[-1]:.1g} of the motion, median "
            f"{statistics.median(warned):.1g}."
        )
    yield ""


def verdicts(axis, cells, methods):
    """(values, [(method, [verdict or None at each value])]) of an axis, of the methods that have some."""
    values = [value for value in axis.values if any(cell["value"] == value for cell in cells)]
    place = {(cell["method"], cell["value"]): cell["verdict"] for cell in cells}
    rows = [(method, [place.get((method, value)) for value in values]) for method in methods]
    return values, [row for row in rows if any(row[1])]


def _table(axis, cells, methods):
    values, rows = verdicts(axis, cells, methods)
    yield f"## {axis.title}{f', {axis.unit}' if axis.unit else ''}"
    yield ""
    yield "| | " + " | ".join(map(shown, values)) + " |"
    yield "|---|" + "---|" * len(values)
    for method, row in rows:
        yield f"| {method} | " + " | ".join(SIGNS.get(verdict, "") for verdict in row) + " |"
    yield ""
