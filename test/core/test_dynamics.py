# SPDX-License-Identifier: Apache-2.0
"""Accelerations on SE(3)^n against a dense solve and another tree, and the power that they take."""

import engine
import mechanisms
import naive
import numpy as np
import precise
import pytest

from liegroup_core import Scene, Simulation
from liegroup_core.engine import Engine
from liegroup_core.scene.consistency import resolve_frames
from liegroup_core.scene.description import Body, Frame, Joint
from liegroup_core.scene.shapes import Rod


def accelerations(scene):
    """{body: (6,)} accelerations with an empty tree."""
    found = engine.engine_accelerations(scene, group="se3")
    return {body.name: value for body, value in zip(scene.bodies, found)}


@pytest.mark.parametrize("name", mechanisms.MECHANISMS)
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.volume(30)
def test_accelerations_agree_with_the_dense_saddle_point(name, seed):
    """Jacobian and Jdot V by differences of the position residual, gravity, springs and dampers.

    Central differences of step 1e-6 leave 1e-10 in J, the five-point second difference of step
    1e-3 leaves 1e-9 in Jdot V; the solve magnifies them by its condition, below 1e3 here.
    """
    scene = mechanisms.named(name, seed)
    frames = resolve_frames(scene)
    matrices = {body.name: body.pose for body in scene.bodies}
    twists = {body.name: body.twist for body in scene.bodies}

    def along(t):
        return naive.residual(
            scene, frames, {key: naive.displaced(matrix, t * twists[key]) for key, matrix in matrices.items()}
        )

    h = 1e-3
    rate = (-along(2 * h) + 16 * along(h) - 30 * along(0) + 16 * along(-h) - along(-2 * h)) / (12 * h * h)
    expected = naive.accelerations(scene, frames, matrices, twists, rate)
    found = accelerations(scene)
    # A body on a fixed joint to the world does not accelerate, but gravity acts on it.
    size = max(9.81, *(np.abs(value).max() for value in expected.values()))
    for body, value in expected.items():
        assert np.abs(found[body] - value).max() <= 1e-6 * size, body


TREES = {"empty tree": {"group": "se3"}, "chain": {"group": "relative", "space": "space"}}


@pytest.mark.parametrize("radius", [0.02, 1e-3, 1e-4])
@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.785), (0.3, 0.5, 0.785)])
@pytest.mark.parametrize("tree", TREES)
def test_accelerations_of_slender_rods_keep_their_digits(radius, turn, tree):
    """Rows that mix rotations about a rod's axis with others: without refinement 1e-11 to 1e-6 are lost.

    The same rows, solved with 50 digits. 1e-13: two hundred roundings of numbers up to g, for
    sums along four rods.
    """
    bodies = [
        Body(name=f"r{i}", shape=Rod(axis=(1, 0, 0), length=1.0, radius=radius, mass=1.0), position=(i + 0.5, 0.0, 0.0))
        for i in range(4)
    ]
    joints = [
        Joint(
            name=f"j{i}",
            type="revolute",
            parent=f"r{i - 1}" if i else "world",
            child=f"r{i}",
            child_frame=Frame(position=(-0.5, 0, 0), rotation_vector=turn),
        )
        for i in range(4)
    ]
    scene = Scene(name="rods", gravity=(0.1, 0.3, -9.81), bodies=bodies, joints=joints)
    J, right = engine.rows(Engine(scene, quiet=True, group="se3"))
    kept = J.any(axis=1)
    wanted = precise.solved_with(scene, (), J[kept], right[kept]).astype(float)
    found = engine.engine_accelerations(scene, **TREES[tree])
    assert np.abs(found - wanted).max() <= 1e-13 * 9.81


def test_accelerations_do_not_depend_on_parent_and_child_order():
    scene = mechanisms.named("net")
    turned = [
        joint.model_copy(
            update={
                "parent": joint.child,
                "child": joint.parent,
                "parent_frame": joint.child_frame,
                "child_frame": joint.parent_frame,
            }
        )
        if joint.parent != "world"
        else joint
        for joint in scene.joints
    ]
    found = accelerations(scene)
    again = accelerations(scene.model_copy(update={"joints": tuple(turned)}))
    size = max(np.abs(value).max() for value in found.values())
    for body, value in found.items():
        # Two orders of the same sums: a few rounding errors times the condition of S, about 1e3.
        assert np.abs(again[body] - value).max() <= 1e-12 * size


@pytest.mark.parametrize("name", mechanisms.MECHANISMS)
def test_energy_rate_equals_the_power_of_the_dampers(name):
    """dE/dt from the accelerations equals the power of the dampers.

    One step of 1e-6 s: E is smooth, so (E(h) - E(0)) / h = Edot + O(h), with E'' below 1e5 W/s.
    """
    scene = mechanisms.named(name)
    simulation = Simulation(scene, step=1e-6)
    start = simulation.sample()
    simulation.advance(1)
    rate = (simulation.sample().energy - start.energy) / 1e-6
    power = 0.0
    for spring in scene.forces:
        ends, speeds = [], []
        for body, point in ((spring.parent, spring.parent_point), (spring.child, spring.child_point)):
            matrix = start.poses.get(body, np.eye(4))
            twist = start.twists.get(body, np.zeros(6))
            ends.append(matrix[:3, :3] @ np.array(point) + matrix[:3, 3])
            speeds.append(matrix[:3, :3] @ (twist[3:] + np.cross(twist[:3], point)))
        d = ends[1] - ends[0]
        power -= spring.damping * ((speeds[1] - speeds[0]) @ d / np.linalg.norm(d)) ** 2
    scale = max(1.0, abs(power))
    assert rate == pytest.approx(power, abs=1e-2 * scale)
