# SPDX-License-Identifier: Apache-2.0
"""Block-sparse elimination of the saddle-point matrix (6.22) on preallocated dense blocks.

    K = | M  J^T |
        | J   0  |

The pattern (model/sparsity.py) is fixed when the model is built. A vertex (body or joint) of k
scalars owns k columns; a block (i, j) is k_i x k_j, row by row, in the flat array `solve`. Diagonal
blocks of bodies are positive definite, s = 1, those of joints negative definite, s = -1:
    s K_vv = (W^T d W)^-1 ,     W unit lower triangular, d diagonal
W and d replace the block, and s K_iv W^T d replaces a block below it. This avoids the solution of
small triangular systems: their latency would take most of the time. If the block of a body is its
constant mass matrix, W and d are not computed: M^-1 (a small matrix and a number) and K_iv M^-1 are
stored.

The most frequent sizes (a body and two kinds of joints) are passed as constants. The
compiler then unrolls the loops over a block, which reduces the time to a quarter or a third
(measured).
"""

from liegroup_core.compiling import kernel, shared
from liegroup_core.joints.elements import WORLD

from .blocks import (
    invert_diagonal,
    over_mass,
    pull_block,
    push_block,
    subtract_product,
    subtract_square,
    times_inverse,
)

# Scalars of a body and of the two most frequent kinds of joints.
SIZES = (6, 3, 5)  # body; spherical; revolute or prismatic
NONE = 0  # no second frequent size

# Diagonal entry of dependent rows, as a multiple of their pivot floor.
REGULARISATION = 1e2


@kernel
def _update(model, solve, v, k, frequent, second):
    """Update the blocks of the vertices that are coupled with vertex v of k scalars.

    frequent, second : most frequent sizes of these vertices, as constants
    """
    vertices = model.vertices
    for u in range(vertices[v]["update_start"], vertices[v]["update_end"]):
        target = model.updates[u, 0]
        left = model.updates[u, 1]
        right = model.updates[u, 2]
        rows = vertices[model.updates[u, 3]]["size"]
        if model.updates[u, 3] == model.updates[u, 4]:
            if rows == frequent:
                subtract_square(solve, target, left, right, frequent, k)
            elif rows == second:
                subtract_square(solve, target, left, right, second, k)
            else:
                subtract_square(solve, target, left, right, rows, k)
            continue
        columns = vertices[model.updates[u, 4]]["size"]
        if rows == frequent and columns == frequent:
            subtract_product(solve, target, left, right, frequent, frequent, k)
        else:
            subtract_product(solve, target, left, right, rows, columns, k)


@kernel
def _eliminate(model, solve, v, k, sign, frequent, second, shift):
    """Eliminate vertex v of k scalars; returns False if one of its pivots is too small."""
    vertices = model.vertices
    place = vertices[v]["diagonal"]
    if vertices[v]["is_constant"] == 0 and not invert_diagonal(
        solve, place, k, sign, model.pivot_floor, vertices[v]["start"], shift
    ):
        return False
    for b in range(vertices[v]["column_fresh"], vertices[v]["column_end"]):
        rows = vertices[model.columns[b, 0]]["size"]
        at, scratch = model.columns[b, 1], model.columns[b, 2]
        if rows == frequent:
            times_inverse(solve, at, scratch, place, frequent, k, sign)
        elif rows == second:
            times_inverse(solve, at, scratch, place, second, k, sign)
        else:
            times_inverse(solve, at, scratch, place, rows, k, sign)
    _update(model, solve, v, k, frequent, second)
    return True


@kernel
def _eliminate_mass(model, solve, v, body, frequent, second):
    """Eliminate body v with a constant mass matrix: K_iv M^-1 below it, K_iv to scratch memory."""
    vertices = model.vertices
    for b in range(vertices[v]["column_fresh"], vertices[v]["column_end"]):
        for r in range(vertices[model.columns[b, 0]]["size"]):
            over_mass(
                solve,
                vertices[v]["diagonal"],
                solve,
                model.columns[b, 1] + r * body,
                model.columns[b, 2] + r * body,
                body,
            )
    _update(model, solve, v, body, frequent, second)


