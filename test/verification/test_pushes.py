# SPDX-License-Identifier: Apache-2.0
"""External wrenches that start and end inside a step, in body and in world axes."""

import bisect
import math

import numpy as np
import pytest
from convergence import fitted_order
from given import reference_inputs

from liegroup_core import Simulation, load_scene
from liegroup_core.methods.table import METHODS
from liegroup_core.reference import WrenchSpan, integrate
from liegroup_core.scene.description import Body, ConstantWrench, Frame, Joint, LinearServo, Scene, SpringDamper

WRENCH = (0.4, -0.3, 0.7, 3.0, -2.0, 4.0)
# END / m is a step size for which the wrench starts after a third of a step and ends after two, if m
# is 1 more than a multiple of 3. The parts of a step are then proportional to it.
END = 0.36  # s
START, DURATION = END / 3, END / 3
# Forces in world axes at points of the body: (torque, force), point. Their sum is zero: a couple.
COUPLE = (((0.4, -0.3, 0.7, 3.0, -2.0, 4.0), (0.5, -0.3, 0.2)), ((0.0, 0.0, 0.0, -3.0, 2.0, -4.0), (-0.1, 0.4, -0.2)))
COUNTS = {1: (100, 199, 400), 2: (100, 199, 400), 3: (40, 79, 160), 8: (7, 10)}


def top(axis=None):
    """A body on a spherical joint to ground, or on a revolute joint about an axis.

    Its centre of mass is not at the origin of its frame.
    """
    frame, kind, turning = Frame(), "spherical", (1.0, 2.0, 9.0)
    if axis is not None:
        frame, kind = Frame(axis=axis), "revolute"
        turning = tuple(3.0 * np.array(axis) / np.linalg.norm(axis))
    joint = Joint(name="tip", type=kind, parent="world", child="a", parent_frame=frame, child_frame=frame)
    return Scene(
        name="pushed",
        gravity=(0.0, 0.0, -9.81),
        bodies=[Body(name="a", mass=2.0, inertia=(0.3, 0.5, 0.4), com=(0.1, -0.2, 0.3), angular_velocity=turning)],
        joints=[joint],
    )


def error(scene, exact, axes, **options):
    """Largest entry of the error of the rotation matrix at END."""
    simulation = Simulation(scene, **{"method": "rkmk4"} | options)
    simulation.apply_wrench("a", WRENCH, START, DURATION, axes=axes)
    simulation.advance(round(END / simulation.step))
    (given,) = simulation.drain_applied()
    assert (given.start, given.end_ns * 1e-9) == pytest.approx((START, START + DURATION), abs=1e-9)
    return np.abs(simulation.sample().pose[0, :9].reshape(3, 3) - exact.rotation[-1, 0]).max()


def reference(scene, axes):
    changes = [WrenchSpan(START, START + DURATION, "a", WRENCH, axes)]
    exact, apart = integrate(scene, *Simulation(scene, method="rkmk4").state(), [0.0, END], changes)
    assert apart.attitude.max() < 1e-11
    return exact


@pytest.mark.parametrize("axes", ["body", "world"])
@pytest.mark.parametrize("method", [name for name in METHODS if name != "rkmk853"])
@pytest.mark.volume(14)
def test_a_wrench_that_starts_and_ends_inside_a_step_costs_no_order(method, axes):
    """Half an order is left for higher powers of h; a wrench held over a step has order 1 or less.

    rkmk853 takes the steps of rkmk8, and smaller ones after a part of a step.
    """
    scene = top()
    exact = reference(scene, axes)
    options = {"rtol": 1e9, "atol": 1e9} if METHODS[method].controlled else {}
    order = METHODS[method].order
    steps = [END / m for m in COUNTS.get(order, (16, 31, 61))]
    errors = [error(scene, exact, axes, method=method, step=h, **options) for h in steps]
    assert fitted_order(steps, errors) >= order - 0.5, errors


