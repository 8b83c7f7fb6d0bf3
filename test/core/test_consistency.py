# SPDX-License-Identifier: Apache-2.0
"""Initial values: consistent ones are accepted, inconsistent ones are refused with a location.

Expected values come from vector algebra (cross products of angular velocities and distances), not
from the adjoints that the code uses.
"""

import re

import mechanisms
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from liegroup_core.errors import SceneError
from liegroup_core.scene import (
    Body,
    Frame,
    Joint,
    Scene,
    check_consistency,
    load_scene,
    resolve_elements,
    resolve_frames,
    scene_from_text,
)

EPS = np.finfo(float).eps


def random_frame(rng):
    """Random pose and its keys in a scene."""
    rotation, position = Rotation.from_quat(rng.normal(size=4)), rng.normal(size=3)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation.as_matrix(), position
    return pose, {"position": position, "quaternion": rotation.as_quat()}


# ---------------------------------------------------------------- frames


def two_bodies(rng, kind="revolute", **joint):
    """World - a - b with random poses; the joint frames satisfy both joints."""
    (C_a, a), (C_b, b) = random_frame(rng), random_frame(rng)
    bodies = [Body(name=name, mass=1, inertia=[1, 1, 1], **keys) for name, keys in (("a", a), ("b", b))]
    F_b, frame_b = random_frame(rng)
    joints = [
        Joint(name="j", type=kind, parent="a", child="b", child_frame=Frame(**frame_b)),
        Joint(name="k", type=kind, parent="world", child="a", parent_frame=Frame(**frame_b)),
    ]
    return C_a, C_b, F_b, Scene(name="s", gravity=(0, 0, 0), bodies=bodies, joints=joints)


def test_an_omitted_joint_frame_coincides_with_the_other_one():
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


def test_joint_frames_in_the_scene_are_used_unchanged():
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
    """Body at `at` with both joint frames given, the child's one shifted by `offset`."""
    frames = {"parent_frame": {"position": at}, "child_frame": {"position": offset} | frame}
    return mechanisms.one_body({"type": kind} | frames, name="b", position=at)


@pytest.mark.parametrize(
    "gap, at, closes", [(1e-10, 0.0, True), (3e-9, 0.0, False), (1e-4, 1e6, True), (3e-3, 1e6, False)]
)
def test_the_accepted_gap_is_relative_to_the_coordinates(gap, at, closes):
    scene = pinned(offset=(0, gap, 0), at=(at, 0, 0))
    if closes:
        check_consistency(scene)
    else:
        with pytest.raises(SceneError, match=f"gap {gap:.3g} m"):
            check_consistency(scene)


def test_a_violated_joint_is_refused_with_gap_and_tilt():
    with pytest.raises(SceneError) as caught:
        check_consistency(pinned(offset=(3, 0, 4), kind="revolute", axis=(1, 0, 0)))
    assert str(caught.value).startswith('joints[0] "j": is violated at the initial poses: gap 5 m, tilt 1.57 rad; omit')
    assert caught.value.place == ("joints", 0)
    with pytest.raises(SceneError, match="gap 0 m, tilt 3.14 rad"):
        check_consistency(pinned(kind="revolute", axis=(0, 0, -1)))


def test_a_pair_may_start_displaced_along_its_free_direction():
    check_consistency(pinned(kind="revolute", rotation_vector=(0, 0, 2.0)))
    check_consistency(pinned(kind="spherical", rotation_vector=(1, -1, 2.0)))
    check_consistency(pinned(kind="planar", offset=(3, 4, 0), rotation_vector=(0, 0, 2.0)))
    check_consistency(pinned(kind="cylindrical", offset=(0, 0, 4), rotation_vector=(0, 0, 2.0)))
    check_consistency(pinned(kind="prismatic", offset=(0, 0, 4)))
    check_consistency(pinned(kind="universal", rotation_vector=(0, -2.0, 0)))
    with pytest.raises(SceneError, match="gap 0 m, tilt 2 rad"):
        check_consistency(pinned(kind="prismatic", offset=(0, 0, 4), rotation_vector=(0, 0, 2.0)))
    with pytest.raises(SceneError, match="gap 0 m, tilt 0.5 rad"):
        check_consistency(pinned(kind="universal", rotation_vector=(0, 0, 0.5)))
    with pytest.raises(SceneError, match="tilt 0.001 rad"):
        check_consistency(pinned(kind="revolute", rotation_vector=(0.001, 0, 0)))


