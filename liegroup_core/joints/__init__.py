# SPDX-License-Identifier: Apache-2.0
"""Joints: their models in a scene, and the constraint elements that they consist of.

Input: joints of a scene and relative poses. Output: rows of forbidden relative twist, their rates and
position residuals. This package does not depend on bodies, forces or integrators.
"""

from .kinds import forbidden_rows, position_residual
from .pairs import LOWER_PAIRS, LowerPair

__all__ = ["LOWER_PAIRS", "LowerPair", "forbidden_rows", "position_residual"]
