# SPDX-License-Identifier: Apache-2.0
"""A substep of an implicit Munthe-Kaas method of three stages, for stiff scenes.

In the algebra, with y = (Psi, change of the velocities), a mechanism is an ordinary differential
equation y' = F(y) from y = 0 on: F = (dexp^-1_{-Psi} V, Vdot) at X_0 exp Psi. The stages of a collocation
method satisfy z_j = h sum_l a_jl F(z_l), and the end is the last stage. With the inverse of a, which has
one real and two complex eigenvalues, Newton's method for

    1/h sum_l (a^-1)_jl z_l - F(z_j) = 0 ,    J = [0 1; Q D]

takes a real and a complex system, mu^2 - mu D - Q, one row for each degree of freedom, mu = eigenvalue / h
(Hairer and Wanner, Solving ODEs II, IV.8; second-order systems: IV.8, exercise 5). J is computed by finite
differences at the start of a step, so that all forces are implicit without further formulas, and again
in a later substep if the iteration becomes slow. The part of J that is due to dexp^-1, about half of the
angular velocity, is omitted.

The error estimate is (mu - J)^-1 (F(0) + mu sum_j e_j z_j), mu real (IV.8.19): of order three, and bounded
for stiff forces.
"""

import math

from liegroup_core.compiling import borrowed, kernel, subroutine
from liegroup_core.dynamics.dense_lu import complex_lu_factorise, complex_lu_solve, lu_factorise, lu_solve
from liegroup_core.forces.law import state_matters
from liegroup_core.status import DEPENDENT_ROWS, NOT_CONVERGED, OK

from . import steps
from .collocation import END, STAGES, START

# Newton's method ends if the next correction is below ROUNDING, rad or m, and for rates ROUNDING (1 + |rate|). At
# up to STUCK times that, it also ends if a correction is not below STALLED times the last one: that is round-off.
# The remaining error is not random: with a bound of 1e-3 of the tolerance, errors of motions are 50 to 500 times
# as large. The matrix is recomputed if a correction is more than SLOW times the last one.
ROUNDING, STUCK, STALLED = 1e-17, 1e5, 0.3
SLOW, MOST_ITERATIONS = 0.05, 20
FREEDOMS_SQUARED = 200  # number of freedoms, squared, at which the factorisations take as long as an evaluation
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
    """Set the stage to row j of z, and evaluate F there. Returns a status."""
    newton = scheme.newton
    scheme.spent[0] += 1.0
    half = work.slopes.shape[1] // 2
    rows = len(newton.initial) // half
    for r in range(rows):
        for c in range(half):
            work.slopes[r, c] = newton.z[j, r * half + c, 0]
            work.slopes[r, half + c] = newton.z[j, r * half + c, 1]
    status = steps.move(model, work, scheme, 1.0, 1, j == END, pose)
    if status != OK:
        return status
    work.clock.now[0] = time
    dependent = steps.accelerate(model, work, external)
    if dependent >= 0:
        return DEPENDENT_ROWS + (dependent << 8)
    steps.store_slopes(model, work, scheme, 1)
    for r in range(rows):
        for c in range(half):
            newton.slopes[j, r * half + c, 0] = work.slopes[rows + r, c]
            newton.slopes[j, r * half + c, 1] = work.slopes[rows + r, half + c]
    if j != START and steps.notes(work):
        steps.note_stage(model, work, scheme, j + 1 if j < STAGES else STAGES + 1)
    return OK


@kernel
def _differentiate(scheme, model, work, time, pose, external):
    """Set Q and D at the start. Returns a status."""
    newton = scheme.newton
    f = len(newton.initial)
    first = f - len(model.law_links)  # freedom of the first state of laws, which is a rate
    for p in range(f):
        newton.z[START, p, 0] = newton.z[START, p, 1] = 0.0
    for p in range(f):
        if p >= first and not state_matters(model.space.forces.laws, work.registers, p - first):
            if newton.filled[p] != 0:
                for r in range(f):
                    newton.stiffness[p, r] = newton.damping[p, r] = 0.0
                newton.filled[p] = 0
            continue
        newton.filled[p] = -1
        for part in range(2):
            if part == 0 and p >= first:
                for r in range(f):
                    newton.stiffness[p, r] = 0.0
                continue
            change = DISPLACEMENT
            if part == 1:
                change *= 1.0 + abs(newton.initial[p, 0])
            newton.z[START, p, part] = change
            status = _evaluate(scheme, model, work, START, time, pose, external)
            newton.z[START, p, part] = 0.0
            if status != OK:
                return status
            for r in range(f):
                slope = (newton.slopes[START, r, 1] - newton.initial[r, 1]) / change
                if part == 0:
                    newton.stiffness[p, r] = slope
                else:
                    newton.damping[p, r] = slope
    return OK


