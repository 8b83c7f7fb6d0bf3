# SPDX-License-Identifier: Apache-2.0
"""Turns of wound springs, the line of a motor, and wrenches with times.

Motions under every kind of force against closed forms: test_reference_kinds.py; orders with wrenches that
start and end inside steps: test_pushes.py.
"""

import mechanisms
import numpy as np
import pytest
from convergence import order_of

from liegroup_core import Scene, Simulation, SimulationError
from liegroup_core.forces.instants import StepGrid
from liegroup_core.scene import Body, ConstantWrench, Frame, Joint, TorsionalSpringDamper
from liegroup_core.status import ROTATION_TOO_LARGE, TURNS_NOT_COUNTED

EPS = 2.0**-52
BOTH = pytest.mark.parametrize("group", ["se3", "so3xr3"])
AXIS = np.array([1.0, 2.0, 2.0]) / 3.0
START = {"quaternion": (0.1, -0.5, 0.1, 0.8544003745)}  # of no special direction


# ---------------------------------------------------------------- on hinges

INERTIA = (0.3, 0.4, 0.5)


def hinged(*forces, spin=0.0):
    """Body on a revolute joint to ground along AXIS, 0.2 m from its centre of mass."""
    arm = 0.2 * np.cross(AXIS, [1.0, 0.0, 0.0]) / np.linalg.norm(np.cross(AXIS, [1.0, 0.0, 0.0]))
    keys = {"name": "arm", "mass": 2.0, "inertia": INERTIA, "position": arm, "angular_velocity": spin * AXIS}
    hinge = {"name": "hinge", "type": "revolute", "parent_frame": {"axis": AXIS}}
    scene = mechanisms.one_body(hinge, forces, linear_velocity=np.cross(spin * AXIS, arm), **keys)
    return scene, AXIS @ np.diag(INERTIA) @ AXIS + 2.0 * 0.2**2


def pair(*forces, spin=0.0):
    """(scene of two free bodies on a revolute joint through both centres of mass, reduced inertia)."""
    bodies = [
        Body(name="first", mass=2.0, inertia=INERTIA, angular_velocity=(0, 0, -spin)),
        Body(name="second", mass=1.0, inertia=(0.1, 0.1, 0.2), position=(0, 0, 0.3)),
    ]
    joint = Joint(name="hinge", type="revolute", parent="first", child="second", child_frame=Frame())
    scene = Scene(name="pair", gravity=(0, 0, 0), bodies=bodies, joints=[joint], forces=forces)
    return scene, 1.0 / (1.0 / INERTIA[2] + 1.0 / 0.2)


def principal(sample, scene):
    """Joint angle from the poses, rad in (-pi, pi]."""
    joint = scene.joints[0]
    turn = sample.poses[joint.child][:3, :3]
    if joint.parent != "world":
        turn = sample.poses[joint.parent][:3, :3].T @ turn
    axis = AXIS if joint.parent == "world" else np.array([0, 0, 1.0])
    sine = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    return np.arctan2(0.5 * sine @ axis, 0.5 * (np.trace(turn) - 1.0))


@BOTH
@pytest.mark.parametrize("made", [hinged, pair])
def test_torsional_oscillator_over_many_turns(made, group):
    """theta = theta0 + e^{-d t} (A cos wt + B sin wt) from rest, wound up by 6.4 turns."""
    stiffness, damping, rest = 3.0, 0.05, 40.0
    spring = TorsionalSpringDamper(name="coil", joint="hinge", stiffness=stiffness, damping=damping, rest_angle=rest)
    scene, inertia = made(spring)
    d = damping / (2 * inertia)
    w = np.sqrt(stiffness / inertia - d * d)

    def angle(t):
        return rest * (1.0 - np.exp(-d * t) * (np.cos(w * t) + d / w * np.sin(w * t)))

    errors = {}
    for h in (8e-3, 4e-3, 2e-3):
        simulation = Simulation(scene, method="rkmk4", step=h, group=group)
        worst, largest = 0.0, 0.0
        for _ in range(50):
            simulation.advance(round(0.08 / h))
            sample = simulation.sample()
            worst = max(worst, abs(sample.angles[0] - angle(sample.time)))
            largest = max(largest, sample.angles[0])
            gap = (sample.angles[0] - principal(sample, scene)) / (2 * np.pi)
            assert abs(gap - round(gap)) < 1e-12
        errors[h] = worst
    assert largest > 10 * 2 * np.pi
    assert order_of(errors) == pytest.approx(4.0, abs=0.1)
    # The classical method on theta'' = -w^2 theta loses (h w)^4 w t / 120 of the phase.
    bound = 2 * rest * (2e-3 * w) ** 4 * w * 4.0 / 120
    assert errors[2e-3] < 1.5 * bound


