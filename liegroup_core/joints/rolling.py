# SPDX-License-Identifier: Apache-2.0
"""Rolling without slip: a thin wheel or a ball on a plane, and a knife edge.

The plane is z = 0 of the parent's joint frame, n its normal and t any of its axes, all in the child's body axes. The
child touches it at s: a wheel with axis a (z of its joint frame), centre c and radius r where its rim is lowest, a
ball with centre c below that,

    wheel   s = c - r m / |m| ,  m = n - a (a . n)        ball   s = c - r n
    velocity of the material point at s along t   t . (v + w x s) = 0      so  J_b = (s x t, t)
    Jdot_b V_rel = tdot . (v + w x s) + t . (w x sdot) ,   tdot = -w x t

with the relative twist (w, v) = V_b - W. For t = n this row is the derivative of the height of s, which is its
position residual. The rows along the plane forbid velocities only (nonholonomic): their position residual is zero. A
knife edge at c, along x of the child's joint frame, forbids the velocity of c along y of that.
"""

import math
from typing import Literal

import numpy as np
from pydantic import Field, model_validator

from liegroup_core.compiling import kernel
from liegroup_core.errors import SceneError
from liegroup_core.fields.frames import Frame
from liegroup_core.fields.values import Flag, Positive
from liegroup_core.lie.vec3 import ZERO3, axpy3, cross3, dot3, matvec3, scale3, vector3

from .described import JointBase
from .elements import Element

# Kinds of the rows along x, y and z of the plane; then that of a knife edge.
WHEEL, BALL, EDGE = 4, 7, 10
FIRST, HEIGHT = WHEEL, 2
_ROWS = ("vx", "vy", "vz")
FLAT = 1e-12  # of 1 - cos of the lean: round-off of poses


def is_holonomic(kind):
    """Whether the rows of an element are derivatives of a position residual."""
    return kind < FIRST or kind in (WHEEL + HEIGHT, BALL + HEIGHT)


class RollingJoint(JointBase):
    """Wheel or ball that rolls on a plane without slip."""

    type: Literal["wheel", "ball_on_plane"] = Field(description="wheel or ball_on_plane")
    parent_frame: Frame = Field(Frame(), description="frame of the plane in the parent frame: z is its normal")
    child_frame: Frame = Field(
        description="frame in the child frame, at the centre: z is the axis of a wheel, any axis of a ball"
    )
    radius: Positive = Field(description="radius in m, greater than 0")
    frictionless: Flag = Field(
        False, description="true: it slides, as a caster that is fixed: it only keeps its height"
    )
    mu: Positive | None = Field(
        None, description="coefficient of friction that the contact is believed to have: beyond it there is a warning"
    )

    @model_validator(mode="after")
    def _slides_or_grips(self):
        if self.frictionless and self.mu is not None:
            raise SceneError("mu has no meaning with frictionless: true; keep one of them", place=("mu",))
        return self

    def elements(self, C_rel):
        """Three elements: both directions of the plane, and the height; without friction the last one."""
        first = WHEEL if self.type == "wheel" else BALL
        found = tuple(
            Element(first + k, (name,), np.eye(6)[3 + k : 4 + k], parameter=self.radius) for k, name in enumerate(_ROWS)
        )
        return found[HEIGHT:] if self.frictionless else found

    def singular(self, C_rel):
        """Why the joint has no meaning at a relative pose of its frames, or ""."""
        if self.type == "wheel" and 1.0 - abs(C_rel[2, 2]) < FLAT:
            return "the wheel lies flat on its plane and touches it at no single point"
        return ""

    @property
    def locates_child(self):
        """False: where it touches the plane follows from the motion."""
        return False

    @property
    def remedy(self):
        """Advice for a joint that the initial poses violate."""
        return "place its centre above the plane so that it touches, and give velocities without slip"


class KnifeEdge(JointBase):
    """Blade or thin wheel without radius, as of a skate: it moves along itself only."""

    type: Literal["knife_edge"] = Field("knife_edge", description="knife_edge")
    parent_frame: Frame = Field(Frame(), description="frame of the plane in the parent frame; only its motion matters")
    child_frame: Frame = Field(description="frame in the child frame at the edge: x along it, no velocity along y")

    def elements(self, C_rel):
        """One element."""
        return (Element(EDGE, ("vy",), np.eye(6)[4:5]),)

    @property
    def locates_child(self):
        """False: it determines no position."""
        return False

    @property
    def remedy(self):
        """Advice for a joint that the initial velocities violate."""
        return "give its body a velocity along the edge"


@kernel
def _contact(element, n, w):
    """Contact point s in the child, and its rate; n: normal of the plane."""
    c, radius = vector3(element["child_point"]), element["parameter"]
    ndot = cross3(n, w)
    if element["kind"] >= BALL:
        return axpy3(-radius, n, c), scale3(-radius, ndot)
    frame = element["child_rotation"]
    a = (frame[2], frame[5], frame[8])
    m, mdot = axpy3(-dot3(a, n), a, n), axpy3(-dot3(a, ndot), a, ndot)
    length = math.sqrt(dot3(m, m))
    if not length > 0.0:
        return c, ZERO3
    u = scale3(1.0 / length, m)
    udot = scale3(1.0 / length, axpy3(-dot3(u, mdot), u, mdot))
    return axpy3(-radius, u, c), scale3(-radius, udot)


@kernel
def row(element, rot, p, w, v):
    """Row J_b of the child, in m and dimensionless, and Jdot_b V_rel in m/s^2.

    element : of ELEMENT
    rot, p  : C_ba, pose of the parent in the body frame of the child
    w, v    : relative twist V_b - W, body axes of the child
    returns angular part, linear part, rate
    """
    plane, frame = element["parent_rotation"], element["child_rotation"]
    if element["kind"] == EDGE:
        t, s = (frame[1], frame[4], frame[7]), vector3(element["child_point"])
        return cross3(s, t), t, 0.0
    direction = (element["kind"] - FIRST) % 3
    n = matvec3(rot, (plane[2], plane[5], plane[8]))
    t = n
    if direction == 0:
        t = matvec3(rot, (plane[0], plane[3], plane[6]))
    elif direction == 1:
        t = matvec3(rot, (plane[1], plane[4], plane[7]))
    s, sdot = _contact(element, n, w)
    tdot = cross3(t, w)
    at = cross3(w, s)
    slip = (v[0] + at[0], v[1] + at[1], v[2] + at[2])
    return cross3(s, t), t, dot3(tdot, slip) + dot3(t, cross3(w, sdot))


@kernel
def residual(kind, rot, p, radius):
    """Height of the contact point above the plane, m; 0 of rows that forbid velocities only.

    rot, p : pose of the child's joint frame in the parent's
    """
    if kind == BALL + HEIGHT:
        return p[2] - radius
    if kind == WHEEL + HEIGHT:
        return p[2] - radius * math.hypot(rot[6], rot[7])
    return 0.0