@kernel
def _find_coupled(newton):
    """Find the freedoms on which an acceleration depends, and whose does: no bristles of points that touch nothing."""
    coupled, active, f = newton.coupled, newton.active, len(newton.initial)
    coupled[0] = active[0] = 0
    for r in range(f):
        active[1 + r] = 0
    for p in range(f):
        if newton.filled[p] == 0:
            continue
        newton.filled[p] = 0
        for r in range(f):
            if newton.stiffness[p, r] != 0.0 or newton.damping[p, r] != 0.0:
                newton.filled[p] = active[1 + r] = 1
        if newton.filled[p] != 0:
            coupled[0] += 1
            coupled[coupled[0]] = p
    for r in range(f):
        if active[1 + r] != 0 or newton.filled[r] != 0:
            active[0] += 1
            active[active[0]] = r


@kernel
def _factorise(newton, h):
    """Factorise the real and the complex matrix for a substep of size h; False: one is singular.

    The other freedoms follow from the coupled ones, as a column of theirs is zero but for the diagonal.
    """
    n, mu = newton.coupled[0], newton.real_value / h
    a, b = newton.pair_value[0] / h, newton.pair_value[1] / h
    for i in range(n):
        r = newton.coupled[1 + i]
        for j in range(n):
            c = newton.coupled[1 + j]
            q, d = newton.stiffness[c, r], newton.damping[c, r]
            newton.factors[i, j] = -mu * d - q
            newton.real_factors[i, j] = -a * d - q
            newton.imag_factors[i, j] = -b * d
        newton.factors[i, i] += mu * mu
        newton.real_factors[i, i] += a * a - b * b
        newton.imag_factors[i, i] += 2.0 * a * b
    if not lu_factorise(newton.factors, newton.pivots, n):
        return False
    return complex_lu_factorise(newton.real_factors, newton.imag_factors, newton.pair_pivots, n)


@kernel
def _solve_real(newton, h):
    """Replace x by the solution of the real system."""
    n, mu, packed, x = newton.coupled[0], newton.real_value / h, newton.packed, newton.x
    for i in range(n):
        packed[i] = x[newton.coupled[1 + i]]
    lu_solve(newton.factors, newton.pivots, n, packed)
    if n < len(x):
        for i in range(n):
            c = newton.coupled[1 + i]
            for k in range(newton.active[0]):
                r = newton.active[1 + k]
                x[r] += (mu * newton.damping[c, r] + newton.stiffness[c, r]) * packed[i]
        for r in range(len(x)):
            x[r] /= mu * mu
    for i in range(n):
        x[newton.coupled[1 + i]] = packed[i]


@kernel
def _solve_pair(newton, h):
    """Replace real_x + i imag_x by the solution of the complex system."""
    n, a, b = newton.coupled[0], newton.pair_value[0] / h, newton.pair_value[1] / h
    u, v, x, y = newton.packed, newton.imag_packed, newton.real_x, newton.imag_x
    for i in range(n):
        r = newton.coupled[1 + i]
        u[i], v[i] = x[r], y[r]
    complex_lu_solve(newton.real_factors, newton.imag_factors, newton.pair_pivots, n, u, v)
    if n < len(x):
        real, imag = a * a - b * b, 2.0 * a * b
        square = real * real + imag * imag
        for i in range(n):
            c = newton.coupled[1 + i]
            for k in range(newton.active[0]):
                r = newton.active[1 + k]
                q, d = a * newton.damping[c, r] + newton.stiffness[c, r], b * newton.damping[c, r]
                x[r] += q * u[i] - d * v[i]
                y[r] += q * v[i] + d * u[i]
        for r in range(len(x)):
            one, two = x[r], y[r]
            x[r], y[r] = (one * real + two * imag) / square, (two * real - one * imag) / square
    for i in range(n):
        r = newton.coupled[1 + i]
        x[r], y[r] = u[i], v[i]


