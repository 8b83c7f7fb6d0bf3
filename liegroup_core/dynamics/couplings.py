# SPDX-License-Identifier: Apache-2.0
"""Couplings of two links of the spanning tree: coordinates, and the forces that a multiplier causes.

The row of a coupling is constant in the rates of the tree: sign_0 in that of the first link, -ratio
sign_1 in that of the second. The coordinate of a joint is its sign times that of its link. As J^T
lambda, a torque or force acts on each link, and its reaction on the parent link. Rows that are
linear in coordinates of SO(2) and R are kept by every Runge-Kutta method: they do not drift, but for
those of driven joints, whose motion depends on time.

plane_couplings.py has the same functions for planar mechanisms, coupled_rows.py the rest.
"""

import math

from liegroup_core.compiling import kernel
from liegroup_core.joints.elements import WORLD
from liegroup_core.lie.vec3 import ZERO3, load3, load9
from liegroup_core.motion_groups.table import slides

from .trees import add_wrench


@kernel
def link_coordinate(model, b, pose):
    """Angle in [-pi, pi] or displacement of link b: hinge, screw or slide."""
    row = len(model.parts) + b
    if slides(model.bodies[b]):
        return pose[row, 4]
    return math.atan2(pose[row, 1], pose[row, 0])


@kernel
def link_shift(model, b, pose):
    """Displacement of link b along its axis: cylinder."""
    return pose[len(model.parts) + b, 4]


@kernel
def add_pair(model, work, b, component, value, out, stride):
    """Add a generalised force on link b, and its reaction on the parent, to wrenches.

    component : 1 for the displacement of a cylinder, else 0
    out : row stride * (number of a link) has its wrench
    """
    link = model.bodies[b]
    axis = 5 if component == 1 or slides(link) else 2
    out[stride * b, axis] += value
    if link["parent"] != WORLD:
        rot, p = load9(work.relative, b, 0), load3(work.relative, b, 9)
        back = (0.0, 0.0, -value)
        if axis == 5:
            add_wrench(ZERO3, back, rot, p, out, stride * link["parent"])
        else:
            add_wrench(back, ZERO3, rot, p, out, stride * link["parent"])


@kernel
def add_coupling(model, work, c, value, out, stride):
    """Add J^T of coupling c times a multiplier to wrenches; see `add_pair`."""
    coupling = model.couplings[c]
    for k in range(2):
        b, share = coupling["links"][k], coupling["factors"][k] * value
        add_pair(model, work, b, 0, share, out, stride)


@kernel
def add_effort(model, work, b, component, value):
    """Apply a generalised force to link b, and its reaction to the parent."""
    add_pair(model, work, b, component, value, work.applied, 1)


@kernel
def coupled_rate(model, rates, c):
    """J times rates (f, 1) of the freedoms, for coupling c."""
    coupling = model.couplings[c]
    total = 0.0
    for k in range(2):
        total += coupling["factors"][k] * rates[model.bodies[coupling["links"][k]]["freedom"], 0]
    return total
