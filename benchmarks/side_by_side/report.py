# SPDX-License-Identifier: Apache-2.0
"""Results of `peers.py` as tables, as sentences about missed targets, and as JSON data."""

import math

from rich.table import Table

from .measure import TARGETS
from .ours import CODE as OURS

WORDS = tuple(f"{target:.0e}".replace("e-0", "e-") for target in TARGETS)


def best(results, target, ours, counted=True):
    """(entry, Cost) of the cheapest result of ours or of the others; None if none meets it.

    counted : True: among ranked entries; False: among the entries outside of the ranking
    """
    met = [
        (entry, costs[target])
        for entry, _, costs in results
        if entry.counted == counted and (entry.code == OURS) == ours and costs[target] is not None
    ]
    return min(met, key=lambda pair: pair[1].cost, default=None)


def ratio(results, target):
    """Best cost of the others divided by ours (above 1: ours is cheaper); None if unknown."""
    mine, theirs = best(results, target, True), best(results, target, False)
    if mine is None:
        return 0.0 if theirs is not None else None
    return theirs[1].cost / mine[1].cost if theirs is not None else math.inf


def _number(value, digits=3):
    """Plain decimal notation with a number of significant digits."""
    if value == 0.0:
        return "0"
    places = max(0, digits - 1 - math.floor(math.log10(abs(value))))
    return f"{value:.{places}f}"


def _cell(cost):
    return "-" if cost is None else _number(1e3 * cost.cost)


def _step(cost):
    """us per step."""
    return _number(1e6 * cost.cost / cost.steps)


def costs_table(name, problem, results):
    """Table of one problem: all configurations of the others, our best ones, these with an estimate."""
    table = Table(
        title=f"{name}, {problem.title}, {problem.duration:g} s: CPU ms per simulated s until "
        "||R - R_exact|| and gaps stay below",
        title_justify="left",
    )
    table.add_column("code")
    table.add_column("setting")
    for word in WORDS:
        table.add_column(word, justify="right")
    table.add_column("us/step", justify="right")
    table.add_column("gap at " + WORDS[0], justify="right")
    kinds = {entry.kind: [] for entry, _, _ in results if entry.code == OURS}
    for kind, some in kinds.items():
        some += [result for result in results if result[0].kind == kind]
    winners = {id(found[0]) for target in TARGETS for some in kinds.values() if (found := best(some, target, True))}
    for entry, rungs, costs in results:
        if entry.code == OURS and id(entry) not in winners:
            continue
        cells = []
        for target in TARGETS:
            top = best(results, target, entry.code == OURS)
            mark = top is not None and top[0] is entry
            cells.append(f"[bold]{_cell(costs[target])}[/bold]" if mark else _cell(costs[target]))
        finest = next((costs[t] for t in reversed(TARGETS) if costs[t] is not None), None)
        first = next((costs[t] for t in TARGETS if costs[t] is not None), None)
        table.add_row(
            entry.code,
            entry.setting + ("" if entry.counted else " (not counted)"),
            *cells,
            "-" if finest is None else _step(finest),
            "-" if first is None else f"{first.gap:.0e}",
            style=None if entry.counted else "dim",
        )
    estimating = [best(results, target, True, counted=False) for target in TARGETS]
    if any(estimating):
        table.add_row(
            OURS,
            "the same, estimating their error (not counted)",
            *(_cell(found and found[1]) for found in estimating),
            style="dim",
        )
    table.add_section()
    verdicts = [_verdict(ratio(results, target), w) for target, w in zip(TARGETS, problem.wanted)]
    table.add_row("", "best of the others / ours", *verdicts)
    return table


def _verdict(value, wanted):
    if value is None:
        return "-"
    style = "green" if value >= wanted else "yellow" if value >= 1.0 else "red"
    shown = "no other" if value == math.inf else f"{value:.1f}"
    return f"[{style}]{shown}[/{style}] (>= {wanted:g})"


def shortfalls(name, problem, results):
    """One sentence per missed target: by how much, against which code, and why."""
    for target, wanted, word in zip(TARGETS, problem.wanted, WORDS):
        value = ratio(results, target)
        if value is None or value >= wanted:
            continue
        mine, theirs = best(results, target, True), best(results, target, False)
        head = (
            f"{name} to {word}: {value:.2f} times as fast as {theirs[0].code} ({theirs[0].setting}); wanted {wanted:g}"
        )
        if mine is None:
            yield f"{head}: no setting of ours reaches it"
            continue
        (my_entry, my), (_, their) = mine, theirs
        affordable = theirs[1].cost / wanted / my.steps
        yield (
            f"{head}: {my_entry.setting} takes {my.steps:.0f} steps per s of {_step(my)} us, "
            f"the other {their.steps:.0f} of {_step(their)}; with this number of steps the target needs "
            f"{_number(1e6 * affordable)} us per step"
        )


def as_data(problem, results):
    """All measurements of a problem, for a JSON file."""

    def rung_data(rung):
        failed = rung.error == math.inf
        return {
            "level": rung.level,
            "steps": rung.steps,
            "cost": rung.cost,
            "times": rung.times,
            "attitude_error": None if failed else rung.attitude_error,
            "gap": None if failed else rung.gap,
        }

    def entry_data(entry, rungs, costs):
        return {
            "code": entry.code,
            "setting": entry.setting,
            "counted": entry.counted,
            "rungs": [rung_data(rung) for rung in rungs],
            "to_target": {
                word: cost and {"cost": cost.cost, "steps": cost.steps, "gap": cost.gap}
                for word, cost in zip(WORDS, costs.values())
            },
        }

    return {
        "entries": [entry_data(*result) for result in results],
        "ratio": {word: ratio(results, target) for word, target in zip(WORDS, TARGETS)},
        "wanted": dict(zip(WORDS, problem.wanted)),
    }
