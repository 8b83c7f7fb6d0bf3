# SPDX-License-Identifier: Apache-2.0
"""Coordinates of joints, shares of forces in what they transmit, and reactions as an array."""

import math

import numpy as np
import pytest
from scene_files import text_of

from liegroup_core import Simulation, load_scene
from liegroup_core.engine import Engine
from liegroup_core.scene.load import example_scenes, scene_from_text

SCENE = text_of("drives.yaml")


@pytest.fixture(scope="module")
def sample():
    simulation = Simulation(scene_from_text(SCENE), "rkmk4", 1e-3, estimate=False, quiet=True)
    simulation.apply_effort("hinge", 1.25)
    simulation.apply_effort("rail", -6.0)
    simulation.command_servo("hinge", 0.7, 0.1)
    simulation.advance(100)
    return simulation.sample()


def test_every_force_at_a_joint_has_its_law(sample):
    (angle, rate), (way, speed) = (sample.joint_coordinates[name] for name in ("hinge", "rail"))
    turn = math.atan2(sample.poses["nut"][1, 0], sample.poses["nut"][0, 0])
    rise = 0.2 * sample.twists["nut"][2]
    assert abs(angle) > 0.1 and abs(way) > 0.01 and turn > 0.1
    expected = {
        "linear": -4.0 - 4.0 / 8.0 * speed,
        "torsion": 7.0 * (0.3 - angle) - 0.4 * rate,
        "motor": 5.0 - 5.0 / 20.0 * rate,
        "coil": -0.6 * turn - 0.1 * sample.twists["nut"][2],
        "twister": 0.7,
        "pusher": 30.0 * (0.1 - 0.2 * turn) - 2.0 * rise,
        "servo": 40.0 * (0.7 - angle) + 3.0 * (0.1 - rate),
        "buffer": 11.0 * (0.2 - way) - 1.5 * speed,
    }
    assert list(sample.force_efforts) == list(expected)
    assert sample.force_efforts == pytest.approx(expected, rel=1e-12)


def test_a_joint_transmits_what_its_child_needs(sample):
    """Newton and Euler for each body, from its acceleration and the other forces on it."""
    for body, joint, com in (("arm", "hinge", [0.5, 0, 0]), ("cart", "rail", [0, 0, 0]), ("nut", "bolt", [0, 0, 0])):
        (entry,) = [each for each in sample.scene.bodies if each.name == body]
        (frame,) = [j.child_frame.pose for j in sample.scene.joints if j.name == joint]
        w, R = sample.twists[body][:3], sample.poses[body][:3, :3]
        turning, moving = np.split(sample.accelerations[body], 2)
        moving = moving + np.cross(turning, com) + np.cross(w, np.cross(w, com))
        force = entry.mass * (moving - R.T @ [0, 0, -9.81])
        torque = entry.inertia_matrix @ turning + np.cross(w, entry.inertia_matrix @ w)
        torque = torque + np.cross(com, force)
        if body == "arm":
            end = np.array([0.9, 0, 0])
            pull = np.array([1.0, 0, 1.0]) - (R @ end + sample.positions["arm"])
            length = np.linalg.norm(pull)
            pull = R.T @ (9.0 * (length - 0.1) * pull / length)
            force, torque = force - pull, torque - np.cross(end, pull)
        needed = np.concatenate([frame[:3, :3].T @ torque, frame[:3, :3].T @ force])
        assert sample.transmitted[joint] == pytest.approx(needed, rel=1e-11, abs=1e-11)
    along = sample.transmitted["hinge"] - sample.reactions["hinge"]
    shares = [sample.force_efforts[name] for name in ("torsion", "motor", "servo")]
    assert along == pytest.approx([0, 0, sum(shares) + 1.25, 0, 0, 0], abs=1e-12)
    along = sample.transmitted["bolt"] - sample.reactions["bolt"]
    efforts = sample.force_efforts
    expected = [0, 0, efforts["twister"] + efforts["coil"], 0, 0, efforts["pusher"]]
    assert along == pytest.approx(expected, abs=1e-12)


def test_a_scene_without_such_forces_has_none():
    scene = scene_from_text(SCENE[: SCENE.index("forces:")])
    sample = Simulation(scene, "rkmk4", 1e-3, estimate=False, quiet=True).sample()
    assert sample.force_efforts == {}
    assert all(np.array_equal(sample.transmitted[j], w) for j, w in sample.reactions.items())


# Two flywheels on one tilted axis, the angle of one unwrapped by a spring without stiffness, and a
# slider along another axis. Without gravity all rates are constant.
WHEELS = text_of("wheels_joint_coordinates.yaml")


def test_steady_motion_has_the_closed_form():
    simulation = Simulation(scene_from_text(WHEELS, "wheels"), method="rkmk4", step=1e-2)
    for _ in range(3):
        simulation.advance(50)
        t, found = simulation.time, simulation.sample().joint_coordinates
        assert list(found) == ["hinge", "axle", "rail"]
        # Constant rates; sums of 150 steps of size at most 0.14: below 150 eps * 21 = 7e-13, and
        # for the wheel on the wheel the error of its joints, of order (14 h)^5 t = 8e-5 at most.
        assert found["hinge"] == pytest.approx((7.0 * t, 7.0), abs=1e-11)
        assert found["rail"] == pytest.approx((-0.5 + 1.5 * t, 1.5), abs=1e-11)
        angle, rate = found["axle"]
        assert -math.pi <= angle <= math.pi
        assert math.remainder(angle + 14.0 * t, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-4)
        assert rate == pytest.approx(-14.0, abs=1e-4)


