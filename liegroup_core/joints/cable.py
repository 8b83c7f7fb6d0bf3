# SPDX-License-Identifier: Apache-2.0
"""Largest or least distance of two points: a cable, or a strut that only pushes.

Both are massless. A cable is slack below its length and taut at its length. A strut bears load at its
length and is loose beyond. They are stops of the distance, not constraints: see joints/stops.py.
"""

from typing import Literal

from pydantic import Field

from liegroup_core.fields.frames import Frame
from liegroup_core.fields.values import Positive

from .described import JointBase
from .stops import DISTANCE, Stop, Switch


class CableJoint(JointBase, Stop):
    """Cable, or strut that only pushes, between the origins of two frames."""

    type: Literal["cable", "strut"] = Field("cable", description="cable or strut")
    parent_frame: Frame = Field(description="frame in the parent frame; only its origin is used")
    child_frame: Frame = Field(description="frame in the child frame; only its origin is used")
    length: Positive = Field(description="largest distance of the origins in m; for a strut, the least distance")

    def elements(self, C_rel):
        """Empty: a cable or strut removes no degree of freedom."""
        return ()

    @property
    def switches(self):
        """[Switch]: the distance, with one stop."""
        ends = (self.length, None) if self.type == "strut" else (None, self.length)
        return [Switch(self.name, DISTANCE, self.between(*ends), None)]

    @property
    def constrains(self):
        """False: a slack cable has no effect, and a taut one is a stop."""
        return False

    @property
    def locates_child(self):
        """False: the joint frames need not coincide."""
        return False
