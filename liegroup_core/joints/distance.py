# SPDX-License-Identifier: Apache-2.0
"""Fixed distance of two points: a massless rod between spherical joints.

s is the child's point and q the parent's, both in the child's body frame. There s is constant and
qdot = -(v + w x q) with the relative twist (w, v) = V_b - W:

    g = |d| - length ,  d = s - q ,  u = d / |d|
    gdot = u . (v + w x s)      so  J_b = (s x u, u)
    Jdot_b V_rel = udot . (v + w x s) ,   udot = (e - u (u . e)) / |d| ,  e = v + w x q

If the points coincide, the direction is undefined: the row is zero, and the solve reports it.
"""

import math
from typing import Literal

import numpy as np
from pydantic import Field

from liegroup_core.compiling import kernel
from liegroup_core.fields.frames import Frame
from liegroup_core.fields.values import Positive
from liegroup_core.lie.vec3 import ZERO3, add3, axpy3, cross3, dot3, matvec3, scale3, sub3, vector3

from .described import JointBase
from .elements import Element

KIND = 2


class DistanceJoint(JointBase):
    """Massless rod between the origins of two frames."""

    type: Literal["distance"] = Field("distance", description="distance")
    parent_frame: Frame = Field(description="frame in the parent frame; only its origin is used")
    child_frame: Frame = Field(description="frame in the child frame; only its origin is used")
    length: Positive | None = Field(
        None, description="distance of the origins in m, greater than 0; default: the initial distance"
    )

    def elements(self, C_rel):
        """One element; without a given length, it is the initial distance."""
        length = math.hypot(*C_rel[:3, 3]) if self.length is None else self.length
        return (Element(KIND, ("length",), np.eye(6)[3:], parameter=length),)

    @property
    def locates_child(self):
        """False: a rod with coincident ends would have no direction."""
        return False

    @property
    def remedy(self):
        """Advice for a joint that the initial poses violate."""
        return "omit length to keep the initial distance"


@kernel
def row(element, rot, p, w, v):
    """Row J_b of the child, in m and dimensionless, and Jdot_b V_rel in m/s^2.

    element : of ELEMENT
    rot, p  : C_ba, pose of the parent in the body frame of the child
    w, v    : relative twist V_b - W, body axes of the child
    returns angular part, linear part, rate
    """
    s = vector3(element["child_point"])
    q = add3(p, matvec3(rot, vector3(element["parent_point"])))
    d = sub3(s, q)
    length = math.sqrt(dot3(d, d))
    if not length > 0.0:
        return ZERO3, ZERO3, 0.0
    inverse = 1.0 / length
    u = scale3(inverse, d)
    e = add3(v, cross3(w, q))
    udot = scale3(inverse, axpy3(-dot3(u, e), u, e))
    return cross3(s, u), u, dot3(udot, add3(v, cross3(w, s)))


@kernel
def residual(rot, p, length):
    """Distance of the points minus the length, m. p: child's point in the parent's joint frame."""
    return math.sqrt(dot3(p, p)) - length
