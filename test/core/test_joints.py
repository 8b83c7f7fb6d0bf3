# SPDX-License-Identifier: Apache-2.0
"""Joints: rows and residuals of every type, against allowed motions and finite differences.

The allowed motions are defined here independently of the table of rows: motions along single
directions, and formulas of machines (thread of a screw, Hooke's joint, conical pendulum).
"""

import math

import engine
import mechanisms
import naive
import numpy as np
import pytest
from mechanisms import FREE, WX, WY, WZ
from scipy.linalg import expm

from liegroup_core import Simulation
from liegroup_core.dynamics.accelerations import accelerations
from liegroup_core.dynamics.coordinates import displace
from liegroup_core.engine import Engine
from liegroup_core.fields.frames import rotation_z_to
from liegroup_core.joints import LOWER_PAIRS, forbidden_rows, position_residual
from liegroup_core.scene.consistency import resolve_elements

EPS = np.finfo(float).eps
TURN_OVER = np.diag([1.0, -1.0, -1.0, 1.0])


def motion(twist):
    """Pose that a constant twist (angular first) leads to after unit time."""
    generator = np.zeros((4, 4))
    generator[:3, :3] = naive.hat(twist[:3])
    generator[:3, 3] = twist[3:]
    return expm(generator)


def elements(kind, pitch=0.7, length=0.9):
    """Elements of a joint of some kind."""
    ends = {"name": "j", "parent": "world", "child": "b", "parent_frame": {}, "child_frame": {}}
    keys = {"pitch": pitch, "length": length}
    keys = {name: keys[name] for name in mechanisms.parameters(kind)}
    return mechanisms.joint(kind, **ends, **keys).elements(np.eye(4))


def residual(kind, C, **parameters):
    return position_residual(elements(kind, **parameters), C)


def allowed(rng, kind, pitch=0.7, size=1.0):
    """Pose that a joint allows, composed of motions along single directions, and its elements."""
    if kind == "universal":
        return motion(size * rng.normal() * WX) @ motion(size * rng.normal() * WY), elements(kind)
    if kind == "distance":
        C = motion(rng.normal(size=6))
        return C, elements(kind, length=np.linalg.norm(C[:3, 3]))
    C = np.eye(4)
    free = FREE[kind](pitch)
    for _ in range(4 if free else 0):
        C = C @ motion(size * rng.choice([-1, 1]) * free[rng.integers(len(free))])
    return C, elements(kind, pitch)


# ---------------------------------------------------------------- the table of lower pairs


@pytest.mark.parametrize("kind", LOWER_PAIRS)
@pytest.mark.parametrize("pitch", [0.0, 0.7, -3e-3])
def test_the_rows_forbid_all_but_the_free_motions(kind, pitch):
    pair = LOWER_PAIRS[kind]
    A, free = pair.forbidden(pitch), np.reshape(FREE[kind](pitch), (-1, 6))
    assert not (A @ free.T).any()
    # Rows are independent; rows and free motions together span all six directions.
    assert np.linalg.matrix_rank(A) == len(A) == 6 - len(free)
    assert pair.turns_freely == (not A[:, :3].any()) == (len(free) == 3 and not free[:, 3:].any())
    assert pair.text


def test_every_lower_pair_is_there():
    assert set(LOWER_PAIRS) == set(FREE)
    assert set(mechanisms.KINDS) == {*FREE, "universal", "distance"}


@pytest.mark.parametrize("kind", FREE)
@pytest.mark.parametrize("size", [1e-9, 1e-3, 1.0, 3.0, np.pi, 6.0, 40.0])
@pytest.mark.parametrize("pitch", [0.7, -1e-3])
def test_the_residual_vanishes_on_the_subgroup(kind, size, pitch):
    rng = np.random.default_rng(1)
    for _ in range(20):
        C, joint = allowed(rng, kind, pitch, size)
        # expm of a motion by `size` is right to about (1 + size) eps, four of them in a row
        assert np.abs(position_residual(joint, C)).max() <= 8 * (1 + size) * EPS


@pytest.mark.parametrize("pitch", [1e-3, 0.5, -0.5, 20.0])
def test_a_screw_may_turn_many_times(pitch):
    for turns in (-10_000, -7, 0, 1, 1000, 123_456):
        for angle in (-3.1, 0.0, 0.4, 3.1):
            C = motion(angle * WZ)
            C[2, 3] = pitch * (2.0 * math.pi * turns + angle)
            error = residual("screw", C, pitch=pitch)
            # z, the turns times 2 pi pitch, and their difference are rounded to its size; the
            # angle, of size 3, to a few eps
            assert np.abs(error).max() <= 4 * EPS * (abs(C[2, 3]) + 3.2 * abs(pitch))


