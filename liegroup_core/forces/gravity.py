# SPDX-License-Identifier: Apache-2.0
"""Uniform gravity."""

from liegroup_core.compiling import kernel
from liegroup_core.lie.vec3 import dot3, load3, load9, scale3, tmatvec3


@kernel
def force(model, pose, i):
    """m R^T g of a body, in body axes; it has no torque about the centre of mass."""
    return scale3(model.bodies[i]["mass"], tmatvec3(load9(pose, i, 0), load3(model.gravity, 0, 0)))


@kernel
def add_wrench(model, pose, wrench_out):
    """Add m R^T g to the force of every body."""
    for i in range(len(model.bodies)):
        weight = force(model, pose, i)
        for c in range(3):
            wrench_out[i, 3 + c] += weight[c]


@kernel
def energy(model, pose):
    """Potential energy -sum m g . r, J, zero at the world origin."""
    gravity = load3(model.gravity, 0, 0)
    total = 0.0
    for i in range(len(model.bodies)):
        total -= model.bodies[i]["mass"] * dot3(gravity, load3(pose, i, 9))
    return total
