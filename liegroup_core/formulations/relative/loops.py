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
from liegroup_core.joints.elements import PAIR, WORLD
from liegroup_core.joints.kinds import variable_row
from liegroup_core.lie.se3 import se3_Ad, se3_ad, se3_inverse
from liegroup_core.lie.vec3 import (
    ZERO3,
    add3,
    axpy3,
    cross3,
    dot3,
    load3,
    load9,
    store3,
    sub3,
    tmatmul3,
    tmatvec3,
)
from liegroup_core.status import DEPENDENT_ROWS, NOT_PROJECTED, OK

from .coordinates import displace, place_links
from .trees import add_wrench, eliminate, gather, move_links, number, spread

# Pivots of W below this part of its diagonal are zero: see model/build.py.
SMALLEST_PIVOT = 1e-10
# Shift of the diagonal of W at a singular pose.
REGULARISATION = 1e-8
SINGULAR = -2


@kernel
def set_rows(model, work):
    """Rows of all cut joints, J V to work.slip and the bias of J Vdot to work.bias."""
    for j in range(len(model.joints)):
        joint = model.joints[j]
        a, b, first, rows = joint["parent"], joint["child"], joint["first"], joint["rows"]
        rot_b, r_b = load9(work.world, b, 0), load3(work.world, b, 9)
        w_b, v_b = load3(work.velocities, b, 0), load3(work.velocities, b, 3)
        if a == WORLD:
            rot, p = se3_inverse(rot_b, r_b)
            w_a, v_a = ZERO3, ZERO3
        else:
            rot = tmatmul3(rot_b, load9(work.world, a, 0))
            p = tmatvec3(rot_b, sub3(load3(work.world, a, 9), r_b))
            w_a, v_a = se3_Ad(rot, p, load3(work.velocities, a, 0), load3(work.velocities, a, 3))
        error_w, error_v = sub3(w_b, w_a), sub3(v_b, v_a)
        rate = 0.0
        if joint["kind"] != PAIR:
            row_w, row_v, rate = variable_row(
                model.elements[joint["element"]], rot, p, error_w, error_v
            )
            store3(row_w, work.child_jacobian, first, 0)
            store3(row_v, work.child_jacobian, first, 3)
        e = ZERO3
        for r in range(first, first + rows):
            alpha, beta = load3(work.child_jacobian, r, 0), load3(work.child_jacobian, r, 3)
            slip = dot3(alpha, error_w) + dot3(beta, error_v)
            work.slip[r] = slip
            e = axpy3(slip, beta, e)
            store3(tmatvec3(rot, sub3(cross3(p, beta), alpha)), work.parent_jacobian, r, 0)
            back = tmatvec3(rot, beta)
            store3((-back[0], -back[1], -back[2]), work.parent_jacobian, r, 3)
        bracket_w, bracket_v = se3_ad(w_b, v_b, w_a, v_a)
        bracket_v = add3(bracket_v, cross3(w_b, e))
        for r in range(first, first + rows):
            work.bias[r] = -rate - (
                dot3(load3(work.child_jacobian, r, 0), bracket_w)
                + dot3(load3(work.child_jacobian, r, 3), bracket_v)
            )


@kernel
def _add_baumgarte(model, work):
    """Add Baumgarte's terms to the bias."""
    rate = model.baumgarte_rate
    position_residuals(model, work.world, work.gap)
    for r in range(len(work.bias)):
        g = work.gap[model.row_residual[r]]
        work.bias[r] -= rate * (2.0 * work.slip[r] + rate * g)


