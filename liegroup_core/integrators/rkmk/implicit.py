# SPDX-License-Identifier: Apache-2.0
"""A substep of an implicit Munthe-Kaas method of three stages, for stiff scenes.

In the algebra, with y = (Psi, change of the velocities), a mechanism is an ordinary differential
equation y' = F(y) from y = 0 on: F = (dexp^-1_{-Psi} V, Vdot) at X_0 exp Psi. The stages of a collocation
method satisfy z_j = h sum_l a_jl F(z_l), and the end is the last stage. With the inverse of a, which has
one real and two complex eigenvalues, Newton's method for

    1/h sum_l (a^-1)_jl z_l - F(z_j) = 0 ,    J = [0 1; Q D]

takes a real and a complex system of the size of the freedoms, mu^2 - mu D - Q, mu = eigenvalue / h
(Hairer and Wanner, Solving ODEs II, IV.8; second-order systems: IV.8, exercise 5). J is by finite
differences at the start of a step, so that all forces are implicit without further formulas, and again
in a later substep if the iteration becomes slow. Its part of the chart, about half of the angular
velocity, is omitted.

The error estimate is (mu - J)^-1 (F(0) + mu sum_j e_j z_j), mu real (IV.8.19): of order three, and bounded
for stiff forces.
"""

import math

from liegroup_core.compiling import kernel, subroutine
from liegroup_core.integrators.dense_lu import (
    complex_lu_factorise,
    complex_lu_solve,
    lu_factorise,
    lu_solve,
)
from liegroup_core.status import DEPENDENT_ROWS, NOT_CONVERGED, OK

from . import relative
from .collocation import END, STAGES, START

# Newton's method ends where the next correction is below ROUNDING, rad or m, and times 1 + the rate for
# rates, or, up to STUCK times that, where it is not below STALLED times the last one: that is rounding. What
# it leaves is no random error: with a bound of 1e-3 of the tolerance motions are wrong by 50 to 500 times
# as much. The matrix is computed anew if a correction is more than SLOW times the one before.
ROUNDING, STUCK, STALLED = 1e-17, 1e5, 0.3
SLOW, MOST_ITERATIONS = 0.05, 20
FREEDOMS_SQUARED = 200  # of a mechanism whose factorisations take as long as an evaluation
DISPLACEMENT = 1e-8  # rad, m, rad/s, m/s: the derivative has half of all digits


@kernel
def _load(source, block, out):
    """Copy a block of Work.slopes to (f, 2): algebra, velocity."""
    half = source.shape[1] // 2
    rows = len(out) // half
    for r in range(rows):
        for c in range(half):
            out[r * half + c, 0] = source[block * rows + r, c]
            out[r * half + c, 1] = source[block * rows + r, half + c]


@kernel
def _store(values, factor, out, block):
    """Copy (f, 2) times a factor to a block of Work.slopes."""
    half = out.shape[1] // 2
    rows = len(values) // half
    for r in range(rows):
        for c in range(half):
            out[block * rows + r, c] = factor * values[r * half + c, 0]
            out[block * rows + r, half + c] = factor * values[r * half + c, 1]


@subroutine
def _evaluate(scheme, model, work, j, time, pose, external):
    """F at z of row j; the stage is there. Returns a status."""
    scheme.spent[0] += 1.0
    half = work.slopes.shape[1] // 2
    rows = len(scheme.initial) // half
    for r in range(rows):
        for c in range(half):
            work.slopes[r, c] = scheme.z[j, r * half + c, 0]
            work.slopes[r, half + c] = scheme.z[j, r * half + c, 1]
    status = relative.move(model, work, scheme, 1.0, 1, j == END, pose)
    if status != OK:
        return status
    work.clock[2] = time
    dependent = relative.accelerate(model, work, external)
    if dependent >= 0:
        return DEPENDENT_ROWS + (dependent << 8)
    relative.store_slopes(model, work, scheme, 1)
    for r in range(rows):
        for c in range(half):
            scheme.slopes[j, r * half + c, 0] = work.slopes[rows + r, c]
            scheme.slopes[j, r * half + c, 1] = work.slopes[rows + r, half + c]
    if j != START and relative.watches(model, work):
        relative.note_stage(model, work, scheme, j + 1 if j < STAGES else STAGES + 1)
    return OK