@kernel
def _push(model, solve, x, v, k, frequent, second):
    """Forward substitution: subtract the contribution of vertex v from later vertices."""
    vertices = model.vertices
    at = vertices[v]["start"]
    for b in range(vertices[v]["column_start"], vertices[v]["column_end"]):
        below = vertices[model.columns[b, 0]]
        rows = below["size"]
        if rows == frequent:
            push_block(solve, model.columns[b, 1], x, below["start"], at, frequent, k)
        elif rows == second:
            push_block(solve, model.columns[b, 1], x, below["start"], at, second, k)
        else:
            push_block(solve, model.columns[b, 1], x, below["start"], at, rows, k)


@kernel
def _pull(model, solve, x, v, k, frequent, second):
    """Back substitution: subtract the contributions of later vertices from vertex v."""
    vertices = model.vertices
    at = vertices[v]["start"]
    for b in range(vertices[v]["column_start"], vertices[v]["column_end"]):
        below = vertices[model.columns[b, 0]]
        rows = below["size"]
        if rows == frequent:
            pull_block(solve, model.columns[b, 1], x, at, below["start"], frequent, k)
        elif rows == second:
            pull_block(solve, model.columns[b, 1], x, at, below["start"], second, k)
        else:
            pull_block(solve, model.columns[b, 1], x, at, below["start"], rows, k)


@kernel
def _eliminate_vertex(model, solve, x, v, k, sign, frequent, second, shift, fresh):
    """Eliminate vertex v of k scalars from K, if K is fresh, and from the right-hand side x.

    The entries of the vertex in x become s d W x_v.
    returns False if one of its pivots is too small
    """
    if fresh and not _eliminate(model, solve, v, k, sign, frequent, second, shift):
        return False
    place = model.vertices[v]["diagonal"]
    at = model.vertices[v]["start"]
    for r in range(k - 1, 0, -1):
        total = x[at + r]
        for q in range(r):
            total += solve[place + r * k + q] * x[at + q]
        x[at + r] = total
    _push(model, solve, x, v, k, frequent, second)
    for r in range(k):
        x[at + r] *= sign * solve[place + r * k + r]
    return True


@kernel
def _eliminate_body(model, solve, x, v, body, frequent, second, fresh):
    """Eliminate the vertex of a body with a constant mass matrix; its entries become M^-1 x_v."""
    if fresh:
        _eliminate_mass(model, solve, v, body, frequent, second)
    _push(model, solve, x, v, body, frequent, second)
    over_mass(
        solve,
        model.vertices[v]["diagonal"],
        x,
        model.vertices[v]["start"],
        len(model.constant),
        body,
    )


@kernel
def _substitute_vertex(model, solve, x, v, k, frequent, second):
    """Back substitution of vertex v of k scalars: subtract contributions, multiply by W^T."""
    _pull(model, solve, x, v, k, frequent, second)
    place = model.vertices[v]["diagonal"]
    at = model.vertices[v]["start"]
    for r in range(k - 1):
        total = x[at + r]
        for q in range(r + 1, k):
            total += solve[place + q * k + r] * x[at + q]
        x[at + r] = total


@kernel
def eliminate(model, solve, x, fresh, shift):
    """Forward elimination of K (Vdot, lambda) = (Q, bias), in place of K and the right-hand side.

    solve : lower triangle of K if `fresh`, else the result of an earlier call; then scratch memory
    x     : (unknowns,) right-hand side: bodies, then joints
    shift : 0, or multiple of the pivot floors to subtract from the zero diagonal of the joints
    returns -1, or the joint (index in model.joints) with dependent rows: K is singular

    K and the right-hand side are eliminated together, vertex by vertex: this hides the latency of
    divisions.
    """
    body, first, second = SIZES
    for v in range(len(model.vertices)):
        k = model.vertices[v]["size"]
        good = True
        if model.vertices[v]["joint"] < 0:
            if model.vertices[v]["is_constant"] == 1:
                _eliminate_body(model, solve, x, v, body, first, second, fresh)
            else:
                good = _eliminate_vertex(model, solve, x, v, body, 1.0, first, second, 0.0, fresh)
        elif k == first:
            good = _eliminate_vertex(model, solve, x, v, first, -1.0, first, body, shift, fresh)
        elif k == second:
            good = _eliminate_vertex(model, solve, x, v, second, -1.0, second, body, shift, fresh)
        else:
            good = _eliminate_vertex(model, solve, x, v, k, -1.0, body, NONE, shift, fresh)
        if not good:
            return model.vertices[v]["joint"]
    return -1


