# SPDX-License-Identifier: Apache-2.0
"""Closed-loop mechanisms against equations of motion in minimal coordinates.

Each reference is written down from the drawing of the mechanism, with angles and lengths only, and
integrated by SciPy to 1e-10 or better; it shares nothing with the engine, not even the scene's
numbers. Tolerances: the error of order 4 at this step, measured, times three.
"""

import mechanisms
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from liegroup_core import Scene, Simulation, load_scene
from liegroup_core.joints.linkage import inverse
from liegroup_core.lie.groups import SO3
from liegroup_core.scene import Body, Frame, Joint
from liegroup_core.scene.library import four_bar_windows
from liegroup_core.scene.shapes import Rod

G = 9.81


def solved(rate, start, times, method="DOP853", rtol=1e-12, atol=1e-13):
    """Solution (len(times), n) of the initial value problem y' = rate(y), by SciPy."""
    solution = solve_ivp(
        lambda t, y: rate(y), (0.0, times[-1]), start, method=method, rtol=rtol, atol=atol, t_eval=times
    )
    assert solution.success
    return solution.y.T


def sampled(scene, step, times, **settings):
    """Samples of a simulation of the scene at these times (s)."""
    simulation = Simulation(scene, step=step, **{"method": "rkmk4"} | settings)
    samples = []
    for time in times:
        simulation.advance(round(time / step) - simulation.steps)
        samples.append(simulation.sample())
    return samples


def angle(pose):
    """Rotation angle about z of a pose in the x-y plane, rad."""
    return np.arctan2(pose[1, 0], pose[0, 0])


def turn(difference):
    """The angle wrapped to (-pi, pi]."""
    return (difference + np.pi) % (2.0 * np.pi) - np.pi


# ---------------------------------------------------------------- planar four-bar


def four_bar(q):
    """Pin C of the elbow-up branch, and rates of coupler and rocker for a unit crank rate.

    Crank 0.5, the other bars and the ground 1; numbers of the plane are complex.
    """
    B, D = 0.5 * np.exp(1j * q), 1.0
    half = (D - B) / 2.0
    C = B + half + 1j * half / abs(half) * np.sqrt(1.0 - abs(half) ** 2)
    # i 0.5 e^iq + i w2 (C - B) = i w3 (C - D)
    (a, c), (b, d) = ((C - B).real, (C - B).imag), ((C - D).real, (C - D).imag)
    w2, w3 = np.linalg.solve([[a, -b], [c, -d]], [-B.real, -B.imag])
    return C, w2, w3


def four_bar_mass(q):
    """Coefficient a of the kinetic energy a q'^2 / 2: uniform bars of 50 mm square section."""
    C, w2, w3 = four_bar(q)
    B = 0.5 * np.exp(1j * q)
    about_middle = [m * (length**2 + 0.05**2) / 12.0 for m, length in ((0.5, 0.5), (1, 1), (1, 1))]
    middle = 1j * B + 1j * w2 * (C - B) / 2.0
    return (
        about_middle[0] + 0.5 * 0.25**2 + about_middle[1] * w2**2 + abs(middle) ** 2 + (about_middle[2] + 0.25) * w3**2
    )


def four_bar_reference(times):
    """Crank angle and rate from conservation of kinetic energy (no gravity)."""
    energy = four_bar_mass(np.pi / 2) * (10.0 * np.pi) ** 2
    q = solved(lambda y: [np.sqrt(energy / four_bar_mass(y[0]))], [np.pi / 2], times)[:, 0]
    return q, np.sqrt(energy / np.array([four_bar_mass(x) for x in q]))


