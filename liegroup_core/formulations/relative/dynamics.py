# SPDX-License-Identifier: Apache-2.0
"""Index-1 accelerations in relative coordinates, with applied wrenches, forces and loops."""

from liegroup_core.compiling import kernel
from liegroup_core.forces.external import external_wrench
from liegroup_core.forces.kinds import add_wrenches
from liegroup_core.joints.elements import WORLD
from liegroup_core.lie.vec3 import load3, matrix3, store3, vector3

from .coordinates import place_bodies, place_links
from .loops import close_loops
from .trees import add_wrench, gather, move_links, spread


@kernel
def _apply(model, work, external):
    """Write the applied wrenches on the links to work.force.

    external : (n, 16) external wrenches, see forces/external.py
    """
    space = work.space
    place_bodies(model, work.world, work.velocities, space.stage_pose, space.stage_twist)
    for i in range(len(model.parts)):
        torque, force = external_wrench(external, space.stage_pose, i)
        store3(torque, work.wrench, i, 0)
        store3(force, work.wrench, i, 3)
    add_wrenches(
        model.space.forces,
        work.angle,
        work.acting,
        space.stage_pose,
        space.stage_twist,
        work.wrench,
    )
    for i in range(len(model.parts)):
        part = model.parts[i]
        if part["link"] != WORLD:
            add_wrench(
                load3(work.wrench, i, 0),
                load3(work.wrench, i, 3),
                matrix3(part["rotation"]),
                vector3(part["point"]),
                work.force,
                part["link"],
            )


@kernel
def accelerations(model, work, external):
    """Accelerations of all freedoms at the stage, to work.acceleration.

    external : (n, 16), see forces/external.py
    returns -1, or the joint with dependent rows if the regularised solve fails too
    """
    move_links(model, work, work.stage_pose, work.stage_twist, len(model.parts))
    for b in range(len(model.bodies)):
        for c in range(6):
            work.force[b, c] = 0.0
    applied = model.has_forces or work.pushed[0] > 0.0
    if applied or len(model.joints) > 0:
        place_links(model, work.relative, work.world)
    if applied:
        _apply(model, work, external)
    gather(model, work)
    g = load3(model.gravity, 0, 0)
    spread(model, work, g[0], g[1], g[2], 1)
    if len(model.joints) > 0:
        return close_loops(model, work)
    return -1
