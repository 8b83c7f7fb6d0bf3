# SPDX-License-Identifier: Apache-2.0
"""Momenta and displacements of links in a plane, for a RATTLE step: space_links.py in the plane.

A rotation is an angle, and dexpinv is the identity: V' is the mean velocity of the substep.
"""

import math

from liegroup_core.compiling import kernel, subroutine
from liegroup_core.joints.elements import WORLD
from liegroup_core.lie.coefficients import turn_coefficients
from liegroup_core.lie.vec3 import load3, load9, matvec3, store3, store9
from liegroup_core.motion_groups.about_z import turned
from liegroup_core.motion_groups.table import HINGE, SLIDE


@subroutine
def displace_links(model, work, memory, h):
    """Displacements of all links for memory.psi; see space_links.displace_links.

    Uses the coordinates of the start in work.stage_pose.
    """
    n, moves, pose, psi = len(model.bodies), memory.moves, work.stage_pose, memory.psi
    largest = 0.0
    for b in range(len(model.plane_links)):
        link = model.plane_links[b]
        a, group, f, row = link["parent"], link["group"], link["freedom"], n + b
        angle, x, y = psi[f, 0], 0.0, 0.0
        if group == SLIDE:
            angle, x = 0.0, psi[f, 0]
        elif group != HINGE:
            x, y = psi[f + 1, 0], psi[f + 2, 0]
        if a != WORLD:
            less, s = moves[a, 1], moves[a, 2]
            px, py = pose[row, 2], pose[row, 3]
            tx = moves[a, 3] + (less * px - s * py)
            ty = moves[a, 4] + (s * px + less * py)
            c0, s0 = pose[row, 0], pose[row, 1]
            x, y = ((c0 * tx + s0 * ty) + (x + (less * x - s * y)), (c0 * ty - s0 * tx) + (y + (s * x + less * y)))
            angle += moves[a, 0]
        square = angle * angle
        if not square <= largest:
            largest = square
        sinc, versinc = turn_coefficients(square)
        less, s = -square * versinc, angle * sinc
        moves[b, 0], moves[b, 1], moves[b, 2], moves[b, 3], moves[b, 4] = angle, less, s, x, y
        cx, cy = memory.centre[b, 0], memory.centre[b, 1]
        spin = memory.central[b, 5] * angle / h
        mass = link["mass"] / h
        fx, fy = mass * (x + (less * cx - s * cy)), mass * (y + (s * cx + less * cy))
        store3((spin, fx, fy), memory.half, b, 0)
        work.force[b, 0] = spin + (cx * fy - cy * fx) - memory.impulse[b, 0]
        work.force[b, 1] = fx - memory.impulse[b, 1]
        work.force[b, 2] = fy - memory.impulse[b, 2]
    memory.turned[0] = largest
    return math.sqrt(largest)


@kernel
def place_ends(model, work, memory):
    """Write the poses in the world of the links of cut joints after memory.moves to memory.world."""
    axes, moves, place = load9(model.axes, 0, 0), memory.moves, work.placed
    for e in range(len(model.elements)):
        for b in (model.elements[e]["parent"], model.elements[e]["child"]):
            if b != WORLD:
                c, s = place[b, 0], place[b, 1]
                less, sine, x, y = moves[b, 1], moves[b, 2], moves[b, 3], moves[b, 4]
                point = (place[b, 2] + (c * x - s * y), place[b, 3] + (s * x + c * y), model.link_heights[b])
                c, s = c + (less * c - sine * s), s + (less * s + sine * c)
                store9(turned(axes, c, s), memory.world, b, 0)
                store3(matvec3(axes, point), memory.world, b, 9)


@kernel
def weigh(model, work, memory):
    """Write the acceleration of gravity in link axes to memory.weight, weights to memory.load."""
    n, g = len(model.bodies), load3(model.space.gravity, 0, 0)
    axes = load9(model.axes, 0, 0)
    world_x = axes[0] * g[0] + axes[3] * g[1] + axes[6] * g[2]
    world_y = axes[1] * g[0] + axes[4] * g[1] + axes[7] * g[2]
    for b in range(len(model.plane_links)):
        link = model.plane_links[b]
        a, row = link["parent"], n + b
        x, y = world_x, world_y
        if a != WORLD:
            x, y = memory.weight[a, 0], memory.weight[a, 1]
        c, s = work.stage_pose[row, 0], work.stage_pose[row, 1]
        x, y = c * x + s * y, c * y - s * x
        memory.weight[b, 0], memory.weight[b, 1] = x, y
        torque = link["moment_x"] * y - link["moment_y"] * x
        store3((torque, link["mass"] * x, link["mass"] * y), memory.load, b, 0)


@kernel
def transport(model, work, memory):
    """Write M V'+ of all links, about the origin and in the axes of the end, to memory.impulse."""
    for b in range(len(model.plane_links)):
        less, s = memory.moves[b, 1], memory.moves[b, 2]
        spin, x, y = load3(memory.half, b, 0)
        x, y = x + (less * x + s * y), y + (less * y - s * x)
        cx, cy = memory.centre[b, 0], memory.centre[b, 1]
        store3((spin + (cx * y - cy * x), x, y), memory.impulse, b, 0)
