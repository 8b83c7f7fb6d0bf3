# SPDX-License-Identifier: Apache-2.0
"""Couplings of two links in a plane: couplings.py with three numbers per twist."""

import math

from liegroup_core.compiling import kernel
from liegroup_core.joints.elements import WORLD
from liegroup_core.motion_groups.table import SLIDE


@kernel
def link_coordinate(model, b, pose):
    """Angle in [-pi, pi] or displacement of link b: hinge or slide."""
    link, row = model.links[b], len(model.parts) + b
    c0, s0 = link["cos"], link["sin"]
    if link["group"] == SLIDE:
        return c0 * (pose[row, 2] - link["x"]) + s0 * (pose[row, 3] - link["y"])
    c, s = pose[row, 0], pose[row, 1]
    return math.atan2(s * c0 - c * s0, c * c0 + s * s0)


@kernel
def link_shift(model, b, pose):
    """No link of a plane is a cylinder."""
    return 0.0


@kernel
def add_pair(model, work, b, component, value, out, stride):
    """Add a generalised force on link b, and its reaction on the parent; see couplings.py."""
    link, row = model.links[b], len(model.parts) + b
    at, to = stride * b, stride * link["parent"]
    if link["group"] != SLIDE:
        out[at, 0] += value
        if link["parent"] != WORLD:
            out[to, 0] -= value
        return
    out[at, 1] += value
    if link["parent"] != WORLD:
        pose = work.stage_pose
        fx, fy = -value * pose[row, 0], -value * pose[row, 1]
        out[to, 0] += pose[row, 2] * fy - pose[row, 3] * fx
        out[to, 1] += fx
        out[to, 2] += fy


@kernel
def add_coupling(model, work, c, value, out, stride):
    """Add J^T of coupling c times a multiplier to wrenches."""
    coupling = model.couplings[c]
    for k in range(2):
        b, share = coupling["links"][k], coupling["factors"][k] * value
        add_pair(model, work, b, 0, share, out, stride)


@kernel
def add_effort(model, work, b, component, value):
    """Apply a generalised force to link b, and its reaction to the parent."""
    # The links have bias forces, less what is applied.
    add_pair(model, work, b, component, -value, work.force, 1)
    add_pair(model, work, b, component, -value, work.applied, 1)
