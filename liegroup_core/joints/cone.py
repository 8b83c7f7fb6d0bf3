# SPDX-License-Identifier: Apache-2.0
"""Angle between two directions: the coordinate that a cone limits at a spherical joint.

x and y are the z axes of the parent's and the child's joint frame, both in the child's body axes.
With the relative twist (w, v) = V_b - W, xdot = -w x x:

    theta = angle(x, y) ,  cos theta = x . y      thetadot = (x x y) . w / sin theta
    Jdot_b V_rel = -((x . w)(y . w) - (w . w - thetadot^2) cos theta) / sin theta

If the axes coincide, the angle has no gradient and the row is zero.
"""

import math

import numpy as np

from liegroup_core.compiling import kernel
from liegroup_core.lie.vec3 import ZERO3, cross3, dot3, matvec3, scale3

from .elements import Element

KIND = 3
CONE_ANGLE = Element(KIND, ("wc",), np.eye(3, 6))


@kernel
def row(element, rot, p, w, v):
    """Row J_b of the child, dimensionless, and Jdot_b V_rel in 1/s^2."""
    parent, child = element["parent_rotation"], element["child_rotation"]
    x = matvec3(rot, (parent[2], parent[5], parent[8]))
    y = (child[2], child[5], child[8])
    across = cross3(x, y)
    sine, cosine = math.sqrt(dot3(across, across)), dot3(x, y)
    if not sine > 0.0:
        return ZERO3, ZERO3, 0.0
    across = scale3(1.0 / sine, across)
    rate = dot3(across, w)
    bent = dot3(x, w) * dot3(y, w) - (dot3(w, w) - rate * rate) * cosine
    return across, ZERO3, -bent / sine


@kernel
def residual(rot, p, parameter):
    """Angle between the z axes, rad; rot: rotation of the child's joint frame in the parent's."""
    return math.atan2(math.hypot(rot[2], rot[5]), rot[8])
