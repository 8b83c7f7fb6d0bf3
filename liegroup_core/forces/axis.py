# SPDX-License-Identifier: Apache-2.0
"""Motion of a joint about or along its z axis: coordinate q, rate, and an effort that acts on it.

A joint that turns, with R the rotation of the child's joint frame in the parent's and z_a, z_b the z axes of both,
    angle    q = atan2(R10 - R01, R00 + R11)        twist angle of the swing-twist decomposition
    effort   torque n on the child and -n on the parent ,   n = (z_a + z_b) / (1 + z_a . z_b)
If the z axes coincide, n is the axis. A joint that slides, with o_a, o_b the origins of the joint frames,
    displacement   q = z_a . (o_b - o_a)
    effort         force z_a on the child and -z_a on the parent, both at o_b

The wrenches of a unit effort are the gradient of q, even if the joint drifts: their power is the rate of q, and the
work of an effort is exactly effort dq (test/contract/test_forces.py).

A rotation matrix gives the angle modulo 2 pi. The angle is unwrapped: it is the value nearest to that
of the last step. This is exact if the joint rotates by less than pi per step.
"""

import math

import numpy as np

from liegroup_core.compiling import kernel
from liegroup_core.joints.elements import WORLD
from liegroup_core.lie.vec3 import (
    ZERO3,
    add3,
    axpy3,
    cross3,
    dot3,
    load3,
    load9,
    matmul3,
    matrix3,
    scale3,
    sub3,
    tmatmul3,
    vector3,
)

from .points import body_axes, place_of, point, point_velocity, stay, turning, world_axes

FIELDS = [
    ("slides", "i8"),  # 1: along z, 0: about z
    ("parent", "i8"),
    ("child", "i8"),  # body index or WORLD
    ("parent_axes", "f8", (9,)),
    ("child_axes", "f8", (9,)),  # rotation from joint frame to body frame, of parent and child
    ("parent_origin", "f8", (3,)),
    ("child_origin", "f8", (3,)),  # m, in the frames of parent and child
]
ROW = np.dtype(FIELDS, align=True)


def fields(slides, parent, child, parent_frame, child_frame):
    """Values of FIELDS from body indices and joint frames (4, 4)."""
    frames = parent_frame, child_frame
    return slides, parent, child, *(F[:3, :3].ravel() for F in frames), *(F[:3, 3] for F in frames)


@kernel
def _frame_axes(pose, body, axes):
    """Axes of a joint frame in the world: a rotation matrix."""
    if body == WORLD:
        return axes
    return matmul3(load9(pose, body, 0), axes)


@kernel
def _z_axis(pose, body, axes):
    return world_axes(pose, body, (axes[2], axes[5], axes[8]))


@kernel
def unwrapped(value, near):
    """The angle that differs from `value` by whole turns and is nearest to `near`, rad."""
    return value + 2.0 * math.pi * math.floor((near - value) / (2.0 * math.pi) + 0.5)


@kernel
def angle(row, pose, near):
    """Angle of the child's joint frame about z, rad: the value modulo 2 pi nearest to `near`."""
    relative = tmatmul3(
        _frame_axes(pose, row["parent"], matrix3(row["parent_axes"])),
        _frame_axes(pose, row["child"], matrix3(row["child_axes"])),
    )
    within_a_turn = math.atan2(relative[3] - relative[1], relative[0] + relative[4])
    return unwrapped(within_a_turn, near)


@kernel
def _place(row, pose):
    """Point of the parent that is at the origin of the child's joint frame."""
    return place_of(pose, row["parent"], point(pose, row["child"], vector3(row["child_origin"])))


@kernel
def displacement(row, pose):
    """Displacement of the child's joint frame along z of the parent's, m."""
    axes = row["parent_axes"]
    return dot3((axes[2], axes[5], axes[8]), sub3(_place(row, pose), vector3(row["parent_origin"])))


@kernel
def coordinate(row, pose, near):
    """Displacement of a joint that slides, m, or the angle nearest to `near`, rad."""
    return displacement(row, pose) if row["slides"] == 1 else angle(row, pose, near)


@kernel
def _normal(z_a, z_b):
    both = 1.0 + dot3(z_a, z_b)
    # The angle is undefined for opposite axes, but the joint does not allow such a pose.
    inverse = 1.0 / both if both > 0.0 else 0.0
    return inverse, scale3(inverse, add3(z_a, z_b))


@kernel
def unit_wrenches(row, pose):
    """((torque, force) on the child, the same on the parent with the opposite sign) of a unit effort, body axes."""
    a, b = row["parent"], row["child"]
    n = _z_axis(pose, a, row["parent_axes"])
    if row["slides"] == 1:
        on_child, on_parent = body_axes(pose, b, n), body_axes(pose, a, n)
        moment = cross3(vector3(row["child_origin"]), on_child)
        return (moment, on_child), (cross3(_place(row, pose), on_parent), on_parent)
    _, n = _normal(n, _z_axis(pose, b, row["child_axes"]))
    return (body_axes(pose, b, n), ZERO3), (body_axes(pose, a, n), ZERO3)


