# SPDX-License-Identifier: Apache-2.0
"""Operations on small dense blocks in one flat array, for the elimination.

A block is given by the address of its first entry in the array `solve`; its entries are stored row
by row. A vector is given by an address too. Sizes are arguments. All functions are inlined, so that
the compiler unrolls their loops for constant sizes.
"""

from liegroup_core.compiling import kernel


@kernel
def invert_diagonal(solve, place, k, sign, floor, first, shift):
    """Replace a k x k block by W below its diagonal and d on it; saddle_point.py defines both.

    sign  : +1 for a positive, -1 for a negative definite block
    floor : array of the smallest regular pivots; those of the block begin at entry `first`
    shift : multiple of these pivots to add to the diagonal
    returns False if a pivot is not above its floor
    """
    # L / d below the diagonal, d on it
    for r in range(k):
        for c in range(r + 1):
            total = sign * solve[place + r * k + c]
            if c == r:
                total += shift * floor[first + r]
            for q in range(c):
                total -= solve[place + r * k + q] * (
                    solve[place + c * k + q] * solve[place + q * k + q]
                )
            if c < r:
                solve[place + r * k + c] = total
            else:
                if not total > floor[first + r]:
                    return False
                solve[place + r * k + r] = 1.0 / total
    # W = L^-1, row by row: W_rc = -sum_q L_rq W_qc
    for r in range(1, k):
        for c in range(r):
            total = solve[place + r * k + c] * solve[place + c * k + c]
            for q in range(c + 1, r):
                total += (
                    solve[place + r * k + q] * solve[place + q * k + q] * solve[place + q * k + c]
                )
            solve[place + r * k + c] = -total
    return True


@kernel
def times_inverse(solve, at, scratch, place, rows, k, sign):
    """Write Y = K_iv W^T of one block of `rows` rows to scratch memory, and s Y d in its place."""
    for r in range(rows):
        for c in range(k - 1, -1, -1):
            total = solve[at + r * k + c]
            for q in range(c):
                total += solve[at + r * k + q] * solve[place + c * k + q]
            solve[scratch + r * k + c] = total
            solve[at + r * k + c] = total * (sign * solve[place + c * k + c])


@kernel
def over_mass(solve, place, x, at, scratch, body):
    """x_at = M^-1 x_at of one body; the old x_at goes to scratch memory.

    place : address of the inverse of the inertia, followed by 1 / mass
    body  : number of coordinates of a body, 6 or 3
    """
    for r in range(body):
        solve[scratch + r] = x[at + r]
    angular = body // 2  # 3 of 6, 1 of 3
    for r in range(angular):
        total = 0.0
        for q in range(angular):
            total += solve[place + r * angular + q] * solve[scratch + q]
        x[at + r] = total
    for r in range(angular, body):
        x[at + r] = solve[place + angular * angular] * solve[scratch + r]


@kernel
def subtract_square(solve, target, left, right, rows, k):
    """K_ii -= L R^T, lower triangle of a symmetric block."""
    for r in range(rows):
        for c in range(r + 1):
            total = 0.0
            for q in range(k):
                total += solve[left + r * k + q] * solve[right + c * k + q]
            solve[target + r * rows + c] -= total


@kernel
def subtract_product(solve, target, left, right, rows, columns, k):
    """K_iw -= L R^T."""
    for r in range(rows):
        for c in range(columns):
            total = 0.0
            for q in range(k):
                total += solve[left + r * k + q] * solve[right + c * k + q]
            solve[target + r * columns + c] -= total


@kernel
def push_block(solve, block, x, to, at, rows, k):
    """x_to -= block x_at."""
    for r in range(rows):
        total = 0.0
        for q in range(k):
            total += solve[block + r * k + q] * x[at + q]
        x[to + r] -= total


@kernel
def pull_block(solve, block, x, to, at, rows, k):
    """x_to -= block^T x_at."""
    for q in range(k):
        total = 0.0
        for r in range(rows):
            total += solve[block + r * k + q] * x[at + r]
        x[to + q] -= total