@kernel
def _correct(newton, h):
    """Add the correction of Newton's method to z; returns its size as a multiple of ROUNDING."""
    f, mu = len(newton.initial), newton.real_value / h
    a, b = newton.pair_value[0] / h, newton.pair_value[1] / h
    for j in range(STAGES):
        for p in range(f):
            for c in range(2):
                total = newton.slopes[j, p, c]
                for other in range(STAGES):
                    total -= newton.inverse[j, other] / h * newton.z[other, p, c]
                newton.residual[j, p, c] = total
    real, pair = newton.real, newton.pair
    # The right side r2 + mu r1 - D r1.
    for i in range(newton.coupled[0]):
        p = newton.coupled[1 + i]
        for j in range(STAGES):
            one = newton.residual[j, p, 0]
            for k in range(newton.active[0]):
                r = newton.active[1 + k]
                newton.residual[j, r, 1] -= newton.damping[p, r] * one
    for r in range(f):
        right, right_a, right_b = 0.0, 0.0, 0.0
        for j in range(STAGES):
            one, two = newton.residual[j, r, 0], newton.residual[j, r, 1]
            right += real[j, 0] * (two + mu * one)
            right_a += pair[j, 0] * (two + a * one) - pair[j, 1] * b * one
            right_b += pair[j, 1] * (two + a * one) + pair[j, 0] * b * one
        newton.x[r], newton.real_x[r], newton.imag_x[r] = right, right_a, right_b
    _solve_real(newton, h)
    _solve_pair(newton, h)
    largest = 0.0
    for p in range(f):
        one, one_a, one_b = 0.0, 0.0, 0.0
        for j in range(STAGES):
            one += real[j, 0] * newton.residual[j, p, 0]
            one_a += pair[j, 0] * newton.residual[j, p, 0]
            one_b += pair[j, 1] * newton.residual[j, p, 0]
        x, u, v = newton.x[p], newton.real_x[p], newton.imag_x[p]
        rate, rate_u, rate_v = mu * x - one, a * u - b * v - one_a, a * v + b * u - one_b
        of_rates = ROUNDING * (1.0 + abs(newton.initial[p, 0]))
        for j in range(STAGES):
            moved = real[j, 1] * x + pair[j, 2] * u - pair[j, 3] * v
            change = real[j, 1] * rate + pair[j, 2] * rate_u - pair[j, 3] * rate_v
            newton.z[j, p, 0] += moved
            newton.z[j, p, 1] += change
            largest = max(largest, abs(moved) / ROUNDING, abs(change) / of_rates)
            if not abs(moved) + abs(change) < math.inf:
                return math.inf
    return largest


@kernel
def _solve(scheme, model, work, h, start, pose, external):
    """Solve for the stages of a substep of size h. Returns a status."""
    newton = scheme.newton
    for j in range(STAGES):
        for p in range(len(newton.initial)):
            newton.z[j, p, 0] = h * scheme.nodes[j] * newton.initial[p, 0]
            newton.z[j, p, 1] = 0.0
    before = math.inf
    for iteration in range(MOST_ITERATIONS):
        for j in range(STAGES):
            time = start + scheme.nodes[j] * h
            status = _evaluate(scheme, model, work, j, time, pose, external)
            if status != OK:
                return status
        size = _correct(newton, h)
        if iteration > 0:
            ratio = size / before if before > 0.0 else 0.0
            if size > STUCK and ratio > SLOW:
                newton.known[0] = 0.0
            if size <= STUCK and ratio > STALLED:
                return OK
            if ratio >= 1.0:
                return NOT_CONVERGED
            if ratio * size <= 1.0 - ratio:
                return OK
        before = size
    return NOT_CONVERGED


