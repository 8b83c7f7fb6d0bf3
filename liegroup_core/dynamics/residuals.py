# SPDX-License-Identifier: Apache-2.0
"""What accelerations leave of the equations of motion and of the rows of cut joints."""

from liegroup_core.compiling import kernel, subroutine
from liegroup_core.joints.elements import WORLD
from liegroup_core.lie.vec3 import add3, cross3, dot3, load3, load9, tmatvec3

from .couplings import add_coupling, coupled_rate
from .trees import momentum, pass_on, spread, spread_response


@kernel
def eliminate(work, f, axis, pitch, wrenches, row):
    """Component s . w of a wrench along freedom f of a link; w becomes w - U (s . w) / D.

    axis, pitch : the component of a twist that f is, and the pitch of its screw or 0
    wrenches    : row `row` has w
    """
    y = wrenches[row, axis]
    if pitch != 0.0:
        y += pitch * wrenches[row, 5]
    share = y * work.freedoms[f, 6]
    for c in range(6):
        wrenches[row, c] -= share * work.freedoms[f, c]
    if pitch == 0.0 and work.held[f] == 0.0:
        wrenches[row, axis] = 0.0
    return y


@kernel
def add_own_forces(model, work):
    """Add the wrench that every single link lacks for its acceleration in work.moved to work.force.

    Own inertias and accelerations of links are small numbers where articulated inertias are sums of
    very different ones: the residual has the digits that a solve with those loses.
    """
    for b in range(len(model.bodies)):
        link = model.bodies[b]
        w, v = load3(work.velocities, b, 0), load3(work.velocities, b, 3)
        angular, linear = momentum(link, w, v)
        torque, force = add3(cross3(w, angular), cross3(v, linear)), cross3(w, linear)
        angular, linear = momentum(link, load3(work.moved, b, 0), load3(work.moved, b, 3))
        torque, force = add3(torque, angular), add3(force, linear)
        for c in range(3):
            work.force[b, c] += torque[c] - work.applied[b, c]
            work.force[b, 3 + c] += force[c] - work.applied[b, 3 + c]


@subroutine
def gather_forces(model, work):
    """u of all freedoms for the wrenches -work.force (L, 6) on the links; work.force is overwritten."""
    for b in range(len(model.bodies) - 1, -1, -1):
        link = model.bodies[b]
        for k in range(link["freedom"], link["freedom"] + link["freedoms"]):
            f, axis = model.order[k, 0], model.order[k, 1]
            work.freedoms[f, 7] = -eliminate(work, f, axis, link["pitch"], work.force, b)
        a = link["parent"]
        if a != WORLD:
            pass_on(work, b, work.force, b, a)
    return 0


@kernel
def gather_residual(model, work):
    """u of all freedoms for what the accelerations in work.moved leave of the equations of motion.

    work.force : J^T lambda of the cut joints (L, 6); overwritten
    """
    add_own_forces(model, work)
    gather_forces(model, work)


@kernel
def add_multipliers(model, work):
    """Add J^T lambda of the cut joints to work.force."""
    for j in range(len(model.joints)):
        joint = model.joints[j]
        a, b = joint["parent"], joint["child"]
        for r in range(joint["first"], joint["first"] + joint["rows"]):
            for c in range(6):
                work.force[b, c] += work.multipliers[r] * work.child_jacobian[r, c]
                if a != WORLD:
                    work.force[a, c] += work.multipliers[r] * work.parent_jacobian[r, c]
    for c in range(len(model.couplings)):
        multiplier = work.multipliers[model.couplings[c]["row"]]
        add_coupling(model, work, c, multiplier, work.force, 1)


@kernel
def _set_right(model, work):
    """J Vdot - bias of the rows at the accelerations in work.moved, to work.right."""
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


@subroutine
def set_present_residual(model, work):
    """Residual of the rows at the accelerations in work.moved and work.acceleration, to work.right."""
    _set_right(model, work)
    for c in range(len(model.couplings)):
        row = model.couplings[c]["row"]
        work.right[row] = coupled_rate(model, work.acceleration, c) - work.bias[row]
    return 0


@kernel
def set_free_residual(model, work):
    """Residual of the rows without cut joints, to work.right."""
    spread(model, work)
    set_present_residual(model, work)


@subroutine
def set_residual(model, work):
    """Residual of the rows at work.total_moved and the response to u, to work.right."""
    spread_response(model, work)
    for b in range(len(model.bodies)):
        for c in range(6):
            work.moved[b, c] += work.total_moved[b, c]
    _set_right(model, work)
    for c in range(len(model.couplings)):
        row = model.couplings[c]["row"]
        rate = coupled_rate(model, work.acceleration, c) + coupled_rate(model, work.total, c)
        work.right[row] = rate - work.bias[row]
    return 0
