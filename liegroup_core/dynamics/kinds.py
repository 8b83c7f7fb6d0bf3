# SPDX-License-Identifier: Apache-2.0
"""Functions of the sweeps, selected by the type of the model: in space or in a plane."""

from liegroup_core.compiling import Choice
from liegroup_core.mechanism.arrays import PlaneModel, RelativeModel

from . import coordinates as space_coordinates
from . import (
    couplings,
    plane_coordinates,
    plane_couplings,
    plane_inverse_dynamics,
    plane_residuals,
    plane_rows,
    plane_trees,
    residuals,
    rows,
    trees,
)
from . import inverse_dynamics as space_inverse_dynamics


def by_space(name, space, plane):
    """Choice of the function of this name of two modules."""
    return Choice(name, {RelativeModel: getattr(space, name), PlaneModel: getattr(plane, name)})


coordinates, displace, displace_by_twist, normalise = (
    by_space(name, space_coordinates, plane_coordinates)
    for name in ("coordinates", "displace", "displace_by_twist", "normalise")
)
place_links, lift_links, place_bodies = (
    by_space(name, space_coordinates, plane_coordinates)
    for name in ("place_links", "lift_links", "place_bodies")
)
move_links, apply_wrenches, gather, spread, spread_response = (
    by_space(name, trees, plane_trees)
    for name in ("move_links", "apply_wrenches", "gather", "spread", "spread_response")
)
set_rows, respond = (by_space(name, rows, plane_rows) for name in ("set_rows", "respond"))
add_multipliers, add_own_forces, gather_forces, gather_residual = (
    by_space(name, residuals, plane_residuals)
    for name in ("add_multipliers", "add_own_forces", "gather_forces", "gather_residual")
)
set_free_residual, set_present_residual, set_residual = (
    by_space(name, residuals, plane_residuals)
    for name in ("set_free_residual", "set_present_residual", "set_residual")
)
inverse_dynamics = by_space("inverse_dynamics", space_inverse_dynamics, plane_inverse_dynamics)
link_coordinate, link_shift, add_effort, add_pair = (
    by_space(name, couplings, plane_couplings)
    for name in ("link_coordinate", "link_shift", "add_effort", "add_pair")
)