def test_a_joint_at_half_a_turn_starts_at_plus_pi():
    """Whichever sign round-off gives to the sine."""
    hinge, coil = {"type": "revolute", "parent_frame": {}, "child_frame": {}}, {"name": "coil", "joint": "j"}
    for turn in (np.pi - 1e-12, np.pi + 1e-12, -np.pi):
        spring = TorsionalSpringDamper(**coil, stiffness=1)
        scene = mechanisms.one_body(hinge, [spring], rotation_vector=(0, 0, turn))
        assert Simulation(scene, method="rkmk4").sample().angles[0] == pytest.approx(np.pi, abs=2e-12)


def test_turns_belong_to_the_state():
    """A pose does not tell them: a state without angles is one that is wound by less than pi."""
    scene, _ = hinged(TorsionalSpringDamper(name="coil", joint="hinge", stiffness=3.0, rest_angle=40.0))
    simulation, other = Simulation(scene, method="rkmk4"), Simulation(scene, method="rkmk4")
    simulation.advance(700)
    middle = simulation.sample()
    assert middle.angles[0] > 2 * np.pi
    other.restore(simulation.snapshot())
    for run in (simulation, other):
        run.advance(500)
    assert simulation.state()[0].tobytes() == other.state()[0].tobytes()
    assert simulation.sample().energy == other.sample().energy
    # a sample keeps its turns while the simulation goes on
    before = simulation.sample()
    simulation.advance(500)
    assert before.energy == pytest.approx(simulation.sample().energy, rel=1e-11)
    assert abs(before.angles[0] - simulation.sample().angles[0]) > np.pi
    other.set_state(middle.pose, middle.twist)
    assert other.sample().angles[0] == pytest.approx(
        middle.angles[0] - 2 * np.pi * round(middle.angles[0] / (2 * np.pi)), abs=1e-12
    )
    alone = simulation.layout.sample(middle.pose, middle.twist, near=middle.angles + 1.0)
    assert alone.angles[0] == middle.angles[0]
    simulation.reset()
    assert simulation.sample().angles[0] == 0.0
    for wrong in ([], [1.0, 2.0], [np.nan]):
        with pytest.raises(ValueError, match="expected 1 finite angles"):
            simulation.set_state(middle.pose, middle.twist, angles=wrong)


def test_turns_that_cannot_be_counted_stop_the_run():
    """Beyond half a turn a step the nearest angle would be one turn off, and silently so."""
    scene, inertia = hinged(TorsionalSpringDamper(name="coil", joint="hinge", stiffness=1e-3), spin=70.0)
    simulation = Simulation(scene, method="rkmk4", step=0.05)
    with pytest.raises(SimulationError, match="joint of coil rotates by pi") as failure:
        simulation.advance(10)
    assert failure.value.status == TURNS_NOT_COUNTED
    assert simulation.steps == 0 and simulation.sample().angles[0] == 0.0
    slower = Simulation(scene, method="rkmk4", step=0.04)
    slower.advance(100)
    w = np.sqrt(1e-3 / inertia)
    assert slower.sample().angles[0] == pytest.approx(70.0 / w * np.sin(4.0 * w), rel=1e-9)


# ---------------------------------------------------------------- wrenches with times


def pushed(step, start, end, group="se3", spin=(1, 2, -3), **wrench):
    push = ConstantWrench(name="push", body="b", start=start, end=end, **wrench)
    scene = mechanisms.one_body(None, [push], name="b", mass=2.0, inertia=INERTIA, angular_velocity=spin, **START)
    return Simulation(scene, method="rkmk4", step=step, group=group)


@pytest.mark.parametrize("group, spin", [("se3", (0, 0, 0)), ("so3xr3", (1, 2, -3))])
@pytest.mark.parametrize(
    "start, end", [(0.1234567, 0.7654321), (0.0, 0.31), (0.50001, 0.50002), (0.1, 0.2), (0.8, None), (2.0, 3.0)]
)
def test_impulse_is_force_times_time(start, end, group, spin):
    """Exact up to round-off, whether or not the times coincide with steps.

    Also on a spinning body where positions are integrated in world axes; on SE(3) the momentum of
    a spinning body is as exact as the method.
    """
    simulation = pushed(0.01, start, end, group, spin, axes="world", force=(3.0, -1.0, 2.0))
    simulation.advance(100)
    assert simulation.steps == 100 and simulation.time == 1.0
    lasting = max(0.0, min(1.0 if end is None else end, 1.0) - start)
    momentum = simulation.sample().spatial_momentum[3:]
    # Rounding of 100 steps of four stages, the rotation back and forth some ten times each.
    assert np.abs(momentum - lasting * np.array([3.0, -1.0, 2.0])).max() <= 4000 * EPS


