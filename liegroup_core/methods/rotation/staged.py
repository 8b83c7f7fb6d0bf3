# SPDX-License-Identifier: Apache-2.0
"""Stages of the coadjoint Runge-Kutta methods for all bodies.

rotation.py has the equations and the loop over the steps.
"""

import math

from liegroup_core.compiling import kernel
from liegroup_core.lie.so3 import so3_dexpinv
from liegroup_core.lie.vec3 import (
    ZERO3,
    add3,
    axpy3,
    dot3,
    load3,
    load9,
    matmul3,
    matrix3,
    matvec3,
    scale3,
    store3,
    tmatvec3,
)
from liegroup_core.mechanism.bodies import STEP_TURN
from liegroup_core.status import NOT_FINITE, OK

from .bodies import TURN, linear_momentum, load, place
from .maps import renormalised, turn, velocity


@kernel
def _weighted(slopes, weights, row, stages, n, i):
    """Sum weights[row, l] times the derivatives of body i over the first stages l: four vectors."""
    rotation, shift, torque, force = ZERO3, ZERO3, ZERO3, ZERO3
    for stage in range(stages):
        weight = weights[row, stage]
        if weight != 0.0:
            k = stage * n + i
            rotation = axpy3(weight, load3(slopes, k, 0), rotation)
            shift = axpy3(weight, load3(slopes, k, 3), shift)
            torque = axpy3(weight, load3(slopes, k, 6), torque)
            force = axpy3(weight, load3(slopes, k, 9), force)
    return rotation, shift, torque, force


@kernel
def staged(spinners, work, memory, weights, h, stage, pose, twist):
    """Go from a stage of a coadjoint method, with its forces, to the next stage or to the end.

    weights : (s + 1, s) a of the tableau, below it b
    returns (status, True if the step is done)
    """
    n, stages = len(spinners), weights.shape[1]
    end = stage + 1 == stages
    for i in range(n):
        spinner = spinners[i]
        torque, force = load(spinner, work, i)
        row = stage * n + i
        w = load3(work.stage_twist, i, 0)
        if stage > 0:
            w = so3_dexpinv(scale3(-1.0, load3(memory, i, TURN)), w)
        rot = load9(work.stage_pose, i, 0)
        store3(w, work.slopes, row, 0)
        store3(matvec3(rot, load3(work.stage_twist, i, 3)), work.slopes, row, 3)
        store3(matvec3(rot, torque), work.slopes, row, 6)
        store3(force, work.slopes, row, 9)

        rotation, shift, torque, force = _weighted(work.slopes, weights, stage + 1, stage + 1, n, i)
        psi = scale3(h, rotation)
        squared = dot3(psi, psi)
        if not squared < math.inf:
            return NOT_FINITE, True
        work.report[STEP_TURN] = max(work.report[STEP_TURN], squared)
        store3(psi, memory, i, TURN)
        start = load9(pose, i, 0)
        inertia = matrix3(spinner["inertia"])
        y = add3(matvec3(inertia, load3(twist, i, 0)), tmatvec3(start, scale3(h, torque)))
        Q_psi = turn(psi)
        y = tmatvec3(Q_psi, y)
        r = axpy3(h, shift, load3(pose, i, 9))
        linear = axpy3(h, force, linear_momentum(spinner, pose, twist, i))
        rot = matmul3(start, Q_psi)
        if end:
            rot = renormalised(rot)
        place(
            spinner,
            i,
            rot,
            velocity(inertia, matrix3(spinner["inverse_inertia"]), y),
            r,
            linear,
            work.stage_pose,
            work.stage_twist,
        )
    return OK, end
