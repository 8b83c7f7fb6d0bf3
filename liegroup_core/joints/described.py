# SPDX-License-Identifier: Apache-2.0
"""Keys that all joints of a scene share: the base of all joint classes."""

from typing import Annotated

from pydantic import Field, model_validator

from liegroup_core.errors import SceneError
from liegroup_core.fields.frames import Frame
from liegroup_core.fields.values import Described, Flag, Name, Number, Text

from .motion import Motion
from .rotor import Rotor, rotor_of_type
from .stops import (
    Cone,
    CylinderFriction,
    CylinderLimits,
    Friction,
    Limits,
    friction_of_type,
    limits_of_type,
    switches_of_joint,
)


class JointBase(Described):
    """Joint of a scene between a body and another body or the world.

    A subclass has `elements(C_rel)`: the constraint elements for the initial pose C_rel (4, 4) of
    the child's joint frame in the parent's. It may override `constrains`, `locates_child` and `remedy`.
    """

    name: Name = Field(description="name, unique among joints and forces")
    type: str
    parent: Text = Field(description="name of a body, or world")
    child: Text = Field(description="name of a body")
    parent_frame: Frame | None = Field(
        None, description="joint frame in the parent frame; default: where child_frame is initially"
    )
    child_frame: Frame | None = Field(
        None, description="joint frame in the child frame; default: where parent_frame is initially"
    )
    rate: Number | None = Field(
        None,
        description="initial joint velocity for assembly: about z in rad/s, or along z in m/s if "
        "the joint does not rotate",
    )
    coordinate: Number | None = Field(
        None,
        description="initial joint coordinate that assembly keeps, of revolute, prismatic and screw "
        "joints: angle about z in rad, or displacement along z in m",
    )
    driven: Flag = Field(
        False,
        description="true: the joint moves as prescribed, with whatever effort this requires; without motion "
        "it keeps its initial rate until a command; for revolute, prismatic and screw joints",
    )
    motion: Motion | None = Field(None, description="prescribed motion of a driven joint; see motion of a joint")
    limits: Annotated[Limits | Cone | CylinderLimits | None, limits_of_type] = Field(
        None, description="stops of the joint; see limits of a joint"
    )
    friction: Annotated[Friction | CylinderFriction | None, friction_of_type] = Field(
        None, description="friction of the joint; see friction of a joint"
    )
    rotor: Annotated[Rotor | None, rotor_of_type] = Field(
        None, description="rotor that turns with the joint, through a gear; see rotor of a joint"
    )
    data: dict[Name, Number] | None = Field(
        None,
        description="numbers by name, for example from a robot file; commands beyond lower, upper, velocity "
        "and effort are refused; other names have no effect",
    )

    @model_validator(mode="after")
    def _one_frame(self):
        if self.parent_frame is None and self.child_frame is None:
            raise SceneError("parent_frame or child_frame is missing: give at least one of them")
        return self

    @property
    def switches(self):
        """[Switch]: coordinates of the joint with stops or friction."""
        return switches_of_joint(self)

    @property
    def rotor_inertia(self):
        """Inertia of its rotor at the joint, kg m^2 or kg; 0 without one."""
        return 0.0 if self.rotor is None else self.rotor.reflected

    @property
    def constrains(self):
        """True if the joint removes degrees of freedom."""
        return True

    def singular(self, C_rel):
        """Why the joint has no meaning at a relative pose of its frames, or ""."""
        return ""

    @property
    def locates_child(self):
        """True if the joint allows a pose in which its frames coincide."""
        return True

    @property
    def remedy(self):
        """Advice for a joint that the initial poses violate."""
        return "omit parent_frame or child_frame to place it where the other one is"