@pytest.mark.parametrize("axis", [(0.0, 0.0, 1.0), (0.0, -1.0, 0.0), (1.0, 2.0, 2.0)])
@pytest.mark.parametrize("axes", ["body", "world"])
def test_in_the_plane_and_in_space(axis, axes):
    """rkmk8 with 64 steps on a revolute joint: below the uncertainty of the reference."""
    scene = top(axis)
    exact = reference(scene, axes)
    for space in ("auto", "space"):
        assert error(scene, exact, axes, method="rkmk8", step=END / 64, space=space) < 1e-11


@pytest.mark.parametrize("method", ["rkmk4", "rkmk8"])
@pytest.mark.parametrize("group", ["relative", "se3", "so3xr3"])
def test_forces_in_world_axes_at_points_of_a_body_cost_no_order(method, group):
    """Commanded, and as forces of the scene, which the reference has."""
    scene = top()
    pushes = [
        ConstantWrench(
            name=f"push{i}",
            body="a",
            torque=wrench[:3],
            force=wrench[3:],
            point=point,
            axes="world",
            start=START,
            end=START + DURATION,
        )
        for i, (wrench, point) in enumerate(COUPLE)
    ]
    state = Simulation(scene, method="rkmk4").state()
    with_pushes = scene.model_copy(update={"forces": pushes})
    exact, apart = integrate(with_pushes, *state, [0.0, END])
    assert apart.attitude.max() < 1e-11
    order = METHODS[method].order
    steps = [END / m for m in {4: (40, 79, 160), 8: (7, 10)}[order]]
    for made, commands in ((with_pushes, ()), (scene, COUPLE)):
        errors = []
        for h in steps:
            simulation = Simulation(made, method=method, step=h, group=group)
            for i, (wrench, point) in enumerate(commands):
                simulation.apply_wrench("a", wrench, START, DURATION, source=f"{i}", axes="world", point=point)
            simulation.advance(round(END / h))
            turned = simulation.sample().pose[0, :9].reshape(3, 3)
            errors.append(np.abs(turned - exact.rotation[-1, 0]).max())
        assert fitted_order(steps, errors) >= order - 0.5, errors
    # The reference repeats the commands, too.
    changes = reference_inputs(simulation.layout, simulation.drain_applied())
    again, _ = integrate(scene, *state, [0.0, END], changes)
    assert np.abs(again.rotation[-1] - exact.rotation[-1]).max() < 1e-11


@pytest.mark.parametrize("beside", [1e-9, -1e-9, 1e-6])
@pytest.mark.parametrize("name, body", [("four_bar", "crank"), ("bricard", "rod2")])
@pytest.mark.parametrize("method", ["constrained_rattle", "constrained_rattle4", "constrained_rattle8"])
@pytest.mark.volume(6)
def test_a_wrench_right_beside_a_step_is_no_obstacle(method, name, body, beside):
    """Substeps of 1e-10 s say nothing about those of 1 ms that follow, whose initial guess they gave.

    The push moves the motion by about beside F / m t, F / m below 100 m/s^2.
    """
    ends = []
    for start in (0.1, 0.1 + beside):
        simulation = Simulation(load_scene(name), method, 2e-3)
        simulation.apply_wrench(body, (1.0, 0.1, 1.0, 0.0, 0.0, 0.0), start, 0.2)
        simulation.advance(250)
        ends.append(simulation.state()[0])
    assert np.abs(ends[1] - ends[0]).max() <= 100.0 * abs(beside) + 1e-10


# Forces that jump or have a kink: accuracies against closed forms, piece by piece.
#
# The error estimate of a substep is small by chance if a jump falls into some of its places, see
# methods/munthe_kaas/error_control.py.


JUMPS_DURATION = 10.0  # s


