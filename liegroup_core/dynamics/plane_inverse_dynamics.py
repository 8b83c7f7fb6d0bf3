# SPDX-License-Identifier: Apache-2.0
"""Generalised forces in the plane: inverse_dynamics.py with three numbers per twist.

The bias forces of the links, work.applied, include those of A and the applied wrenches: see
plane_trees.py. Only E of the links is left.
"""

from liegroup_core.compiling import kernel, subroutine
from liegroup_core.joints.elements import WORLD
from liegroup_core.lie.vec3 import load3, store3
from liegroup_core.motion_groups.table import HINGE, SLIDE

from .plane_residuals import add_multipliers, add_own_forces


@kernel
def _accelerate(model, work, rates):
    """E of all links for the joint accelerations `rates`, to work.moved."""
    n = len(model.parts)
    for b in range(len(model.links)):
        link = model.links[b]
        a, group, f, row = link["parent"], link["group"], link["freedom"], n + b
        w, vx, vy = 0.0, 0.0, 0.0
        if a != WORLD:
            w, ux, uy = load3(work.moved, a, 0)
            c, s = work.stage_pose[row, 0], work.stage_pose[row, 1]
            ux, uy = ux - w * work.stage_pose[row, 3], uy + w * work.stage_pose[row, 2]
            vx, vy = c * ux + s * uy, c * uy - s * ux
        if group == HINGE:
            w += rates[f]
        elif group == SLIDE:
            vx += rates[f]
        else:
            w, vx, vy = w + rates[f], vx + rates[f + 1], vy + rates[f + 2]
        store3((w, vx, vy), work.moved, b, 0)


@subroutine
def inverse_dynamics(model, work, rates, force_out):
    """Forces of all freedoms that are missing for their accelerations; see inverse_dynamics.py."""
    _accelerate(model, work, rates)
    force, n = work.force, len(model.parts)
    for b in range(len(model.links)):
        store3((0.0, 0.0, 0.0), force, b, 0)
    add_multipliers(model, work)
    add_own_forces(model, work)
    for b in range(len(model.links) - 1, -1, -1):
        link = model.links[b]
        group, f, a, row = link["group"], link["freedom"], link["parent"], n + b
        torque, fx, fy = load3(force, b, 0)
        if group == HINGE:
            force_out[f] = torque
        elif group == SLIDE:
            force_out[f] = fx
        else:
            force_out[f], force_out[f + 1], force_out[f + 2] = torque, fx, fy
        if a != WORLD:
            c, s = work.stage_pose[row, 0], work.stage_pose[row, 1]
            fx, fy = c * fx - s * fy, s * fx + c * fy
            torque += work.stage_pose[row, 2] * fy - work.stage_pose[row, 3] * fx
            force[a, 0] += torque
            force[a, 1] += fx
            force[a, 2] += fy
    return 0
