# SPDX-License-Identifier: Apache-2.0
"""Functions of the sweeps, selected by the type of the model: in space or in a plane."""

from liegroup_core.compiling import Choice

from . import coordinates as space_coordinates
from . import plane_coordinates, plane_rows, plane_trees, rows, trees
from .arrays import PlaneModel, RelativeModel


def _of(name, space, plane):
    """Choice of the function of this name of two modules."""
    return Choice(name, {RelativeModel: getattr(space, name), PlaneModel: getattr(plane, name)})


coordinates, displace, place_links, lift_links, place_bodies = (
    _of(name, space_coordinates, plane_coordinates)
    for name in ("coordinates", "displace", "place_links", "lift_links", "place_bodies")
)
move_links, apply_wrenches, gather, spread, spread_response = (
    _of(name, trees, plane_trees)
    for name in ("move_links", "apply_wrenches", "gather", "spread", "spread_response")
)
set_rows, set_right, respond = (
    _of(name, rows, plane_rows) for name in ("set_rows", "set_right", "respond")
)
