# SPDX-License-Identifier: Apache-2.0
"""Every example scene builds, satisfies its joints initially and conserves what it should."""

import numpy as np
import pytest
from scene_files import each_scene

from liegroup_core import Simulation, load_scene
from liegroup_core.scene import check_consistency
from liegroup_core.scene.library import chain, four_bar_windows

# Steps for which the error of order 4 of each scene is small, s; the rest take 1 ms.
STEPS = {"four_bar": 1e-4, "lagrangian_top": 2e-4, "andrews_squeezer": 2e-6, "flyball_governor": 5e-5}


@each_scene
@pytest.mark.turn(3)
def test_an_example_scene_satisfies_constraints_and_conserves_energy(path):
    scene = load_scene(path)
    check_consistency(scene)
    simulation = Simulation(scene, method="rkmk4", step=STEPS.get(path.stem, 1e-3))
    first = simulation.sample()
    # poses and frames of size 1 with a few round-offs each
    assert first.constraint_residual <= 1e-14
    simulation.advance(200)
    last = simulation.sample()
    assert last.constraint_residual <= 1e-7
    fed = any(joint.driven or joint.friction for joint in scene.joints)
    fed = fed or any(force.type == "motor" or getattr(force, "damping", 0.0) for force in scene.forces)
    if not fed:
        masses = np.array([body.mass for body in scene.bodies])
        # of what the scene has of energy: its motion, or the fall through its own size
        moving = max(abs(first.energy), abs(last.energy), masses.sum() * 9.81 * 0.1)
        assert abs(last.energy - first.energy) <= 1e-6 * moving
    assert simulation.singular_solves == 0


@pytest.mark.parametrize(
    "name, made",
    [("ball_chain", chain(10)), ("hinge_chain", chain(10, "revolute")), ("n_four_bar", four_bar_windows(2))],
)
def test_example_files_equal_the_library_scenes(name, made):
    scene = load_scene(name)
    for mine, theirs in zip(made.bodies, scene.bodies):
        assert (mine.name, mine.mass, mine.inertia, mine.com) == (theirs.name, theirs.mass, theirs.inertia, theirs.com)
        np.testing.assert_allclose(mine.pose, theirs.pose, atol=1e-15)
        np.testing.assert_allclose(mine.twist, theirs.twist, atol=1e-15)
    assert [(j.name, j.type, j.parent, j.child) for j in made.joints] == [
        (j.name, j.type, j.parent, j.child) for j in scene.joints
    ]


@pytest.mark.parametrize("kind", ["spherical", "revolute"])
@pytest.mark.parametrize("n", [1, 3, 30])
def test_initial_acceleration_of_a_chain_has_the_closed_form(kind, n):
    """One rod released from rest: theta'' = m g (l / 2) / (m r^2 / 4 + m l^2 / 3)."""
    simulation = Simulation(chain(n, kind), method="rkmk4", step=1e-4)
    start = simulation.sample()
    simulation.advance(10)
    sample = simulation.sample()
    if n == 1:
        acceleration = 9.81 * 0.05 / (0.005**2 / 4 + 0.1**2 / 3)
        assert sample.twists["rod0"][1] == pytest.approx(1e-3 * acceleration, rel=1e-5)
    # both kinds of joint move in the plane alike, and none of the energy is lost
    assert np.abs(sample.pose[:, 10]).max() <= 1e-15
    assert sample.energy == pytest.approx(start.energy, abs=1e-12)


def test_chains_of_spherical_and_of_revolute_joints_fall_alike():
    """In the plane a revolute joint adds only constraints that are satisfied anyway."""
    ball, hinge = (Simulation(chain(5, kind), method="rkmk4") for kind in ("spherical", "revolute"))
    ball.advance(200)
    hinge.advance(200)
    np.testing.assert_allclose(ball.sample().pose, hinge.sample().pose, atol=1e-10)