def test_the_four_bar_starts_with_a_closed_loop():
    scene = load_scene("four_bar")
    C, w2, w3 = four_bar(np.pi / 2)
    assert C == pytest.approx(0.870810 + 0.991620j, abs=1e-6)
    crank, coupler, rocker = scene.bodies
    corner = coupler.pose @ (0.5, 0, 0, 1)
    # a pose of size 1 written as a quaternion and read again: a few round-offs
    np.testing.assert_allclose(corner, [C.real, C.imag, 0, 1], atol=2e-15)
    np.testing.assert_allclose(rocker.pose @ (0.5, 0, 0, 1), corner, atol=2e-15)
    rate = 10.0 * np.pi
    for body, w, v in (
        (crank, 1.0, 1j * 0.25j),
        (rocker, w3, 1j * w3 * (C - 1.0) / 2),
        (coupler, w2, 1j * 0.5j + 1j * w2 * (C - 0.5j) / 2),
    ):
        velocity = body.rotation @ body.linear_velocity
        expected = [rate * v.real, rate * v.imag, 0.0]
        np.testing.assert_allclose(velocity, expected, atol=1e-13 * rate)
        np.testing.assert_allclose(body.angular_velocity, [0, 0, rate * w], atol=1e-13 * rate)
    # what the crank was given is kept to the bit
    assert crank.position == (0.0, 0.25, 0.0) and crank.rotation_vector == (0, 0, np.pi / 2)


def test_four_bar_follows_its_energy_integral():
    q, rate = four_bar_reference([0.25, 0.5, 1.0])
    # the one-freedom quadrature done elsewhere, in twelve digits
    assert turn(q[-1]) == pytest.approx(-0.765225378176, abs=1e-9)
    assert rate[-1] == pytest.approx(31.566340728, abs=1e-8)
    samples = sampled(load_scene("four_bar"), 1e-4, [0.25, 0.5, 1.0])
    for sample, angle_then, rate_then in zip(samples, q, rate):
        assert abs(turn(angle(sample.poses["crank"]) - angle_then)) <= 6e-7
        assert sample.twists["crank"][2] == pytest.approx(rate_then, abs=1e-5)
        # the one row that is left out keeps nothing: the motion stays in the plane by itself
        for pose in sample.poses.values():
            assert abs(pose[2, 3]) == 0.0 and abs(pose[2, 2] - 1.0) <= 1e-15


def test_four_bar_eliminates_one_redundant_row():
    assert Simulation(load_scene("four_bar"), method="rkmk4").layout.dropped_rows == [("coupler_rocker", "vz")]


# ---------------------------------------------------------------- rows of four-bar windows


@pytest.mark.parametrize("n", [1, 2, 4])
@pytest.mark.turn(3)
def test_windows_before_and_after_the_first_singular_pose(n):
    """At 0.5 s the cranks are upright; by 1 s they have passed the collinear pose."""
    times = [0.5, 1.0]
    scene = load_scene("n_four_bar") if n == 2 else four_bar_windows(n)
    reference = mechanisms.windows_motion(n, times)
    assert reference[0][0] > 0.0 > reference[1][0]
    for sample, (q, rate) in zip(sampled(scene, 1e-3, times), reference):
        for k in range(n + 1):
            # a crank's x axis is world x at the start, when its angle is a right one
            assert abs(turn(angle(sample.poses[f"crank{k}"]) + np.pi / 2 - q)) <= 1e-9
            assert sample.twists[f"crank{k}"][2] == pytest.approx(rate, abs=1e-8)
        assert sample.constraint_residual <= 1e-9


@pytest.mark.parametrize("n", [1, 2, 4])
def test_windows_pass_their_singular_pose_repeatedly(n):
    """Each passage amplifies constraint drift; projection after each step removes it."""
    times = [2.0, 4.0, 6.0, 8.0, 10.0]
    samples = sampled(four_bar_windows(n), 1e-3, times, stabilisation="projection")
    for sample, (q, _) in zip(samples, mechanisms.windows_motion(n, times)):
        for k in range(n + 1):
            assert abs(turn(angle(sample.poses[f"crank{k}"]) + np.pi / 2 - q)) <= 1e-7
        assert sample.constraint_residual <= 1e-12


@pytest.mark.parametrize("n", [2, 5])
@pytest.mark.turn(3)
def test_each_window_eliminates_three_redundant_rows(n):
    """A planar loop of four revolute joints has three redundant rows, all out of plane."""
    dropped = Simulation(four_bar_windows(n), method="rkmk4").layout.dropped_rows
    assert len(dropped) == 3 * n
    assert {row for _, row in dropped} == {"wx", "wy", "vz"}


# ---------------------------------------------------------------- Bricard's linkage

