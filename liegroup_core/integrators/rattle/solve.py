# SPDX-License-Identifier: Apache-2.0
"""Forces, and responses to impulses, for a RATTLE step; each function is compiled once."""

from liegroup_core.compiling import borrowed, subroutine
from liegroup_core.forces.external import external_wrench
from liegroup_core.forces.gravity import add_wrench as add_gravity
from liegroup_core.forces.kinds import add_wrenches
from liegroup_core.formulations.absolute.constraints import assemble
from liegroup_core.formulations.absolute.newton_euler import REFINEMENTS_WHEN_SINGULAR
from liegroup_core.formulations.absolute.saddle_point import REGULARISATION, solve
from liegroup_core.lie.vec3 import store3
from liegroup_core.status import DEPENDENT_ROWS, OK


@subroutine
def loads(model, work, pose, twist, external):
    """Write the sum of all wrenches, without gyroscopic terms, into work.wrench (n, 6)."""
    pose, twist, external = borrowed(pose), borrowed(twist), borrowed(external)
    for i in range(len(model.bodies)):
        torque, force = external_wrench(external, pose, i)
        store3(torque, work.wrench, i, 0)
        store3(force, work.wrench, i, 3)
    add_gravity(model, pose, work.wrench)
    add_wrenches(model.forces, work.angle, work.acting, work.wanted, pose, twist, work.wrench)


@subroutine
def respond(model, work, impulse, target, fresh, less, pose, twist, velocity_out):
    """Add the velocity change dV of all bodies under an impulse and the joint reactions.

    Solves M dV + J^T lambda = impulse, J dV = target - less J V.
    impulse      : (n, 6) N m s, N s
    target       : (rows,)
    fresh        : True: J is evaluated at `pose`, and V is `twist`. False: J is that of the last
                   fresh call, and `less` must be 0
    velocity_out : (n, 6); dV is added to it
    returns OK, or DEPENDENT_ROWS + (element << 8)
    """
    impulse, target = borrowed(impulse), borrowed(target)
    pose, twist, velocity_out = borrowed(pose), borrowed(twist), borrowed(velocity_out)
    dependent = -1
    refinements, shift = model.refinements, 0.0
    for _ in range(2):
        if fresh:
            assemble(model, work, pose, twist)
        for i in range(len(model.bodies)):
            for c in range(6):
                work.acceleration[i, c] = impulse[i, c]
        for j in range(len(model.joints)):
            start, first = model.joints[j]["start"], model.joints[j]["first"]
            for r in range(model.joints[j]["rows"]):
                work.solution[start + r] = target[first + r] - less * work.slip[first + r]
        dependent = solve(model, work, refinements, shift, fresh)
        if dependent < 0:
            break
        # Singular pose: regularised solve, see newton_euler.accelerations.
        refinements, shift = REFINEMENTS_WHEN_SINGULAR, REGULARISATION
        work.report[2] += 1.0
    if dependent >= 0:
        return DEPENDENT_ROWS + (model.joints[dependent]["element"] << 8)
    for i in range(len(model.bodies)):
        for c in range(6):
            velocity_out[i, c] += work.acceleration[i, c]
    return OK
