# SPDX-License-Identifier: Apache-2.0
"""Contract of every Lie group, over rotation angles from 0 to nearly 2 pi.

The references are independent of the kernels: hat is written out here, exp is mpmath's matrix
exponential, ad is the matrix commutator, Ad the conjugation, dexp the series of ad^k/(k+1)! and
dexpinv its inverse, all with 50 digits. A further group is tested by adding it to GROUPS.

Tolerances are in units of 2^-53. An entry of exp carries up to 6 units from a coefficient, the
products and the sums, and 1.5 t from the angle, since t^2, one product and two sums, is known to 3
units; linear entries all that times the size of eta.
"""

import math

import mpmath as mp
import numpy as np
import pytest
from scene_files import cases

from liegroup_core.lie import SE3, SO3
from liegroup_core.lie.groups import cross

UNIT = 2.0**-53
GROUPS = [SO3, SE3]
DIMENSION = {SO3: 3, SE3: 6}

# rad: 0, squares that vanish or are subnormal, both sides of the switches at 1 and 2, and more.
SMALL = [0.0, 1e-300, 1e-160, 1e-12, 1e-9, 1e-6, 1e-4, 1e-3, 1e-2, 1e-1]
BELOW_PI = [0.5, 1.0 - 1e-15, 1.0, 1.5, 2.0 - 1e-15, 2.0, 2.7, 3.1, math.pi - 1e-6]
BEYOND_PI = [math.pi + 1e-6, 3.5, 4.0, 4.7, 5.5, 6.1]


@pytest.fixture(autouse=True)
def fifty_digits():
    with mp.workdps(50):
        yield


def mp_hat(X):
    """Matrix of an algebra element by definition, 50 digits."""
    x, y, z = X[:3]
    rows = [[0, -z, y], [z, 0, -x], [-y, x, 0]]
    if len(X) == 6:
        rows = [row + [e] for row, e in zip(rows, X[3:])] + [[0, 0, 0, 0]]
    return mp.matrix(rows)


def mp_vee(m):
    """Coordinates of an algebra matrix by definition, 50 digits."""
    return [m[2, 1], m[0, 2], m[1, 0]] + ([m[i, 3] for i in range(3)] if m.rows == 4 else [])


def mp_operator(dimension, action):
    """Matrix of a linear map that is given on algebra matrices."""
    units = [mp_hat([int(i == k) for i in range(dimension)]) for k in range(dimension)]
    return mp.matrix([mp_vee(action(unit)) for unit in units]).T


def mp_ad(X):
    x = mp_hat([mp.mpf(c) for c in X])
    return mp_operator(len(X), lambda e: x * e - e * x)


def mp_exp(X):
    return mp.expm(mp_hat([mp.mpf(c) for c in X]))


def mp_dexp(X):
    """Series sum ad_X^k / (k+1)!, until the terms vanish in 50 digits."""
    ad = mp_ad(X)
    term = total = mp.eye(len(X))
    k = 1
    while mp.norm(term, mp.inf) > mp.mpf(10) ** -45:
        term = term * ad / (k + 1)
        total = total + term
        k += 1
    return total


def difference(got, want):
    """Largest entry of |got - want|."""
    want = mp.matrix(want)
    return max(float(abs(mp.mpf(float(g)) - w)) for g, w in zip(np.ravel(got), want))


def element(group, angle, size, rng):
    """Algebra element: rotation by `angle` (rad) about a random axis, |eta| = size."""
    axis = rng.standard_normal(3)
    xi = axis / np.linalg.norm(axis) * angle
    if group is SO3:
        return xi
    eta = rng.standard_normal(3)
    return np.concatenate((xi, eta / np.linalg.norm(eta) * size))


def elements(group, angles, seed=1):
    """Elements for all `angles`: random and coordinate axes; eta small, large, parallel."""
    rng = np.random.default_rng(seed)
    found = []
    for angle in angles:
        found += [element(group, angle, size, rng) for size in (1.0, 100.0)]
        xi = angle * np.eye(3)[rng.integers(3)]
        found.append(np.concatenate((xi, 0.7 * xi))[: DIMENSION[group]])
    return found


