# SPDX-License-Identifier: Apache-2.0
"""Planar four-bar of the chapter's Figs. 6.4 and 6.5 against the quadrature of its energy.

It has one freedom and no force, so its crank speed is a function of its angle alone, and the angle
after one second, the period and the speed follow from integrals in many digits. Bounds of errors
are those of an independent implementation of the same method with another form of the joint rows.
"""

import numpy as np
import pytest
from planar_four_bar import PlanarFourBar

from liegroup_core import Simulation
from liegroup_sim_ros.chapter.joint_runs import CRANK_RATE, four_bar, joint_errors

ANGLE_1 = -0.765225378176  # rad, modulo a turn: crank after 1 s
TURNS_1 = 5.628211  # turns it has made by then
ANGLE_ERROR = {5e-3: 2.1e-1, 2e-3: 2.2e-2, 1e-3: 1.7e-3, 1e-4: 1.87e-7}
GROUPS = ("se3", "so3xr3")


def crank_angle(run):
    """(k,) unwrapped crank angle from the x axis, rad."""
    return np.unwrap(np.arctan2(run.poses[:, 0, 1, 0], run.poses[:, 0, 0, 0]))


def angle_error(run):
    return abs((crank_angle(run)[-1] - ANGLE_1 + np.pi) % (2.0 * np.pi) - np.pi)


@pytest.fixture(scope="module")
def runs():
    return {(group, step): joint_errors(four_bar(), step, group, 1.0) for group in GROUPS for step in ANGLE_ERROR}


@pytest.mark.parametrize("group", GROUPS)
@pytest.mark.turn(3)
def test_crank_angle_after_one_second(runs, group):
    for step, elsewhere in ANGLE_ERROR.items():
        assert angle_error(runs[group, step]) <= 1.1 * elsewhere
    assert crank_angle(runs[group, 1e-4])[-1] == pytest.approx(2.0 * np.pi * (0.25 + TURNS_1), abs=2.0 * np.pi * 1e-6)


def test_the_position_of_the_spherical_joint_does_not_matter(runs):
    """As joint 4, as in the caption of Fig. 6.5: the same motion in the plane."""
    other = joint_errors(four_bar(ball="ground_rocker"), 1e-3, "se3", 1.0)
    run = runs["se3", 1e-3]
    assert other.gap[:, [1, 2]] == pytest.approx(run.gap[:, [1, 2]], rel=1e-6, abs=1e-12)
    assert other.gap[:, [0, 3]].max() <= 1e-12
    assert angle_error(other) == pytest.approx(angle_error(run), rel=1e-6)


def test_energy_drifts_at_order_four(runs):
    scene = four_bar()
    for group in GROUPS:
        drift = {}
        for step in ANGLE_ERROR:
            energy = runs[group, step].energy
            # Bars that turn about an end, and the coupler: 1/2 (w I w + v m v) at the start.
            assert energy[0] == pytest.approx(
                sum(
                    0.5
                    * (
                        body.mass * np.dot(body.linear_velocity, body.linear_velocity)
                        + body.inertia[2] * body.angular_velocity[2] ** 2
                    )
                    for body in scene.bodies
                ),
                rel=1e-14,
            )
            drift[step] = np.abs(energy / energy[0] - 1.0).max()
            # What a freedom's speed lacks by it, over 34 rad, is more than the angle's error.
            assert angle_error(runs[group, step]) <= 34.0 * drift[step] / 2.0
        assert np.log10(drift[1e-3] / drift[1e-4]) == pytest.approx(4.0, abs=0.1)


@pytest.mark.turn(3)
def test_an_independent_planar_implementation_agrees_until_drift_dominates():
    """While constraints hold the motion is the same; with drift, the form of the rows matters."""
    planar, simulation = (PlanarFourBar(four_bar()), Simulation(four_bar(), method="rkmk4", step=1e-4))
    assert planar.V[0, 0] == CRANK_RATE
    for _ in range(10):
        planar.step(1e-4)
    simulation.advance(10)
    sample = simulation.sample()
    # Joints are open by 1e-13 m then; a local error of the method is as large.
    assert sample.constraint_residual <= 1e-12
    assert planar.q[:, 1:] == pytest.approx(sample.pose[:, 9:11], abs=1e-12)
    assert planar.V[:, 0] == pytest.approx(sample.twist[:, 2], abs=1e-9)

    planar, worst = PlanarFourBar(four_bar()), np.zeros(4)
    for _ in range(500):
        planar.step(2e-3)
        worst = np.maximum(worst, planar.gaps())
    assert np.angle(np.exp(1j * planar.q[0, 0])) == pytest.approx(-0.743173762, abs=1e-9)
    assert worst[[1, 2]] == pytest.approx([5.60e-3, 2.03e-4], rel=3e-3)
    assert max(worst[0], worst[3]) <= 1e-12
