# SPDX-License-Identifier: Apache-2.0
"""Joints as data: the table of lower pairs, and the elements that every joint is made of."""

from .elements import elements_of, forbidden_rows, position_residual
from .pairs import LOWER_PAIRS, LowerPair

__all__ = ["LOWER_PAIRS", "LowerPair", "elements_of", "forbidden_rows", "position_residual"]
