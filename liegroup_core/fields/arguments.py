# SPDX-License-Identifier: Apache-2.0
"""Checks of arguments of the Python API. Each error is a ValueError with one line."""

import math
from collections.abc import Mapping
from numbers import Integral, Real

import numpy as np

from .values import shown


def is_finite(value):
    """True for a real number (not a bool) that is finite as a float."""
    try:
        return isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(float(value))
    except OverflowError:
        return False


def is_count(value):
    """True for a whole number, 0 or more."""
    return isinstance(value, (int, Integral)) and not isinstance(value, bool) and value >= 0


def got(value):
    """Text "got VALUE" for the end of a message, in one line."""
    return "got " + " ".join(shown(value).split())


def floats(what, given):
    """New array of numbers.

    what : beginning of the error message, such as what the numbers must be
    """
    try:
        return np.array(given, dtype=float, order="C")
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"{what}, {got(given)}") from None


def finite(what, given, shape):
    """New array of finite numbers with this shape; what : see `floats`."""
    numbers = floats(what, given)
    if numbers.shape != shape or not np.isfinite(numbers).all():
        raise ValueError(f"{what}, {got(given)}")
    return numbers


def check_name(name, known, what):
    """Refuse a name that is not among the known names.

    what : beginning of the message, with {} for the name
    """
    if not isinstance(name, str) or name not in known:
        names = f"choose one of: {', '.join(known)}" if known else "the scene has none"
        raise ValueError(f"{what.format(shown(name))}; {names}")


def mapping(what, given):
    """The mapping, {} for None."""
    if given is None:
        return {}
    if not isinstance(given, Mapping):
        raise ValueError(f"{what}, {got(given)}")
    return given
