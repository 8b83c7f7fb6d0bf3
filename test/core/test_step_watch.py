# SPDX-License-Identifier: Apache-2.0
"""A step that is too large for its motion is not silent, and one that is not is left alone."""
import logging
import re
import subprocess
import sys

import pytest

from liegroup_core import Simulation, load_scene
from liegroup_core.integrators.step_watch import StepWatch
from liegroup_core.study import extremes_problems as problems
from liegroup_core.wrenches import NEVER

PLENTY = {"free_body": 4000, "heavy_top": 4000, "double_pendulum": 2000, "slider_crank": 1000,
          "bricard": 1000, "lagrangian_top": 2000, "n_four_bar": 1000, "ball_chain": 300}


def blind(monkeypatch):
    monkeypatch.setattr(StepWatch, "begins", lambda *_: False)
    monkeypatch.setattr(StepWatch, "next_look", lambda *_: NEVER)


def run(scene, steps, every=None, **settings):
    simulation = Simulation(scene, **settings)
    for _ in range(steps // (every or steps)):
        simulation.advance(every or steps)
    return simulation


@pytest.mark.parametrize("method", ["stoermer_verlet", "coadjoint_rkmk2", "rkmk2"])
def test_a_rod_that_slowly_goes_wrong(method, caplog):
    """A rod of ratio 100 at 0.2 s: stable at the start, and off by more than 5 % after 20 s."""
    problem = problems.inertia_rod(100.0, step=0.2)
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


def test_tolerances_that_are_too_large():
    """With error control two halves of a step tell nothing: tolerances do. 16 s in two steps."""
    problem = problems.step_bars(8.0)
    loose = run(problem.scene, 2, method="rkmk54", step=8.0)
    assert "take smaller rtol and atol" in loose.doubt
    free = problems.step_free(8.0)
    assert run(free.scene, 2, method="rkmk54", step=8.0).doubt is None


def test_joints_that_open_within_a_few_steps():
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


@pytest.mark.parametrize("name", PLENTY)
def test_scenes_at_their_default_step_are_left_alone(name):
    assert run(load_scene(name), PLENTY[name]).doubt is None


def test_a_body_at_rest_is_left_alone():
    """Rounding is all that moves it: it is not a motion that could be wrong."""
    scene = problems.redundant(1).scene
    hanging = scene.model_copy(update={"gravity": (9.81, 0.0, 0.0)})
    assert run(hanging, 4000, step=0.05).doubt is None


def test_what_a_push_gives_is_no_error():
    """Between two looks: the energy is another one afterwards, by 40 % of the kinetic one."""
    simulation = Simulation(load_scene("free_body"), step=1e-3)
    before = simulation.energy()
    simulation.apply_wrench("body", [0.0, 0.0, 40.0, 0.0, 0.0, 0.0], start=0.6, duration=0.2)
    simulation.advance(4000)
    assert simulation.energy() > 1.4 * before and simulation.doubt is None
    simulation.reset()
    assert simulation._step_watch._keeps_energy


@pytest.mark.parametrize("settings", [
    {"method": "rkmk4"}, {"method": "rkmk4", "space": "space"}, {"method": "rkmk54"},
    {"method": "rkmk4", "stabilisation": "projection"}, {"method": "generalized_alpha"},
    {"method": "constrained_rattle"}], ids=str)
def test_it_changes_nothing(settings, monkeypatch):
    """To the bit, with all that lasts between steps; and whichever way the steps are asked for."""
    scene = load_scene("slider_crank")
    looked = run(scene, 100, step=2e-3, **settings)
    pieces = run(scene, 100, 10, step=2e-3, **settings)
    blind(monkeypatch)
    alone = run(scene, 100, step=2e-3, **settings)
    for other in (pieces, looked):
        assert [a.tobytes() for a in other.state()] == [a.tobytes() for a in alone.state()]
        assert other.substeps == alone.substeps
    assert looked.doubt == pieces.doubt
    assert looked._work.report.tobytes() == alone._work.report.tobytes()


def test_it_changes_nothing_of_the_rotation_methods(monkeypatch):
    problem = problems.step_top(5e-3)
    for method in ("stoermer_verlet", "coadjoint_rkmk4", "rattle", "lie_midpoint"):
        looked = run(problem.scene, 100, method=method, step=1e-3)
        with monkeypatch.context() as patch:
            blind(patch)
            alone = run(problem.scene, 100, method=method, step=1e-3)
        assert [a.tobytes() for a in looked.state()] == [a.tobytes() for a in alone.state()]


def test_nothing_is_compiled_on_the_way():
    """By looks at steps, at joints, or for messages: a run in real time would stop for it."""
    code = """if True:
        import gc
        from liegroup_core import Simulation, load_scene
        from liegroup_core._compile import Kernel, compiled
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


def test_a_small_component_that_grows():
    """Next to a separatrix: errors of a wobble of 1e-8 decide when the body flips over."""
    problem = problems.racket(1e-8, step=0.5)
    for method, wrong in (("rkmk2", True), ("simo_wong", True), ("rkmk4", False)):
        doubt = run(problem.scene, problem.steps, method=method, step=problem.step).doubt
        assert ("added up" in doubt) if wrong else doubt is None
