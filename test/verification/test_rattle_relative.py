# SPDX-License-Identifier: Apache-2.0
"""RATTLE in relative coordinates: the trajectory on (SO(3) x R^3)^n, with the joints of trees closed.

Both solve the same equations of the same discrete Lagrangian, in other unknowns. Orders:
test_relative_orders.py; symmetry and momentum in space: test_constrained_geometric.py; closed trees:
test_trees_stay_closed.py.
"""

import functools

import mechanisms
import numpy as np
import pytest
import random_mechanisms
from volume import VERIFY, some

from liegroup_core import Scene, load_scene
from liegroup_core.engine import Engine
from liegroup_core.mechanism.arrays import PlaneModel
from liegroup_core.methods.table import METHODS
from liegroup_core.motion_groups.table import DIRECT, FREEDOMS
from liegroup_core.scene.description import Drag

METHOD = "constrained_rattle"
CONSTRAINED = [name for name, method in METHODS.items() if method.family == "constrained"]
STEP, STEPS = 5e-4, 50
UNIT = 2.0**-53


@functools.cache
def scenes():
    """{name: scene} every joint, in space and in a plane, trees and loops."""
    every = [
        ("world", "a", "planar"),
        ("a", "b", "universal"),
        ("b", "c", "cylindrical"),
        ("c", "d", "spherical"),
        ("d", "e", "screw"),
        ("b", "f", "prismatic"),
        ("world", "g", None),
        ("g", "h", "revolute"),
    ]
    every = mechanisms.with_every_pair(every)
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
def test_the_scenes_have_all_groups_of_joints_and_planes():
    models = [Engine(scene, METHOD, group="relative", quiet=True).layout.relative for scene in scenes().values()]
    groups = {group for model in models for group in model.links["group"].tolist()}
    assert groups == set(range(len(FREEDOMS))) - {DIRECT}
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


@pytest.mark.parametrize("method", CONSTRAINED)
@pytest.mark.parametrize("name", ["four_bar", "double_pendulum", "planar loops", "hinges"])
@pytest.mark.turn(3)
def test_backward_steps_undo_forward_steps_in_a_plane(method, name):
    """As test_constrained_geometric.test_backward_steps_undo_forward_steps in space."""
    known = {"hinges": mechanisms.chain(6, "revolute")} | scenes()
    scene = next(scene for each, scene in known.items() if each.startswith(name))
    simulation = Engine(scene, method, 1e-3, "relative", quiet=True)
    assert isinstance(simulation.layout.relative, PlaneModel)
    simulation.advance(2)
    pose, twist = simulation.state()
    simulation.advance(3)
    there, rates = simulation.state()
    external = simulation.inputs.acting.external  # scenes have wrenches
    assert simulation._integrator.advance(-1e-3, 3, there, rates, external) == (3, 0)
    size = max(1.0, simulation.layout.size)
    assert np.abs(there - pose).max() <= 6e-14 * size
    assert np.abs(rates - twist).max() <= 1.2e-10 * size


@pytest.mark.parametrize("method", CONSTRAINED)
@pytest.mark.parametrize("kinds", [("revolute", "spherical", "universal"), ("screw", "planar")])
def test_a_floating_tree_keeps_its_momentum(method, kinds):
    """Without gravity. Tolerance: a few same-sign round-offs of every link per substep."""
    rng = np.random.default_rng(8)
    links = [("world", "b0", None)]
    links += [(f"b{i // 2}", f"b{i + 1}", kinds[i % len(kinds)]) for i in range(4)]
    made = mechanisms.mechanism(rng, links, springs=2)
    scene = Scene(name="floating", gravity=(0, 0, 0), bodies=made.bodies, joints=made.joints)
    simulation = Engine(scene, method, 2e-3, "relative", quiet=True)
    start = simulation.sample()
    simulation.advance(300)
    end_of_run = simulation.sample()
    size = np.abs(start.spatial_momentum).max() + np.abs(end_of_run.spatial_momentum).max()
    roundings = 300 * 17 * len(links)
    off = np.abs(end_of_run.spatial_momentum - start.spatial_momentum).max()
    assert off <= roundings * UNIT * size
    assert np.abs(end_of_run.pose - start.pose).max() > 0.1


def test_strong_dampers_converge():
    """h c / 2 m = 5: fixed-point iterations multiply the error by five, Broyden's method solves it.

    The reference: the exact decay in closed form, of the implicit half of each step: on a slide
    v+ = v (1 - a) / (1 + a), a = h c / 2 m, is the trapezoidal rule.
    """
    made = mechanisms.mechanism(np.random.default_rng(1), [("world", "a", "prismatic")], springs=0)
    mass = made.bodies[0].mass
    scene = Scene(
        name="thick",
        gravity=(0, 0, 0),
        bodies=made.bodies,
        joints=made.joints,
        forces=[Drag(name="honey", body="a", linear=1e4 * mass)],
    )
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
