# SPDX-License-Identifier: Apache-2.0
"""Lower pairs and initial values: residuals vanish on the subgroup, inconsistent starts are named.

The expected values come from plain vector algebra (cross products of angular velocities and
distances, matrix exponentials of SciPy), not from the adjoints the code uses.
"""

import re

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from liegroup_core.errors import SceneError
from liegroup_core.joints import LOWER_PAIRS, position_residual, rotation_z_to
from liegroup_core.scene import (Body, Frame, Joint, Scene, check_consistency, load_scene,
                                 resolve_frames, scene_from_text)

EPS = np.finfo(float).eps


def motion(twist):
    """Pose that a constant twist (angular first) leads to after unit time."""
    (wx, wy, wz), v = twist[:3], twist[3:]
    generator = np.zeros((4, 4))
    generator[:3, :3] = [[0, -wz, wy], [wz, 0, -wx], [-wy, wx, 0]]
    generator[:3, 3] = v
    return expm(generator)


def random_frame(rng):
    """Pose and the keys that describe it in a scene."""
    rotation, position = Rotation.from_quat(rng.normal(size=4)), rng.normal(size=3)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation.as_matrix(), position
    return pose, {"position": position, "quaternion": rotation.as_quat()}


# ---------------------------------------------------------------- the table of lower pairs

@pytest.mark.parametrize("kind", LOWER_PAIRS)
def test_the_rows_are_read_only_unit_vectors(kind):
    A = LOWER_PAIRS[kind].forbidden
    np.testing.assert_array_equal(A @ A.T, np.eye(len(A)))
    assert set(A.flat) == {0.0, 1.0}
    with pytest.raises(ValueError):
        A[0, 0] = 1.0
    assert LOWER_PAIRS[kind].text


@pytest.mark.parametrize("kind, forbidden", [
    ("spherical", [[0, 0, 0, 1, 0, 0], [0, 0, 0, 0, 1, 0], [0, 0, 0, 0, 0, 1]]),
    ("revolute", [[1, 0, 0, 0, 0, 0], [0, 1, 0, 0, 0, 0], [0, 0, 0, 1, 0, 0],
                  [0, 0, 0, 0, 1, 0], [0, 0, 0, 0, 0, 1]])])
def test_the_rows_are_angular_first_about_z(kind, forbidden):
    np.testing.assert_array_equal(LOWER_PAIRS[kind].forbidden, forbidden)


@pytest.mark.parametrize("kind", LOWER_PAIRS)
@pytest.mark.parametrize("size", [1e-9, 1e-3, 1.0, 3.0, np.pi, 6.0, 40.0])
def test_the_residual_vanishes_on_the_subgroup(kind, size):
    """Subgroup elements are products of motions along single free directions."""
    rng = np.random.default_rng(1)
    free = np.flatnonzero(~LOWER_PAIRS[kind].forbidden.any(axis=0))
    for _ in range(20):
        C = np.eye(4)
        for direction in rng.choice(free, size=4):
            C = C @ motion(size * rng.choice([-1, 1]) * np.eye(6)[direction])
        # expm of a rotation by `size` is right to about (1 + size) eps, four of them in a row
        assert np.abs(position_residual(kind, C)).max() <= 8 * (1 + size) * EPS


@pytest.mark.parametrize("kind", LOWER_PAIRS)
@pytest.mark.parametrize("size", [1e-8, 1e-4])
def test_the_residual_changes_as_the_forbidden_twist(kind, size):
    """Next to the identity, parent's and child's joint frame have the same axes: d = A V."""
    rng = np.random.default_rng(2)
    for _ in range(20):
        twist = size * rng.uniform(-1, 1, 6)
        error = position_residual(kind, motion(twist)) - LOWER_PAIRS[kind].forbidden @ twist
        # second order: products of two components, |omega| and |v| up to sqrt(3) size each;
        # expm rounds the entries of size 1 beside which the twist stands
        assert np.abs(error).max() <= 3 * size**2 + 4 * EPS


