# SPDX-License-Identifier: Apache-2.0
"""Two perpendicular directions; together with a spherical joint, this is the universal joint.

x is the x axis of the parent's joint frame and y the y axis of the child's, both in the child's body
axes. There y is constant and xdot = -w x x with the relative twist (w, v) = V_b - W:

    g = x . y      gdot = (y x x) . w      so  J_b = (y x x, 0),
    Jdot_b V_rel = (y x xdot) . w = (x . w)(y . w) - (w . w)(x . y)
"""

import math

import numpy as np

from liegroup_core.compiling import kernel
from liegroup_core.lie.vec3 import ZERO3, cross3, dot3, matvec3

from .elements import Element

KIND = 1
PERPENDICULAR = Element(KIND, ("wn",), np.eye(3, 6))


@kernel
def row(element, rot, p, w, v):
    """Row J_b of the child, dimensionless, and Jdot_b V_rel in 1/s^2.

    element : of ELEMENT
    rot, p  : C_ba, pose of the parent in the body frame of the child
    w, v    : relative twist V_b - W, body axes of the child
    returns angular part, linear part, rate
    """
    parent, child = element["parent_rotation"], element["child_rotation"]
    x = matvec3(rot, (parent[0], parent[3], parent[6]))
    y = (child[1], child[4], child[7])
    return cross3(y, x), ZERO3, dot3(x, w) * dot3(y, w) - dot3(w, w) * dot3(x, y)


@kernel
def residual(rot, p, parameter):
    """Pi / 2 minus the angle between x and y, rad.

    rot : rotation of the child's joint frame in the parent's. x . y = rot_xy; the length of x x y is
    that of the other two elements of this row of rot. The derivative with respect to g is 1 at pi / 2.
    """
    return math.atan2(rot[1], math.hypot(rot[0], rot[2]))
