# SPDX-License-Identifier: Apache-2.0
"""Both halves of a RATTLE step on bodies; rattle.py has the equations, spaces.py the list.

The first half finds V' and the poses at the end, so that the constraints are satisfied there. The
second half finds V at the end, so that the velocity constraints are satisfied.
"""

import math

from liegroup_core.compiling import kernel
from liegroup_core.forces.kinds import count_turns
from liegroup_core.formulations.absolute.constraints import position_residuals
from liegroup_core.formulations.absolute.projection import is_satisfied
from liegroup_core.integrators.body_state import enter as enter
from liegroup_core.integrators.body_state import leave as leave
from liegroup_core.integrators.broyden import broyden
from liegroup_core.integrators.motion import end_status, rotation_status
from liegroup_core.integrators.rotation.maps import turn, velocity
from liegroup_core.integrators.rotation.newton import EXPONENTIAL, newton
from liegroup_core.lie.so3 import so3_nearest
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
from liegroup_core.model.arrays import copy_state
from liegroup_core.status import NOT_CONVERGED, OK

from .arrays import HISTORY, times_between
from .solve import loads, respond

MAX_ITERATIONS = 50
# Velocity-dependent forces are iterated until no velocity changes by more than TOLERANCE times the
# largest one. If round-off is larger: until changes below STUCK times that stop decreasing.
TOLERANCE, STUCK = 1e-15, 100.0
MAX_REPEATS = 100


@kernel
def begin(model, work, memory, pose, twist, external, fresh):
    """Set the start of a step to the state, and Q there."""
    copy_state(pose, twist, work.start_pose, work.start_twist)
    loads(model, work, pose, twist, external)
    for i in range(len(model.bodies)):
        for c in range(6):
            memory.load[i, c] = work.wrench[i, c]


@kernel
def _update_poses(model, work, memory, h):
    """Compute the poses at the end of a substep from V', into work.stage_pose. Returns a status."""
    for i in range(len(model.bodies)):
        inertia = matrix3(model.bodies[i]["inertia"])
        momentum = matvec3(inertia, load3(memory.half, i, 0))
        x, converged = newton(
            EXPONENTIAL,
            inertia,
            h,
            load3(memory.turn, i, 0),
            ZERO3,
            ZERO3,
            ZERO3,
            scale3(h, momentum),
        )
        status = rotation_status(dot3(x, x))
        if status != OK:
            return status
        if not converged:
            return NOT_CONVERGED
        store3(x, memory.turn, i, 0)
        rot = load9(work.start_pose, i, 0)
        store9(so3_nearest(matmul3(rot, turn(x))), work.stage_pose, i, 0)
        store3(
            axpy3(h, matvec3(rot, load3(memory.half, i, 3)), load3(work.start_pose, i, 9)),
            work.stage_pose,
            i,
            9,
        )
    return OK


@kernel
def _extrapolate(memory, h):
    """Extrapolate J V' from the last substeps, into memory.target.

    (2/h) J V' is the constraint acceleration at h/3 after the start of a substep, up to O(h^2).
    returns the time in s between these points of the last substep and of this one
    """
    since, ahead = times_between(memory, h)
    for r in range(len(memory.bias)):
        memory.target[r] = 0.5 * h * (memory.bias[r] + ahead * memory.growth[r])
    return since


@kernel
def _store_history(memory, h, since):
    """Store J V' of a finished substep, which is memory.target, for `_extrapolate`."""
    # With backward substeps these points may be too close in time for a difference quotient.
    are_apart = memory.size[0] != 0.0 and abs(since) > 0.2 * abs(h)
    for r in range(len(memory.bias)):
        bias = 2.0 / h * memory.target[r]
        if are_apart:
            memory.growth[r] = (bias - memory.bias[r]) / since
        memory.bias[r] = bias
    memory.size[0] = h


@kernel
def _correct(model, work, memory, h, k):
    """Write correction k of J V' into memory.corrections, from the residuals in work.gap.

    Broyden's method starts from h times the identity: the Jacobian d gap / d (J V') is h + O(h^2).
    """
    step, rows = memory.corrections, len(model.row_residual)
    for r in range(rows):
        step[k, r] = -work.gap[model.row_residual[r]] / h
    broyden(step, k, 0.5)


