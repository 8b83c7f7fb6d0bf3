# SPDX-License-Identifier: Apache-2.0
"""Points of bodies: position, velocity, and forces at them.

body  : body index, or WORLD
place : (3,) m, the point in the frame of the body
moves (n, 6) : displacement of every body, X exp(s moves), in its axes;  rates (n, 6) : change of its twist
"""

from liegroup_core.compiling import kernel
from liegroup_core.joints.elements import WORLD
from liegroup_core.lie.vec3 import ZERO3, add3, cross3, load3, load9, matvec3, sub3, tmatvec3


@kernel
def world_axes(pose, body, direction):
    """World components of a direction that is fixed in a body."""
    if body == WORLD:
        return direction
    return matvec3(load9(pose, body, 0), direction)


@kernel
def body_axes(pose, body, vector):
    """Components of a world vector in the axes of a body; the inverse of `world_axes`."""
    if body == WORLD:
        return vector
    return tmatvec3(load9(pose, body, 0), vector)


@kernel
def point(pose, body, place):
    """World position of a point of a body; for the world, the point itself."""
    if body == WORLD:
        return place
    return add3(load3(pose, body, 9), matvec3(load9(pose, body, 0), place))


@kernel
def place_of(pose, body, position):
    """Point of a body at a given world position; the inverse of `point`."""
    if body == WORLD:
        return position
    return body_axes(pose, body, sub3(position, load3(pose, body, 9)))


@kernel
def point_velocity(pose, twist, body, place):
    """World velocity of a point that is fixed in a body; for moves in place of the twist, its displacement."""
    if body == WORLD:
        return ZERO3
    in_body = add3(load3(twist, body, 3), cross3(load3(twist, body, 0), place))
    return matvec3(load9(pose, body, 0), in_body)


@kernel
def apply_force(pose, body, place, force, wrench_out):
    """Add a world force at a point of a body to the body's wrench in body axes."""
    if body == WORLD:
        return
    in_body = tmatvec3(load9(pose, body, 0), force)
    torque = cross3(place, in_body)
    for c in range(3):
        wrench_out[body, c] += torque[c]
        wrench_out[body, 3 + c] += in_body[c]


@kernel
def turning(pose, moves, body):
    """Rotation vector of a displacement, world axes."""
    return ZERO3 if body == WORLD else matvec3(load9(pose, body, 0), load3(moves, body, 0))


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
