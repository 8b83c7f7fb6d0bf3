# SPDX-License-Identifier: Apache-2.0
"""Newton's method for one step of the generalised-alpha method, see generalized_alpha.py.

Finite differences give the matrix, so that all forces are implicit without further formulas. It is
dense: its factorisation takes N^3 / 3 multiplications for N unknowns. The factors are reused over
iterations and steps as long as the iteration converges quickly.
"""

import math

from liegroup_core.compiling import kernel
from liegroup_core.dynamics.dense_lu import lu_factorise, lu_solve
from liegroup_core.status import NOT_CONVERGED, OK

from .arrays import sigma
from .steps import residual

# Newton's method ends when the correction of the poses, rad and m, is below TOLERANCE times the
# largest coordinate or 1: about ten times round-off. Its effect on velocities is larger by 2 / h.
# If round-off is larger and corrections stop decreasing, the bound is STUCK times that.
TOLERANCE, STUCK = 2e-15, 100.0
# The matrix is factorised again if a correction exceeds SLOW times the one before, and either it
# exceeds that bound, or the constraints are violated by more than TOLERANCE: near a singular pose old
# factors do not satisfy them. A correction is halved if the next one exceeds GROWTH times it. Some growth is
# allowed: if the initial guess stretches a stiff spring, corrections increase before they decrease.
SLOW, GROWTH = 0.1, 10.0
MOST_ITERATIONS = 50
DISPLACEMENT = 1e-7  # rad and m, perturbation of a pose: the derivative has half of all digits


@kernel
def _differentiate(model, work, memory, numbers, h, pose, external):
    """Factorise the Jacobian of the residual at memory.x; memory.base is the residual there.

    returns a status
    """
    for c in range(len(memory.x)):
        value = memory.x[c]
        memory.x[c] += DISPLACEMENT / sigma(numbers, h) if c < len(memory.rate) else 1.0 + abs(value)
        change = memory.x[c] - value
        status = residual(model, work, memory, numbers, h, pose, external)
        memory.x[c] = value
        if status != OK:
            return status
        for r in range(len(memory.x)):
            memory.matrix[r, c] = (memory.residual[r] - memory.base[r]) / change
    if not lu_factorise(memory.matrix, memory.pivots, len(memory.x)):
        memory.factored[0] = 0.0
        return NOT_CONVERGED
    memory.factored[0] = 1.0
    return OK


@kernel
def _correct(memory, numbers, h):
    """Replace the residual in memory.next by the Newton correction.

    returns the largest displacement of a pose that it causes, rad or m
    """
    lu_solve(memory.matrix, memory.pivots, len(memory.x), memory.next)
    largest = 0.0
    for k in range(len(memory.rate)):
        # NaN propagates.
        if not abs(memory.next[k]) <= largest:
            largest = abs(memory.next[k])
    return largest * sigma(numbers, h)


@kernel
def _violation(memory, numbers, h):
    """Largest position residual in memory.residual, rad or m."""
    largest = 0.0
    for r in range(len(memory.rate), len(memory.x)):
        largest = max(largest, abs(memory.residual[r]))
    return largest * sigma(numbers, h)


@kernel
def newton(model, work, memory, numbers, h, pose, external):
    """Solve one step for memory.x, with memory.x as the initial guess; returns a status."""
    size = len(memory.x)
    tolerance = TOLERANCE * memory.size[0]
    for k in range(size):
        memory.start[k] = memory.x[k]
    old_factors = memory.factored[0] != 0.0
    status, previous = OK, math.inf
    for _ in range(MOST_ITERATIONS):
        status = residual(model, work, memory, numbers, h, pose, external)
        correction = math.inf
        if status == OK and memory.factored[0] != 0.0:
            for k in range(size):
                memory.next[k] = memory.residual[k]
            correction = _correct(memory, numbers, h)
        if (STUCK * tolerance < previous < math.inf) and not correction < GROWTH * previous:
            if old_factors:
                # The iteration diverged with old factors: restart it with new ones.
                memory.factored[0] = 0.0
                old_factors = False
                previous = math.inf
                for k in range(size):
                    memory.x[k] = memory.start[k]
            else:
                for k in range(size):
                    memory.correction[k] *= 0.5
                    memory.x[k] += memory.correction[k]
            continue
        if status != OK:
            return status
        slow = SLOW * previous < correction
        if (
            memory.factored[0] == 0.0
            or (slow and STUCK * tolerance < correction)
            or (slow and old_factors and tolerance < _violation(memory, numbers, h))
        ):
            for k in range(size):
                memory.base[k] = memory.residual[k]
            status = _differentiate(model, work, memory, numbers, h, pose, external)
            if status != OK:
                return status
            old_factors = False
            for k in range(size):
                memory.next[k] = memory.base[k]
            correction = _correct(memory, numbers, h)
        for k in range(size):
            memory.correction[k] = memory.next[k]
            memory.x[k] -= memory.correction[k]
        if correction <= tolerance or SLOW * previous < correction <= STUCK * tolerance:
            return OK
        previous = correction
    if status != OK:
        return status
    return NOT_CONVERGED
