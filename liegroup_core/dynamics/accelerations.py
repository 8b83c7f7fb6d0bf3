# SPDX-License-Identifier: Apache-2.0
"""Index-1 accelerations in relative coordinates, with applied wrenches, forces and loops."""

import math

from liegroup_core.compiling import kernel, shared, subroutine
from liegroup_core.forces.external import set_external_wrenches
from liegroup_core.forces.kinds import add_wrenches
from liegroup_core.forces.law import set_branches
from liegroup_core.mechanism.bodies import PIVOT, SINGULAR_SOLVES
from liegroup_core.status import OK

from .algebra import state_column, tree_size
from .coordinates import place_bodies, place_links
from .free_bodies import accelerations_of_free_bodies
from .loads import GIVEN, MOST_ITERATIONS, begin_loads, settle_loads
from .loops import POOR, SINGULAR, apply_multipliers, close_loops, project, set_loops
from .matrix import AT, NEAR
from .residuals import add_multipliers, gather_residual, set_free_residual, set_present_residual, set_residual
from .singular_poses import SIDES, WEIGHTS, add_aside, begin_aside, end_aside, go_aside
from .sliding import (
    ENOUGH,
    PRECISE,
    add_share,
    begin_shares,
    count_slides,
    factorise_shares,
    improve_shares,
    keep_rates,
    largest_rate,
    open_surfaces,
    set_column,
    set_surface_rates,
    slides,
    take_kept_rates,
)
from .switches import apply_switches, set_row_efforts
from .trees import apply_wrenches, gather, move_links, spread, spread_response

# Each refinement multiplies the error in regular directions by (shift of W) / pivot.
REFINEMENTS_WHEN_SINGULAR = 4


@kernel
def apply_forces(model, work, external):
    """Apply external wrenches and forces to the links.

    external : (n, COLUMNS) external wrenches, see forces/external.py
    """
    space = work.space
    place_bodies(model, work, space.stage_pose, space.stage_twist)
    set_external_wrenches(external, space.stage_pose, space.stage_twist, work.wrench)
    laws, n = model.space.forces.laws, len(model.bodies)
    work.registers[0, 0] = work.clock.now[0]
    set_branches(laws, work.branches, work.registers)
    size, column = tree_size(model), state_column(model)
    for s in range(len(model.law_links)):
        work.registers[laws.states[s, 0], 0] = work.stage_twist[n + size + s, 0]
    pose, twist = space.stage_pose, space.stage_twist
    add_wrenches(model.space.forces, work.angle, work.targets, work.registers, pose, twist, work.wrench)
    apply_wrenches(model, work)
    for s in range(len(model.law_links)):
        work.applied[size + s, column] += work.registers[laws.states[s, 1], 0]


@subroutine
def _refine(model, work):
    """Solve for the residual of the equations of motion and add the correction to the accelerations."""
    for f in range(len(work.total)):
        work.total[f, 0] = work.acceleration[f, 0]
    for b in range(len(model.links)):
        for c in range(work.moved.shape[1]):
            work.total_moved[b, c] = work.moved[b, c]
            work.force[b, c] = 0.0
    add_multipliers(model, work)
    gather_residual(model, work)
    if len(model.cuts) > 0:
        set_residual(model, work)
        close_loops(model, work)
    spread_response(model, work)
    for b in range(len(model.links)):
        for c in range(work.moved.shape[1]):
            work.moved[b, c] += work.total_moved[b, c]
    for f in range(len(work.total)):
        work.acceleration[f, 0] += work.total[f, 0]
    return 0


@subroutine
def solve_equations(model, work):
    """Accelerations of all degrees of freedom for the kinematics and applied wrenches in `work`.

    returns the same as `accelerations`
    """
    gather(model, work)
    refinements = model.refinements
    work.report[PIVOT] = 1.0
    if len(model.cuts) > 0:
        found = set_loops(model, work)
        if found >= 0:
            return found
        if found == POOR:
            refinements = max(refinements, 1)
        elif found == SINGULAR:
            refinements = REFINEMENTS_WHEN_SINGULAR
        if model.has_switched_rows and set_row_efforts(model, work):
            apply_multipliers(model, work)
            spread(model, work)
            set_present_residual(model, work)
        else:
            set_free_residual(model, work)
        close_loops(model, work)
    spread(model, work)
    for _ in range(refinements):
        _refine(model, work)
    return -1


