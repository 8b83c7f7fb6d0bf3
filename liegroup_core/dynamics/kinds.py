# SPDX-License-Identifier: Apache-2.0
"""Functions of the sweeps, selected by the type of the model: in space or in a plane."""

from . import coordinates as space_coordinates
from . import plane_coordinates
from .algebra import by_space as _by_space
from .couplings import add_effort as add_effort
from .couplings import add_pair as add_pair
from .couplings import link_coordinate as link_coordinate
from .couplings import link_shift as link_shift
from .inverse_dynamics import inverse_dynamics as inverse_dynamics
from .residuals import add_multipliers as add_multipliers
from .residuals import add_own_forces as add_own_forces
from .residuals import gather_forces as gather_forces
from .residuals import gather_residual as gather_residual
from .residuals import set_free_residual as set_free_residual
from .residuals import set_present_residual as set_present_residual
from .residuals import set_residual as set_residual
from .rows import respond as respond
from .rows import set_rows as set_rows
from .trees import apply_wrenches as apply_wrenches
from .trees import gather as gather
from .trees import move_links as move_links
from .trees import spread as spread
from .trees import spread_response as spread_response

coordinates, displace, displace_by_twist, normalise = (
    _by_space(name, space_coordinates, plane_coordinates)
    for name in ("coordinates", "displace", "displace_by_twist", "normalise")
)
place_links, lift_links, place_bodies = (
    _by_space(name, space_coordinates, plane_coordinates)
    for name in ("place_links", "lift_links", "place_bodies")
)
