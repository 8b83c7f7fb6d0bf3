# SPDX-License-Identifier: Apache-2.0
"""The series of dexp^-1 that a method takes: in closed form, or truncated."""

from liegroup_core.compiling import kernel
from liegroup_core.lie.coefficients import dexpinv_coefficients, truncated_dexpinv_coefficients
from liegroup_core.methods.table import EXACT


@kernel
def dexpinv_series(scheme, x):
    """Coefficients of dexp^-1 for a squared angle: factor of -ad, b and u."""
    if scheme.highest == EXACT:
        b, u = dexpinv_coefficients(x)
        return 0.5, b, u
    return truncated_dexpinv_coefficients(scheme.highest, x)
