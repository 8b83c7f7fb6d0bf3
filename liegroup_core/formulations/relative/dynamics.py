# SPDX-License-Identifier: Apache-2.0
"""Index-1 accelerations in relative coordinates, with applied wrenches, forces and loops."""

from liegroup_core.compiling import kernel, subroutine
from liegroup_core.forces.external import external_wrench
from liegroup_core.forces.kinds import add_wrenches
from liegroup_core.joints.elements import WORLD
from liegroup_core.lie.vec3 import load3, matrix3, store3, vector3

from .coordinates import place_bodies, place_links
from .loops import SINGULAR, add_multipliers, close_loops, set_loops
from .trees import add_wrench, gather, gather_residual, move_links, spread

# Each refinement multiplies the error in regular directions by the shift of W divided by its pivot.
REFINEMENTS_WHEN_SINGULAR = 4


@kernel
def _apply(model, work, external):
    """Add the applied wrenches on the bodies to work.applied.

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
                work.applied,
                part["link"],
            )


@subroutine
def _refine(model, work):
    """Add the accelerations for what the present ones leave of the equations of motion."""
    for f in range(len(work.total)):
        work.total[f, 0] = work.acceleration[f, 0]
    for b in range(len(model.bodies)):
        for c in range(6):
            work.total_moved[b, c] = work.moved[b, c]
            work.force[b, c] = 0.0
    add_multipliers(model, work, work.force)
    gather_residual(model, work)
    spread(model, work, 0.0, 0.0, 0.0, 0)
    if len(model.joints) > 0:
        _add_total(model, work)
        close_loops(model, work)
        spread(model, work, 0.0, 0.0, 0.0, 0)
    _add_total(model, work)
    for f in range(len(work.total)):
        work.acceleration[f, 0] += work.total[f, 0]
    return 0


@kernel
def _add_total(model, work):
    """Add the accelerations before the refinement to those of the links."""
    for b in range(len(model.bodies)):
        for c in range(6):
            work.moved[b, c] += work.total_moved[b, c]


@kernel
def accelerations(model, work, external):
    """Accelerations of all freedoms at the stage, to work.acceleration.

    external : (n, 16), see forces/external.py
    returns -1, or the joint with dependent rows if the regularised solve fails too
    """
    move_links(model, work, work.stage_pose, work.stage_twist, len(model.parts))
    for b in range(len(model.bodies)):
        for c in range(6):
            work.applied[b, c] = 0.0
    applied = model.has_forces or work.pushed[0] > 0.0
    if applied or len(model.joints) > 0:
        place_links(model, work.relative, work.world)
    if applied:
        _apply(model, work, external)
    gather(model, work)
    g = load3(model.gravity, 0, 0)
    spread(model, work, g[0], g[1], g[2], 1)
    refinements = model.space.refinements
    if len(model.joints) > 0:
        found = set_loops(model, work)
        if found >= 0:
            return found
        if found == SINGULAR:
            refinements = REFINEMENTS_WHEN_SINGULAR
        close_loops(model, work)
        spread(model, work, g[0], g[1], g[2], 1)
    for _ in range(refinements):
        _refine(model, work)
    return -1