@kernel
def balance(model, work):
    """Apply stops and friction, and solve for the accelerations; iterates friction by load, see loads.py.

    returns the same as `accelerations`
    """
    if len(model.switches) == 0:
        return solve_equations(model, work)
    begin_loads(model, work)
    apply_switches(model, work)
    found = -1
    for iteration in range(MOST_ITERATIONS):
        found = solve_equations(model, work)
        if found >= 0 or not model.has_loads or work.iteration[GIVEN] != 0.0:
            break
        if settle_loads(model, work, iteration):
            break
    return found


@shared
def _accelerations_of_branches(model, work, external):
    """Accelerations with the branches of laws as they are; returns the same as `accelerations`."""
    if model.only_free_bodies:
        work.report[PIVOT] = 1.0
        accelerations_of_free_bodies(model, work, external)
        return -1
    move_links(model, work)
    applied = model.space.forces.exist or work.pushed[0] > 0.0
    if applied or len(model.cuts) > 0:
        place_links(model, work)
    if applied:
        apply_forces(model, work, external)
    return balance(model, work)


@subroutine
def _rates_of_branches(model, work, external):
    """As above, also the rates of the surfaces of laws."""
    found = _accelerations_of_branches(model, work, external)
    if found < 0:
        set_surface_rates(model, work)
    return found


@shared
def _accelerations_on_surfaces(model, work, external):
    """Accelerations of motions that slide along surfaces, see sliding.py; returns the same as `accelerations`."""
    begin_shares(model, work)
    found = _rates_of_branches(model, work, external)
    keep_rates(work)
    for j in range(len(work.shares)):
        if found < 0 and slides(model, work, j):
            add_share(model, work, j, 1.0)
            found = _rates_of_branches(model, work, external)
            set_column(model, work, j)
            add_share(model, work, j, -1.0)
    if found >= 0:
        return found
    before, off = math.inf, math.inf
    going = factorise_shares(model, work)
    take_kept_rates(work)
    while going and found < 0:
        improve_shares(model, work)
        found = _rates_of_branches(model, work, external)
        before, off = off, largest_rate(model, work)
        going = ENOUGH < off < 0.5 * before
    if found < 0 and not off <= PRECISE:
        open_surfaces(model, work)
        found = _accelerations_of_branches(model, work, external)
    return found


@kernel
def _accelerations_of_stage(model, work, external):
    """Accelerations at the stage, not displaced; returns the same as `accelerations`."""
    if count_slides(model, work) > 0:
        return _accelerations_on_surfaces(model, work, external)
    return _accelerations_of_branches(model, work, external)


@shared
def _accelerations_aside(model, work, external):
    """Accelerations near a singular pose, from displaced stages; returns -1: see singular_poses.py.

    If a displaced stage is singular, too, or cannot be projected, those of the regularised solve remain.
    """
    regular, pivot = work.report[SINGULAR_SOLVES], work.report[PIVOT]
    d, sides, first = begin_aside(model, work), len(SIDES) - 1, pivot
    if d == 0.0:
        return -1
    if pivot >= AT:
        d, sides, first = 0.0, 1, 0.0
    for side in range(1, sides + 1):
        go_aside(model, work, SIDES[side] * d)
        # Pivots grow with the square of the distance from a singular pose.
        least = max(AT, 2.0 * SIDES[side] * SIDES[side] * first)
        if (
            project(model, work) != OK
            or _accelerations_of_stage(model, work, external) >= 0
            or work.report[PIVOT] < least
        ):
            end_aside(work, 0)
            return -1
        add_aside(work, WEIGHTS[side] if sides > 1 else 1.0)
    end_aside(work, 1)
    work.report[SINGULAR_SOLVES] = regular
    return -1


@kernel
def accelerations(model, work, external):
    """Write the accelerations of all degrees of freedom at the stage to work.acceleration.

    external : (n, COLUMNS), see forces/external.py
    returns -1, or the joint with dependent rows if the regularised solve fails too
    """
    found = _accelerations_of_stage(model, work, external)
    if work.report[PIVOT] < NEAR and found < 0 and len(model.switches) == 0:
        return _accelerations_aside(model, work, external)
    return found
