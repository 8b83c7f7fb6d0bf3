# SPDX-License-Identifier: Apache-2.0
"""Servos that hold joints of a robot at their start: statics, which joints, and refusals in one line."""

import math

import pytest
import scipy
from robot_texts import written

from liegroup_core import SceneError, Simulation
from liegroup_core.robots.held_joints import Servos
from liegroup_core.robots.options import Options
from liegroup_core.scene.load import scene_from_robot

# A hinge about y, whose bar has its centre 0.3 m below it, a slide, and a finger that follows the hinge.
URDF = """<robot name="arm"><link name="base"/>
<link name="bar"><inertial><origin xyz="0 0 -0.3"/><mass value="2"/>
  <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="finger"><inertial><mass value="1e-9"/>
  <inertia ixx="1e-9" iyy="1e-9" izz="1e-9" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="block"><inertial><mass value="3"/>
  <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="hinge" type="continuous"><parent link="base"/><child link="bar"/><axis xyz="0 1 0"/>
  <limit effort="100" velocity="9"/></joint>
<joint name="bend" type="revolute"><parent link="bar"/><child link="finger"/><axis xyz="0 1 0"/><mimic joint="hinge"/>
  <limit effort="0" velocity="9" lower="-9" upper="9"/></joint>
<joint name="lift" type="prismatic"><parent link="base"/><child link="block"/><axis xyz="0 0 1"/>
  <limit effort="0" velocity="9" lower="-1" upper="1"/></joint></robot>"""
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


@pytest.mark.parametrize(
    "keys, said",
    [
        ({"joints": ["hnge"]}, "servos: moving joint with one coordinate 'hnge' is not in the robot; did you mean"),
        ({"stiffness": 0}, "stiffness must be greater than 0"),
        ({"damping": None}, "damping"),
    ],
)
def test_a_wrong_hold_is_refused_in_one_line(tmp_path, keys, said):
    with pytest.raises(SceneError, match=said) as caught:
        scene_from_robot(
            written(tmp_path / "arm.urdf", URDF), Options(servos=Servos(**({"stiffness": 1, "damping": 1} | keys)))
        )
    assert "\n" not in str(caught.value)
