# SPDX-License-Identifier: Apache-2.0
"""Accelerations on SE(3)^n against a dense solve and another tree, and the power that they take."""

import engine
import mechanisms
import naive
import numpy as np
import precise
import pytest
import random_mechanisms

from liegroup_core import Scene, Simulation
from liegroup_core.dynamics.inverse_dynamics import inverse_dynamics
from liegroup_core.engine import Engine
from liegroup_core.methods.munthe_kaas import steps as relative
from liegroup_core.scene.consistency import resolve_frames
from liegroup_core.scene.description import Body, Frame, Joint
from liegroup_core.scene.load import load_scene, scene_from_text
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
        moved = {key: naive.displaced(matrix, t * twists[key]) for key, matrix in matrices.items()}
        return naive.residual(scene, frames, moved)

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
    at = Frame(position=(-0.5, 0, 0), rotation_vector=turn)
    ends = zip(["world", "r0", "r1", "r2"], ["r0", "r1", "r2", "r3"])
    joints = [Joint(name=f"j{b}", type="revolute", parent=a, child=b, child_frame=at) for a, b in ends]
    scene = Scene(name="rods", gravity=(0.1, 0.3, -9.81), bodies=bodies, joints=joints)
    J, right = engine.rows(Engine(scene, quiet=True, group="se3"))
    kept = J.any(axis=1)
    wanted = precise.solved_with(scene, (), J[kept], right[kept]).astype(float)
    found = engine.engine_accelerations(scene, **TREES[tree])
    assert np.abs(found - wanted).max() <= 1e-13 * 9.81


def test_accelerations_do_not_depend_on_parent_and_child_order():
    scene = mechanisms.named("net")
    swapped = {"parent": "child", "child": "parent", "parent_frame": "child_frame", "child_frame": "parent_frame"}
    turned = [
        joint.model_copy(update={to: getattr(joint, of) for to, of in swapped.items() if joint.parent != "world"})
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


# Accelerations of the body frames at a state, against derivatives of the motion.
#
# Differences over five instants have an error of (omega h)^4, 1e-9 for 50 rad/s and h = 1e-4 s, and a
# round-off of 1e-16 / h^2 = 1e-8 m/s^2 for 1 m.


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


# Generalised forces of joint accelerations, in space and in the plane.
#
# The mass matrix M of the joints is that of the kinetic energy, which bodies, their masses and twists
# give without joints. The whole is compared with articulated bodies: forces vanish at the accelerations
# and multipliers of the index-1 equations, which test_relative_accelerations.py checks against 50
# digits to 1e-12 of an acceleration. A force is a sum over at most 40 bodies of products with such
# errors: 1e-10 of the largest addend, |M| |qddot| or the bias, leaves room for levers.


SPACES = ("auto", "space")
CASES = [(name, seed) for name in random_mechanisms.CLASSES for seed in range(4)]
ADDENDS = 1e-10


def solved(scene, wrenches, space):
    """(engine, model, work) of a mechanism, with accelerations and multipliers in work."""
    simulation = Engine(scene, "rkmk4", quiet=True, group="relative", space=space)
    for body, wrench, axes in wrenches:
        simulation.apply_wrench(body, wrench, source=axes, axes=axes)
    simulation.advance(0)
    model, work = engine.at_stage(simulation)
    assert relative.accelerate(model, work, simulation.inputs.acting.external) == -1
    return simulation, model, work


def forces(model, work, rates):
    """Forces (f,) of the joint accelerations `rates`."""
    out = np.zeros(len(rates))
    inverse_dynamics(model, work, rates.reshape(-1, 1), out)
    return out


def mass_matrix(model, work):
    """(M, bias) (f, f) and (f,), by unit accelerations."""
    f = len(work.acceleration)
    bias = forces(model, work, np.zeros(f))
    return np.column_stack([forces(model, work, unit) - bias for unit in np.eye(f)]), bias


@pytest.mark.parametrize("name, seed", CASES)
@pytest.mark.parametrize("space", SPACES)
@pytest.mark.volume(5)
def test_forces_vanish_at_the_accelerations_of_the_equations_of_motion(name, seed, space):
    scene, wrenches = random_mechanisms.random_mechanism(name, seed)
    _, model, work = solved(scene, wrenches, space)
    rates = work.acceleration[:, 0].copy()
    left = forces(model, work, rates)
    M, bias = mass_matrix(model, work)
    assert np.abs(M - M.T).max() <= 1e-12 * np.abs(M).max()
    largest = np.abs(M).max() * np.abs(rates).max() + np.abs(bias).max()
    assert np.abs(left).max() <= ADDENDS * largest


@pytest.mark.parametrize("name", ["tree", "loops", "planar loops"])
@pytest.mark.parametrize("space", SPACES)
@pytest.mark.volume(2)
def test_the_mass_matrix_is_that_of_the_kinetic_energy(name, space):
    for seed in range(4):
        simulation, model, work = solved(*random_mechanisms.random_mechanism(name, seed), space)
        M, _ = mass_matrix(model, work)
        rates = np.concatenate(
            [row[:count] for row, count in zip(work.stage_twist[len(model.bodies) :], model.links["freedoms"])]
        )
        twists = simulation.state()[1].ravel()
        energy = 0.5 * twists @ engine.masses(simulation.layout.centred) @ twists
        assert 0.5 * rates @ M @ rates == pytest.approx(energy, rel=1e-11)
