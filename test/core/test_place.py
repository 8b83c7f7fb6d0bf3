# SPDX-License-Identifier: Apache-2.0
"""Engine.place: some bodies get a pose or a twist, the others follow through their joints."""

import numpy as np
import pytest
from engine import rows
from scene_files import text_of

from liegroup_core import Simulation
from liegroup_core.engine import Engine
from liegroup_core.errors import SceneError
from liegroup_core.joints.limits import BeyondLimits
from liegroup_core.lie.groups import SE3, SO3
from liegroup_core.scene.load import load_scene, scene_from_text

FREE = text_of("two_free.yaml")


def pose(rotation, position):
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = SO3.exp(np.array(rotation, dtype=float)), position
    return matrix


def test_a_free_body_gets_exactly_what_is_given_and_others_keep_their_bits():
    engine = Engine(scene_from_text(FREE), "rkmk4", 1e-3)
    engine.advance(100)
    before = engine.state()
    wanted, twist = pose([0.3, -0.2, 0.9], [1.0, 2.0, 3.0]), [0.1, 0.2, 0.3, 4.0, 5.0, 6.0]
    engine.place({"near": wanted}, {"near": twist})
    sample = engine.sample()
    assert np.abs(sample.poses["near"] - wanted).max() <= 1e-15
    assert np.abs(sample.twists["near"] - twist).max() <= 1e-15
    assert engine.steps == 100
    for old, new in zip(before, engine.state()):
        assert np.array_equal(old[1], new[1])
    engine.place({}, {"near": np.zeros(6)})
    assert np.array_equal(engine.sample().poses["near"], sample.poses["near"])
    assert not engine.sample().twists["near"].any()


@pytest.mark.parametrize("name, group", [("four_bar", "auto"), ("four_bar", "se3")])
def test_a_crank_that_is_turned_moves_the_other_links(name, group):
    """The crank stays where it is set; coupler and rocker close the loop again, and move with it."""
    scene = load_scene(name)
    engine = Engine(scene, "rkmk4", 1e-3, group, quiet=True)
    engine.advance(50)
    crank = scene.bodies[0].name
    start = engine.sample()
    axis = start.twists[crank][:3] / np.linalg.norm(start.twists[crank][:3])
    # About its joint to the ground, where its frame or its joint frame may be.
    (hinge,) = [j for j in scene.joints if {j.parent, j.child} == {"world", crank}]
    frame = hinge.child_frame if hinge.child == crank else hinge.parent_frame
    about = start.poses[crank] @ frame.pose
    turned = about @ pose(0.2 * (frame.pose[:3, :3].T @ axis), [0, 0, 0]) @ SE3.inverse(frame.pose)
    engine.place({crank: turned}, {})
    sample = engine.sample()
    assert np.abs(sample.poses[crank] - turned).max() <= 1e-14
    assert sample.constraint_residual <= 1e-12
    others = [body.name for body in scene.bodies[1:]]
    assert min(np.abs(sample.poses[b] - start.poses[b]).max() for b in others) > 1e-3
    J, _ = rows(engine)
    slip = J @ engine.state()[1].ravel()
    assert np.abs(slip).max() <= 1e-13 * np.abs(sample.twist).max()


def test_digits_that_single_precision_has_lost_are_found_again():
    engine = Engine(load_scene("heavy_top"), "rkmk4", 1e-3, quiet=True)
    engine.advance(10)
    top = engine.layout.body_names[0]
    sample = engine.sample()
    rounded = sample.poses[top].astype(np.float32)
    rotation = SO3.from_quaternion(sample.quaternions[top].astype(np.float32).astype(float))
    rounded = rounded.astype(float)
    rounded[:3, :3] = rotation
    twist = sample.twists[top].astype(np.float32).astype(float)
    assert not np.array_equal(twist, sample.twists[top])
    engine.place({top: rounded}, {top: twist})
    after = engine.sample()
    assert after.constraint_residual <= 1e-14
    assert np.abs(rows(engine)[0] @ engine.state()[1].ravel()).max() <= 1e-13
    assert np.abs(after.poses[top] - sample.poses[top]).max() <= 1e-6
    assert np.abs(after.twists[top] - sample.twists[top]).max() <= 1e-6 * np.abs(twist).max()


