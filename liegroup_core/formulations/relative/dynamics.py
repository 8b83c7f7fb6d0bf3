# SPDX-License-Identifier: Apache-2.0
"""Index-1 accelerations in relative coordinates, with applied wrenches, forces and loops."""

from liegroup_core.compiling import kernel
from liegroup_core.forces.external import external_wrench
from liegroup_core.forces.kinds import add_wrenches
from liegroup_core.lie.vec3 import store3

from .kinds import apply_wrenches, gather, move_links, place_bodies, place_links, spread
from .loops import close_loops


@kernel
def _apply(model, work, external):
    """Apply external wrenches and forces to the links.

    external : (n, 16) external wrenches, see forces/external.py
    """
    space = work.space
    place_bodies(model, work, space.stage_pose, space.stage_twist)
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
    apply_wrenches(model, work)


@kernel
def accelerations(model, work, external):
    """Accelerations of all freedoms at the stage, to work.acceleration.

    external : (n, 16), see forces/external.py
    returns -1, or the joint with dependent rows if the regularised solve fails too
    """
    move_links(model, work)
    applied = model.has_forces or work.pushed[0] > 0.0
    if applied or len(model.joints) > 0:
        place_links(model, work)
    if applied:
        _apply(model, work, external)
    gather(model, work)
    if len(model.joints) > 0:
        dependent = close_loops(model, work)
        if dependent >= 0:
            return dependent
    spread(model, work)
    return -1
