# SPDX-License-Identifier: Apache-2.0
"""Encoder of a joint with one angle or displacement, with a resolution."""

from typing import Literal

import numpy as np
from pydantic import Field

from liegroup_core.fields.values import Positive, Text

from .described import Sensor


class Encoder(Sensor):
    """Encoder of a joint."""

    parts = ("position [rad or m]",)
    needs_coordinate = True
    type: Literal["encoder"] = Field("encoder", description="encoder")
    joint: Text = Field(description="name of a joint with one angle or displacement")
    resolution: Positive | None = Field(None, description="resolution in rad or m, with a step at 0; default: exact")

    def measure(self, sample):
        """(1,) rad or m, rounded down to a multiple of the resolution."""
        position, _ = sample.joint_coordinates[self.joint]
        if self.resolution is not None:
            position = self.resolution * np.floor(position / self.resolution)
        return np.array([position])
