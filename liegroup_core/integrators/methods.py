# SPDX-License-Identifier: Apache-2.0
"""The integration methods as data: an explicit Runge-Kutta tableau is all a Munthe-Kaas method is.

A new explicit method is one entry of METHODS. Tests check row sums, order conditions, and the
order on a problem whose rotations do not commute.
"""
from dataclasses import dataclass

import numpy as np

# The groups a pose can move on; GROUPS[name] is the code that the kernels know.
SE3, SO3XR3 = 0, 1
GROUPS = {"se3": SE3, "so3xr3": SO3XR3}


@dataclass(frozen=True)
class Tableau:
    """Coefficients of an explicit Runge-Kutta method of `s` stages.

    a : (s, s) strictly lower triangular
    b : (s,) weights
    c : (s,) nodes, the row sums of a
    """

    name: str
    order: int
    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    source: str


def _tableau(name, order, a, b, source):
    stages = len(b)
    full = np.zeros((stages, stages))
    for i, row in enumerate(a):
        full[i, :len(row)] = row
    return Tableau(name, order, full, np.array(b, dtype=float), full.sum(axis=1), source)


METHODS = {t.name: t for t in (
    _tableau("rkmk4", 4, [[], [1 / 2], [0, 1 / 2], [0, 0, 1]], [1 / 6, 1 / 3, 1 / 3, 1 / 6],
             "Kutta 1901, as Munthe-Kaas method: Munthe-Kaas, BIT 38 (1998) 92-111; (6.25)"),
)}