@kernel
def _substitute(model, solve, x):
    """Back substitution after `eliminate`, in place."""
    body, first, second = SIZES
    for v in range(len(model.vertices) - 1, -1, -1):
        k = model.vertices[v]["size"]
        if model.vertices[v]["joint"] < 0:
            if model.vertices[v]["is_constant"] == 1:
                _pull(model, solve, x, v, body, first, second)
            else:
                _substitute_vertex(model, solve, x, v, body, first, second)
        elif k == first:
            _substitute_vertex(model, solve, x, v, first, first, body)
        elif k == second:
            _substitute_vertex(model, solve, x, v, second, second, body)
        else:
            _substitute_vertex(model, solve, x, v, k, body, NONE)


@kernel
def _subtract_rows(matrix, place, turned, rows, body, x, row_start, body_start, y_out):
    """Subtract both products of the block J of a joint and a body: y -= (J^T lambda, J x)."""
    for r in range(rows):
        for c in range(body):
            value = matrix[place + (c * rows + r if turned == 1 else r * body + c)]
            y_out[row_start + r] -= value * x[body_start + c]
            y_out[body_start + c] -= value * x[row_start + r]


@kernel
def _subtract_image(model, matrix, x, y_out, body):
    """y -= K x, with K as written by `assemble`; body: scalars of a body."""
    for v in range(len(model.vertices)):
        if model.vertices[v]["joint"] < 0:
            at = model.vertices[v]["start"]
            place = model.vertices[v]["diagonal"]
            for r in range(body):
                for c in range(body):
                    y_out[at + r] -= model.constant[place + r * body + c] * x[at + c]
    for j in range(len(model.joints)):
        a = model.joints[j]["parent"]
        b = model.joints[j]["child"]
        rows = model.joints[j]["rows"]
        start = model.joints[j]["start"]
        _subtract_rows(
            matrix,
            model.joints[j]["child_place"],
            model.joints[j]["child_turned"],
            rows,
            body,
            x,
            start,
            body * b,
            y_out,
        )
        if a != WORLD:
            _subtract_rows(
                matrix,
                model.joints[j]["parent_place"],
                model.joints[j]["parent_turned"],
                rows,
                body,
                x,
                start,
                body * a,
                y_out,
            )


@shared
def solve(model, work, refinements, shift, fresh):
    """Solve K x = b with iterative refinement.

    work.matrix   : K, overwritten; constant vertices are already eliminated
    work.solution : b, overwritten by x
    fresh         : False: work.matrix is the result of an earlier call; with refinement, work.kept
                    is K
    shift         : see `eliminate`. Refinement removes the effect of the shift, except in directions
                    in which K is singular: there the constraints have no effect
    returns -1, or the joint with dependent rows
    """
    if refinements > 0:
        if fresh:
            for i in range(model.fresh):
                work.kept[i] = work.matrix[i]
        for i in range(len(work.right)):
            work.right[i] = work.solution[i]
    x = work.solution
    for step in range(refinements + 1):
        if step > 0:
            x = work.residual
            for i in range(len(work.right)):
                x[i] = work.right[i]
            _subtract_image(model, work.kept, work.solution, x, SIZES[0])
        dependent = eliminate(model, work.matrix, x, fresh and step == 0, shift)
        if dependent >= 0:
            return dependent
        _substitute(model, work.matrix, x)
        if step > 0:
            for i in range(len(work.right)):
                work.solution[i] += x[i]
    return -1
