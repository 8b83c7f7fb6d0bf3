# SPDX-License-Identifier: Apache-2.0
"""Linear complementarity problem with bounds, for stops and dry friction that act at once.

    w = A x + b ,   lo <= x <= hi ,   w >= 0 where x = lo,  w <= 0 where x = hi,  w = 0 between

x are impulses or efforts, w the resulting velocities or accelerations. A = D M^-1 D^T is
symmetric and positive semidefinite: a solution is a minimum of x A x / 2 + b x within the bounds. It
exists, and w is unique even if x is not, as with redundant contacts.

Block principal pivoting changes all wrong entries of the active set at once. If their number does not
decrease, Murty's rule changes only the first one, and terminates for positive definite A. If neither
terminates, scipy's bounded least squares finds the minimum.

Source: Cottle, Pang and Stone, The Linear Complementarity Problem, 4.2; Judice and Pires, Computers
and Operations Research 21 (1994), 587-596.
"""

import numpy as np
import scipy

# Relative to the terms of w: a smaller w is zero, and x is at a bound if moving it there changes w by less.
TOLERANCE = 1e-11
DEPENDENT = 1e-10  # an entry depends on others if holding these leaves it less than this fraction of its mobility
REDUNDANT = 1e-12  # remaining mobility, relative to that of the entry alone: below it, entries are redundant
PATIENCE = 5  # rounds of block pivoting without fewer wrong entries
FREE, LOW, HIGH = 0, -1, 1


def solve(A, b, lo, hi, fixed=0):
    """(x, w, at): solution, residual, and FREE, LOW or HIGH of each entry.

    A : (k, k) symmetric, positive semidefinite;  b : (k,);  lo <= 0 <= hi : (k,), may be infinite
    fixed : (k,) LOW or HIGH for entries that stay at this bound whatever their w, FREE for the others
    """
    k, sizes = len(b), np.diagonal(A)
    # With a diagonal near 1, Cholesky factors keep the digits of small entries beside large ones. Powers of 2 are
    # exact.
    scale = np.exp2(-np.rint(0.5 * np.log2(np.where(sizes > 0.0, sizes, 1.0))))
    A, b, lo, hi = A * scale * scale[:, None], b * scale, lo / scale, hi / scale
    x, w, at = _solve_scaled(A, b, lo, hi, np.broadcast_to(fixed, k))
    return x * scale, w / scale, at


def _solve_scaled(A, b, lo, hi, fixed):
    """`solve` for a matrix whose diagonal has entries from 0.5 to 2, or 0 for an entry without mobility."""
    k = len(b)
    at = fixed.copy()
    # Entries with zero mobility go to the bound selected by the sign of b.
    still = (np.diagonal(A) <= 0.0) & (fixed == FREE)
    at[still & (b > 0.0) & np.isfinite(lo)] = LOW
    at[still & (b < 0.0) & np.isfinite(hi)] = HIGH
    fixed = np.where(still, at, fixed)
    fewest, patience = k + 1, PATIENCE
    for _ in range(20 + 10 * k + 2 ** min(k, 10)):
        x, w = _with(A, b, lo, hi, at)
        tolerance = TOLERANCE * (np.abs(A) @ np.abs(x) + np.abs(b))
        to = at.copy()
        to[(at == FREE) & (x < lo - tolerance)] = LOW
        to[(at == FREE) & (x > hi + tolerance)] = HIGH
        to[(at == LOW) & (w < -tolerance)] = FREE
        to[(at == HIGH) & (w > tolerance)] = FREE
        wrong = np.flatnonzero((to != at) & (fixed == FREE))
        if not len(wrong):
            return x, w, at
        if len(wrong) < fewest:
            fewest, patience = len(wrong), PATIENCE
        else:
            patience -= 1
        if patience < 0:
            wrong = wrong[:1]
        at[wrong] = to[wrong]
    lo, hi = np.where(fixed == HIGH, hi, lo), np.where(fixed == LOW, lo, hi)
    x, w = _least_squares(A, b, lo, hi)
    return x, w, np.where(x <= lo, LOW, np.where(x >= hi, HIGH, FREE))


def independent(A, free):
    """(mask of free entries that are independent, mask of the others that depend on these).

    Takes the entries with the largest remaining mobility first: Cholesky factorisation with pivoting.
    """
    rest, left = A.astype(float), free.copy()
    held = np.zeros(len(A), dtype=bool)
    least = DEPENDENT * np.diagonal(A)
    while (left := left & (np.diagonal(rest) > least)).any():
        k = np.argmax(np.where(left, np.diagonal(rest), -np.inf))
        rest = rest - np.outer(rest[:, k], rest[k] / rest[k, k])
        held[k], left[k] = True, False
    return held, ~held & (np.diagonal(rest) <= least)


def _with(A, b, lo, hi, at):
    """(x, w) for an active set; x has the smallest norm if free entries are redundant."""
    x = np.where(at == LOW, lo, np.where(at == HIGH, hi, 0.0))
    free = np.flatnonzero(at == FREE)
    if len(free):
        part, right = A[np.ix_(free, free)], -(b + A @ x)[free]
        factor, failed = scipy.linalg.lapack.dpotrf(part, lower=1)
        if failed or np.diagonal(factor).min() ** 2 <= REDUNDANT:
            x[free] = np.linalg.lstsq(part, right, rcond=REDUNDANT)[0]
        else:
            x[free] = scipy.linalg.lapack.dpotrs(factor, right, lower=1)[0]
    w = A @ x + b
    w[free] = 0.0
    return x, w


def _least_squares(A, b, lo, hi):
    """(x, w) that minimises x A x / 2 + b x within the bounds; entries with equal bounds are there."""
    x = np.where(lo == hi, lo, 0.0)
    some = lo < hi
    if not some.all():
        if some.any():
            x[some], _ = _least_squares(A[np.ix_(some, some)], (b + A @ x)[some], lo[some], hi[some])
        return x, A @ x + b
    sizes, directions = np.linalg.eigh(A)
    kept = sizes > 1e-14 * sizes.max(initial=0.0)
    root = np.sqrt(sizes[kept])
    C = root[:, None] * directions[:, kept].T
    found = scipy.optimize.lsq_linear(C, -(directions[:, kept].T @ b) / root, (lo, hi), method="bvls", tol=1e-15)
    return found.x, A @ found.x + b
