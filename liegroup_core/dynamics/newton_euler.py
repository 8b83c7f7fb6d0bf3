# SPDX-License-Identifier: Apache-2.0
"""Index-1 accelerations: Newton-Euler equations of all bodies with the joints' accelerations.

Solves (6.22)
    M Vdot + J^T lambda = Q,   J Vdot = bias
by S lambda = J M^-1 Q - bias with S = J M^-1 J^T. In body frames at the centre of mass M is
block diagonal (Theta, m I), so its inverse is free. Q holds the gyroscopic terms with the sign
that (6.30) misses: torque -w x Theta w, force -m w x v.
"""
from .._compile import kernel
from ..forces.gravity import add_wrench as add_gravity
from ..forces.spring_damper import add_wrench as add_springs
from ..lie.vec3 import cross3, load3, matrix3, matvec3
from .block_cholesky import factorise, substitute
from .constraints import (add_baumgarte, assemble_rows, assemble_solve, constraint_force,
                          row_velocity)


@kernel
def _divide_by_mass(model, wrench, acceleration_out):
    """acceleration = M^-1 wrench, body by body."""
    for i in range(len(model.bodies)):
        inverse_mass = model.bodies[i]["inverse_mass"]
        angular = matvec3(matrix3(model.bodies[i]["inverse_inertia"]), load3(wrench, i, 0))
        for c in range(3):
            acceleration_out[i, c] = angular[c]
            acceleration_out[i, 3 + c] = inverse_mass * wrench[i, 3 + c]


@kernel
def accelerations(model, work, pose, twist, external, world_axes):
    """Vdot of all bodies into work.acceleration, multipliers into work.multiplier.

    pose (n, 12), twist (n, 6), external (n, 6): applied wrenches in body axes about the centre
    of mass; world_axes: see assemble_rows
    returns -1, or the joint whose rows depend on others at this pose
    """
    for i in range(len(model.bodies)):
        w = load3(twist, i, 0)
        gyro_w = cross3(matvec3(matrix3(model.bodies[i]["inertia"]), w), w)
        gyro_v = cross3(load3(twist, i, 3), w)
        mass = model.bodies[i]["mass"]
        for c in range(3):
            work.wrench[i, c] = external[i, c] + gyro_w[c]
            work.wrench[i, 3 + c] = external[i, 3 + c] + mass * gyro_v[c]
    add_gravity(model, pose, work.wrench)
    add_springs(model.springs, pose, twist, work.wrench)
    _divide_by_mass(model, work.wrench, work.acceleration)
    m = len(model.joints)
    if m == 0:
        return -1

    assemble_rows(model, work, pose, twist, world_axes, work.multiplier)
    if model.baumgarte_rate > 0.0:
        add_baumgarte(model, work, pose, twist, work.multiplier)
    for j in range(m):
        for r in range(model.joints[j]["rows"]):
            row = model.joints[j]["row_start"] + r
            value = row_velocity(model, work, j, r, work.acceleration)
            work.multiplier[row] = value - work.multiplier[row]
    if not model.solve_is_constant:
        assemble_solve(model, work)
        dependent = factorise(model, work.solve)
        if dependent >= 0:
            return dependent
    substitute(model, work.solve, work.multiplier)
    constraint_force(model, work, -1.0, work.wrench)
    _divide_by_mass(model, work.wrench, work.acceleration)
    return -1