@kernel
def _respond(model, work, j):
    """Responses y of the rows of joint j, along its path to the world."""
    joint = model.joints[j]
    a, b, first, rows = joint["parent"], joint["child"], joint["first"], joint["rows"]
    for r in range(rows):
        at = model.path_places[j] + r
        for k in range(model.paths[j, 0], model.paths[j, 1]):
            link = model.path_links[k]
            for c in range(6):
                work.carried[link, c] = 0.0
        for c in range(6):
            work.carried[b, c] = work.child_jacobian[first + r, c]
        if a != WORLD:
            for c in range(6):
                work.carried[a, c] += work.parent_jacobian[first + r, c]
        for k in range(model.paths[j, 0], model.paths[j, 1]):
            i = model.path_links[k]
            link = model.bodies[i]
            for d in range(link["freedoms"]):
                f = link["freedom"] + number(link["group"], d)
                work.response[at] = eliminate(link, work, f, d, work.carried, i)
                at += rows
            parent = link["parent"]
            if parent != WORLD:
                add_wrench(
                    load3(work.carried, i, 0),
                    load3(work.carried, i, 3),
                    load9(work.relative, i, 0),
                    load3(work.relative, i, 9),
                    work.carried,
                    parent,
                )


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
def _set_residual(model, work):
    """J Vdot - bias of the rows at the present accelerations, to work.right."""
    for j in range(len(model.joints)):
        joint = model.joints[j]
        a, b = joint["parent"], joint["child"]
        w, v = load3(work.moved, b, 0), load3(work.moved, b, 3)
        if a == WORLD:
            # The world accelerates by -g, see trees.py.
            v = add3(v, tmatvec3(load9(work.world, b, 0), load3(model.gravity, 0, 0)))
        for r in range(joint["first"], joint["first"] + joint["rows"]):
            value = dot3(load3(work.child_jacobian, r, 0), w)
            value += dot3(load3(work.child_jacobian, r, 3), v)
            if a != WORLD:
                value += dot3(load3(work.parent_jacobian, r, 0), load3(work.moved, a, 0))
                value += dot3(load3(work.parent_jacobian, r, 3), load3(work.moved, a, 3))
            work.right[r] = value - work.bias[r]


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
        _respond(model, work, j)
    _set_matrix(model, work)


@subroutine
def set_loops(model, work):
    """Rows of the cut joints, and the factor of W.

    returns -1; SINGULAR where W had to be shifted; or the joint with dependent rows if that fails too
    """
    set_rows(model, work)
    if model.baumgarte_rate > 0.0:
        _add_baumgarte(model, work)
    for r in range(len(work.multipliers)):
        work.multipliers[r] = 0.0
    _set_responses(model, work)
    if _factor(model, work, 0.0) < 0:
        return -1
    # Singular pose: accelerations that the joints leave undetermined follow from the masses.
    work.report[2] += 1.0
    dependent = _factor(model, work, REGULARISATION)
    return dependent if dependent >= 0 else SINGULAR


@subroutine
def close_loops(model, work):
    """Change u of the freedoms so that the accelerations in work.moved satisfy the cut joints."""
    _set_residual(model, work)
    _solve(model, work)
    for r in range(len(work.right)):
        work.multipliers[r] += work.right[r]
    _subtract_responses(model, work)
    return 0


@kernel
def add_multipliers(model, work, wrench_out):
    """Add J^T lambda of the cut joints to wrenches on the links (L, 6)."""
    for j in range(len(model.joints)):
        joint = model.joints[j]
        a, b = joint["parent"], joint["child"]
        for r in range(joint["first"], joint["first"] + joint["rows"]):
            for c in range(6):
                wrench_out[b, c] += work.multipliers[r] * work.child_jacobian[r, c]
                if a != WORLD:
                    wrench_out[a, c] += work.multipliers[r] * work.parent_jacobian[r, c]


@subroutine
def project(model, work, pose, twist):
    """Project the rows of the links in pose, twist (n + L, ...) onto the cut joints, in place.

    returns a status: OK, NOT_PROJECTED or DEPENDENT_ROWS + (element of `space` << 8)
    """
    n, links = len(model.parts), len(model.bodies)
    for _ in range(MAX_ITERATIONS + 1):
        move_links(model, work, pose, twist, n)
        place_links(model, work.relative, work.world)
        for b in range(links):
            for c in range(6):
                work.applied[b, c] = 0.0
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
        spread(model, work, 0.0, 0.0, 0.0, 0)
        for b in range(links):
            link = model.bodies[b]
            if satisfied:
                for k in range(link["freedoms"]):
                    twist[n + b, k] += work.acceleration[link["freedom"] + k, 0]
            else:
                displace(link, pose, n + b, work.acceleration, link["freedom"], 1.0, pose)
        if satisfied:
            return OK
    return NOT_PROJECTED