@pytest.mark.parametrize("kind", LOWER_PAIRS)
def test_every_forbidden_motion_shows_in_full(kind):
    """A single forbidden motion of any size is a residual of that size, up to half a turn."""
    for row in LOWER_PAIRS[kind].forbidden:
        for size in (1e-12, 0.3, 2.0, 3.1):
            residual = position_residual(kind, motion(size * row))
            # round-off of the entries of the matrix, of size 1 and `size`
            assert abs(np.linalg.norm(residual) - size) <= 8 * (1 + size) * EPS


def test_an_axis_turned_over_is_half_a_turn_away():
    for turn in (0.0, 0.4, 2.0):
        over = motion([0, 0, turn, 0, 0, 0]) @ np.diag([1.0, -1.0, -1.0, 1.0])
        residual = position_residual("revolute", over)
        assert np.linalg.norm(residual[:2]) == np.pi and not residual[2:].any()
        assert not position_residual("spherical", over).any()


def test_rotation_z_to_is_a_rotation_to_round_off():
    rng = np.random.default_rng(3)
    axes = list(rng.normal(size=(50, 3))) + [(0, 0, 1), (0, 0, -1), (1, 0, 0), (0, -1, 0)]
    axes += [(tiny, -tiny, sign) for tiny in (1e-300, 1e-170, 1e-16, 1e-8, 1e-3)
             for sign in (1, -1)]
    for axis in axes:
        axis = np.array(axis) / np.linalg.norm(axis)
        R = rotation_z_to(axis)
        np.testing.assert_array_equal(R[:, 2], axis)
        # the unit vectors it is built from are right to 1 eps, and three products are summed
        np.testing.assert_allclose(R.T @ R, np.eye(3), atol=4 * EPS)
        assert np.linalg.det(R) > 0.0
        # shortest: the angle is that between z and the axis, trace = 1 + 2 cos
        assert abs(np.trace(R) - (1.0 + 2.0 * axis[2])) <= 8 * EPS


# ---------------------------------------------------------------- frames

def two_bodies(rng, kind="revolute", **joint):
    """World - a - b with random poses; frames of the two joints chosen to close."""
    (C_a, a), (C_b, b) = random_frame(rng), random_frame(rng)
    bodies = [Body(name=name, mass=1, inertia=[1, 1, 1], **keys)
              for name, keys in (("a", a), ("b", b))]
    F_b, frame_b = random_frame(rng)
    joints = [Joint(name="j", type=kind, parent="a", child="b", child_frame=Frame(**frame_b)),
              Joint(name="k", type=kind, parent="world", child="a", parent_frame=Frame(**frame_b))]
    return C_a, C_b, F_b, Scene(name="s", gravity=(0, 0, 0), bodies=bodies, joints=joints)


def test_a_frame_left_out_is_where_the_other_one_is():
    rng = np.random.default_rng(4)
    for _ in range(10):
        C_a, C_b, F, scene = two_bodies(rng)
        (F_ja, F_jb), (F_kw, F_ka) = resolve_frames(scene)
        # poses with entries of size 1 to 3, two products and an inverse
        np.testing.assert_allclose(F_jb, F, atol=4 * EPS)
        np.testing.assert_allclose(C_a @ F_ja, C_b @ F, atol=64 * EPS)
        np.testing.assert_allclose(F_kw, F, atol=4 * EPS)
        np.testing.assert_allclose(C_a @ F_ka, F, atol=64 * EPS)
        check_consistency(scene)


def test_frames_that_are_given_are_taken_as_they_are():
    [(F_a, F_b)] = resolve_frames(load_scene("heavy_top"))
    np.testing.assert_array_equal(F_a, np.eye(4))
    np.testing.assert_array_equal(F_b[:3, 3], [-0.5, 0, 0])
    np.testing.assert_array_equal(F_b[:3, :3], np.eye(3))
    elbow = resolve_frames(load_scene("double_pendulum"))[1]
    np.testing.assert_array_equal(elbow[0][:3, 2], [0, 1, 0])
    # 1.8 - 1.2 in floating point: -0.6 up to the round-off of 1.8
    np.testing.assert_allclose(elbow[1][:3, 3], [-0.6, 0, 0], atol=2 * EPS)


