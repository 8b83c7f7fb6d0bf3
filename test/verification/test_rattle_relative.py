# SPDX-License-Identifier: Apache-2.0
"""RATTLE in relative coordinates: the trajectory on (SO(3) x R^3)^n, with the joints of trees closed.

Both solve the same equations of the same discrete Lagrangian, in other unknowns. Orders:
test_relative_orders.py; symmetry and momentum: test_constrained_geometric.py; closed trees:
test_trees_stay_closed.py.
"""

import functools

import mechanisms
import numpy as np
import pytest
import random_mechanisms
from volume import VERIFY, some

from liegroup_core import load_scene
from liegroup_core.engine import Engine
from liegroup_core.mechanism.arrays import PlaneModel
from liegroup_core.scene.description import Drag

METHOD = "constrained_rattle"
STEP, STEPS = 5e-4, 50
UNIT = 2.0**-53


@functools.cache
def scenes():
    """{name: scene} every joint, in space and in a plane, trees and loops."""
    every = mechanisms.with_every_group()
    found = {
        "every joint": mechanisms.mechanism(np.random.default_rng(3), every),
        "every joint, a loop": mechanisms.mechanism(np.random.default_rng(3), every, loops=[("f", "h", "spherical")]),
    }
    for name in ("loops", "planar loops", "spherical loops"):
        for seed in some(range(10), 3):
            found[f"{name} {seed}"] = random_mechanisms.random_mechanism(name, seed)[0]
    for name in ("four_bar", "slider_crank", "double_pendulum", "bricard", "free_body"):
        found[name] = load_scene(name)
    return found


def end(scene, step=STEP, steps=STEPS, method=METHOD, **settings):
    """Poses and twists after some steps."""
    simulation = Engine(scene, method, step, quiet=True, **settings)
    simulation.advance(steps)
    return simulation.state()


@pytest.mark.turn(3)
def test_planes_are_among_the_scenes():
    models = [Engine(scene, METHOD, group="relative", quiet=True).layout.relative for scene in scenes().values()]
    assert sum(isinstance(model, PlaneModel) for model in models) >= (10 if VERIFY else 5)


@pytest.mark.turn(3)
def test_relative_and_absolute_trajectories_are_the_same():
    """Tolerance: a closed joint is closed to 16 units of lengths L, its velocity to 2/h times that.

    Such errors of 50 steps add up like a random walk, sqrt(50) = 7. Positions also gain the velocities
    for 25 ms: in 7 * 0.025 * 2/h * 16 units = 700 times 16 units. Twenty times as much is left to how
    the motion of a mechanism amplifies them. A method with another error of order h^2 fails.
    """
    others = []
    for name, scene in scenes().items():
        pose, twist = end(scene, group="so3xr3")
        size = max(1.0, np.abs(pose[:, 9:]).max())
        for space in ("auto", "space"):
            there, rates = end(scene, group="relative", space=space)
            assert np.abs(there - pose).max() <= 20 * 700 * 16 * UNIT * size, (name, space)
            assert np.abs(rates - twist).max() <= 20 * 7 * 2 / STEP * 16 * UNIT * size, name
        others.append(np.abs(end(scene, method="rkmk8", group="relative")[0] - pose).max())
    assert np.median(others) > 20 * 700 * 16 * UNIT


def test_strong_dampers_converge():
    """h c / 2 m = 5: fixed-point iterations multiply the error by five, Broyden's method solves it.

    The reference: the exact decay in closed form, of the implicit half of each step: on a slide
    v+ = v (1 - a) / (1 + a), a = h c / 2 m, is the trapezoidal rule.
    """
    made = mechanisms.mechanism(np.random.default_rng(1), [("world", "a", "prismatic")], springs=0)
    mass = made.bodies[0].mass
    forces = [Drag(name="honey", body="a", linear=1e4 * mass)]
    scene = made.remade(gravity=(0, 0, 0), forces=forces)
    simulation = Engine(scene, METHOD, 1e-3, "relative", quiet=True)
    start = simulation.state()[1][0, 3:]
    simulation.advance(1)
    assert simulation.state()[1][0, 3:] == pytest.approx(start * (1.0 - 5.0) / (1.0 + 5.0), rel=1e-12, abs=1e-13)


@pytest.mark.parametrize("space", ["auto", "space"])
def test_rods_without_inertia_about_their_axes(space):
    """On (SO(3) x R^3)^n every body needs inertia about all axes; here energy is kept to O(h^2)."""
    made = mechanisms.chain(3, "revolute")
    bodies = [body.remade(inertia=(0.0, 1e-4, 1e-4)) for body in made.bodies]
    scene = made.remade(bodies=bodies)
    errors = []
    for step in (1e-3, 5e-4):
        simulation = Engine(scene, METHOD, step, space=space, quiet=True)
        start, largest = simulation.energy(), 0.0
        for _ in range(50):
            simulation.advance(round(0.01 / step))
            largest = max(largest, abs(simulation.energy() - start))
        errors.append(largest)
    assert 3.0 < errors[0] / errors[1] < 5.0