CORNERS = np.array([[0, 0, 0], [1, 0, 0], [1, -1, 0], [1, -1, 1], [0, -1, 1], [0, 0, 1.0]])
AXES = np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 0, 0.0]])
ALONG, ACROSS = 2 * 0.1**2 / 12, (1 + 0.1**2) / 12  # kg m^2, of a box of 1 x 0.1 x 0.1 m


def bricard(a, b):
    """Corners and joint axes, (6, 3) each, for joint angles a, b, a, b, a."""
    R, corner = np.eye(3), np.zeros(3)
    corners, axes = [corner], []
    for i in range(5):
        axes.append(R @ AXES[i])
        R = R @ Rotation.from_rotvec((b if i % 2 else a) * AXES[i]).as_matrix()
        corner = corner + R @ (CORNERS[i + 1] - CORNERS[i])
        corners.append(corner)
    axes.append(R @ AXES[5])
    return np.array(corners), np.array(axes)


def bricard_tangent(a, b):
    """Unit tangent (da, db) of the curve (1 + sin a) (1 + sin b) = 1."""
    across = np.array([np.cos(a) * (1 + np.sin(b)), (1 + np.sin(a)) * np.cos(b)])
    return np.array([-across[1], across[0]]) / np.hypot(*across)


def bricard_energies(a, b):
    """Twice the kinetic energy and the power of gravity, at unit speed along the tangent."""
    corners, axes = bricard(a, b)
    da, db = bricard_tangent(a, b)
    omega, velocity = np.zeros(3), np.zeros(3)  # of the last rod, and of its first corner
    kinetic = power = 0.0
    for i in range(5):
        omega = omega + (db if i % 2 else da) * axes[i]
        along = corners[i + 1] - corners[i]
        middle = velocity + np.cross(omega, along / 2)
        velocity = velocity + np.cross(omega, along)
        spin = omega @ along
        kinetic += middle @ middle + ACROSS * (omega @ omega - spin**2) + ALONG * spin**2
        power -= G * middle[1]
    return kinetic, power


def bricard_rate(y):
    """Time derivative of (a, b, tangential speed), by Lagrange's equation in one coordinate."""
    a, b, speed = y
    da, db = bricard_tangent(a, b)
    kinetic, power = bricard_energies(a, b)
    h = 1e-3  # fourth order: right to 1e-12
    ahead, behind, far_ahead, far_behind = (bricard_energies(a + s * h * da, b + s * h * db)[0] for s in (1, -1, 2, -2))
    slope = (8 * (ahead - behind) - (far_ahead - far_behind)) / (12 * h)
    return [speed * da, speed * db, (power - 0.5 * slope * speed**2) / kinetic]


@pytest.mark.turn(3)
def test_bricard_follows_lagranges_equation():
    """10 s, two revolutions: constraints hold and the energy is conserved."""
    times = [0.5, 1.25, 2.0, 4.0, 6.0, 8.0, 10.0]
    reference = solved(bricard_rate, [0.0, 0.0, 0.0], times)
    simulation = Simulation(load_scene("bricard"), method="rkmk4")
    energy = simulation.sample().energy
    for time, (a, b, _) in zip(times, reference):
        corners, axes = bricard(a, b)
        # the reference itself: the last rod ends in its hinge to ground, and turns in it
        np.testing.assert_allclose(corners[5], CORNERS[5], atol=1e-10)
        np.testing.assert_allclose(axes[5], AXES[5], atol=1e-10)
        simulation.advance(round(time / 1e-3) - simulation.steps)
        sample = simulation.sample()
        for i in range(5):
            tip = sample.poses[f"rod{i + 1}"] @ (1, 0, 0, 1)
            np.testing.assert_allclose(tip[:3], corners[i + 1], atol=1e-8)
        assert sample.constraint_residual <= 1e-9
        assert abs(sample.energy - energy) <= 1e-9 * 30.0
    assert simulation.singular_solves == 0


