# SPDX-License-Identifier: Apache-2.0
"""The map of extremes: every method on every axis, each cell judged, in parallel.

    from liegroup_core.study.extremes import survey
    for count, axis, cells in survey(AXES): ...

See extremes_axes.py for what is driven to its limit, extremes_cell.py for how a cell is judged.
"""
from collections import Counter
from functools import partial

from ..errors import SceneError, SimulationError
from ..integrators import misfit
from ..integrators.methods import METHODS
from ..simulation import make_layout
from . import extremes_problems as problems
from .extremes_axes import _STEPS, AXES, Axis, _powers
from .extremes_cell import REFUSED, SILENT, UNJUDGED, VERDICTS, judge_alike, run_cell
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
    """Yields (number of columns, Axis, cells) as columns are done; a cell is a dict for JSON.

    quick : only the values that tests take
    A column is one value of one axis: its true motion is made once, and all methods are run. Those
    of an axis along which only the scale changes come together, as they are judged together.
    """
    columns = [(axis, value, methods) for axis in axes
               for value in (axis.quick if quick else axis.values)]
    waiting = {axis.name: [] for axis in axes}
    left = Counter(axis.name for axis, _, _ in columns)
    for k, cells in run(column, columns, scheduler, workers):
        axis = columns[k][0]
        waiting[axis.name] += cells
        left[axis.name] -= 1
        if axis.alike is None or not left[axis.name]:
            cells, waiting[axis.name] = waiting[axis.name], []
            if axis.alike is not None:
                judge_alike(cells, axis.alike)
            yield len(columns), axis, cells
        else:
            yield len(columns), axis, []


def column(item):
    """The cells of a value of an axis: item is (Axis, value, names of methods)."""
    axis, value, methods = item
    where = {"axis": axis.name, "value": value}
    problem = axis.problem(value)
    try:
        layout = make_layout(problem.scene)
    except SceneError as error:
        return [where | {"method": method, "verdict": REFUSED, "says": [str(error)]}
                for method in methods]
    # What a method is not for is not judged.
    methods = [method for method in methods if not misfit(method, layout)]
    try:
        truth = problem.motion(problem.samples() * problem.step)
    except (SimulationError, ValueError) as error:
        return [where | {"method": method, "verdict": UNJUDGED, "says": [str(error)]}
                for method in methods]
    return [where | run_cell(problem, truth, method) for method in methods]


def counts(cells):
    """{verdict: number of cells}."""
    return {verdict: sum(cell["verdict"] == verdict for cell in cells) for verdict in VERDICTS}


def silent(cells):
    """The cells that must not be."""
    return [cell for cell in cells if cell["verdict"] == SILENT]


__all__ = ["AXES", "VERDICTS", "axes_of", "column", "counts", "silent", "survey"]
