# SPDX-License-Identifier: Apache-2.0
"""The step check warns of steps that are too large for the motion, and of no others."""

import json
import logging
import re
import subprocess
import sys
from pathlib import Path

import pytest

from liegroup_core import Simulation, load_scene
from liegroup_core.monitor.step_watch import StepWatch
from liegroup_core.scene.description import SpringDamper
from liegroup_core.study.extremes import problems as problems

ROOT = Path(__file__).resolve().parents[2]
SCENES = ROOT / "config" / "scenes"
TRADES = json.loads((ROOT / "docs" / "which_method.json").read_text())["scenes"]
PLENTY = {
    "free_body": 4000,
    "heavy_top": 4000,
    "double_pendulum": 2000,
    "slider_crank": 1000,
    "bricard": 1000,
    "lagrangian_top": 2000,
    "n_four_bar": 1000,
    "ball_chain": 300,
    "four_bar": 2000,
    "hinge_chain": 300,
}
# The step that is taken where none is given is too large for these.
FASTER = {"andrews_squeezer", "flyball_governor"}


def run(scene, steps, every=None, **settings):
    simulation = Simulation(scene, **settings)
    for _ in range(steps // (every or steps)):
        simulation.advance(every or steps)
    return simulation


@pytest.mark.parametrize(
    "method, step", [("stoermer_verlet", 0.1), ("coadjoint_rkmk2", 0.1), ("rkmk2", 0.2)]
)
def test_a_slowly_growing_error_of_an_unstable_rod_is_reported(method, step, caplog):
    """Rod of inertia ratio 100: stable at the start, error above 5 % after 20 s."""
    problem = problems.inertia_rod(100.0, step=step)
    with caplog.at_level(logging.WARNING, "liegroup_core"):
        simulation = run(problem.scene, problem.steps, method=method, step=problem.step)
    assert "errors may have added up" in simulation.doubt
    assert simulation.doubt in caplog.messages and "\n" not in simulation.doubt
    assert sum("added up" in text for text in caplog.messages) == 1
    # The step that it names is such that nothing is said any more.
    step = float(re.search("steps of ([^ ]+) s", simulation.doubt)[1])
    assert step < problem.step
    assert run(problem.scene, round(20.0 / step), method=method, step=step).doubt is None
    simulation.reset()
    assert simulation.doubt is None
    simulation.advance(problem.steps)
    assert simulation.doubt
    unwatched = run(problem.scene, problem.steps, method=method, step=problem.step, watch=False)
    unwatched.reset()
    unwatched.advance(problem.steps)
    assert unwatched.doubt is None


def test_too_loose_tolerances_are_reported():
    """With error control, halving the step shows nothing; tighter tolerances do. 16 s, two steps."""
    problem = problems.step_bars(8.0)
    loose = run(problem.scene, 2, method="rkmk54", step=8.0)
    assert "take smaller rtol and atol" in loose.doubt
    free = problems.step_free(8.0)
    assert run(free.scene, 2, method="rkmk54", step=8.0).doubt is None


def test_constraint_drift_within_a_few_steps_is_reported():
    problem = problems.step_bars(0.05)
    said = []
    handler = logging.Handler()
    handler.emit = lambda record: said.append(record.getMessage())
    logger = logging.getLogger("liegroup_core")
    logger.addHandler(handler)
    try:
        run(problem.scene, 4, method="rkmk4", step=0.05)
    finally:
        logger.removeHandler(handler)
    assert any("is open by" in text for text in said)


def test_every_example_scene_is_covered():
    assert {*PLENTY, *FASTER} == {path.stem for path in SCENES.glob("*.yaml")}


@pytest.mark.parametrize("name", PLENTY)
def test_example_scenes_at_their_default_step_give_no_warning(name):
    assert run(load_scene(name), PLENTY[name]).doubt is None


@pytest.mark.parametrize("part", TRADES, ids=lambda part: part["scene"])
def test_configurations_chosen_by_the_trade_give_no_warning(part):
    """The cheapest for 1e-3, 1e-6 and 1e-9 of every scene, over the horizon of the trade."""
    for choice in part["cheapest"]:
        cell = part["cells"][choice["cell"]]
        settings = {key: cell[key] for key in ("method", "step", "group", "stabilisation")}
        steps = round(part["horizon"] / cell["step"])
        assert run(load_scene(part["scene"]), steps, **settings, **cell["options"]).doubt is None


def test_a_body_at_rest_gives_no_warning():
    """Its only motion is round-off, which has no meaningful relative error."""
    scene = problems.redundant(1).scene
    hanging = scene.model_copy(update={"gravity": (9.81, 0.0, 0.0)})
    assert run(hanging, 4000, step=0.05).doubt is None


def test_energy_added_by_a_wrench_is_not_an_error():
    """Between two checks the wrench changes the energy by 40 % of the kinetic energy."""
    simulation = Simulation(load_scene("free_body"), step=1e-3)
    before = simulation.energy()
    simulation.apply_wrench("body", [0.0, 0.0, 40.0, 0.0, 0.0, 0.0], start=0.6, duration=0.2)
    simulation.advance(4000)
    assert simulation.energy() > 1.4 * before and simulation.doubt is None
    simulation.reset()
    assert simulation._step_watch._keeps_energy


@pytest.mark.parametrize(
    "settings",
    [
        {"method": "rkmk4"},
        {"method": "rkmk4", "space": "space"},
        {"method": "rkmk54"},
        {"method": "rkmk4", "stabilisation": "projection"},
        {"method": "generalized_alpha"},
        {"method": "constrained_rattle"},
    ],
    ids=str,
)
def test_the_step_check_does_not_change_the_run(settings):
    """Bit-identical state and method memory, however the steps are split."""
    scene = load_scene("slider_crank")
    looked = run(scene, 100, step=2e-3, **settings)
    pieces = run(scene, 100, 10, step=2e-3, **settings)
    alone = run(scene, 100, step=2e-3, watch=False, **settings)
    for other in (pieces, looked):
        assert [a.tobytes() for a in other.state()] == [a.tobytes() for a in alone.state()]
        assert other.substeps == alone.substeps
    assert looked.doubt == pieces.doubt and alone.doubt is None
    assert looked._work.report.tobytes() == alone._work.report.tobytes()


def test_the_step_check_does_not_change_rotation_methods():
    problem = problems.step_top(5e-3)
    for method in ("stoermer_verlet", "coadjoint_rkmk4", "rattle", "lie_midpoint"):
        looked = run(problem.scene, 100, method=method, step=1e-3)
        alone = run(problem.scene, 100, method=method, step=1e-3, watch=False)
        assert [a.tobytes() for a in looked.state()] == [a.tobytes() for a in alone.state()]


def test_nothing_is_compiled_during_a_run():
    """Neither step and joint checks nor messages compile anything: it would stop real time."""
    code = """if True:
        import gc
        from liegroup_core import Simulation, load_scene
        from liegroup_core.compiling import Kernel, compiled
        kernels = [each for each in gc.get_objects() if isinstance(each, Kernel)]
        for scene in ("heavy_top", "four_bar"):
            simulation = Simulation(load_scene(scene))
            before = sum(len(each.dispatcher.overloads) for each in kernels)
            simulation.advance(3000)
            simulation.sample().rows
            print(sum(len(each.dispatcher.overloads) for each in kernels) - before)
        print(bool(kernels) == compiled())
        """
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert said.stdout.split() == ["0", "0", "True"]


def test_an_error_of_a_small_growing_component_is_reported():
    """Near a separatrix, errors in a 1e-8 component determine when the body flips."""
    problem = problems.racket(1e-8, step=0.5)
    for method, wrong in (("rkmk2", True), ("simo_wong", True), ("rkmk4", False)):
        doubt = run(problem.scene, problem.steps, method=method, step=problem.step).doubt
        assert ("added up" in doubt) if wrong else doubt is None


@pytest.mark.parametrize(
    "method, stiffness",
    [("rkmk8", 1e6), ("coadjoint_rkmk8", 1e6), ("rkmk8", 1.5e6), ("coadjoint_rkmk8", 1.5e6)],
)
def test_a_spring_passing_zero_length_is_reported(method, stiffness, monkeypatch):
    """Damped spring passing zero length within 1 of 50 steps: errors of 7 to 48 % afterwards."""
    problem = problems.stiff_damped(stiffness)
    settings = {"method": method, "step": problem.step}
    assert "ends of a spring passed" in run(problem.scene, problem.steps, **settings).doubt
    if stiffness == 1e6:  # no other look comes across it
        monkeypatch.setattr(StepWatch, "waits", lambda *_: False)
        assert run(problem.scene, problem.steps, **settings).doubt is None


def test_a_linear_spring_through_zero_length_needs_no_check():
    """Without damper and rest length the force is linear in the position, also through zero."""
    stiff = Simulation(problems.stiff(1e6).scene, "rkmk8", 1e-3)
    assert not stiff._step_watch.waits(0)
    assert Simulation(problems.stiff_damped(1e6).scene, "rkmk8", 1e-3)._step_watch.waits(0)


@pytest.mark.parametrize(
    "method, space",
    [
        ("rkmk8", "auto"),
        ("rkmk8", "space"),
        ("coadjoint_rkmk4", None),
        ("lie_midpoint", None),
        ("generalized_alpha", None),
        ("constrained_rattle", None),
    ],
)
def test_the_spring_check_does_not_change_the_run(method, space, monkeypatch):
    """Bit-identical in every family; the check does find a spring that swings through zero."""
    met = []
    meets = StepWatch.met
    monkeypatch.setattr(
        StepWatch, "met", lambda self, steps: met.append(steps) or meets(self, steps)
    )
    spring = SpringDamper(
        name="spring",
        parent="world",
        parent_point=(0.0, 0.0, -1.0),
        child="bob",
        child_point=(0.0, 0.0, 0.0),
        stiffness=40.0,
        damping=0.5,
    )
    scene = problems.angle(0.5).scene
    scene = scene.model_copy(update={"forces": (spring,)})
    if space == "auto":
        hinge = scene.joints[0].model_copy(
            update={
                "type": "revolute",
                **{
                    end: getattr(scene.joints[0], end).model_copy(update={"axis": (0, 1, 0)})
                    for end in ("parent_frame", "child_frame")
                },
            }
        )
        scene = scene.model_copy(update={"joints": (hinge,)})
    settings = {"method": method, "step": 0.01} | ({"space": space} if space else {})
    looked = run(scene, 400, **settings)
    assert (looked.layout.plane is not None) == (space == "auto")
    # A look at some of the steps that are waited for, not at all of them.
    assert 2 < len(met) < 60 and met == sorted(set(met))
    count = len(met)
    alone = run(scene, 400, watch=False, **settings)
    assert [a.tobytes() for a in looked.state()] == [a.tobytes() for a in alone.state()]
    assert len(met) == count


@pytest.mark.parametrize(
    "method, step, offset",
    [
        ("stoermer_verlet", 0.05, 1e-10),
        ("stoermer_verlet", 0.05, 1e-11),
        ("coadjoint_rkmk4", 0.5, 1e-10),
        ("coadjoint_rkmk4", 0.5, 3e-10),
    ],
)
def test_a_return_to_the_intermediate_axis_is_reported(method, step, offset):
    """Momentum is conserved, energy drifts by 1e-5, and the next flip occurs at a wrong time."""
    problem = problems.racket(offset, step)
    doubt = run(problem.scene, problem.steps, method=method, step=step).doubt
    assert "came back to its middle axis" in doubt
    finer = run(problem.scene, 10 * problem.steps, method=method, step=0.1 * step)
    assert finer.doubt is None or "middle" not in finer.doubt
    assert run(problem.scene, problem.steps, method="rkmk8", step=step).doubt is None


@pytest.mark.parametrize("part", [1.01, 1.02])
def test_a_wrongly_sleeping_top_is_reported(part):
    """The tilt grows from 1e-3 to 0.06 rad; its rate stays below 1 % of the spin."""
    problem = problems.sleeping(part)
    for method, wrong in (("rkmk1", True), ("rkmk4", False)):
        doubt = run(problem.scene, problem.steps, method=method, step=problem.step).doubt
        assert ("added up" in doubt) if wrong else doubt is None


def test_a_flip_between_two_checks_is_reported():
    """Errors that grow from check to check are examined before they are large."""
    for method in ("rkmk2", "lie_midpoint"):
        problem = problems.racket(1e-5, 0.5)
        assert run(problem.scene, problem.steps, method=method, step=0.5).doubt
    assert run(problem.scene, problem.steps, method="rkmk8", step=0.5).doubt is None


def test_an_unstable_step_gives_exactly_one_warning(caplog):
    """From the stability check at the start of a rotation method, none from the step check."""
    problem = problems.stiff(1e7)
    with caplog.at_level(logging.WARNING, "liegroup_core"):
        simulation = Simulation(problem.scene, "stoermer_verlet", problem.step)
        simulation.advance(3)
    told = [
        text for text in caplog.messages if "stability limit at the start of the run is" in text
    ]
    assert told == [simulation.doubt]
    assert not any("added up" in text for text in caplog.messages)


def test_the_step_suggested_for_generalized_alpha_follows_its_order():
    """It cannot be measured: after a change of the step size its velocities first oscillate."""
    scene = load_scene("slider_crank")
    simulation = run(scene, 100, method="generalized_alpha", step=5e-3)
    step = float(re.search("steps of ([^ ]+) s", simulation.doubt)[1])
    assert 1e-4 < step < 5e-3
    assert run(scene, round(0.5 / step), method="generalized_alpha", step=step).doubt is None