@kernel
def first_half(model, work, memory, h, fresh):
    """Find V' and the poses at the end that satisfy all constraints. Returns a status.

    h     : s, substep
    fresh : True: the saddle-point matrix at the start is not factorised yet
    """
    n, rows = len(model.bodies), len(model.row_residual)
    since = _extrapolate(memory, h)
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
    satisfied = rows == 0
    for iteration in range(MAX_ITERATIONS):
        if status == OK:
            status = _update_poses(model, work, memory, h)
        if status != OK:
            return status
        if satisfied:
            _store_history(memory, h, since)
            return OK
        position_residuals(model, work.stage_pose, work.gap)
        # At round-off level, one more correction removes the bias of the remaining residual.
        satisfied = is_satisfied(model, work, work.stage_pose)
        k = iteration % HISTORY
        _correct(model, work, memory, h, k)
        for r in range(rows):
            memory.correction[r] = memory.corrections[k, r]
            memory.target[r] += memory.correction[r]
        status = respond(
            model,
            work,
            memory.impulse,
            memory.correction,
            False,
            0.0,
            work.stage_pose,
            memory.half,
            memory.half,
        )
    return NOT_CONVERGED


@kernel
def _transport(model, work, memory, h):
    """Write V'+ into memory.half, and 2 V'+ - V, the initial guess of V+, into work.stage_twist."""
    for i in range(len(model.bodies)):
        inertia = matrix3(model.bodies[i]["inertia"])
        inverse = matrix3(model.bodies[i]["inverse_inertia"])
        x = load3(memory.turn, i, 0)
        rotation = turn(x)
        w, v = load3(work.start_twist, i, 0), load3(work.start_twist, i, 3)
        store3(axpy3(2.0 / h, x, scale3(-1.0, w)), work.stage_twist, i, 0)
        half = load3(memory.half, i, 3)
        store3(tmatvec3(rotation, axpy3(2.0, half, scale3(-1.0, v))), work.stage_twist, i, 3)
        y = tmatvec3(rotation, matvec3(inertia, load3(memory.half, i, 0)))
        store3(velocity(inertia, inverse, y), memory.half, i, 0)
        store3(tmatvec3(rotation, half), memory.half, i, 3)


@kernel
def _update_impulse(model, work, memory, h):
    """Compute the impulse of the change of Q+ from memory.load to work.wrench; update memory.load.

    returns (largest component of its velocity change of a free body, largest component of
    work.stage_twist)
    """
    change = speed = 0.0
    for i in range(len(model.bodies)):
        for c in range(6):
            memory.impulse[i, c] = 0.5 * h * (work.wrench[i, c] - memory.load[i, c])
            memory.load[i, c] = work.wrench[i, c]
            speed = max(speed, abs(work.stage_twist[i, c]))
        dw = matvec3(matrix3(model.bodies[i]["inverse_inertia"]), load3(memory.impulse, i, 0))
        dv = scale3(model.bodies[i]["inverse_mass"], load3(memory.impulse, i, 3))
        for c in range(3):
            # NaN propagates.
            if not abs(dw[c]) <= change:
                change = abs(dw[c])
            if not abs(dv[c]) <= change:
                change = abs(dv[c])
    return change, speed


@kernel
def second_half(model, work, memory, h, external):
    """Find V+ at the end of a substep, into work.stage_twist. Returns a status.

    Also writes Q+ into memory.load. external: see forces/external.py
    """
    _transport(model, work, memory, h)
    for i in range(len(model.bodies)):
        for c in range(6):
            memory.load[i, c] = 0.0
    for r in range(len(memory.target)):
        memory.target[r] = 0.0
    previous = math.inf
    for repeat in range(MAX_REPEATS):
        loads(model, work, work.stage_pose, work.stage_twist, external)
        change, speed = _update_impulse(model, work, memory, h)
        if repeat == 0:
            copy_state(work.stage_pose, memory.half, work.stage_pose, work.stage_twist)
        elif change <= TOLERANCE * speed or (0.5 * previous < change <= STUCK * TOLERANCE * speed):
            return OK
        else:
            previous = change
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


@kernel
def keep(model, work, memory):
    """Continue from the end of a substep."""
    for i in range(len(model.bodies)):
        x = load3(memory.turn, i, 0)
        work.report[1] = max(work.report[1], dot3(x, x))
    copy_state(work.stage_pose, work.stage_twist, work.start_pose, work.start_twist)


@kernel
def finish(model, work, h):
    """Check the end of a step, and unwrap angles. Returns a status."""
    status = end_status(model.forces, h, work.stage_pose, work.stage_twist)
    if status == OK:
        count_turns(model.forces, work.stage_pose, work.angle)
    return status
