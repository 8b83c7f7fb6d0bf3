# SPDX-License-Identifier: Apache-2.0
"""Torsional spring with damper about the z axis of a joint.

    torque on the child  -(k (theta - theta0) + c thetadot)
The angle theta is unwrapped (turn.py). Its value after the last step is part of the state, one number
`angle` per row.
"""

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from liegroup_core.compiling import kernel
from liegroup_core.fields.values import NotNegative, Number

from . import turn
from .turn import TurnForce

ROW = np.dtype(
    turn.FIELDS
    + [
        ("stiffness", "f8"),
        ("damping", "f8"),
        ("rest_angle", "f8"),  # N m/rad, N m s/rad, rad
    ],
    align=True,
)


class TorsionalSpringDamper(TurnForce):
    """Spring and damper about the z axis of a joint."""

    counts_turns: ClassVar = True
    type: Literal["torsional_spring_damper"] = Field("torsional_spring_damper", description="torsional_spring_damper")
    stiffness: NotNegative = Field(description="stiffness in N m/rad, not negative")
    damping: NotNegative = Field(0.0, description="damping in N m s/rad, not negative")
    rest_angle: Number = Field(0.0, description="rest angle in rad, may exceed 2 pi")

    @property
    def is_conservative(self):
        """True without damping."""
        return self.damping == 0.0


def make_row(spring, index, ends):
    """Record of a TorsionalSpringDamper; arguments as in kinds.make_forces."""
    return (*turn.fields(*ends[spring.joint]), spring.stiffness, spring.damping, spring.rest_angle)


@kernel
def effort(row, near, pose, twist, n):
    """Torque on the child, N m; near: the angle after the last step, n: see turn.axis."""
    torque = row["stiffness"] * (row["rest_angle"] - turn.angle(row, pose, near))
    if row["damping"] > 0.0:
        torque -= row["damping"] * turn.rate(row, pose, twist, n)
    return torque


@kernel
def add_wrench(rows, angle, pose, twist, wrench_out):
    """Add the torques of all rows; angle: (k,) rad after the last step."""
    for e in range(len(rows)):
        row = rows[e]
        n = turn.axis(row, pose)
        turn.apply(row, pose, n, effort(row, angle[e], pose, twist, n), wrench_out)


@kernel
def energy(rows, angle, pose):
    """Potential energy sum k (theta - theta0)^2 / 2, J; angle (k,) as for `add_wrench`."""
    total = 0.0
    for e in range(len(rows)):
        row = rows[e]
        wound = turn.angle(row, pose, angle[e]) - row["rest_angle"]
        total += 0.5 * row["stiffness"] * wound * wound
    return total


@kernel
def power(rows, pose, twist):
    """Power -sum c thetadot^2 of all dampers, W; never positive."""
    total = 0.0
    for e in range(len(rows)):
        row = rows[e]
        rate = turn.rate(row, pose, twist, turn.axis(row, pose))
        total -= row["damping"] * rate * rate
    return total


@kernel
def add_change(rows, angle, pose, twist, moves, rates, wrench_out):
    """Add the changes of the torques along displacements, see changes.py."""
    for e in range(len(rows)):
        row = rows[e]
        n = turn.axis(row, pose)
        torque = effort(row, angle[e], pose, twist, n)
        turn.add_change(row, pose, twist, moves, rates, n, torque, row["stiffness"], row["damping"], 0.0, wrench_out)
