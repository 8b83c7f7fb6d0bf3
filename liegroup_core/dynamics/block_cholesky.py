# SPDX-License-Identifier: Apache-2.0
"""Block-sparse Cholesky of S = J M^-1 J^T on preallocated dense blocks.

The pattern (model.sparsity) is fixed when the model is built; here only numbers move. Joint j
owns k_j rows; a block (i, j) is k_i x k_j, row by row, in the flat array `solve`. The diagonal of
the factor is kept as reciprocals: a division takes as long as ten multiplications.

The usual numbers of rows, 3 and 5, are handed on as constants: the compiler then unrolls the loops
over a block, which was measured to take a quarter to a third of the time.
"""
import math

from .._compile import kernel

# A pivot this small against its own diagonal entry means that a row depends on earlier ones:
# rounding of S leaves about k eps, 1e-13 is some hundred times that.
SMALLEST_PIVOT = 1e-13


@kernel
def _factorise_diagonal(solve, place, k):
    """Cholesky factor of one k x k block in place, its diagonal as reciprocals.

    returns False when a row depends on earlier ones
    """
    for r in range(k):
        for c in range(r):
            total = solve[place + r * k + c]
            for q in range(c):
                total -= solve[place + r * k + q] * solve[place + c * k + q]
            solve[place + r * k + c] = total * solve[place + c * k + c]
        pivot = solve[place + r * k + r]
        total = pivot
        for q in range(r):
            total -= solve[place + r * k + q] * solve[place + r * k + q]
        if not total > SMALLEST_PIVOT * pivot:
            return False
        solve[place + r * k + r] = 1.0 / math.sqrt(total)
    return True


@kernel
def _eliminate(model, solve, j, k):
    """Eliminate joint j, which has k rows; False when one of them depends on earlier ones."""
    joints = model.joints
    place = joints[j]["diagonal"]
    if not _factorise_diagonal(solve, place, k):
        return False
    # L_ij = S_ij L_jj^-T
    for b in range(joints[j]["column_start"], joints[j]["column_end"]):
        at = model.columns[b, 1]
        for r in range(joints[model.columns[b, 0]]["rows"]):
            for c in range(k):
                total = solve[at + r * k + c]
                for q in range(c):
                    total -= solve[at + r * k + q] * solve[place + c * k + q]
                solve[at + r * k + c] = total * solve[place + c * k + c]
    # S_ik -= L_ij L_kj^T
    for u in range(joints[j]["update_start"], joints[j]["update_end"]):
        target = model.updates[u, 0]
        left = model.updates[u, 1]
        right = model.updates[u, 2]
        columns = joints[model.updates[u, 4]]["rows"]
        for r in range(joints[model.updates[u, 3]]["rows"]):
            for c in range(columns):
                total = 0.0
                for q in range(k):
                    total += solve[left + r * k + q] * solve[right + c * k + q]
                solve[target + r * columns + c] -= total
    return True


@kernel
def factorise(model, solve):
    """Overwrite S (lower triangle of blocks) by its Cholesky factor L.

    returns -1, or the joint whose rows depend on rows eliminated before (S is singular)
    """
    for j in range(len(model.joints)):
        k = model.joints[j]["rows"]
        if k == 3:
            good = _eliminate(model, solve, j, 3)
        elif k == 5:
            good = _eliminate(model, solve, j, 5)
        else:
            good = _eliminate(model, solve, j, k)
        if not good:
            return j
    return -1


@kernel
def _forward(model, solve, x, j, k):
    """Solve with column j of L, which has k rows, and take its part from what is below."""
    joints = model.joints
    place = joints[j]["diagonal"]
    at = joints[j]["row_start"]
    for r in range(k):
        total = x[at + r]
        for q in range(r):
            total -= solve[place + r * k + q] * x[at + q]
        x[at + r] = total * solve[place + r * k + r]
    for b in range(joints[j]["column_start"], joints[j]["column_end"]):
        below = joints[model.columns[b, 0]]
        block = model.columns[b, 1]
        for r in range(below["rows"]):
            total = 0.0
            for q in range(k):
                total += solve[block + r * k + q] * x[at + q]
            x[below["row_start"] + r] -= total


@kernel
def _backward(model, solve, x, j, k):
    """Take from row j of L^T, which has k rows, what is below, and solve with it."""
    joints = model.joints
    place = joints[j]["diagonal"]
    at = joints[j]["row_start"]
    for b in range(joints[j]["column_start"], joints[j]["column_end"]):
        below = joints[model.columns[b, 0]]
        block = model.columns[b, 1]
        for r in range(below["rows"]):
            value = x[below["row_start"] + r]
            for q in range(k):
                x[at + q] -= solve[block + r * k + q] * value
    for r in range(k - 1, -1, -1):
        total = x[at + r]
        for q in range(r + 1, k):
            total -= solve[place + q * k + r] * x[at + q]
        x[at + r] = total * solve[place + r * k + r]


@kernel
def substitute(model, solve, x):
    """Solve L L^T x = b in place of b.

    solve : the factor of `factorise`
    x     : (rows,) right-hand side in, solution out
    """
    for j in range(len(model.joints)):
        k = model.joints[j]["rows"]
        if k == 3:
            _forward(model, solve, x, j, 3)
        elif k == 5:
            _forward(model, solve, x, j, 5)
        else:
            _forward(model, solve, x, j, k)
    for j in range(len(model.joints) - 1, -1, -1):
        k = model.joints[j]["rows"]
        if k == 3:
            _backward(model, solve, x, j, 3)
        elif k == 5:
            _backward(model, solve, x, j, 5)
        else:
            _backward(model, solve, x, j, k)
