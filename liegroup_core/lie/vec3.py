# SPDX-License-Identifier: Apache-2.0
"""Arithmetic of 3-vectors and 3x3 matrices as tuples, for all kernels.

A vector is (x, y, z), a matrix its nine entries row by row. Tuples stay in registers: a cross
product of tuples takes about 1 ns, one of arrays 15 ns and an allocation. Arrays are indexed by row
and column, never sliced: a slice costs two atomic operations on a reference count.
"""

import math

from liegroup_core.compiling import kernel

ZERO3 = (0.0, 0.0, 0.0)
IDENTITY3 = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)


@kernel
def load3(array, row, start):
    """Read three entries of a row of a two-dimensional array, from `start` on."""
    return (array[row, start], array[row, start + 1], array[row, start + 2])


@kernel
def store3(vector, array_out, row, start):
    """Write a vector to a row of a two-dimensional array, from `start` on."""
    array_out[row, start] = vector[0]
    array_out[row, start + 1] = vector[1]
    array_out[row, start + 2] = vector[2]


@kernel
def add_to3(vector, array_out, row, start):
    """Add a vector to three entries of a row of a two-dimensional array, from `start` on."""
    for c in range(3):
        array_out[row, start + c] += vector[c]


@kernel
def load_column(array, row, column):
    """Read three entries of a column of a two-dimensional array, from `row` on."""
    return (array[row, column], array[row + 1, column], array[row + 2, column])


@kernel
def store_column(vector, array_out, row, column):
    """Write a vector to a column of a two-dimensional array, from `row` on."""
    array_out[row, column] = vector[0]
    array_out[row + 1, column] = vector[1]
    array_out[row + 2, column] = vector[2]


@kernel
def load9(array, row, start):
    """Read nine entries of a row of a two-dimensional array, from `start` on: a matrix."""
    return (
        array[row, start],
        array[row, start + 1],
        array[row, start + 2],
        array[row, start + 3],
        array[row, start + 4],
        array[row, start + 5],
        array[row, start + 6],
        array[row, start + 7],
        array[row, start + 8],
    )


@kernel
def store9(matrix, array_out, row, start):
    """Write a matrix to a row of a two-dimensional array, from `start` on."""
    for i in range(9):
        array_out[row, start + i] = matrix[i]


@kernel
def vector3(field):
    """Convert a three-component field of a record to a vector."""
    return (field[0], field[1], field[2])


@kernel
def matrix3(field):
    """Convert a nine-component field of a record to a matrix."""
    return (field[0], field[1], field[2], field[3], field[4], field[5], field[6], field[7], field[8])


@kernel
def add3(a, b):
    """a + b"""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


@kernel
def sub3(a, b):
    """a - b"""
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


@kernel
def scale3(s, a):
    """s a"""
    return (s * a[0], s * a[1], s * a[2])


@kernel
def axpy3(s, a, b):
    """s a + b"""
    return (s * a[0] + b[0], s * a[1] + b[1], s * a[2] + b[2])


@kernel
def dot3(a, b):
    """a . b"""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel
def cross3(a, b):
    """a x b"""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@kernel
def matvec3(m, a):
    """m a"""
    return (
        m[0] * a[0] + m[1] * a[1] + m[2] * a[2],
        m[3] * a[0] + m[4] * a[1] + m[5] * a[2],
        m[6] * a[0] + m[7] * a[1] + m[8] * a[2],
    )


@kernel
def tmatvec3(m, a):
    """m^T a"""
    return (
        m[0] * a[0] + m[3] * a[1] + m[6] * a[2],
        m[1] * a[0] + m[4] * a[1] + m[7] * a[2],
        m[2] * a[0] + m[5] * a[1] + m[8] * a[2],
    )


@kernel
def matmul3(m, n):
    """m n"""
    return (
        m[0] * n[0] + m[1] * n[3] + m[2] * n[6],
        m[0] * n[1] + m[1] * n[4] + m[2] * n[7],
        m[0] * n[2] + m[1] * n[5] + m[2] * n[8],
        m[3] * n[0] + m[4] * n[3] + m[5] * n[6],
        m[3] * n[1] + m[4] * n[4] + m[5] * n[7],
        m[3] * n[2] + m[4] * n[5] + m[5] * n[8],
        m[6] * n[0] + m[7] * n[3] + m[8] * n[6],
        m[6] * n[1] + m[7] * n[4] + m[8] * n[7],
        m[6] * n[2] + m[7] * n[5] + m[8] * n[8],
    )


@kernel
def transpose3(m):
    """m^T"""
    return (m[0], m[3], m[6], m[1], m[4], m[7], m[2], m[5], m[8])


@kernel
def tmatmul3(m, n):
    """m^T n"""
    return matmul3(transpose3(m), n)


@kernel
def solve3(m, b):
    """Solve m x = b by Cramer's rule; the result is not finite if m is singular.

    For Newton's method: accurate if the condition number of m is far below 1/eps.
    """
    r0, r1, r2 = (m[0], m[1], m[2]), (m[3], m[4], m[5]), (m[6], m[7], m[8])
    c0, c1, c2 = cross3(r1, r2), cross3(r2, r0), cross3(r0, r1)
    det = dot3(r0, c0)
    inverse = 1.0 / det if det != 0.0 else math.nan
    return scale3(inverse, axpy3(b[0], c0, axpy3(b[1], c1, scale3(b[2], c2))))
