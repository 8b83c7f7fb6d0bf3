# SPDX-License-Identifier: Apache-2.0
"""Uniform gravity."""
from .._compile import kernel
from ..lie.vec3 import dot3, load3, load9, tmatvec3


@kernel
def add_wrench(model, pose, wrench_out):
    """Add m R^T g to the force of every body (body axes; no torque about the centre of mass)."""
    gravity = load3(model.gravity, 0, 0)
    for i in range(len(model.bodies)):
        force = tmatvec3(load9(pose, i, 0), gravity)
        mass = model.bodies[i]["mass"]
        for c in range(3):
            wrench_out[i, 3 + c] += mass * force[c]


@kernel
def energy(model, pose):
    """Potential energy -sum m g . r, J, zero at the world origin."""
    gravity = load3(model.gravity, 0, 0)
    total = 0.0
    for i in range(len(model.bodies)):
        total -= model.bodies[i]["mass"] * dot3(gravity, load3(pose, i, 9))
    return total
