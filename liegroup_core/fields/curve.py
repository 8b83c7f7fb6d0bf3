# SPDX-License-Identifier: Apache-2.0
"""Curves of couplings: q_joint = offset + p(q_other) with p(q) = ratio q + a_2 q^2 + a_3 q^3 + a_4 q^4.

A coupling is anything with an offset, a ratio and a curve, the tuple (a_2, ...) of at most three numbers. Plain
Python, for scenes and robots; kernels use `law` of dynamics/couplings.py.
"""

import numpy as np

# Two roots that coincide are found with an error of the root of round-off, about 1e-8, along the imaginary axis.
DOUBLE = 1e-7


def rise(coupling, q):
    """p(q)."""
    total = 0.0
    for a in (*coupling.curve[::-1], coupling.ratio):
        total = (total + a) * q
    return total


def slope(coupling, q):
    """Derivative of p at q: the rate of `joint` relative to that of `other`."""
    total = 0.0
    for k in range(len(coupling.curve), 0, -1):
        total = (total + (k + 1) * coupling.curve[k - 1]) * q
    return total + coupling.ratio


def counted_from(coupling, start):
    """{offset, ratio, curve} of the same relation with the coordinate of `other` counted from `start`."""
    a = [coupling.offset, coupling.ratio, *coupling.curve]
    for first in range(len(a) - 1):  # Taylor coefficients, by repeated synthetic division
        for k in range(len(a) - 2, first - 1, -1):
            a[k] += start * a[k + 1]
    return {"offset": a[0], "ratio": a[1], "curve": tuple(a[2:])}


def other_at(coupling, value, near):
    """Coordinate of `other`, the nearest one to `near`, at which `joint` has a coordinate; `near` if there is none."""
    coefficients = [*coupling.curve[::-1], coupling.ratio, coupling.offset - value]
    roots = np.roots(coefficients)
    real = roots.real[np.abs(roots.imag) <= DOUBLE * (1.0 + np.abs(roots))]
    return float(min(real, key=lambda q: abs(q - near), default=near))
