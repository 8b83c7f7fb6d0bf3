# SPDX-License-Identifier: Apache-2.0
"""The independent reference integration against 45-digit end states and closed forms.

The golden numbers come from Taylor series of the polynomial equations of motion in 45 digits. A
DOP853 run of another author's code, in other coordinates, at rtol = atol = 1e-13 differed from
them by 1.6e-14 and 2.5e-13 (free body, 1 s and 10 s), 1.3e-11 (Lagrangian top, 1 s) and 9.6e-11
(heavy top, 6 s). This one works at the same tolerance, so it must be as close.
"""

import math

import mechanisms
import numpy as np
import pytest
from golden import END, HEAVY_TOP_CENTRE
from scipy.spatial.transform import Rotation

from liegroup_core.errors import SimulationError
from liegroup_core.layout import make_layout
from liegroup_core.mechanism.body_model import initial_state
from liegroup_core.reference import Reference, Trajectory, WrenchSpan, distance, integrate
from liegroup_core.reference.equations import joint_equations
from liegroup_core.reference.system import build_system
from liegroup_core.reference.trajectory import _to_state
from liegroup_core.reference.vectors import FRAME, place
from liegroup_core.scene.description import Body, Scene
from liegroup_core.scene.load import load_scene


def follow(scene, times, changes=()):
    """(trajectory, uncertainty) from the initial state of the scene."""
    return integrate(scene, *initial_state(scene), times, changes)


@pytest.mark.parametrize(
    "name, time, bound",
    [("free_body", 1, 1.6e-14), ("free_body", 10, 2.5e-13), ("lagrangian_top", 1, 1.3e-11), ("heavy_top", 6, 9.6e-11)],
)
def test_golden_end_states(name, time, bound):
    """Bound: error of another DOP853 run, plus 1e-13 for the round-off of about 1000 steps.

    omega differs by at most the error of R times the largest angular acceleration, below 700
    rad/s^2 for the tops (150 rad/s x 4.6 rad/s), so the same bound times 700.
    """
    trajectory, uncertainty = follow(load_scene(name), np.linspace(0.0, time, 601 if name == "heavy_top" else 3))
    error = np.linalg.norm(trajectory.rotation[-1, 0] - END[name, time][:3], 2)
    assert error <= bound + 1e-13
    assert np.linalg.norm(trajectory.twist[-1, 0, :3] - END[name, time][3]) <= 700.0 * (bound + 1e-13)
    # What it says about itself holds, down to the same round-off, and is small enough to judge
    # the best fourth-order runs by (4e-11 for the heavy top at h = 1e-4).
    assert error <= uncertainty.attitude[-1, 0] + 1e-13
    assert uncertainty.attitude[-1, 0] <= 4e-11
    if name == "heavy_top":
        # Centre of mass: error of R times 0.5 m. The spherical joint holds to round-off.
        assert np.linalg.norm(trajectory.position[-1, 0] - HEAVY_TOP_CENTRE) <= bound
        pivot = trajectory.position[:, 0] - 0.5 * trajectory.rotation[:, 0, :, 0]
        assert np.abs(pivot).max() <= 1e-12  # measured 1.1e-13 with damped drift, 4e-11 without


