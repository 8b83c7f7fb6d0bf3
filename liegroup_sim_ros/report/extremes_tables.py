# SPDX-License-Identifier: Apache-2.0
"""Tables of a robustness map on a terminal, and its JSON document."""

import json
import math

from rich.table import Table
from rich.text import Text

from liegroup_core.study.extremes.extremes import VERDICTS, counts, silent

from .extremes_page import SIGNS, shown, verdicts

WIDTH = 200  # characters; all tables fit into this width
STYLES = dict(zip(VERDICTS, ("green", "yellow", "blue", "cyan", "dim", "bold white on red")))
NOTE = (
    "accurate: error below 5 % of the motion; flagged: wrong, with a warning; "
    "refused: no step taken, with a reason; stopped: ended early with an error; "
    "unjudged: the reference is not accurate enough; silent: wrong without a "
    "warning"
)


def document(axes, cells):
    """JSON text of a robustness map: axes, number of cells for each verdict, cells."""
    content = {
        "schema": 1,
        "axes": [
            {"name": axis.name, "title": axis.title, "unit": axis.unit, "values": list(axis.values)} for axis in axes
        ],
        "counts": counts(cells),
        "cells": [{key: _finite(value) for key, value in cell.items()} for cell in cells],
    }
    return json.dumps(content, indent=1, allow_nan=False) + "\n"


def _finite(value):
    """None for a number that is not finite, because JSON has no infinity."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


def print_axis(axis, cells, methods, console):
    """Print the verdicts of an axis: a row for each method, a column for each value."""
    values, rows = verdicts(axis, cells, methods)
    console.print(Text(axis.title + (f", {axis.unit}" if axis.unit else ""), style="bold"), soft_wrap=True)
    table = Table(box=None, padding=(0, 1, 0, 0))
    table.add_column("", no_wrap=True)
    for value in values:
        table.add_column(shown(value), justify="center", no_wrap=True)
    for method, row in rows:
        table.add_row(Text(method), *(Text(SIGNS.get(each, ""), style=STYLES.get(each, "")) for each in row))
    console.print(table, width=WIDTH, crop=False)
    console.print()


def print_end(cells, console):
    """Print the number of cells for each verdict, and each undetected error."""
    console.print(Text(", ".join(f"{SIGNS[name]} {name} {number}" for name, number in counts(cells).items())))
    console.print(Text(NOTE, style="dim"))
    for cell in silent(cells):
        console.print(
            Text(
                f"! {cell['axis']} {shown(cell['value'])}, {cell['method']}: undetected error "
                f"of {cell['error']:.2g} of the motion",
                style="bold red",
            )
        )