def test_a_refusal_names_the_joint_of_the_scene():
    """The third joint, of two mechanisms that are not connected."""
    scene = scene_from_text(
        "name: pair\ngravity: [0, 0, 0]\nbodies: [{name: a, mass: 1, inertia: [1, 1, 1]}, "
        "{name: b, mass: 1, inertia: [1, 1, 1]}, {name: c, mass: 1, inertia: [1, 1, 1]}]\njoints:\n"
        + "".join(
            f"  - {{name: j{k}, type: spherical, parent: world, child: {body}, "
            "parent_frame: {position: [0, 0, 0]}, child_frame: {position: [0, 0, 0]}}\n"
            for k, body in enumerate("abc")
        )
    )
    engine = Engine(scene, "rkmk4", 1e-3)
    with pytest.raises(SceneError, match=r'joints\[2\] "j2": cannot be assembled.* 1 m'):
        engine.place({"c": pose([0, 0, 0], [1.0, 0, 0])}, {})
    with pytest.raises(SceneError, match=r'joints\[2\] "j2": .* 1 m/s'):
        engine.place({}, {"c": [0, 0, 0, 1.0, 0, 0]})


def test_what_the_joints_do_not_allow_is_refused_with_the_gap_and_changes_nothing():
    engine = Engine(load_scene("heavy_top"), "rkmk4", 1e-3)
    engine.advance(10)
    before = engine.snapshot()
    top = engine.layout.body_names[0]
    lifted = engine.sample().poses[top].copy()
    lifted[2, 3] += 0.25
    with pytest.raises(SceneError, match=r"violation is 0\.25 m"):
        engine.place({top: lifted}, {})
    with pytest.raises(SceneError, match=r"violates this joint by 3 m/s"):
        engine.place({}, {top: [0, 0, 0, 0, 0, 3.0]})
    for unknown in ({"nobody": np.eye(4)}, {}), ({}, {"nobody": np.zeros(6)}):
        with pytest.raises(ValueError, match="unknown body 'nobody'; choose one of: "):
            engine.place(*unknown)
    for wrong in (np.full((4, 4), np.nan), np.eye(3), np.diag([1.0, 2.0, 1.0, 1.0])):
        with pytest.raises(ValueError):
            engine.place({top: wrong}, {})
    with pytest.raises(ValueError, match=r"finite twist \(6,\)"):
        engine.place({}, {top: [np.inf] * 6})
    for size in (1e101, 1e155, 1e308):  # whose squares, or cubes, are infinite
        far = np.eye(4)
        far[0, 3] = size
        with pytest.raises(BeyondLimits, match="too large"):
            engine.place({top: far})
        with pytest.raises(BeyondLimits, match="too large"):
            engine.place({}, {top: [size] * 6})
    assert engine.snapshot() == before


def test_the_estimate_starts_again():
    simulation = Simulation(scene_from_text(FREE), accuracy=1e-4)
    simulation.advance(24)
    assert simulation.largest_error > 0.0
    simulation.place({}, {"near": np.zeros(6)})
    assert simulation.largest_error == 0.0 and simulation.steps == 24
    simulation.advance(24)
    assert np.isfinite(simulation.largest_error)


ARM = text_of("arm_place.yaml")