def four_bar_period(speed=10.0 * math.pi):
    """Period of the scene four_bar, s: the mean of 1 / crank rate over a turn, as its energy is constant.

    The trapezoidal rule converges exponentially for a periodic function: 400 points leave round-off.
    """
    angle = np.linspace(0.0, 2.0 * math.pi, 400, endpoint=False) + math.pi / 2
    pin = 0.5 * np.exp(1j * angle)
    pin_rate = 1j * pin  # rates per rad/s of the crank
    base = 1.0 - pin  # from the pin to the rocker's
    reach = np.abs(base)
    far = pin + base / 2.0 + 1j * base / reach * np.sqrt(1.0 - reach**2 / 4.0)
    bars = far - pin, far - 1.0
    # far = pin + bar_0 = 1 + bar_1, all bars turn: pin_rate + i w_0 bar_0 = i w_1 bar_1
    rows = np.array([[[-(1j * b).real, (1j * c).real], [-(1j * b).imag, (1j * c).imag]] for b, c in zip(*bars)])
    w = np.linalg.solve(rows, np.stack([pin_rate.real, pin_rate.imag], axis=1)[..., None])[..., 0]
    moment = 0.5 * (0.25 + 0.0025) / 12 + 0.5 * 0.0625
    moment = moment + (1.0025 / 12) * (w**2).sum(axis=1)
    moment = moment + np.abs(pin_rate + 0.5j * w[:, 0] * bars[0]) ** 2 + np.abs(0.5j * w[:, 1] * bars[1]) ** 2
    return 2.0 * math.pi * np.sqrt(moment / moment[0]).mean() / speed


@pytest.mark.turn(3)
def test_a_closed_loop_returns_after_eighty_periods():
    """The redundant row of the planar loop stays redundant; a drift out of the plane would grow tenfold per second.

    The period has the round-off of a mean, 1e-15 relative: 80 of them shift the crank by 1e-15 x 500 rad. The poses
    of the scene are assembled to 1e-13. Its largest rates are 70 rad/s.
    """
    trajectory, uncertainty = follow(load_scene("four_bar"), np.array([0.0, 80.0 * four_bar_period()]))
    assert trajectory.times[-1] > 14.0
    off = distance(Trajectory(*(part[:1] for part in trajectory)), Trajectory(*(part[1:] for part in trajectory)))
    assert off.angle.max() <= 3.0 * uncertainty.angle.max() + 1e-10
    assert uncertainty.angle.max() <= 1e-11
    assert np.abs(trajectory.position[-1, :, 2]).max() <= 1e-13


def test_a_stiff_spring_costs_few_steps():
    """A damper of 1e5 1/s would limit explicit steps to 3e-5 s: 17 000 for half a second."""
    scene = load_scene("flyball_governor")
    reference = Reference(scene, *initial_state(make_layout(scene).centred), end=0.5)
    assert reference.at(np.array([0.25, 0.5]))[1].angle.max() <= 1e-11
    assert reference.steps < 100


@pytest.mark.turn(3)
def test_a_chaotic_motion_ends_where_it_is_unknown():
    """Two pendulums in line: their uncertainty grows by a factor of ten in about two seconds."""
    scene = load_scene("double_pendulum")
    reference = Reference(scene, *initial_state(make_layout(scene).centred))
    found, uncertainty = reference.up_to_limit(np.arange(0.0, 100.0))
    assert 15.0 < found.times[-1] < 60.0 and uncertainty.angle.max() <= 1e-6
    assert "amplifies small differences" in reference.stopped
    with pytest.raises(SimulationError, match="exceeds 1e-06"):
        reference.at(np.array([70.0]))


def constant_push(**values):
    """Scene of one body without gravity."""
    return Scene(
        name="pushed", gravity=(0.0, 0.0, 0.0), bodies=[Body(name="a", mass=2.0, inertia=(0.3, 0.4, 0.5), **values)]
    )


def test_a_wrench_change_between_steps_is_integrated_exactly():
    """Force along body x without rotation: piecewise x = f t^2 / 2m, to round-off."""
    times = np.array([0.0, 0.1, 0.25, 0.3, 1.0])
    changes = [WrenchSpan(0.1, 0.3, "a", (0, 0, 0, 4.0, 0, 0))]
    trajectory, _ = follow(constant_push(), times, changes)
    assert trajectory.position[:, 0, 0] == pytest.approx([0.0, 0.0, 0.15**2, 0.2**2, 0.2**2 + 0.4 * 0.7], abs=1e-14)
    assert trajectory.twist[-1, 0] == pytest.approx([0, 0, 0, 0.4, 0, 0], abs=1e-14)


