# SPDX-License-Identifier: Apache-2.0
"""Kernels of SO(3) and SE(3): properties beyond the group contract.

The contract test reaches exp, log, dexp, dexpinv, Ad, ad and the inverse through the matrix
classes; here are the remaining kernels, the quaternions, the edges, and plain Python.
"""

import json
import math
import os
import subprocess
import sys
from fractions import Fraction
from pathlib import Path

import mpmath as mp
import numpy as np
import pytest

from liegroup_core.compiling import compiled
from liegroup_core.lie import SE3, SO3, coefficients, se3, so3

UNIT = 2.0**-53
ROOT = Path(__file__).parents[2]


def vector(rng, size=1.0):
    return tuple((size * rng.standard_normal(3)).tolist())


def pose(rng):
    return se3.se3_exp(vector(rng), vector(rng))


def matrix(R, r):
    C = np.eye(4)
    C[:3, :3] = np.reshape(R, (3, 3))
    C[:3, 3] = r
    return C


@pytest.mark.parametrize("seed", range(5))
def test_compose_and_inverse_against_matrices(seed):
    rng = np.random.default_rng(seed)
    A, B = pose(rng), pose(rng)
    # Entries are sums of three or four products of numbers below 8.
    product = matrix(*se3.se3_compose(*A, *B))
    assert np.abs(product - matrix(*A) @ matrix(*B)).max() <= 64 * UNIT
    assert np.abs(matrix(*se3.se3_inverse(*A)) @ matrix(*A) - np.eye(4)).max() <= 64 * UNIT


@pytest.mark.parametrize("seed", range(5))
def test_Ad_inverse_is_Ad_of_the_inverse(seed):
    rng = np.random.default_rng(seed)
    C, w, v = pose(rng), vector(rng), vector(rng)
    got = np.concatenate(se3.se3_Ad_inverse(*C, w, v))
    want = np.linalg.inv(SE3.Ad(matrix(*C))) @ np.concatenate((w, v))
    assert np.abs(got - want).max() <= 200 * UNIT  # cond(Ad) is below 10 for |r| < 3


@pytest.mark.parametrize("seed", range(5))
def test_ad_transpose_is_the_dual_of_ad(seed):
    rng = np.random.default_rng(seed)
    xi, eta, torque, force = (vector(rng) for _ in range(4))
    got = np.concatenate(se3.se3_ad_transpose(xi, eta, torque, force))
    want = SE3.ad(np.concatenate((xi, eta))).T @ np.concatenate((torque, force))
    assert np.abs(got - want).max() <= 64 * UNIT


# Quaternions (x, y, z, w) that take each of the four roots, and neighbours of a half turn.
QUATERNIONS = [
    (0.0, 0.0, 0.0, 1.0),
    (1.0, 0.0, 0.0, 0.0),
    (0.0, 1.0, 0.0, 0.0),
    (0.0, 0.0, 1.0, 0.0),
    (0.1, 0.2, 0.3, 0.9),
    (0.9, 0.2, 0.3, 0.1),
    (0.2, 0.9, -0.3, 0.1),
    (-0.2, 0.3, 0.9, 0.1),
    (0.5, 0.5, 0.5, 0.5),
    (0.5, -0.5, 0.5, 0.5),
    (1e-9, 0.0, 0.0, 1.0),
    (0.6, 0.8, 0.0, 1e-9),
    (1e-300, -2e-300, 0.0, 1.0),
    (0.9, 0.2, 0.3, -0.1),
    (0.1, 0.2, 0.3, -0.9),
]


@pytest.mark.parametrize("q", QUATERNIONS)
def test_quaternion_to_matrix_and_back(q):
    unit = np.array(q) / np.linalg.norm(q)
    R = so3.so3_from_quaternion(q)
    # The same rotation acting on a vector by the quaternion product, v + 2 u x (u x v + w v).
    v, u = np.array([0.3, -1.0, 2.0]), unit[:3]
    turned = v + 2.0 * np.cross(u, np.cross(u, v) + unit[3] * v)
    assert np.abs(np.reshape(R, (3, 3)) @ v - turned).max() <= 32 * UNIT
    back = np.array(so3.so3_to_quaternion(R))
    assert back[3] >= 0.0
    # Which sign comes is open only at w = 0.
    wanted = -unit if unit[3] < 0.0 or unit[3] == 0.0 and back @ unit < 0.0 else unit
    assert np.abs(back - wanted).max() <= 8 * UNIT
    # Small components keep their relative accuracy next to the identity.
    if abs(q[3]) == 1.0:
        assert np.abs(back - wanted)[:3].max() <= 8 * UNIT * np.abs(q[:3]).max()


@pytest.mark.parametrize("factor", [1e-90, 0.5, -3.0, 1e90])
def test_quaternion_norm_does_not_matter(factor):
    q = np.array([0.1, -0.5, 0.3, 0.7])
    assert np.abs(SO3.from_quaternion(factor * q) - SO3.from_quaternion(q)).max() <= 8 * UNIT


