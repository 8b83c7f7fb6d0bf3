# SPDX-License-Identifier: Apache-2.0
"""What a scene says of forces: one class a kind, selected by its `type`.

A force holds to two bodies (`parent`, `child`), to a joint (`joint`) or to one body (`body`). What
it does is in the file of its type in liegroup_core/forces/.
"""

from typing import ClassVar, Literal

from pydantic import Field, model_validator

from liegroup_core.errors import SceneError
from liegroup_core.fields.values import (
    Described,
    Name,
    NotNegative,
    Number,
    Positive,
    Text,
    Vector3,
)

# Joints with one angle about z, and joints with one coordinate along z.
TURNING = ("revolute", "cylindrical", "planar", "screw")
SLIDING = ("prismatic", "cylindrical", "screw")


class SpringDamper(Described):
    """Straight spring and damper between two points."""

    name: Name = Field(description="name, unique among joints and forces")
    type: Literal["spring_damper"] = Field("spring_damper", description="spring_damper")
    parent: Text = Field(description="name of a body, or world")
    parent_point: Vector3 = Field(description="attachment point in m, in the parent frame")
    child: Text = Field(description="name of a body")
    child_point: Vector3 = Field(description="attachment point in m, in the child frame")
    stiffness: NotNegative = Field(description="stiffness in N/m, not negative")
    damping: NotNegative = Field(
        0.0, description="damping along the line between the points in N s/m, not negative"
    )
    rest_length: NotNegative = Field(0.0, description="rest length in m, not negative")


class TorsionalSpringDamper(Described):
    """Spring and damper about the z axis of a joint."""

    joint_types: ClassVar = TURNING
    name: Name = Field(description="name, unique among joints and forces")
    type: Literal["torsional_spring_damper"] = Field(
        "torsional_spring_damper", description="torsional_spring_damper"
    )
    joint: Text = Field(description="name of a joint that rotates about its z axis")
    stiffness: NotNegative = Field(description="stiffness in N m/rad, not negative")
    damping: NotNegative = Field(0.0, description="damping in N m s/rad, not negative")
    rest_angle: Number = Field(0.0, description="rest angle in rad, may exceed 2 pi")


class LinearSpringDamper(Described):
    """Spring and damper along the z axis of a joint."""

    joint_types: ClassVar = SLIDING
    name: Name = Field(description="name, unique among joints and forces")
    type: Literal["linear_spring_damper"] = Field(
        "linear_spring_damper", description="linear_spring_damper"
    )
    joint: Text = Field(description="name of a joint that translates along its z axis")
    stiffness: NotNegative = Field(description="stiffness in N/m, not negative")
    damping: NotNegative = Field(0.0, description="damping in N s/m, not negative")
    rest_position: Number = Field(0.0, description="rest position in m")


class Motor(Described):
    """Motor about the z axis of a joint."""

    joint_types: ClassVar = TURNING
    name: Name = Field(description="name, unique among joints and forces")
    type: Literal["motor"] = Field("motor", description="motor")
    joint: Text = Field(description="name of a joint that rotates about its z axis")
    torque: Number = Field(description="stall torque on the child in N m")
    rate_limit: Positive | None = Field(
        None,
        description="no-load speed in rad/s, greater than 0: the torque falls linearly to zero "
        "there; default: constant torque",
    )


class LinearMotor(Described):
    """Motor along the z axis of a joint."""

    joint_types: ClassVar = SLIDING
    name: Name = Field(description="name, unique among joints and forces")
    type: Literal["linear_motor"] = Field("linear_motor", description="linear_motor")
    joint: Text = Field(description="name of a joint that translates along its z axis")
    force: Number = Field(description="stall force on the child in N")
    speed_limit: Positive | None = Field(
        None,
        description="no-load speed in m/s, greater than 0: the force falls linearly to zero there; "
        "default: constant force",
    )


class Drag(Described):
    """Resistance of still surroundings to the motion of a body."""

    name: Name = Field(description="name, unique among joints and forces")
    type: Literal["drag"] = Field("drag", description="drag")
    body: Text = Field(description="name of a body")
    linear: NotNegative = Field(
        0.0, description="linear drag of the centre of mass in N s/m, not negative"
    )
    quadratic: NotNegative = Field(
        0.0, description="quadratic drag of the centre of mass in N s^2/m^2, not negative"
    )
    angular: NotNegative = Field(
        0.0, description="linear rotational drag in N m s/rad, not negative"
    )
    angular_quadratic: NotNegative = Field(
        0.0, description="quadratic rotational drag in N m s^2/rad^2, not negative"
    )


class ConstantWrench(Described):
    """Constant torque and force on a body, from one time to another."""

    name: Name = Field(description="name, unique among joints and forces")
    type: Literal["applied_wrench"] = Field("applied_wrench", description="applied_wrench")
    body: Text = Field(description="name of a body")
    torque: Vector3 = Field((0.0, 0.0, 0.0), description="torque in N m")
    force: Vector3 = Field((0.0, 0.0, 0.0), description="force in N")
    point: Vector3 = Field(
        (0.0, 0.0, 0.0), description="point of application in m, in the body frame"
    )
    axes: Literal["body", "world"] = Field(
        "body", description="axes in which torque and force are constant: body or world"
    )
    start: NotNegative = Field(0.0, description="start time in s, not negative")
    end: Positive | None = Field(None, description="end time in s, after start; default: no end")

    @model_validator(mode="after")
    def _check(self):
        if self.end is not None and self.end <= self.start:
            raise SceneError(
                f"end {self.end:g} must be later than start {self.start:g}: give a later end or "
                "omit it",
                place=("end",),
            )
        return self
