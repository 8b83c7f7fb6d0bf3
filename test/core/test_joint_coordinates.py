# SPDX-License-Identifier: Apache-2.0
"""Joint positions and velocities against closed forms and differences in time."""

import math

import pytest
from scene_files import text_of

from liegroup_core import Simulation, load_scene
from liegroup_core.scene.load import scene_from_text

# Two flywheels on one tilted axis, the angle of one unwrapped by a spring without stiffness, and a
# slider along another axis. Without gravity all rates are constant.
SCENE = text_of("wheels_joint_coordinates.yaml")


def test_steady_motion_has_the_closed_form():
    simulation = Simulation(scene_from_text(SCENE, "wheels"), method="rkmk4", step=1e-2)
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
