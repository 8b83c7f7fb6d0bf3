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
from scipy.spatial.transform import Rotation

from liegroup_core.errors import SimulationError
from liegroup_core.layout import make_layout
from liegroup_core.mechanism.body_model import initial_state
from liegroup_core.reference import Reference, Trajectory, WrenchSpan, distance, integrate
from liegroup_core.reference.equations import joint_equations
from liegroup_core.reference.system import build_system
from liegroup_core.reference.trajectory import _to_state
from liegroup_core.scene.description import Body, Frame, Joint, Scene, SpringDamper
from liegroup_core.scene.load import load_scene

FREE_R_1 = [
    [0.67948695072138193, 0.15978651402103335, 0.71607663956895312],
    [0.18508239274714739, 0.90710109646680989, -0.37803717897014038],
    [-0.70995914790525023, 0.3894045078394925, 0.5867896876905163],
]
FREE_W_1 = [0.44832395111839394, 0.83054914365814067, -0.0065366678179422367]
FREE_R_10 = [
    [0.19178161690691239, 0.77079260376254685, -0.60753483307669178],
    [0.85411011090955504, -0.436001649248976, -0.28354625776800601],
    [-0.48344154750976658, -0.46452268387789887, -0.74195885755494269],
]
FREE_W_10 = [0.90423322093210655, -0.092267277872608393, -0.3331830261298791]
LAGRANGE_R_1 = [
    [0.22929964080360759, 0.17334396409838604, 0.95779619170155087],
    [-0.76534074220468094, 0.64008859207056878, 0.067380580456872719],
    [-0.60139439891715374, -0.74849079113358131, 0.27943928238402867],
]
LAGRANGE_W_1 = [-0.82207810168270446, 150.0, -5.9232913481173362]
HEAVY_R_6 = [
    [0.72338819974053045, -0.25225153160076429, -0.6427119707001131],
    [-0.18843768873839291, 0.82340059951614024, -0.53525946061643169],
    [0.66422944073496695, 0.50831153589263489, 0.54810458175368647],
]
HEAVY_W_6 = [-0.0041293748192801087, -8.5248086858488045, -0.4237118796976931]
HEAVY_COM_6 = [0.36169409987026524, -0.09421884436919646, 0.33211472036748346]


def follow(scene, times, changes=()):
    """(trajectory, uncertainty) from the initial state of the scene."""
    return integrate(scene, *initial_state(scene), times, changes)


@pytest.mark.parametrize(
    "name, time, rotation, omega, bound",
    [
        ("free_body", 1.0, FREE_R_1, FREE_W_1, 1.6e-14),
        ("free_body", 10.0, FREE_R_10, FREE_W_10, 2.5e-13),
        ("lagrangian_top", 1.0, LAGRANGE_R_1, LAGRANGE_W_1, 1.3e-11),
        ("heavy_top", 6.0, HEAVY_R_6, HEAVY_W_6, 9.6e-11),
    ],
)
def test_golden_end_states(name, time, rotation, omega, bound):
    """Bound: error of another DOP853 run, plus 1e-13 for the round-off of about 1000 steps.

    omega differs by at most the error of R times the largest angular acceleration, below 700
    rad/s^2 for the tops (150 rad/s x 4.6 rad/s), so the same bound times 700.
    """
    trajectory, uncertainty = follow(load_scene(name), [time / 2.0, time])
    error = np.linalg.norm(trajectory.rotation[-1, 0] - rotation, 2)
    assert error <= bound + 1e-13
    assert np.linalg.norm(trajectory.twist[-1, 0, :3] - omega) <= 700.0 * (bound + 1e-13)
    # What it says about itself holds, down to the same round-off, and is small enough to judge
    # the best fourth-order runs by (4e-11 for the heavy top at h = 1e-4).
    assert error <= uncertainty.attitude[-1, 0] + 1e-13
    assert uncertainty.attitude[-1, 0] <= 4e-11


def test_position_of_the_heavy_top():
    """Centre of mass at 6 s: error of R times 0.5 m. The spherical joint holds to round-off."""
    trajectory, _ = follow(load_scene("heavy_top"), np.linspace(0.0, 6.0, 601))
    assert np.linalg.norm(trajectory.position[-1, 0] - HEAVY_COM_6) <= 9.6e-11
    pivot = trajectory.position[:, 0] - 0.5 * trajectory.rotation[:, 0, :, 0]
    assert np.abs(pivot).max() <= 1e-12  # measured 1.1e-13 with damped drift, 4e-11 without