def rod(length=None, reach=(3, 0, 4), at=(0, 0, 0)):
    """Body at `at` on a distance joint to the point `at` + `reach`."""
    joint = {"type": "distance", "length": length, "child_frame": {}}
    return mechanisms.one_body(joint | {"parent_frame": {"position": np.add(at, reach)}}, name="b", position=at)


def test_an_omitted_distance_is_the_initial_distance():
    [[element]] = resolve_elements(rod())
    assert element.parameter == 5.0
    check_consistency(rod())
    check_consistency(rod(5.0))
    with pytest.raises(
        SceneError,
        match=r"joints\[0\] \"j\": is violated .* gap 1 m, tilt 0 "
        "rad; omit length to keep the initial distance",
    ):
        check_consistency(rod(4.0))
    with pytest.raises(SceneError, match="gap 2 m, tilt 0 rad"):
        check_consistency(rod(2.0, reach=(0, 0, 0)))


@pytest.mark.parametrize(
    "reach, length, at",
    [((0, 0, 0), None, 0), ((0, 1e-10, 0), None, 0), ((0, 1e-10, 0), 1e-10, 0), ((1e-4, 0, 0), None, 1e6)],
)
def test_a_distance_joint_of_zero_length_is_refused(reach, length, at):
    """A distance below the round-off of the positions has no direction."""
    with pytest.raises(SceneError, match="the two points coincide, .*; use a spherical joint") as caught:
        check_consistency(rod(length, reach, (at, 0, 0)))
    assert caught.value.place == ("joints", 0)


def test_of_several_violated_joints_the_first_is_named():
    scene = pinned(offset=(1, 0, 0))
    again = scene.joints[0].model_copy(update={"name": "k"})
    with pytest.raises(SceneError, match=r'^joints\[0\] "j": .* \(and 1 more\)$'):
        check_consistency(scene.model_copy(update={"joints": [*scene.joints, again]}))


# ---------------------------------------------------------------- velocities


def allowed_velocity(rng, kind, axes, way, cross_axis):
    """Relative angular velocity, and velocity of the child's point relative to the parent.

    axes : columns x, y, z of the parent's joint frame in the world
    way  : from its origin to that of the child's one; cross_axis: y axis of the child's frame
    """
    x, y, z = axes.T
    any_turn = rng.normal(size=3)
    if kind == "distance":
        return any_turn, np.cross(way, any_turn)  # keeps the distance
    if kind == "universal":
        return axes[:, 0] * rng.normal() + cross_axis * rng.normal(), np.zeros(3)
    free = mechanisms.directions(kind)
    twist = rng.normal(size=len(free)) @ free
    return axes @ twist[:3], axes @ twist[3:]


def forbidden_direction(kind, axes, way):
    """Direction in which the joint forbids translation."""
    if kind == "distance":
        return way / np.linalg.norm(way)
    return axes[:, 2] if kind == "planar" else axes[:, 0]


def moving(rng, kind, error=0.0, turn=np.zeros(3)):
    """World - a - b with consistent velocities, plus a violation of the second joint.

    error : m/s of b along a forbidden direction; turn: rad/s of b
    In world axes, with the child's point at q, its relative velocity s and the relative angular
    velocity u:  w_b = w_a + u,  v_b = v_a + w_a x (q - r_a) + s + w_b x (r_b - q).
    """
    parent_pose, w_parent, v_parent = np.eye(4), np.zeros(3), np.zeros(3)
    bodies, joints = [], []
    for parent, child in (("world", "a"), ("a", "b")):
        C, keys = random_frame(rng)
        at_parent, _ = random_frame(rng)
        at_child = at_parent @ mechanisms.allowed_motion(rng, kind)
        q, way = at_child[:3, 3], at_child[:3, 3] - at_parent[:3, 3]
        u, s = allowed_velocity(rng, kind, at_parent[:3, :3], way, at_child[:3, 1])
        w = w_parent + u
        v = v_parent + np.cross(w_parent, q - parent_pose[:3, 3]) + s + np.cross(w, C[:3, 3] - q)
        if child == "b":
            v = v + error * forbidden_direction(kind, at_parent[:3, :3], way)
        keys["angular_velocity"] = C[:3, :3].T @ w + (turn if child == "b" else 0.0)
        keys["linear_velocity"] = C[:3, :3].T @ v
        bodies.append(Body(name=child, mass=1, inertia=[1, 1, 1], **keys))
        # both frames are given
        frames = (np.linalg.inv(parent_pose) @ at_parent, np.linalg.inv(C) @ at_child)
        ends = dict(zip(("parent_frame", "child_frame"), map(described, frames)))
        joints.append(mechanisms.joint(kind, name=f"to_{child}", parent=parent, child=child, **ends))
        parent_pose, w_parent, v_parent = C, w, v
    return Scene(name="s", gravity=(0, 0, 0), bodies=bodies, joints=joints)


