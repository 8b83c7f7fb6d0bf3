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
PATIENCE = 5  # rounds of block pivoting without fewer wrong entries
FREE, LOW, HIGH = 0, -1, 1


def solve(A, b, lo, hi, fixed=0):
    """(x, w, at): solution, residual, and FREE, LOW or HIGH of each entry.

    A : (k, k) symmetric, positive semidefinite;  b : (k,);  lo <= 0 <= hi : (k,), may be infinite
    fixed : (k,) LOW or HIGH for entries that stay at this bound whatever their w, FREE for the others
    """
    k = len(b)
    fixed = np.broadcast_to(fixed, k)
    at = fixed.copy()
    # Entries with zero mobility go to the bound selected by the sign of b.
    still = (np.diagonal(A) <= 0.0) & (fixed == FREE)
    at[still & (b > 0.0) & np.isfinite(lo)] = LOW
    at[still & (b < 0.0) & np.isfinite(hi)] = HIGH
    fixed = np.where(still, at, fixed)
    fewest, patience = k + 1, PATIENCE
    mobility = np.maximum(np.diagonal(A), 1e-300)
    for _ in range(20 + 10 * k + 2 ** min(k, 10)):
        x, w = _with(A, b, lo, hi, at)
        tolerance = TOLERANCE * (np.abs(A) @ np.abs(x) + np.abs(b))
        reach = tolerance / mobility
        to = at.copy()
        to[(at == FREE) & (x < lo - reach)] = LOW
        to[(at == FREE) & (x > hi + reach)] = HIGH
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
    right = -(b + A @ x)[free]
    if len(free) == 1 and A[free[0], free[0]] > 0.0:
        x[free] = right / A[free[0], free[0]]
    elif len(free):
        x[free] = np.linalg.lstsq(A[np.ix_(free, free)], right, rcond=1e-12)[0]
    w = A @ x + b
    w[free] = 0.0
    return x, w


def _least_squares(A, b, lo, hi):
    sizes, directions = np.linalg.eigh(A)
    kept = sizes > 1e-14 * sizes.max(initial=0.0)
    root = np.sqrt(sizes[kept])
    C = root[:, None] * directions[:, kept].T
    found = scipy.optimize.lsq_linear(C, -(directions[:, kept].T @ b) / root, (lo, hi), method="bvls", tol=1e-15)
    return found.x, A @ found.x + b
