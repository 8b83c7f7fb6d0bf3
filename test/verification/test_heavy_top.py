# SPDX-License-Identifier: Apache-2.0
"""Heavy top with spring against independent golden numbers.

Golden end state: Taylor series of the polynomial equations of motion in 45 digits; an independent
DOP853 run agrees to 1e-10. With zero rest length and the centre of mass at R rc the spring acts as
a constant field, so this top has a reference without any of our code.
"""

import numpy as np
import pytest
from convergence import order_of
from golden import END, HEAVY_TOP_CENTRE
from planar_four_bar import PlanarFourBar

from liegroup_core import Simulation, load_scene
from liegroup_sim_ros.chapter.joint_runs import CRANK_RATE, four_bar, joint_errors

HORIZON = 6.0

# ||R - Rref||_2 at 6 s and the largest |r + R r0| on the way, of an independent implementation of
# the same methods; both groups, per step size.
SE3_ERROR = {1e-2: 3.089e-3, 2e-3: 5.652e-6, 1e-3: 3.623e-7, 5e-4: 2.294e-8, 1e-4: 3.740e-11}
SO3XR3_ERROR = {1e-2: 4.692e-2, 5e-3: 3.536e-3, 2e-3: 9.221e-5, 1e-3: 5.771e-6}
SO3XR3_RESIDUAL = {1e-2: 7.499e-3, 5e-3: 4.904e-4, 2e-3: 1.274e-5, 1e-3: 7.985e-7}


def run(step, group, samples):
    """(largest |r + R r0| over `samples` samples, last sample)."""
    simulation = Simulation(load_scene("heavy_top"), method="rkmk4", step=step, group=group)
    steps = round(HORIZON / step)
    worst = 0.0
    for _ in range(samples):
        simulation.advance(steps // samples)
        pose = simulation.sample().poses["top"]
        worst = max(worst, np.linalg.norm(pose[:3, 3] + pose[:3, :3] @ [-0.5, 0.0, 0.0]))
    return worst, simulation.sample()


def attitude_error(sample):
    return np.linalg.norm(sample.poses["top"][:3, :3] - END["heavy_top", 6][:3], 2)


@pytest.fixture(scope="module")
def se3_runs():
    return {h: run(h, "se3", 600) for h in SE3_ERROR}


@pytest.mark.turn(3)
def test_end_state_at_one_millisecond(se3_runs):
    sample = se3_runs[1e-3][1]
    assert attitude_error(sample) <= 4e-7
    # |r - rref| = |(R - Rref) rc| <= 0.5 ||R - Rref||. A lag dt in time gives |dR| = |w| dt and
    # |dw| = |wdot| dt; |w| = 8.5 rad/s, and the field's 1.1e4 N at 0.5 m on 5.5 kg m^2 turns by at
    # most 1010 rad/s^2, so |dw| <= 119 |dR|.
    assert np.linalg.norm(sample.positions["top"] - HEAVY_TOP_CENTRE) <= 2e-7
    assert np.linalg.norm(sample.twists["top"][:3] - END["heavy_top", 6][3]) <= 119 * 4e-7


def test_errors_equal_those_of_an_independent_implementation(se3_runs):
    for step, expected in SE3_ERROR.items():
        # Half a digit more than printed; at 1e-4 the golden state's 1e-12 and rounding also count.
        assert attitude_error(se3_runs[step][1]) == pytest.approx(expected, rel=2e-3, abs=2e-12)


def test_energy_drift_equals_that_of_an_independent_implementation(se3_runs):
    start = Simulation(load_scene("heavy_top"), method="rkmk4").sample().energy
    drift = {h: abs(sample.energy - start) / abs(start) for h, (_, sample) in se3_runs.items()}
    # The independent implementation's largest drift over the run: 1.5e-3, 4.9e-7, 1.6e-8.
    for step, largest in {1e-2: 1.5e-3, 2e-3: 4.9e-7, 1e-3: 1.6e-8}.items():
        assert drift[step] <= 1.05 * largest


@pytest.mark.turn(3)
def test_the_joint_drifts_at_order_four_on_so3xr3():
    residuals, errors = {}, {}
    for step in SO3XR3_ERROR:
        residuals[step], sample = run(step, "so3xr3", round(HORIZON / step))
        errors[step] = attitude_error(sample)
        assert residuals[step] == pytest.approx(SO3XR3_RESIDUAL[step], rel=1e-3)
        assert errors[step] == pytest.approx(SO3XR3_ERROR[step], rel=1e-3)
    assert order_of(residuals) == pytest.approx(4.0, abs=0.1)


# Planar four-bar of the chapter's Figs. 6.4 and 6.5 against the quadrature of its energy.
#
# It has one freedom and no force, so its crank speed is a function of its angle alone, and the angle
# after one second, the period and the speed follow from integrals in many digits. Bounds of errors
# are those of an independent implementation of the same method with another form of the joint rows.


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
            moving = (
                0.5
                * (b.mass * np.dot(b.linear_velocity, b.linear_velocity) + b.inertia[2] * b.angular_velocity[2] ** 2)
                for b in scene.bodies
            )
            assert energy[0] == pytest.approx(sum(moving), rel=1e-14)
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
