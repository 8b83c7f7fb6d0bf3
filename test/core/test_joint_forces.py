# SPDX-License-Identifier: Apache-2.0
"""Shares of springs, motors, servos and commands in what a joint transmits."""

import math

import numpy as np
import pytest
from scene_files import text_of

from liegroup_core import Simulation
from liegroup_core.scene import scene_from_text

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