def exp_units(X):
    """Error bound of an entry of exp(X) in units of round-off, for 1 + |eta| = 1."""
    return 6.0 + 1.5 * np.linalg.norm(X[:3])


def scale(X):
    """1 + |eta|, the scale of errors in the linear entries."""
    return 1.0 + float(np.linalg.norm(X[3:]))


@pytest.mark.parametrize("group", GROUPS)
def test_hat_and_vee_against_their_definitions(group):
    X = np.arange(1.0, 1.0 + DIMENSION[group])
    assert difference(group.hat(X), mp_hat(list(X))) == 0.0
    assert (group.vee(group.hat(X)) == X).all()


@pytest.mark.parametrize("group", GROUPS)
def test_exp_against_matrix_exponential(group):
    for X in elements(group, SMALL + BELOW_PI + BEYOND_PI):
        allowed = exp_units(X) * UNIT * scale(X)
        assert difference(group.exp(X), mp_exp(X)) <= allowed, X


@pytest.mark.parametrize("group", GROUPS)
def test_exp_beyond_full_turns(group):
    for X in elements(group, [2.0 * math.pi, 4.0 * math.pi, 20.0, 1000.0]):
        allowed = exp_units(X) * UNIT * scale(X)
        assert difference(group.exp(X), mp_exp(X)) <= allowed, X


@pytest.mark.parametrize("group", GROUPS)
def test_exp_of_zero_is_exactly_the_identity(group):
    identity = group.exp(np.zeros(DIMENSION[group]))
    assert (identity == np.eye(len(identity))).all()
    assert (group.log(identity) == 0.0).all()
    assert (group.dexp(np.zeros(DIMENSION[group])) == np.eye(DIMENSION[group])).all()
    assert (group.dexpinv(np.zeros(DIMENSION[group])) == np.eye(DIMENSION[group])).all()


@pytest.mark.parametrize("group", GROUPS)
def test_group_axioms(group):
    rng = np.random.default_rng(3)
    for angle in SMALL + BELOW_PI + BEYOND_PI:
        X = element(group, angle, 2.0, rng)
        Y = element(group, rng.uniform(0.0, 3.0), 2.0, rng)
        A, B = group.exp(X), group.exp(Y)
        identity = np.eye(len(A))
        # Two factors, good to 16 units times 1 + 2 each, and a product of rows.
        tolerance = 100 * UNIT
        assert group.log(A @ B).shape == X.shape  # closed: log refuses others
        assert np.abs(group.inverse(A) @ A - identity).max() <= tolerance
        assert np.abs(group.exp(-X) - group.inverse(A)).max() <= tolerance
        assert np.abs(group.inverse(A @ B) - group.inverse(B) @ group.inverse(A)).max() <= tolerance
        assert np.abs(group.exp(0.3 * X) @ group.exp(0.7 * X) - A).max() <= tolerance
        assert np.abs(group.Ad(A @ B) - group.Ad(A) @ group.Ad(B)).max() <= tolerance
        # The rotation part stays one: 9 entries' errors, twice.
        R = A[:3, :3]
        assert np.abs(R.T @ R - np.eye(3)).max() <= 12 * UNIT
        assert abs(np.linalg.det(R) - 1.0) <= 20 * UNIT


@pytest.mark.parametrize("group", GROUPS)
def test_log_inverts_exp(group):
    # Below pi: relative to t for the rotation; eta comes back by two maps of norm <= pi/2.
    for X in elements(group, SMALL + BELOW_PI + [math.pi - 1e-12]):
        back = group.log(group.exp(X))
        t = np.linalg.norm(X[:3])
        assert np.abs(back[:3] - X[:3]).max() <= 10 * UNIT * t, X
        assert np.abs(back - X).max() <= 30 * UNIT * (t + np.linalg.norm(X[3:])), X


@pytest.mark.parametrize("group", GROUPS)
def test_log_beyond_pi_is_the_shorter_rotation(group):
    for X in elements(group, BEYOND_PI):
        back = group.log(group.exp(X))
        t = mp.norm(mp.matrix(X[:3]))
        want = [mp.mpf(x) * (1 - 2 * mp.pi / t) for x in X[:3]]
        # Absolute: of the size of the rotation's own 16 units.
        assert difference(back[:3], want) <= 20 * UNIT
        assert np.abs(group.exp(back) - group.exp(X)).max() <= 60 * UNIT * scale(X)