@pytest.mark.parametrize("name", ["slider_crank", "double_pendulum", "four_bar", "flyball_governor"])
def test_rates_are_those_of_the_coordinates(name):
    """Central differences, h = 1e-5 s: error h^2/6 of a third derivative, below 1e-11 * 1e5."""
    h = 1e-5
    simulation = Simulation(load_scene(name), method="rkmk4", step=h)
    simulation.advance(2000)
    before = simulation.sample().joint_coordinates
    simulation.advance(1)
    here = simulation.sample().joint_coordinates
    simulation.advance(1)
    after = simulation.sample().joint_coordinates
    kinds = {joint.name: joint.type for joint in simulation.scene.joints}
    assert list(here) == [n for n, kind in kinds.items() if kind in ("revolute", "prismatic")]
    for joint, (_, rate) in here.items():
        difference = (after[joint][0] - before[joint][0]) / (2.0 * h)
        assert rate == pytest.approx(difference, rel=1e-6, abs=1e-6), joint


def test_scenes_without_such_joints_have_none():
    assert Simulation(load_scene("heavy_top"), method="rkmk4").sample().joint_coordinates == {}


STEPS = {"andrews_squeezer": 3}


def compare(simulation):
    """Assert the same bits as in a Sample; returns the array."""
    sample, array = simulation.sample(), simulation.reaction_array()
    np.testing.assert_array_equal(array, sample.reaction_array)
    named = np.array(list(sample.reactions.values())).reshape(-1, 6)
    np.testing.assert_array_equal(array, named)
    return array


@pytest.mark.parametrize("name", sorted(example_scenes()))
@pytest.mark.volume(8)
def test_the_array_has_the_reactions_of_a_sample(name):
    """At every step of every scene, with stops, friction, drives and redundant constraints."""
    simulation = Simulation(load_scene(name), quiet=True)
    shapes = {compare(simulation).shape}  # before the first step, too
    for _ in range(STEPS.get(name, 60)):
        simulation.advance(1)
        shapes.add(compare(simulation).shape)
    assert shapes == {(len(simulation.scene.joints), 6)}


def test_wrenches_and_commands_count():
    """What acts in a Sample acts in the array: wrenches, targets, motions; then no more."""
    top = Engine(load_scene("heavy_top"), quiet=True)
    top.apply_wrench("top", [0, 0, 0, 0, 300, 0], start=0.002, duration=0.003)
    free = Engine(load_scene("heavy_top"), quiet=True)
    differ = []
    for _ in range(8):
        for engine in (top, free):
            engine.advance(1)
        differ.append(np.abs(compare(top) - compare(free))[0, 3:].max())
    assert min(differ[2:5]) > 4.0 and max(differ[:2] + differ[5:]) < 1.0
    arm = Engine(load_scene("driven_arm"), quiet=True)
    arm.command_motion("elbow", [0.02], [0.1], start=0.002)
    arm.advance(1)
    before = compare(arm)
    arm.advance(4)
    assert np.abs(compare(arm) - before).max() > 1.0


def test_a_singular_pose_has_more_undetermined_components():
    """A flat parallelogram: the array has NaN where the Sample has them."""
    scene = load_scene("n_four_bar")
    engine = Engine(scene, quiet=True)
    regular = np.isnan(compare(engine)).sum()
    turned = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    poses = {body.name: np.eye(4) for body in scene.bodies}
    for k, body in enumerate(scene.bodies):
        if k < 3:  # the cranks lie along x, each from its pin
            poses[body.name][:3, :3] = turned
        poses[body.name][0, 3] = (0.0, 1.0, 2.0, 1.0, 2.0)[k]
    engine.place(poses, {body: np.zeros(6) for body in poses})
    assert engine.singular_solves == 0
    assert np.isnan(compare(engine)).sum() > regular
    assert engine.singular_solves == 0  # those of reactions do not count


def test_an_array_of_the_user_takes_them():
    """Rows of a larger array, whatever its memory layout; another shape is an error."""
    engine = Engine(load_scene("four_bar"), quiet=True)
    loads = np.zeros((6, 4, 3)).T  # (3, 4, 6), not contiguous
    for k in range(3):
        engine.advance(1)
        assert engine.reaction_array(loads[k]) is not None
    np.testing.assert_array_equal(loads[2], engine.reaction_array())
    assert not np.array_equal(loads[1], loads[2], equal_nan=True)
    first = engine.reaction_array()
    engine.advance(1)
    engine.reaction_array()
    np.testing.assert_array_equal(first, loads[2])  # a result is the caller's
    with pytest.raises(ValueError, match="broadcast"):
        engine.reaction_array(np.zeros((3, 6)))


@pytest.mark.parametrize("name", ("bricard", "door", "stick_slip"))
def test_a_run_with_reactions_is_bit_identical(name):
    """Asking at every step changes no state, no memory and no event."""
    with_them, without = (Simulation(load_scene(name), quiet=True) for _ in range(2))
    for _ in range(80):
        with_them.advance(1)
        with_them.reaction_array()
    without.advance(80)
    for one, other in zip(with_them.state(), without.state()):
        np.testing.assert_array_equal(one, other)
    assert with_them.snapshot() == without.snapshot()
    assert with_them.drain_events() == without.drain_events()