# ---------------------------------------------------------------- closing

def pinned(offset=(0, 0, 0), kind="spherical", at=(0, 0, 0), **frame):
    """A body at `at` with both joint frames given, the child's one shifted by `offset`."""
    return Scene(
        name="s", gravity=(0, 0, 0),
        bodies=[Body(name="b", mass=1, inertia=[1, 1, 1], position=at)],
        joints=[Joint(name="j", type=kind, parent="world", child="b",
                      parent_frame=Frame(position=at),
                      child_frame=Frame(position=offset, **frame))])


@pytest.mark.parametrize("gap, at, closes", [
    (1e-10, 0.0, True), (3e-9, 0.0, False), (1e-4, 1e6, True), (3e-3, 1e6, False)])
def test_a_gap_counts_relative_to_the_numbers(gap, at, closes):
    scene = pinned(offset=(0, gap, 0), at=(at, 0, 0))
    if closes:
        check_consistency(scene)
    else:
        with pytest.raises(SceneError, match=f"gap {gap:.3g} m"):
            check_consistency(scene)


def test_an_open_joint_is_named_with_gap_and_tilt():
    with pytest.raises(SceneError) as caught:
        check_consistency(pinned(offset=(3, 0, 4), kind="revolute", axis=(1, 0, 0)))
    assert str(caught.value).startswith(
        'joints[0] "j": does not close at the initial poses: gap 5 m, tilt 1.57 rad; leave out')
    assert caught.value.place == ("joints", 0)
    with pytest.raises(SceneError, match="gap 0 m, tilt 3.14 rad"):
        check_consistency(pinned(kind="revolute", axis=(0, 0, -1)))


def test_a_pair_may_start_turned_the_way_it_turns():
    check_consistency(pinned(kind="revolute", rotation_vector=(0, 0, 2.0)))
    check_consistency(pinned(kind="spherical", rotation_vector=(1, -1, 2.0)))
    with pytest.raises(SceneError, match="tilt 0.001 rad"):
        check_consistency(pinned(kind="revolute", rotation_vector=(0.001, 0, 0)))


def test_of_several_open_joints_the_first_is_named():
    scene = pinned(offset=(1, 0, 0))
    again = scene.joints[0].model_copy(update={"name": "k"})
    with pytest.raises(SceneError, match=r'^joints\[0\] "j": .* \(and 1 more\)$'):
        check_consistency(scene.model_copy(update={"joints": [*scene.joints, again]}))


# ---------------------------------------------------------------- velocities

def moving(rng, kind, error=np.zeros(6)):
    """World - a - b that move as their two joints allow, plus an error in the twist of b.

    In world axes, with the joint at p and its allowed relative angular velocity u:
    w_b = w_a + u,  v_b = v_a + w_a x (p - r_a) + w_b x (r_b - p).
    """
    R_parent, r_parent, w_parent, v_parent = np.eye(3), np.zeros(3), np.zeros(3), np.zeros(3)
    bodies, joints = [], []
    for parent, child in (("world", "a"), ("a", "b")):
        C, keys = random_frame(rng)
        R, r = C[:3, :3], C[:3, 3]
        p, axis = rng.normal(size=3), rng.normal(size=3)
        u = rng.normal(size=3) if kind == "spherical" else rng.normal() * axis
        w = w_parent + u
        v = v_parent + np.cross(w_parent, p - r_parent) + np.cross(w, r - p)
        twist = np.r_[R.T @ w, R.T @ v] + (error if child == "b" else 0.0)
        bodies.append(Body(name=child, mass=1, inertia=[1, 1, 1], **keys,
                           angular_velocity=twist[:3], linear_velocity=twist[3:]))
        # both frames are given: they are turned against each other, about the axis at least
        other = rng.normal(size=3) if kind == "spherical" else axis
        joints.append(Joint(
            name=f"to_{child}", type=kind, parent=parent, child=child,
            parent_frame=Frame(position=R_parent.T @ (p - r_parent), axis=R_parent.T @ other),
            child_frame=Frame(position=R.T @ (p - r), axis=R.T @ axis)))
        R_parent, r_parent, w_parent, v_parent = R, r, w, v
    return Scene(name="s", gravity=(0, 0, 0), bodies=bodies, joints=joints)


