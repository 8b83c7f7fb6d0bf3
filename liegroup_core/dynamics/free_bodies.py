# SPDX-License-Identifier: Apache-2.0
"""Fast path for scenes of free bodies: Newton-Euler equations, body by body.

If all links float, each with one body, and no joint connects them, the frame of a link is that of its body:
coordinates and rates are pose and twist. The mass matrix is constant and the model has its inverse, so no
inertia is gathered and no degree of freedom is eliminated.
"""

from liegroup_core.compiling import kernel
from liegroup_core.forces import gravity
from liegroup_core.forces.external import external_wrench
from liegroup_core.forces.kinds import add_wrenches
from liegroup_core.forces.law import set_branches
from liegroup_core.lie.vec3 import ZERO3, cross3, load3, matrix3, matvec3, scale3, store_column


@kernel
def copy_bodies(model, pose, twist, pose_out, twist_out):
    """Write poses and twists of the bodies from the rows of the links."""
    n = len(model.bodies)
    for i in range(n):
        for c in range(12):
            pose_out[i, c] = pose[n + i, c]
        for c in range(6):
            twist_out[i, c] = twist[n + i, c]


@kernel
def copy_links(model, pose, twist):
    """Write the rows of the links from those of the bodies."""
    n = len(model.bodies)
    for i in range(n):
        for c in range(12):
            pose[n + i, c] = pose[i, c]
        for c in range(6):
            twist[n + i, c] = twist[i, c]


@kernel
def accelerations_of_free_bodies(model, work, external):
    """Write the accelerations of all degrees of freedom at the stage, M^-1 Q in body axes, to work.acceleration.

    external : (n, COLUMNS) external wrenches, see forces/external.py
    """
    space, bodies = work.space, model.space.bodies
    pose, twist = space.stage_pose, space.stage_twist
    copy_bodies(model, work.stage_pose, work.stage_twist, pose, twist)
    for i in range(len(model.bodies)):
        w = load3(twist, i, 0)
        gyro_w = cross3(matvec3(matrix3(bodies[i]["inertia"]), w), w)
        gyro_v = cross3(load3(twist, i, 3), w)
        mass = bodies[i]["mass"]
        weight = gravity.force(model.space, pose, i)
        torque, force = ZERO3, ZERO3
        if work.pushed[0] > 0.0:
            torque, force = external_wrench(external, pose, twist, i)
        for c in range(3):
            work.wrench[i, c] = torque[c] + gyro_w[c]
            work.wrench[i, 3 + c] = force[c] + mass * gyro_v[c] + weight[c]
    forces = model.space.forces
    if forces.exist:
        work.registers[0, 0] = work.clock.now[0]
        set_branches(forces.laws, work.branches, work.registers)
        add_wrenches(forces, work.angle, work.targets, work.registers, pose, twist, work.wrench)
    for i in range(len(model.bodies)):
        f = model.links[i]["freedom"]
        angular = matvec3(matrix3(bodies[i]["inverse_inertia"]), load3(work.wrench, i, 0))
        store_column(angular, work.acceleration, f, 0)
        linear = scale3(bodies[i]["inverse_mass"], load3(work.wrench, i, 3))
        store_column(linear, work.acceleration, f + 3, 0)
