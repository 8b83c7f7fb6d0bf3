# SPDX-License-Identifier: Apache-2.0
"""Results of a sweep as tables: quantiles, and rank correlations with the parameters."""

import re

import numpy as np
from rich.text import Text
from scipy.stats import spearmanr

from liegroup_core.study.sweep.sweep import LARGEST, OK
from liegroup_sim_ros.numbers import counted, shown

from .tables import TextTable
from .terminal import printed

WIDTH = 130  # characters; in a narrower terminal, lines wrap
QUANTILES = (0.0, 0.05, 0.5, 0.95, 1.0)
BODIES = 2  # number of bodies whose states are shown by default
REASONS = 10  # largest number of different texts that are printed
# Smallest number of runs for a rank correlation; with fewer, 5 % of correlations exceed 0.6 by chance.
LEAST = 10


def spread(table, columns):
    """{column: quantiles QUANTILES}; None for a column without numbers."""
    result = {}
    for name in columns:
        values = table[name][np.isfinite(table[name])]
        result[name] = np.quantile(values, QUANTILES) if len(values) else None
    return result


def dependence(table, parameters, columns):
    """{column: {parameter: Spearman's rank correlation}} of the runs that have both numbers.

    Constant columns, and columns with fewer than LEAST runs, are omitted.
    """
    result = {}
    for column in columns:
        for parameter in parameters:
            x, y = table[parameter], table[column]
            both = np.isfinite(x) & np.isfinite(y)
            x, y = x[both], y[both]
            if len(x) >= LEAST and np.ptp(x) > 0.0 and np.ptp(y) > 0.0:
                result.setdefault(column, {})[parameter] = float(spearmanr(x, y).statistic)
    return result


def reasons(texts):
    """[(count, text)], most frequent first; texts that differ only in numbers are merged."""
    kinds = {}
    for text in texts:
        kinds.setdefault(re.sub(r"[-+]?\d[\d.]*(e[-+]?\d+)?", "#", text), []).append(text)
    return [(len(same), same[0]) for same in sorted(kinds.values(), key=len, reverse=True)]


def _solver(settings):
    """Text with the method, or with the accuracy if there is none."""
    if "method" in settings:
        return settings["method"]
    return f"accuracy {settings['accuracy']:g} in {settings['horizon']:g} s, states"


def print_sweep(file, show, console):
    """Print the tables of a SweepFile on a terminal. Returns the set of the statuses of its runs.

    show : names of columns, or None
    """
    sweep = file.sweep
    kinds = sweep.columns
    columns = list(show or _usual(sweep))
    needed = ["run", "status", "warning", "cpu_s", "time", *sweep.paths, *columns]
    read = file.table(list(dict.fromkeys(needed)))
    table = {
        name: read[name].to_numpy() if kinds[name] != "text" else read[name].to_pylist() for name in read.column_names
    }
    ok = np.array([status == OK for status in table["status"]])
    console.width = max(console.width, WIDTH)
    settings = dict(sweep.settings)
    console.print(
        Text(
            f"{sweep.name}: {counted(len(ok), 'run')} of {sweep.steps * settings['step']:.9g} s, "
            f"{_solver(settings)} at {shown(settings['step'] * 1e3, 'ms')}; "
            f"{len(ok) - ok.sum()} failed",
            style="bold",
        )
    )
    cpu = table["cpu_s"]
    if len(cpu):
        mean, total = shown(cpu.mean() * 1e3, "ms"), shown(cpu.sum(), "s")
        console.print(Text(f"{mean} of CPU time per run, {total} in total", style="dim"))
    _print_reasons(console, "failed", [s for s in table["status"] if s != OK])
    _print_reasons(console, "with warning", [w for w in table["warning"] if w])
    for name in dict.fromkeys((*sweep.paths, *columns)):
        table[name] = np.where(ok, table[name], np.nan)
    distribution = spread(table, (*sweep.paths, *columns))
    _print(
        console,
        "Distribution of the completed runs",
        ("", "minimum", "5 %", "median", "95 %", "maximum"),
        [(name, *map(shown, values)) for name, values in distribution.items() if values is not None],
    )
    ranks = dependence(table, sweep.paths, columns)
    _print(
        console,
        "Rank correlation (Spearman): 0 none, 1 or -1 monotonically increasing or decreasing",
        ("", *sweep.paths),
        [(name, *(f"{row[path]:+.2f}" if path in row else "-" for path in sweep.paths)) for name, row in ranks.items()],
    )
    return set(table["status"])


def _usual(sweep):
    floats = [
        name
        for name, kind in sweep.columns.items()
        if kind == "float" and name not in (*sweep.paths, "cpu_s", "time", "energy_start")
    ]
    owners = list(dict.fromkeys(name.rpartition(".")[0] for name in floats if "." in name))
    shown = ["", LARGEST[:-1], *owners[:BODIES]]
    return [name for name in floats if name.rpartition(".")[0] in shown]


def _print_reasons(console, what, texts):
    found = reasons(texts)
    for count, text in found[:REASONS]:
        console.print(Text(f"{count} {what}: {text}"))
    if len(found) > REASONS:
        console.print(
            Text(
                f"{sum(count for count, _ in found[REASONS:])} {what} for "
                f"{counted(len(found) - REASONS, 'other reason')}"
            )
        )


def _print(console, title, heads, rows):
    if rows:
        console.print(printed(TextTable(title, heads, rows)))