def constant_push(joints=(), **values):
    """Scene of one body without gravity."""
    return Scene(
        name="pushed",
        gravity=(0.0, 0.0, 0.0),
        joints=joints,
        bodies=[Body(name="a", mass=2.0, inertia=(0.3, 0.4, 0.5), **values)],
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


def test_a_body_on_a_revolute_joint_under_constant_torque():
    """(I_z + m l^2) theta'' = torque, constant here: theta = a t^2 / 2."""
    hinge = Joint(name="hinge", type="revolute", parent="world", child="a", parent_frame=Frame(axis=(1.0, 2.0, 2.0)))
    scene = constant_push([hinge], position=(0.3, 0.0, -0.1))
    axis = np.array([1.0, 2.0, 2.0]) / 3.0
    arm = np.cross(axis, scene.bodies[0].position)
    inertia = axis @ np.diag(scene.bodies[0].inertia) @ axis + 2.0 * arm @ arm
    times = np.linspace(0.0, 1.5, 7)
    # The hinge takes up all of a torque but its part along the axis; the force has moment arm * f.
    trajectory, _ = follow(scene, times, [WrenchSpan(0.0, math.inf, "a", (*(0.7 * axis), 0, 0, 0))])
    rate = 0.7 / inertia
    angles = np.arccos(np.clip((np.trace(trajectory.rotation[:, 0], axis1=1, axis2=2) - 1) / 2, -1.0, 1.0))
    assert trajectory.twist[:, 0, :3] @ axis == pytest.approx(rate * times, abs=1e-12)
    assert angles == pytest.approx(0.5 * rate * times**2, abs=1e-7)  # arccos: sqrt of round-off
    assert trajectory.rotation[:, 0] @ axis == pytest.approx(np.tile(axis, (7, 1)), abs=1e-13)


def test_two_bodies_on_a_spring_damper_are_a_damped_oscillator():
    """Motion along a line: d'' = -(k (d - l0) + c d') / mu, closed form."""
    scene = Scene(
        name="pair",
        gravity=(0.0, 0.0, 0.0),
        bodies=[
            Body(name="a", mass=1.0, inertia=(1, 1, 1)),
            Body(name="b", mass=3.0, inertia=(1, 1, 1), position=(0.0, 1.2, 0.0)),
        ],
        forces=[
            SpringDamper(
                name="s",
                parent="a",
                parent_point=(0, 0, 0),
                child="b",
                child_point=(0, 0, 0),
                stiffness=40.0,
                damping=3.0,
                rest_length=1.0,
            )
        ],
    )
    times = np.linspace(0.0, 3.0, 31)
    trajectory, _ = follow(scene, times)
    decay = 3.0 / (2.0 * 0.75)
    frequency = math.sqrt(40.0 / 0.75 - decay**2)
    exact = 1.0 + 0.2 * np.exp(-decay * times) * (
        np.cos(frequency * times) + decay / frequency * np.sin(frequency * times)
    )
    gap = trajectory.position[:, 1, 1] - trajectory.position[:, 0, 1]
    assert np.abs(gap - exact).max() <= 1e-11  # tolerance 1e-13 a step, some tens of steps
    centre = (trajectory.position[:, 0] + 3.0 * trajectory.position[:, 1]) / 4.0
    assert np.abs(centre - [0.0, 0.9, 0.0]).max() <= 1e-13


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
    system, angle = build_system(scene, start)
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
        rows, gap = np.zeros((k, 12)), np.zeros((3, k))
        state = _to_state(pose, twist).reshape(2, 13)
        joint_equations(system.equations, state, angle_at(state, t), rows, gap)
        return rows, gap

    def angle_at(state, t):
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
    acceleration = np.concatenate([np.concatenate([a[i], b[i] * axis[i]]) for i in range(2)])
    assert np.abs(now[1]).max() > 0.1
    assert np.abs((after[0] - before[0]) / (2 * h) - now[1]).max() <= 1e-6
    assert np.abs((after[1] - before[1]) / (2 * h) - rows @ acceleration - now[2]).max() <= 1e-6
    assert np.abs(at(0.0)[1][0]).max() <= 1e-14


def test_a_closed_loop_with_redundant_rows_conserves_energy():
    """Planar four-bar of four revolute joints: 20 rows of rank 17."""

    def rod(name, start, end, **values):
        start, end = np.array(start), np.array(end)
        length = np.linalg.norm(end - start)
        return Body(
            name=name,
            mass=length,
            inertia=(1e-3, length**3 / 12, length**3 / 12),
            position=tuple((start + end) / 2),
            rotation_vector=(0, 0, math.atan2(*(end - start)[1::-1])),
            **values,
        )

    points = [(0.0, 0.0, 0.0), (0.0, 0.5, 0.0), (0.87081, 0.99162, 0.0), (1.0, 0.0, 0.0)]
    bodies = [rod(*args) for args in zip("abc", points, points[1:])]
    ends = [("world", "a"), ("a", "b"), ("b", "c")]
    joints = [
        Joint(
            name=f"j{i}",
            type="revolute",
            parent=p,
            child=c,
            child_frame=Frame(position=(-np.linalg.norm(np.subtract(*points[i : i + 2])) / 2, 0, 0)),
        )
        for i, (p, c) in enumerate(ends)
    ]
    joints.append(Joint(name="j3", type="revolute", parent="world", child="c", parent_frame=Frame(position=points[3])))
    scene = Scene(name="four_bar", gravity=(0.0, -9.81, 0.0), bodies=bodies, joints=joints)
    pose, twist = initial_state(scene)
    times = np.linspace(0.0, 2.0, 41)
    trajectory, uncertainty = integrate(scene, pose, twist, times)
    mass = np.array([body.mass for body in scene.bodies])
    inertia = np.array([body.inertia for body in scene.bodies])
    energy = (
        0.5 * np.einsum("ni,kni->k", inertia, trajectory.twist[..., :3] ** 2)
        + 0.5 * np.einsum("n,kni->k", mass, trajectory.twist[..., 3:] ** 2)
        + 9.81 * trajectory.position[..., 1] @ mass
    )
    moved = np.abs(trajectory.position - trajectory.position[0]).max()
    assert moved > 0.3  # it swings
    # Energies up to 15 J; the error of the state is the run's own uncertainty, of size 1e-11.
    assert np.abs(energy - energy[0]).max() <= 1e-9
    assert uncertainty.position.max() <= 1e-9
    assert np.abs(trajectory.position[..., 2]).max() <= 1e-12


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
    with pytest.raises(SimulationError, match="after 3 steps; compare a shorter time"):
        Reference(scene, pose, twist, changes, end=1.0, most_steps=3).at(times)
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
