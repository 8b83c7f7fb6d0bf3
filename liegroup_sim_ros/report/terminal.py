# SPDX-License-Identifier: Apache-2.0
"""Tables of an analysis on a terminal."""

from rich.table import Table
from rich.text import Text

from liegroup_sim_ros.numbers import NO_NUMBER, counted, shown

from .summary import (
    BALANCE_HEAD,
    BALANCE_TITLE,
    OVERVIEW,
    balance_rows,
    comparison_rows,
    overview,
    sections,
    short_names,
)


def print_table(figures, console):
    """Print verdict, problems and tables."""
    console.print(Text(figures["verdict"], style="bold"))
    for problem in figures["problems"]:
        console.print(Text(f"! {problem}", style="bold red"))
    for warning in figures["warnings"]:
        console.print(Text(f"! {warning}", style="yellow"))
    for title, rows in sections(figures):
        table = Table(
            box=None,
            show_header=False,
            padding=(0, 2, 0, 0),
            title=Text(title),
            title_justify="left",
            title_style="bold",
        )
        table.add_column(width=24, style="dim")
        table.add_column(width=18)
        table.add_column(style="dim", overflow="fold")
        for what, value, remark in rows:
            style = "bold red" if value in NO_NUMBER else ""
            table.add_row(Text(what), Text(value, style=style), Text(remark))
        console.print()
        console.print(table)
    if "stored" in figures.get("balance", {}):
        console.print()
        console.print(plain_table(BALANCE_TITLE, BALANCE_HEAD, balance_rows(figures["balance"])))


def print_overview(analyses, console):
    """Print a line for each recording, then their problems."""
    table = Table(box=None, padding=(0, 2, 0, 0))
    names = short_names(analyses)
    for title in ("file", *OVERVIEW):
        table.add_column(Text(title), overflow="fold", no_wrap=title != "file")
    for name, figures in zip(names, analyses):
        table.add_row(
            Text(name), *(Text(cell, style="bold red" if cell in NO_NUMBER else "") for cell in overview(figures))
        )
    console.print(table)
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
    table = Table(box=None, show_header=False, padding=(0, 2, 0, 0))
    for what, value, remark in comparison_rows(figures)[1:]:
        table.add_row(Text(what), Text(value), Text(remark, style="dim"))
    console.print(table)


def plain_table(title, heads, rows):
    """Table without lines; markup in its texts is not interpreted."""
    table = Table(box=None, padding=(0, 2, 0, 0), title=Text(title), title_justify="left", title_style="bold")
    for head in heads:
        table.add_column(Text(head), no_wrap=True)
    for row in rows:
        table.add_row(*map(Text, row))
    return table
