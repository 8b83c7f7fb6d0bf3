# SPDX-License-Identifier: Apache-2.0
"""Two points at a fixed distance: a massless rod between ball joints.

s is the child's point, q the parent's one; both in the child's body frame, where s is constant and
the parent's point moves with qdot = -(v + w x q), (w, v) = V_b - W the relative twist:

    g = |d| - length ,  d = s - q ,  u = d / |d|
    gdot = u . (v + w x s)      so  J_b = (s x u, u)
    Jdot_b V_rel = udot . (v + w x s) ,   udot = (e - u (u . e)) / |d| ,  e = v + w x q

Where the points coincide there is no direction: the row is then zero, which the solve reports.
"""

import math

from liegroup_core.compiling import kernel
from liegroup_core.lie.vec3 import ZERO3, add3, axpy3, cross3, dot3, scale3, sub3


@kernel
def _direction(s, q):
    """u and 1 / |d|."""
    d = sub3(s, q)
    length = math.sqrt(dot3(d, d))
    if not length > 0.0:
        return ZERO3, 0.0
    return scale3(1.0 / length, d), 1.0 / length


@kernel
def distance_row(s, q):
    """Row J_b of the child: angular part, m; linear part, dimensionless."""
    u, _ = _direction(s, q)
    return cross3(s, u), u


@kernel
def distance_rate(s, q, w, v):
    """Jdot_b V_rel, m/s^2. w, v: relative twist."""
    u, inverse = _direction(s, q)
    e = add3(v, cross3(w, q))
    udot = scale3(inverse, axpy3(-dot3(u, e), u, e))
    return dot3(udot, add3(v, cross3(w, s)))


@kernel
def distance_residual(p, length):
    """How much too far the points are apart, m. p: the child's point seen from the parent's."""
    return math.sqrt(dot3(p, p)) - length