@pytest.mark.turn(3)
def test_bricard_eliminates_a_row_that_is_always_redundant():
    """The same for rotated and reflected linkages, and for another order of the joints."""
    scene = load_scene("bricard")
    for joints in (scene.joints, scene.joints[::-1], scene.joints[3:] + scene.joints[:3]):
        layout = Simulation(scene.remade(joints=joints), method="rkmk4").layout
        [(_, row)] = layout.dropped_rows
        # Of all entries of the vanishing combination of rows only those of wx at hinge 1, of wy at
        # hinge 6 and of wy at the others, across both rods, do not change their sign on the way.
        assert row == "wy"


# ---------------------------------------------------------------- Bennett's linkage


def test_bennett_linkage_follows_its_closed_form():
    """Four revolute joints, mobile because sin(twist) / length is the same for all links.

    With the turns a and b of two neighbouring hinges tan(a / 2) tan(b / 2) is kept. 20 rows of
    rank 17; without gravity the energy is kept as well.
    """
    lengths = [1.0, 0.7, 1.0, 0.7]
    twists = np.array([0.7, np.arcsin(0.7 * np.sin(0.7))] * 2)
    kept = np.sin((twists[1] + twists[0]) / 2) / np.sin((twists[1] - twists[0]) / 2)
    near, far = (
        [Frame()] * 4,
        [Frame(position=(length, 0, 0), rotation_vector=(twist, 0, 0)) for length, twist in zip(lengths, twists)],
    )
    first = 1.0
    turns = [first, 2.0 * np.arctan(kept / np.tan(first / 2))]
    pose, bodies = far[0].pose, []
    for k, angle_there in ((1, turns[1]), (2, -turns[0]), (3, -turns[1])):
        pose = pose @ Frame(rotation_vector=(0, 0, angle_there)).pose
        bodies.append(
            Body(
                name=f"link{k}",
                position=pose[:3, 3],
                quaternion=SO3.to_quaternion(pose[:3, :3]),
                shape=Rod(axis=(1, 0, 0), length=lengths[k], radius=0.05, mass=1.0, position=(lengths[k] / 2, 0, 0)),
            )
        )
        pose = pose @ far[k].pose
    names = ["world", "link1", "link2", "link3"]
    joints = [
        Joint(
            name=f"hinge{k}",
            type="revolute",
            parent=names[k],
            child=names[k + 1],
            parent_frame=far[k],
            child_frame=near[k],
            rate=None if k else 6.0,
        )
        for k in range(3)
    ]
    joints.append(
        Joint(name="hinge3", type="revolute", parent="world", child="link3", parent_frame=near[3], child_frame=far[3])
    )
    simulation = Simulation(
        Scene(name="bennett", gravity=(0, 0, 0), assemble=True, bodies=bodies, joints=joints), method="rkmk4"
    )
    assert len(simulation.layout.dropped_rows) == 3
    energy = simulation.sample().energy
    for _ in range(10):  # half a dozen turns
        simulation.advance(200)
        sample = simulation.sample()
        one = angle(inverse(far[0].pose) @ sample.poses["link1"])
        other = angle(inverse(sample.poses["link1"] @ far[1].pose) @ sample.poses["link2"])
        # the hinges between links have drifted by 2e-6 by then; 10 for where a tangent is large
        assert np.tan(one / 2) * np.tan(-other / 2) == pytest.approx(kept, rel=2e-5)
        assert sample.energy == pytest.approx(energy, rel=1e-6)
    assert simulation.singular_solves == 0


# ---------------------------------------------------------------- Andrews' squeezing mechanism


def squeezer_chains(q):
    """Body frames, centres of mass and point E: {body: terms [(length, angle index)]}.

    A term is length e^(i q[index]); what a place is made of also gives its slope.
    """
    A, B = -0.06934 - 0.00227j, -0.03635 + 0.03273j
    k1, k2, k3, k4, k5, k6, k7 = range(7)
    F, G_, H = (0.007, k1), (0.04, k5), (-0.04j, k7)
    centres = [
        [0, (0.00092, k1)],
        [0, F, (-0.0115, k2)],
        [B, (0.01043 - 0.01874j, k3)],
        [A, G_, (-0.00579j, k4)],
        [A, (0.02308 + 0.00916j, k5)],
        [A, H, (0.00579, k6)],
        [A, (-0.00449 - 0.01228j, k7)],
    ]
    E = [[0, F, (-0.028, k2)], [B, (-0.035j, k3)], [A, G_, (-0.02j, k4)], [A, H, (0.02, k6)]]
    D = [B, (0.02 - 0.018j, k3)]
    return centres, E, D


