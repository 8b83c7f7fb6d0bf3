# SPDX-License-Identifier: Apache-2.0
"""Coefficients of exp, dexp and dexpinv against their definitions with 60 digits."""

import math
from fractions import Fraction

import mpmath as mp
import numpy as np
import pytest

from liegroup_core.lie import coefficients

UNIT = 2.0**-53
NAMES = ("sinc", "versinc", "cubic", "versinc slope", "cubic slope", "b", "u")


def computed(x):
    """The seven coefficients as the kernels compute them."""
    return (*coefficients.exp_coefficients(x), *coefficients.dexp_slopes(x), *coefficients.dexpinv_coefficients(x))


def exact(x):
    """The seven closed forms. They lose 4 lg(1/t) digits: 60 digits suffice for t > 1e-8.

    t^2 is taken as the kernel gets it, so that no error of the argument enters.
    """
    with mp.workdps(60):
        x = mp.mpf(x)
        t = mp.sqrt(x)
        sinc = mp.sin(t) / t
        versinc = (1 - mp.cos(t)) / x
        cubic = (t - mp.sin(t)) / t**3
        beta = (mp.sin(t / 2) / (t / 2)) ** 2
        gamma = t / 2 * mp.cot(t / 2)
        return (
            sinc,
            versinc,
            cubic,
            (sinc - 2 * versinc) / x,
            (versinc - 3 * cubic) / x,
            (1 - gamma) / x,
            (1 / beta + gamma - 2) / x**2,
        )


def errors(t_values):
    """For each angle, the seven absolute errors and the seven exact values."""
    absolute, values = [], []
    for t in t_values:
        x = float(t * t)
        want = exact(x)
        absolute.append([float(abs(mp.mpf(got) - w)) for got, w in zip(computed(x), want)])
        values.append([abs(float(w)) for w in want])
    return np.array(absolute), np.array(values)


def grid(low, high, n):
    """n angles, and the last double before and first after every switch between formulas."""
    switches = [math.sqrt(coefficients.EXP_SERIES_BELOW)]
    switches += [2.0**k * math.sqrt(coefficients.DEXPINV_SERIES_BELOW) for k in range(3)]
    sides = [math.nextafter(s, to) for s in switches for to in (0.0, 9.0)] + switches
    inside = [s for s in sides if low <= s <= high]
    return np.concatenate((np.linspace(low, high, n), inside))


def bernoulli(n):
    """|B_n| exactly."""
    return abs(Fraction(*map(int, mp.bernfrac(n))))


def factorial(n):
    return Fraction(math.factorial(n))


@pytest.mark.parametrize(
    "table, term",
    [
        ("SINC_SERIES", lambda k: (-1) ** k / factorial(2 * k + 1)),
        ("VERSINC_SERIES", lambda k: (-1) ** k / factorial(2 * k + 2)),
        ("CUBIC_SERIES", lambda k: (-1) ** k / factorial(2 * k + 3)),
        ("VERSINC_SLOPE_SERIES", lambda k: 2 * (k + 1) * (-1) ** (k + 1) / factorial(2 * k + 4)),
        ("CUBIC_SLOPE_SERIES", lambda k: 2 * (k + 1) * (-1) ** (k + 1) / factorial(2 * k + 5)),
        ("DEXPINV_SERIES", lambda k: bernoulli(2 * k + 2) / factorial(2 * k + 2)),
        ("DEXPINV_SLOPE_SERIES", lambda k: 2 * (k + 1) * bernoulli(2 * k + 4) / factorial(2 * k + 4)),
    ],
)
def test_series_coefficients_are_rounded_rationals_and_the_truncation_suffices(table, term):
    series = getattr(coefficients, table)
    assert series == tuple(float(term(k)) for k in range(12))

    # What is cut off at the switch. The terms fall by a factor x/39 or faster there, so the
    # remainder is below twice the first term left out; the smallest value below the switch is
    # the one at it, but for sinc and the like, which do not fall below 0.4 of their limit.
    switch = coefficients.DEXPINV_SERIES_BELOW if table.startswith("DEXPINV") else coefficients.EXP_SERIES_BELOW
    remainder = 2.0 * abs(float(term(12))) * switch**12
    assert remainder < 0.1 * UNIT * 0.4 * abs(series[0])


