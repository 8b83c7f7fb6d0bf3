# SPDX-License-Identifier: Apache-2.0
"""Force-torque sensor in a joint or weld: what the joint transmits to its child."""

from typing import Literal

import numpy as np
from pydantic import Field

from liegroup_core.fields.values import NotNegative, Text

from .described import Sensor


class ForceTorque(Sensor):
    """Force-torque sensor in a joint, such as a fixed joint between hand and arm."""

    parts = (*("tx [N m]", "ty [N m]", "tz [N m]"), *("fx [N]", "fy [N]", "fz [N]"))
    type: Literal["force_torque"] = Field("force_torque", description="force_torque")
    joint: Text = Field(description="name of the joint")
    torque_noise: NotNegative = Field(0.0, description="standard deviation of each torque in N m")
    force_noise: NotNegative = Field(0.0, description="standard deviation of each force in N")

    @property
    def noise(self):
        """Standard deviations."""
        return np.repeat([self.torque_noise, self.force_noise], 3)

    def measure(self, sample):
        """(6,) `Sample.reactions` of the joint; NaN where it is undetermined."""
        return sample.reactions[self.joint]
