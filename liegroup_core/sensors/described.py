# SPDX-License-Identifier: Apache-2.0
"""What a scene says of every sensor: the base of the classes of all kinds, and their noise."""

import zlib
from typing import Annotated, ClassVar

import numpy as np
from pydantic import BeforeValidator, Field

from liegroup_core.fields.values import Described, Name


def _seed(value):
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < 2**32:
        raise ValueError(f"must be a whole number from 0 to {2**32 - 1}")
    return value


Seed = Annotated[int, BeforeValidator(_seed)]


class Sensor(Described):
    """Sensor of a scene, at a body, at a joint or between two bodies.

    A subclass has `measure(sample)`: its numbers without noise, of the length of `parts`, their names
    and units.

    needs_coordinate : True: its joint has one angle or displacement
    """

    parts: ClassVar = ()
    needs_coordinate: ClassVar = False
    name: Name = Field(description="name, unique among all bodies, joints, forces and sensors")
    type: str

    def read(self, sample):
        """Numbers of a Sample."""
        return self.measure(sample)


class NoisySensor(Sensor):
    """Sensor with noise. A subclass has `noise`, the standard deviations of its numbers, 0 without noise."""

    seed: Seed = Field(0, description="of the noise, a whole number")

    def read(self, sample):
        """Numbers with noise: white, of the same values at the same step in every run.

        It is drawn from a counter (Philox) with the seed and the sensor's name as key and the step
        as position, so that it needs no memory and a run is repeated bit for bit from any step.
        """
        values, noise = self.measure(sample), self.noise
        if noise.any():
            key = [self.seed, zlib.crc32(self.name.encode())]
            bits = np.random.Philox(key=key, counter=[0, 0, 0, sample.steps])
            values = values + noise * np.random.Generator(bits).standard_normal(len(noise))
        return values


def frame_pose(frame):
    """(R (3, 3), p (3,) m) of a Frame in its body; the body frame if it is None."""
    pose = np.eye(4) if frame is None else frame.pose
    return pose[:3, :3], pose[:3, 3]
