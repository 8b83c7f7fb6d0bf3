# SPDX-License-Identifier: Apache-2.0
"""Servos: closed forms with commands and limits, turns, exact repetition, those that hold a robot, and refusals."""

import json
import math

import numpy as np
import pytest
import scipy
from given import reference_inputs
from robot_texts import written
from scene_files import cases, text_of
from scipy.linalg import expm

from liegroup_core import SceneError, Simulation, load_scene
from liegroup_core.forces.commands import Command
from liegroup_core.reference import integrate
from liegroup_core.robots.held_joints import Servos
from liegroup_core.robots.options import Options
from liegroup_core.scene.load import scene_from_robot, scene_from_text

INERTIA, MASS = 0.5, 2.0
SERVO = "{name: drive, type: servo, joint: hinge, stiffness: 40, damping: 3"
LINEAR = "{name: pull, type: linear_servo, joint: slide, stiffness: 90, damping: 8"
# A hinge and a slide, each alone on the ground, without gravity.
BENCH = text_of("bench_servos.yaml")
# Two links on a tilted base under gravity, one that slides.
ARM = text_of("arm_servos.yaml")
GROUPS = cases("servos_groups")


def scene(text, *forces):
    return scene_from_text(text + "".join(f"  - {force}\n" for force in forces))


def both(more="", linear=""):
    return f"{SERVO}{more}}}", f"{LINEAR}{linear}}}"


def law(mass, stiffness, damping):
    """Function (state, position, velocity, t) -> state: the linear servo on a mass, exactly."""

    def after(state, position, velocity, t):
        matrix = np.zeros((3, 3))
        matrix[0, 1] = 1.0
        matrix[1] = (-stiffness / mass, -damping / mass, (stiffness * position + damping * velocity) / mass)
        return (expm(matrix * t) @ [*state, 1.0])[:2]

    return after


@pytest.mark.parametrize("method, group", GROUPS)
def test_servos_are_damped_oscillators_about_targets(method, group):
    """Commands from 20.3 ms to 70.7 ms, inside steps, then the values of the scene again."""
    apart = []
    for step in (1e-3, 5e-4):
        made = scene(BENCH, *both(", position: 0.4", ", velocity: 0.3"))
        simulation = Simulation(made, method, step, group, estimate=False)
        for joint, target in (("hinge", (-0.7, 2.0)), ("slide", (0.5, 0.0))):
            simulation.command_servo(joint, *target, start=0.0203, duration=0.0504)
        simulation.advance(round(0.2 / step))
        found = simulation.sample().joint_coordinates
        for joint, after, idle, target in (
            ("hinge", law(INERTIA, 40, 3), (0.4, 0.0), (-0.7, 2.0)),
            ("slide", law(MASS, 90, 8), (0.0, 0.3), (0.5, 0.0)),
        ):
            state = after((0.0, 0.0), *idle, 0.0203)
            state = after(after(state, *target, 0.0504), *idle, 0.2 - 0.0707)
            apart.append(np.abs(np.subtract(found[joint], state)).max())
    if method == "rkmk8":
        assert max(apart) < 1e-12
    else:  # order 2
        assert all(3.0 < large / small < 5.0 for large, small in zip(apart, apart[2:]))
        assert max(apart) < 1e-3


@pytest.mark.parametrize("group", ["relative", "se3"])
def test_a_servo_at_its_limit_has_a_constant_effort(group):
    """Far from the target: tau / I = 4 rad/s^2, f / m = -1.5 m/s^2, and it says so."""
    made = scene(BENCH, *both(", position: 9, effort_limit: 2", ", position: -9, effort_limit: 3"))
    simulation = Simulation(made, "rkmk4", 1e-3, group, estimate=False)
    simulation.advance(100)
    sample = simulation.sample()
    assert sample.saturated == ("hinge", "slide")
    assert sample.servo_efforts == {"hinge": 2.0, "slide": -3.0}
    for joint, acceleration in (("hinge", 4.0), ("slide", -1.5)):
        expected = 0.005 * acceleration, 0.1 * acceleration
        assert sample.joint_coordinates[joint] == pytest.approx(expected, abs=1e-13)
    work = 2.0 * 0.02 + 3.0 * 0.0075
    assert sample.energy == pytest.approx(work, rel=1e-12)
    assert sample.power == pytest.approx(2.0 * 0.4 + 3.0 * 0.15, rel=1e-12)
    simulation.command_servo("hinge", 0.02)
    simulation.advance(1)
    assert simulation.sample().saturated == ("slide",)