@pytest.mark.parametrize("pitch", [0.5, -0.5])
def test_a_screw_is_on_the_thread_next_to_it(pitch):
    """Beyond half a thread the next thread is nearer."""
    lead = 2.0 * math.pi * abs(pitch)
    for angle in (-2.0, 0.0, 1.0):
        for off in (-0.49, -0.1, 0.2, 0.49):
            for threads in (-3, 0, 5):
                C = motion(angle * WZ)
                C[2, 3] = pitch * angle + (off + threads) * lead
                error = residual("screw", C, pitch=pitch)
                assert error[-1] == pytest.approx(off * lead, abs=1e-13)
                assert not error[:-1].any()


@pytest.mark.parametrize("pitch", [0.0, 5e-324, 1e-300, -1e-30])
def test_a_screw_without_a_pitch_is_a_hinge(pitch):
    C = motion(1.2 * WZ)
    C[:3, 3] = 0.1, -0.2, 0.3
    error = residual("screw", C, pitch=pitch)
    np.testing.assert_allclose(error, residual("revolute", C), atol=1e-15)
    np.testing.assert_allclose(LOWER_PAIRS["screw"].forbidden(0.0), LOWER_PAIRS["revolute"].forbidden())


@pytest.mark.parametrize("kind", FREE)
def test_every_forbidden_motion_shows_in_full(kind):
    """A single forbidden motion of any size is a residual of that size, up to half a turn."""
    for direction in np.eye(6):
        if any((direction * free).any() for free in FREE[kind](0.0)):
            continue
        for size in (1e-12, 0.3, 2.0, 3.1):
            error = residual(kind, motion(size * direction), pitch=1.0)
            # round-off of the entries of the matrix, of size 1 and `size`
            assert abs(np.linalg.norm(error) - size) <= 8 * (1 + size) * EPS


@pytest.mark.parametrize("kind", [kind for kind in FREE if kind != "spherical"])
def test_an_axis_turned_over_is_half_a_turn_away(kind):
    rng = np.random.default_rng(4)
    for _ in range(5):
        C, joint = allowed(rng, kind)
        error = position_residual(joint, C @ TURN_OVER)
        # the product of four exponentials is a rotation to a few eps: so is the sine of the tilt
        assert np.linalg.norm(error[:2]) == pytest.approx(np.pi, abs=16 * EPS)
    assert np.linalg.norm(residual(kind, TURN_OVER)) == np.pi


def test_half_a_turn_about_the_axis_shows_where_it_is_forbidden():
    half = np.diag([-1.0, -1.0, 1.0, 1.0])
    for kind in ("prismatic", "fixed"):
        assert np.linalg.norm(residual(kind, half)) == np.pi
    assert residual("universal", motion(math.pi / 2 * WZ))[-1] == pytest.approx(-math.pi / 2)


def test_rotation_z_to_is_a_rotation_to_round_off():
    rng = np.random.default_rng(3)
    axes = list(rng.normal(size=(50, 3))) + [(0, 0, 1), (0, 0, -1), (1, 0, 0), (0, -1, 0)]
    axes += [(tiny, -tiny, sign) for tiny in (1e-300, 1e-170, 1e-16, 1e-8, 1e-3) for sign in (1, -1)]
    for axis in axes:
        axis = np.array(axis) / np.linalg.norm(axis)
        R = rotation_z_to(axis)
        np.testing.assert_array_equal(R[:, 2], axis)
        # the unit vectors it is built from are right to 1 eps, and three products are summed
        np.testing.assert_allclose(R.T @ R, np.eye(3), atol=4 * EPS)
        assert np.linalg.det(R) > 0.0
        # shortest: the angle is that between z and the axis, trace = 1 + 2 cos
        assert abs(np.trace(R) - (1.0 + 2.0 * axis[2])) <= 8 * EPS


# ---------------------------------------------------------------- joints with own formulas


def test_a_universal_joint_turns_its_shafts_as_hookes_joint_does():
    """w_b / w_a = cos beta / (1 - sin^2 beta cos^2 gamma), shafts at an angle beta, the cross of
    shaft a turned by gamma from their plane (any textbook on machines).
    """
    for beta in (0.0, 0.3, 1.2):
        shaft_b = np.array([math.sin(beta), 0.0, math.cos(beta)])
        for gamma in (0.0, 0.4, 2.0, -3.0):
            cross = np.array([math.cos(gamma), math.sin(gamma), 0.0])  # x axis, in yoke a
            y = np.cross(shaft_b, cross)
            y /= np.linalg.norm(y)  # y axis, in yoke b
            parent, child = np.eye(4), np.eye(4)
            parent[:3, :3] = np.column_stack([cross, np.cross([0, 0, 1], cross), [0, 0, 1]])
            child[:3, :3] = np.column_stack([np.cross(y, shaft_b), y, shaft_b])
            C = np.linalg.inv(parent) @ child
            joint = elements("universal")
            assert np.abs(position_residual(joint, C)).max() <= 4 * EPS
            ratio = math.cos(beta) / (1.0 - (math.sin(beta) * math.cos(gamma)) ** 2)
            turning = child[:3, :3].T @ (ratio * shaft_b - [0, 0, 1])
            # products of unit vectors, times a ratio up to 1 / cos beta = 2.8
            assert np.abs(forbidden_rows(joint, C) @ [*turning, 0, 0, 0]).max() <= 16 * EPS
            assert abs(forbidden_rows(joint, C)[-1] @ [*(1.1 * turning + 0.1), 0, 0, 0]) > 1e-3


