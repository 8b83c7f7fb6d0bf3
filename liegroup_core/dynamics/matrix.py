# SPDX-License-Identifier: Apache-2.0
"""W of the cut joints from their responses, its factor and solve; see loops.py."""

from liegroup_core.compiling import kernel
from liegroup_core.mechanism.bodies import NEAR_SOLVES, PIVOT

# A pivot of W counts as zero below this fraction of its diagonal entry: see mechanism/body_model.py.
SMALLEST_PIVOT = 1e-10
# It also does below this fraction of the diagonal entry of another row of the joint: in a flat pose a joint may
# have no mobility at all in one direction.
SMALLEST_MOBILITY = 1e-12
# If a pivot is below this fraction of its diagonal entry, a refinement follows the solve. It recovers the digits
# that the small pivot costs.
SMALL_PIVOT = 1e-2
# Smallest pivot relative to the usual one: below NEAR a pose is near a singular one, below AT it counts as singular.
NEAR, AT = 2.2e-3, 2e-5
# The same of warnings: within about 0.1 rad, which stages of long steps hardly leap over.
PASSING = 1e-2
# Shift of W at a singular pose.
REGULARISATION = 1e-8


@kernel
def set_block(model, work, j):
    """Set the diagonal block of W of joint j from its responses."""
    first, rows = model.cuts[j]["first"], model.cuts[j]["rows"]
    W, y = work.matrix, work.response
    at = model.path_places[j]
    if rows == 3:
        xx, xy, xz, yy, yz, zz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for k in range(model.path_ends[j], model.path_ends[j + 1]):
            a, b, c = y[at], y[at + 1], y[at + 2]
            inverse = work.freedoms[model.path_freedoms[k], 6]
            x, v, z = inverse * a, inverse * b, inverse * c
            xx, xy, xz = xx + x * a, xy + x * b, xz + x * c
            yy, yz, zz = yy + v * b, yz + v * c, zz + z * c
            at += 3
        W[first, first], W[first, first + 1], W[first, first + 2] = xx, xy, xz
        W[first + 1, first + 1], W[first + 1, first + 2] = yy, yz
        W[first + 2, first + 2] = zz
        return
    for s in range(first, first + rows):
        for r in range(s, first + rows):
            W[s, r] = 0.0
    for k in range(model.path_ends[j], model.path_ends[j + 1]):
        inverse = work.freedoms[model.path_freedoms[k], 6]
        for s in range(rows):
            share = inverse * y[at + s]
            for r in range(s, rows):
                W[first + s, first + r] += share * y[at + r]
        at += rows


@kernel
def _add_three(model, work, start, end, s, r):
    """Set the block of W of two joints with three rows each, from rows s and r on."""
    y = work.response
    xx, xy, xz, yx, yy, yz, zx, zy, zz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for e in range(start, end):
        at, other = model.shared_freedoms[e, 2], model.shared_freedoms[e, 1]
        a, b, c = y[other], y[other + 1], y[other + 2]
        inverse = work.freedoms[model.shared_freedoms[e, 0], 6]
        d, f, g = inverse * y[at], inverse * y[at + 1], inverse * y[at + 2]
        xx, xy, xz = xx + d * a, xy + d * b, xz + d * c
        yx, yy, yz = yx + f * a, yy + f * b, yz + f * c
        zx, zy, zz = zx + g * a, zy + g * b, zz + g * c
    W = work.matrix
    W[s, r], W[s, r + 1], W[s, r + 2] = xx, xy, xz
    W[s + 1, r], W[s + 1, r + 1], W[s + 1, r + 2] = yx, yy, yz
    W[s + 2, r], W[s + 2, r + 1], W[s + 2, r + 2] = zx, zy, zz