@pytest.mark.parametrize("group", GROUPS)
def test_log_at_half_turns(group):
    # Either sign may come; the rotation must be the same and the angle pi.
    axes = [np.eye(3)[i] for i in range(3)] + [
        np.array(a) / np.linalg.norm(a) for a in ([1, 1, 0], [0, -1, 1], [1, 2, 3], [-3, 1e-9, 1])
    ]
    for axis in axes:
        C = np.eye(len(group.exp(np.zeros(DIMENSION[group]))))
        C[:3, :3] = 2.0 * np.outer(axis, axis) - np.eye(3)
        C[:3, 3:] = [[1.0], [-2.0], [3.0]][: 3 * (len(C) - 3)]
        X = group.log(C)
        assert abs(np.linalg.norm(X[:3]) - math.pi) <= 8 * UNIT
        assert np.abs(group.exp(X) - C).max() <= 60 * UNIT * scale(X)


@pytest.mark.parametrize("group", GROUPS)
def test_Ad_against_conjugation(group):
    for X in elements(group, SMALL + BELOW_PI + BEYOND_PI):
        C = group.exp(X)
        c = mp.matrix(C.tolist())
        inverse = mp.inverse(c)
        want = mp_operator(len(X), lambda e: c * e * inverse)
        # C is a rotation but for 12 units; a row of three products, two of them for r x R.
        assert difference(group.Ad(C), want) <= 24 * UNIT * scale(X), X


@pytest.mark.parametrize("group", GROUPS)
def test_ad_against_the_commutator(group):
    for X in elements(group, SMALL + BELOW_PI):
        assert difference(group.ad(X), mp_ad(X)) == 0.0


@pytest.mark.parametrize("group", GROUPS)
def test_Ad_of_exp_is_exp_of_ad(group):
    for X in elements(group, [1e-300, 1e-3, 1.0, 3.0, 5.0]):
        # Of r x R both factors carry the error of exp.
        allowed = 2 * exp_units(X) * UNIT * scale(X)
        assert difference(group.Ad(group.exp(X)), mp.expm(mp_ad(X))) <= allowed, X


@pytest.mark.parametrize("group", GROUPS)
def test_dexp_against_the_series_of_ad(group):
    for X in elements(group, SMALL + BELOW_PI + BEYOND_PI + [2.0 * math.pi]):
        assert difference(group.dexp(X), mp_dexp(X)) <= 4.5 * UNIT * scale(X), X


@pytest.mark.parametrize("group", GROUPS)
def test_dexpinv_against_the_inverse_of_the_series_of_ad(group):
    # Up to pi all coefficients times their powers of t are below 1: 4.5 units = 5e-16. Beyond,
    # the lower left block has a double pole at 2 pi, so that the rounding of t^2 shows with its
    # derivative, a triple one.
    for X in elements(group, SMALL + BELOW_PI + BEYOND_PI):
        t = float(np.linalg.norm(X[:3]))
        growth = max(1.0, math.pi / (2.0 * math.pi - t)) ** 3
        allowed = 4.5 * UNIT * growth * scale(X)
        assert difference(group.dexpinv(X), mp.inverse(mp_dexp(X))) <= allowed, X


@pytest.mark.parametrize("group", GROUPS)
def test_dexpinv_is_the_inverse_of_dexp(group):
    # The errors of both, times the norm of the other: at most 1 + |eta| and (1 + |eta|) pi/2.
    for X in elements(group, SMALL + BELOW_PI):
        product = group.dexpinv(X) @ group.dexp(X)
        assert np.abs(product - np.eye(len(X))).max() <= 24 * UNIT * scale(X), X