def described(pose):
    """Frame description of a pose (4, 4)."""
    return Frame(position=pose[:3, 3], quaternion=Rotation.from_matrix(pose[:3, :3]).as_quat())


@pytest.mark.parametrize("kind", mechanisms.KINDS)
def test_velocities_allowed_by_the_joints_are_accepted(kind):
    rng = np.random.default_rng(5)
    for _ in range(10):
        check_consistency(moving(rng, kind))


@pytest.mark.parametrize("kind", mechanisms.KINDS)
def test_a_velocity_against_a_joint_is_refused_with_its_size(kind):
    rng = np.random.default_rng(6)
    for _ in range(10):
        error = 1e-6 * rng.uniform(0.1, 10)
        with pytest.raises(SceneError) as caught:
            check_consistency(moving(rng, kind, error))
        assert str(caught.value).startswith(
            f'joints[1] "to_b": the initial velocities violate the joint by {error:.3g} m/s and '
        )
        assert caught.value.place == ("joints", 1)


def test_an_angular_velocity_against_a_revolute_joint_is_refused():
    """Revolute joint at the centre of mass: no linear violation; rotation about z is free."""
    scene = pinned(kind="revolute")
    turning = scene.bodies[0].model_copy(update={"angular_velocity": (0.1, 0.0, 5.0)})
    message = r"by 0 m/s and 0\.1 rad/s; .* angular_velocity \[0, 0, 5\]"
    with pytest.raises(SceneError, match=message):
        check_consistency(scene.model_copy(update={"bodies": [turning]}))


@pytest.mark.parametrize("kind", mechanisms.KINDS)
def test_the_velocities_suggested_by_the_error_are_consistent(kind):
    rng = np.random.default_rng(7)
    for _ in range(10):
        scene = moving(rng, kind, rng.normal(), rng.normal(size=3))
        with pytest.raises(SceneError) as caught:
            check_consistency(scene)
        vectors = re.search(
            r'consistent values for "b" are angular_velocity \[(.*)\] and '
            r"linear_velocity \[(.*)\]$",
            str(caught.value),
        )
        update = {
            key: [float(x) for x in text.split(",")]
            for key, text in zip(("angular_velocity", "linear_velocity"), vectors.groups())
        }
        mended = scene.bodies[1].model_copy(update=update)
        check_consistency(scene.model_copy(update={"bodies": [scene.bodies[0], mended]}))


def test_the_heavy_top_with_zero_centre_velocity_gets_the_right_suggestion():
    """0.5 rad/s about z, 0.5 m from the pivot."""
    text = load_scene("heavy_top").text
    wrong = text.replace("linear_velocity: [0.0, 0.25, 0.0]", "linear_velocity: [0.0, 0.0, 0.0]")
    assert wrong != text
    with pytest.raises(SceneError) as caught:
        scene_from_text(wrong, source="top.yaml")
    line = text[: text.index("- name: pivot")].count("\n") + 1
    assert str(caught.value) == (
        f'top.yaml:{line}: joints[0] "pivot": the initial velocities violate the joint by '
        '0.25 m/s and 0 rad/s; consistent values for "top" are angular_velocity [0, 0, 0.5] and '
        "linear_velocity [0, 0.25, 0]"
    )


def test_extreme_numbers_are_checked_without_floating_point_warnings(recwarn):
    check_consistency(pinned(offset=(1e-300, 0, 0), at=(0, -1e-300, 0)))
    with pytest.raises(SceneError, match=r"is violated .* gap 1e\+100 m"):
        check_consistency(pinned(offset=(1e100, 0, 0), at=(0, -1e100, 0)))
    assert not recwarn.list
