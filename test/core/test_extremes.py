# SPDX-License-Identifier: Apache-2.0
"""The robustness map: its verdicts detect planted errors, and no error is undetected."""

from dataclasses import replace

import numpy as np
import pytest
from volume import VERIFY, some

from liegroup_core import Simulation, load_scene
from liegroup_core.scene.description import Frame
from liegroup_core.study.extremes import cell as extremes_cell
from liegroup_core.study.extremes import extremes
from liegroup_core.study.extremes import problems as problems
from liegroup_core.study.extremes.axes import AXES
from liegroup_core.study.extremes.cell import (
    ACCURATE,
    FLAGGED,
    REFUSED,
    SILENT,
    STOPPED,
    UNJUDGED,
    judge_alike,
    run_cell,
)
from liegroup_core.study.extremes.extremes import axes_of, column, counts, silent, survey

METHODS = ("rkmk2", "rkmk4", "rkmk54", "rkmk8", "generalized_alpha", "stoermer_verlet", "rattle", "constrained_rattle")


def verdict(problem, method, make=Simulation, **more):
    truth = problem.motion(problem.samples() * problem.step)._replace(**more)
    return run_cell(problem, truth, method, make)


def lighter(scene, method, step, **settings):
    """Mutant: 4/5 of gravity, for its companion, too."""
    gravity = tuple(0.8 * g for g in scene.gravity)
    return Simulation(scene.model_copy(update={"gravity": gravity}), method, step, **settings)


@pytest.mark.parametrize("amplitude", [1e-250, 1e-2])
def test_plausible_wrong_answers_get_the_verdict_silent(amplitude):
    problem = problems.angle(amplitude)
    assert verdict(problem, "rkmk4")["verdict"] == ACCURATE
    found = verdict(problem, "rkmk4", lighter)
    assert found["verdict"] == SILENT and found["error"] > 0.2 and not found["says"]


@pytest.mark.parametrize("method", ["constrained_rattle", "constrained_rattle4", "constrained_rattle8"])
def test_angles_whose_squares_underflow(method):
    """Squares of angles around 1e-160 rad are subnormal or zero."""
    errors = []
    for amplitude in (1e-4, 1e-155, 1e-158, 1e-160, 1e-161, 1e-162, 1e-165):
        problem = problems.angle(amplitude, part=1.0)
        truth = problem.motion(problem.samples() * problem.step)
        errors.append(run_cell(problem, truth, method)["error"])
    # The problem is linear, so relative errors agree up to round-off, except for the nonlinearity
    # of sin at the largest amplitude: 1e-9.
    assert errors == pytest.approx([errors[0]] * len(errors), rel=1e-6)


@pytest.mark.turn(3)
def test_flagged_refused_stopped_and_unjudged_verdicts():
    assert verdict(problems.step_free(0.25), "rkmk8")["verdict"] == ACCURATE
    assert verdict(problems.step_free(1.0), "rkmk2")["verdict"] == FLAGGED
    refused = verdict(problems.step_free(8.0), "rkmk4")
    assert refused["verdict"] == REFUSED and "almost 2 pi" in refused["says"][0]
    misfit = verdict(problems.mass_chain(1.0), "rattle")
    assert misfit["verdict"] == REFUSED and "cannot integrate this scene" in misfit["says"][0]
    stopped = verdict(problems.step_top(0.2), "rkmk1")
    assert stopped["verdict"] == STOPPED and "smaller step" in stopped["says"][-1]
    assert verdict(problems.step_free(0.25), "rkmk8", uncertainty=0.1)["verdict"] == UNJUDGED


def test_an_error_far_above_that_of_scale_one_is_wrong():
    """1 % is correct if nothing better is expected, and wrong if the scale 1 has 1e-6."""
    cells = [
        {
            "method": "rkmk4",
            "value": value,
            "error": error,
            "estimate": 0.0,
            "uncertainty": 0.0,
            "says": [],
            "verdict": ACCURATE,
        }
        for value, error in ((1.0, 1e-6), (10.0, 1e-5), (100.0, 1e-2))
    ]
    judge_alike(cells, 1.0)
    assert [cell["verdict"] for cell in cells] == [ACCURATE, ACCURATE, SILENT]


