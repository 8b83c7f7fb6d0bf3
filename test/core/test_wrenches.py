# SPDX-License-Identifier: Apache-2.0
"""Applied wrenches: schedule, and momentum after a known impulse."""

import numpy as np
import pytest

from liegroup_core import Simulation, load_scene
from liegroup_core.forces.schedule import NEVER, WrenchSchedule

PUSH = (1.0, 0.0, 0.0, 0.0, 2.0, 0.0)
POSE = np.array([[1.0, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0]])


def totals(schedule, steps):
    history = []
    for step in range(steps):
        schedule.update(step, POSE)
        history.append(schedule.total[0].copy())
    return np.array(history)


def test_a_wrench_acts_only_during_its_steps():
    schedule = WrenchSchedule(1)
    schedule.command("a", 0, PUSH, 2, 5)
    acts = totals(schedule, 8).any(axis=1)
    assert acts.tolist() == [False, False, True, True, True, False, False, False]


def test_a_source_replaces_its_wrench_and_sources_add():
    schedule = WrenchSchedule(1)
    schedule.command("a", 0, PUSH, 0, NEVER)
    schedule.command("b", 0, PUSH, 1, 4)
    schedule.command("a", 0, 3 * np.array(PUSH), 2, NEVER)
    assert totals(schedule, 6)[:, 0].tolist() == [1, 2, 4, 4, 3, 3]


def test_zero_ends_a_wrench_and_clear_ends_a_source():
    schedule = WrenchSchedule(1)
    schedule.command("a", 0, PUSH, 0, NEVER)
    schedule.command("a", 0, np.zeros(6), 2, NEVER)
    schedule.command("b", 0, PUSH, 0, NEVER)
    schedule.command("b", 0, PUSH, 100, NEVER)
    assert totals(schedule, 4)[:, 0].tolist() == [2, 2, 1, 1]
    schedule.clear("b")
    assert schedule.update(4, POSE) == [0]
    assert not schedule.total.any() and schedule.next_change(4) == NEVER


def test_the_later_of_two_commands_for_one_step_applies():
    schedule = WrenchSchedule(1)
    schedule.command("a", 0, PUSH, 1, NEVER)
    schedule.command("a", 0, 5 * np.array(PUSH), 1, NEVER)
    assert totals(schedule, 2)[1, 0] == 5


