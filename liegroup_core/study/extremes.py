# SPDX-License-Identifier: Apache-2.0
"""The map of extremes: every method on every axis, each cell judged, in parallel.

    from liegroup_core.study.extremes import survey
    for done, cells in survey(): ...

See extremes_axes.py for what is driven to its limit, extremes_cell.py for how a cell is judged.
"""
from functools import partial

from ..errors import SceneError, SimulationError
from ..integrators import misfit
from ..integrators.methods import METHODS
from ..simulation import make_layout
from . import extremes_problems as problems
from .extremes_axes import _STEPS, AXES, Axis, _powers
from .extremes_cell import REFUSED, SILENT, UNJUDGED, VERDICTS, run_cell
from .tasks import run


def axes_of(scene=None, horizon=8.0, long=False):
    """The axes of the map; with the name of a scene, those that any scene has: step and speed."""
    if scene is None:
        return tuple(axis for axis in AXES if long or not axis.long)
    steps = tuple(step for step in _STEPS if step <= horizon)
    return (Axis("step", f"step, {horizon:g} s", "s", steps,
                 partial(problems.of_scene_step, scene, horizon)),
            Axis("speed", f"velocities at the start at 1 ms, {horizon:g} s", "times",
                 _powers(-6, 5), partial(problems.of_scene_speed, scene, horizon)))


def survey(axes, quick=False, methods=tuple(METHODS), scheduler=None, workers=None):
    """Yields (number of columns, cells of a column that is done); a cell is a dict for JSON.

    quick : only the values that tests take
    A column is one value of one axis: its true motion is made once, and all methods are run.
    """
    columns = [(axis, value, methods) for axis in axes
               for value in (axis.quick if quick else axis.values)]
    for _, cells in run(column, columns, scheduler, workers):
        yield len(columns), cells


def column(item):
    """The cells of a value of an axis: item is (Axis, value, names of methods)."""
    axis, value, methods = item
    natural = None
    if axis.alike is not None and value != axis.alike:
        natural = {cell["method"]: cell["error"] for cell in _cells(axis, axis.alike, methods)}
    return _cells(axis, value, methods, natural)


def _cells(axis, value, methods, natural=None):
    problem = axis.problem(value)
    try:
        layout = make_layout(problem.scene)
    except SceneError as error:
        return [{"axis": axis.name, "value": value, "method": method, "verdict": REFUSED,
                 "says": [str(error)]} for method in methods]
    truth, unknown = None, ""
    try:
        truth = problem.motion(problem.samples() * problem.step)
    except (SimulationError, ValueError) as error:
        unknown = str(error)
    found = []
    for method in methods:
        where = {"axis": axis.name, "value": value}
        if misfit(method, layout):
            continue                        # it is not for such scenes: nothing to judge
        if truth is None:
            found.append(where | {"method": method, "verdict": UNJUDGED, "says": [unknown]})
            continue
        expected = None if natural is None else natural[method]
        found.append(where | run_cell(problem, truth, method, expected))
    return found


def counts(cells):
    """{verdict: number of cells}."""
    return {verdict: sum(cell["verdict"] == verdict for cell in cells) for verdict in VERDICTS}


def silent(cells):
    """The cells that must not be."""
    return [cell for cell in cells if cell["verdict"] == SILENT]


__all__ = ["AXES", "REFUSED", "VERDICTS", "axes_of", "column", "counts", "silent", "survey"]
