# SPDX-License-Identifier: Apache-2.0
"""Point-to-point spring with damper.

With d the vector from the parent's point to the child's point and l = |d| the force on the child is
    f = -(k (l - l0) + c ldot) d / l ,   ldot = d . ddot / l
and the parent gets -f. A spring of zero rest length has f = -k d, without a division. Where a
direction is missing (l = 0), the rest length and the damper contribute nothing.
"""
import math

from .._compile import kernel
from ..lie.vec3 import (add3, axpy3, cross3, dot3, load3, load9, matvec3, scale3, sub3, tmatvec3,
                        vector3)
from ..model.arrays import WORLD


@kernel
def _point(pose, body, place):
    """World position of a point of a body (of the world: the point itself)."""
    if body == WORLD:
        return place
    return add3(load3(pose, body, 9), matvec3(load9(pose, body, 0), place))


@kernel
def _point_velocity(pose, twist, body, place):
    """World velocity of a point that is fixed in a body."""
    if body == WORLD:
        return (0.0, 0.0, 0.0)
    in_body = add3(load3(twist, body, 3), cross3(load3(twist, body, 0), place))
    return matvec3(load9(pose, body, 0), in_body)


@kernel
def _apply(pose, body, place, force, wrench_out):
    """Add a force in world axes that acts at a point of a body to its wrench in body axes."""
    if body == WORLD:
        return
    in_body = tmatvec3(load9(pose, body, 0), force)
    torque = cross3(place, in_body)
    for c in range(3):
        wrench_out[body, c] += torque[c]
        wrench_out[body, 3 + c] += in_body[c]


@kernel
def add_wrench(springs, pose, twist, wrench_out):
    """Add the wrenches of all spring-dampers (springs: (ns,) of SPRING_DAMPER)."""
    for e in range(len(springs)):
        row = springs[e]
        parent, child = row["parent"], row["child"]
        at_parent = vector3(row["parent_point"])
        at_child = vector3(row["child_point"])
        d = sub3(_point(pose, child, at_child), _point(pose, parent, at_parent))
        factor = row["stiffness"]
        length = math.sqrt(dot3(d, d))
        if length > 0.0:
            factor -= row["stiffness"] * row["rest_length"] / length
            if row["damping"] > 0.0:
                ddot = sub3(_point_velocity(pose, twist, child, at_child),
                            _point_velocity(pose, twist, parent, at_parent))
                factor += row["damping"] * (dot3(d, ddot) / length) / length
        force = scale3(-factor, d)
        _apply(pose, child, at_child, force, wrench_out)
        _apply(pose, parent, at_parent, scale3(-1.0, force), wrench_out)


@kernel
def energy(springs, pose):
    """Potential energy sum k (l - l0)^2 / 2 of all springs, J."""
    total = 0.0
    for e in range(len(springs)):
        row = springs[e]
        d = axpy3(-1.0, _point(pose, row["parent"], vector3(row["parent_point"])),
                  _point(pose, row["child"], vector3(row["child_point"])))
        stretch = math.sqrt(dot3(d, d)) - row["rest_length"]
        total += 0.5 * row["stiffness"] * stretch * stretch
    return total
