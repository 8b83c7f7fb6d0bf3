# SPDX-License-Identifier: Apache-2.0
"""Residuals in the plane: residuals.py with three numbers per twist."""

from liegroup_core.compiling import kernel, subroutine
from liegroup_core.joints.elements import WORLD
from liegroup_core.lie.vec3 import load3
from liegroup_core.motion_groups.table import HINGE, SLIDE

from .couplings import coupled_rate
from .plane_couplings import add_coupling


@kernel
def add_multipliers(model, work):
    """Add J^T lambda of the cut joints to work.force."""
    for j in range(len(model.joints)):
        joint = model.joints[j]
        a, b = joint["parent"], joint["child"]
        for r in range(joint["first"], joint["first"] + joint["rows"]):
            for c in range(3):
                work.force[b, c] += work.multipliers[r] * work.child_jacobian[r, 2 + c]
                if a != WORLD:
                    work.force[a, c] += work.multipliers[r] * work.parent_jacobian[r, 2 + c]
    for c in range(len(model.couplings)):
        multiplier = work.multipliers[model.couplings[c]["row"]]
        add_coupling(model, work, c, multiplier, work.force, 1)


@kernel
def add_own_forces(model, work):
    """Add the wrench that every single link lacks for its acceleration E to work.force."""
    force = work.force
    for b in range(len(model.links)):
        link = model.links[b]
        mass, mx, my = link["mass"], link["moment_x"], link["moment_y"]
        w, x, y = load3(work.moved, b, 0)
        force[b, 0] += work.applied[b, 0] + (link["inertia"] * w + (mx * y - my * x))
        force[b, 1] += work.applied[b, 1] + (mass * x - my * w)
        force[b, 2] += work.applied[b, 2] + (mass * y + mx * w)


@subroutine
def gather_forces(model, work):
    """u of all freedoms for the wrenches -work.force (L, 3) on the links; work.force is overwritten."""
    force, U, n = work.force, work.freedoms, len(model.parts)
    for b in range(len(model.links) - 1, -1, -1):
        link = model.links[b]
        group, f, a, row = link["group"], link["freedom"], link["parent"], n + b
        torque, fx, fy = load3(force, b, 0)
        if group != HINGE and group != SLIDE:
            share = torque * U[f, 6]
            fx, fy = fx - share * U[f, 1], fy - share * U[f, 2]
            U[f, 7], U[f + 1, 7] = -torque, -fx
            U[f + 2, 7] = -(fy - fx * U[f + 1, 6] * U[f + 1, 2])
            continue
        part = torque if group == HINGE else fx
        U[f, 7] = -part
        if a != WORLD:
            c, s = work.stage_pose[row, 0], work.stage_pose[row, 1]
            share = part * U[f, 6]
            fx, fy = c * fx - s * fy, s * fx + c * fy
            torque += work.stage_pose[row, 2] * fy - work.stage_pose[row, 3] * fx
            force[a, 0] += torque - share * U[f, 0]
            force[a, 1] += fx - share * U[f, 1]
            force[a, 2] += fy - share * U[f, 2]
    return 0


@kernel
def gather_residual(model, work):
    """u of all freedoms for what work.moved leaves of the equations of motion.

    work.force : J^T lambda of the cut joints (L, 3); overwritten
    """
    add_own_forces(model, work)
    gather_forces(model, work)


@kernel
def set_free_residual(model, work):
    """Residual of the rows without cut joints, to work.right: `respond` has written J E there."""
    for r in range(len(work.right)):
        work.right[r] -= work.bias[r]


@subroutine
def set_present_residual(model, work):
    """Residual of the rows at the accelerations in work.moved and work.acceleration, to work.right."""
    for j in range(len(model.joints)):
        joint = model.joints[j]
        a, b = joint["parent"], joint["child"]
        for row in range(joint["first"], joint["first"] + joint["rows"]):
            value = 0.0
            for c in range(3):
                value += work.child_jacobian[row, 2 + c] * work.moved[b, c]
                if a != WORLD:
                    value += work.parent_jacobian[row, 2 + c] * work.moved[a, c]
            work.right[row] = value - work.bias[row]
    for c in range(len(model.couplings)):
        row = model.couplings[c]["row"]
        work.right[row] = coupled_rate(model, work.acceleration, c) - work.bias[row]
    return 0


@subroutine
def set_residual(model, work):
    """Residual of the rows at work.moved and the response to u, to work.right."""
    for j in range(len(model.joints)):
        joint = model.joints[j]
        a, b, rows = joint["parent"], joint["child"], joint["rows"]
        for r in range(rows):
            row, at = joint["first"] + r, model.path_places[j] + r
            value = 0.0
            for c in range(3):
                value += work.child_jacobian[row, 2 + c] * work.moved[b, c]
                if a != WORLD:
                    value += work.parent_jacobian[row, 2 + c] * work.moved[a, c]
            for k in range(model.path_ends[j], model.path_ends[j + 1]):
                f = model.path_freedoms[k]
                value += work.response[at] * (work.freedoms[f, 6] * work.freedoms[f, 7])
                at += rows
            work.right[row] = value - work.bias[row]
    for c in range(len(model.couplings)):
        work.right[model.couplings[c]["row"]] += coupled_rate(model, work.total, c)
    return 0
