# SPDX-License-Identifier: Apache-2.0
"""LU factorisation of a dense square matrix with partial pivoting, in place."""

import math

from liegroup_core.compiling import kernel


@kernel
def lu_factorise(matrix, pivots):
    """Replace matrix (n, n) by its LU factors; returns False if it is singular.

    pivots : (n,) int64; row exchanged with row k
    """
    size = len(pivots)
    for k in range(size):
        best = k
        for r in range(k + 1, size):
            if abs(matrix[r, k]) > abs(matrix[best, k]):
                best = r
        pivots[k] = best
        if not 0.0 < abs(matrix[best, k]) < math.inf:
            return False
        if best != k:
            for c in range(size):
                matrix[k, c], matrix[best, c] = matrix[best, c], matrix[k, c]
        for r in range(k + 1, size):
            factor = matrix[r, k] / matrix[k, k]
            matrix[r, k] = factor
            if factor != 0.0:
                for c in range(k + 1, size):
                    matrix[r, c] -= factor * matrix[k, c]
    return True


@kernel
def lu_solve(matrix, pivots, x):
    """Replace the right-hand side x (n,) by the solution, with the factors of `lu_factorise`."""
    size = len(pivots)
    for k in range(size):
        x[k], x[pivots[k]] = x[pivots[k]], x[k]
    for k in range(size):
        for r in range(k + 1, size):
            x[r] -= matrix[r, k] * x[k]
    for k in range(size - 1, -1, -1):
        for c in range(k + 1, size):
            x[k] -= matrix[k, c] * x[c]
        x[k] /= matrix[k, k]
