# SPDX-License-Identifier: Apache-2.0
"""Tables of an analysis, and progress, on a terminal."""

from contextlib import contextmanager

from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text

from liegroup_sim_ros.numbers import NO_NUMBER, counted, shown

from .summary import OVERVIEW, balance_table, comparison_rows, overview, sections, short_names
from .tables import TextTable


@contextmanager
def working(what):
    """Show a line on stderr while work lasts, if that is a terminal; yields a function that tells how far it is."""
    console = Console(stderr=True)
    columns = SpinnerColumn(), TextColumn("{task.description}", markup=False), TimeElapsedColumn()
    with Progress(*columns, console=console, disable=not console.is_terminal, transient=True) as bar:
        task = bar.add_task(what, total=None)
        yield lambda text: bar.update(task, description=f"{what}: {text}")


def print_table(figures, console):
    """Print verdict, problems and tables."""
    console.print(Text(figures["verdict"], style="bold"))
    for problem in figures["problems"]:
        console.print(Text(f"! {problem}", style="bold red"))
    for warning in figures["warnings"]:
        console.print(Text(f"! {warning}", style="yellow"))
    for title, rows in sections(figures):
        console.print()
        console.print(section(title, rows, 18))
    if "stored" in figures.get("balance", {}):
        console.print()
        console.print(printed(balance_table(figures["balance"])))


def print_overview(analyses, console):
    """Print a line for each recording, then their problems."""
    names = short_names(analyses)
    rows = [(name, *map(_marked, overview(figures))) for name, figures in zip(names, analyses)]
    console.print(printed(TextTable(None, ("file", *OVERVIEW), rows, 1)))
    for name, figures in zip(names, analyses):
        for problem in figures.get("problems") or [figures[key] for key in ("failed",) if key in figures]:
            text = problem if problem.startswith((figures["log"], name)) else f"{name}: {problem}"
            console.print(Text(f"! {text}", style="bold red"), soft_wrap=True)


def print_comparison(figures, console):
    """Print the difference between two recordings."""
    identical, samples = figures["identical"], figures["samples"]
    console.print()
    console.print(
        Text(
            f"Comparison with {figures['logs'][1]}: bit-identical in {identical} of "
            + counted(samples, "sample")
            + (f", first difference at {shown(figures['first_difference_s'], 's')}" if identical < samples else ""),
            style="bold",
        )
    )
    rows = [(what, value, Text(remark, style="dim")) for what, value, remark in comparison_rows(figures)[1:]]
    console.print(printed(TextTable(None, ("", "", ""), rows)))


def printed(table):
    """A Table for a console, without lines; markup in its texts is not interpreted."""
    found = _table(table.title, any(table.heads))
    for k, head in enumerate(table.heads):
        folds = k < table.folded
        found.add_column(
            Text(head),
            overflow="fold" if folds else "ellipsis",
            no_wrap=not folds,
            justify="right" if k in table.right else "left",
        )
    for row in table.rows:
        found.add_row(*(cell if isinstance(cell, Text) else Text(cell) for cell in row))
    return found


def section(title, rows, width=None):
    """Table of (quantity, value, remark) with a title; width of the values in characters."""
    table = _table(title, False)
    table.add_column(width=24, style="dim", overflow="fold")
    table.add_column(width=width, overflow="fold")
    table.add_column(style="dim", overflow="fold")
    for what, value, remark in rows:
        table.add_row(Text(what), _marked(value), Text(remark))
    return table


def _table(title, has_heads):
    title = None if title is None else Text(title)
    return Table(
        box=None, show_header=has_heads, padding=(0, 2, 0, 0), title=title, title_justify="left", title_style="bold"
    )


def _marked(cell):
    return Text(cell, style="bold red" if cell in NO_NUMBER else "")