def test_errors_are_relative_to_the_size_of_the_motion():
    """Angles of 1e-300 are distinguished, and so are rotations of nearly pi."""
    about = problems.motions.about
    R = about(1, np.array([0.0, 1e-300]))[:, None]
    none = np.zeros((2, 1, 3))
    truth = problems.motions.ReferenceMotion(R, none, 0.0)
    assert extremes_cell.sizes(truth, 2.0) == (1e-300, 2e-300)
    angle, _ = extremes_cell.apart(about(2, np.array([3.0])), none[0], about(2, np.array([0.5])), none[0])
    assert angle == pytest.approx(2.5, rel=1e-15)


def test_reference_solutions_agree_with_the_independent_integration():
    """Closed forms and one-angle equations against DOP853 in maximal coordinates."""
    for problem in (
        problems.step_bars(5e-3),
        problems.mass_chain(3.0),
        problems.angle(1.0),
        problems.stiff(1e3),
        problems.step_top(0.05),
        problems.inertia_rod(10.0),
    ):
        times = problem.samples()[:4] * problem.step
        mine = problem.motion(times)
        theirs = problems.motions.integrated(problem.scene, problem.length)(times)
        angle, way = extremes_cell.apart(mine.rotation, mine.position, theirs.rotation, theirs.position)
        assert max(angle, way) < 1e-8


@pytest.mark.slow
@pytest.mark.turn(6)
def test_the_quick_map_has_no_undetected_error():
    cells = []
    for columns, _, found, _ in survey(axes_of(), quick=True, methods=some(METHODS, 3), workers=1):
        cells += found
    assert silent(cells) == []
    found = counts(cells)
    assert columns == sum(len(axis.quick) for axis in AXES)
    # Every verdict must occur; otherwise the map demonstrates nothing.
    assert all(found[name] > 0 for name in (ACCURATE, FLAGGED, REFUSED))
    assert found[STOPPED] > 0 or not VERIFY


@pytest.mark.slow
@pytest.mark.turn(3)
def test_an_interrupted_map_resumes_from_the_cache(tmp_path, monkeypatch):
    """An interrupted map continues with the same cells and the same verdicts."""
    axes = [axis for axis in AXES if axis.name in ("angle", "step_free")]
    methods = ("rkmk4", "rattle")

    def whole(kept, methods):
        cells = [
            cell | {"seconds": 0.0}
            for *_, found, _ in survey(axes, True, methods, workers=1, kept=kept)
            for cell in found
        ]
        return sorted(cells, key=lambda cell: (cell["axis"], cell["value"], cell["method"]))

    alone = whole(None, methods)
    ended = survey(axes, True, methods[:1], workers=1, kept=extremes.Kept.of(root=tmp_path))
    next(ended), next(ended)
    ended.close()
    (file,) = tmp_path.rglob("*.jsonl")
    with open(file, "a", encoding="utf-8") as stream:
        stream.write('\n{"axis": "angle", "val')  # as left by a process killed while writing
    made = []
    monkeypatch.setattr(extremes, "column", lambda item: made.append(item) or column(item))
    assert whole(extremes.Kept.of(root=tmp_path), methods) == alone
    assert sum(len(names) for *_, names in made) == 2 * sum(len(a.quick) for a in axes) - 2
    made.clear()
    assert whole(extremes.Kept.of(root=tmp_path), methods) == alone and made == []
    assert whole(extremes.Kept.of(load_scene("free_body"), 1.0, tmp_path), methods) == alone
    assert made


def test_an_unbuildable_scene_is_refused_by_all_applicable_methods():
    def far(distance):
        """Four-bar with its last joint at the given distance in m."""
        made = problems.length_bars(1.0)
        *joints, last = made.scene.joints
        last = last.model_copy(update={"parent_frame": Frame(position=(distance, 0, 0))})
        return replace(made, scene=made.scene.model_copy(update={"joints": (*joints, last)}))

    axis = replace(next(axis for axis in AXES if axis.name == "length_bars"), problem=far)
    cells = column((axis, 5.0, ("rkmk4", "rattle")))
    assert [(cell["method"], cell["verdict"]) for cell in cells] == [("rkmk4", REFUSED)]
    assert "cannot be assembled" in cells[0]["says"][0]


def test_a_user_scene_is_mapped():
    axes = axes_of("free_body", horizon=1.0)
    assert [axis.name for axis in axes] == ["step", "speed"]
    assert all(step <= 1.0 for step in axes[0].values)
    cells = column((axes[0], 0.5, ("rkmk4", "rkmk8")))
    assert {cell["verdict"] for cell in cells} == {ACCURATE}
