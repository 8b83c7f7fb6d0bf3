# SPDX-License-Identifier: Apache-2.0
"""Kernels by which events act on the mechanism: see switching.py."""

from liegroup_core.compiling import borrowed, stepper
from liegroup_core.dynamics.accelerations import accelerations
from liegroup_core.dynamics.coordinates import place_links
from liegroup_core.dynamics.impulses import (
    add_impulse,
    clear_impulses,
    factor_rows,
    respond_to_impulses,
    set_rate_changes,
)
from liegroup_core.dynamics.loads import UNSETTLED
from liegroup_core.dynamics.sliding import set_surface_rates
from liegroup_core.dynamics.state import begin, enter, leave
from liegroup_core.dynamics.switches import count_coordinates, set_guards
from liegroup_core.dynamics.trees import move_links
from liegroup_core.forces.formulas import UNKNOWN
from liegroup_core.forces.law import branch_of
from liegroup_core.status import DEPENDENT_ROWS, NO_FRICTION, OK


@stepper
def look(model, work, pose_in, twist_in, external_in):
    """Accelerations, guards, coordinates and rates of surfaces at a state. Returns a status."""
    pose_in, twist_in = borrowed(pose_in), borrowed(twist_in)
    pose, twist, external, status = enter(model, work, pose_in, twist_in, borrowed(external_in))
    begin(model, work, pose, twist)
    dependent = accelerations(model, work, external)
    if dependent >= 0:
        return DEPENDENT_ROWS + (model.owners[dependent] << 8)
    for k in range(len(work.branches)):
        if work.branches[k] == UNKNOWN:
            work.branches[k] = branch_of(model.space.forces.laws, work.registers, k)
    if len(work.shares) > 0:
        set_surface_rates(model, work)
    # Guards first: they need the applied forces of the stage, which count_coordinates clears.
    set_guards(model, work)
    count_coordinates(model, work)
    if work.iteration[UNSETTLED] != 0.0:
        work.iteration[UNSETTLED] = 0.0
        return NO_FRICTION
    return status


@stepper
def respond(model, work, out, mobility, open_mobility):
    """Rate changes by unit impulses at the switches: of all rates, (k, f), and of the switches, (k, k).

    Uses the stage of `look`. open_mobility (k,) : change of each switch's own rate without closed loops. It
    sets the size of the round-off in `mobility`.
    returns a status
    """
    move_links(model, work)
    place_links(model, work)
    dependent = factor_rows(model, work)
    if dependent >= 0:
        return DEPENDENT_ROWS + (model.owners[dependent] << 8)
    for k in range(len(model.switches)):
        clear_impulses(model, work)
        add_impulse(model, work, k, 1.0)
        open_mobility[k] = respond_to_impulses(model, work)
        for f in range(len(work.freedoms)):
            out[k, f] = work.acceleration[f, 0]
        set_rate_changes(model, work, mobility, k)
    return OK


@stepper
def change_rates(model, work, changes, pose_out, twist_out):
    """Add `changes` (f,) to the rates of all degrees of freedom; those of held ones become zero."""
    n = len(model.bodies)
    for b in range(len(model.links)):
        f = model.links[b]["freedom"]
        for k in range(model.links[b]["freedoms"]):
            held = work.held[f + k] != 0.0
            work.twist[n + b, k] = 0.0 if held else work.twist[n + b, k] + changes[f + k]
    leave(model, work, work.pose, work.twist, pose_out, twist_out)
