# SPDX-License-Identifier: Apache-2.0
"""Implicit equations of one rotating body, solved by Newton's method with their exact Jacobian.

Vectors are in body axes; I is the inertia about the centre of mass or the fixed point; t = |x|.
    GYROSCOPIC  I x + (h/2) x x I x = c                                               x in rad/s
    RATTLE      (sin t/t) I x + ((1-cos t)/t^2) x x I x = c                           x in rad
    EXPONENTIAL I x + x x I x / 2 + b x x (x x I x) = c,  b = (1 - (t/2) cot(t/2))/t^2  x in rad
    INCREMENT   (2/h) I x - I dexp_{-x} v - exp(-x) a - exp(-x/2) b = c               x in rad
All equations are smooth, so that Newton's method converges quadratically.
"""

import math

from liegroup_core.compiling import kernel, subroutine
from liegroup_core.lie.coefficients import dexp_slopes, dexpinv_coefficients, exp_coefficients
from liegroup_core.lie.so3 import so3_dexp, so3_exp
from liegroup_core.lie.vec3 import IDENTITY3, axpy3, cross3, dot3, matmul3, matvec3, scale3, solve3, sub3, tmatvec3

GYROSCOPIC, RATTLE, INCREMENT, EXPONENTIAL = 0, 1, 2, 3

# Continuation in h, if Newton's method does not converge from its initial guess: first and smallest
# increment as fractions of h, and largest difference of a solution from its prediction, rad.
FIRST_INCREMENT, SMALLEST_INCREMENT = 0.125, 1e-3
LARGEST_DEVIATION = 0.25

# After a correction of this relative size the next one would be below round-off, with a margin for
# a nearly singular matrix.
LAST_CORRECTION = 1e-9
MAX_ITERATIONS = 60


@kernel
def _combine(s, m, t, n):
    """s m + t n, a linear combination of two matrices."""
    return (
        s * m[0] + t * n[0],
        s * m[1] + t * n[1],
        s * m[2] + t * n[2],
        s * m[3] + t * n[3],
        s * m[4] + t * n[4],
        s * m[5] + t * n[5],
        s * m[6] + t * n[6],
        s * m[7] + t * n[7],
        s * m[8] + t * n[8],
    )


@kernel
def _hat(x):
    """Matrix of the cross product with x from the left."""
    return (0.0, -x[2], x[1], x[2], 0.0, -x[0], -x[1], x[0], 0.0)


@kernel
def _norm1(x):
    """1-norm of a vector. Squares of components below 1e-160 would lose digits."""
    return abs(x[0]) + abs(x[1]) + abs(x[2])


@kernel
def _outer(a, b):
    """a b^T"""
    return (
        a[0] * b[0],
        a[0] * b[1],
        a[0] * b[2],
        a[1] * b[0],
        a[1] * b[1],
        a[1] * b[2],
        a[2] * b[0],
        a[2] * b[1],
        a[2] * b[2],
    )


@kernel
def _rotated_back(x, a):
    """exp(-x) a and its derivative with respect to x, (exp(-x) a)^ dexp_{-x}."""
    q = tmatvec3(so3_exp(x), a)
    _, c, d = exp_coefficients(dot3(x, x))
    dexp = _combine(1.0, _combine(1.0 - d * dot3(x, x), IDENTITY3, -c, _hat(x)), d, _outer(x, x))
    return q, matmul3(_hat(q), dexp)


@kernel
def _dexp_slope(x, v):
    """Derivative of dexp_{-x} v with respect to x."""
    _, c, d = exp_coefficients(dot3(x, x))
    c_slope, d_slope = dexp_slopes(dot3(x, x))
    xv = cross3(x, v)
    by_length = axpy3(-c_slope, xv, scale3(d_slope, cross3(x, xv)))
    inner = _combine(1.0, _combine(dot3(x, v), IDENTITY3, 1.0, _outer(x, v)), -2.0, _outer(v, x))
    return _combine(1.0, _combine(c, _hat(v), d, inner), 1.0, _outer(by_length, x))


