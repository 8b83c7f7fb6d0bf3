# SPDX-License-Identifier: Apache-2.0
"""Index-1 accelerations: Newton-Euler equations of all bodies with acceleration constraints.

Solves (6.22)
    M Vdot + J^T lambda = Q,   J Vdot = bias
In body frames at the centre of mass M is block diagonal (Theta, m I). Q contains the gyroscopic
terms with the sign that (6.30) misses: torque -w x Theta w, force -m w x v.
"""

from liegroup_core.compiling import kernel
from liegroup_core.forces import gravity
from liegroup_core.forces.external import external_wrench
from liegroup_core.forces.kinds import add_wrenches
from liegroup_core.lie.vec3 import cross3, load3, matrix3, matvec3

from .constraints import add_baumgarte, assemble
from .saddle_point import REGULARISATION, solve

# The regularisation shifts a row by 1e-8. Each refinement multiplies the error in regular directions
# by 1e-8 divided by the squared sine of the angle between rows.
REFINEMENTS_WHEN_SINGULAR = 4


@kernel
def wrenches(model, work, pose, twist, external, wrench_out):
    """Write Q, external wrenches, forces and gyroscopic terms of all bodies, to wrench_out (n, 6)."""
    for i in range(len(model.bodies)):
        w = load3(twist, i, 0)
        gyro_w = cross3(matvec3(matrix3(model.bodies[i]["inertia"]), w), w)
        gyro_v = cross3(load3(twist, i, 3), w)
        mass = model.bodies[i]["mass"]
        weight = gravity.force(model, pose, i)
        torque, force = external_wrench(external, pose, i)
        for c in range(3):
            wrench_out[i, c] = torque[c] + gyro_w[c]
            wrench_out[i, 3 + c] = force[c] + mass * gyro_v[c] + weight[c]
    add_wrenches(model.forces, work.angle, work.acting, work.wanted, pose, twist, wrench_out)


@kernel
def _unconstrained(model, wrench):
    """Replace Q (n, 6) by M^-1 Q."""
    for i in range(len(model.bodies)):
        angular = matvec3(matrix3(model.bodies[i]["inverse_inertia"]), load3(wrench, i, 0))
        inverse_mass = model.bodies[i]["inverse_mass"]
        for c in range(3):
            wrench[i, c] = angular[c]
            wrench[i, 3 + c] *= inverse_mass


@kernel
def accelerations(model, work, pose, twist, external):
    """Write Vdot of all bodies to work.acceleration, and Vdot and lambda to work.solution.

    pose (n, 12), twist (n, 6); work.angle, work.acting and work.wanted: see Work
    external : external wrenches, see forces/external.py
    returns -1, or the joint with dependent rows if the regularised solve fails too
    """
    dependent = -1
    refinements, shift = model.refinements, 0.0
    for _ in range(2):
        wrenches(model, work, pose, twist, external, work.acceleration)
        if len(model.joints) == 0:
            _unconstrained(model, work.acceleration)
            break
        assemble(model, work, pose, twist)
        if model.baumgarte_rate > 0.0:
            add_baumgarte(model, work, pose)
        dependent = solve(model, work, refinements, shift, True)
        if dependent < 0:
            break
        # Singular pose: regularised solve. Accelerations that the joints leave undetermined follow
        # from the masses.
        refinements, shift = REFINEMENTS_WHEN_SINGULAR, REGULARISATION
        work.report[2] += 1.0
    return dependent