@pytest.mark.parametrize("group", ["se3", "so3xr3"])
@pytest.mark.parametrize("steps_at_once", [1, 7, 1000])
def test_a_known_wrench_gives_the_closed_form_momentum(group, steps_at_once):
    """Body at rest, torque and force along one principal axis, for 250 steps of 1 ms.

    Then L = tau t and p = f t for ever after: the axis does not turn, so body and world axes agree
    on it. Rounding: 250 additions to sums of at most 2.5e-1 and 7.5e-1, each eps/2 relative, and
    the four stage weights of a step, each once more: below 8 * 250 eps * 0.75 = 4e-13.
    """
    simulation = Simulation(load_scene("free_body"), step=1e-3, group=group)
    pose, twist = simulation.state()
    simulation.set_state(pose, 0.0 * twist)
    simulation.apply_wrench("body", (0, 0, 1.0, 0, 0, 3.0), start=0.1, duration=0.25)
    for _ in range(1000 // steps_at_once):
        simulation.advance(steps_at_once)
    simulation.advance(1000 - simulation.steps)
    momentum = simulation.sample().spatial_momentum
    assert np.abs(momentum - [0, 0, 0.25, 0, 0, 0.75]).max() <= 4e-13
    assert [c.step for c in simulation.drain_applied()] == [100, 350]


def test_a_spinning_body_gains_the_same_linear_momentum():
    """Force along the spin axis: p = f t, and the spin does not change."""
    simulation = Simulation(load_scene("free_body"), step=1e-3)
    pose, _ = simulation.state()
    simulation.set_state(pose, [[0, 0, 20.0, 0, 0, 0]])
    before = simulation.sample().spatial_momentum
    simulation.apply_wrench("body", (0, 0, 0, 0, 0, -4.0), duration=0.5)
    simulation.advance(800)
    change = simulation.sample().spatial_momentum - before
    assert np.abs(change - [0, 0, 0, 0, 0, -2.0]).max() <= 8 * 800 * 2.2e-16 * 33.2


def test_a_force_in_world_axes_keeps_its_direction_on_a_spinning_body():
    """It rotates with the body only within a step: impulse F (sin wh, 1 - cos wh) / w per step.

    RKMK4 turns the momentum, seen from the body, by w h = 0.02 in every step with an error of
    (w h)^5 / 120 of its size, at most 2 N s: over 800 steps 4.3e-8 N s.
    """
    simulation = Simulation(load_scene("free_body"), step=1e-3)
    spin, force, steps = 20.0, 4.0, 500
    simulation.set_state(
        np.array([[1.0, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0]]), [[0, 0, spin, 0, 0, 0]]
    )
    simulation.apply_wrench("body", (0, 0, 0, force, 0, 0), duration=0.5, axes="world")
    simulation.advance(800)
    angle = spin * simulation.step
    expected = steps * force / spin * np.array([np.sin(angle), 1.0 - np.cos(angle), 0.0])
    change = simulation.sample().spatial_momentum[3:]
    assert np.abs(change - expected).max() <= 800 * 2.0 * angle**5 / 120
    # One change for every step, in body axes, and one at the end.
    changes = simulation.drain_applied()
    assert [c.step for c in changes] == [*range(501)] and not any(changes[-1].wrench)
    # 250 steps of 0.02 rad: the body has turned by 5 rad.
    assert np.allclose(
        changes[250].wrench[3:], (4.0 * np.cos(5.0), -4.0 * np.sin(5.0), 0.0), rtol=0.0, atol=1e-9
    )


def test_wrenches_in_world_and_body_axes_of_two_sources_add():
    simulation = Simulation(load_scene("free_body"))
    quarter = [[0.0, -1, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0]]  # a quarter turn about z
    simulation.set_state(np.array(quarter), np.zeros((1, 6)))
    simulation.apply_wrench("body", (1, 0, 0, 0, 2, 0), source="world", axes="world")
    simulation.apply_wrench("body", (0, 0, 3, 0, 0, 0), source="body")
    assert (simulation.wrench_count, simulation.wrench_sources) == (2, {"world", "body"})
    simulation.advance(1)
    assert simulation.drain_applied() == [(0, "body", (0.0, -1.0, 3.0, 2.0, 0.0, 0.0))]
    with pytest.raises(ValueError, match="axes must be 'body' or 'world', got 'top'"):
        simulation.apply_wrench("body", PUSH, axes="top")


def test_replaying_the_recorded_changes_is_bit_identical():
    def pushes(simulation):
        simulation.apply_wrench("top", (0.3, 0, 0, 0, 50.0, 0), start=0.05, duration=0.1)
        simulation.apply_wrench("top", (0, 0, 0.1, 9.0, 0, 0), duration=0.0901, source="other")

    first = Simulation(load_scene("heavy_top"), step=1e-3)
    pushes(first)
    first.advance(400)
    second = Simulation(load_scene("heavy_top"), step=1e-3)
    changes = first.drain_applied()
    assert [c.step for c in changes] == [0, 50, 90, 150]
    for change in changes:
        second.advance(change.step - second.steps)
        second.apply_wrench(change.body, change.wrench)
    second.advance(400 - second.steps)
    for mine, theirs in zip(first.state(), second.state()):
        assert mine.tobytes() == theirs.tobytes()


@pytest.mark.parametrize("wrench", [(1, 2, 3), (np.nan, 0, 0, 0, 0, 0), (0, 0, 0, np.inf, 0, 0)])
def test_an_invalid_wrench_is_refused_and_changes_nothing(wrench):
    simulation = Simulation(load_scene("free_body"))
    with pytest.raises(ValueError, match="six finite numbers"):
        simulation.apply_wrench("body", wrench)
    with pytest.raises(ValueError, match="unknown body 'nobody'; choose one of: body"):
        simulation.apply_wrench("nobody", PUSH)
    with pytest.raises(ValueError, match="duration must be positive"):
        simulation.apply_wrench("body", PUSH, duration=0.0)
    simulation.advance(1)
    assert simulation.drain_applied() == []