@kernel
def _equation(kind, inertia, h, x, v, a, b, c):
    """Residual, left-hand side minus c, and its derivative with respect to x."""
    Ix = matvec3(inertia, x)
    if kind == INCREMENT:
        first, first_slope = _rotated_back(x, a)
        second, second_slope = _rotated_back(scale3(0.5, x), b)
        transported = matvec3(inertia, so3_dexp(scale3(-1.0, x), v))
        value = sub3(axpy3(2.0 / h, Ix, scale3(-1.0, transported)), first)
        outer = _combine(2.0 / h, inertia, -1.0, matmul3(inertia, _dexp_slope(x, v)))
        slope = _combine(1.0, outer, -1.0, _combine(1.0, first_slope, 0.5, second_slope))
        return sub3(sub3(value, second), c), slope
    gyration = cross3(x, Ix)
    gyration_slope = _combine(1.0, matmul3(_hat(x), inertia), -1.0, _hat(Ix))
    if kind == GYROSCOPIC:
        return (sub3(axpy3(0.5 * h, gyration, Ix), c), _combine(1.0, inertia, 0.5 * h, gyration_slope))
    squared = dot3(x, x)
    if kind == EXPONENTIAL:
        b, u = dexpinv_coefficients(squared)
        twice = cross3(x, gyration)
        # x x (x x a) = (x x^T - x^2) a, differentiated by both factors x
        both = _combine(1.0, _outer(x, x), -squared, IDENTITY3)
        twice_slope = _combine(
            1.0,
            _combine(1.0, matmul3(both, inertia), 1.0, _outer(x, Ix)),
            1.0,
            _combine(dot3(x, Ix), IDENTITY3, -2.0, _outer(Ix, x)),
        )
        return (
            sub3(axpy3(b, twice, axpy3(0.5, gyration, Ix)), c),
            _combine(
                1.0, _combine(1.0, inertia, 0.5, gyration_slope), 1.0, _combine(b, twice_slope, u, _outer(twice, x))
            ),
        )
    sinc, versinc, cubic = exp_coefficients(squared)
    versinc_slope, _ = dexp_slopes(squared)
    # (1/t) d/dt sin t/t = (t - sin t)/t^3 - (1 - cos t)/t^2
    by_length = axpy3(cubic - versinc, Ix, scale3(versinc_slope, gyration))
    return (
        sub3(axpy3(sinc, Ix, scale3(versinc, gyration)), c),
        _combine(1.0, _combine(sinc, inertia, versinc, gyration_slope), 1.0, _outer(by_length, x)),
    )


@subroutine
def newton(kind, inertia, h, start, v, a, b, c):
    """Solve an equation of this module for x; returns (x, converged).

    kind  : GYROSCOPIC, RATTLE, EXPONENTIAL or INCREMENT; v, a, b only for INCREMENT
    start : initial guess
    A correction that does not reduce the residual is halved.
    """
    base = x = start
    scale = _norm1(start)
    correction = (0.0, 0.0, 0.0)
    smallest = math.inf
    for _ in range(MAX_ITERATIONS):
        residual, jacobian = _equation(kind, inertia, h, x, v, a, b, c)
        size = _norm1(residual)
        if size < smallest:
            smallest, base = size, x
            correction = solve3(jacobian, residual)
            x = sub3(base, correction)
            largest = max(scale, _norm1(x))
            if _norm1(correction) <= LAST_CORRECTION * largest:
                return x, True
        else:
            correction = scale3(0.5, correction)
            x = sub3(base, correction)
            if size == 0.0:
                return base, True
    return base, False


@subroutine
def continuation(inertia, h, start, v, a, b, c):
    """Solve an INCREMENT equation from an initial guess, or else by continuation in h.

    returns (x, converged). Rotations of much more than 1 rad have several solutions. Continuation
    follows the solution that is a small rotation for small h.
    """
    x, converged = newton(INCREMENT, inertia, h, start, v, a, b, c)
    if converged:
        return x, True
    solved, increment = 0.0, FIRST_INCREMENT  # fractions of h
    x = (0.0, 0.0, 0.0)
    while solved < 1.0 and increment >= SMALLEST_INCREMENT:
        target = min(1.0, solved + increment)
        prediction = scale3(target / solved, x) if solved > 0.0 else scale3(target, start)
        y, converged = newton(INCREMENT, inertia, target * h, prediction, v, a, b, c)
        deviation = sub3(y, prediction)
        if converged and dot3(deviation, deviation) <= LARGEST_DEVIATION * LARGEST_DEVIATION:
            x, solved = y, target
            increment *= 2.0
        else:
            increment *= 0.5
    return x, solved == 1.0