@kernel
def _differentiate(scheme, model, work, time, pose, external):
    """Set Q and D at the start. Returns a status."""
    f = len(scheme.initial)
    for p in range(f):
        scheme.z[START, p, 0] = scheme.z[START, p, 1] = 0.0
    for p in range(f):
        for part in range(2):
            change = DISPLACEMENT
            if part == 1:
                change *= 1.0 + abs(scheme.initial[p, 0])
            scheme.z[START, p, part] = change
            status = _evaluate(scheme, model, work, START, time, pose, external)
            scheme.z[START, p, part] = 0.0
            if status != OK:
                return status
            for r in range(f):
                slope = (scheme.slopes[START, r, 1] - scheme.initial[r, 1]) / change
                if part == 0:
                    scheme.stiffness[r, p] = slope
                else:
                    scheme.damping[r, p] = slope
    return OK


@kernel
def _factorise(scheme, h):
    """Factorise the real and the complex matrix for a substep of size h; False: one is singular."""
    f, mu = len(scheme.initial), scheme.real_value / h
    a, b = scheme.pair_value[0] / h, scheme.pair_value[1] / h
    scheme.spent[0] += (
        f * f // FREEDOMS_SQUARED
    )  # whole: sums are exact, and repeated runs the same
    for r in range(f):
        for c in range(f):
            q, d = scheme.stiffness[r, c], scheme.damping[r, c]
            scheme.factors[r, c] = -mu * d - q
            scheme.real_factors[r, c] = -a * d - q
            scheme.imag_factors[r, c] = -b * d
        scheme.factors[r, r] += mu * mu
        scheme.real_factors[r, r] += a * a - b * b
        scheme.imag_factors[r, r] += 2.0 * a * b
    if not lu_factorise(scheme.factors, scheme.pivots):
        return False
    return complex_lu_factorise(scheme.real_factors, scheme.imag_factors, scheme.pair_pivots)


@kernel
def _correct(scheme, h):
    """Add the correction of Newton's method to z; returns its size as a multiple of ROUNDING."""
    f, mu = len(scheme.initial), scheme.real_value / h
    a, b = scheme.pair_value[0] / h, scheme.pair_value[1] / h
    for j in range(STAGES):
        for p in range(f):
            for c in range(2):
                total = scheme.slopes[j, p, c]
                for other in range(STAGES):
                    total -= scheme.inverse[j, other] / h * scheme.z[other, p, c]
                scheme.residual[j, p, c] = total
    real, pair = scheme.real, scheme.pair
    for r in range(f):
        # The right side r2 + mu r1 - D r1.
        right, right_a, right_b = 0.0, 0.0, 0.0
        for j in range(STAGES):
            one, two = scheme.residual[j, r, 0], scheme.residual[j, r, 1]
            for p in range(f):
                two -= scheme.damping[r, p] * scheme.residual[j, p, 0]
            right += real[j, 0] * (two + mu * one)
            right_a += pair[j, 0] * (two + a * one) - pair[j, 1] * b * one
            right_b += pair[j, 1] * (two + a * one) + pair[j, 0] * b * one
        scheme.x[r], scheme.real_x[r], scheme.imag_x[r] = right, right_a, right_b
    lu_solve(scheme.factors, scheme.pivots, scheme.x)
    complex_lu_solve(
        scheme.real_factors, scheme.imag_factors, scheme.pair_pivots, scheme.real_x, scheme.imag_x
    )
    largest = 0.0
    for p in range(f):
        one, one_a, one_b = 0.0, 0.0, 0.0
        for j in range(STAGES):
            one += real[j, 0] * scheme.residual[j, p, 0]
            one_a += pair[j, 0] * scheme.residual[j, p, 0]
            one_b += pair[j, 1] * scheme.residual[j, p, 0]
        x, u, v = scheme.x[p], scheme.real_x[p], scheme.imag_x[p]
        rate, rate_u, rate_v = mu * x - one, a * u - b * v - one_a, a * v + b * u - one_b
        of_rates = ROUNDING * (1.0 + abs(scheme.initial[p, 0]))
        for j in range(STAGES):
            moved = real[j, 1] * x + pair[j, 2] * u - pair[j, 3] * v
            change = real[j, 1] * rate + pair[j, 2] * rate_u - pair[j, 3] * rate_v
            scheme.z[j, p, 0] += moved
            scheme.z[j, p, 1] += change
            largest = max(largest, abs(moved) / ROUNDING, abs(change) / of_rates)
            if not abs(moved) + abs(change) < math.inf:
                return math.inf
    return largest