def test_a_servo_counts_turns():
    """Twenty radians, with a shaft that starts in (-pi, pi]; damped critically, to round-off."""
    made = scene(BENCH, SERVO.replace("damping: 3", "damping: 8.95") + "}")
    simulation = Simulation(made, "rkmk4", 1e-3, estimate=False)
    simulation.command_servo("hinge", 20.0)
    simulation.advance(4000)
    angle, rate = simulation.sample().joint_coordinates["hinge"]
    assert angle == pytest.approx(20.0, abs=1e-9) and abs(rate) < 1e-9
    assert simulation.sample().angles == pytest.approx([20.0], abs=1e-9)


def test_a_servo_without_commands_is_a_spring():
    spring = "{name: s, type: torsional_spring_damper, joint: hinge, stiffness: 40, damping: 3, rest_angle: 5}"
    runs = [
        Simulation(scene(ARM, force), "rkmk4", 1e-3, estimate=False) for force in (spring, f"{SERVO}, position: 5}}")
    ]
    for run in runs:
        run.advance(1000)
    assert np.abs(runs[0].state()[0] - runs[1].state()[0]).max() < 1e-12


@pytest.mark.parametrize("group", ["relative", "se3", "so3xr3"])
def test_servos_follow_the_independent_reference(group):
    """With limits that are reached, commands, an effort and a wrench, on an arm under gravity.

    The kinks of the limits leave an error of the step: 1e-7 at 0.5 ms.
    """
    made = scene(ARM, *both(", effort_limit: 9", ", effort_limit: 12"))
    simulation = Simulation(made, "rkmk4", 5e-4, group, stabilisation="projection", estimate=False)
    start = simulation.state()
    simulation.command_servo("hinge", -0.6, 0.2, start=0.1003)
    simulation.command_servo("slide", 0.2, start=0.25, duration=0.2)
    simulation.apply_effort("hinge", -2.0, start=0.3)
    simulation.advance(1200)
    changes = reference_inputs(simulation.layout, simulation.drain_applied())
    assert len(changes) == 4
    found, uncertainty = integrate(made, *start, [0.6], changes)
    sample = simulation.sample()
    assert np.abs(found.position[0] - sample.pose[:, 9:]).max() < 1e-7
    assert uncertainty.position.max() < 1e-8


