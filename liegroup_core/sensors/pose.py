# SPDX-License-Identifier: Apache-2.0
"""Pose and twist of a frame fixed to a body, such as a tool or a marker of a tracker."""

from typing import Literal

import numpy as np
from pydantic import Field

from liegroup_core.fields.frames import Frame
from liegroup_core.fields.values import NotNegative, Text
from liegroup_core.lie.groups import SO3, cross

from .described import NoisySensor, frame_pose


class Pose(NoisySensor):
    """Pose and twist of a frame of a body."""

    parts = (
        *("x [m]", "y [m]", "z [m]"),
        *("qx", "qy", "qz", "qw"),
        *("vx [m/s]", "vy [m/s]", "vz [m/s]"),
        *("wx [rad/s]", "wy [rad/s]", "wz [rad/s]"),
    )
    type: Literal["pose"] = Field("pose", description="pose")
    body: Text = Field(description="name of the body")
    frame: Frame = Field(description="frame in the body")
    position_noise: NotNegative = Field(0.0, description="standard deviation of each coordinate of the position in m")

    @property
    def noise(self):
        """Standard deviations; only the position has noise."""
        return np.repeat([self.position_noise, 0.0], [3, 10])

    def measure(self, sample):
        """(13,) position and quaternion in the world, velocity and angular velocity in own axes."""
        R, p = frame_pose(self.frame)
        pose, (w, v) = sample.poses[self.body], np.split(sample.twists[self.body], 2)
        return np.concatenate(
            [pose[:3, :3] @ p + pose[:3, 3], SO3.to_quaternion(pose[:3, :3] @ R), R.T @ (v + cross(w, p)), R.T @ w]
        )
