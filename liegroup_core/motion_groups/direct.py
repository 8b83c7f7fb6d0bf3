# SPDX-License-Identifier: Apache-2.0
"""SO(3) x R^3: a floating link as for SE(3), but rotation and position are multiplied separately.

Its velocity on the group is (omega in link axes, rdot in WORLD axes): (6.26) and the note to it. The
rates of the link remain its twist; integrators on the group convert them.
"""

from liegroup_core.compiling import kernel
from liegroup_core.lie.so3 import so3_exp
from liegroup_core.lie.vec3 import add3, cross3, dot3, load3, load9, matmul3, matvec3, store3, store9, sub3, tmatvec3

from .ball import normalise as normalise
from .ball import relative_rotation as relative_rotation
from .ball import slope as slope
from .free import COMPONENTS as COMPONENTS
from .free import JOINTS as JOINTS
from .free import ORDER as ORDER
from .free import displace as displace_by_twist  # noqa: F401
from .free import eliminate as eliminate
from .free import leave as leave
from .free import move_coordinates as move_coordinates
from .free import project_pose as project_pose
from .free import relative_point as relative_point

NAME = "SO(3) x R^3"
IN_WORLD_AXES = True


@kernel
def displace(link, coordinates, row, screws, at, out):
    """X exp(Psi), separately for rotation and position."""
    xi = (screws[at, 0], screws[at + 1, 0], screws[at + 2, 0])
    eta = (screws[at + 3, 0], screws[at + 4, 0], screws[at + 5, 0])
    store3(add3(load3(coordinates, row, 9), eta), out, row, 9)
    store9(matmul3(load9(coordinates, row, 0), so3_exp(xi)), out, row, 0)
    return dot3(xi, xi)


@kernel
def to_world(coordinates, row, v):
    """rdot for the velocity v in link axes."""
    return matvec3(load9(coordinates, row, 0), v)


@kernel
def to_link(coordinates, row, v):
    """Velocity in link axes for rdot."""
    return tmatvec3(load9(coordinates, row, 0), v)


@kernel
def to_world_rate(coordinates, row, w, v, rate):
    """Second derivative of r, for the twist (w, v) and the derivative of v in link axes."""
    return to_world(coordinates, row, add3(rate, cross3(w, v)))


@kernel
def to_link_rate(coordinates, row, w, v, rate):
    """Derivative of v in link axes, for the second derivative of r."""
    return sub3(to_link(coordinates, row, rate), cross3(w, v))
