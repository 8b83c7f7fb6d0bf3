# SPDX-License-Identifier: Apache-2.0
"""Springs, dampers, motors and servos about or along the z axis of a joint: one law of its coordinate q (axis.py).

    effort on the child   f + k (q* - q) + c (v* - qdot) ,   within +- limit
Springs with dampers have q* at rest and v* = 0. Targets q*, v* of servos come from the scene or from commands, which
are constant between two instants of the schedule, or they are outputs of a law (law.py). A motor has f at rest and
c = |f| / no-load speed: the characteristic of a DC motor at constant voltage. It holds at every rate: above the no-load
speed the motor brakes, and for rates opposite to f the effort exceeds f. The effort is smooth, so that methods keep
their order.

The angle of a spring or servo is unwrapped. Its value after the last step is part of the state.
"""

import math
from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from liegroup_core.compiling import kernel
from liegroup_core.fields.values import NotNegative, Number, Positive, Text

from . import axis
from .described import Force

GROUPS = ("dampers", "motors", "servos")
LAW = {"effort": 0.0, "stiffness": 0.0, "damping": 0.0, "position": 0.0, "velocity": 0.0, "limit": math.inf}
ROW = np.dtype(
    [
        ("group", "i8"),  # index in GROUPS; the first have potential energy
        ("angle", "i8"),  # index of the unwrapped angle, or -1
        ("target", "i8"),  # index of the target position and velocity, which replace those of the row, or -1
        ("position_from", "i8"),
        ("velocity_from", "i8"),  # registers of laws with the target position and velocity, or -1
        *((key, "f8") for key in LAW),
        *axis.FIELDS,
    ],
    align=True,
)


class TurnForce(Force):
    """Force about the z axis of a joint."""

    joint_moves: ClassVar = "turns"
    joint: Text = Field(description="name of a joint that rotates about its z axis")


class SlideForce(Force):
    """Force along the z axis of a joint."""

    joint_moves: ClassVar = "slides"
    joint: Text = Field(description="name of a joint that translates along its z axis")


class _Spring(Force):
    group: ClassVar = "dampers"

    @property
    def is_conservative(self):
        """True without damping."""
        return self.damping == 0.0


class _Servo(Force):
    group: ClassVar = "servos"

    @property
    def law(self):
        """Entries of LAW."""
        targets = {"position": self.position, "velocity": self.velocity}
        return {"stiffness": self.stiffness, "damping": self.damping, "limit": self.effort_limit or math.inf} | targets


class TorsionalSpringDamper(_Spring, TurnForce):
    """Spring and damper about the z axis of a joint."""

    type: Literal["torsional_spring_damper"] = Field("torsional_spring_damper", description="torsional_spring_damper")
    stiffness: NotNegative = Field(description="stiffness in N m/rad, not negative")
    damping: NotNegative = Field(0.0, description="damping in N m s/rad, not negative")
    rest_angle: Number = Field(0.0, description="rest angle in rad, may exceed 2 pi")

    @property
    def law(self):
        """Entries of LAW."""
        return {"stiffness": self.stiffness, "damping": self.damping, "position": self.rest_angle}


class LinearSpringDamper(_Spring, SlideForce):
    """Spring and damper along the z axis of a joint."""

    type: Literal["linear_spring_damper"] = Field("linear_spring_damper", description="linear_spring_damper")
    stiffness: NotNegative = Field(description="stiffness in N/m, not negative")
    damping: NotNegative = Field(0.0, description="damping in N s/m, not negative")
    rest_position: Number = Field(0.0, description="rest position in m")

    @property
    def law(self):
        """Entries of LAW."""
        return {"stiffness": self.stiffness, "damping": self.damping, "position": self.rest_position}


class Motor(TurnForce):
    """Motor about the z axis of a joint."""

    group: ClassVar = "motors"
    type: Literal["motor"] = Field("motor", description="motor")
    torque: Number = Field(description="stall torque on the child in N m")
    rate_limit: Positive | None = Field(
        None,
        description="no-load speed in rad/s, greater than 0, at which the torque has fallen linearly to "
        "zero; default: constant torque",
    )

    @property
    def law(self):
        """Entries of LAW."""
        return {"effort": self.torque, "damping": abs(self.torque) / (self.rate_limit or math.inf)}


class LinearMotor(SlideForce):
    """Motor along the z axis of a joint."""

    group: ClassVar = "motors"
    type: Literal["linear_motor"] = Field("linear_motor", description="linear_motor")
    force: Number = Field(description="stall force on the child in N")
    speed_limit: Positive | None = Field(
        None,
        description="no-load speed in m/s, greater than 0, at which the force has fallen linearly to zero; "
        "default: constant force",
    )

    @property
    def law(self):
        """Entries of LAW."""
        return {"effort": self.force, "damping": abs(self.force) / (self.speed_limit or math.inf)}


