# SPDX-License-Identifier: Apache-2.0
"""Two points that keep within a distance, or beyond one: a cable, a strut that only pushes.

Neither has a mass. A cable is slack below its length and taut at it; a strut bears at its length and
is loose beyond. They are no constraint, but stops of the distance: see joints/stops.py.
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
    length: Positive = Field(description="largest distance of the origins in m, of a strut the least one")

    def elements(self, C_rel):
        """None: it takes no freedom from the mechanism."""
        return ()

    @property
    def switches(self):
        """[Switch]: the distance, with one stop."""
        ends = (self.length, None) if self.type == "strut" else (None, self.length)
        return [Switch(self.name, DISTANCE, self.between(*ends), None)]

    @property
    def constrains(self):
        """False: slack, it is not there; taut, it is a stop."""
        return False

    @property
    def locates_child(self):
        """False: it does not."""
        return False
