# SPDX-License-Identifier: Apache-2.0
"""Commands beyond the limits of a joint are refused, and nothing changes."""

import math

import numpy as np
import pytest
from scene_files import cases, text_of

from liegroup_core import Simulation
from liegroup_core.forces.commands import TARGET, Command
from liegroup_core.joints.limits import SPEED, BeyondLimits
from liegroup_core.joints.motion import extremes, peak_rate, through
from liegroup_core.scene.load import scene_from_text

SCENE = text_of("rig_command_limits.yaml")


@pytest.fixture(scope="module")
def simulation():
    return Simulation(scene_from_text(SCENE), "rkmk8", 1e-3)


@pytest.mark.parametrize("joint, points, text", cases("a_motion_beyond_the_limits_is_refused"))
def test_a_motion_beyond_the_limits_is_refused(simulation, joint, points, text):
    """The rest-to-rest quintic needs 15/8 of its mean rate in the middle: 1.875 * 1.7 = 3.1875.

    From rest at 0 to 2 m and -1 m/s after 4 s, with s = t/4: 36 s^3 - 58 s^4 + 24 s^5 m,
    largest at s = 0.7811.
    """
    before = simulation.snapshot(), len(simulation.commanded_motions)
    with pytest.raises(BeyondLimits, match=text) as caught:
        simulation.command_motion(joint, *points)
    assert "\n" not in str(caught.value)
    assert (simulation.snapshot(), len(simulation.commanded_motions)) == before


def test_what_is_within_the_limits_is_taken(simulation):
    """rkmk8 integrates a motion of degree five without an error of the method."""
    simulation.reset()
    simulation.command_motion("rail", [1.0], [1.5])
    simulation.command_motion("free", [0.02], [10.6])  # 1.875 * 10.6 / 0.02 = 994 rad/s
    simulation.advance(1000)
    found = simulation.sample().joint_coordinates
    assert found["rail"] == pytest.approx((1.5, 0.0), abs=1e-12)
    assert found["free"] == pytest.approx((10.6, 0.0), abs=1e-11)


def test_a_joint_that_is_faster_than_its_limit_can_go_on_and_stop():
    scene = SCENE.replace("inertia: [1, 1, 0.5]}", "inertia: [1, 1, 0.5], angular_velocity: [0, 0, 2000]}")
    simulation = Simulation(scene_from_text(scene), "rkmk4", 1e-5)
    simulation.command_motion("free", [1e-3], [1.25], [500.0])
    simulation.command_motion("free", [1e-3], None, [0.0])
    simulation.advance(200)
    assert simulation.sample().joint_coordinates["free"][1] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("seed", range(20))
def test_the_peak_rate_is_that_of_a_fine_grid(seed):
    rng = np.random.default_rng(seed)
    start, duration = rng.normal(size=3), rng.uniform(0.1, 3.0)
    row, _ = through(start, [1.0, 1.0 + duration], rng.normal(size=1), rng.normal(size=1))
    s = np.linspace(0.0, duration, 20_001)
    rates = np.polynomial.Polynomial(row[1:]).deriv()(s)
    # The grid misses a peak by half its second derivative times half a spacing squared.
    curvature = np.abs(np.polynomial.Polynomial(row[1:]).deriv(3)(s)).max()
    missed = curvature * (duration / 20_000) ** 2
    assert abs(peak_rate(row, duration, 0.0) - np.abs(rates).max()) <= missed + 1e-12
    assert peak_rate(row, duration, math.inf) >= np.abs(rates).max() - 1e-12


@pytest.mark.parametrize("seed", range(20))
def test_the_extreme_positions_are_those_of_a_fine_grid(seed):
    rng = np.random.default_rng(seed)
    start, duration = rng.normal(size=3), rng.uniform(0.1, 3.0)
    row, _ = through(start, [1.0, 1.0 + duration], rng.normal(size=1), rng.normal(size=1))
    curve = np.polynomial.Polynomial(row[1:])
    s = np.linspace(0.0, duration, 20_001)
    missed = np.abs(curve.deriv(2)(s)).max() * (duration / 20_000) ** 2
    least, largest = extremes(row, duration, math.inf, -math.inf)
    assert abs(least - curve(s).min()) <= missed + 1e-12
    assert abs(largest - curve(s).max()) <= missed + 1e-12
    bounds = extremes(row, duration, -math.inf, math.inf)
    assert bounds[0] <= least + 1e-12 and largest <= bounds[1] + 1e-12