def test_turns_have_the_accuracy_of_exp_coefficients():
    """Bounds of exp_coefficients; the terms left out at the switch are below a tenth of a unit."""
    switch = coefficients.SHORT_SERIES_BELOW
    for series in (coefficients.SINC_SERIES, coefficients.VERSINC_SERIES):
        assert 2.0 * abs(series[6]) * switch**6 < 0.2 * UNIT * series[0]
    sides = [math.nextafter(switch, to) for to in (0.0, 9.0)]
    for x in (0.0, 1e-300, switch, *sides, *np.geomspace(1e-9, 9.0, 300)):
        wanted = exact(x)[:2] if x > 1e-12 else (1.0, 0.5)
        for got, want, units in zip(coefficients.turn_coefficients(x), wanted, (12, 5)):
            assert abs(got - want) <= units * UNIT * abs(want)


@pytest.mark.parametrize("x", [0.0, 5e-324, 1e-320, 1e-300, 1e-150, 1e-20])
def test_tiny_angles_give_the_limits(x):
    # The next term is x/6 of the limit or less: below half a unit for x = 1e-20.
    assert computed(x) == (1.0, 1 / 2, 1 / 6, -1 / 12, -1 / 60, 1 / 12, 1 / 360)


def test_relative_accuracy_of_exp_coefficients_up_to_3():
    # Series of twelve terms falling from the first: 3 units, from the last sum and the products
    # before it. Half-angle form: sine, quotient and product 3; sinc near t = 3 loses 1/cos(1.5) =
    # 14 times the half unit of the angle, and cubic, (1 - sinc)/t^2, gains. The slopes cancel:
    # of sinc - 2 versinc stays 0.6 of its terms, of versinc - 3 cubic 0.1, with 3 + 3 units.
    bound = (12, 5, 4, 9, 50)
    absolute, value = errors(np.concatenate((np.geomspace(1e-6, 0.1, 100), grid(0.1, 3.0, 1000))))
    worst = (absolute / value).max(axis=0) / UNIT
    for name, error, allowed in zip(NAMES, worst, bound):
        assert error <= allowed, name


def test_absolute_accuracy_of_exp_coefficients_beyond_3():
    # The root's error and that of t^2 move the angle by up to t/2 units more or less, which sin
    # and cos, at most 1, pass on; each has its own few units, as above. No NaN at 2 pi k.
    angles = np.concatenate((grid(3.0, 50.0, 600), math.pi * np.arange(1, 15)))
    absolute, value = errors(angles)
    for i, (power, units) in enumerate(((1, 8), (2, 8), (2, 8), (3, 16), (4, 16))):
        allowed = (units + angles / 2) * UNIT / angles**power
        assert (absolute[:, i] <= allowed).all(), NAMES[i]


def test_accuracy_of_dexpinv_coefficients():
    # Series: 3 units. Doubling: all terms positive; quotient and sums add one unit, and four
    # where f^2 enters. Beyond pi gamma = 1 - b t^2 cancels; near a pole at distance d a change
    # of t by t/2 units changes b by t/(2 d) of these and u, a double pole, by twice that.
    angles = np.concatenate((np.geomspace(1e-6, 0.1, 100), grid(0.1, 6.28, 1500)))
    absolute, value = errors(angles)
    growth = np.maximum(1.0, math.pi / (2.0 * math.pi - angles))
    for i, units in ((5, 4), (6, 10)):
        assert (absolute[:, i] / value[:, i] <= units * UNIT * growth).all(), NAMES[i]


@pytest.mark.parametrize("k", [1, 2, 3])
def test_accuracy_of_dexpinv_coefficients_near_their_poles(k):
    # Doubles around (2 pi k)^2: one of them may be taken for the pole itself and give NaN, the
    # others are large: b = -1/(t d) at the distance d = t/2 * 2^-52 * n of the n-th neighbour.
    x = float((2 * mp.pi * k) ** 2)
    pole = 0
    for n in range(-300, 301):
        b, u = coefficients.dexpinv_coefficients(x * (1.0 + n * 2.0**-52))
        pole += math.isnan(b)
        assert math.isnan(b) and math.isnan(u) or abs(b) > 1e10 and abs(u) > 1e20
    assert pole <= 2


def test_finite_angles_off_the_poles_give_finite_coefficients():
    for x in np.geomspace(1e-300, 1.7e308, 2000):
        assert all(map(math.isfinite, computed(float(x))))


@pytest.mark.parametrize("x", [math.inf, math.nan])
def test_non_finite_angles_give_nan(x):
    assert all(map(math.isnan, computed(x)))
