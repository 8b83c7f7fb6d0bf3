# SPDX-License-Identifier: Apache-2.0
"""Linear analysis of mechanisms: linear systems, modes, equilibria, inverse dynamics."""

from .inverse import InverseDynamics, inverse_dynamics
from .linear_system import LinearSystem, change_along, linearise, pole_errors
from .misfit import Misfit
from .modes import Mode, modes_of, shapes_of
from .sensitivities import Sensitivities, outputs_of, sensitivities
from .transition import Transition, transition
from .trim import Trim, TrimError, trim

__all__ = [
    "InverseDynamics",
    "LinearSystem",
    "Misfit",
    "Mode",
    "Sensitivities",
    "Transition",
    "Trim",
    "TrimError",
    "change_along",
    "inverse_dynamics",
    "linearise",
    "modes_of",
    "outputs_of",
    "pole_errors",
    "sensitivities",
    "shapes_of",
    "transition",
    "trim",
]
