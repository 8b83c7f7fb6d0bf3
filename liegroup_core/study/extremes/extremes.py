# SPDX-License-Identifier: Apache-2.0
"""Robustness map: every method on every axis, run in parallel.

    from liegroup_core.study.extremes.extremes import survey
    for count, axis, cells, complete in survey(AXES): ...

axes.py defines the parameters that are driven to their limits, cell.py the verdicts.
"""

from collections import Counter
from functools import partial
from pathlib import Path

from liegroup_core.errors import SceneError, SimulationError
from liegroup_core.layout import make_layout
from liegroup_core.methods.families import misfit
from liegroup_core.methods.table import METHODS
from liegroup_core.scene.load import load_scene
from liegroup_core.study.tasks import run
from liegroup_core.study.trade.cache import Folder, key_of

from . import problems as problems
from .axes import _STEPS, AXES, Axis, _powers
from .cell import DEFAULT, REFUSED, SILENT, UNJUDGED, VERDICTS, judge_alike, run_cell

# Version of problems and verdicts, because the key of the cache does not depend on these sources.
FORMAT = 3
# The default accuracy counts as a method.
METHOD_NAMES = (DEFAULT, *METHODS)


def axes_of(scene=None, horizon=8.0, long=False):
    """Axes of the map. For a scene of the user these are step and speed.

    A scene that is initially at rest has no speed axis.
    """
    if scene is None:
        return tuple(axis for axis in AXES if long or not axis.long)
    steps = tuple(step for step in _STEPS if step <= horizon)
    axes = (
        Axis(
            "step",
            f"step, {horizon:g} s",
            "s",
            steps,
            partial(problems.of_scene_step, scene, horizon),
            quick=steps[::3],
        ),
        Axis(
            "speed",
            f"initial velocities at 1 ms, {horizon:g} s",
            "times",
            _powers(-6, 5),
            partial(problems.of_scene_speed, scene, horizon),
            quick=(1e-3, 1.0, 1e3),
        ),
    )
    return axes if problems.moves(load_scene(scene)) else axes[:1]


class Kept:
    """Cache of finished columns. Each is written immediately, so that an interrupted map can be continued.

    folder : Folder; None: no cache
    """

    FILE = "cells.jsonl"

    def __init__(self, folder=None):
        self._folder, self._known = folder, {}
        for line in folder.lines(self.FILE) if folder else ():
            known = self._known.setdefault((line["axis"], line["value"]), {})
            known |= dict.fromkeys(line["methods"])
            known |= {cell["method"]: cell for cell in line["cells"]}

    @classmethod
    def of(cls, scene=None, horizon=None, root=None):
        """Cache of a Scene over a horizon, or of the axes of the map.

        root : folder; None: in the cache of the user
        """
        text = "" if scene is None else f"{scene.text} {horizon}"
        return cls(Folder(Path("extremes", key_of(f"extremes {FORMAT} {text}")), root))

    def missing(self, axis, value, methods):
        """Methods without a cached result at a value."""
        return tuple(name for name in methods if name not in self._known.get((axis, value), ()))

    def cells(self, axis, value, methods):
        """Cached cells of the methods that suit the problem."""
        known = self._known.get((axis, value), {})
        return [dict(known[name]) for name in methods if known.get(name)]

    def keep(self, axis, value, methods, cells):
        """Write the results of a column."""
        line = {"axis": axis, "value": value, "methods": list(methods), "cells": cells}
        if self._folder is not None:
            self._folder.keep_line(self.FILE, line)


def survey(axes, quick=False, methods=METHOD_NAMES, scheduler=None, workers=None, kept=None):
    """Run the map; yields (number of columns, Axis, cells, whether the axis is complete).

    quick : only the values for tests
    kept  : Kept, to which results are added; columns in it are not run again
    A cell is a dict of JSON types. A column is one value of one axis; its reference solution is computed
    once for all methods. On long axes, each method is a separate column. Columns of an axis along which
    only the scale changes are yielded together, because their verdicts depend on each other.
    """
    kept = kept or Kept()
    columns = [
        (axis, value, group)
        for axis in axes
        for value in (axis.quick if quick else axis.values)
        for group in ([(name,) for name in methods] if axis.long else [tuple(methods)])
    ]
    waiting = {axis.name: [] for axis in axes}
    left = Counter(axis.name for axis, _, _ in columns)

    def done(k, cells):
        axis = columns[k][0]
        waiting[axis.name] += cells
        left[axis.name] -= 1
        complete = not left[axis.name]
        cells = []
        if axis.alike is None or complete:
            cells, waiting[axis.name] = waiting[axis.name], []
            if axis.alike is not None:
                judge_alike(cells, axis.alike)
        return len(columns), axis, cells, complete

    def before(k):
        axis, value, group = columns[k]
        return kept.cells(axis.name, value, group)

    work = []
    for k, (axis, value, group) in enumerate(columns):
        missing = kept.missing(axis.name, value, group)
        if missing:
            work.append((k, (axis, value, missing)))
        else:
            yield done(k, before(k))
    for place, cells in run(column, [item for _, item in work], scheduler, workers):
        k, (axis, value, missing) = work[place]
        kept.keep(axis.name, value, missing, cells)
        yield done(k, before(k) + cells)


def column(item):
    """Cells of a column; item : (Axis, value, names of methods)."""
    axis, value, methods = item
    where = {"axis": axis.name, "value": value}
    problem = axis.problem(value)
    try:
        layout = make_layout(problem.scene)
    except SceneError as error:
        refused = [where | {"method": method, "verdict": REFUSED, "says": [str(error)]} for method in methods]
        if axis.alike is None:
            return refused
        layout = make_layout(axis.problem(axis.alike).scene)  # the same joints
        return [cell for cell in refused if _suits(cell["method"], layout)]
    # Methods that do not suit the problem are skipped.
    methods = [method for method in methods if _suits(method, layout)]
    try:
        truth = problem.motion(problem.samples() * problem.step)
    except (SimulationError, ValueError) as error:
        return [where | {"method": method, "verdict": UNJUDGED, "says": [str(error)]} for method in methods]
    return [where | run_cell(problem, truth, method) for method in methods]


def _suits(method, layout):
    return method == DEFAULT or not misfit(method, layout)


def counts(cells):
    """{verdict: number of cells}."""
    return {verdict: sum(cell["verdict"] == verdict for cell in cells) for verdict in VERDICTS}


def silent(cells):
    """Cells with an undetected error."""
    return [cell for cell in cells if cell["verdict"] == SILENT]


__all__ = ["AXES", "VERDICTS", "Kept", "axes_of", "column", "counts", "silent", "survey"]
