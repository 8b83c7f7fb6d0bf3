# SPDX-License-Identifier: Apache-2.0
"""Residuals of the equations of motion and of the rows of cut joints, for given accelerations."""

from liegroup_core.compiling import kernel, subroutine
from liegroup_core.joints.elements import WORLD

from .algebra import add, add_to, choice, link_of, load, offset, product, size, sub
from .couplings import add_coupling, add_rotors, coupled_rate
from .links import acceleration_of, bias_force, leave, momentum
from .trees import spread, spread_response


@kernel
def add_own_forces(model, work):
    """Add the wrench that every single link needs for its acceleration in work.moved to work.force.

    It uses the links' own inertias, where articulated inertias are sums of very different numbers. So the
    residual keeps digits that a solve with articulated inertias loses.
    """
    for b in range(len(model.links)):
        link = link_of(model, b)
        F = bias_force(model, work, link, b)
        F = add(model, F, momentum(model, link, load(model, work.moved, b)))
        add_to(model, sub(model, F, load(model, work.applied, b)), work.force, b)


@subroutine
def gather_forces(model, work):
    """u of all degrees of freedom for the wrenches -work.force (L, s) on the links; work.force is overwritten."""
    for b in range(len(model.links) - 1, -1, -1):
        leave(model, work, link_of(model, b), b)
    return 0


@kernel
def gather_residual(model, work):
    """u of all degrees of freedom for the residual of the equations of motion at work.moved and work.total.

    work.force : J^T lambda of the cut joints (L, s); overwritten
    """
    add_own_forces(model, work)
    add_rotors(model, work, work.total, 1.0, work.force)
    gather_forces(model, work)


@kernel
def add_multipliers(model, work):
    """Add J^T lambda of the cut joints to work.force."""
    for j in range(len(model.cuts)):
        cut = model.cuts[j]
        a, b = cut["parent"], cut["child"]
        for r in range(cut["first"], cut["first"] + cut["rows"]):
            for c in range(size(model)):
                at = offset(model) + c
                work.force[b, c] += work.multipliers[r] * work.child_jacobian[r, at]
                if a != WORLD:
                    work.force[a, c] += work.multipliers[r] * work.parent_jacobian[r, at]
    for c in range(len(model.couplings)):
        multiplier = work.multipliers[model.couplings[c]["row"]]
        add_coupling(model, work, c, multiplier, work.force, 1)


@kernel
def _set_right(model, work):
    """Write J Vdot - bias of the rows at the accelerations in work.moved to work.right."""
    for j in range(len(model.cuts)):
        cut = model.cuts[j]
        a, b = cut["parent"], cut["child"]
        V = acceleration_of(model, work, b, a)
        for r in range(cut["first"], cut["first"] + cut["rows"]):
            value = product(model, 0.0, work.child_jacobian, r, V)
            if a != WORLD:
                above = load(model, work.moved, a)
                value = product(model, value, work.parent_jacobian, r, above)
            work.right[r] = value - work.bias[r]


@subroutine
def set_present_residual(model, work):
    """Write the residual of the rows at work.moved and work.acceleration to work.right."""
    _set_right(model, work)
    for c in range(len(model.couplings)):
        row = model.couplings[c]["row"]
        work.right[row] = coupled_rate(model, work, work.acceleration, 0, c) - work.bias[row]
    return 0


@kernel
def set_response_residual(model, work):
    """Write the residual of the rows in the response to u, J Vdot - bias, to work.right."""
    for j in range(len(model.cuts)):
        first, rows = model.cuts[j]["first"], model.cuts[j]["rows"]
        at = model.path_places[j]
        for r in range(first, first + rows):
            work.right[r] = -work.bias[r]
        for k in range(model.path_ends[j], model.path_ends[j + 1]):
            f = model.path_freedoms[k]
            rate = work.freedoms[f, 6] * work.freedoms[f, 7]
            for r in range(rows):
                work.right[first + r] += work.response[at + r] * rate
            at += rows


@kernel
def _set_moved_residual(model, work):
    """Write the residual of the rows at the accelerations without cut joints to work.right."""
    spread(model, work)
    set_present_residual(model, work)


@kernel
def _set_carried_residual(model, work):
    """The same in a plane: `respond` has written J E to work.right."""
    for r in range(len(work.right)):
        work.right[r] -= work.bias[r]


set_free_residual = choice("set_free_residual", _set_moved_residual, _set_carried_residual)


@subroutine
def set_residual(model, work):
    """Write the residual of the rows at work.total_moved plus the response to u to work.right."""
    spread_response(model, work)
    for b in range(len(model.links)):
        for c in range(size(model)):
            work.moved[b, c] += work.total_moved[b, c]
    _set_right(model, work)
    for c in range(len(model.couplings)):
        row = model.couplings[c]["row"]
        rate = coupled_rate(model, work, work.acceleration, 0, c) + coupled_rate(model, work, work.total, 0, c)
        work.right[row] = rate - work.bias[row]
    return 0