@pytest.mark.parametrize("group", ["relative", "se3"])
def test_joints_take_their_values_and_the_others_keep_theirs(group):
    """A floating tree: whole turns of a spring's joint too, and what is free of it keeps its bits."""
    engine = Engine(scene_from_text(ARM), "rkmk4", 1e-3, group, quiet=True)
    start = engine.sample()
    engine.place({}, {}, {"rail": (0.1, 0.5), "bolt": (0.4, -2.0)})
    for body in ("base", "upper"):  # not moved by what they carry
        assert np.abs(engine.sample().poses[body] - start.poses[body]).max() <= 1e-14
        assert np.abs(engine.sample().twists[body] - start.twists[body]).max() <= 1e-13
    engine.advance(20)
    before, stone = engine.sample(), engine.state()[0][4]
    engine.place(joints={"shoulder": (7.5, -1.0)})
    after = engine.sample()
    assert after.joint_coordinates["shoulder"] == pytest.approx((7.5, -1.0), abs=1e-13)
    assert after.joint_coordinates["rail"] == pytest.approx(before.joint_coordinates["rail"], abs=1e-13)
    assert np.abs(after.poses["base"] - before.poses["base"]).max() <= 1e-14
    assert np.abs(after.twists["base"] - before.twists["base"]).max() <= 1e-13
    assert np.array_equal(engine.state()[0][4], stone)
    for sample in before, after:
        between = SE3.inverse(sample.poses["lower"]) @ sample.poses["nut"]
        assert between[2, 3] == pytest.approx(0.02 * np.arctan2(between[1, 0], between[0, 0]))
    relative = [SE3.inverse(s.poses["lower"]) @ s.poses["nut"] for s in (before, after)]
    assert np.abs(relative[0] - relative[1]).max() <= 1e-14
    assert after.constraint_residual <= 1e-14
    assert np.abs(rows(engine)[0] @ engine.state()[1].ravel()).max() <= 1e-13
    assert engine.steps == 20


def test_bodies_and_joints_are_set_together():
    """The arm moves with its base."""
    engine = Engine(scene_from_text(ARM), "rkmk4", 1e-3, quiet=True)
    base, twist = pose([0.1, 0.2, 0.3], [4.0, 5.0, 6.0]), [0.1, 0.2, 0.3, 1.0, 2.0, 3.0]
    engine.place({"base": base}, {"base": twist}, {"shoulder": (0.5, 0.0), "rail": (None, 0.2)})
    sample = engine.sample()
    assert np.abs(sample.poses["base"] - base).max() <= 1e-14
    assert np.abs(sample.twists["base"] - twist).max() <= 1e-13
    assert sample.joint_coordinates["shoulder"] == pytest.approx((0.5, 0.0), abs=1e-13)
    assert sample.joint_coordinates["rail"] == pytest.approx((0.0, 0.2), abs=1e-13)
    shoulder = pose([0, 0, 0], [0, 0.1, 0]) @ pose([0, 0.5, 0], [0, 0, 0])
    assert np.abs(sample.poses["upper"] - base @ shoulder).max() <= 1e-14
    assert sample.constraint_residual <= 1e-14


def test_a_loop_closes_about_a_joint_that_is_set():
    """The crank's angle and rate are kept; coupler and rocker follow, and refusals give the nearest."""
    engine = Engine(load_scene("four_bar"), "rkmk4", 1e-3, quiet=True)
    engine.advance(10)
    (joint, (angle, _)), *others = engine.sample().joint_coordinates.items()
    engine.place(joints={joint: (angle + 0.3, 2.5)})
    sample = engine.sample()
    assert sample.joint_coordinates[joint] == pytest.approx((angle + 0.3, 2.5), abs=1e-12)
    assert sample.constraint_residual <= 1e-12
    assert np.abs(rows(engine)[0] @ engine.state()[1].ravel()).max() <= 1e-12
    # All angles and rates, with six digits, are those of this pose.
    rounded = {name: (round(q, 7), round(v, 7)) for name, (q, v) in sample.joint_coordinates.items()}
    engine.place(joints=rounded)
    assert engine.sample().constraint_residual <= 1e-12
    before = engine.state()
    other = others[-1][0]
    wrong = rounded | {other: (rounded[other][0] + 0.1, 0.0)}
    with pytest.raises(SceneError, match=r"no pose near the start .* the nearest ones: "):
        engine.place(joints=wrong)
    with pytest.raises(SceneError, match=r"contradict each other"):
        engine.place(joints={joint: (None, 1.0), other: (None, -9.0)})
    for values in ({"nothing": (1.0, None)}, {joint: (np.nan, None)}, {joint: (None, np.inf)}):
        with pytest.raises(ValueError, match="is not a joint|both finite or None"):
            engine.place(joints=values)
    assert all(np.array_equal(a, b) for a, b in zip(before, engine.state()))