def test_a_wrench_in_body_axes_rotates_with_the_body():
    """Constant spin n and force along body x: rddot = f/m (cos nt, sin nt, 0)."""
    spin, a = 3.0, 2.0
    scene = constant_push(angular_velocity=(0, 0, spin))
    times = np.linspace(0.0, 2.0, 21)
    trajectory, _ = follow(scene, times, [WrenchSpan(0.0, math.inf, "a", (0, 0, 0, 2.0 * a, 0, 0))])
    exact = a / spin**2 * np.stack([1.0 - np.cos(spin * times), spin * times - np.sin(spin * times)], axis=1)
    # Tolerance 1e-13 per step of some ten steps, over values up to 1.
    assert np.abs(trajectory.position[:, 0, :2] - exact).max() <= 5e-12


@pytest.mark.parametrize("kind", mechanisms.KINDS)
def test_joint_residuals_match_their_time_derivatives(kind):
    """g, gdot, gddot = A a + ... against central differences along a motion that violates g = 0.

    Both bodies move by r = r0 + v t + a t^2 / 2 and turn about a fixed axis of their own at
    w t + b t^2 / 2. Differences of step 1e-4 leave 1e-8 of third and fourth derivatives of some
    ten, and round-off 1e-16 / 1e-8 of the second difference: 1e-6 covers both.
    """
    rng = np.random.default_rng(4)
    scene = mechanisms.mechanism(rng, [("world", "a", "spherical"), ("a", "b", kind)], springs=0)
    scene = scene.model_copy(update={"joints": scene.joints[1:]})
    start, _ = initial_state(scene)
    system, angle, _ = build_system(scene, start)
    axis, (w, b), (v, a) = (*rng.normal(size=(1, 2, 3)), rng.normal(size=(2, 2)), rng.normal(size=(2, 2, 3)))
    axis /= np.linalg.norm(axis, axis=1)[:, None]
    k = len(system.equations.kind)

    def at(t):
        """(A, (g, gdot, gddot without a)) at time t, and the accelerations."""
        pose, twist = start.copy(), np.zeros((2, 6))
        for i in range(2):
            turn = Rotation.from_rotvec((w[i] * t + b[i] * t * t / 2) * axis[i]).as_matrix()
            pose[i, :9] = (start[i, :9].reshape(3, 3) @ turn).ravel()
            pose[i, 9:] += v[i] * t + a[i] * t * t / 2
            twist[i] = (*((w[i] + b[i] * t) * axis[i]), *(pose[i, :9].reshape(3, 3).T @ (v[i] + a[i] * t)))
        rows, gap, frame = np.zeros((k, 24)), np.zeros((3, k)), np.zeros((3, FRAME))
        place(_to_state(pose, twist).reshape(2, 13), frame)
        joint_equations(system.equations, frame, angle_at(t), np.zeros((3, 0)), rows, gap)
        return rows, gap

    def angle_at(t):
        """Angle of a screw: its rate z . (w_b - w_a) integrated by Gauss's rule."""
        if not len(angle):
            return angle
        nodes, weights = np.polynomial.legendre.leggauss(6)
        total = 0.0
        for node, weight in zip(nodes, weights):
            s = t * (1 + node) / 2
            turned = [
                Rotation.from_matrix(start[i, :9].reshape(3, 3))
                * Rotation.from_rotvec((w[i] * s + b[i] * s * s / 2) * axis[i])
                for i in range(2)
            ]
            spin = [turned[i].apply((w[i] + b[i] * s) * axis[i]) for i in range(2)]
            z = turned[0].apply(scene.joints[0].parent_frame.pose[:3, 2])
            total += weight * t / 2 * (z @ (spin[1] - spin[0]))
        return angle + total

    h, t = 1e-4, 0.1
    (rows, now), (_, before), (_, after) = at(t), at(t - h), at(t + h)
    # Rows have (rddot, omegadot) of parent and child, world axes; the world, which is at rest, has index 2.
    frames = [
        Rotation.from_matrix(start[i, :9].reshape(3, 3)) * Rotation.from_rotvec(t * (w[i] + b[i] * t / 2) * axis[i])
        for i in range(2)
    ]
    moving = [np.concatenate([a[i], frames[i].apply(b[i] * axis[i])]) for i in range(2)] + [np.zeros(6)]
    acceleration = np.concatenate([moving[i] for i in system.equations.body[0]])
    assert np.abs(now[1]).max() > 0.1
    assert np.abs((after[0] - before[0]) / (2 * h) - now[1]).max() <= 1e-6
    assert np.abs((after[1] - before[1]) / (2 * h) - rows @ acceleration - now[2]).max() <= 1e-6
    assert np.abs(at(0.0)[1][0]).max() <= 1e-14


