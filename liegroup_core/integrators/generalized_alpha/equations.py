# SPDX-License-Identifier: Apache-2.0
"""Equations of one step of the generalised-alpha method, see generalized_alpha.py.

The unknowns x = (Vdot_1, lambda) determine the end of the step (`move`) and the residual of
    Vdot_1 - M^-1 (Q - J^T lambda) = 0 ,   g / sigma = 0
in m/s^2 and rad/s^2 (`residual`). g are the position residuals of the independent rows.
"""

import numpy as np

from liegroup_core.compiling import Struct, borrowed, kernel, subroutine
from liegroup_core.formulations.absolute.constraints import (
    assemble,
    position_residuals,
    subtract_joint_forces,
)
from liegroup_core.formulations.absolute.newton_euler import wrenches
from liegroup_core.integrators.methods import SE3
from liegroup_core.integrators.motion import displace, rotation_status
from liegroup_core.lie.vec3 import (
    axpy3,
    cross3,
    dot3,
    load3,
    matrix3,
    matvec3,
    scale3,
    store3,
    store9,
    sub3,
    tmatvec3,
)
from liegroup_core.status import OK


class Coefficients(Struct):
    """Coefficients of the method, see generalized_alpha.py."""

    alpha_m: float
    alpha_f: float
    beta: float
    gamma: float


class Memory(Struct):
    """Memory of the method besides pose, twist and Work; N = 6 n + rows."""

    rate: np.ndarray  # (n, 6) Vdot_0 on the group
    mean: np.ndarray  # (n, 6) a_0
    old: np.ndarray  # (n, 6) (alpha_f Vdot_0 - alpha_m a_0) / (1 - alpha_m)
    body_rate: np.ndarray  # (n, 6) Vdot_1 in body axes
    x: np.ndarray  # (N,) Vdot_1, then lambda
    start: np.ndarray  # (N,) x before the first iteration
    residual: np.ndarray  # (N,)
    base: np.ndarray  # (N,) unperturbed residual of the finite differences
    correction: np.ndarray  # (N,) last correction of x
    next: np.ndarray  # (N,) residual, then the next correction
    matrix: np.ndarray  # (N, N) factors of the derivative of the residual
    pivots: np.ndarray  # (N,) see lu_factorise
    factored: np.ndarray  # (1,) bool: `matrix` holds factors


@kernel
def sigma(numbers, h):
    """d psi / d Vdot_1, s^2."""
    return h * h * numbers.beta * (1.0 - numbers.alpha_f) / (1.0 - numbers.alpha_m)


@kernel
def move(model, work, memory, numbers, group, h, pose):
    """Compute the end of a step from the unknowns memory.x.

    Writes work.stage_pose, work.stage_twist and memory.body_rate.
    returns OK, ROTATION_TOO_LARGE or NOT_FINITE
    """
    factor = (1.0 - numbers.alpha_f) / (1.0 - numbers.alpha_m)
    for i in range(len(model.bodies)):
        for c in range(0, 6, 3):
            rate = (memory.x[6 * i + c], memory.x[6 * i + c + 1], memory.x[6 * i + c + 2])
            a0 = load3(memory.mean, i, c)
            a1 = axpy3(factor, rate, load3(memory.old, i, c))
            v0 = load3(work.velocity, i, c)
            store3(
                axpy3(
                    h, v0, axpy3(h * h * (0.5 - numbers.beta), a0, scale3(h * h * numbers.beta, a1))
                ),
                work.slopes,
                i,
                c,
            )
            store3(
                axpy3(h * (1.0 - numbers.gamma), a0, axpy3(h * numbers.gamma, a1, v0)),
                work.stage_twist,
                i,
                c,
            )
            store3(rate, memory.body_rate, i, c)
        xi, eta = load3(work.slopes, i, 0), load3(work.slopes, i, 3)
        rotation = dot3(xi, xi)
        status = rotation_status(rotation)
        if status != OK:
            return status
        work.report[1] = max(work.report[1], rotation)
        rot, r = displace(group, pose, i, xi, eta)
        store9(rot, work.stage_pose, i, 0)
        store3(r, work.stage_pose, i, 9)
        if group != SE3:
            w = load3(work.stage_twist, i, 0)
            v = tmatvec3(rot, load3(work.stage_twist, i, 3))
            store3(v, work.stage_twist, i, 3)
            linear = tmatvec3(rot, load3(memory.body_rate, i, 3))
            store3(sub3(linear, cross3(w, v)), memory.body_rate, i, 3)
    return OK


@subroutine
def residual(model, work, memory, numbers, group, h, pose, external):
    """Write the residual of one step at memory.x into memory.residual, and the state as `move`.

    returns OK, ROTATION_TOO_LARGE or NOT_FINITE
    """
    pose, external = borrowed(pose), borrowed(external)
    status = move(model, work, memory, numbers, group, h, pose)
    if status != OK:
        return status
    n = len(model.bodies)
    wrenches(model, work, work.stage_pose, work.stage_twist, external, work.wrench)
    assemble(model, work, work.stage_pose, work.stage_twist)
    subtract_joint_forces(model, work, memory.x, 6 * n, work.wrench)
    for i in range(n):
        angular = matvec3(matrix3(model.bodies[i]["inverse_inertia"]), load3(work.wrench, i, 0))
        inverse_mass = model.bodies[i]["inverse_mass"]
        for c in range(3):
            memory.residual[6 * i + c] = memory.body_rate[i, c] - angular[c]
            memory.residual[6 * i + 3 + c] = (
                memory.body_rate[i, 3 + c] - inverse_mass * work.wrench[i, 3 + c]
            )
    position_residuals(model, work.stage_pose, work.gap)
    for row in range(len(model.row_residual)):
        memory.residual[6 * n + row] = work.gap[model.row_residual[row]] / sigma(numbers, h)
    return OK
