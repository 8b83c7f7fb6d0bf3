# SPDX-License-Identifier: Apache-2.0
"""Centres of mass away from the body frames: the same mechanism in other frames."""

from collections.abc import Mapping

import mechanisms
import numpy as np
import pytest
from other_frames import described_elsewhere

from liegroup_core import Simulation
from liegroup_core.mechanism.symmetry import conserved_momentum
from liegroup_core.observables.invariants import momentum_values
from liegroup_core.observables.sample import Sample
from liegroup_core.reference import WrenchSpan, integrate
from liegroup_core.scene import Body, Frame, Joint, Scene
from liegroup_core.scene.centres import PLACES, Offsets, at_centres_of_mass
from liegroup_core.scene.description import FORCES, JOINTS

# Properties of a Sample that depend on the body frames; all others belong to the mechanism.
OF_FRAMES = {"pose", "twist", "rows", "poses", "twists", "positions", "pose_matrices"}
OF_FRAMES |= {"accelerations", "acting", "child_frames", "scene"}
# None without an estimate, an accuracy, stops and friction.
ABSENT = {"error", "errors", "bound", "switching"}


def pair(name, seed=0):
    """Random mechanism twice: frames at the centres of mass, and elsewhere."""
    scene = mechanisms.named(name, seed)
    rng = np.random.default_rng(seed)
    com = {body.name: 0.5 * rng.normal(size=3) for body in scene.bodies}
    return scene, described_elsewhere(scene, com), com


def public(sample):
    """{name: value} of all properties of a Sample that belong to the mechanism."""
    names = [name for name in dir(Sample) if not name.startswith("_")] + ["time", "steps"]
    return {name: getattr(sample, name) for name in names if name not in OF_FRAMES | ABSENT}


def close(mine, theirs, atol):
    if isinstance(mine, Mapping):
        assert mine.keys() == theirs.keys()
        for key in mine:
            close(mine[key], theirs[key], atol)
    elif isinstance(mine, tuple) and mine and isinstance(mine[0], str):
        assert mine == theirs
    else:
        # Sums of some ten products: a few roundings of their size beside the absolute part.
        np.testing.assert_allclose(mine, theirs, rtol=8 * np.finfo(float).eps, atol=atol)


@pytest.mark.parametrize("name", mechanisms.MECHANISMS)
def test_the_frames_are_moved_to_the_centres_of_mass(name):
    scene, elsewhere, _ = pair(name)
    centred = at_centres_of_mass(elsewhere)
    for mine, theirs in zip(centred.bodies, scene.bodies):
        assert mine.com == (0.0, 0.0, 0.0)
        assert (mine.mass, mine.inertia) == (theirs.mass, theirs.inertia)
        # numbers of size 1 to 10, offsets of size 1 added and taken away
        np.testing.assert_allclose(mine.pose, theirs.pose, atol=1e-14)
        np.testing.assert_allclose(mine.twist, theirs.twist, atol=1e-14)
    for mine, theirs in zip((*centred.joints, *centred.forces), (*scene.joints, *scene.forces)):
        for key, value in theirs.model_dump().items():
            other = mine.model_dump()[key]
            if isinstance(value, (tuple, float)):
                np.testing.assert_allclose(other, value, atol=1e-14)
            elif isinstance(value, dict):
                np.testing.assert_allclose(other["position"], value["position"], atol=1e-14)
                assert other == value | {"position": other["position"]}
            else:
                assert other == value


