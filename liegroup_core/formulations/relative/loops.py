# SPDX-License-Identifier: Apache-2.0
"""Closed loops: rows of the cut joints, their solve, and projection onto them.

A cut joint has rows J for the twists of its two links, as in absolute/constraints.py. On the
freedoms of the tree, with the factors of trees.py (M = L D L^T in the freedoms' order),
    W lambda = J Vdot_free - bias ,   W = J M^-1 J^T = sum over freedoms of y y^T / D
The column y = L^-1 (J^T) of a row results from carrying its wrench along the path from the two links
to the world: y_f = s . w, w <- w - U y_f / D. W is zero where paths of two joints share no freedom.
Its factorisation L D L^T stays within the envelope of W; the order of the cut joints keeps that
narrow. Then u_f - y_f . lambda gives the accelerations with loops.

Positions are projected in the coordinates of the tree: M dq + J^T lambda = 0, J dq = -g, by
Newton's method, and velocities likewise: the tree stays exactly closed.
"""

from liegroup_core.compiling import kernel, subroutine
from liegroup_core.formulations.absolute.constraints import position_residuals
from liegroup_core.formulations.absolute.projection import MAX_ITERATIONS, is_satisfied
from liegroup_core.status import DEPENDENT_ROWS, NOT_PROJECTED, OK

from .kinds import (
    displace,
    gather,
    lift_links,
    move_links,
    place_links,
    respond,
    set_right,
    set_rows,
    spread_response,
)
from .rows import number

# Pivots of W below this part of its diagonal are zero: see model/build.py.
SMALLEST_PIVOT = 1e-10
# Shift of the diagonal of W in the solve at a singular pose, and its refinements.
REGULARISATION, REFINEMENTS_WHEN_SINGULAR = 1e-8, 4


@kernel
def _add_baumgarte(model, work):
    """Add Baumgarte's terms to work.right."""
    rate = model.baumgarte_rate
    position_residuals(model, work.world, work.gap)
    for r in range(len(work.right)):
        g = work.gap[model.row_residual[r]]
        work.right[r] += rate * (2.0 * work.slip[r] + rate * g)


@kernel
def _set_matrix(model, work):
    """W in the upper triangle of work.matrix, within its envelope."""
    for r in range(len(work.right)):
        for s in range(model.first_column[r], r + 1):
            work.matrix[s, r] = 0.0
    start = 0
    for k in range(len(model.shared)):
        i, j, end = model.shared[k, 0], model.shared[k, 1], model.shared[k, 2]
        rows_i, rows_j = model.joints[i]["rows"], model.joints[j]["rows"]
        at_i, at_j = model.joints[i]["first"], model.joints[j]["first"]
        for e in range(start, end):
            inverse = work.freedoms[model.shared_freedoms[e, 0], 6]
            place_i, place_j = model.shared_freedoms[e, 1], model.shared_freedoms[e, 2]
            for s in range(rows_j):
                y = inverse * work.response[place_j + s]
                # j <= i: the column is that of the later row.
                for r in range(s if i == j else 0, rows_i):
                    work.matrix[at_j + s, at_i + r] += y * work.response[place_i + r]
        start = end


@kernel
def _factor(model, work, shift):
    """Factorise W + shift diag(W) = L D L^T. Returns -1, or the joint of a dependent row."""
    W = work.matrix
    for j in range(len(model.joints)):
        first = model.joints[j]["first"]
        for r in range(first, first + model.joints[j]["rows"]):
            begin = model.first_column[r]
            pivot = W[r, r] * (1.0 + shift)
            # W_rr is needed again: L has a unit diagonal, and D is in work.diagonal.
            for s in range(begin, r):
                value = W[s, r]
                for t in range(max(begin, model.first_column[s]), s):
                    value -= W[r, t] * W[s, t]
                W[r, s] = value
            for s in range(begin, r):
                value = W[r, s]
                W[r, s] = value * work.diagonal[s]
                pivot -= value * W[r, s]
            if not pivot > SMALLEST_PIVOT * W[r, r]:
                return j
            work.diagonal[r] = 1.0 / pivot
    return -1


