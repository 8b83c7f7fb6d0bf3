# SPDX-License-Identifier: Apache-2.0
"""Closed-form rotations against 45-digit end states, Taylor series, and each other."""

import mpmath as mp
import numpy as np
import pytest
from golden import DIGITS

from liegroup_core.reference.elliptic import free_body, heavy_top, to_floats

INERTIA, OMEGA = ("0.9144", "1.098", "1.66"), ("0.45549", "0.82623", "0.03476")
TOP = ("15.234375", "0.46875", 15, (0, 1, 0), ("0", "0", "-9.81"))
TOP_OMEGA = ("0", "150", "-4.61538")
START = np.eye(3).tolist()


def numbers(found):
    return [*found[0], *found[1]]


def far(one, other):
    """Largest difference of two results (R, w)."""
    return max(abs(a - b) for a, b in zip(numbers(one), numbers(other)))


def by_series(inertia, omega, time, torque=lambda R: mp.zeros(3, 1)):
    """(R, w) by mpmath's Taylor series method, 32 digits; torque(R) in body axes."""
    with mp.workdps(32):
        inertia, omega = mp.matrix(inertia), [mp.mpf(c) for c in omega]
        inverse = inertia**-1

        def hat(w):
            return mp.matrix([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])

        def rate(_, y):
            R, w = mp.matrix(3, 3), mp.matrix(y[9:])
            for k in range(9):
                R[k // 3, k % 3] = y[k]
            return [*(R * hat(w)), *(inverse * (torque(R) - hat(w) * inertia * w))]

        end = mp.odefun(rate, 0, [*mp.eye(3), *omega])(time)
        return end[:9], end[9:]


@pytest.mark.parametrize("time, golden", [(1, DIGITS["free_body", 1]), (10, DIGITS["free_body", 10])])
def test_free_body_at_golden_end_states(time, golden):
    """Tolerance: golden numbers below 1 have 17 digits, half a unit of the last one."""
    with mp.workdps(40):
        found = free_body(INERTIA, START, OMEGA, time)
        assert max(abs(a - mp.mpf(b)) for a, b in zip(numbers(found), golden.split())) <= 5e-17


def test_lagrangian_top_at_its_golden_end_state():
    """Tolerance: |w| = 150 rad/s with 17 digits per component, the largest exact."""
    with mp.workdps(40):
        found = heavy_top(*TOP, START, TOP_OMEGA, 1)
        assert max(abs(a - mp.mpf(b)) for a, b in zip(numbers(found), DIGITS["lagrangian_top", 1].split())) <= 5e-16


@pytest.mark.parametrize(
    "omega",
    [("0.3", "1.2", "0.1"), ("-0.7", "0.5", "-1.4"), ("2", "-0.4", "0.3"), ("0", "1", "1e-9"), ("1e-25", "1", "0")],
    ids=["below", "above", "below, fast", "separatrix", "nearer"],
)
@pytest.mark.volume(2)
def test_free_body_in_every_regime_against_taylor_series(omega):
    """Also at 1e-9 and 1e-25 from the unstable axis: the modulus differs from 1 by the squares."""
    diagonal = ("0.9144", "1.098", "1.66")
    with mp.workdps(40):
        series = by_series(mp.diag([mp.mpf(i) for i in diagonal]), omega, 2)
        assert far(free_body(diagonal, START, omega, 2, digits=60), series) <= mp.mpf(10) ** -28


@pytest.mark.turn(3)
def test_free_body_on_the_separatrix():
    """L^2 = 2 E I_2: I_1 (I_2 - I_1) w_1^2 = I_3 (I_3 - I_2) w_3^2, here 3 w_1^2 = 12 w_3^2."""
    omega = (2, 1, 1)
    series = by_series(mp.diag([1, 4, 6]), omega, 1)
    assert far(free_body((1, 4, 6), START, omega, 1), series) <= mp.mpf(10) ** -28


@pytest.mark.turn(3)
def test_free_body_with_full_inertia_and_arbitrary_attitude():
    rng = np.random.default_rng(3)
    points = rng.normal(size=(4, 3))
    inertia = sum((p @ p) * np.eye(3) - np.outer(p, p) for p in points)
    omega = rng.normal(size=3)
    found = free_body(inertia, START, omega, 1)
    with mp.workdps(40):
        assert far(found, by_series(inertia.tolist(), omega.tolist(), 1)) <= mp.mpf(10) ** -28
        # Another start turns all of it: 90 degrees about z, exactly.
        turn = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
        turned = free_body(inertia, turn, omega, 1)
        assert far((mp.matrix(turn) * found[0], found[1]), turned) <= mp.mpf(10) ** -28


@pytest.mark.parametrize(
    "inertia, omega", [((2, 2, 2), (1, 2, 3)), ((2, 3, 4), (0, 5, 0)), ((2, 3, 4), (0, 0, 0)), ((2, 2, 4), (1, 2, 0))]
)
def test_steady_rotation_about_principal_axes(inertia, omega):
    R, w = free_body(inertia, START, omega, 1)
    with mp.workdps(40):
        hat = mp.matrix([[0, -omega[2], omega[1]], [omega[2], 0, -omega[0]], [-omega[1], omega[0], 0]])
        assert far((R, w), (mp.expm(hat), omega)) <= mp.mpf(10) ** -28


def test_symmetric_free_body_precesses():
    """w precesses about the symmetry axis at the rate (I_3 - I_1) w_3 / I_1."""
    _, w = free_body((2, 2, 3), START, (1, 0, 4), mp.mpf(1) / 8)
    assert far((w, []), ((mp.cos(0.25), mp.sin(0.25), 4), [])) <= 1e-15


@pytest.mark.turn(3)
def test_heavy_top_against_taylor_series():
    """Slow top with large nutation, tilted start and oblique gravity."""
    g, omega = mp.matrix([3, -1, -9]), ("1.5", "-2", "0.7")

    with mp.workdps(60):
        e = mp.matrix([2, -1, 2]) / 3
        inertia = mp.mpf("1.3") * mp.eye(3) + (mp.mpf("0.5") - mp.mpf("1.3")) * e * e.T

    def torque(R):
        f = mp.mpf("0.7") * (R.T * g)
        return mp.matrix([e[1] * f[2] - e[2] * f[1], e[2] * f[0] - e[0] * f[2], e[0] * f[1] - e[1] * f[0]])

    with mp.workdps(40):
        found = heavy_top("1.3", "0.5", "0.7", e, g, START, omega, 1)
        assert far(found, by_series(inertia, omega, 1, torque)) <= mp.mpf(10) ** -28


def test_steady_precession_of_a_heavy_top():
    """Horizontal axis: precession W with I_3 w_3 W = m g l, without nutation."""
    spin, precession = mp.mpf(8), mp.mpf(1) / 4
    gravity = 3 * spin * precession / 2  # I_3 w_3 W / (m l)
    R, _ = heavy_top(5, 3, 2, (0, 0, 1), (0, -gravity, 0), START, (0, precession, spin), 2)
    # The axis starts along z, up is y: turned by W t about y. Compared in 15 digits.
    end = (mp.sin(2 * precession), 0, mp.cos(2 * precession))
    assert max(abs(R[i, 2] - end[i]) for i in range(3)) <= mp.mpf(10) ** -14


def test_a_top_with_vanishing_gravity_is_a_free_body():
    """A torque of 1e-40 is invisible in 30 digits, so two unrelated formulas must agree."""
    omega = ("0.3", "2", "-0.5")
    top = heavy_top(2, 3, 1, (0, 1, 0), ("0", "0", "-1e-40"), START, omega, 5, digits=90)
    assert far(top, free_body((2, 3, 2), START, omega, 5)) <= 1e-29


def test_a_vertical_axis_is_refused():
    for omega in ((0, 0, 30), (0, 0, 0)):
        with pytest.raises(ValueError, match="vertical"):
            heavy_top(1, 1, 1, (0, 0, 1), (0, 0, -9.81), START, omega, 1)


def test_results_in_double_precision():
    R, w = free_body((1, 2, 3), START, (0, 0, 1), 0)
    assert to_floats(R).shape == (3, 3) and to_floats(w).tolist() == [0, 0, 1]