def test_a_driven_joint_keeps_the_turns_that_it_is_given():
    simulation = Simulation(load_scene("driven_arm"))
    for turns in (7.0, -30.0, 0.5):
        simulation.place(joints={"elbow": (turns, None)})
        assert simulation.sample().prescribed["elbow"][0] == pytest.approx(turns, abs=1e-12)
    simulation.place(joints={"elbow": (7.0, 0.0), "shoulder": (None, 0.0)})
    simulation.place(joints={"shoulder": (0.2, None)})
    for rates in ((2.0, 1.0), (0.0, 0.0)):  # in any order
        given = {"elbow": (7.0, rates[0]), "shoulder": (None, rates[1])}
        simulation.place(joints=given)
        found = simulation.sample().prescribed
        assert (found["elbow"][1], found["shoulder"][1]) == pytest.approx(rates, abs=1e-12)
    simulation.advance(10)
    assert simulation.sample().prescribed["elbow"][:2] == pytest.approx((7.0, 0.0), abs=1e-12)


CARRIED = text_of("carried.yaml")


def test_driven_joints_keep_their_rates_unless_a_twist_that_is_given_prevents_it():
    """Their motions go on, too. Only the elbow gives way if the bodies on both sides are set."""
    engine = Engine(scene_from_text(CARRIED), "rkmk4", 1e-3, quiet=True)
    engine.advance(300)
    engine.place(twists={"upper": [0, 0.1, 0, 0, 0, -0.04]})
    assert not engine.commanded_motions
    before = engine.sample()
    assert before.joint_coordinates["shoulder"][1] == pytest.approx(0.1, abs=1e-9)
    for joint in ("elbow", "wrist"):
        rate = before.prescribed[joint][1]
        assert before.joint_coordinates[joint][1] == pytest.approx(rate, abs=1e-9) and rate > 0.1
    engine.place(twists={"upper": np.zeros(6), "lower": np.zeros(6)})
    assert engine.commanded_motions == ("elbow",)
    after = engine.sample()
    assert after.prescribed["elbow"][1] == pytest.approx(0.0, abs=1e-12)
    assert after.joint_coordinates["wrist"][1] == pytest.approx(2.0, abs=1e-9)
    engine.place(joints={"shoulder": (0.3, 0.0)})
    assert engine.sample().prescribed["wrist"][1] == pytest.approx(2.0, abs=1e-12)


GEARS = text_of("gears_place.yaml")


def test_gears_keep_their_turns_and_follow_in_both_directions():
    engine = Engine(scene_from_text(GEARS), "rkmk4", 1e-3, quiet=True)
    engine.advance(600)
    before = engine.sample()
    assert before.joint_coordinates["ja"][0] == pytest.approx(12.0, abs=1e-9)
    engine.place({}, {"a": np.zeros(6)})  # after two turns: the poses stay
    assert np.abs(engine.sample().pose - before.pose).max() <= 1e-12
    assert not engine.sample().twist.any()
    engine.place(joints={"ja": (30.0, 1.0)})
    found = engine.sample().joint_coordinates
    assert found["ja"] == pytest.approx((30.0, 1.0), abs=1e-12)
    assert found["jb"] == pytest.approx((-21.0, -0.7), abs=1e-12)
    engine.place(joints={"jb": (1.4, None)})
    found = engine.sample().joint_coordinates
    assert found["ja"] == pytest.approx((-2.0, 1.0), abs=1e-12)
    engine.advance(1)
    with pytest.raises(SceneError, match="no pose near the start"):
        engine.place(joints={"ja": (0.0, 0.0), "jb": (0.5, 0.0)})