@kernel
def _solve(model, work):
    """Solve for work.right in place with the factor of W."""
    L, x = work.matrix, work.right
    for r in range(len(x)):
        for s in range(model.first_column[r], r):
            x[r] -= L[r, s] * x[s]
    for r in range(len(x)):
        x[r] *= work.diagonal[r]
    for r in range(len(x) - 1, -1, -1):
        for s in range(model.first_column[r], r):
            x[s] -= L[r, s] * x[r]


@kernel
def _refine(model, work, times):
    """Solve for work.right by the shifted factor and `times` refinements with W itself."""
    for r in range(len(work.right)):
        work.residual[r], work.multipliers[r] = work.right[r], 0.0
    for step in range(times + 1):
        if step > 0:
            for r in range(len(work.right)):
                work.right[r] = work.residual[r]
            for r in range(len(work.right)):
                for s in range(model.first_column[r], r + 1):
                    W = work.matrix[s, r]
                    work.right[r] -= W * work.multipliers[s]
                    if s != r:
                        work.right[s] -= W * work.multipliers[r]
        _solve(model, work)
        for r in range(len(work.right)):
            work.multipliers[r] += work.right[r]
    for r in range(len(work.right)):
        work.right[r] = work.multipliers[r]


@kernel
def _subtract_responses(model, work):
    """Subtract y . lambda from u of all freedoms; lambda is in work.right."""
    for j in range(len(model.joints)):
        first, rows = model.joints[j]["first"], model.joints[j]["rows"]
        at = model.path_places[j]
        for k in range(model.paths[j, 0], model.paths[j, 1]):
            link = model.bodies[model.path_links[k]]
            for d in range(link["freedoms"]):
                f = link["freedom"] + number(link["group"], d)
                for r in range(rows):
                    work.freedoms[f, 7] -= work.response[at + r] * work.right[first + r]
                at += rows


@kernel
def _set_responses(model, work):
    """Responses of all joints, and W."""
    for j in range(len(model.joints)):
        respond(model, work, j)
    _set_matrix(model, work)


@subroutine
def close_loops(model, work):
    """Change the forces u of the freedoms to those with loops.

    returns -1, or the joint with dependent rows if the regularised solve fails too
    """
    set_right(model, work)
    if model.baumgarte_rate > 0.0:
        lift_links(model, work)
        _add_baumgarte(model, work)
    _set_responses(model, work)
    dependent = _factor(model, work, 0.0)
    if dependent < 0:
        _solve(model, work)
    else:
        # Singular pose: accelerations that the joints leave undetermined follow from the masses.
        work.report[2] += 1.0
        dependent = _factor(model, work, REGULARISATION)
        if dependent >= 0:
            return dependent
        _refine(model, work, REFINEMENTS_WHEN_SINGULAR)
    _subtract_responses(model, work)
    return -1


@subroutine
def project(model, work):
    """Project the links at the stage onto the cut joints, in place.

    returns a status: OK, NOT_PROJECTED or DEPENDENT_ROWS + (element of `space` << 8)
    """
    n, links = len(model.parts), len(model.bodies)
    for _ in range(MAX_ITERATIONS + 1):
        move_links(model, work)
        place_links(model, work)
        lift_links(model, work)
        gather(model, work)
        set_rows(model, work)
        position_residuals(model, work.world, work.gap)
        satisfied = is_satisfied(model, work, work.world)
        _set_responses(model, work)
        dependent = _factor(model, work, 0.0)
        if dependent >= 0:
            return DEPENDENT_ROWS + (model.owners[dependent] << 8)
        for r in range(len(work.right)):
            work.right[r] = work.slip[r] if satisfied else work.gap[model.row_residual[r]]
        _solve(model, work)
        for f in range(len(work.freedoms)):
            work.freedoms[f, 7] = 0.0
        _subtract_responses(model, work)
        spread_response(model, work)
        for b in range(links):
            f = model.bodies[b]["freedom"]
            if satisfied:
                for k in range(model.bodies[b]["freedoms"]):
                    work.stage_twist[n + b, k] += work.acceleration[f + k, 0]
            else:
                displace(model, b, work.stage_pose, work.acceleration, f, work.stage_pose)
        if satisfied:
            return OK
    return NOT_PROJECTED
