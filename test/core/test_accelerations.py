# SPDX-License-Identifier: Apache-2.0
"""Accelerations of the body frames at a state, against derivatives of the motion.

Differences over five instants have an error of (omega h)^4, 1e-9 for 50 rad/s and h = 1e-4 s, and a
round-off of 1e-16 / h^2 = 1e-8 m/s^2 for 1 m.
"""

import numpy as np
import pytest
import random_mechanisms

from liegroup_core.engine import Engine
from liegroup_core.scene.load import load_scene, scene_from_text

STEP = 1e-4
PUSH = [0.3, -0.2, 0.5, 4.0, -3.0, 2.0]
SCENES = ("heavy_top", "double_pendulum", "four_bar", "bricard", "flyball_governor", "slider_crank")


def measured(engine):
    """(sample, (n, 6) accelerations) in the middle of five instants, by differences."""
    samples = []
    for _ in range(5):
        samples.append(engine.sample())
        engine.advance(1)
    x = [sample.pose[:, 9:] for sample in samples]
    w = [np.einsum("nij,nj->ni", sample.pose[:, :9].reshape(-1, 3, 3), sample.twist[:, :3]) for sample in samples]
    linear = (-x[0] + 16.0 * x[1] - 30.0 * x[2] + 16.0 * x[3] - x[4]) / (12.0 * STEP**2)
    angular = (w[0] - 8.0 * w[1] + 8.0 * w[3] - w[4]) / (12.0 * STEP)
    return samples[2], np.concatenate([angular, linear], axis=1)


def in_world(sample):
    """Sample.accelerations (n, 6), in world axes."""
    R = sample.pose[:, :9].reshape(-1, 3, 3)
    found = np.array(list(sample.accelerations.values())).reshape(-1, 2, 3)
    return np.einsum("nij,nkj->nki", R, found).reshape(-1, 6)


def check(scene, wrenches=()):
    engine = Engine(scene, "rkmk4", STEP, quiet=True, stabilisation="projection")
    for body, wrench, axes in wrenches:
        engine.apply_wrench(body, wrench, source=axes, axes=axes)
    engine.advance(20)
    sample, expected = measured(engine)
    found = in_world(sample)
    size = max(1.0, np.abs(expected).max())
    assert np.abs(found - expected).max() <= 1e-6 * size


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("axes", ["body", "world"])
@pytest.mark.turn(3)
def test_accelerations_are_the_derivatives_of_the_motion(name, axes):
    scene = load_scene(name)
    check(scene, [(scene.bodies[-1].name, PUSH, axes)])


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("name", ["tree", "loops", "couplings"])
@pytest.mark.volume(4)
def test_accelerations_of_random_mechanisms(name, seed):
    check(*random_mechanisms.random_mechanism(name, seed))


def test_a_free_body_falls_and_turns_as_in_closed_form():
    """A wrench about the frame's origin, and a centre of mass away from it."""
    scene = scene_from_text(
        "name: one\ngravity: [0, 0, -9.81]\nbodies:\n"
        "  - {name: stone, mass: 2, inertia: [1, 2, 3], com: [0, 0, 1], "
        "angular_velocity: [2, 0, 0]}\n"
    )
    engine = Engine(scene, "rkmk4", quiet=True)
    engine.apply_wrench("stone", [0, 0, 0, 4, 0, 0])
    engine.advance(0)
    found = in_world(engine.sample())
    # The force at the origin has the moment (0, -4, 0) about the centre of mass: omega_y' = -2.
    # Centre: (2, 0, -9.81). Origin: omega' x (0, 0, -1) = (2, 0, 0), and 4 m/s^2 towards the centre.
    assert found[0] == pytest.approx([0.0, -2.0, 0.0, 4.0, 0.0, -9.81 + 4.0], abs=1e-12)


def test_a_wrench_of_the_scene_counts_from_its_start():
    scene = scene_from_text(
        "name: timed\ngravity: [0, 0, 0]\nbodies: [{name: a, mass: 2, inertia: [1, 1, 1]}]\n"
        "forces: [{name: jet, type: applied_wrench, body: a, force: [6, 0, 0], start: 0.003, end: 0.005}]\n"
    )
    engine = Engine(scene, "rkmk4", 1e-3, quiet=True)
    found = []
    for _ in range(7):
        found.append(in_world(engine.sample())[0, 3])
        engine.advance(1)
    assert found == [0.0, 0.0, 0.0, 3.0, 3.0, 0.0, 0.0]
