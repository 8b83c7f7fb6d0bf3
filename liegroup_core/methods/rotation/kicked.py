# SPDX-License-Identifier: Apache-2.0
"""KICKED steps of all bodies: explicit in the forces, two evaluations per step.

maps.py has the equations of one body, rotation.py the loop over the steps.
"""

import math

from liegroup_core.compiling import kernel
from liegroup_core.lie.vec3 import axpy3, dot3, load3, load9, matmul3, matrix3, matvec3, scale3, store3
from liegroup_core.mechanism.bodies import STEP_TURN
from liegroup_core.status import NO_RATTLE_STEP, NOT_CONVERGED, NOT_FINITE, OK

from .bodies import LINEAR, MOMENTUM, VELOCITY, linear_momentum, load, place
from .maps import RATTLE, kicked_end, kicked_rotation, renormalised


@kernel
def kicked(rule, spinners, work, memory, h, evaluation, pose, twist):
    """Take half of a KICKED step: evaluation 0 of the forces at its start, 1 at its end.

    returns (status, True if the step is done)
    """
    for i in range(len(spinners)):
        spinner = spinners[i]
        inertia, inverse = matrix3(spinner["inertia"]), matrix3(spinner["inverse_inertia"])
        torque, force = load(spinner, work, i)
        if evaluation == 0:
            w = load3(twist, i, 0)
            rotation, x, momentum, converged = kicked_rotation(rule, inertia, inverse, h, w, torque)
            squared = dot3(x, x)
            if not squared < math.inf:
                return NOT_FINITE, True
            work.report[STEP_TURN] = max(work.report[STEP_TURN], squared)
            if not converged:
                if rule == RATTLE:
                    x = scale3(h, matvec3(inverse, axpy3(0.5 * h, torque, matvec3(inertia, w))))
                    work.report[STEP_TURN] = dot3(x, x)
                    return NO_RATTLE_STEP + (i << 8), True
                return NOT_CONVERGED, True
            linear = axpy3(0.5 * h, force, linear_momentum(spinner, pose, twist, i))
            guess = axpy3(2.0 / h, x, scale3(-1.0, w))
            store3(momentum, memory, i, MOMENTUM)
            store3(guess, memory, i, VELOCITY)
            store3(linear, memory, i, LINEAR)
            rot = renormalised(matmul3(load9(pose, i, 0), rotation))
            r = axpy3(h / spinner["mass"], linear, load3(pose, i, 9))
            place(spinner, i, rot, guess, r, axpy3(0.5 * h, force, linear), work.stage_pose, work.stage_twist)
        else:
            w, converged = kicked_end(
                rule, inertia, inverse, h, load3(memory, i, VELOCITY), load3(memory, i, MOMENTUM), torque
            )
            if not converged:
                return NOT_CONVERGED, True
            place(
                spinner,
                i,
                load9(work.stage_pose, i, 0),
                w,
                load3(work.stage_pose, i, 9),
                axpy3(0.5 * h, force, load3(memory, i, LINEAR)),
                work.stage_pose,
                work.stage_twist,
            )
    return OK, evaluation == 1
