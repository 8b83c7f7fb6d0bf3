# SPDX-License-Identifier: Apache-2.0
"""The index-1 solve against a dense solve, and its structure."""

import engine
import mechanisms
import naive
import numpy as np
import pytest

from liegroup_core import Scene, Simulation
from liegroup_core.forces.external import no_wrenches
from liegroup_core.formulations.absolute.newton_euler import accelerations, wrenches
from liegroup_core.model import build
from liegroup_core.model.sparsity import Structure, block_layout, elimination_order
from liegroup_core.scene.consistency import resolve_frames
from liegroup_core.scene.description import Body, Frame, Joint
from liegroup_core.scene.shapes import Rod


def engine_accelerations(simulation):
    pose, twist = simulation.state()
    work = simulation._work
    external = no_wrenches(simulation.layout.offsets)
    assert accelerations(simulation.layout.model, work, pose, twist, external) == -1
    return dict(zip(simulation.layout.body_names, work.acceleration.copy()))


@pytest.mark.parametrize("name", mechanisms.MECHANISMS)
@pytest.mark.parametrize("seed", range(3))
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
            scene,
            frames,
            {key: naive.displaced(matrix, t * twists[key]) for key, matrix in matrices.items()},
        )

    h = 1e-3
    rate = (-along(2 * h) + 16 * along(h) - 30 * along(0) + 16 * along(-h) - along(-2 * h)) / (
        12 * h * h
    )
    expected = naive.accelerations(scene, frames, matrices, twists, rate)
    found = engine_accelerations(Simulation(scene))
    # A body on a fixed joint to the world does not accelerate, but gravity acts on it.
    size = max(9.81, *(np.abs(value).max() for value in expected.values()))
    for body, value in expected.items():
        assert np.abs(found[body] - value).max() <= 1e-6 * size, body


def random_tree(rng):
    """Tree of five bodies with random types of joints."""
    links = [
        (
            f"b{rng.integers(max(0, i - 2), i)}" if i else "world",
            f"b{i}",
            rng.choice(mechanisms.KINDS),
        )
        for i in range(5)
    ]
    return mechanisms.mechanism(rng, links, springs=0)


def distance_to_dense(simulation):
    """Difference of the accelerations to a dense solve with the same rows, relative to the largest."""
    J, bias = engine.rows(simulation)
    solved = np.abs(J).sum(axis=1) > 0.0
    J, bias = J[solved], bias[solved]
    work, (pose, twist) = simulation._work, simulation.state()
    external = no_wrenches(simulation.layout.offsets)
    wrenches(simulation.layout.model, work, pose, twist, external, work.wrench)
    M = engine.masses(simulation.layout.centred)
    K = np.block([[M, J.T], [J, np.zeros((len(J), len(J)))]])
    wanted = np.linalg.solve(K, np.concatenate([work.wrench.ravel(), bias]))[: twist.size]
    found = np.concatenate(list(engine_accelerations(simulation).values()))
    return np.abs(found - wanted).max() / max(9.81, np.abs(wanted).max())


@pytest.mark.parametrize("bodies_first", [False, True])
@pytest.mark.parametrize("seed", range(4))
def test_both_elimination_orders_of_a_tree_agree_with_the_dense_solve(
    monkeypatch, bodies_first, seed
):
    """Against the dense K of the same rows, bodies of 1 to 900 kg.

    Bodies first lose the digits of that ratio, 900 times some ten roundings: 1e-12; leaves first
    those of the lever against the inertia, about ten times.
    """
    rng = np.random.default_rng(seed)
    scene = random_tree(rng)
    heavier = np.exp(rng.uniform(0.0, np.log(900.0), size=len(scene.bodies)))
    scene = scene.model_copy(
        update={
            "bodies": tuple(
                body.model_copy(
                    update={
                        "mass": factor * body.mass,
                        "inertia": tuple(factor * np.array(body.inertia)),
                    }
                )
                for factor, body in zip(heavier, scene.bodies)
            )
        }
    )
    monkeypatch.setattr(
        build, "cheapest_structure", lambda *given: Structure(*given[:4], bodies_first)
    )
    simulation = Simulation(scene)
    assert distance_to_dense(simulation) <= 1e-12


@pytest.mark.parametrize("thin", [1e-2, 1e-4, 1e-6])
@pytest.mark.parametrize("seed", range(4))
def test_iterative_refinement_keeps_the_accuracy_for_thin_bodies(thin, seed):
    """Bodies with one small moment of inertia: a refinement recovers the digits that elimination loses.

    Without refinement it loses the digits of the ratio of m p^2 to the inertia, five for 1e-4; up
    to three are allowed. The dense solve is accurate to 2e-14 (checked with 40 digits).
    """
    rng = np.random.default_rng(seed)
    scene = random_tree(rng)
    bodies = []
    for body in scene.bodies:
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        matrix = 0.1 * body.mass * turn @ np.diag([1.0, 1.0, thin]) @ turn.T
        bodies.append(
            body.model_copy(
                update={"inertia": (*np.diag(matrix), matrix[0, 1], matrix[0, 2], matrix[1, 2])}
            )
        )
    simulation = Simulation(scene.model_copy(update={"bodies": tuple(bodies)}))
    assert distance_to_dense(simulation) <= (1e-12 if thin == 1e-2 else 1e-13)


