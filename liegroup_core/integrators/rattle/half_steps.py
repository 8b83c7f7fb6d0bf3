# SPDX-License-Identifier: Apache-2.0
"""The two halves of a RATTLE step, with the equations for lambda and mu; see rattle.py."""

import math

import numpy as np

from liegroup_core.compiling import Struct, kernel
from liegroup_core.formulations.absolute.constraints import position_residuals
from liegroup_core.formulations.absolute.projection import is_closed
from liegroup_core.integrators.broyden import broyden
from liegroup_core.integrators.motion import copy_state, orthonormal, turn_status
from liegroup_core.integrators.rotation.maps import turn, velocity
from liegroup_core.integrators.rotation.newton import EXPONENTIAL, newton
from liegroup_core.lie.vec3 import (
    ZERO3,
    axpy3,
    dot3,
    load3,
    load9,
    matmul3,
    matrix3,
    matvec3,
    scale3,
    store3,
    store9,
    tmatvec3,
)
from liegroup_core.status import NOT_CONVERGED, OK

from .solve import loads, respond

MOST_ITERATIONS = 50
# Corrections that Broyden's method stores before it restarts.
REMEMBERED = 8
# Forces that depend on velocity are iterated until no velocity changes by more than this fraction
# of the largest. If round-off is larger: until changes below this multiple stop decreasing.
TOLERANCE, STUCK = 1e-15, 100.0
MOST_REPEATS = 100


class Memory(Struct):
    """Memory of the method besides pose, twist and Work; the last three are for initial guesses."""

    half: np.ndarray  # (n, 6) V', then V'+
    turn: np.ndarray  # (n, 3) rad, x
    load: np.ndarray  # (n, 6) Q at the start of a substep, then at its end
    impulse: np.ndarray  # (n, 6) right-hand side of the bodies, N m s and N s
    target: np.ndarray  # (rows,) right-hand side of the rows: change of J V wanted
    corrections: np.ndarray  # (REMEMBERED, rows) of J V' in this substep
    bias: np.ndarray  # (rows,) (2/h) J V' of the last substep
    growth: np.ndarray  # (rows,) its rate
    size: np.ndarray  # (1,) s, the last substep; 0: there is none


@kernel
def _place(model, work, memory, h):
    """Poses at the end of a substep for the present V': work.stage_pose. Returns a status."""
    for i in range(len(model.bodies)):
        inertia = matrix3(model.bodies[i]["inertia"])
        momentum = matvec3(inertia, load3(memory.half, i, 0))
        x, found = newton(
            EXPONENTIAL,
            inertia,
            h,
            load3(memory.turn, i, 0),
            ZERO3,
            ZERO3,
            ZERO3,
            scale3(h, momentum),
        )
        status = turn_status(dot3(x, x))
        if status != OK:
            return status
        if not found:
            return NOT_CONVERGED
        store3(x, memory.turn, i, 0)
        rot = load9(work.start_pose, i, 0)
        store9(orthonormal(matmul3(rot, turn(x))), work.stage_pose, i, 0)
        store3(
            axpy3(h, matvec3(rot, load3(memory.half, i, 3)), load3(work.start_pose, i, 9)),
            work.stage_pose,
            i,
            9,
        )
    return OK


@kernel
def _guess(memory, h):
    """Extrapolate J V' from the last substeps into memory.target; returns s since the last one.

    (2/h) J V' is the constraint acceleration h/3 after the start of a substep, up to O(h^2).
    """
    since = (2.0 * memory.size[0] + h) / 3.0
    for r in range(len(memory.bias)):
        memory.target[r] = 0.5 * h * (memory.bias[r] + since * memory.growth[r])
    return since


@kernel
def _remember(memory, h, since):
    """Store J V' of a finished substep, in memory.target, for `_guess`."""
    # Backward substeps may be at nearly the same time: too close for a difference.
    differ = memory.size[0] != 0.0 and abs(since) > 0.2 * abs(h)
    for r in range(len(memory.bias)):
        now = 2.0 / h * memory.target[r]
        if differ:
            memory.growth[r] = (now - memory.bias[r]) / since
        memory.bias[r] = now
    memory.size[0] = h


@kernel
def _correct(model, work, memory, h, k):
    """Write correction k of J V' for the residuals in work.gap into memory.corrections.

    The square Jacobian is d gap / d (J V') = h + O(h^2): Broyden's method starts from h.
    """
    step, rows = memory.corrections, len(model.row_residual)
    for r in range(rows):
        step[k, r] = -work.gap[model.row_residual[r]] / h
    broyden(step, k, 0.5)


