# SPDX-License-Identifier: Apache-2.0
"""Conversion between spatial and planar states, and forces of planar mechanisms.

Planar axes are axes of the world and of the bodies (arrays.py). Products with them are exact:
conversion to the plane and back is bit-identical. Forces are computed in space.
"""

from liegroup_core.compiling import kernel
from liegroup_core.forces.kinds import add_wrenches
from liegroup_core.lie.vec3 import (
    dot3,
    load3,
    load9,
    matmul3,
    matrix3,
    matvec3,
    store3,
    store9,
    tmatmul3,
    tmatvec3,
    transpose3,
)
from liegroup_core.status import OFF_PLANE, OK

# Components of a direction or of a twist below this bound are zero up to round-off.
IN_PLANE = 1e-13


@kernel
def to_plane(model, pose, twist, pose_out, twist_out):
    """Convert spatial pose (n, 12) and twist (n, 6) to planar ones, (n, 4) and (n, 3).

    returns OK, or OFF_PLANE if a body is tilted or moves out of the plane. Positions along the
    normal are arbitrary.
    """
    world = load9(model.world, 0, 0)
    status = OK
    for i in range(len(model.bodies)):
        axes = matrix3(model.bodies[i]["axes"])
        rot = matmul3(matmul3(world, load9(pose, i, 0)), transpose3(axes))
        tilt = abs(rot[2]) + abs(rot[5]) + abs(rot[6]) + abs(rot[7])
        w, v = matvec3(axes, load3(twist, i, 0)), matvec3(axes, load3(twist, i, 3))
        if not (
            tilt <= IN_PLANE
            and rot[8] > 0.0
            and abs(w[0]) + abs(w[1]) <= IN_PLANE * (1.0 + abs(w[2]))
            and abs(v[2]) <= IN_PLANE * (1.0 + abs(v[0]) + abs(v[1]))
        ):
            status = OFF_PLANE
        r = matvec3(world, load3(pose, i, 9))
        pose_out[i, 0], pose_out[i, 1], pose_out[i, 2], pose_out[i, 3] = rot[0], rot[3], r[0], r[1]
        store3((w[2], v[0], v[1]), twist_out, i, 0)
    return status


@kernel
def wrench_to_plane(model, wrench, wrench_out):
    """Convert spatial wrenches (n, 6) to planar ones (n, 3); joints balance the other components."""
    for i in range(len(model.bodies)):
        axes = matrix3(model.bodies[i]["axes"])
        torque = matvec3(axes, load3(wrench, i, 0))
        force = matvec3(axes, load3(wrench, i, 3))
        store3((torque[2], force[0], force[1]), wrench_out, i, 0)


@kernel
def external_to_plane(model, external, external_out):
    """Convert external wrenches (forces/external.py) to planar ones (n, 7).

    Columns: the planar wrench (3), the force in planar world axes (2), and the centre of mass in
    planar body axes (2). A torque about the normal is the same in body and world axes.
    """
    wrench_to_plane(model, external, external_out)
    world = load9(model.world, 0, 0)
    for i in range(len(model.bodies)):
        torque = matvec3(world, load3(external, i, 6))
        force = matvec3(world, load3(external, i, 9))
        centre = matvec3(matrix3(model.bodies[i]["axes"]), load3(external, i, 12))
        external_out[i, 0] += torque[2]
        external_out[i, 3], external_out[i, 4] = force[0], force[1]
        external_out[i, 5], external_out[i, 6] = centre[0], centre[1]


@kernel
def to_space(model, pose, twist, pose_out, twist_out):
    """Convert planar pose (n, 4) and twist (n, 3) to spatial ones, (n, 12) and (n, 6).

    pose_out : its positions along the normal are unchanged
    """
    world = load9(model.world, 0, 0)
    for i in range(len(model.bodies)):
        axes = matrix3(model.bodies[i]["axes"])
        c, s = pose[i, 0], pose[i, 1]
        turn = (c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0)
        height = dot3((world[6], world[7], world[8]), load3(pose_out, i, 9))
        store9(tmatmul3(world, matmul3(turn, axes)), pose_out, i, 0)
        store3(tmatvec3(world, (pose[i, 2], pose[i, 3], height)), pose_out, i, 9)
        store3(tmatvec3(axes, (0.0, 0.0, twist[i, 0])), twist_out, i, 0)
        store3(tmatvec3(axes, (twist[i, 1], twist[i, 2], 0.0)), twist_out, i, 3)


@kernel
def add_forces(model, work, wrench_out):
    """Add the forces of the scene at the stage to the wrenches (n, 3)."""
    space = work.space
    to_space(model, work.stage_pose, work.stage_twist, space.stage_pose, space.stage_twist)
    for i in range(len(model.bodies)):
        for c in range(6):
            space.wrench[i, c] = 0.0
    add_wrenches(
        model.space.forces,
        space.angle,
        space.acting,
        space.stage_pose,
        space.stage_twist,
        space.wrench,
    )
    wrench_to_plane(model, space.wrench, wrench_out)
