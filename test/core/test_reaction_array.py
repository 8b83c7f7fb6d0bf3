# SPDX-License-Identifier: Apache-2.0
"""Reactions of an engine's present state, without a Sample: the same bits, and nothing else changes."""

import numpy as np
import pytest

from liegroup_core import Simulation, load_scene
from liegroup_core.engine import Engine
from liegroup_core.scene.load import example_scenes

STEPS = {"andrews_squeezer": 3}


def compare(simulation):
    """Assert the same bits as in a Sample; returns the array."""
    sample, array = simulation.sample(), simulation.reaction_array()
    np.testing.assert_array_equal(array, sample.reaction_array)
    named = np.array(list(sample.reactions.values())).reshape(-1, 6)
    np.testing.assert_array_equal(array, named)
    return array


@pytest.mark.parametrize("name", sorted(example_scenes()))
@pytest.mark.volume(8)
def test_the_array_has_the_reactions_of_a_sample(name):
    """At every step of every scene, with stops, friction, drives and redundant constraints."""
    simulation = Simulation(load_scene(name), quiet=True)
    shapes = {compare(simulation).shape}  # before the first step, too
    for _ in range(STEPS.get(name, 60)):
        simulation.advance(1)
        shapes.add(compare(simulation).shape)
    assert shapes == {(len(simulation.scene.joints), 6)}


def test_wrenches_and_commands_count():
    """What acts in a Sample acts in the array: wrenches, targets, motions; then no more."""
    top = Engine(load_scene("heavy_top"), quiet=True)
    top.apply_wrench("top", [0, 0, 0, 0, 300, 0], start=0.002, duration=0.003)
    free = Engine(load_scene("heavy_top"), quiet=True)
    differ = []
    for _ in range(8):
        for engine in (top, free):
            engine.advance(1)
        differ.append(np.abs(compare(top) - compare(free))[0, 3:].max())
    assert min(differ[2:5]) > 4.0 and max(differ[:2] + differ[5:]) < 1.0
    arm = Engine(load_scene("driven_arm"), quiet=True)
    arm.command_motion("elbow", [0.02], [0.1], start=0.002)
    arm.advance(1)
    before = compare(arm)
    arm.advance(4)
    assert np.abs(compare(arm) - before).max() > 1.0


def test_a_singular_pose_has_more_undetermined_components():
    """A flat parallelogram: the array has NaN where the Sample has them."""
    scene = load_scene("n_four_bar")
    engine = Engine(scene, quiet=True)
    regular = np.isnan(compare(engine)).sum()
    turned = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    poses = {body.name: np.eye(4) for body in scene.bodies}
    for k, body in enumerate(scene.bodies):
        if k < 3:  # the cranks lie along x, each from its pin
            poses[body.name][:3, :3] = turned
        poses[body.name][0, 3] = (0.0, 1.0, 2.0, 1.0, 2.0)[k]
    engine.place(poses, {body: np.zeros(6) for body in poses})
    assert engine.singular_solves == 0
    assert np.isnan(compare(engine)).sum() > regular
    assert engine.singular_solves == 0  # those of reactions do not count


def test_an_array_of_the_user_takes_them():
    """Rows of a larger array, whatever its memory layout; another shape is an error."""
    engine = Engine(load_scene("four_bar"), quiet=True)
    loads = np.zeros((6, 4, 3)).T  # (3, 4, 6), not contiguous
    for k in range(3):
        engine.advance(1)
        assert engine.reaction_array(loads[k]) is not None
    np.testing.assert_array_equal(loads[2], engine.reaction_array())
    assert not np.array_equal(loads[1], loads[2], equal_nan=True)
    first = engine.reaction_array()
    engine.advance(1)
    engine.reaction_array()
    np.testing.assert_array_equal(first, loads[2])  # a result is the caller's
    with pytest.raises(ValueError, match="broadcast"):
        engine.reaction_array(np.zeros((3, 6)))


@pytest.mark.parametrize("name", ("bricard", "door", "stick_slip"))
def test_a_run_with_reactions_is_bit_identical(name):
    """Asking at every step changes no state, no memory and no event."""
    with_them, without = (Simulation(load_scene(name), quiet=True) for _ in range(2))
    for _ in range(80):
        with_them.advance(1)
        with_them.reaction_array()
    without.advance(80)
    for one, other in zip(with_them.state(), without.state()):
        np.testing.assert_array_equal(one, other)
    assert with_them.snapshot() == without.snapshot()
    assert with_them.drain_events() == without.drain_events()