@kernel
def _solve(scheme, model, work, h, start, pose, external):
    """Solve for the stages of a substep of size h. Returns a status."""
    for j in range(STAGES):
        for p in range(len(scheme.initial)):
            scheme.z[j, p, 0] = h * scheme.nodes[j] * scheme.initial[p, 0]
            scheme.z[j, p, 1] = 0.0
    before = math.inf
    for iteration in range(MOST_ITERATIONS):
        for j in range(STAGES):
            time = start + scheme.nodes[j] * h
            status = _evaluate(scheme, model, work, j, time, pose, external)
            if status != OK:
                return status
        size = _correct(scheme, h)
        if iteration > 0:
            ratio = size / before if before > 0.0 else 0.0
            if size > STUCK and ratio > SLOW:
                scheme.known[0] = 0.0
            if size <= STUCK and ratio > STALLED:
                return OK
            if ratio >= 1.0:
                return NOT_CONVERGED
            if ratio * size <= 1.0 - ratio:
                return OK
        before = size
    return NOT_CONVERGED


@kernel
def _estimate(scheme, h):
    """Write the error estimate of a substep of size h to scheme.next."""
    f, real = len(scheme.initial), scheme.real_value / h
    for p in range(f):
        for c in range(2):
            total = scheme.initial[p, c]
            for j in range(STAGES):
                total += real * scheme.estimate[j] * scheme.z[j, p, c]
            scheme.next[p, c] = total
    for r in range(f):
        right = scheme.next[r, 1] + real * scheme.next[r, 0]
        for p in range(f):
            right -= scheme.damping[r, p] * scheme.next[p, 0]
        scheme.x[r] = right
    lu_solve(scheme.factors, scheme.pivots, scheme.x)
    for p in range(f):
        scheme.next[p, 1] = real * scheme.x[p] - scheme.next[p, 0]
        scheme.next[p, 0] = scheme.x[p]


@kernel
def substep(scheme, model, work, size, start, elapsed, first, pose, external):
    """Set the stage to the end of a substep of a size in s; see explicit.py.

    The error estimate is in work.slopes, as the derivative of stage 1.
    """
    begin = start + elapsed
    if first == 0:
        work.clock[2] = begin
        dependent = relative.accelerate(model, work, external)
        if dependent >= 0:
            return DEPENDENT_ROWS + (dependent << 8)
        relative.store_slopes(model, work, scheme, 0)
        if relative.watches(model, work):
            relative.note_stage(model, work, scheme, 0)
    _load(work.slopes, 0, scheme.initial)
    # Not from an earlier step: a run that is repeated from this step on is to be bit-identical.
    fresh = elapsed == 0.0 or scheme.known[0] == 0.0
    status = NOT_CONVERGED
    for _ in range(2):
        if fresh:
            status = _differentiate(scheme, model, work, begin, pose, external)
            if status != OK:
                break
        scheme.known[0] = 1.0
        status = NOT_CONVERGED
        if _factorise(scheme, size):
            status = _solve(scheme, model, work, size, begin, pose, external)
        if status != NOT_CONVERGED or fresh:
            break
        fresh = True
    if status == OK:
        _estimate(scheme, size)
        for p in range(len(scheme.initial)):
            for c in range(2):
                scheme.z[END, p, c] = scheme.z[STAGES - 1, p, c]
        status = _evaluate(scheme, model, work, END, begin + size, pose, external)
    else:
        scheme.known[0] = 0.0
    _store(scheme.initial, 1.0, work.slopes, 0)
    _store(scheme.next, 1.0 / size, work.slopes, 1)
    return status