@pytest.mark.parametrize("angle", [0.9, 1.0, -1.0])
def test_a_position_that_is_far_away_is_reached_in_steps(angle):
    """All parallelograms of the linkage have equal angles; in one step another branch is met."""
    engine = Engine(load_scene("n_four_bar"), "rkmk4", 1e-3, quiet=True)
    engine.place(joints={"ground0": (angle, 2.0)})
    sample = engine.sample()
    for number in range(3):
        found = sample.joint_coordinates[f"ground{number}"]
        assert found == pytest.approx((angle, 2.0), abs=1e-12)
    assert sample.constraint_residual <= 1e-14
    assert np.abs(rows(engine)[0] @ engine.state()[1].ravel()).max() <= 1e-12


def test_a_position_that_no_step_reaches_is_refused_and_nothing_changes():
    """The first hinge of this loop turns back by at most 0.503 rad."""
    engine = Engine(load_scene("bricard"), "rkmk4", 1e-3, quiet=True)
    engine.place(joints={"hinge1": (-0.5, None)})
    before = engine.state()
    with pytest.raises(SceneError, match=r'"hinge1": no pose near the start .* coordinate -1;'):
        engine.place(joints={"hinge1": (-1.0, None)})
    assert all(np.array_equal(old, new) for old, new in zip(before, engine.state()))


ROTOR = text_of("rotor_place.yaml")
SPRING = "forces: [{name: s, type: torsional_spring_damper, joint: axle, stiffness: 0}]\n"
# The gear pair has two rotors of the same inertia: that of the other one at twice the speed counts fourfold.
GEARED = (
    ROTOR.replace(
        "joints:",
        "  - {name: motor, mass: 1, inertia: [1, 1, 1], position: [0, 1, 0], angular_velocity: [0, 0, -40]}\n"
        "joints:\n"
        "  - {name: shaft, type: revolute, parent: world, child: motor,\n"
        "     parent_frame: {position: [0, 1, 0]}, child_frame: {}}",
    )
    + "couplings: [{name: gears, joint: axle, other: shaft, ratio: -0.5}]\n"
)


def rotor_at(engine):
    """Coordinate of the stop and rate of the rotor."""
    sample = engine.sample()
    return sample.switching[0, 3], sample.twists["rotor"][2]


def after(seconds, q=40.0):
    """Coordinate and rate of the rotor at 20 rad/s, from q on: it rebounds at 50.3 rad with half its rate."""
    hit = (50.3 - q) / 20.0
    return (50.3 - 10.0 * (seconds - hit), -10.0) if seconds > hit else (q + 20.0 * seconds, 20.0)


@pytest.mark.parametrize("text", [ROTOR, ROTOR + SPRING, GEARED], ids=["alone", "spring", "gears"])
@pytest.mark.parametrize("options", [{"method": "rkmk4"}, {"accuracy": 1e-6}], ids=str)
def test_a_joint_with_stops_some_turns_apart_is_placed_in_its_turn(text, options):
    """Closed form. Rounding of 100 steps of 0.2 rad at 50 rad, each below 2 eps * 50: below 3e-12; the event is
    found to 1e-13 rad.
    """
    engine = Simulation(scene_from_text(text), step=0.01, **options)
    given = {"axle": (40.0, 20.0)} if text is not GEARED else {"shaft": (-80.0, -40.0)}
    engine.place(joints=given)
    assert rotor_at(engine) == pytest.approx((40.0, 20.0), abs=1e-13)
    snapshot = engine.snapshot()
    for _ in range(2):
        engine.advance(100)
        assert rotor_at(engine) == pytest.approx(after(1.0), abs=3e-12)
        for driven in (engine, engine._running.companion):
            assert driven.state()[1][0, 2] == pytest.approx(-10.0, abs=3e-12)
        engine.restore(snapshot)
    with pytest.raises(SceneError, match="axle would be beyond its stop: its position 60 rad"):
        engine.place(joints={"axle": (60.0, 0.0)})


