# SPDX-License-Identifier: Apache-2.0
"""Derivatives by central differences of high order, with an estimate of their error.

Six values at +-h, +-2h, +-3h give a derivative of order six. With h = 0.01 rad both its errors are near
round-off: h^6 / 140 times the seventh derivative, and about 2 eps / h times the value. The formulas of orders
2, 4 and 6 from the same values form a sequence, from which the error of the last one follows. Where it is not
small, because a function changes over less than h, smaller h are tried.
"""

import numpy as np

from liegroup_core.errors import SimulationError

# Weights of f(k h) - f(-k h), k = 1, 2, 3, for h f' of orders 2, 4 and 6.
WEIGHTS = np.array([[0.5, 0.0, 0.0], [2.0 / 3.0, -1.0 / 12.0, 0.0], [0.75, -0.15, 1.0 / 60.0]])
# The same, of f'(0+) and f'(0-) in the mean, of orders 1, 2 and 3: for functions that are smooth on each side only.
SIDED = np.array([[0.5, 0.0, 0.0], [1.0, -0.25, 0.0], [1.5, -0.75, 1.0 / 6.0]])
SMALLER = 8.0  # factor between two sizes
MOST_SIZES = 8
ENOUGH = 1e-12  # relative error at which no smaller h is tried
KINK = 0.01  # second difference at a kink, relative to the first; h f'' / (2 f') is below 1e-3
RUN_NOISE = 1e-11  # of values of a run to 1e-13, relative
ROUND_OFF = 4.0 * np.finfo(float).eps  # of a value; the weights add up to less than 2


def of_values(values, h, weights=WEIGHTS, noise=ROUND_OFF):
    """Derivative, an estimate of its error, and whether that is small, from values at (h, -h), (2h, -2h), (3h, -3h).

    values : (3, 2, ...);  noise : of values, relative; errors of which it makes most are small
    """
    second, fourth, sixth = np.tensordot(weights, values[:, 0] - values[:, 1], 1) / h
    last, before = np.abs(sixth - fourth), np.abs(fourth - second)
    # The differences of successive orders decrease like a geometric sequence; of SIDED the first may vanish by chance.
    # Where only the outer values are beyond a kink, the first one is zero and the last one is not.
    ratio = np.divide(last, before, out=np.ones_like(last), where=before > 0.0)
    most = np.abs(values).max(axis=(0, 1)) / h
    error = last * (np.minimum(ratio, 1.0) if weights is WEIGHTS else 1.0) + ROUND_OFF * most
    size = _largest(np.abs(sixth))
    return sixth, error, _largest(error) <= max(ENOUGH * size, 2.0 * noise * _largest(most))


def _largest(values):
    """Largest of values >= 0, without those that are NaN: outputs that are undetermined."""
    return np.nan_to_num(values).max(initial=0.0)


def kinked(values, base):
    """Whether a function has a kink at 0: its second difference grows with the distance, not with its square.

    values : (2, 2, ...) at (h, -h), (2h, -2h);  base : at 0
    """
    near, far = (np.abs(pair[0] + pair[1] - 2.0 * base) for pair in values[:2])
    first, size = _largest(np.abs(values[0][0] - values[0][1])), max(1.0, _largest(np.abs(base)))
    return (near > KINK * first) & (near > RUN_NOISE * size) & (far < 3.0 * near)


def derivative(function, h, base=None, weights=WEIGHTS, noise=ROUND_OFF):
    """Derivative of a function of one number at 0, and an estimate of its error.

    function : returns an array; may raise SimulationError away from 0
    h        : first distance of the values
    base     : the value at 0; if it is given, a function with a kink there has no derivative
    weights  : WEIGHTS, or SIDED;  noise : as of `of_values`
    returns (derivative, error), arrays of the same shape; the error is inf if no distance has values
    """
    best = None
    for _ in range(MOST_SIZES):
        try:
            values = np.array([[function(k * h), function(-k * h)] for k in (1, 2, 3)])
        except SimulationError:
            h /= SMALLER
            continue
        if base is not None and kinked(values, base).any():
            h /= SMALLER
            continue
        found, error, is_small = of_values(values, h, weights, noise)
        if best is None or _largest(error) < _largest(best[1]):
            best = found, error
        if is_small:
            break
        h /= SMALLER
    if best is None:
        raise SimulationError("the accelerations near the state cannot be computed")
    return best