@kernel
def first_half(model, work, memory, h, fresh):
    """V' and the pose at the end, with all joints satisfied. Returns a status.

    fresh : True: the saddle-point matrix at the start must be computed
    """
    n, rows = len(model.bodies), len(model.row_residual)
    since = _guess(memory, h)
    for i in range(n):
        for c in range(6):
            memory.impulse[i, c] = 0.5 * h * memory.load[i, c]
        for c in range(3):
            memory.turn[i, c] = h * work.start_twist[i, c]
    copy_state(work.start_pose, work.start_twist, work.stage_pose, memory.half)
    status = respond(
        model,
        work,
        memory.impulse,
        memory.target,
        fresh,
        0.0,
        work.start_pose,
        work.start_twist,
        memory.half,
    )
    for i in range(n):
        for c in range(6):
            memory.impulse[i, c] = 0.0
    closed = rows == 0
    for iteration in range(MOST_ITERATIONS):
        if status == OK:
            status = _place(model, work, memory, h)
        if status != OK:
            return status
        if closed:
            _remember(memory, h, since)
            return OK
        position_residuals(model, work.stage_pose, work.gap)
        # At round-off level: after one more correction the round-off has no preferred sign.
        closed = is_closed(model, work, work.stage_pose)
        k = iteration % REMEMBERED
        _correct(model, work, memory, h, k)
        for r in range(rows):
            memory.target[r] += memory.corrections[k, r]
        status = respond(
            model,
            work,
            memory.impulse,
            memory.corrections[k],
            False,
            0.0,
            work.stage_pose,
            memory.half,
            memory.half,
        )
    return NOT_CONVERGED


@kernel
def _carry(model, work, memory, h):
    """Write V'+ into memory.half, and the initial guess 2 V'+ - V of V+ into work.stage_twist."""
    for i in range(len(model.bodies)):
        inertia = matrix3(model.bodies[i]["inertia"])
        inverse = matrix3(model.bodies[i]["inverse_inertia"])
        x = load3(memory.turn, i, 0)
        change = turn(x)
        w, v = load3(work.start_twist, i, 0), load3(work.start_twist, i, 3)
        store3(axpy3(2.0 / h, x, scale3(-1.0, w)), work.stage_twist, i, 0)
        half = load3(memory.half, i, 3)
        store3(tmatvec3(change, axpy3(2.0, half, scale3(-1.0, v))), work.stage_twist, i, 3)
        y = tmatvec3(change, matvec3(inertia, load3(memory.half, i, 0)))
        store3(velocity(inertia, inverse, y), memory.half, i, 0)
        store3(tmatvec3(change, half), memory.half, i, 3)


@kernel
def _new_impulse(model, work, memory, h):
    """Impulse of the change of Q+, from memory.load to work.wrench; memory.load is updated.

    returns (largest component of the velocity change of a free body, and of work.stage_twist)
    """
    apart = speed = 0.0
    for i in range(len(model.bodies)):
        for c in range(6):
            memory.impulse[i, c] = 0.5 * h * (work.wrench[i, c] - memory.load[i, c])
            memory.load[i, c] = work.wrench[i, c]
            speed = max(speed, abs(work.stage_twist[i, c]))
        dw = matvec3(matrix3(model.bodies[i]["inverse_inertia"]), load3(memory.impulse, i, 0))
        dv = scale3(model.bodies[i]["inverse_mass"], load3(memory.impulse, i, 3))
        for c in range(3):
            # NaN propagates.
            if not abs(dw[c]) <= apart:
                apart = abs(dw[c])
            if not abs(dv[c]) <= apart:
                apart = abs(dv[c])
    return apart, speed


@kernel
def second_half(model, work, memory, h, external):
    """V+ into work.stage_twist, Q+ into memory.load. Returns a status."""
    _carry(model, work, memory, h)
    for i in range(len(model.bodies)):
        for c in range(6):
            memory.load[i, c] = 0.0
    for r in range(len(memory.target)):
        memory.target[r] = 0.0
    previous = math.inf
    for repeat in range(MOST_REPEATS):
        loads(model, work, work.stage_pose, work.stage_twist, external)
        apart, speed = _new_impulse(model, work, memory, h)
        if repeat == 0:
            copy_state(work.stage_pose, memory.half, work.stage_pose, work.stage_twist)
        elif apart <= TOLERANCE * speed or (0.5 * previous < apart <= STUCK * TOLERANCE * speed):
            return OK
        else:
            previous = apart
        # The first iteration makes J V+ zero; later ones do not change it.
        status = respond(
            model,
            work,
            memory.impulse,
            memory.target,
            repeat == 0,
            1.0 if repeat == 0 else 0.0,
            work.stage_pose,
            memory.half,
            work.stage_twist,
        )
        if status != OK:
            return status
    return NOT_CONVERGED