@kernel
def keep_unit(unit, numbers, at):
    """Write unit wrenches to the rows at .. at + 5 of an array (m, 2)."""
    for c in range(3):
        numbers[at + c, 0], numbers[at + c, 1] = unit[0][0][c], unit[0][1][c]
        numbers[at + 3 + c, 0], numbers[at + 3 + c, 1] = unit[1][0][c], unit[1][1][c]


@kernel
def kept_unit(numbers, at):
    """Unit wrenches that `keep_unit` has written."""
    return (
        (
            (numbers[at, 0], numbers[at + 1, 0], numbers[at + 2, 0]),
            (numbers[at, 1], numbers[at + 1, 1], numbers[at + 2, 1]),
        ),
        (
            (numbers[at + 3, 0], numbers[at + 4, 0], numbers[at + 5, 0]),
            (numbers[at + 3, 1], numbers[at + 4, 1], numbers[at + 5, 1]),
        ),
    )


@kernel
def _changes(row, pose, moves, unit):
    """Derivatives of unit wrenches along displacements, see kinds.add_changes."""
    a, b = row["parent"], row["child"]
    turn_a, turn_b = turning(pose, moves, a), turning(pose, moves, b)
    z_a = _z_axis(pose, a, row["parent_axes"])
    d_a = cross3(turn_a, z_a)
    if row["slides"] == 1:
        place, there = vector3(row["child_origin"]), _place(row, pose)
        on_child = body_axes(pose, b, sub3(d_a, cross3(turn_b, z_a)))
        # Of the parent's point that is at the child's: its place in the parent changes, too.
        apart = body_axes(pose, a, sub3(point_velocity(pose, moves, b, place), point_velocity(pose, moves, a, there)))
        return (cross3(place, on_child), on_child), (cross3(apart, unit[1][1]), ZERO3)
    z_b = _z_axis(pose, b, row["child_axes"])
    d_b = cross3(turn_b, z_b)
    inverse, n = _normal(z_a, z_b)
    dn = scale3(inverse, axpy3(-(dot3(d_a, z_b) + dot3(z_a, d_b)), n, add3(d_a, d_b)))
    on_child = body_axes(pose, b, sub3(dn, cross3(turn_b, n)))
    return (on_child, ZERO3), (body_axes(pose, a, sub3(dn, cross3(turn_a, n))), ZERO3)


@kernel
def _power(row, wrench, twist, body):
    if body == WORLD:
        return 0.0
    total = dot3(wrench[0], load3(twist, body, 0))
    if row["slides"] == 1:
        total += dot3(wrench[1], load3(twist, body, 3))
    return total


@kernel
def rate(row, unit, twist):
    """Rate of the coordinate, rad/s or m/s; unit : see `unit_wrenches`."""
    return _power(row, unit[0], twist, row["child"]) - _power(row, unit[1], twist, row["parent"])


@kernel
def rate_change(row, unit, pose, twist, moves, rates):
    """Change of the rate along displacements, see kinds.add_changes."""
    return rate(row, _changes(row, pose, moves, unit), twist) + rate(row, unit, rates)


@kernel
def _add(row, effort, wrench, body, wrench_out):
    if body == WORLD:
        return
    for c in range(3):
        wrench_out[body, c] += effort * wrench[0][c]
    if row["slides"] == 1:
        for c in range(3):
            wrench_out[body, 3 + c] += effort * wrench[1][c]


@kernel
def apply(row, unit, effort, wrench_out):
    """Add the wrenches of an effort; unit : see `unit_wrenches`."""
    _add(row, effort, unit[0], row["child"], wrench_out)
    _add(row, -effort, unit[1], row["parent"], wrench_out)


@kernel
def add_change(row, unit, pose, twist, moves, rates, effort, stiffness, damping, given, wrench_out):
    """Add the change of `apply` along displacements, see kinds.add_changes.

    stiffness, damping : minus the derivatives of the effort by coordinate and rate; given : its change by other causes
    """
    if given == 0.0 and stay(moves, rates, row["parent"], row["child"]):
        return
    change = _changes(row, pose, moves, unit)
    faster = rate(row, change, twist) + rate(row, unit, rates)
    apply(row, unit, given - stiffness * rate(row, unit, moves) - damping * faster, wrench_out)
    apply(row, change, effort, wrench_out)


@kernel
def count_turns(rows, pose, angles):
    """Unwrap the angles (k,) of rows (k,) at a pose; each must have changed by less than pi since the last call."""
    for e in range(len(rows)):
        angles[e] = angle(rows[e], pose, angles[e])


@kernel
def too_fast(rows, h, pose, twist):
    """First row whose joint rotates by pi or more in a time h, or -1."""
    for e in range(len(rows)):
        row = rows[e]
        if abs(h * rate(row, unit_wrenches(row, pose), twist)) >= math.pi:
            return e
    return -1