def test_a_joint_beyond_its_limits_can_return(simulation):
    simulation.reset()
    simulation.place(joints={"rail": (2.0, 0.5)})
    simulation.advance(400)
    assert simulation.sample().joint_coordinates["rail"] == pytest.approx((2.2, 0.5), abs=1e-12)
    simulation.command_motion("rail", [2.0], [1.5], [0.0])
    simulation.advance(2000)
    assert simulation.sample().joint_coordinates["rail"] == pytest.approx((1.5, 0.0), abs=1e-12)


def test_limits_of_the_scene_and_the_defaults(simulation):
    limits = simulation.layout.limits
    assert limits["free"][2:] == (-math.inf, math.inf, SPEED, math.inf)
    assert limits["rail"][1:] == ("m", -0.5, 2.0, 3.0, math.inf)


SERVOS = text_of("servos.yaml")


def test_a_servo_without_limits_of_position_does_not_jump_beyond_what_it_covers_in_a_second():
    """4 rad from its target position, which moves with every command; rails without stiffness may."""
    scene = SERVOS.replace("lower: 0.5, upper: 2.0, velocity: 4.0", "velocity: 4.0")
    simulation = Simulation(scene_from_text(scene), "rkmk4", 1e-3)
    text = "joint 'hinge' cannot jump from 0 to 4.1 rad: approach it in steps of at most 4 rad"
    with pytest.raises(BeyondLimits, match=text):
        simulation.command_servo("hinge", 4.1)
    assert simulation.input_count == 0
    simulation.command_servo("hinge", 4.0)
    simulation.advance(1)
    simulation.command_servo("hinge", 8.0)
    with pytest.raises(BeyondLimits, match="from 4 to -0.1 rad"):
        simulation.command_servo("hinge", -0.1)
    simulation.command_servo("rail", 1e9, 1.0)
    Command(TARGET, "hinge", (100.0, 0.0), 0).repeat(simulation)  # as a run that is repeated had it


def test_efforts_and_servos_beyond_the_limits_are_refused():
    """A servo without stiffness has no position. What a run recorded is repeated, beyond them too."""
    simulation = Simulation(scene_from_text(SERVOS), "rkmk4", 1e-3)
    for text, command, *arguments in (
        ("effort 10.1 N m of joint 'hinge'", simulation.apply_effort, "hinge", 10.1),
        ("effort -5.1 N of joint 'rail'", simulation.apply_effort, "rail", -5.1),
        ("position 2.01 rad of joint 'hinge'", simulation.command_servo, "hinge", 2.01),
        ("position 1e\\+99 rad of joint 'hinge'", simulation.command_servo, "hinge", 1e99),
        ("position must be a finite number: 1e\\+300 is too large", simulation.command_servo, "rail", 1e300),
        ("velocity 4.1 rad/s of joint 'hinge'", simulation.command_servo, "hinge", 1.0, 4.1),
        ("velocity -3.1 m/s of joint 'rail'", simulation.command_servo, "rail", 0.0, -3.1),
    ):
        with pytest.raises(BeyondLimits, match=text):
            command(*arguments)
    assert simulation.input_count == 0
    simulation.apply_effort("hinge", -10.0)
    simulation.command_servo("hinge", 2.0, -4.0)
    simulation.command_servo("rail", 0.0, 3.0)
    simulation.advance(10)
    before = simulation.snapshot()
    with pytest.raises(BeyondLimits, match="position 2.5 rad of joint 'hinge'"):
        simulation.place(joints={"hinge": (2.5, 9.0), "rail": (1.0, None)})
    assert simulation.snapshot() == before
    Command(TARGET, "hinge", (2.5, 9.0), simulation.time_ns).repeat(simulation)
    simulation.advance(1)
    assert simulation.drain_applied()[-1].values[0] == 2.5