@pytest.mark.parametrize("group", ["se3", "so3xr3"])
@pytest.mark.parametrize("name", mechanisms.MECHANISMS)
@pytest.mark.volume(18)
def test_the_motion_does_not_depend_on_body_frames(name, group):
    """Round-off of 1e-15 grows by less than a factor of 1000 in 100 steps of these mechanisms."""
    scene, elsewhere, com = pair(name)
    one, other = (Simulation(scene, method="rkmk4", group=group), Simulation(elsewhere, method="rkmk4", group=group))
    for _ in range(3):
        mine, theirs = other.sample(), one.sample()
        close(public(mine), public(theirs), 1e-10)
        for body, c in com.items():
            R = mine.poses[body][:3, :3]
            np.testing.assert_allclose(R, theirs.poses[body][:3, :3], atol=1e-11)
            np.testing.assert_allclose(mine.positions[body] + R @ c, theirs.positions[body], atol=1e-11)
            w, v = np.split(mine.twists[body], 2)
            np.testing.assert_allclose(np.r_[w, v + np.cross(w, c)], theirs.twists[body], atol=1e-10)
            turning, moving = np.split(mine.accelerations[body], 2)
            moving = moving + np.cross(turning, c) + np.cross(w, np.cross(w, c))
            np.testing.assert_allclose(np.r_[turning, moving], theirs.accelerations[body], rtol=1e-12, atol=1e-10)
        one.advance(50)
        other.advance(50)


@pytest.mark.parametrize("name", ["ball", "net"])
def test_wrenches_refer_to_the_origin_of_the_body_frame(name):
    """A force at the frame's origin has the torque -c x f about the centre of mass."""
    scene, elsewhere, com = pair(name, seed=3)
    one, other = Simulation(scene, method="rkmk4"), Simulation(elsewhere, method="rkmk4")
    torque, force = np.array([0.3, -0.2, 0.5]), np.array([4.0, 5.0, -6.0])
    other.apply_wrench("a", (*torque, *force), start=0.01, duration=0.03)
    one.apply_wrench("a", (*(torque - np.cross(com["a"], force)), *force), start=0.01, duration=0.03)
    one.advance(60)
    other.advance(60)
    close(public(other.sample()), public(one.sample()), 1e-10)
    # what is written down is what was commanded, to the bit
    applied = other.drain_applied()
    assert [command.values for command in applied] == [(*torque, *force)]


def test_a_sample_is_restored_from_its_recorded_pose():
    _, scene, _ = pair("net")
    simulation = Simulation(scene, method="rkmk4")
    simulation.advance(20)
    sample = simulation.sample()
    again = simulation.layout.sample(sample.pose, sample.twist, sample.time, sample.time_ns, sample.steps)
    close(public(again), public(sample), 1e-13)
    np.testing.assert_allclose(again.pose, sample.pose, atol=1e-15)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["chain of hinges", "tree"])
def test_the_reference_integration_uses_the_same_body_frames(name):
    """The reference integration takes states and wrenches, and returns motions, of body frames."""
    _, scene, _ = pair(name, seed=1)
    simulation = Simulation(scene, method="rkmk4", step=5e-4)
    start = simulation.state()
    simulation.apply_wrench("b", (0.1, 0.2, 0.3, 1, -2, 0.5), start=0.02)
    simulation.advance(200)
    sample = simulation.sample()
    changes = [WrenchSpan(0.02, np.inf, "b", (0.1, 0.2, 0.3, 1, -2, 0.5))]
    exact, _ = integrate(scene, *start, [0.0, 0.1], changes)
    n = len(scene.bodies)
    np.testing.assert_allclose(exact.position[1], sample.pose[:, 9:], atol=1e-8)
    np.testing.assert_allclose(exact.rotation[1].reshape(n, 9), sample.pose[:, :9], atol=1e-8)
    np.testing.assert_allclose(exact.twist[1], sample.twist, atol=1e-7)
    still = simulation.layout.sample(
        np.concatenate([exact.rotation[0].reshape(n, 9), exact.position[0]], axis=1), exact.twist[0]
    )
    first = Simulation(scene, method="rkmk4").sample()
    np.testing.assert_allclose(still.pose, first.pose, atol=1e-14)
    np.testing.assert_allclose(still.twist, first.twist, atol=1e-14)


