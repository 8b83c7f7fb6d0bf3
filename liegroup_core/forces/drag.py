# SPDX-License-Identifier: Apache-2.0
"""Drag on a body at its centre of mass, relative to a medium at rest.

    force  -(c1 + c2 |v|) v        torque  -(d1 + d2 |omega|) omega
Both are independent of the choice of axes. At rest, the second derivative of the quadratic part jumps.
"""

import math
from typing import Literal

import numpy as np
from pydantic import Field

from liegroup_core.compiling import kernel
from liegroup_core.fields.values import NotNegative, Text
from liegroup_core.lie.vec3 import dot3, load3

from .described import Force

ROW = np.dtype(
    [
        ("body", "i8"),
        ("linear", "f8"),
        ("quadratic", "f8"),  # N s/m, N s^2/m^2
        ("angular", "f8"),
        ("angular_quadratic", "f8"),  # N m s/rad, N m s^2/rad^2
    ],
    align=True,
)


class Drag(Force):
    """Drag of a medium at rest on a body."""

    type: Literal["drag"] = Field("drag", description="drag")
    body: Text = Field(description="name of a body")
    linear: NotNegative = Field(0.0, description="linear drag of the centre of mass in N s/m, not negative")
    quadratic: NotNegative = Field(0.0, description="quadratic drag of the centre of mass in N s^2/m^2, not negative")
    angular: NotNegative = Field(0.0, description="linear rotational drag in N m s/rad, not negative")
    angular_quadratic: NotNegative = Field(0.0, description="quadratic rotational drag in N m s^2/rad^2, not negative")


def make_row(drag, index):
    """Record of a Drag; index as in kinds.make_forces."""
    return (index[drag.body], drag.linear, drag.quadratic, drag.angular, drag.angular_quadratic)


@kernel
def _factors(row, w, v):
    """Drag coefficients at this angular and linear velocity, N m s/rad and N s/m."""
    return (
        row["angular"] + row["angular_quadratic"] * math.sqrt(dot3(w, w)),
        row["linear"] + row["quadratic"] * math.sqrt(dot3(v, v)),
    )


@kernel
def add_wrench(rows, twist, wrench_out):
    """Add the wrenches of all rows."""
    for e in range(len(rows)):
        row = rows[e]
        body = row["body"]
        w = load3(twist, body, 0)
        v = load3(twist, body, 3)
        angular, linear = _factors(row, w, v)
        for c in range(3):
            wrench_out[body, c] -= angular * w[c]
            wrench_out[body, 3 + c] -= linear * v[c]


@kernel
def power(rows, twist):
    """Power of the drag on all bodies, W; never positive."""
    total = 0.0
    for e in range(len(rows)):
        row = rows[e]
        w = load3(twist, row["body"], 0)
        v = load3(twist, row["body"], 3)
        angular, linear = _factors(row, w, v)
        total -= angular * dot3(w, w) + linear * dot3(v, v)
    return total


@kernel
def add_change(rows, twist, rates, wrench_out):
    """Add the changes of the wrenches with the twists, see kinds.add_changes."""
    for e in range(len(rows)):
        row = rows[e]
        body = row["body"]
        w, v, dw, dv = load3(twist, body, 0), load3(twist, body, 3), load3(rates, body, 0), load3(rates, body, 3)
        angular, linear = _factors(row, w, v)
        turns, moves = math.sqrt(dot3(w, w)), math.sqrt(dot3(v, v))
        more = row["angular_quadratic"] * dot3(w, dw) / turns if turns > 0.0 else 0.0
        further = row["quadratic"] * dot3(v, dv) / moves if moves > 0.0 else 0.0
        for c in range(3):
            wrench_out[body, c] -= angular * dw[c] + more * w[c]
            wrench_out[body, 3 + c] -= linear * dv[c] + further * v[c]