@pytest.mark.parametrize("radius", [0.02, 1e-3, 1e-4, 1e-5])
@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.785), (0.3, 0.5, 0.785)])
def test_iterative_refinement_keeps_the_accuracy_for_slender_rods(radius, turn):
    """Rows that mix rotations about a rod's axis with others: elimination loses 1e-11 to 1e-4.

    1e-13: the dense solve itself is accurate to about 1e-14 here.
    """
    bodies = [
        Body(
            name=f"r{i}",
            shape=Rod(axis=(1, 0, 0), length=1.0, radius=radius, mass=1.0),
            position=(i + 0.5, 0.0, 0.0),
        )
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
    assert distance_to_dense(Simulation(scene, space="space")) <= 1e-13


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
    found = engine_accelerations(Simulation(scene))
    again = engine_accelerations(Simulation(scene.model_copy(update={"joints": tuple(turned)})))
    size = max(np.abs(value).max() for value in found.values())
    for body, value in found.items():
        # Two orders of the same sums: a few rounding errors times the condition of S, about 1e3.
        assert np.abs(again[body] - value).max() <= 1e-12 * size


def saddle_graph(joints, bodies):
    """Sizes and neighbours of bodies, then joints; a joint is a tuple of its bodies."""
    neighbours = [set() for _ in range(bodies + len(joints))]
    for j, held in enumerate(joints):
        for body in held:
            neighbours[body].add(bodies + j)
            neighbours[bodies + j].add(body)
    return [6] * bodies + [3] * len(joints), neighbours


def test_a_chain_is_eliminated_from_its_tip_without_fill_in():
    n = 200
    sizes, neighbours = saddle_graph([(0,)] + [(i - 1, i) for i in range(1, n)], n)
    order, below = elimination_order(sizes, neighbours, n)
    assert sum(map(len, below)) == 2 * n - 1
    assert order == [v for i in reversed(range(n)) for v in (i, n + i)]


def test_a_tree_has_no_fill_in():
    n = 100
    rng = np.random.default_rng(5)
    sizes, neighbours = saddle_graph([(0,)] + [(rng.integers(i), i) for i in range(1, n)], n)
    order, below = elimination_order(sizes, neighbours, n)
    assert sorted(order) == list(range(2 * n)) and sum(map(len, below)) == 2 * n - 1


def test_in_a_ring_joints_are_eliminated_after_their_bodies():
    n = 30
    sizes, neighbours = saddle_graph([(i, (i + 1) % n) for i in range(n)], n)
    order, below = elimination_order(sizes, neighbours, n)
    for p, v in enumerate(order):
        assert v < n or all(body in order[:p] for body in neighbours[v])
    # A ring of 2 n vertices fills one block for each but the last three.
    assert sum(map(len, below)) <= 2 * (2 * n) - 3
    place, ends, _, columns, _ = block_layout(np.array([sizes[v] for v in order]), below, [])
    assert len(columns) == sum(map(len, below)) and len(place) == 2 * n + len(columns)
    size = sum(sizes[order[i]] * sizes[order[j]] for i, j in place)
    # Nothing changes, and scratch memory is that of a body's part of the solution.
    assert ends == (0, 0, size, size + 6)


def test_eliminating_bodies_first_couples_the_joints_of_a_body():
    n = 200
    sizes, neighbours = saddle_graph([(0,)] + [(i - 1, i) for i in range(1, n)], n)
    order, below = elimination_order(sizes, neighbours, n, bodies_first=True)
    for p, v in enumerate(order):
        assert v < n or neighbours[v] <= set(order[:p])
    assert sum(map(len, below)) == (2 * n - 1) + (n - 1)


def test_only_pose_dependent_blocks_are_marked_variable():
    """Body on two joints, 6 + 3 + 3: the block of the second joint changes."""
    place, (summed, fresh, size, end), ranges, columns, updates = block_layout(
        np.array([6, 3, 3]), [[1, 2], [2], []], [(2, 0)]
    )
    changing = {block for block, at in place.items() if at < fresh}
    assert changing == {(2, 0), (2, 1), (2, 2)} and fresh == 18 + 9 + 9
    # The block that is written anew comes after those that are added to.
    assert place[2, 0] == summed == 9 + 9
    assert [constant for constant, *_ in ranges] == [True, True, False]
    # Of the body's two columns the second is formed anew, and so is what it is multiplied with.
    assert [tuple(row[3:]) for row in updates] == [(2, 1), (2, 2), (2, 2)]
    assert size == 36 + 2 * 18 + 3 * 9 and len(columns) == 3
    # One product at a time is kept, that of the body: of a factor that changes with all others.
    assert end == size + 18 and (columns[columns[:, 2] >= 0, 2] == size).all()
    assert (updates[:, 1:3] == size).any(axis=1).all()


@pytest.mark.parametrize("name", mechanisms.MECHANISMS)
def test_rewritten_blocks_have_no_constant_part(name):
    """`assemble` overwrites these blocks of J, so elimination must not have added to them."""
    model = Simulation(mechanisms.named(name)).layout.model
    assert not model.matrix[model.summed : model.fresh].any()


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
        for body, point in (
            (spring.parent, spring.parent_point),
            (spring.child, spring.child_point),
        ):
            matrix = start.poses.get(body, np.eye(4))
            twist = start.twists.get(body, np.zeros(6))
            ends.append(matrix[:3, :3] @ np.array(point) + matrix[:3, 3])
            speeds.append(matrix[:3, :3] @ (twist[3:] + np.cross(twist[:3], point)))
        d = ends[1] - ends[0]
        power -= spring.damping * ((speeds[1] - speeds[0]) @ d / np.linalg.norm(d)) ** 2
    scale = max(1.0, abs(power))
    assert rate == pytest.approx(power, abs=1e-2 * scale)
