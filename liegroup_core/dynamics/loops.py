# SPDX-License-Identifier: Apache-2.0
"""Closed loops: rows of the cut joints, their solve, and projection onto them.

A cut joint has rows J for the twists of its two links, see rows.py. On the
degrees of freedom of the tree, with the factors of trees.py (M = L D L^T in their order),
    W lambda = J Vdot_free - bias ,   W = J M^-1 J^T = sum over degrees of freedom of y y^T / D
The column y = L^-1 (J^T) of a row results from carrying its wrench along the path from the two links
to the world: y_f = s . w, w <- w - U y_f / D. W is zero where paths of two joints share no freedom.
Its factorisation L D L^T stays within the envelope of W; the order of the cut joints keeps that
narrow. Then u_f - y_f . lambda gives the accelerations with loops.

Positions are projected in the coordinates of the tree: M dq + J^T lambda = 0, J dq = -g, by
Newton's method, and velocities likewise: the tree stays exactly closed.
"""

from liegroup_core.compiling import kernel, shared, subroutine
from liegroup_core.lie.so3 import so3_exp
from liegroup_core.lie.vec3 import load3, load_column, store3, tmatvec3
from liegroup_core.mechanism.bodies import PIVOT, SINGULAR_SOLVES
from liegroup_core.status import DEPENDENT_ROWS, NOT_PROJECTED, OK

from .constraints import MAX_ITERATIONS, is_satisfied
from .coordinates import displace_by_twist, lift_links, place_links
from .coupled_rows import set_all_rows, set_gap
from .matrix import AT, REGULARISATION, factor, has_small_pivot, is_off, set_shared, solve
from .rows import respond
from .trees import gather, move_links, spread_response

SINGULAR, POOR = -2, -3
# Each iteration multiplies the residual of the independent rows by AT / pivot.
ITERATIONS_WHEN_SINGULAR = 4


@shared
def gather_alone(model, work):
    """`gather`, compiled once for all callers except the accelerations, which inline it."""
    gather(model, work)
    return 0


@shared
def factor_alone(model, work, shift):
    """`factor`, compiled once for all callers except the accelerations."""
    return factor(model, work, shift)


@kernel
def _add_baumgarte(model, work):
    """Add Baumgarte's terms to the bias."""
    rate = model.baumgarte_rate
    set_gap(model, work)
    for r in range(len(work.bias)):
        if is_off(model, work, r):
            continue
        g = work.gap[model.row_residual[r]]
        work.bias[r] -= rate * (2.0 * work.slip[r] + rate * g)


@kernel
def _subtract_responses(model, work):
    """Subtract y . lambda from u of all degrees of freedom; lambda is in work.right."""
    for j in range(len(model.cuts)):
        first, rows = model.cuts[j]["first"], model.cuts[j]["rows"]
        at = model.path_places[j]
        for k in range(model.path_ends[j], model.path_ends[j + 1]):
            total = 0.0
            for r in range(rows):
                total += work.response[at + r] * work.right[first + r]
            work.freedoms[model.path_freedoms[k], 7] -= total
            at += rows


@shared
def set_system(model, work):
    """Rows of all cut joints, their responses, and W, for the articulated bodies in `work`."""
    set_all_rows(model, work)
    for j in range(len(model.cuts)):
        respond(model, work, j)
    set_shared(model, work)
    return 0


@shared
def set_loops(model, work):
    """Rows of the cut joints, and the factor of W.

    returns -1; POOR near a singular pose; SINGULAR where W had to be shifted; or the joint with
    dependent rows if that fails too
    """
    set_system(model, work)
    if model.baumgarte_rate > 0.0:
        lift_links(model, work)
        _add_baumgarte(model, work)
    for r in range(len(work.multipliers)):
        work.multipliers[r] = 0.0
    if factor(model, work, 0.0) < 0:
        return POOR if has_small_pivot(work) else -1
    # Singular pose: accelerations that the joints leave undetermined follow from the masses.
    work.report[SINGULAR_SOLVES] += 1.0
    dependent = factor_alone(model, work, REGULARISATION)
    return dependent if dependent >= 0 else SINGULAR


@kernel
def apply_multipliers(model, work):
    """Subtract the response to the known multipliers, of switches that are not held, from u."""
    for r in range(len(work.right)):
        work.right[r] = work.multipliers[r]
    _subtract_responses(model, work)


@subroutine
def close_loops(model, work):
    """Change u of the degrees of freedom so that the residual of the rows in work.right vanishes."""
    solve(model, work)
    for r in range(len(work.right)):
        work.multipliers[r] += work.right[r]
    _subtract_responses(model, work)
    return 0


@shared
def project(model, work):
    """Project the links at the stage onto the cut joints, in place.

    At a singular pose only independent rows are corrected. The remaining gap is of second order in the
    displacement, and is closed at the next pose.

    returns a status: OK, NOT_PROJECTED or DEPENDENT_ROWS + (element of `space` << 8). work.report[PIVOT] is the
    smallest pivot of W there, 0 if a row depends on others
    """
    n, links = len(model.bodies), len(model.links)
    for iteration in range(MAX_ITERATIONS + 1):
        move_links(model, work)
        place_links(model, work)
        lift_links(model, work)
        gather_alone(model, work)
        set_system(model, work)
        set_gap(model, work)
        satisfied = is_satisfied(model, work, work.world)
        dependent = factor_alone(model, work, 0.0)
        pivot = 0.0 if dependent >= 0 else work.report[PIVOT]
        if pivot < AT:
            satisfied = satisfied or iteration >= ITERATIONS_WHEN_SINGULAR
            dependent = factor_alone(model, work, AT * model.usual_pivot)
            work.report[PIVOT] = pivot
            if dependent >= 0:
                return DEPENDENT_ROWS + (model.owners[dependent] << 8)
        for r in range(len(work.right)):
            work.right[r] = work.slip[r] if satisfied else work.gap[model.row_residual[r]]
        solve(model, work)
        for f in range(len(work.freedoms)):
            work.freedoms[f, 7] = 0.0
        _subtract_responses(model, work)
        spread_response(model, work)
        for b in range(links):
            f = model.links[b]["freedom"]
            if satisfied:
                for k in range(model.links[b]["freedoms"]):
                    work.stage_twist[n + b, k] += work.acceleration[f + k, 0]
            else:
                displace_by_twist(model, b, work.stage_pose, work.acceleration, f, work.stage_pose)
                if model.is_empty_tree:
                    # Keep the velocity in world axes: this conserves linear momentum.
                    turn = so3_exp(load_column(work.acceleration, f, 0))
                    v = tmatvec3(turn, load3(work.stage_twist, n + b, 3))
                    store3(v, work.stage_twist, n + b, 3)
        if satisfied:
            return OK
    return NOT_PROJECTED
