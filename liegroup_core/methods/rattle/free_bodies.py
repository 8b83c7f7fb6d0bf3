# SPDX-License-Identifier: Apache-2.0
"""Both halves of a RATTLE step of free bodies, body by body; rattle.py has the equations.

See dynamics/free_bodies.py. Newton's method finds the rotation of a body from its momentum at half step for
any inertia. The common correction of all links in halves.py would fail for a slender rod in a large step.
"""

import math

from liegroup_core.compiling import borrowed, subroutine
from liegroup_core.dynamics.free_bodies import copy_bodies
from liegroup_core.forces.external import set_external_wrenches
from liegroup_core.forces.gravity import add_wrench as add_gravity
from liegroup_core.forces.kinds import add_wrenches
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
from liegroup_core.mechanism.bodies import copy_state
from liegroup_core.methods.checks import rotation_status
from liegroup_core.methods.rotation.maps import turn, velocity
from liegroup_core.methods.rotation.newton import EXPONENTIAL, newton
from liegroup_core.status import NOT_CONVERGED, OK

from .arrays import MAX_REPEATS, STUCK, TOLERANCE


@subroutine
def loads_of_bodies(model, work, external_in):
    """Write the sum of all wrenches on the bodies at the stage, without gyroscopic terms, to work.wrench."""
    external, space = borrowed(external_in), work.space
    pose, twist = space.stage_pose, space.stage_twist
    copy_bodies(model, work.stage_pose, work.stage_twist, pose, twist)
    set_external_wrenches(external, pose, twist, work.wrench)
    add_gravity(model.space, pose, work.wrench)
    work.registers[0, 0] = work.clock.now[0]
    add_wrenches(model.space.forces, work.angle, work.targets, work.registers, pose, twist, work.wrench)
    return 0


@subroutine
def first_half_of_bodies(model, work, memory, h):
    """Find V' and the poses at the end of a substep, from Q in memory.load. Returns a status."""
    n, bodies = len(model.bodies), model.space.bodies
    copy_state(work.stage_pose, work.stage_twist, work.start_pose, work.start_twist)
    memory.turned[0] = 0.0
    for i in range(n):
        inertia, row = matrix3(bodies[i]["inertia"]), n + i
        inverse, mass = matrix3(bodies[i]["inverse_inertia"]), bodies[i]["inverse_mass"]
        w, v = load3(work.start_twist, row, 0), load3(work.start_twist, row, 3)
        torque = scale3(0.5 * h, load3(memory.load, i, 0))
        force = scale3(0.5 * h, load3(memory.load, i, 3))
        guess = scale3(h, w)
        w, v = axpy3(1.0, matvec3(inverse, torque), w), axpy3(mass, force, v)
        store3(w, memory.half, i, 0)
        store3(v, memory.half, i, 3)
        momentum = scale3(h, matvec3(inertia, w))
        x, converged = newton(EXPONENTIAL, inertia, h, guess, ZERO3, ZERO3, ZERO3, momentum)
        status = rotation_status(dot3(x, x))
        if status != OK:
            return status
        if not converged:
            return NOT_CONVERGED
        memory.turned[0] = max(memory.turned[0], dot3(x, x))
        store3(x, memory.moves, i, 0)
        rot = load9(work.start_pose, row, 0)
        store9(so3_nearest(matmul3(rot, turn(x))), work.stage_pose, row, 0)
        r = axpy3(h, matvec3(rot, v), load3(work.start_pose, row, 9))
        store3(r, work.stage_pose, row, 9)
    return OK


@subroutine
def second_half_of_bodies(model, work, memory, h, external_in):
    """Find V+ at the end of a substep, as the twists at the stage, and Q+. Returns a status."""
    external, n, bodies = borrowed(external_in), len(model.bodies), model.space.bodies
    for i in range(n):
        inertia, inverse = matrix3(bodies[i]["inertia"]), matrix3(bodies[i]["inverse_inertia"])
        x, row = load3(memory.moves, i, 0), n + i
        rotation = turn(x)
        w, v = load3(work.start_twist, row, 0), load3(work.start_twist, row, 3)
        half = load3(memory.half, i, 3)
        # 2 V'+ - V, the initial guess of V+
        store3(axpy3(2.0 / h, x, scale3(-1.0, w)), work.stage_twist, row, 0)
        guess = tmatvec3(rotation, axpy3(2.0, half, scale3(-1.0, v)))
        store3(guess, work.stage_twist, row, 3)
        y = tmatvec3(rotation, matvec3(inertia, load3(memory.half, i, 0)))
        store3(velocity(inertia, inverse, y), memory.half, i, 0)
        store3(tmatvec3(rotation, half), memory.half, i, 3)
        for c in range(6):
            memory.load[i, c] = 0.0
    previous = math.inf
    for repeat in range(MAX_REPEATS):
        loads_of_bodies(model, work, external)
        change = speed = 0.0
        for i in range(n):
            row, impulse = n + i, memory.impulse
            for c in range(6):
                impulse[i, c] = 0.5 * h * (work.wrench[i, c] - memory.load[i, c])
                memory.load[i, c] = work.wrench[i, c]
                speed = max(speed, abs(work.stage_twist[row, c]))
            dw = matvec3(matrix3(bodies[i]["inverse_inertia"]), load3(impulse, i, 0))
            dv = scale3(bodies[i]["inverse_mass"], load3(impulse, i, 3))
            for c in range(3):
                # NaN propagates.
                if not abs(dw[c]) <= change:
                    change = abs(dw[c])
                if not abs(dv[c]) <= change:
                    change = abs(dv[c])
                impulse[i, c], impulse[i, 3 + c] = dw[c], dv[c]
        if repeat > 0:
            stuck = 0.5 * previous < change <= STUCK * TOLERANCE * speed
            if change <= TOLERANCE * speed or stuck:
                return OK
            previous = change
        for i in range(n):
            for c in range(6):
                start = memory.half[i, c] if repeat == 0 else work.stage_twist[n + i, c]
                work.stage_twist[n + i, c] = start + memory.impulse[i, c]
    return NOT_CONVERGED
