# SPDX-License-Identifier: Apache-2.0
"""Joints as data: the table of lower pairs and the position residual they share."""

from .pairs import LOWER_PAIRS, LowerPair, position_residual, rotation_z_to

__all__ = ["LOWER_PAIRS", "LowerPair", "position_residual", "rotation_z_to"]