def place(terms, q):
    """Position, gradient (n,) and second derivatives (n,) by q, as complex numbers."""
    z, slope, second = terms[0] + 0j, np.zeros(len(q), complex), np.zeros(len(q), complex)
    for length, k in terms[1:]:
        arm = length * np.exp(1j * q[k])
        z, slope[k], second[k] = z + arm, slope[k] + 1j * arm, second[k] - arm
    return z, slope, second


def squeezer_rate(y):
    """Time derivative of the seven angles and rates: M q'' + J^T lambda = f, J q'' = -J' q'."""
    q, rate = y[:7], y[7:]
    mass = [0.04325, 0.00365, 0.02373, 0.00706, 0.07050, 0.00706, 0.05498]
    moment = [2.194e-6, 4.410e-7, 5.255e-6, 5.667e-7, 1.169e-5, 5.667e-7, 1.912e-5]
    centres, ends, D = squeezer_chains(q)
    M, f = np.diag(moment), np.zeros(7)
    for m, terms in zip(mass, centres):
        _, slope, second = place(terms, q)
        M = M + m * (slope.conj()[:, None] * slope).real
        f -= m * (slope.conj() * (second @ rate**2)).real
    f[0] += 0.033
    z, slope, _ = place(D, q)
    line = z - (0.014 + 0.072j)
    f -= 4530.0 * (1.0 - 0.07785 / abs(line)) * (slope.conj() * line).real
    places = [place(terms, q) for terms in ends]
    J, bias = [], []
    for other in places[1:]:
        gap, curve = places[0][1] - other[1], (places[0][2] - other[2]) @ rate**2
        J += [gap.real, gap.imag]
        bias += [-curve.real, -curve.imag]
    J = np.array(J)
    system = np.block([[M, J.T], [J, np.zeros((6, 6))]])
    scale = np.array([1e3] * 7 + [1e-3] * 6)  # the moments are of 1e-6
    solution = np.linalg.solve(scale[:, None] * system * scale, scale * np.concatenate([f, bias]))
    return np.concatenate([rate, (scale * solution)[:7]])


SQUEEZER_START = (
    -0.0617138900142764496,
    0.0,
    0.455279819163070380,
    0.222668390165885885,
    0.487364979543842551,
    -0.222668390165885885,
    1.23054744454982119,
)


def squeezer_angles(angles):
    """Angles of the body frames from the seven angles of the literature."""
    beta, theta, gamma, phi, delta, omega, epsilon = angles
    return np.array([beta, beta + theta, gamma, phi + delta, delta, omega + epsilon, epsilon])


# Test set for initial value problem solvers, problem Andrews, at t = 0.03 s; beta and theta turn
# two and a half times.
SQUEEZER_END = (
    15.81077119629904,
    -15.75637105984298,
    0.04082224013073101,
    -0.5347301163226948,
    0.5244099658805304,
    0.5347301163226948,
    1.048080741042263,
)


@pytest.mark.turn(3)
def test_andrews_squeezer_against_its_index_one_equations():
    times = [0.01, 0.02, 0.03]
    reference = solved(
        squeezer_rate, np.concatenate([squeezer_angles(SQUEEZER_START), np.zeros(7)]), times, rtol=1e-11, atol=1e-13
    )
    np.testing.assert_allclose(reference[-1][:7], squeezer_angles(SQUEEZER_END), atol=1e-6)
    scene = load_scene("andrews_squeezer")
    for body, expected in zip(scene.bodies, squeezer_angles(SQUEEZER_START)):
        assert angle(body.pose) == pytest.approx(expected, abs=1e-12)
    for sample, expected in zip(sampled(scene, 2e-6, times), reference):
        for k, (body, q) in enumerate(zip(scene.bodies, expected)):
            assert abs(turn(angle(sample.poses[body.name]) - q)) <= 1e-6
            assert sample.twists[body.name][2] == pytest.approx(expected[7 + k], abs=1e-2)


