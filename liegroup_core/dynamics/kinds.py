# SPDX-License-Identifier: Apache-2.0
"""Functions of the sweeps, selected by the type of the model: in space or in a plane."""

from .coordinates import coordinates as coordinates
from .coordinates import displace as displace
from .coordinates import displace_by_twist as displace_by_twist
from .coordinates import lift_links as lift_links
from .coordinates import normalise as normalise
from .coordinates import place_bodies as place_bodies
from .coordinates import place_links as place_links
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