@pytest.mark.parametrize("group", GROUPS)
def test_body_twist_is_dexp_of_minus_X(group):
    """C^-1 Cdot = hat(dexp_{-X} Xdot) and Cdot C^-1 = hat(dexp_X Xdot), by finite differences."""
    rng = np.random.default_rng(5)
    # Central difference of the 50-digit exponential: error step^2 times third derivative, 1e-27.
    step = mp.mpf(10) ** -15
    for angle in (0.0, 1e-3, 0.9, 2.5, 4.0):
        X, rate = element(group, angle, 1.0, rng), element(group, 1.0, 1.0, rng)
        ahead, behind = (mp_exp([mp.mpf(x) + s * mp.mpf(v) for x, v in zip(X, rate)]) for s in (step, -step))
        inverse = mp.inverse(mp_exp(X))
        Cdot = (ahead - behind) / (2 * step)
        # 4.5 units an entry of dexp, and rows of six times a rate of norm sqrt(2).
        assert difference(group.dexp(-X) @ rate, mp_vee(inverse * Cdot)) <= 40 * UNIT
        assert difference(group.dexp(X) @ rate, mp_vee(Cdot * inverse)) <= 40 * UNIT
        # And backwards, what the integrators use: with pi/(2 pi - 4) cubed for the last angle.
        body = np.array([float(v) for v in mp_vee(inverse * Cdot)])
        assert np.abs(group.dexpinv(-X) @ body - rate).max() <= 40 * 3 * UNIT


@pytest.mark.parametrize("group", GROUPS)
@pytest.mark.parametrize("name", ["exp", "hat", "ad", "dexp", "dexpinv"])
def test_functions_vectorise_over_leading_dimensions(group, name):
    X = np.random.default_rng(7).standard_normal((2, 3, DIMENSION[group]))
    function = getattr(group, name)
    batch = function(X)
    assert batch.shape[:2] == (2, 3)
    assert (batch[1, 2] == function(X[1, 2])).all()
    for of_pose in (group.log, group.inverse, group.Ad) if name == "exp" else ():
        assert (of_pose(batch)[1, 2] == of_pose(batch[1, 2])).all()
    assert function(X[:0]).shape == (0,) + batch.shape[1:]


@pytest.mark.parametrize("group", GROUPS)
@pytest.mark.parametrize("name", ["exp", "hat", "ad", "dexp", "dexpinv"])
@pytest.mark.parametrize("bad, message", cases("wrong_coordinates_are_refused"))
def test_wrong_coordinates_are_refused(group, name, bad, message):
    with pytest.raises(ValueError, match=message):
        getattr(group, name)(bad)


@pytest.mark.parametrize("group", GROUPS)
@pytest.mark.parametrize("number", [math.nan, math.inf])
def test_non_finite_numbers_are_refused(group, number):
    X = np.zeros(DIMENSION[group])
    X[-1] = number
    for name in ("exp", "hat", "ad", "dexp", "dexpinv"):
        with pytest.raises(ValueError, match="must be finite"):
            getattr(group, name)(X)
    C = group.exp(np.zeros(DIMENSION[group]))
    C[0, -1] = number
    for name in ("log", "inverse", "Ad"):
        with pytest.raises(ValueError, match="must be finite"):
            getattr(group, name)(C)


@pytest.mark.parametrize("group", GROUPS)
@pytest.mark.parametrize("name", ["log", "inverse", "Ad"])
def test_matrices_outside_the_group_are_refused(group, name):
    identity = group.exp(np.zeros(DIMENSION[group]))
    function = getattr(group, name)
    scaled, mirrored = identity.copy(), identity.copy()
    scaled[:3, :3] *= 1.001
    mirrored[2, 2] = -1.0
    for bad, message in (
        (scaled, "not a rotation"),
        (mirrored, "reflection"),
        (np.eye(5), "must have shape"),
        (identity[0], "must have shape"),
    ):
        with pytest.raises(ValueError, match=message):
            function(bad)
    if group is SE3:
        identity[3, 0] = 0.1
        with pytest.raises(ValueError, match="last row"):
            function(identity)
    # Single precision is close enough.
    rounded = group.exp(np.linspace(0.1, 0.6, DIMENSION[group])).astype(np.float32)
    assert np.isfinite(function(rounded)).all()


@pytest.mark.parametrize("shape", [(3,), (5, 3), (2, 5, 3)])
def test_vector_products_have_the_bits_of_numpys(shape):
    a, b = np.random.default_rng(0).normal(size=(2, *shape))
    assert np.array_equal(cross(a, b), np.cross(a, b))
