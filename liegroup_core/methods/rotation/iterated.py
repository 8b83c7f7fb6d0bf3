# SPDX-License-Identifier: Apache-2.0
"""ITERATED steps of all bodies: implicit in the forces, with Broyden's method for the loads.

maps.py has the equations of one body, rotation.py the loop over the steps.
"""

import math

from liegroup_core.compiling import kernel
from liegroup_core.lie.vec3 import add3, axpy3, dot3, load3, load9, matmul3, matrix3, scale3, store3, store9
from liegroup_core.mechanism.bodies import STEP_TURN
from liegroup_core.methods.broyden import broyden
from liegroup_core.status import NOT_CONVERGED, OK

from .bodies import FORCE, LINEAR, PLACE, TORQUE, TURN, VELOCITY, Q, linear_momentum, load, place
from .maps import BOTTASSO_BORRI, LIE_MIDPOINT, iterated_end, iterated_step, renormalised, turn

# Corrections of the loads that Broyden's method stores before it restarts, and its `bound`: above
# it forces nearly amplify a displacement, as negative damping does.
HISTORY, BROYDEN_BOUND = 16, 0.9


@kernel
def _largest_difference(a, b):
    """Largest absolute difference of the components of two vectors; NaN propagates."""
    largest = 0.0
    for c in range(3):
        difference = abs(a[c] - b[c])
        if not difference <= largest:
            largest = difference
    return largest


@kernel
def _scales(spinner):
    """Scales of torque and force, 1/(kg m^2) and 1/kg, that turn loads into accelerations."""
    inertia = spinner["inertia"]
    return 3.0 / (inertia[0] + inertia[4] + inertia[8]), 1.0 / spinner["mass"]


@kernel
def update_loads(spinners, work, loads, corrections, evaluation):
    """Update the loads of an ITERATED step from the forces at its last iterate, by Broyden's method.

    loads (6 n,)             : rad/s^2 and m/s^2, in place
    corrections (HISTORY, 6 n) : previous corrections of the loads
    evaluation               : number of the iteration, from 0
    """
    k = max(0, evaluation - 1) % HISTORY
    for i in range(len(spinners)):
        torque, force = load(spinners[i], work, i)
        by_torque, by_force = _scales(spinners[i])
        for c in range(3):
            if evaluation == 0:
                loads[6 * i + c] = loads[6 * i + 3 + c] = 0.0
            corrections[k, 6 * i + c] = by_torque * torque[c] - loads[6 * i + c]
            corrections[k, 6 * i + 3 + c] = by_force * force[c] - loads[6 * i + 3 + c]
    if evaluation > 0:
        broyden(corrections, k, BROYDEN_BOUND)
    for r in range(len(loads)):
        loads[r] += corrections[k, r]


@kernel
def iterated(rule, spinners, work, memory, loads, h, evaluation, pose, twist):
    """Take an ITERATED step with the present loads; place the bodies where forces act next.

    returns (status, largest change of a displacement since the last iteration, in rad and relative
    to the largest coordinate or 1 m)
    """
    largest = 0.0
    for i in range(len(spinners)):
        spinner = spinners[i]
        inertia, inverse = matrix3(spinner["inertia"]), matrix3(spinner["inverse_inertia"])
        by_torque, by_force = _scales(spinner)
        torque = (loads[6 * i] / by_torque, loads[6 * i + 1] / by_torque, loads[6 * i + 2] / by_torque)
        force = (loads[6 * i + 3] / by_force, loads[6 * i + 4] / by_force, loads[6 * i + 5] / by_force)
        w = load3(twist, i, 0)
        guess = load3(memory, i, TURN)
        if evaluation == 0:
            store3(torque, memory, i, TORQUE)
            store3(force, memory, i, FORCE)
            guess = scale3(0.5 * h if rule == LIE_MIDPOINT else h, w)
        first = load3(memory, i, TORQUE)
        u, converged = iterated_step(rule, inertia, inverse, h, guess, w, first, torque)
        if not converged:
            return NOT_CONVERGED, 0.0
        whole, to_load, w_load, w_end = iterated_end(rule, inertia, inverse, h, u, w, first, torque)
        store3(u, memory, i, TURN)
        store3(w_end, memory, i, VELOCITY)
        store9(turn(whole), memory, i, Q)
        # For large steps there are several solutions. If this one rotates less than the body does, the
        # larger of both rotations is reported.
        work.report[STEP_TURN] = max(work.report[STEP_TURN], dot3(whole, whole), h * h * dot3(w, w))

        r, linear = load3(pose, i, 9), linear_momentum(spinner, pose, twist, i)
        if rule == BOTTASSO_BORRI:
            force = scale3(0.5, add3(load3(memory, i, FORCE), force))
        halfway, end = axpy3(0.5 * h, force, linear), axpy3(h, force, linear)
        r_end = axpy3(h / spinner["mass"], halfway, r)
        store3(end, memory, i, LINEAR)
        store3(r_end, memory, i, PLACE)
        # Forces are evaluated halfway, or at the end for BOTTASSO_BORRI.
        r_load, momentum_load = axpy3(0.5 * h / spinner["mass"], halfway, r), halfway
        if rule == BOTTASSO_BORRI:
            r_load, momentum_load = r_end, end
        length = 1.0
        for c in range(3):
            length = max(length, abs(r_load[c]))
        change = max(
            _largest_difference(u, guess),
            _largest_difference(r_load, load3(work.stage_pose, i, 9)) / length if spinner["held"] == 0 else 0.0,
        )
        if evaluation == 0:
            change = math.inf
        if not change <= largest:
            largest = change
        place(
            spinner,
            i,
            matmul3(load9(pose, i, 0), turn(to_load)),
            w_load,
            r_load,
            momentum_load,
            work.stage_pose,
            work.stage_twist,
        )
    return OK, largest


@kernel
def finish_iterated(spinners, work, memory, pose):
    """Place the bodies at the end of an ITERATED step."""
    for i in range(len(spinners)):
        rot = renormalised(matmul3(load9(pose, i, 0), load9(memory, i, Q)))
        place(
            spinners[i],
            i,
            rot,
            load3(memory, i, VELOCITY),
            load3(memory, i, PLACE),
            load3(memory, i, LINEAR),
            work.stage_pose,
            work.stage_twist,
        )
