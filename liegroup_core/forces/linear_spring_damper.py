# SPDX-License-Identifier: Apache-2.0
"""Spring and damper along the z axis of a joint: force -(k (s - s0) + c sdot)."""

from typing import Literal

import numpy as np
from pydantic import Field

from liegroup_core.compiling import kernel
from liegroup_core.fields.values import NotNegative, Number

from . import slide
from .slide import SlideForce

ROW = np.dtype(
    slide.FIELDS
    + [
        ("stiffness", "f8"),
        ("damping", "f8"),
        ("rest_position", "f8"),  # N/m, N s/m, m
    ],
    align=True,
)


class LinearSpringDamper(SlideForce):
    """Spring and damper along the z axis of a joint."""

    type: Literal["linear_spring_damper"] = Field("linear_spring_damper", description="linear_spring_damper")
    stiffness: NotNegative = Field(description="stiffness in N/m, not negative")
    damping: NotNegative = Field(0.0, description="damping in N s/m, not negative")
    rest_position: Number = Field(0.0, description="rest position in m")

    @property
    def is_conservative(self):
        """True without damping."""
        return self.damping == 0.0


def make_row(spring, index, ends):
    """Record of a LinearSpringDamper; arguments as in kinds.make_forces."""
    return (*slide.fields(*ends[spring.joint]), spring.stiffness, spring.damping, spring.rest_position)


@kernel
def effort(row, pose, twist):
    """Force on the child, N."""
    force = row["stiffness"] * (row["rest_position"] - slide.coordinate(row, pose))
    if row["damping"] > 0.0:
        force -= row["damping"] * slide.rate(row, pose, twist)
    return force


@kernel
def add_wrench(rows, pose, twist, wrench_out):
    """Add the wrenches of all rows."""
    for e in range(len(rows)):
        slide.apply(rows[e], pose, effort(rows[e], pose, twist), wrench_out)


@kernel
def energy(rows, pose):
    """Potential energy sum k (s - s0)^2 / 2, J."""
    total = 0.0
    for e in range(len(rows)):
        row = rows[e]
        stretch = slide.coordinate(row, pose) - row["rest_position"]
        total += 0.5 * row["stiffness"] * stretch * stretch
    return total


@kernel
def power(rows, pose, twist):
    """Power -sum c sdot^2 of all dampers, W; never positive."""
    total = 0.0
    for e in range(len(rows)):
        row = rows[e]
        rate = slide.rate(row, pose, twist)
        total -= row["damping"] * rate * rate
    return total


@kernel
def add_change(rows, pose, twist, moves, rates, wrench_out):
    """Add the changes of the wrenches along displacements, see changes.py."""
    for e in range(len(rows)):
        row = rows[e]
        force = effort(row, pose, twist)
        slide.add_change(row, pose, twist, moves, rates, force, row["stiffness"], row["damping"], 0.0, wrench_out)