@pytest.mark.parametrize("kind", LOWER_PAIRS)
def test_velocities_that_the_joints_allow_are_consistent(kind):
    rng = np.random.default_rng(5)
    for _ in range(10):
        check_consistency(moving(rng, kind))


@pytest.mark.parametrize("kind", LOWER_PAIRS)
def test_a_velocity_against_a_joint_is_named_with_its_size(kind):
    rng = np.random.default_rng(6)
    for _ in range(10):
        error = np.r_[np.zeros(3), rng.normal(scale=1e-6, size=3)]
        with pytest.raises(SceneError) as caught:
            check_consistency(moving(rng, kind, error))
        size = f"{np.linalg.norm(error):.3g} m/s"
        assert str(caught.value).startswith(
            f'joints[1] "to_b": the initial velocities violate the joint by {size} and ')
        assert caught.value.place == ("joints", 1)


def test_a_turn_against_a_hinge_is_named():
    """The hinge is at the centre of mass, so that nothing slips; turning about z is free."""
    scene = pinned(kind="revolute")
    turning = scene.bodies[0].model_copy(update={"angular_velocity": (0.1, 0.0, 5.0)})
    message = r"by 0 m/s and 0\.1 rad/s; .* angular_velocity \[0, 0, 5\]"
    with pytest.raises(SceneError, match=message):
        check_consistency(scene.model_copy(update={"bodies": [turning]}))


@pytest.mark.parametrize("kind", LOWER_PAIRS)
def test_the_velocities_the_message_gives_are_consistent(kind):
    rng = np.random.default_rng(7)
    for _ in range(10):
        scene = moving(rng, kind, rng.normal(size=6))
        with pytest.raises(SceneError) as caught:
            check_consistency(scene)
        vectors = re.search(r'"b" would follow it with angular_velocity \[(.*)\] and '
                            r"linear_velocity \[(.*)\]$", str(caught.value))
        update = {key: [float(x) for x in text.split(",")] for key, text in
                  zip(("angular_velocity", "linear_velocity"), vectors.groups())}
        mended = scene.bodies[1].model_copy(update=update)
        check_consistency(scene.model_copy(update={"bodies": [scene.bodies[0], mended]}))


def test_the_heavy_top_at_rest_at_its_centre_is_refused_with_the_right_velocity():
    """Half a radian per second about z, half a metre from the pivot."""
    text = load_scene("heavy_top").text
    wrong = text.replace("linear_velocity: [0.0, 0.25, 0.0]", "linear_velocity: [0.0, 0.0, 0.0]")
    assert wrong != text
    with pytest.raises(SceneError) as caught:
        scene_from_text(wrong, source="top.yaml")
    line = text[:text.index("- name: pivot")].count("\n") + 1
    assert str(caught.value) == (
        f'top.yaml:{line}: joints[0] "pivot": the initial velocities violate the joint by '
        '0.25 m/s and 0 rad/s; "top" would follow it with angular_velocity [0, 0, 0.5] and '
        "linear_velocity [0, 0.25, 0]")


def test_extreme_numbers_are_judged_without_a_warning(recwarn):
    check_consistency(pinned(offset=(1e-300, 0, 0), at=(0, -1e-300, 0)))
    with pytest.raises(SceneError, match=r"does not close .* gap 1e\+100 m"):
        check_consistency(pinned(offset=(1e100, 0, 0), at=(0, -1e100, 0)))
    assert not recwarn.list
