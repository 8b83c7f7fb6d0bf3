# SPDX-License-Identifier: Apache-2.0
"""Point-to-point spring with damper.

With d the vector from the parent's point to the child's point and l = |d| the force on the child is
    f = -(k (l - l0) + c ldot) d / l ,   ldot = d . ddot / l
and the force on the parent is -f. A spring of zero rest length has f = -k d, without a division. At
l = 0 the direction is undefined, and rest length and damper do not contribute.
"""

import math
from typing import Literal

import numpy as np
from pydantic import Field

from liegroup_core.compiling import kernel
from liegroup_core.fields.values import NotNegative, Text, Vector3
from liegroup_core.lie.vec3 import add3, axpy3, cross3, dot3, scale3, sub3, vector3

from .described import Force
from .points import apply_force, point, point_velocity, stay, turning

ROW = np.dtype(
    [
        ("parent", "i8"),
        ("child", "i8"),  # body index or WORLD
        ("parent_point", "f8", (3,)),
        ("child_point", "f8", (3,)),  # m, in the frames of parent and child
        ("stiffness", "f8"),
        ("damping", "f8"),
        ("rest_length", "f8"),  # N/m, N s/m, m
    ],
    align=True,
)


class SpringDamper(Force):
    """Straight spring and damper between two points."""

    type: Literal["spring_damper"] = Field("spring_damper", description="spring_damper")
    parent: Text = Field(description="name of a body, or world")
    parent_point: Vector3 = Field(description="attachment point in m, in the parent frame")
    child: Text = Field(description="name of a body")
    child_point: Vector3 = Field(description="attachment point in m, in the child frame")
    stiffness: NotNegative = Field(description="stiffness in N/m, not negative")
    damping: NotNegative = Field(0.0, description="damping along the line between the points in N s/m, not negative")
    rest_length: NotNegative = Field(0.0, description="rest length in m, not negative")

    @property
    def is_conservative(self):
        """True without damping."""
        return self.damping == 0.0


def make_row(spring, index):
    """Record of a SpringDamper; index as in kinds.make_forces."""
    return (
        index[spring.parent],
        index[spring.child],
        spring.parent_point,
        spring.child_point,
        spring.stiffness,
        spring.damping,
        spring.rest_length,
    )


@kernel
def _line(row, pose):
    """Vector from the parent's point to the child's point, world axes."""
    return sub3(
        point(pose, row["child"], vector3(row["child_point"])), point(pose, row["parent"], vector3(row["parent_point"]))
    )


@kernel
def _line_rate(row, pose, twist):
    """Time derivative of the vector of `_line`."""
    return sub3(
        point_velocity(pose, twist, row["child"], vector3(row["child_point"])),
        point_velocity(pose, twist, row["parent"], vector3(row["parent_point"])),
    )


@kernel
def add_wrench(rows, pose, twist, wrench_out):
    """Add the wrenches of all spring-dampers (rows: (k,) of ROW)."""
    for e in range(len(rows)):
        row = rows[e]
        d = _line(row, pose)
        factor = row["stiffness"]
        length = math.sqrt(dot3(d, d))
        if length > 0.0:
            factor -= row["stiffness"] * row["rest_length"] / length
            if row["damping"] > 0.0:
                ddot = _line_rate(row, pose, twist)
                factor += row["damping"] * (dot3(d, ddot) / length) / length
        force = scale3(-factor, d)
        apply_force(pose, row["child"], vector3(row["child_point"]), force, wrench_out)
        apply_force(pose, row["parent"], vector3(row["parent_point"]), scale3(-1.0, force), wrench_out)


@kernel
def energy(rows, pose):
    """Potential energy sum k (l - l0)^2 / 2 of all springs, J."""
    total = 0.0
    for e in range(len(rows)):
        row = rows[e]
        d = _line(row, pose)
        stretch = math.sqrt(dot3(d, d)) - row["rest_length"]
        total += 0.5 * row["stiffness"] * stretch * stretch
    return total


@kernel
def power(rows, pose, twist):
    """Power -sum c ldot^2 of all dampers, W; never positive."""
    total = 0.0
    for e in range(len(rows)):
        row = rows[e]
        d = _line(row, pose)
        squared = dot3(d, d)
        if squared > 0.0:
            along = dot3(d, _line_rate(row, pose, twist))
            total -= row["damping"] * along * along / squared
    return total


@kernel
def add_change(rows, pose, twist, moves, rates, wrench_out):
    """Add the changes of the wrenches along displacements, see kinds.add_changes."""
    for e in range(len(rows)):
        row = rows[e]
        if stay(moves, rates, row["parent"], row["child"]):
            continue
        a, b, at_a, at_b = row["parent"], row["child"], vector3(row["parent_point"]), vector3(row["child_point"])
        turn_a, turn_b = turning(pose, moves, a), turning(pose, moves, b)
        d, moved = _line(row, pose), _line_rate(row, pose, moves)
        factor, change = row["stiffness"], 0.0
        length = math.sqrt(dot3(d, d))
        if length > 0.0:
            longer = dot3(d, moved) / length
            factor -= row["stiffness"] * row["rest_length"] / length
            change += row["stiffness"] * row["rest_length"] * longer / (length * length)
            if row["damping"] > 0.0:
                ddot = _line_rate(row, pose, twist)
                faster = add3(_line_rate(row, pose, rates), cross3(turn_b, point_velocity(pose, twist, b, at_b)))
                faster = sub3(faster, cross3(turn_a, point_velocity(pose, twist, a, at_a)))
                along = dot3(d, ddot) / length
                factor += row["damping"] * along / length
                along = dot3(moved, ddot) + dot3(d, faster) - 2.0 * along * longer
                change += row["damping"] * along / (length * length)
        force, dF = scale3(-factor, d), axpy3(-change, d, scale3(-factor, moved))
        # The forces are constant in world axes but for dF, and the bodies turn.
        apply_force(pose, b, at_b, sub3(dF, cross3(turn_b, force)), wrench_out)
        apply_force(pose, a, at_a, sub3(cross3(turn_a, force), dF), wrench_out)