def test_quaternion_zero_is_refused_and_gives_nan_in_a_kernel():
    with pytest.raises(ValueError, match="norm of a quaternion"):
        SO3.from_quaternion([0.0, 0.0, 0.0, 0.0])
    assert any(map(math.isnan, so3.so3_from_quaternion((0.0, 0.0, 0.0, 0.0))))


@pytest.mark.parametrize("size", [5e-324, 1e-310, 1e-300, 1e-160, 1e-154])
def test_tiny_rotations_keep_full_relative_accuracy(size):
    xi = (size, -2.0 * size, 3.0 * size)
    # All digits there are: the factor 1/4 in log costs subnormal numbers their last ones.
    back = so3.so3_log(so3.so3_exp(xi))
    assert max(abs(a - b) for a, b in zip(back, xi)) <= (0.0 if size >= 1e-300 else 2 * 5e-324)
    w, v = (1.0, 2.0, 3.0), (-1.0, 0.5, 4.0)
    assert so3.so3_dexp(xi, w) == so3.so3_dexpinv(xi, w) == w
    # A translation with it: what is left of the bracket is below the last digit of v.
    eta = (10.0, 20.0, 30.0)
    assert se3.se3_exp(xi, eta)[1] == eta
    assert se3.se3_dexpinv(xi, (0.0, 0.0, 0.0), w, v) == (w, v)


def test_pure_translation_is_exact():
    zero, eta, w, v = (0.0, 0.0, 0.0), (2.0, -4.0, 8.0), (1.0, 2.0, 3.0), (4.0, 8.0, 16.0)
    assert se3.se3_exp(zero, eta) == ((1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0), eta)
    bracket = np.cross(eta, w)  # the series ends here, as ad^2 w = 0
    assert se3.se3_dexp(zero, eta, w, v) == (w, tuple(v + 0.5 * bracket))
    assert se3.se3_dexpinv(zero, eta, w, v) == (w, tuple(v - 0.5 * bracket))


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e200])
def test_non_finite_input_gives_non_finite_output_without_raising(bad):
    xi, ok = (0.1, bad, 0.2), (1.0, 2.0, 3.0)
    results = [
        so3.so3_exp(xi),
        so3.so3_dexp(xi, ok),
        so3.so3_dexpinv(xi, ok),
        sum(se3.se3_exp(xi, ok), ()),
        sum(se3.se3_dexp(xi, ok, ok, ok), ()),
        sum(se3.se3_dexpinv(xi, ok, ok, ok), ()),
    ]
    for result in results:
        assert not all(map(math.isfinite, result))
    if abs(bad) != 1e200:
        R = (1.0, bad, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
        assert not all(map(math.isfinite, so3.so3_log(R)))


@pytest.mark.parametrize("k", [1, 2, 3])
def test_full_turns_are_regular_except_for_dexpinv(k):
    xi = (0.0, 2.0 * math.pi * k, 0.0)
    ok = (1.0, 2.0, 3.0)
    # exp(2 pi k) = I; the angle is known to 2^-53 of itself, its square to 2 of that.
    assert np.abs(SO3.exp(xi) - np.eye(3)).max() <= 2.0 * xi[1] * UNIT
    assert all(map(math.isfinite, sum(se3.se3_dexp(xi, ok, ok, ok), ())))
    assert max(map(abs, so3.so3_dexpinv((0.0, xi[1] * (1.0 - 1e-9), 0.0), ok))) > 1e8


SAMPLE = """
import json, sys
import numpy as np
from liegroup_core.lie import se3, so3
rng = np.random.default_rng(11)
bits = []
for size in 10.0 ** rng.uniform(-9.0, 0.8, 200):
    xi = tuple((size * rng.standard_normal(3)).tolist())
    eta, w, v = (tuple(rng.standard_normal(3).tolist()) for _ in range(3))
    R, r = se3.se3_exp(xi, eta)
    numbers = [R, r, *se3.se3_log(R, r), *se3.se3_dexp(xi, eta, w, v),
               *se3.se3_dexpinv(xi, eta, w, v), so3.so3_to_quaternion(R),
               *se3.se3_Ad(R, r, w, v), *se3.se3_Ad_inverse(R, r, w, v)]
    bits.append([float(x).hex() for group in numbers for x in group])
json.dump(bits, sys.stdout)
"""


@pytest.mark.slow
@pytest.mark.skipif(not compiled(), reason="compares machine code with plain Python")
def test_plain_python_and_compiled_kernels_are_bit_identical():
    def run(disable):
        environment = {**os.environ, "NUMBA_DISABLE_JIT": disable, "PYTHONPATH": str(ROOT)}
        done = subprocess.run(
            [sys.executable, "-c", SAMPLE], env=environment, check=True, capture_output=True, text=True, timeout=60
        )
        return json.loads(done.stdout)

    assert run("0") == run("1")


# Coefficients of exp, dexp and dexpinv against their definitions with 60 digits.


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
