# SPDX-License-Identifier: Apache-2.0
"""Linear analysis of mechanisms: linear systems, modes, equilibria, inverse dynamics."""

from .inverse import InverseDynamics, inverse_dynamics
from .linear_system import LinearSystem, linearise, pole_errors
from .modes import Mode, modes_of, shapes_of
from .sensitivities import Sensitivities, sensitivities
from .trim import Trim, TrimError, trim

__all__ = [
    "InverseDynamics",
    "LinearSystem",
    "Mode",
    "Sensitivities",
    "Trim",
    "TrimError",
    "inverse_dynamics",
    "linearise",
    "modes_of",
    "pole_errors",
    "sensitivities",
    "shapes_of",
    "trim",
]
