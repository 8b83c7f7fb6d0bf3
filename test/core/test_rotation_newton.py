# SPDX-License-Identifier: Apache-2.0
"""Newton's method for the implicit equations of one rotating body."""

import numpy as np
import pytest

from liegroup_core.lie.groups import SO3
from liegroup_core.methods.rotation.newton import GYROSCOPIC, INCREMENT, RATTLE, _equation, newton

KINDS = (GYROSCOPIC, RATTLE, INCREMENT)


def vectors(rng, count):
    return [tuple(v) for v in rng.normal(size=(count, 3))]


def inertia_of(rng):
    points = rng.normal(size=(4, 3))
    return sum((p @ p) * np.eye(3) - np.outer(p, p) for p in points)


def left_hand_side(kind, I, h, x, v, a, b):
    """Left-hand sides with series and matrices of independent code."""
    x, v, a, b = map(np.array, (x, v, a, b))
    t = np.linalg.norm(x)
    if kind == GYROSCOPIC:
        return I @ x + h / 2 * np.cross(x, I @ x)
    if kind == RATTLE:
        F, Jd = SO3.exp(x), np.trace(I) / 2 * np.eye(3) - I
        skew = F @ Jd - Jd @ F.T  # (c)^ , which is what RATTLE solves
        return np.array([skew[2, 1], skew[0, 2], skew[1, 0]])
    dexp = v - (1 - np.cos(t)) / t**2 * np.cross(x, v) + (t - np.sin(t)) / t**3 * np.cross(x, np.cross(x, v))
    return 2 / h * I @ x - I @ dexp - SO3.exp(x).T @ a - SO3.exp(x / 2).T @ b


@pytest.mark.parametrize("kind", KINDS)
def test_residuals_and_derivatives_of_the_implicit_equations(kind):
    """Central differences of step 1e-5: truncation error 1e-10, round-off 1e-11."""
    rng = np.random.default_rng(kind)
    for _ in range(20):
        I, h = inertia_of(rng), rng.uniform(0.1, 2.0)
        x, v, a, b, c = vectors(rng, 5)
        value, slope = _equation(kind, tuple(I.ravel()), h, x, v, a, b, c)
        assert np.abs(np.add(value, c) - left_hand_side(kind, I, h, x, v, a, b)).max() <= 1e-12
        for k in range(3):
            d = np.zeros(3)
            d[k] = 1e-5
            ends = [left_hand_side(kind, I, h, x + sign * d, v, a, b) for sign in (1, -1)]
            found = np.array(slope).reshape(3, 3)[:, k]
            assert np.abs((ends[0] - ends[1]) / 2e-5 - found).max() <= 1e-7 * (1 + np.abs(slope).max())


@pytest.mark.parametrize("kind", KINDS)
def test_newton_converges_to_round_off(kind):
    """From the initial guess of a step of at most half a turn."""
    rng = np.random.default_rng(10 + kind)
    for _ in range(200):
        I = inertia_of(rng)
        w = rng.normal(size=3)
        h = rng.uniform(0.01, 0.9) / np.linalg.norm(w)
        y = I @ w
        zero = (0.0, 0.0, 0.0)
        start, a, c = {GYROSCOPIC: (w, zero, y), RATTLE: (h * w, zero, h * y), INCREMENT: (h * w, y, y)}[kind]
        flat = tuple(I.ravel())
        x, found = newton(kind, flat, h, tuple(start), zero, tuple(a), zero, tuple(c))
        assert found
        left, _ = _equation(kind, flat, h, x, zero, tuple(a), zero, tuple(c))
        # Terms of the size of (2/h) I x, each rounded: some ten units of them.
        size = np.abs(I).max() * np.linalg.norm(x) * (2 / h if kind == INCREMENT else 1)
        assert np.abs(left).max() <= 30 * 1.1e-16 * size


def test_an_equation_without_solution_returns_a_failure_status():
    """Rotation about a principal axis with sin f = 1.01."""
    flat, zero = (1.0, 0, 0, 0, 2.0, 0, 0, 0, 2.5), (0.0, 0.0, 0.0)
    for speed, works in ((0.99, True), (1.01, False)):
        c = (0.0, 2.0 * speed, 0.0)
        x, found = newton(RATTLE, flat, 1.0, (0.0, speed, 0.0), zero, zero, zero, c)
        assert found == works
        assert not works or x[1] == pytest.approx(np.arcsin(speed), rel=1e-14)
