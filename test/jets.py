# SPDX-License-Identifier: Apache-2.0
"""Numbers of 50 digits with first and second derivatives along the motion of two bodies."""

import decimal
from decimal import Decimal

import mpmath
import numpy as np

DIGITS = 50
TWISTS = 12  # unit twists of the parent, then of the child, each (omega, v) in its axes at its COM


def precise(function):
    """Run a function with DIGITS digits."""

    def run(*args, **keys):
        with decimal.localcontext() as context, mpmath.workdps(DIGITS):
            context.prec = DIGITS
            return function(*args, **keys)

    run.__doc__ = function.__doc__
    return run


def decimals(values):
    """Array of the same shape with the exact decimal value of every number."""
    values = np.asarray(values, dtype=float)
    return np.array([Decimal(x) for x in values.ravel().tolist()], dtype=object).reshape(values.shape)


NONE = decimals(np.zeros(TWISTS + 1))
AXES = decimals(np.eye(3))


class Jet:
    """Number with its derivatives with respect to the state of two bodies.

    slopes    : (13,) derivatives along the 12 unit twists, and along the motion of both bodies
    curvature : second derivative along the motion with constant twists, Vdot = 0
    Functions of numbers have the names with which NumPy calls them for an array of objects.
    """

    def __init__(self, value, slopes=NONE, curvature=Decimal(0)):
        self.value, self.slopes, self.curvature = value, slopes, curvature

    @property
    def rate(self):
        return self.slopes[TWISTS]

    def _mapped(self, value, slope, bend):
        """Function with a value and derivatives `slope` and `bend` at this number."""
        return Jet(value, slope * self.slopes, slope * self.curvature + bend * self.rate**2)

    def __add__(self, other):
        if not isinstance(other, Jet):
            return Jet(self.value + Decimal(other), self.slopes, self.curvature)
        return Jet(self.value + other.value, self.slopes + other.slopes, self.curvature + other.curvature)

    def __mul__(self, other):
        if not isinstance(other, Jet):
            return self._mapped(self.value * Decimal(other), Decimal(other), Decimal(0))
        return Jet(
            self.value * other.value,
            self.value * other.slopes + other.value * self.slopes,
            self.value * other.curvature + 2 * self.rate * other.rate + other.value * self.curvature,
        )

    __radd__, __rmul__ = __add__, __mul__

    def __neg__(self):
        return self * -1

    def __sub__(self, other):
        return self + -other

    def __rsub__(self, other):
        return -self + other

    def __truediv__(self, other):
        if not isinstance(other, Jet):
            return self * (1 / Decimal(other))
        x = 1 / other.value
        return self * other._mapped(x, -(x**2), 2 * x**3)

    def sqrt(self):
        root = self.value.sqrt()
        if not root:  # the distance of points that coincide has no derivative
            return Jet(root, NONE * Decimal("nan"), Decimal("nan"))
        return self._mapped(root, 1 / (2 * root), -1 / (4 * root**3))

    def arctan2(self, x):
        y, square = self, self.value**2 + x.value**2
        angle = mpmath.atan2(mpmath.mpf(str(y.value)), mpmath.mpf(str(x.value)))
        turn = x.value * y.slopes - y.value * x.slopes
        bend = x.value * y.curvature - y.value * x.curvature
        grows = 2 * (x.value * x.rate + y.value * y.rate)
        return Jet(Decimal(mpmath.nstr(angle, DIGITS)), turn / square, bend / square - turn[TWISTS] * grows / square**2)

    def round(self, decimals=0, out=None):
        """The nearest integer: a constant."""
        return round(self.value)