def test_distance_of_two_poses():
    """Rotation by 0.3 rad and translation by 0.2 m; the attitude distance of a half turn is 2."""

    def still(angle, x):
        c, s = math.cos(angle), math.sin(angle)
        return Trajectory(
            np.zeros(1),
            np.array([[[[1, 0, 0], [0, c, -s], [0, s, c]]]]),
            np.array([[[x, 0.0, 0.0]]]),
            np.full((1, 1, 6), x),
        )

    apart = distance(still(0.1, 0.3), still(0.4, 0.1))
    assert apart.angle[0, 0] == pytest.approx(0.3, abs=1e-15)
    assert apart.attitude[0, 0] == pytest.approx(2.0 * math.sin(0.15), abs=1e-15)
    assert apart.position[0, 0] == pytest.approx(0.2, abs=1e-15)
    assert apart.angular[0, 0] == apart.linear[0, 0] == pytest.approx(0.2 * math.sqrt(3))
    assert distance(still(0.0, 0), still(math.pi, 0)).attitude[0, 0] == pytest.approx(2.0)


def test_evaluation_in_pieces_is_bit_identical():
    """Times split over several calls, across a wrench change."""
    scene = constant_push()
    layout = make_layout(scene)
    pose, twist = initial_state(layout.centred)
    changes = [WrenchSpan(0.35, math.inf, "a", (0.1, 0.2, 0.0, 1.0, 0.0, 0.0))]
    times = np.linspace(0.0, 1.0, 41)
    whole, known = integrate(scene, pose, twist, times, changes)
    reference = Reference(scene, pose, twist, changes, end=1.0)
    parts = [reference.at(part) for part in np.split(times, [1, 7, 14, 15, 40])]
    for k, name in enumerate(("rotation", "position", "twist"), 1):
        assert np.array_equal(np.concatenate([part[k] for part, _ in parts]), whole[k]), name
    assert np.array_equal(np.concatenate([part.angle for _, part in parts]), known.angle)
    with pytest.raises(SimulationError, match="limit of steps, 1"):
        Reference(scene, pose, twist, changes, end=1.0, most_steps=1).at(times)
    limited = Reference(scene, pose, twist, changes, end=1.0, most_steps=reference.steps - 1)
    part, apart = limited.up_to_limit(times)
    k = len(part.times)
    assert 1 < k < 41 and len(limited.up_to_limit(times[k:])[0].times) == 0
    assert np.array_equal(part.position, whole.position[:k])
    assert np.array_equal(apart.angle, known.angle[:k])


def test_invalid_arguments_are_refused():
    scene = constant_push()
    with pytest.raises(ValueError, match="times must increase"):
        follow(scene, [0.2, 0.1])
    pushed = [WrenchSpan(0.0, math.inf, "a", (math.inf,) + (0.0,) * 5)]
    with pytest.raises(SimulationError, match="not finite"):
        follow(scene, [1.0], pushed)
