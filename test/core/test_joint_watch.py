# SPDX-License-Identifier: Apache-2.0
"""Constraint violations are reported."""

import logging

import numpy as np
import pytest

from liegroup_core import Simulation, SimulationError, load_scene
from liegroup_core.monitor.joint_watch import EVERY, mechanism_size


def run(name, steps, every=100, **settings):
    simulation = Simulation(load_scene(name), **settings)
    for _ in range(steps // every):
        simulation.advance(every)
    return simulation


def test_drift_after_a_singular_pose_is_reported(caplog):
    """The N-four-bar's third flat pose, at 2.6 s: no step meets it exactly, all come close.

    At 3 s residuals still look small, while the energy has jumped by 2 mJ; at 3.2 s the bars
    fly apart. Projection keeps energy and joints.
    """
    with caplog.at_level(logging.WARNING, "liegroup_core"):
        wrong = run("n_four_bar", 3000)
    assert wrong.singular_solves == 0 and wrong.sample().constraint_residual < 1e-5
    assert "opened suddenly" in wrong.doubt and "stabilisation projection" in wrong.doubt
    assert wrong.doubt in caplog.messages and "\n" not in wrong.doubt
    right = run("n_four_bar", 3000, stabilisation="projection")
    assert right.doubt is None
    start = Simulation(load_scene("n_four_bar")).energy()
    assert abs(wrong.energy() - start) > 1e-3 and abs(right.energy() - start) < 1e-6
    with pytest.raises(SimulationError):
        wrong.advance(300)
    right.advance(300)
    wrong.reset()
    assert wrong.doubt is None
    wrong.advance(3000)
    assert "opened suddenly" in wrong.doubt


def test_large_constraint_drift_is_reported():
    """Four-bar at 20 to 50 rad/s, step 2 ms: drift soon exceeds 1e-3 of the characteristic length."""
    simulation = run("four_bar", 2000, step=2e-3)
    assert "open by" in simulation.doubt
    size = mechanism_size(simulation.layout.model)
    assert size == pytest.approx(0.5)
    assert simulation.sample().constraint_residual > 1e-3 * size


@pytest.mark.parametrize(
    "name",
    ["heavy_top", "free_body", "slider_crank", "bricard", "double_pendulum", "lagrangian_top"],
)
def test_accurate_runs_are_not_reported(name):
    assert run(name, 3000).doubt is None


def test_the_report_does_not_depend_on_the_advance_calls():
    whole, pieces = run("n_four_bar", 3000, every=3000), run("n_four_bar", 3000, every=30)
    assert whole.doubt == pieces.doubt is not None
    for mine, theirs in zip(whole.state(), pieces.state()):
        assert mine.tobytes() == theirs.tobytes()


def test_drift_under_a_new_wrench_is_not_reported():
    """At rest there is no drift; under an external wrench there is, without an earlier rate to compare."""
    simulation = Simulation(
        load_scene("double_pendulum").model_copy(update={"gravity": (0, 0, 0)}), step=5e-3
    )
    simulation.advance(2 * EVERY)
    assert simulation.sample().constraint_residual < 1e-15
    simulation.apply_wrench("lower", (0, 2.0, 0, 0, 0, 0), duration=1.0)
    simulation.advance(EVERY)
    assert simulation.sample().constraint_residual > 1e-9
    assert simulation.doubt is None


def test_characteristic_length_of_the_double_pendulum():
    """Rods 1.2 m long with joints at their ends: 0.6 m. A free body: its radii of gyration."""
    model = Simulation(load_scene("double_pendulum")).layout.model
    assert mechanism_size(model) == pytest.approx(0.6)
    body = Simulation(load_scene("free_body")).layout.model
    assert mechanism_size(body) == pytest.approx(np.sqrt(0.9144 + 1.098 + 1.66))
