# SPDX-License-Identifier: Apache-2.0
"""Joints: what a scene says of them, and the constraint elements that they are made of.

In: joints of a scene and relative poses. Out: rows of forbidden relative twist, their rates and
position residuals. A joint knows no body, no force and no integrator.
"""

from .kinds import forbidden_rows, position_residual
from .pairs import LOWER_PAIRS, LowerPair

__all__ = ["LOWER_PAIRS", "LowerPair", "forbidden_rows", "position_residual"]