def through_its_end(rng):
    """Spring with a rest length on a body of 1 kg that runs through its other end: x'' = -k (x - l sign x)."""
    k, l = 10.0 ** rng.uniform(1.0, 4.5), 10.0 ** rng.uniform(-2.0, 0.0)
    x0, w = l * rng.uniform(2.2, 6.0), math.sqrt(k)
    pieces, t, x, v, side = [], 0.0, x0, 0.0, 1.0
    while t < JUMPS_DURATION:
        pieces.append((t, x, v, w, side * l))
        amplitude, phase = math.hypot(x - side * l, v / w), math.atan2(-v / w, x - side * l)
        turned = (side * math.acos(-side * l / amplitude) - phase) % (2.0 * math.pi)
        t, x, v = t + turned / w, 0.0, -amplitude * w * math.sin(phase + turned)
        side = -side
    ends = dict(parent="world", parent_point=(0, 0, 0), child="b", child_point=(0, 0, 0))
    return x0, SpringDamper(name="k", **ends, stiffness=k, rest_length=l), pieces


def at_its_limit(rng):
    """Servo on a body of 1 kg, mostly at its largest effort: x'' = -clip(k x, F)."""
    k, x0 = 10.0 ** rng.uniform(1.0, 7.0), 10.0 ** rng.uniform(-1.0, 0.5)
    largest = min(k * x0 * 10.0 ** rng.uniform(-5.0, -0.3), 1000.0 * x0)
    w, edge = math.sqrt(k), largest / k
    pieces, t, x, v, side = [], 0.0, x0, 0.0, 1.0
    while t < JUMPS_DURATION:
        if side:  # constant force until x = side * edge
            pieces.append((t, x, v, 0.0, -side * largest))
            root = math.sqrt(v * v + 2.0 * largest * (side * x - edge))
            t, x, v, side = t + (side * v + root) / largest, side * edge, -side * root, 0.0
        else:  # spring, to the other edge
            pieces.append((t, x, v, w, 0.0))
            amplitude, phase, side = (math.hypot(x, v / w), math.atan2(-v / w, x), math.copysign(1, v))
            turned = (-side * math.acos(side * edge / amplitude) - phase) % (2.0 * math.pi)
            v = -amplitude * w * math.sin(phase + turned)
            t, x = t + turned / w, side * edge
    return x0, LinearServo(name="k", joint="j", stiffness=k, effort_limit=largest), pieces


def position(pieces, starts, time):
    """m, of a piece (start, x, v, w, centre) of an oscillation, or with w = 0 an acceleration."""
    start, x, v, w, centre = pieces[bisect.bisect_right(starts, time) - 1]
    q = time - start
    if w == 0.0:
        return x + v * q + 0.5 * centre * q * q
    return centre + (x - centre) * math.cos(w * q) + v / w * math.sin(w * q)


@pytest.mark.parametrize("accuracy", [1e-4, 1e-6])
@pytest.mark.parametrize("make", [through_its_end, at_its_limit])
@pytest.mark.volume(1)
def test_the_accuracy_is_kept_or_its_end_said(make, accuracy):
    """Finer ones end at rounding: no substep can be shorter than what rounding of a pose allows."""
    along = Frame(axis=(1, 0, 0))
    for seed in range(24):
        x0, force, pieces = make(np.random.default_rng([seed, make is at_its_limit]))
        scene = Scene(
            name="slider",
            gravity=(0, 0, 0),
            bodies=[Body(name="b", mass=1.0, inertia=(1.0, 1.0, 1.0), position=(x0, 0, 0))],
            joints=[
                Joint(name="j", type="prismatic", parent="world", child="b", parent_frame=along, child_frame=along)
            ],
            forces=[force],
        )
        simulation = Simulation(scene, accuracy=accuracy, horizon=JUMPS_DURATION, quiet=True)
        size, starts = simulation.promise["length"], [piece[0] for piece in pieces]
        while simulation.time < JUMPS_DURATION:
            simulation.advance(1)
            error = simulation.sample().positions["b"][0] - position(pieces, starts, simulation.time)
            if simulation.time <= simulation.accurate_until:
                assert abs(error) <= accuracy * size, (seed, simulation.time)
