# SPDX-License-Identifier: Apache-2.0
"""LU factorisation of a dense square matrix with partial pivoting, in place."""

import math

from liegroup_core.compiling import kernel


@kernel
def lu_factorise(matrix, pivots, size):
    """Replace the first `size` rows and columns of a matrix by their LU factors; returns False if it is singular.

    pivots : (size,) int64 or longer; row exchanged with row k
    """
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
def lu_solve(matrix, pivots, size, x):
    """Replace the right-hand side x (size,) by the solution, with the factors of `lu_factorise`."""
    for k in range(size):
        x[k], x[pivots[k]] = x[pivots[k]], x[k]
    for k in range(size):
        for r in range(k + 1, size):
            x[r] -= matrix[r, k] * x[k]
    for k in range(size - 1, -1, -1):
        for c in range(k + 1, size):
            x[k] -= matrix[k, c] * x[c]
        x[k] /= matrix[k, k]


@kernel
def complex_lu_factorise(real, imag, pivots, size):
    """`lu_factorise` of real + i imag, in two arrays whose rows the processor handles in parallel.

    Complex division is written out, since that of compilers and of Python rounds differently.
    """
    for k in range(size):
        best, largest = k, 0.0
        for r in range(k, size):
            square = real[r, k] * real[r, k] + imag[r, k] * imag[r, k]
            if square > largest:
                best, largest = r, square
        pivots[k] = best
        if not 0.0 < largest < math.inf:
            return False
        if best != k:
            for c in range(size):
                real[k, c], real[best, c] = real[best, c], real[k, c]
                imag[k, c], imag[best, c] = imag[best, c], imag[k, c]
        u, v = real[k, k] / largest, -imag[k, k] / largest  # of the inverse of the pivot
        for r in range(k + 1, size):
            a = real[r, k] * u - imag[r, k] * v
            b = real[r, k] * v + imag[r, k] * u
            real[r, k], imag[r, k] = a, b
            if a != 0.0 or b != 0.0:
                for c in range(k + 1, size):
                    real[r, c] -= a * real[k, c] - b * imag[k, c]
                    imag[r, c] -= a * imag[k, c] + b * real[k, c]
    return True


@kernel
def complex_lu_solve(real, imag, pivots, size, x, y):
    """As `lu_solve`, for the right-hand side x + i y, with the factors of `complex_lu_factorise`."""
    for k in range(size):
        other = pivots[k]
        x[k], x[other] = x[other], x[k]
        y[k], y[other] = y[other], y[k]
    for r in range(size):
        a, b = x[r], y[r]
        for k in range(r):
            a -= real[r, k] * x[k] - imag[r, k] * y[k]
            b -= real[r, k] * y[k] + imag[r, k] * x[k]
        x[r], y[r] = a, b
    for k in range(size - 1, -1, -1):
        a, b = x[k], y[k]
        for c in range(k + 1, size):
            a -= real[k, c] * x[c] - imag[k, c] * y[c]
            b -= real[k, c] * y[c] + imag[k, c] * x[c]
        u, v = real[k, k], imag[k, k]
        square = u * u + v * v
        x[k], y[k] = (a * u + b * v) / square, (b * u - a * v) / square
