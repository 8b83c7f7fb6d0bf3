# SPDX-License-Identifier: Apache-2.0
"""Translation of a joint along its z axis: coordinate, rate, and a force along it.

With o_a, o_b the origins of the joint frames and z the z axis of the parent's frame,
    coordinate   s = z . (o_b - o_a)
    rate         sdot = z . (velocity of o_b - velocity of the parent's point that is at o_b)
A force f z acts on the child at o_b, and -f z acts on the parent at the same point. Their total wrench
is zero, and their work is exactly f ds, even if the joint drifts (test/contract/test_forces.py).
"""

from typing import ClassVar

from pydantic import Field

from liegroup_core.compiling import kernel
from liegroup_core.fields.values import Text
from liegroup_core.lie.vec3 import ZERO3, axpy3, cross3, dot3, scale3, sub3, vector3

from .changes import (
    angular_velocity,
    apply_change_of_force,
    apply_change_of_torque,
    change_of_velocity,
    shift,
    stay,
    turning,
)
from .described import Force
from .points import apply_force, place_of, point, point_velocity, world_axes


class SlideForce(Force):
    """Force along the z axis of a joint."""

    joint_moves: ClassVar = "slides"
    joint: Text = Field(description="name of a joint that translates along its z axis")


FIELDS = [
    ("parent", "i8"),
    ("child", "i8"),  # body index or WORLD
    ("axis", "f8", (3,)),  # z in the axes of the parent
    ("parent_origin", "f8", (3,)),
    ("child_origin", "f8", (3,)),  # m, in the frames of parent and child
]


def fields(parent, child, parent_frame, child_frame):
    """Values of FIELDS from body indices and joint frames (4, 4)."""
    return parent, child, parent_frame[:3, 2], parent_frame[:3, 3], child_frame[:3, 3]


@kernel
def coordinate(row, pose):
    """s, m."""
    z = world_axes(pose, row["parent"], vector3(row["axis"]))
    return dot3(
        z,
        sub3(
            point(pose, row["child"], vector3(row["child_origin"])),
            point(pose, row["parent"], vector3(row["parent_origin"])),
        ),
    )


@kernel
def rate(row, pose, twist):
    """sdot, m/s."""
    z = world_axes(pose, row["parent"], vector3(row["axis"]))
    place = vector3(row["child_origin"])
    at_parent = place_of(pose, row["parent"], point(pose, row["child"], place))
    return dot3(
        z, sub3(point_velocity(pose, twist, row["child"], place), point_velocity(pose, twist, row["parent"], at_parent))
    )


@kernel
def apply(row, pose, force, wrench_out):
    """Add the wrench of force * z to the child and subtract it from the parent."""
    pull = scale3(force, world_axes(pose, row["parent"], vector3(row["axis"])))
    place = vector3(row["child_origin"])
    at_parent = place_of(pose, row["parent"], point(pose, row["child"], place))
    apply_force(pose, row["child"], place, pull, wrench_out)
    apply_force(pose, row["parent"], at_parent, scale3(-1.0, pull), wrench_out)


@kernel
def add_change(row, pose, twist, moves, rates, force, stiffness, damping, given, wrench_out):
    """Add the change of `apply` along displacements, see changes.py.

    stiffness, damping : minus the derivatives of the force by coordinate and rate; given : its change by other causes
    """
    a, b, place = row["parent"], row["child"], vector3(row["child_origin"])
    if given == 0.0 and stay(moves, rates, a, b):
        return
    z = world_axes(pose, a, vector3(row["axis"]))
    dz = cross3(turning(pose, moves, a), z)
    origin, at = vector3(row["parent_origin"]), point(pose, b, place)
    moved = shift(pose, moves, b, place)
    s = dot3(dz, sub3(at, point(pose, a, origin))) + dot3(z, sub3(moved, shift(pose, moves, a, origin)))
    # Of the parent's point that is at the child's: its place in the parent changes, too.
    there = place_of(pose, a, at)
    apart = sub3(moved, shift(pose, moves, a, there))
    speed = sub3(point_velocity(pose, twist, b, place), point_velocity(pose, twist, a, there))
    faster = sub3(
        change_of_velocity(pose, twist, moves, rates, b, place), change_of_velocity(pose, twist, moves, rates, a, there)
    )
    faster = sub3(faster, cross3(angular_velocity(pose, twist, a), apart))
    change = given - stiffness * s - damping * (dot3(dz, speed) + dot3(z, faster))
    pull, changed = scale3(force, z), axpy3(change, z, scale3(force, dz))
    apply_change_of_force(pose, moves, b, place, pull, changed, wrench_out)
    apply_change_of_force(pose, moves, a, there, scale3(-1.0, pull), scale3(-1.0, changed), wrench_out)
    apply_change_of_torque(pose, moves, a, ZERO3, cross3(pull, apart), wrench_out)
