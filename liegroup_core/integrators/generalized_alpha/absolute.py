# SPDX-License-Identifier: Apache-2.0
"""Operations of a generalised-alpha step on SE(3)^n and (SO(3) x R^3)^n; see spaces.py.

The residual is
    Vdot_1 - M^-1 (Q - J^T lambda) = 0 ,   g / sigma = 0
in m/s^2 and rad/s^2. g are the position residuals of the independent rows of all joints.
"""

from liegroup_core.compiling import borrowed, kernel, subroutine
from liegroup_core.forces.kinds import count_turns
from liegroup_core.formulations.absolute.constraints import (
    assemble,
    position_residuals,
    subtract_joint_forces,
)
from liegroup_core.formulations.absolute.newton_euler import accelerations, wrenches
from liegroup_core.integrators.body_state import enter as enter
from liegroup_core.integrators.body_state import leave as leave
from liegroup_core.integrators.methods import SE3
from liegroup_core.integrators.motion import displace, end_status, group_velocity, rotation_status
from liegroup_core.lie.so3 import so3_nearest
from liegroup_core.lie.vec3 import (
    add3,
    cross3,
    dot3,
    load3,
    load9,
    matrix3,
    matvec3,
    store3,
    store9,
    sub3,
    tmatvec3,
)
from liegroup_core.status import OK

from .arrays import set_end, set_size, sigma


@kernel
def _load(array, k):
    """Three numbers of a flat array."""
    return array[k], array[k + 1], array[k + 2]


@kernel
def _store(v, array, k):
    """Write three numbers to a flat array."""
    array[k], array[k + 1], array[k + 2] = v


@kernel
def begin(model, work, memory, group, pose, twist):
    """Write the velocity on the group to memory.velocity."""
    for i in range(len(model.bodies)):
        group_velocity(group, pose, twist, i, work.velocity)
        for c in range(6):
            memory.velocity[6 * i + c] = work.velocity[i, c]


@kernel
def initialise(model, work, memory, group, pose, twist, external):
    """Vdot and lambda from the index-1 equations, to memory.x; returns -1 or a dependent element."""
    set_size(model, memory, pose)
    dependent = accelerations(model, work, pose, twist, external)
    if dependent >= 0:
        return model.joints[dependent]["element"]
    for k in range(len(memory.x)):
        memory.x[k] = work.solution[k]
    if group != SE3:
        for i in range(len(model.bodies)):
            linear = add3(
                load3(work.acceleration, i, 3), cross3(load3(twist, i, 0), load3(twist, i, 3))
            )
            _store(matvec3(load9(pose, i, 0), linear), memory.x, 6 * i + 3)
    return -1


@kernel
def move(model, work, memory, numbers, group, h, pose):
    """Write the end of the step for memory.x to work.stage_pose and stage_twist. Returns a status."""
    set_end(memory, numbers, h)
    for i in range(len(model.bodies)):
        k = 6 * i
        xi = memory.psi[k, 0], memory.psi[k + 1, 0], memory.psi[k + 2, 0]
        eta = memory.psi[k + 3, 0], memory.psi[k + 4, 0], memory.psi[k + 5, 0]
        rotation = dot3(xi, xi)
        status = rotation_status(rotation)
        if status != OK:
            return status
        work.report[1] = max(work.report[1], rotation)
        rot, r = displace(group, pose, i, xi, eta)
        store9(rot, work.stage_pose, i, 0)
        store3(r, work.stage_pose, i, 9)
        w, v = _load(memory.end, k), _load(memory.end, k + 3)
        rate = _load(memory.x, k + 3)
        if group != SE3:
            v = tmatvec3(rot, v)
            rate = sub3(tmatvec3(rot, rate), cross3(w, v))
        store3(w, work.stage_twist, i, 0)
        store3(v, work.stage_twist, i, 3)
        _store(_load(memory.x, k), memory.body_rate, k)
        _store(rate, memory.body_rate, k + 3)
    return OK


@subroutine
def residual(model, work, memory, numbers, group, h, pose, external):
    """Write the residual of one step at memory.x into memory.residual, and the state as `move`."""
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
            memory.residual[6 * i + c] = memory.body_rate[6 * i + c] - angular[c]
            memory.residual[6 * i + 3 + c] = (
                memory.body_rate[6 * i + 3 + c] - inverse_mass * work.wrench[i, 3 + c]
            )
    position_residuals(model, work.stage_pose, work.gap)
    for row in range(len(model.row_residual)):
        memory.residual[6 * n + row] = work.gap[model.row_residual[row]] / sigma(numbers, h)
    return OK


@kernel
def finish(model, work, memory, h):
    """Check and normalise the end of the step, and unwrap angles. Returns a status."""
    status = end_status(model.forces, h, work.stage_pose, work.stage_twist)
    if status != OK:
        return status
    for i in range(len(model.bodies)):
        store9(so3_nearest(load9(work.stage_pose, i, 0)), work.stage_pose, i, 0)
    count_turns(model.forces, work.stage_pose, work.angle)
    set_size(model, memory, work.stage_pose)
    return OK
