# SPDX-License-Identifier: Apache-2.0
"""Distance between two points of bodies and its rate: a draw-wire sensor or a laser."""

from typing import Literal

import numpy as np
from pydantic import Field

from liegroup_core.fields.values import NotNegative, Text, Vector3
from liegroup_core.lie.groups import cross

from .described import NoisySensor


class DistanceSensor(NoisySensor):
    """Distance between a point of one body, or the world, and a point of another."""

    parts = ("distance [m]", "rate [m/s]")
    type: Literal["distance"] = Field("distance", description="distance")
    parent: Text = Field(description="name of a body, or world")
    child: Text = Field(description="name of a body")
    parent_point: Vector3 = Field((0.0, 0.0, 0.0), description="point in m, frame of the parent")
    child_point: Vector3 = Field((0.0, 0.0, 0.0), description="point in m, frame of the child")
    distance_noise: NotNegative = Field(0.0, description="standard deviation in m")

    @property
    def noise(self):
        """Standard deviations; the rate has none."""
        return np.array([self.distance_noise, 0.0])

    def measure(self, sample):
        """(2,) distance and its rate; the rate is NaN where the points coincide."""
        (a, va), (b, vb) = (
            _point(sample, name, np.array(place))
            for name, place in ((self.parent, self.parent_point), (self.child, self.child_point))
        )
        length = float(np.linalg.norm(b - a))
        rate = (b - a) @ (vb - va) / length if length > 0.0 else np.nan
        return np.array([length, rate])


def _point(sample, body, place):
    """Position and velocity (3,) of a point in the world."""
    if body == "world":
        return place, np.zeros(3)
    pose, (w, v) = sample.poses[body], np.split(sample.twists[body], 2)
    return pose[:3, :3] @ place + pose[:3, 3], pose[:3, :3] @ (v + cross(w, place))
