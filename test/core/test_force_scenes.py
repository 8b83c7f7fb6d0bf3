# SPDX-License-Identifier: Apache-2.0
"""Forces in scene files: correct ones are read, wrong ones refused in one line with location."""

import math

import pytest

from liegroup_core.errors import SceneError
from liegroup_core.forces.joint_law import LAW
from liegroup_core.layout import make_layout
from liegroup_core.mechanism.body_model import build_model
from liegroup_core.scene import scene_from_text

HEAD = """\
name: rig
gravity: [0, 0, -9.81]
bodies:
  - {name: a, mass: 1, inertia: [1, 1, 1]}
  - {name: b, mass: 1, inertia: [1, 1, 1]}
joints:
  - {name: ball, type: spherical, parent: world, child: a, child_frame: {}}
  - {name: hinge, type: revolute, parent: a, child: b, child_frame: {}}
forces:
"""
SPRING = "type: torsional_spring_damper, joint: hinge, stiffness: 5, damping: 1, rest_angle: -20"
MOTOR = "type: motor, joint: hinge, torque: -5, rate_limit: 100"
SERVO = "type: servo, joint: hinge, stiffness: 5, damping: 1, position: -20, velocity: 3, effort_limit: 7"
DRAG = "type: drag, body: a, linear: 1, quadratic: 2, angular: 3, angular_quadratic: 4"
PUSH = (
    "type: applied_wrench, body: b, force: [1, 2, 3], torque: [4, 5, 6], point: [7, 8, 9], "
    "axes: world, start: 0.25, end: 0.75"
)


def scene_with(force):
    return scene_from_text(HEAD + f"  - {{name: it, {force}}}\n", source="x.yaml")


def test_every_number_of_a_force_reaches_the_model():
    def row(force):
        scene = scene_with(force)
        again = scene_from_text(scene.model_copy(update={}).text)
        assert again.model_dump() == scene.model_dump()
        forces = build_model(scene)[0].forces
        (found,) = (rows[0] for rows in (forces.joint_law, forces.drag) if len(rows))
        return found

    keys = ("slides", "parent", "child", "group", "angle", "target", *LAW)
    for force, (group, angle, target), law in (
        (SPRING, (0, 0, -1), (0, 5, 1, -20, 0, math.inf)),
        (MOTOR, (1, -1, -1), (-5, 0, 0.05, 0, 0, math.inf)),
        (MOTOR.replace(", rate_limit: 100", ""), (1, -1, -1), (-5, 0, 0, 0, 0, math.inf)),
        (SERVO, (2, 0, 0), (0, 5, 1, -20, 3, 7)),
    ):
        assert [row(force)[key] for key in keys] == [0, 0, 1, group, angle, target, *law]
    assert row(DRAG).tolist() == (0, 1, 2, 3, 4)
    ((start, end, push),) = make_layout(scene_with(PUSH)).commands
    assert (push.axes, push.name, start, end) == ("world", "b", 0.25, 0.75)
    assert (push.values, push.point) == ((4.0, 5.0, 6.0, 1.0, 2.0, 3.0), (7.0, 8.0, 9.0))
    ((start, end, push),) = make_layout(scene_with("type: applied_wrench, body: b")).commands
    assert (push.axes, push.point, start, end) == ("body", None, 0.0, math.inf)


@pytest.mark.parametrize(
    "force, message",
    [
        (
            SPRING.replace("hinge", "hing"),
            "joint 'hing' is not a joint; did you mean \"hinge\"? choose one of: ball, hinge",
        ),
        (
            SPRING.replace("hinge", "ball"),
            'joint "ball" is spherical, but torsional_spring_damper requires a joint that is revolute or ',
        ),
        (MOTOR.replace("hinge", "ball"), 'joint "ball" is spherical, but motor requires a joint that is '),
        (
            "type: linear_motor, joint: hinge, force: 1",
            'joint "hinge" is revolute, but linear_motor requires a joint that is prismatic or ',
        ),
        (
            "type: linear_spring_damper, joint: hinge, stiffness: 1",
            'joint "hinge" is revolute, but linear_spring_damper requires a joint that is prismatic or ',
        ),
        (SPRING.replace("joint: hinge, ", ""), "joint is missing: give the name of a joint that "),
        (SPRING.replace("joint: hinge", "joint: 3"), "joint must be text, got 3"),
        (SPRING.replace("stiffness: 5", "stiffness: -5"), "stiffness must not be negative, got -5"),
        (SPRING.replace("-20", ".inf"), "rest_angle must be finite, got inf"),
        (SPRING.replace("rest_angle", "rest_angel"), "unknown key 'rest_angel'; did you mean \"rest_angle\"?"),
        (MOTOR.replace("100", "0"), "rate_limit must be greater than 0, got 0"),
        (MOTOR.replace("torque: -5, ", ""), "torque is missing: give the stall torque on the child"),
        (DRAG.replace("body: a", "body: c"), "body 'c' is not a body; choose one of: a, b"),
        (DRAG.replace("body: a", "body: world"), "body 'world' is not a body; choose one of: a, b"),
        (DRAG.replace("quadratic: 2", "quadratic: -2"), "quadratic must not be negative, got -2"),
        (PUSH.replace("0.75", "0.25"), "end 0.25 must be later than start 0.25: give a later end"),
        (PUSH.replace("start: 0.25", "start: -1"), "start must not be negative, got -1"),
        (PUSH.replace("axes: world", "axes: hinge"), "axes must be 'body' or 'world', got 'hinge'"),
        (PUSH.replace("[1, 2, 3]", "[1, 2]"), "force must have 3 numbers [x, y, z], got [1, 2]"),
    ],
)
def test_a_wrong_force_is_refused_in_one_line(force, message):
    with pytest.raises(SceneError) as caught:
        scene_with(force)
    text = str(caught.value)
    assert len(text.splitlines()) == 1
    head, _, rest = text.partition('forces[0] "it": ')
    assert head == "x.yaml:10: " and rest.startswith(message), text


def test_a_joint_force_in_a_scene_without_joints_is_refused():
    text = HEAD[: HEAD.index("joints:")] + f"forces:\n  - {{name: it, {MOTOR}}}\n"
    with pytest.raises(SceneError, match="joint 'hinge' is not a joint; the scene has no joints"):
        scene_from_text(text)