@kernel
def set_shared(model, work):
    """Set the other blocks of W within its envelope, those of joints that share degrees of freedom."""
    W, y = work.matrix, work.response
    for j in range(len(model.cuts)):
        first = model.cuts[j]["first"]
        for r in range(first, first + model.cuts[j]["rows"]):
            for s in range(model.first_column[r], first):
                W[s, r] = 0.0
    start = 0
    for k in range(len(model.shared)):
        i, j, end = model.shared[k, 0], model.shared[k, 1], model.shared[k, 2]
        at_i, at_j = model.cuts[i]["first"], model.cuts[j]["first"]
        rows_i, rows_j = model.cuts[i]["rows"], model.cuts[j]["rows"]
        if rows_i == 3 and rows_j == 3:
            _add_three(model, work, start, end, at_j, at_i)
            start = end
            continue
        for e in range(start, end):
            inverse = work.freedoms[model.shared_freedoms[e, 0], 6]
            place_i, place_j = model.shared_freedoms[e, 1], model.shared_freedoms[e, 2]
            for s in range(rows_j):
                share = inverse * y[place_j + s]
                for r in range(rows_i):
                    W[at_j + s, at_i + r] += share * y[place_i + r]
        start = end


@kernel
def _mobility(model, W, r, first, rows):
    """Largest diagonal entry of W among the rows of a joint of the kind of row r: rotation or translation."""
    largest = W[r, r]
    for s in range(first, first + rows):
        if W[s, s] > largest and model.row_turns[s] == model.row_turns[r]:
            largest = W[s, s]
    return largest


@kernel
def is_off(model, work, r):
    """Whether row r is inactive: it belongs to a switch that is not held."""
    return model.switched[r] == 1 and work.held[len(work.freedoms) + r] == 0.0


@kernel
def factor(model, work, shift):
    """Factorise W + shift w = L D L^T, w the diagonal matrix of `_mobility`.

    Inactive rows keep their multipliers.
    returns -1, or the joint of a dependent row
    """
    W, held, smallest = work.matrix, False, 1.0
    for k in range(len(model.switches)):
        held = held or work.held[model.switches[k]["freedom"]] != 0.0
    for j in range(len(model.cuts)):
        first = model.cuts[j]["first"]
        rows, in_loop = model.cuts[j]["rows"], model.cuts[j]["in_loop"] == 1
        for r in range(first, first + rows):
            if is_off(model, work, r):
                work.diagonal[r] = 0.0
                continue
            begin = model.first_column[r]
            mobility = _mobility(model, W, r, first, rows)
            pivot = W[r, r] + shift * mobility
            # Keep W_rr for later: L has a unit diagonal, and 1 / D goes to work.diagonal.
            for s in range(begin, r):
                value = W[s, r]
                for t in range(max(begin, model.first_column[s]), s):
                    value -= W[r, t] * W[s, t]
                W[r, s] = value
            for s in range(begin, r):
                value = W[r, s]
                W[r, s] = value * work.diagonal[s]
                pivot -= value * W[r, s]
            least = max(SMALLEST_PIVOT * W[r, r], SMALLEST_MOBILITY * mobility) if in_loop else 0.0
            if not pivot > least:
                if not held:
                    return j
                # The held degrees of freedom and the rows before this one imply it.
                work.diagonal[r] = 0.0
                continue
            work.diagonal[r] = 1.0 / pivot
            if in_loop and pivot < smallest * mobility:
                smallest = pivot / mobility
    work.report[PIVOT] = smallest / model.usual_pivot
    if work.report[PIVOT] < PASSING:
        work.report[NEAR_SOLVES] += 1.0
    return -1


@kernel
def has_small_pivot(work):
    """Whether a pivot of W is below SMALL_PIVOT of its diagonal entry."""
    for r in range(len(work.diagonal)):
        if SMALL_PIVOT * work.matrix[r, r] * work.diagonal[r] > 1.0:
            return True
    return False


@kernel
def solve(model, work):
    """Solve for work.right in place with the factor of W."""
    L, x = work.matrix, work.right
    for r in range(len(x)):
        value = x[r]
        for s in range(model.first_column[r], r):
            value -= L[r, s] * x[s]
        x[r] = value
    for r in range(len(x)):
        x[r] *= work.diagonal[r]
    for r in range(len(x) - 1, -1, -1):
        value = x[r]
        for s in range(model.first_column[r], r):
            x[s] -= L[r, s] * value