@pytest.mark.parametrize("method", ["rkmk4", "rkmk54", "generalized_alpha", "constrained_rattle", None])
@pytest.mark.parametrize("at_once", [1, 13])
def test_the_recorded_changes_repeat_a_run_bit_by_bit(method, at_once):
    """Servos, efforts and wrenches inside steps, that replace each other, that cancel, and that end unnoticed."""
    made = scene(ARM, *both(", effort_limit: 9"))
    options = {"method": method, "step": 1e-3} if method else {"accuracy": 1e-5, "step": 1e-3}
    first, second = (Simulation(scene_from_text(made.text), **options) for _ in range(2))
    push, effort = first.apply_wrench, first.apply_effort
    first.command_servo("hinge", -0.6, 0.2, start=0.0501234)
    first.command_servo("hinge", 0.3, start=0.12)
    first.command_servo("slide", 0.2, start=0.07, duration=0.09)
    effort("slide", 3.0, start=0.0304, duration=0.1)
    effort("hinge", 0.7, duration=0.0901, source="other")
    effort("slide", 0.9, start=0.09)
    effort("slide", 0.0, start=0.1402)
    push("hand", (0, 0, 0, 0, 2.0, 0), start=0.1, duration=0.07)
    push("upper", (0.3, 0, 0, 0, 5.0, 0), start=0.0501234, duration=0.1, axes="world")
    push("upper", (0, 0, 0.1, 0.9, 0, 0), duration=0.0901, source="other")
    push("upper", (0, 0, 0.1, 0.9, 0, 0), start=0.0304, duration=0.2, source="other")
    push("hand", (0.2, 0, 0, 0, 0, 0), start=0.1803, source="one")
    push("hand", (-0.2, 0, 0, 0, 0, 0), start=0.1803, source="two")
    push("hand", (0, 0.2, 0, 0, 0, 0), start=0.1803, duration=1e-5, source="short")
    push("hand", (0, 0, 0, 0.7, 0, 0.3), 0.12, 0.1002, "end", "world", (0.1, -0.02, 0.3))
    first.advance(260)
    changes = first.drain_applied()
    assert [change.kind for change in changes].count("target") == 4
    starts = [change.start_ns for change in changes if change.name == "upper"]
    assert starts == [50_123_400, 0, 30_400_000]
    assert [change.point for change in changes if change.point] == [(0.1, -0.02, 0.3)]
    for change in changes:
        Command.from_json(json.loads(json.dumps(change.as_json()))).repeat(second)
    for _ in range(260 // at_once):
        second.advance(at_once)
    for mine, theirs in zip(first.state(), second.state()):
        assert mine.tobytes() == theirs.tobytes()
    if method is None:
        assert first.sample().errors.tobytes() == second.sample().errors.tobytes()


def test_the_estimate_of_the_error_follows_commands():
    """Also of commands from before the companion starts: within a factor of 10 of the true error."""
    made = scene(ARM, *both())
    simulation = Simulation(made, "rkmk4", 0.01)
    reference = Simulation(made, "rkmk853", 1e-3, estimate=False, rtol=1e-13, atol=1e-13)
    for each in (simulation, reference):
        each.command_servo("slide", 0.2)
        each.command_servo("hinge", -1.0, 0.2, start=0.1003)
        each.apply_effort("slide", -5.0, start=0.15, duration=0.2)
        each.advance(round(0.4 / each.step))
    sample, true = simulation.sample(), reference.sample()
    error = np.linalg.norm(sample.pose[:, 9:] - true.pose[:, 9:], axis=1).max()
    assert error > 1e-9 and 0.1 < sample.errors[:, 0].max() / error < 10.0


@pytest.mark.parametrize("group", ["relative", "se3", "so3xr3"])
def test_a_servo_holds_the_crank_of_a_loop(group):
    """Three turns of a four-bar linkage at rest there; the coordinate counts them."""
    text = load_scene("four_bar").text.replace("rate: 31.41592653589793", "rate: 0.0")
    servo = "{name: drive, type: servo, joint: ground_crank, stiffness: 300, damping: 40}"
    made = scene(text + "\nforces:\n", servo)
    simulation = Simulation(made, "rkmk54", 1e-2, group, "projection", rtol=1e-7, atol=1e-7, estimate=False)
    simulation.command_servo("ground_crank", 6.0 * np.pi)
    simulation.advance(500)
    angle, rate = simulation.sample().joint_coordinates["ground_crank"]
    assert angle == pytest.approx(6.0 * np.pi, abs=1e-4) and abs(rate) < 1e-3


def test_wrong_servos_and_commands_are_refused():
    simulation = Simulation(scene(BENCH, f"{SERVO}}}"), "rkmk4", estimate=False)
    for arguments, text in (
        (("slide", 1.0), "joint 'slide' has no servo; choose one of: hinge"),
        (("hinge", np.nan), "target position must be a finite number, got nan"),
        (("hinge", 1.0, np.inf), "target velocity must be a finite number, got inf"),
        (("hinge", "1"), "target position must be a finite number, got '1'"),
        (("hinge", 1.0, 0.0, None, -1.0), "duration must be positive"),
    ):
        with pytest.raises(ValueError, match=text):
            simulation.command_servo(*arguments)
    simulation.advance(1)
    assert simulation.drain_applied() == [] and simulation.input_count == 0
    for force, text in (
        (f"{SERVO}}}\n  - {SERVO.replace('drive', 'other')}}}", 'already has the servo "drive"'),
        (f"{SERVO}, effort_limit: 0}}", "effort_limit must be greater than 0"),
        (SERVO.replace("hinge", "slide") + "}", "requires a joint that is"),
        (LINEAR.replace("slide", "hinge") + "}", "requires a joint that is"),
    ):
        with pytest.raises(SceneError, match=text):
            scene(BENCH, force)


def test_a_reset_ends_commands():
    simulation = Simulation(scene(BENCH, f"{SERVO}}}"), "rkmk4", estimate=False)
    simulation.command_servo("hinge", 1.0)
    simulation.advance(10)
    assert simulation.sample().joint_coordinates["hinge"][1] > 0.0
    simulation.reset()
    simulation.advance(10)
    assert simulation.sample().joint_coordinates["hinge"] == (0.0, 0.0)


# A hinge about y, whose bar has its centre 0.3 m below it, a slide, and a finger that follows the hinge.
URDF = text_of("arm_held_joints.urdf")
STIFFNESS, DAMPING = 40.0, 8.0


def held(tmp_path, start=1.2, forces=(), **keys):
    path = written(tmp_path / "arm.urdf", URDF)
    servos = Servos(stiffness=STIFFNESS, damping=DAMPING, **keys)
    return scene_from_robot(path, Options(start={"hinge": start}, servos=servos, forces=list(forces)))


@pytest.mark.parametrize("turns", [0, 1])
def test_a_joint_comes_to_rest_where_its_servo_carries_the_weight(tmp_path, turns):
    """Round-off after 20 s, in which the slowest motion decays by e^-40; a start beyond a turn is the same start."""
    start = 1.2 + 2.0 * math.pi * turns
    scene = held(tmp_path, start, joints=["hinge", "lift"])
    assert [(f.type, f.joint, f.effort_limit) for f in scene.forces] == [
        ("servo", "hinge", 100.0),
        ("linear_servo", "lift", None),
    ]
    simulation = Simulation(scene, accuracy=1e-9, quiet=True)
    simulation.advance_to(20.0)
    at = simulation.sample().joint_coordinates
    rest = scipy.optimize.brentq(lambda q: STIFFNESS * (1.2 - q) - 2.0 * 9.81 * 0.3 * math.sin(q), 0.0, 1.2)
    assert at["hinge"][0] == pytest.approx(rest, abs=1e-8)
    assert at["lift"][0] == pytest.approx(-3.0 * 9.81 / STIFFNESS, abs=1e-8)


def test_joints_that_turn_and_that_nothing_else_leads_are_held(tmp_path):
    assert [force.joint for force in held(tmp_path).forces] == ["hinge"]
    own = {"name": "own", "type": "servo", "joint": "hinge", "stiffness": 5, "damping": 1}
    scene = scene_from_robot(written(tmp_path / "arm.urdf", URDF), Options())
    servo = scene.remade(forces=[own]).forces[0]
    with pytest.raises(
        SceneError, match="servos: no joint that turns is free of other servos and couplings: name joints"
    ):
        held(tmp_path, forces=[servo])


@pytest.mark.parametrize("keys, said", cases("a_wrong_hold_is_refused_in_one_line"))
def test_a_wrong_hold_is_refused_in_one_line(tmp_path, keys, said):
    with pytest.raises(SceneError, match=said) as caught:
        scene_from_robot(
            written(tmp_path / "arm.urdf", URDF), Options(servos=Servos(**({"stiffness": 1, "damping": 1} | keys)))
        )
    assert "\n" not in str(caught.value)