def test_conserved_momentum_does_not_depend_on_body_frames():
    """Two free bodies on a spherical joint, and a single one: all momentum is conserved."""
    bodies = [
        Body(name=name, mass=mass, inertia=(1, 2, 2.5), com=com, position=place, angular_velocity=w, linear_velocity=v)
        for name, mass, com, place, w, v in (
            ("a", 2.0, (0.3, 0, 0.1), (0, 0, 0), (1, 0, 2), (0, 0, 0)),
            ("b", 1.0, (0, 0.2, -0.4), (0, 1, 0), (0, 3, 1), (0, 0, 0)),
            ("c", 3.0, (0.1, 0.1, 0), (5, 0, 0), (0, 1, 1), (1, 0, 0)),
        )
    ]
    joint = Joint(
        name="j", type="spherical", parent="a", child="b", parent_frame=Frame(), child_frame=Frame(position=(0, -1, 0))
    )
    scene = Scene(name="s", gravity=(0, 0, 0), assemble=True, bodies=bodies, joints=[joint])
    simulation = Simulation(scene, method="rkmk4")
    samples = []
    for _ in range(5):
        samples.append(simulation.sample())
        simulation.advance(100)
    pose = np.array([sample.pose for sample in samples])
    twist = np.array([sample.twist for sample in samples])
    kept = conserved_momentum(scene)
    assert sorted(len(group.labels) for group in kept) == [6, 6]
    for group in kept:
        values = momentum_values(scene, group, pose[..., :9].reshape(5, 3, 3, 3), pose[..., 9:], twist)
        # the error of order 4 at this step, measured 1e-10
        np.testing.assert_allclose(values, values[:1].repeat(5, axis=0), atol=1e-9)


def test_without_offsets_scene_and_arrays_are_returned_unchanged():
    scene = mechanisms.named("net")
    assert at_centres_of_mass(scene) is scene
    offsets, pose, twist = Offsets(scene), np.ones((5, 12)), np.ones((5, 6))
    assert all(a is b for a, b in zip(offsets.to_bodies(pose, twist), (pose, twist)))
    assert all(a is b for a, b in zip(offsets.to_centres(pose, twist), (pose, twist)))
    wrench = np.array([-0.0, 1e308, 3.0, 1e308, 0.0, 1e-300])
    assert offsets.wrench_at_centre(2, wrench).tobytes() == wrench.tobytes()


def test_offset_conversion_and_its_inverse_for_whole_motions():
    """Arrays of samples, as in an analysis, give the same as single samples."""
    _, scene, _ = pair("tree")
    rng = np.random.default_rng(1)
    offsets, n = Offsets(scene), len(scene.bodies)
    poses = [[mechanisms.random_pose(rng) for _ in range(n)] for _ in range(4)]
    pose = np.array([[np.r_[C[:3, :3].ravel(), C[:3, 3]] for C in row] for row in poses])
    twist = rng.normal(size=(4, n, 6))
    moved = offsets.to_centres(pose, twist)
    for k in range(4):
        for mine, theirs in zip(offsets.to_centres(pose[k], twist[k]), moved):
            np.testing.assert_array_equal(mine, theirs[k])
    for mine, theirs in zip(offsets.to_bodies(*moved), (pose, twist)):
        np.testing.assert_allclose(mine, theirs, atol=1e-15 * 8)


@pytest.mark.parametrize("kind", [*JOINTS, *FORCES], ids=lambda kind: kind.__name__)
def test_every_point_and_frame_of_every_kind_is_shifted(kind):
    """Every point or frame in a body, of any joint or force, is listed in PLACES."""
    for key, field in kind.model_fields.items():
        holds_frame = Frame in (field.annotation, *getattr(field.annotation, "__args__", ()))
        of_joint = field.annotation is float  # a joint coordinate is no place
        if "point" in key or "position" in key and not of_joint or holds_frame:
            assert PLACES.get(key) in kind.model_fields, key
