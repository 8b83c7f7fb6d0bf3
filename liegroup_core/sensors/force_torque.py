# SPDX-License-Identifier: Apache-2.0
"""Force-torque sensor in a joint: the wrench that the joint transmits to its child."""

from typing import Literal

import numpy as np
from pydantic import Field

from liegroup_core.fields.frames import Frame
from liegroup_core.fields.values import NotNegative, Text
from liegroup_core.lie.groups import SE3, SO3

from .described import NoisySensor

MEASURED = {"reaction": "reactions", "transmitted": "transmitted"}  # attributes of a Sample
ROUND_OFF = 1e-14  # of rotations


class ForceTorque(NoisySensor):
    """Force-torque sensor in a joint, such as a fixed joint between hand and arm."""

    parts = (*("tx [N m]", "ty [N m]", "tz [N m]"), *("fx [N]", "fy [N]", "fz [N]"))
    type: Literal["force_torque"] = Field("force_torque", description="force_torque")
    joint: Text = Field(description="name of the joint")
    frame: Frame | None = Field(
        None,
        description="sensor frame in the child: the axes, and the origin that the torque is about; default: "
        "the joint frame of the child",
    )
    acts_on: Literal["child", "parent"] = Field(
        "child", description="child: the wrench on the child; parent: the opposite one, on the parent"
    )
    measures: Literal["reaction", "transmitted"] = Field(
        "reaction",
        description="reaction: the wrench of the joint's constraints alone; transmitted: with springs, motors, "
        "servos and commanded efforts at the joint, as a sensor next to a drive measures",
    )
    torque_noise: NotNegative = Field(0.0, description="standard deviation of each torque in N m")
    force_noise: NotNegative = Field(0.0, description="standard deviation of each force in N")

    @property
    def noise(self):
        """Standard deviations."""
        return np.repeat([self.torque_noise, self.force_noise], 3)

    def measure(self, sample):
        """(6,) torque and force of the joint in the frame of the sensor; NaN where undetermined."""
        wrench = getattr(sample, MEASURED[self.measures])[self.joint]
        if self.frame is not None:
            wrench = _moved(wrench, SE3.inverse(self.frame.pose) @ sample.child_frames[self.joint])
        return wrench if self.acts_on == "child" else -wrench


def _moved(wrench, between):
    """Wrench (6,) in another frame; between: (4, 4) pose of the old frame in the new one. NaN propagates."""
    R, p = between[:3, :3], between[:3, 3]
    to = np.zeros((6, 6))
    to[:3, :3] = to[3:, 3:] = R
    to[:3, 3:] = SO3.hat(p) @ R
    unknown = np.isnan(wrench)
    found = to @ np.where(unknown, 0.0, wrench)
    found[(np.abs(to) > ROUND_OFF)[:, unknown].any(axis=1)] = np.nan
    return found
