# SPDX-License-Identifier: Apache-2.0
"""Inertial measurement unit: orientation, angular velocity and specific force of a frame of a body.

An accelerometer measures the specific force: the acceleration of the frame's origin minus gravity, in
the axes of the frame. Some drivers remove gravity again: what is left is that acceleration. Angular
velocity and specific force have a constant bias.
"""

from typing import Literal

import numpy as np
from pydantic import Field

from liegroup_core.fields.frames import Frame
from liegroup_core.fields.values import Flag, NotNegative, Text, Vector3
from liegroup_core.lie.groups import SO3, cross

from .described import NoisySensor, frame_pose


class Imu(NoisySensor):
    """Inertial measurement unit on a body."""

    parts = (
        *("qx", "qy", "qz", "qw"),
        *("wx [rad/s]", "wy [rad/s]", "wz [rad/s]"),
        *("ax [m/s^2]", "ay [m/s^2]", "az [m/s^2]"),
    )
    type: Literal["imu"] = Field("imu", description="imu")
    body: Text = Field(description="name of the body")
    frame: Frame | None = Field(None, description="sensor frame in the body; default: the body frame")
    angular_velocity_noise: NotNegative = Field(0.0, description="standard deviation of each angular velocity in rad/s")
    acceleration_noise: NotNegative = Field(0.0, description="standard deviation of each specific force in m/s^2")
    angular_velocity_bias: Vector3 = Field((0.0, 0.0, 0.0), description="bias in rad/s")
    remove_gravity: Flag = Field(
        False, description="true: accelerations, of a driver that removes gravity; false: specific forces"
    )
    acceleration_bias: Vector3 = Field((0.0, 0.0, 0.0), description="bias in m/s^2")

    @property
    def noise(self):
        """Standard deviations; the orientation has none."""
        return np.repeat([0.0, self.angular_velocity_noise, self.acceleration_noise], [4, 3, 3])

    def measure(self, sample):
        """(10,) quaternion x y z w to the world, angular velocity, specific force."""
        R, p = frame_pose(self.frame)
        body = sample.poses[self.body][:3, :3]
        w = sample.twists[self.body][:3]
        turning, moving = np.split(sample.accelerations[self.body], 2)
        force = moving + cross(turning, p) + cross(w, cross(w, p))
        if not self.remove_gravity:
            force -= body.T @ np.array(sample.scene.gravity)
        return np.concatenate(
            [SO3.to_quaternion(body @ R), R.T @ w + self.angular_velocity_bias, R.T @ force + self.acceleration_bias]
        )
