# SPDX-License-Identifier: Apache-2.0
"""Forces in scene files: correct ones are read, wrong ones refused in one line with location."""

import math

import pytest
from scene_files import text_of

from liegroup_core.errors import SceneError
from liegroup_core.forces.joint_law import LAW
from liegroup_core.layout import make_layout
from liegroup_core.mechanism.body_model import build_model
from liegroup_core.scene import scene_from_text

HEAD = text_of("rig_force_scenes.yaml")
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


def test_a_joint_force_in_a_scene_without_joints_is_refused():
    text = HEAD[: HEAD.index("joints:")] + f"forces:\n  - {{name: it, {MOTOR}}}\n"
    with pytest.raises(SceneError, match="joint 'hinge' is not a joint; the scene has no joints"):
        scene_from_text(text)