# ---------------------------------------------------------------- spatial slider-crank


def slider_crank(q, universal):
    """Slider position, its derivative, and angular velocity of the rod, at unit crank rate."""
    B = np.array([0.0, 0.1 - 0.08 * np.sin(q), 0.12 + 0.08 * np.cos(q)])
    dB = np.array([0.0, -0.08 * np.cos(q), -0.08 * np.sin(q)])
    x = np.sqrt(0.3**2 - B[1] ** 2 - B[2] ** 2)
    dx = -(B @ dB) / x
    along = (np.array([x, 0, 0]) - B) / 0.3
    across = np.cross(along, (np.array([dx, 0, 0]) - dB) / 0.3)  # no turn about the rod itself
    if universal:
        # The slider does not turn and holds the first axis, x; the second one, across x and the
        # rod, is fixed in the rod. It turns about both, and not about their common normal.
        normal = np.cross([1, 0, 0], np.cross([1, 0, 0], along))
        across = across - (normal @ across) / (normal @ along) * along
    return x, dx, along, across, B, dB


def slider_crank_energies(q, universal):
    """Twice the kinetic energy at unit crank rate, and the potential energy."""
    x, dx, along, omega, B, dB = slider_crank(q, universal)
    spin = omega @ along
    middle = (dB + np.array([dx, 0, 0])) / 2
    kinetic = (
        1e-4 + 0.12 * 0.04**2 + 2.0 * dx**2 + 0.5 * middle @ middle + 4e-3 * (omega @ omega - spin**2) + 4e-4 * spin**2
    )
    return kinetic, G * (0.12 * (0.12 + 0.04 * np.cos(q)) + 0.5 * B[2] / 2)


def slider_crank_reference(times, universal=True):
    """Crank angle from conservation of energy."""
    kinetic, potential = slider_crank_energies(0.0, universal)
    energy = 0.5 * kinetic * 6.0**2 + potential

    def rate(y):
        kinetic, potential = slider_crank_energies(y[0], universal)
        return [np.sqrt(2.0 * (energy - potential) / kinetic)]

    return solved(rate, [0.0], times)[:, 0]


@pytest.mark.turn(3)
def test_slider_crank_follows_its_energy_integral():
    scene = load_scene("slider_crank")
    rod, slider = scene.bodies[1:]
    # given with the benchmark for a crank rate of 6 rad/s
    np.testing.assert_allclose(rod.rotation @ rod.angular_velocity, [1.92, -0.96, 0.48], atol=1e-12)
    np.testing.assert_allclose(rod.rotation @ rod.linear_velocity, [0.12, -0.24, 0.0], atol=1e-12)
    np.testing.assert_allclose(slider.linear_velocity, [0.24, 0.0, 0.0], atol=1e-12)
    times = [0.5, 1.0, 3.0]
    for sample, q in zip(sampled(scene, 2.5e-4, times), slider_crank_reference(times)):
        crank = sample.poses["crank"]
        assert abs(turn(np.arctan2(crank[2, 1], crank[1, 1]) - q)) <= 1e-6
        assert sample.positions["slider"][0] == pytest.approx(slider_crank(q, True)[0], abs=1e-6)


# ---------------------------------------------------------------- flyball governor


def governor_rate(y):
    """Derivative of (arm angle below the horizontal, slider height) and rates; spin is constant."""
    alpha, s, dalpha, ds = y
    com, mass, along, across = 5.15 / 5.3, 5.3, 5e-6, 0.3 * (1 + 1e-4) / 12
    across += 0.3 * (com - 0.5) ** 2 + 5.0 * (1.0 - com) ** 2

    def about_shaft(alpha):
        return (
            0.3 * 2e-4 / 12
            + 3.0 * 0.02 / 12
            + 2 * (mass * (0.05 + com * np.cos(alpha)) ** 2 + along * np.sin(alpha) ** 2 + across * np.cos(alpha) ** 2)
        )

    spin = about_shaft(np.pi / 6) * 2 * np.pi / about_shaft(alpha)
    slope = 4 * (
        -mass * (0.05 + com * np.cos(alpha)) * com * np.sin(alpha) + (along - across) * np.sin(alpha) * np.cos(alpha)
    )
    line = np.array([0.5 * np.cos(alpha), 1.0 - 0.5 * np.sin(alpha) - s])
    by_alpha = np.array([-0.5 * np.sin(alpha), -0.5 * np.cos(alpha)])
    length = np.hypot(*line)
    stretch = line @ (by_alpha * dalpha - np.array([0.0, ds])) / length
    pull = (8e5 * (length - 0.5) + 4e4 * stretch) * line / length
    return [
        dalpha,
        ds,
        (0.25 * slope * spin**2 + mass * G * com * np.cos(alpha) - pull @ by_alpha) / (across + mass * com**2),
        -G + 2 * pull[1] / 3.0,
    ]


