# SPDX-License-Identifier: Apache-2.0
"""Derivatives of the quantities of points.py along displacements of the bodies.

moves (n, 6) : displacement of every body, X exp(s moves), in its axes;  rates (n, 6) : change of its twist
All results are derivatives by s at 0, in world axes; `body` may be WORLD.
"""

from liegroup_core.compiling import kernel
from liegroup_core.joints.elements import WORLD
from liegroup_core.lie.vec3 import ZERO3, add3, cross3, load3, load9, matvec3, sub3, tmatvec3

from .points import point_velocity, world_axes


@kernel
def stay(moves, rates, a, b):
    """Whether two bodies keep pose and twist, so that a force between them does not change."""
    total = 0.0
    for c in range(6):
        if a != WORLD:
            total += abs(moves[a, c]) + abs(rates[a, c])
        if b != WORLD:
            total += abs(moves[b, c]) + abs(rates[b, c])
    return total == 0.0


@kernel
def turning(pose, moves, body):
    """Rotation vector of a body."""
    return ZERO3 if body == WORLD else matvec3(load9(pose, body, 0), load3(moves, body, 0))


@kernel
def shift(pose, moves, body, place):
    """Displacement of a point that is fixed in a body."""
    return point_velocity(pose, moves, body, place)


@kernel
def change_of_velocity(pose, twist, moves, rates, body, place):
    """Change of the velocity of a point that is fixed in a body."""
    turned = cross3(turning(pose, moves, body), point_velocity(pose, twist, body, place))
    return add3(point_velocity(pose, rates, body, place), turned)


@kernel
def angular_velocity(pose, twist, body):
    """Angular velocity of a body."""
    return ZERO3 if body == WORLD else world_axes(pose, body, load3(twist, body, 0))


@kernel
def change_of_angular_velocity(pose, twist, moves, rates, body):
    """Change of the angular velocity of a body."""
    turned = cross3(turning(pose, moves, body), angular_velocity(pose, twist, body))
    return add3(angular_velocity(pose, rates, body), turned)


@kernel
def in_body_axes(pose, moves, body, vector, change):
    """Change of the components of a vector in the axes of a body, which turns."""
    return tmatvec3(load9(pose, body, 0), sub3(change, cross3(turning(pose, moves, body), vector)))


@kernel
def apply_change_of_force(pose, moves, body, place, force, change, wrench_out):
    """Add the change of `apply_force`, at a point that is fixed in a body."""
    if body == WORLD:
        return
    in_body = in_body_axes(pose, moves, body, force, change)
    torque = cross3(place, in_body)
    for c in range(3):
        wrench_out[body, c] += torque[c]
        wrench_out[body, 3 + c] += in_body[c]


@kernel
def apply_change_of_torque(pose, moves, body, torque, change, wrench_out):
    """Add the change of `apply_torque`."""
    if body == WORLD:
        return
    in_body = in_body_axes(pose, moves, body, torque, change)
    for c in range(3):
        wrench_out[body, c] += in_body[c]