class Servo(_Servo, TurnForce):
    """Servo about the z axis of a joint."""

    type: Literal["servo"] = Field("servo", description="servo")
    stiffness: NotNegative = Field(description="position gain in N m/rad, not negative")
    damping: NotNegative = Field(0.0, description="velocity gain in N m s/rad, not negative")
    effort_limit: Positive | None = Field(None, description="largest torque in N m, greater than 0; default: no limit")
    position: Number = Field(0.0, description="target angle in rad until a command; may exceed 2 pi")
    velocity: Number = Field(0.0, description="target velocity in rad/s until a command")


class LinearServo(_Servo, SlideForce):
    """Servo along the z axis of a joint."""

    type: Literal["linear_servo"] = Field("linear_servo", description="linear_servo")
    stiffness: NotNegative = Field(description="position gain in N/m, not negative")
    damping: NotNegative = Field(0.0, description="velocity gain in N s/m, not negative")
    effort_limit: Positive | None = Field(None, description="largest force in N, greater than 0; default: no limit")
    position: Number = Field(0.0, description="target position in m until a command")
    velocity: Number = Field(0.0, description="target velocity in m/s until a command")


def make_row(force, ends, angle, target, registers):
    """Record of a force; ends as in kinds.make_forces, angle, target and registers (2,): see ROW."""
    motion = axis.fields(force.joint_moves == "slides", *ends[force.joint])
    return GROUPS.index(force.group), angle, target, *registers, *(LAW | force.law).values(), *motion


@kernel
def _effort(row, unit, angle, targets, registers, pose, twist):
    """Effort on the child, N m or N; unit: see axis.unit_wrenches."""
    effort, position, velocity, near = row["effort"], row["position"], row["velocity"], 0.0
    if row["target"] >= 0:
        position, velocity = targets[row["target"], 0], targets[row["target"], 1]
    if row["position_from"] >= 0:
        position = registers[row["position_from"], 0]
    if row["velocity_from"] >= 0:
        velocity = registers[row["velocity_from"], 0]
    if row["stiffness"] > 0.0:
        if row["angle"] >= 0:
            near = angle[row["angle"]]
        effort += row["stiffness"] * (position - axis.coordinate(row, pose, near))
    effort += row["damping"] * (velocity - axis.rate(row, unit, twist))
    return min(max(effort, -row["limit"]), row["limit"])


@kernel
def add_wrench(rows, angle, targets, registers, pose, twist, wrench_out):
    """Add the wrenches of all rows.

    angle   : (k,) rad, all unwrapped angles after the last step
    targets : (k, 2) target position and velocity of all servos
    registers : (m, 2) of laws, after law.measure in this state
    """
    for e in range(len(rows)):
        row = rows[e]
        unit = axis.unit_wrenches(row, pose)
        axis.apply(row, unit, _effort(row, unit, angle, targets, registers, pose, twist), wrench_out)


@kernel
def efforts(rows, angle, targets, registers, pose, twist, out):
    """Write the efforts of all rows on the children of their joints to out (k,); arguments as for `add_wrench`."""
    for e in range(len(rows)):
        out[e] = _effort(rows[e], axis.unit_wrenches(rows[e], pose), angle, targets, registers, pose, twist)


@kernel
def energy(rows, angle, pose):
    """Potential energy sum k (q - q*)^2 / 2 of the springs, J; angle as for `add_wrench`."""
    total = 0.0
    for e in range(len(rows)):
        row = rows[e]
        if row["group"] == 0:
            near = angle[row["angle"]] if row["angle"] >= 0 else 0.0
            stretch = axis.coordinate(row, pose, near) - row["position"]
            total += 0.5 * row["stiffness"] * stretch * stretch
    return total


@kernel
def powers(rows, angle, targets, registers, pose, twist):
    """Powers by GROUPS, W: -sum c qdot^2 of dampers, never positive; sum effort * qdot of motors and servos."""
    dampers = motors = servos = 0.0
    for e in range(len(rows)):
        row = rows[e]
        unit = axis.unit_wrenches(row, pose)
        rate = axis.rate(row, unit, twist)
        if row["group"] == 0:
            dampers -= row["damping"] * rate * rate
        else:
            power = _effort(row, unit, angle, targets, registers, pose, twist) * rate
            if row["group"] == 1:
                motors += power
            else:
                servos += power
    return dampers, motors, servos


@kernel
def add_change(rows, angle, targets, registers, pose, twist, moves, rates, shifts, at, wrench_out):
    """Add the changes of the wrenches along displacements, see kinds.add_changes; at a limit efforts do not change.

    registers : after law.measure_changes along the displacements

    shifts : changes of the targets of all servos, from row `at` on
    """
    for e in range(len(rows)):
        row = rows[e]
        unit = axis.unit_wrenches(row, pose)
        effort = _effort(row, unit, angle, targets, registers, pose, twist)
        k, c, given = row["stiffness"], row["damping"], 0.0
        if abs(effort) >= row["limit"]:
            k = c = 0.0
        if row["target"] >= 0:
            own = at + row["target"]
            position, velocity = row["position_from"], row["velocity_from"]
            given = k * (shifts[own, 0] if position < 0 else registers[position, 1])
            given += c * (shifts[own, 1] if velocity < 0 else registers[velocity, 1])
        axis.add_change(row, unit, pose, twist, moves, rates, effort, k, c, given, wrench_out)
