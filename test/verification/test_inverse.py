# SPDX-License-Identifier: Apache-2.0
"""Inverse dynamics against runs: efforts that were found return the motion, and are those of driven joints."""

import numpy as np
import pytest
from scene_files import text_of

from liegroup_core import Simulation, SimulationError, load_scene
from liegroup_core.linear import inverse_dynamics
from liegroup_core.scene.load import scene_from_text

SCENES = {"double_pendulum": ["shoulder", "elbow"], "four_bar": ["ground_crank"]}


def simulation_of(scene, step=1e-3):
    return Simulation(scene, "rkmk8", step, estimate=False, quiet=True)


def of_joints(sample, joints):
    """(2, m) positions and velocities."""
    return np.array([sample.joint_coordinates[joint] for joint in joints]).T


@pytest.mark.parametrize("name, duration", [("double_pendulum", 0.25), ("four_bar", 0.08)])
@pytest.mark.turn(3)
def test_a_run_with_the_efforts_that_were_found_returns_the_motion(name, duration):
    """Sines in the joints. Efforts are constant in each step, with the values of its middle.

    Such runs are symmetric in time: their error has even powers of the step, and extrapolation removes three of them.
    """
    scene, joints = load_scene(name), SCENES[name]
    start = simulation_of(scene)
    q, v = of_joints(start.sample(), joints)
    w, size = np.arange(3.0, 3.0 + len(joints)), 0.3

    def motion(t):
        position, rate = q + (v - size * w) * t + size * np.sin(w * t), v + size * w * (np.cos(w * t) - 1.0)
        return position, rate, -size * w**2 * np.sin(w * t)

    errors = []
    for steps in (40, 80, 160, 320):
        step = duration / steps
        middles = (np.arange(steps) + 0.5) * step
        found = inverse_dynamics(start, middles, *zip(*map(motion, middles)), joints)
        run = simulation_of(scene, step)
        for efforts in found.efforts:
            for joint, effort in zip(joints, efforts):
                run.apply_effort(joint, float(effort))
            run.advance(1)
        error = of_joints(run.sample(), joints) - motion(duration)[:2]
        error[0] -= 2.0 * np.pi * np.round(error[0] / (2.0 * np.pi))
        errors.append(error)
    assert np.abs(errors[-1]).max() > 1e-8  # without extrapolation
    for power in (4.0, 16.0, 64.0):
        errors = [(power * fine - coarse) / (power - 1.0) for coarse, fine in zip(errors, errors[1:])]
    assert np.abs(errors[0]).max() < 1e-9


@pytest.mark.parametrize("name", SCENES)
def test_efforts_are_those_of_driven_joints(name):
    """The multipliers of the prescribed motion along a run; both are solutions of the same equations."""
    scene, joints = load_scene(name), SCENES[name]
    start = simulation_of(scene)
    q, v = of_joints(start.sample(), joints)
    points = {joint: [q[k], q[k] + 0.1 * v[k] + 0.2, q[k] - 0.1] for k, joint in enumerate(joints)}
    driven = [
        joint.remade(driven=True, motion={"times": [0.0, 0.1, 0.3], "positions": points[joint.name]})
        if joint.name in joints
        else joint
        for joint in scene.joints
    ]
    run, times, motion, efforts = simulation_of(scene.remade(joints=driven)), [], [], []
    for _ in range(15):
        run.advance(20)
        sample = run.sample()
        times.append(sample.time)
        motion.append([sample.prescribed[joint] for joint in joints])
        efforts.append([sample.drive_efforts[joint] for joint in joints])
    found = inverse_dynamics(start, times, *np.array(motion).transpose(2, 0, 1), joints)
    assert np.abs(found.efforts - efforts).max() < 1e-12 * np.abs(efforts).max()
    assert found.residual.max() < 1e-11


PENDULUM = text_of("pendulum_inverse.yaml")


def test_a_motion_leaves_a_stop():
    """From a stop that holds the rod at the start."""
    text = PENDULUM.replace("{FRICTION}", "{viscous: 0.1}").replace("lower: -1.0", "lower: 0.0")
    start = simulation_of(scene_from_text(text, source="test"))
    found = inverse_dynamics(start, [0.0], [[0.2]], [[0.3]], [[2.0]], ["pin"])
    assert found.efforts[0, 0] == pytest.approx(0.27 * 2.0 + 0.1 * 0.3 + 9.81 * 0.5 * np.sin(0.2), rel=1e-12)


@pytest.mark.parametrize("mu", [0.0, 0.3])
def test_friction_opposes_the_motion(mu):
    """From a state at rest, in both directions: m g l sin(q) + I a + friction; by load with the force on the pin."""
    friction = f"coulomb: 0.7, viscous: 0.1, mu: {mu}, radius: 0.05"
    start = simulation_of(scene_from_text(PENDULUM.replace("FRICTION", friction), source="test"))
    times, motion = [0.0, 1.0, 2.0], np.array([[0.3, 0.5, 0.2], [0.3, -0.5, 0.2], [-0.2, 0.0, 3.0]])
    found = inverse_dynamics(start, times, *motion.T[..., None], ["pin"])
    q, v, a = motion.T
    along, across = 0.5 * v**2 + 9.81 * np.cos(q), 0.5 * a + 9.81 * np.sin(q)
    expected = 0.27 * a + 9.81 * 0.5 * np.sin(q) + 0.1 * v
    expected += np.sign(v) * (0.7 + mu * 0.05 * np.hypot(along, across))
    assert found.efforts[:, 0] == pytest.approx(expected, rel=1e-12)
    assert found.residual.max() < 1e-11
    with pytest.raises(SimulationError, match="the motion is beyond a stop at 0 s: pin would be at 1.2 rad"):
        inverse_dynamics(start, [0.0], [[1.2]], [[0.0]], [[0.0]], ["pin"])