@kernel
def _estimate(newton, h):
    """Write the error estimate of a substep of size h to newton.next."""
    f, real = len(newton.initial), newton.real_value / h
    for p in range(f):
        for c in range(2):
            total = newton.initial[p, c]
            for j in range(STAGES):
                total += real * newton.estimate[j] * newton.z[j, p, c]
            newton.next[p, c] = total
    for r in range(f):
        newton.x[r] = newton.next[r, 1] + real * newton.next[r, 0]
    for i in range(newton.coupled[0]):
        p = newton.coupled[1 + i]
        for k in range(newton.active[0]):
            r = newton.active[1 + k]
            newton.x[r] -= newton.damping[p, r] * newton.next[p, 0]
    _solve_real(newton, h)
    for p in range(f):
        newton.next[p, 1] = real * newton.x[p] - newton.next[p, 0]
        newton.next[p, 0] = newton.x[p]


@kernel
def keep_stages(scheme, work):
    """Keep the stages of a substep, for `inside`."""
    newton = scheme.newton
    half = work.slopes.shape[1] // 2
    rows = len(newton.initial) // half
    for j in range(STAGES):
        for r in range(rows):
            for c in range(half):
                work.kept_slopes[j * rows + r, c] = newton.z[j, r * half + c, 0]
                work.kept_slopes[j * rows + r, half + c] = newton.z[j, r * half + c, 1]


@kernel
def inside(scheme, model, work, theta, start, size, pose):
    """Set the stage to a fraction theta of the kept substep: its collocation polynomial. Returns a status."""
    columns = work.slopes.shape[1]
    rows = len(work.lead_slopes) * 2 // columns
    for r in range(rows):
        for c in range(columns):
            total = 0.0
            for j in range(STAGES):
                weight = 0.0
                for d in range(STAGES - 1, -1, -1):
                    weight = theta * (weight + scheme.inside[j, d])
                total += weight * work.kept_slopes[j * rows + r, c]
            work.slopes[r, c] = total
    work.clock.now[0] = start + theta * size
    return steps.move(model, work, scheme, 1.0, 1, True, pose)


@subroutine
def substep(scheme, model, work, size, start, elapsed, first, pose_in, external_in):
    """Set the stage to the end of a substep of `size` s; see explicit.py.

    The error estimate is in work.slopes, as the derivative of stage 1.
    """
    pose, external = borrowed(pose_in), borrowed(external_in)
    newton = scheme.newton
    begin = start + elapsed
    if first == 0:
        work.clock.now[0] = begin
        dependent = steps.accelerate(model, work, external)
        if dependent >= 0:
            return DEPENDENT_ROWS + (dependent << 8)
        steps.store_slopes(model, work, scheme, 0)
        if steps.notes(work):
            steps.note_stage(model, work, scheme, 0)
    _load(work.slopes, 0, newton.initial)
    # Never the Jacobian of an earlier step, so that a run repeated from this step on is bit-identical.
    fresh = elapsed == 0.0 or newton.known[0] == 0.0
    status = NOT_CONVERGED
    for _ in range(2):
        if fresh:
            status = _differentiate(scheme, model, work, begin, pose, external)
            if status != OK:
                break
        newton.known[0] = 1.0
        status = NOT_CONVERGED
        _find_coupled(newton)  # at each substep, as a snapshot has only the derivatives
        # an integer, so that sums are exact and repeated runs identical
        scheme.spent[0] += newton.coupled[0] * newton.coupled[0] // FREEDOMS_SQUARED
        if _factorise(newton, size):
            status = _solve(scheme, model, work, size, begin, pose, external)
        if status != NOT_CONVERGED or fresh:
            break
        fresh = True
    if status == OK:
        _estimate(newton, size)
        for p in range(len(newton.initial)):
            for c in range(2):
                newton.z[END, p, c] = newton.z[STAGES - 1, p, c]
        status = _evaluate(scheme, model, work, END, begin + size, pose, external)
    else:
        newton.known[0] = 0.0
    _store(newton.initial, 1.0, work.slopes, 0)
    _store(newton.next, 1.0 / size, work.slopes, 1)
    return status
