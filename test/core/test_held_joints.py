# SPDX-License-Identifier: Apache-2.0
"""Servos that hold joints of a robot at their start: statics, which joints, and refusals in one line."""

import math

import pytest
import scipy
from robot_texts import written
from scene_files import cases, text_of

from liegroup_core import SceneError, Simulation
from liegroup_core.robots.held_joints import Servos
from liegroup_core.robots.options import Options
from liegroup_core.scene.load import scene_from_robot

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