@pytest.mark.parametrize("text", [ROTOR, ROTOR + SPRING, GEARED], ids=["alone", "spring", "gears"])
def test_joints_that_are_not_given_stay_in_their_turns(text):
    """Closed form, as above: after a turn and more, another body is placed, then the rotor is turned a little."""
    engine = Simulation(scene_from_text(text), step=0.01, quiet=True)
    engine.advance(100)
    engine.place({}, {"stone": [0, 0, 0, 1.0, 0, 0]})
    assert rotor_at(engine) == pytest.approx((20.0, 20.0), abs=3e-12)
    engine.advance(40)
    assert rotor_at(engine) == pytest.approx(after(1.4, 0.0), abs=3e-12)
    engine.place({"rotor": pose([0, 0, 28.5], [0, 0, 0])})
    assert rotor_at(engine) == pytest.approx((28.5, 20.0), abs=1e-12)
    engine.advance(200)
    assert rotor_at(engine) == pytest.approx(after(2.0, 28.5), abs=3e-12)


def test_limits_of_commands_hold_for_states_that_are_set():
    """As for joint commands: given positions and velocities, and joints that poses would move beyond their limits."""
    text = text_of("lamp_place.yaml")
    engine = Engine(scene_from_text(text.replace("data", "coordinate: 5.0, data") + "assemble: true\n"), "rkmk4", 1e-3)
    turned = np.eye(4)
    turned[:2, :2] = [[np.cos(2.0), -np.sin(2.0)], [np.sin(2.0), np.cos(2.0)]]
    before = engine.state()
    for given, words in (
        ({"joints": {"hinge": (6.5, None)}}, "position 6.5 rad of joint 'hinge' is beyond its limits, 4 to 6 rad"),
        ({"joints": {"hinge": (None, 3.0)}}, "velocity 3 rad/s of joint 'hinge' is beyond its limit of 2 rad/s"),
        ({"poses": {"arm": turned}}, "is beyond its limits"),
    ):
        with pytest.raises(ValueError, match=words):
            engine.place(**given)
        assert all(map(np.array_equal, engine.state(), before))
    engine.place(joints={"hinge": (5.5, 1.5)})
    turned[:2, :2] = [[np.cos(4.5), -np.sin(4.5)], [np.sin(4.5), np.cos(4.5)]]
    engine.place(poses={"arm": turned})
    # A joint that is beyond its limits already may be left there.
    outside = Engine(scene_from_text(text), "rkmk4", 1e-3)
    outside.place(twists={"arm": [0, 0, 1, 0, 0, 0]})


RACK = text_of("rack_place.yaml")


def test_a_coupling_with_play_keeps_its_turns():
    """After many turns the play is that of the unwrapped angle: 0.01 m on both sides of 0.1 m/rad."""
    engine = Engine(scene_from_text(RACK), "rkmk4", 1e-3)
    engine.apply_effort("turn", 20.0)
    engine.advance(2000)
    angle = engine.sample().joint_coordinates["turn"][0]
    assert angle > 50.0
    for off in (0.009, -0.009):
        engine.place(joints={"turn": (angle, 0.0), "slide": (0.1 * angle + off, 0.0)})
        found = engine.sample().joint_coordinates
        assert found["turn"][0] == pytest.approx(angle, abs=1e-12)
        assert found["slide"][0] == pytest.approx(0.1 * angle + off, abs=1e-12)
    with pytest.raises(SceneError, match="coupling rack would be beyond its stop: its position 0.011 m"):
        engine.place(joints={"turn": (angle, 0.0), "slide": (0.1 * angle + 0.011, 0.0)})
