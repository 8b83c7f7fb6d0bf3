# SPDX-License-Identifier: Apache-2.0
"""Points of bodies: position, velocity, and forces at them.

body  : body index, or WORLD
place : (3,) m, the point in the frame of the body
"""

from liegroup_core.compiling import kernel
from liegroup_core.joints.elements import WORLD
from liegroup_core.lie.vec3 import add3, cross3, load3, load9, matvec3, sub3, tmatvec3


@kernel
def world_axes(pose, body, direction):
    """World components of a direction that is fixed in a body."""
    if body == WORLD:
        return direction
    return matvec3(load9(pose, body, 0), direction)


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
    return tmatvec3(load9(pose, body, 0), sub3(position, load3(pose, body, 9)))


@kernel
def point_velocity(pose, twist, body, place):
    """World velocity of a point that is fixed in a body."""
    if body == WORLD:
        return (0.0, 0.0, 0.0)
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
def apply_torque(pose, body, torque, wrench_out):
    """Add a world torque to the wrench of a body in body axes."""
    if body == WORLD:
        return
    in_body = tmatvec3(load9(pose, body, 0), torque)
    for c in range(3):
        wrench_out[body, c] += in_body[c]
