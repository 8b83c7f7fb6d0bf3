# SPDX-License-Identifier: Apache-2.0
"""Small kernels that use every replaced part of Numba once, with known results."""

import platform

import numpy as np

from .kernels import Choice, kernel, shared, stepper, subroutine
from .structs import Struct, borrowed

ROW = np.dtype([("number", "i8"), ("vector", "f8", (3,))], align=True)


class Inner(Struct):
    matrix: np.ndarray
    shift: float


class Outer(Struct):
    flag: bool
    count: int
    inner: Inner
    rows: np.ndarray


@kernel
def _of_inner(first, factor):
    return factor * first.shift


@kernel
def _of_outer(first, factor):
    return factor * first.count


_either = Choice("either", {Inner: _of_inner, Outer: _of_outer})


@subroutine
def _sum(matrix, row):
    total = 0.0
    for i in range(matrix.shape[1]):
        total += matrix[row, i]
    return total


@shared
def _shared(outer, factor, flag):
    return outer.count * factor if flag else -1


@shared
def _halve(first, array):
    array[0] *= 0.5
    return 0


_shared_choice = Choice("shared", {Inner: _halve, Outer: _halve})


@kernel
def _move(outer, array):
    outer.inner.matrix[1, 0] = _sum(outer.inner.matrix, 1) + outer.rows[1]["vector"][2]
    outer.rows[0]["number"] = _shared(outer, 3, True) + _shared(outer, 5, outer.flag)
    _shared_choice(outer, array)
    return _either(outer, 2.0) + _either(outer.inner, 2.0)


@stepper
def _steps(outer, array, steps):
    array = borrowed(array)
    total = 0.0
    for _ in range(steps):
        total += _move(outer, array)
    return total


def check():
    """Compile and run the kernels; raise ArithmeticError if a result is wrong."""
    rows = np.zeros(2, dtype=ROW)
    rows["vector"] = 0.25
    inner = Inner(matrix=np.arange(4.0).reshape(2, 2), shift=0.5)
    outer = Outer(flag=False, count=7, inner=inner, rows=rows)
    array = np.array([2.0**-1022])
    results = (_steps(outer, array, 2), inner.matrix.tolist(), int(rows["number"][0]), _shared(outer, 3, True))
    expected = (30.0, [[0.0, 1.0], [8.5, 3.0]], 20, 21)
    if results != expected:
        raise ArithmeticError(f"small kernels returned {results}, expected {expected}")
    if platform.machine() in ("x86_64", "AMD64") and (array[0], 0.5 * 2.0**-1022) != (0.0, 2.0**-1023):
        raise ArithmeticError("subnormal numbers are not flushed to zero in steps only")
