# SPDX-License-Identifier: Apache-2.0
"""Two directions that stay perpendicular: with a ball joint, the universal joint.

x is the x axis of the parent's joint frame, y the y axis of the child's one; both in the child's
body axes, where y is constant and xdot = -w x x with the relative twist (w, v) = V_b - W:

    g = x . y      gdot = (y x x) . w      so  J_b = (y x x, 0),
    Jdot_b V_rel = (y x xdot) . w = (x . w)(y . w) - (w . w)(x . y)
"""

import math

from liegroup_core.compiling import kernel
from liegroup_core.lie.vec3 import cross3, dot3


@kernel
def perpendicular_row(x, y):
    """Row J_b of the child: its angular part, dimensionless; the linear part is zero."""
    return cross3(y, x)


@kernel
def perpendicular_rate(x, y, w):
    """Jdot_b V_rel, 1/s^2. w: relative angular velocity."""
    return dot3(x, w) * dot3(y, w) - dot3(w, w) * dot3(x, y)


@kernel
def perpendicular_residual(rot):
    """Angle between x and y beyond a right angle, with a minus sign; rad.

    rot : rotation of the child's joint frame in the parent's one. x . y = rot_xy, and the cross
    product has the length of the rest of that row. Its slope by g is 1 at the right angle.
    """
    return math.atan2(rot[1], math.hypot(rot[0], rot[2]))