@pytest.mark.turn(3)
def test_flyball_governor_against_minimal_coordinates():
    times = [0.5, 1.0, 2.0]
    reference = solved(governor_rate, [np.pi / 6, 0.5, 0.0, 0.0], times, method="Radau", rtol=1e-10, atol=1e-12)
    scene = load_scene("flyball_governor")
    for body in scene.bodies:
        np.testing.assert_allclose(body.rotation @ body.angular_velocity, [0, 0, 2 * np.pi], atol=1e-12)
    for sample, (alpha, s, _, _) in zip(sampled(scene, 5e-5, times), reference):
        height = sample.positions["slider"][2]
        assert height == pytest.approx(s, abs=1e-7)
        for arm in ("arm1", "arm2"):
            assert np.arcsin(-sample.poses[arm][2, 0]) == pytest.approx(alpha, abs=1e-7)
        assert sample.spatial_momentum[2] == pytest.approx(sampled(scene, 5e-5, [0.0])[0].spatial_momentum[2], rel=1e-9)


# ------------------------------------------------------- spatial four-bar


def test_a_rod_between_two_balls_does_not_spin():
    """Hinge, ball, ball, hinge, from rest: no moment acts on the coupler about itself.

    Its moment of inertia there is a 600th of that across it, so a force beside its axis would show.
    """
    ends = {
        "crank": ((0.0, 0.0, 0.0), (0.2, 0.0, 0.0)),
        "coupler": ((0.2, 0.0, 0.0), (0.6, 0.3, 0.5)),
        "rocker": ((0.6, 0.3, 0.0), (0.6, 0.3, 0.5)),
    }
    starts = {name: np.array(start) for name, (start, _) in ends.items()}
    along = {name: np.subtract(end, start) for name, (start, end) in ends.items()}
    bodies = []
    for name, line in along.items():
        length = np.linalg.norm(line)
        axis = np.outer(line, line) / length**2
        J = length**2 / 12 * (np.eye(3) - axis) + 0.02**2 / 6 * axis
        bodies.append(
            Body(
                name=name, mass=1.0, position=starts[name] + line / 2, inertia=J[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
            )
        )
    half = {name: line / 2 for name, line in along.items()}
    joints = [
        ("revolute", "world", "crank", Frame(position=-half["crank"], axis=(0.3, 0.2, 1.0))),
        ("spherical", "crank", "coupler", Frame(position=-half["coupler"])),
        ("revolute", "world", "rocker", Frame(position=-half["rocker"], axis=(0.2, 1.0, 0.0))),
        ("spherical", "coupler", "rocker", Frame(position=half["rocker"])),
    ]
    scene = Scene(
        name="spatial_four_bar",
        gravity=(0.0, 0.0, -G),
        bodies=bodies,
        joints=[
            Joint(name=f"{a}_{b}", type=kind, parent=a, child=b, child_frame=frame) for kind, a, b, frame in joints
        ],
    )
    axis = along["coupler"] / np.linalg.norm(along["coupler"])
    fastest, spin = 0.0, 0.0
    for sample in sampled(scene, 5e-3, np.arange(0.05, 2.01, 0.05), group="relative"):
        omega = sample.twist[1, :3]
        fastest, spin = max(fastest, np.abs(omega).max()), max(spin, abs(omega @ axis))
    assert fastest > 0.5
    assert spin < 1e-8