# ---------------------------------------------------------------- the kernels of the engine


@pytest.mark.parametrize("name", mechanisms.MECHANISMS)
def test_the_kernel_has_the_residuals_of_the_joints(name):
    """Also at poses that violate the joints."""
    rng = np.random.default_rng(3)
    simulation = Simulation(mechanisms.named(name), method="rkmk4")
    layout = simulation.layout
    found = naive.matrices(simulation.state()[0])
    for size in (0.0, 0.1, 3.0):
        moved = np.array([C @ motion(size * rng.normal(size=6)) for C in found])
        values = engine.residual(layout.model, moved)
        where = dict(zip(layout.body_names, moved)) | {"world": np.eye(4)}
        for i, (joint, frames, parts) in enumerate(
            zip(layout.scene.joints, layout.joint_frames, resolve_elements(layout.scene))
        ):
            C = np.linalg.inv(where[joint.parent] @ frames[0]) @ where[joint.child] @ frames[1]
            # the same formula of poses with entries up to 20, by another way of multiplying them
            np.testing.assert_allclose(values[layout.joint_of_row == i], position_residual(parts, C), atol=2e-13)


@pytest.mark.parametrize("name", mechanisms.UNWELDED)
def test_the_bias_is_the_rate_of_the_rows_where_joints_are_open_too(name):
    """bias = -Jdot V - J_b (0, omega x e) along C exp(t V), at any pose and twist.

    The second term turns the velocity error e of a joint's point, so that it is constant in the
    world. PERPENDICULAR has no linear part.

    Central differences of step 1e-4 leave 1e-8 times third powers of the twists.
    """
    simulation = Simulation(mechanisms.named(name), method="rkmk4", group="se3")
    rng = np.random.default_rng(8)
    found = np.array([C @ motion(0.3 * rng.normal(size=6)) for C in naive.matrices(simulation.state()[0])])
    twist = rng.normal(size=(len(found), 6))

    def at(t):
        pose = naive.flat(np.array([naive.displaced(C, t * V) for C, V in zip(found, twist)]))
        J, bias = engine.rows(simulation, pose, twist)
        return J, J @ twist.ravel(), bias

    h = 1e-4
    rate = (at(h)[1] - at(-h)[1]) / (2 * h)
    J, slips, bias = at(0.0)
    for element in simulation.layout.model.elements:
        rows = slice(element["row_start"], element["row_start"] + element["rows"])
        first = 6 * element["child"]
        beta = J[rows, first + 3 : first + 6]
        rate[rows] += beta @ np.cross(twist[element["child"], :3], slips[rows] @ beta)
    np.testing.assert_allclose(rate, -bias, atol=1e-6)


def test_the_points_of_an_open_ball_joint_in_a_loop_accelerate_alike():
    """Each link at its own point, whatever the gap: d^2/dt^2 of the gap is zero in world axes.

    The gap is 0.1 to 1 m, accelerations are up to 100 m/s^2: sums of 20 products leave 1e-12 of them.
    """
    links = [("world", "a", "revolute"), ("a", "b", "universal"), ("world", "c", "revolute")]
    for seed in range(5):
        rng = np.random.default_rng(seed)
        scene = mechanisms.mechanism(rng, links, loops=[("b", "c", "spherical")])
        simulation = Engine(scene, "rkmk4", group="relative", space="space", quiet=True)
        model, work = engine.at_stage(simulation)
        (joint,) = model.cuts
        element = model.elements[joint["element"]]
        first = len(model.bodies)
        for b in range(len(model.links)):
            away = rng.uniform(-0.4, 0.4, (len(work.acceleration), 1))
            displace(model, b, work.stage_pose, away, 0, work.stage_pose)
            work.stage_twist[first + b] = rng.uniform(-2.0, 2.0, 6)
        assert accelerations(model, work, simulation.inputs.acting.external) == -1
        found = []
        for link, point in (("parent", "parent_point"), ("child", "child_point")):
            b, at = joint[link], element[point]
            rot, p = work.world[b, :9].reshape(3, 3), work.world[b, 9:]
            (w, v), (dw, dv) = work.velocities[b].reshape(2, 3), work.moved[b].reshape(2, 3)
            rate = v + np.cross(w, at)
            found.append((p + rot @ at, rot @ (dv + np.cross(dw, at) + np.cross(w, rate))))
        (at_a, of_a), (at_b, of_b) = found
        assert np.linalg.norm(at_a - at_b) > 0.1
        np.testing.assert_allclose(of_a, of_b, atol=1e-12 * np.abs(of_a).max())