def test_a_failed_split_step_leaves_the_last_valid_state():
    """The first part of step 2 succeeds, up to the wrench; the second part rotates the body beyond the limit."""
    simulation, other = (pushed(0.1, 0.25, None, torque=(0, 0, 1e6)) for _ in range(2))
    with pytest.raises(SimulationError, match="step 2,") as failure:
        simulation.advance(10)
    assert failure.value.status == ROTATION_TOO_LARGE and simulation.steps == 2
    other.advance_to(0.25)
    assert simulation.time == other.time
    for mine, theirs in zip(simulation.state(), other.state()):
        assert mine.tobytes() == theirs.tobytes()


def test_wrench_times_follow_the_step_count():
    """After set_state and reset, and in the power of a sample."""
    simulation = pushed(0.1, 0.25, 0.5, spin=(0, 0, 0), force=(5.0, 0, 0))
    simulation.advance(10)
    end = simulation.state()
    simulation.reset()
    powers = []
    for _ in range(10):
        simulation.advance(1)
        powers.append(simulation.sample().power)
    assert [bool(power) for power in powers] == [False, False, True, True] + 6 * [False]
    for mine, theirs in zip(simulation.state(), end):
        assert mine.tobytes() == theirs.tobytes()
    simulation.set_state(*end, steps=3)
    assert simulation.sample().power != 0.0
    pose, twist = simulation.state()
    assert simulation.layout.sample(pose, twist, time=0.3).power != 0.0
    assert simulation.layout.sample(pose, twist, time=0.5).power == 0.0


def test_steps_are_split_where_wrenches_of_the_scene_start_and_end():
    """3 * 0.1 is not 0.3 in binary, but it is meant."""
    times = (0.0, None), (0.3, 0.5), (0.42, 0.44)
    pushes = [ConstantWrench(name=f"p{k}", body="b", force=(1, 0, 0), start=a, end=b) for k, (a, b) in enumerate(times)]
    simulation = Simulation(mechanisms.one_body(None, pushes, name="b"), "rkmk4", 0.1)
    schedule, boundary = simulation.inputs.schedule, StepGrid(0.1).boundary
    changes, step = [], -1
    while (step := schedule.next_change(step)) < 100:
        changes.append(step)
    assert changes == [3, 4, 5]  # the first acts already
    assert not schedule.inside(3)
    inside = schedule.inside(4)
    assert [instant.time for instant in inside] == [0.42, 0.44]
    at = (boundary(3), 2.0), (boundary(4), 2.0), (inside[0], 3.0), (inside[1], 2.0), (boundary(5), 1.0)
    for instant, force in at:
        schedule.update(instant)
        assert schedule.total["body"][0, 3] == force
    assert simulation.input_count == 0 and not simulation.wrench_sources and not simulation.drain_applied()


@pytest.mark.parametrize("steps, step, time, sign", [(35, 0.01, 0.35, 1), (22, 0.03, 0.66, -1)])
def test_a_decimal_time_is_matched_to_its_step(steps, step, time, sign):
    """In binary, steps * step differs from the decimal time by a round-off of either sign."""
    assert np.sign(steps * step - time) == sign
    for key, before, after in (("start", 0.0, 1.0), ("end", 1.0, 0.0)):
        push = ConstantWrench(name="push", body="b", force=(1, 0, 0), **{key: time})
        scene = mechanisms.one_body(None, [push], name="b", linear_velocity=(1, 0, 0))
        simulation = Simulation(scene, method="rkmk4", step=step)
        grid, schedule = StepGrid(step), simulation.inputs.schedule
        assert not schedule.inside(steps - 1) and not schedule.inside(steps)
        for k, expected in ((steps - 1, before), (steps, after)):
            schedule.update(grid.boundary(k))
            assert schedule.total["body"][0, 3] == expected
        pose, twist = simulation.state()
        simulation.set_state(pose, twist, steps=steps)
        assert simulation.sample().power == after
