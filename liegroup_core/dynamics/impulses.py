# SPDX-License-Identifier: Apache-2.0
"""Velocity changes caused by impulses on links, with closed loops."""

from liegroup_core.compiling import kernel

from .coordinates import lift_links
from .couplings import add_pair
from .loops import apply_multipliers, close_loops, factor_alone, gather_alone, set_system
from .matrix import REGULARISATION
from .residuals import gather_forces, set_response_residual
from .trees import spread_response


@kernel
def factor_rows(model, work):
    """Articulated inertias and the factor of W at the pose of the stage; call place_links first.

    returns -1, or the joint with dependent rows if the regularised solve fails, too
    """
    gather_alone(model, work)
    if len(model.cuts) == 0:
        return -1
    lift_links(model, work)
    set_system(model, work)
    found = -1
    if factor_alone(model, work, 0.0) >= 0:
        found = factor_alone(model, work, REGULARISATION)
    # An impulse must not change J V, so the rows have no bias.
    for r in range(len(work.bias)):
        work.bias[r] = 0.0
    return found


@kernel
def clear_impulses(model, work):
    """Clear the sum of impulses: work.force, which has the opposite sign, and work.multipliers."""
    for b in range(len(model.links)):
        for c in range(work.force.shape[1]):
            work.force[b, c] = 0.0
    for r in range(len(work.multipliers)):
        work.multipliers[r] = 0.0


@kernel
def add_impulse(model, work, k, value):
    """Add an impulse at switch k, N m s or N s."""
    switch = model.switches[k]
    if switch["row"] < 0:
        add_pair(model, work, switch["link"], switch["component"], -value, work.force, 1)
    else:
        work.multipliers[switch["row"]] -= value


@kernel
def respond_to_impulses(model, work):
    """Write the changes of all rates due to work.force to work.acceleration, those of link twists to work.moved.

    returns twice the energy that the impulses would give the tree at rest, without closed loops
    """
    gather_forces(model, work)
    if len(model.cuts) > 0:
        apply_multipliers(model, work)
    energy = 0.0
    for f in range(len(work.freedoms)):
        energy += work.freedoms[f, 6] * work.freedoms[f, 7] * work.freedoms[f, 7]
    if len(model.cuts) > 0:
        set_response_residual(model, work)
        close_loops(model, work)
    spread_response(model, work)
    return energy


@kernel
def set_rate_changes(model, work, out, row):
    """Write the changes of the rates of all switches to a row of `out`, after respond_to_impulses."""
    if len(model.cuts) > 0:
        set_response_residual(model, work)
    for k in range(len(model.switches)):
        switch = model.switches[k]
        if switch["row"] < 0:
            out[row, k] = work.acceleration[switch["freedom"], 0]
        else:
            out[row, k] = work.right[switch["row"]]
