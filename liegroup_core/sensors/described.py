# SPDX-License-Identifier: Apache-2.0
"""Keys that all sensors of a scene share, and their noise: the base of all sensor classes."""

import zlib
from functools import lru_cache
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

    A subclass has `parts`, names and units of its numbers, and `measure(sample)`, the numbers without
    noise.

    needs_coordinate : True if its joint must have exactly one angle or displacement
    """

    parts: ClassVar = ()
    needs_coordinate: ClassVar = False
    name: Name = Field(description="name, unique among all bodies, joints, forces and sensors")
    type: str

    def read(self, sample):
        """Measured numbers at a Sample."""
        return self.measure(sample)


class NoisySensor(Sensor):
    """Sensor with noise. A subclass has `noise`, the standard deviations of its numbers, 0 without noise."""

    seed: Seed = Field(0, description="seed of the noise, a whole number")

    def read(self, sample):
        """Measured numbers with white noise, which is the same at the same time in every run.

        The noise is sampled from a counter-based generator (Philox). Its key is the seed and the sensor's
        name, its counter the time in ns. So it has no state, and a run is bit-identical from any step on.
        """
        return self.measure(sample) + self.noise_at(sample.time_ns)

    def noise_at(self, time_ns):
        """Noise of all numbers at a time in ns."""
        noise = self.noise
        if not noise.any():
            return np.zeros(len(noise))
        key = [self.seed, zlib.crc32(self.name.encode())]
        bits = np.random.Philox(key=key, counter=[0, 0, 0, time_ns])
        return noise * np.random.Generator(bits).standard_normal(len(noise))


@lru_cache(maxsize=1024)
def frame_pose(frame):
    """(R (3, 3), p (3,) m) of a Frame in its body; the body frame if it is None."""
    pose = np.eye(4) if frame is None else frame.pose
    pose.setflags(write=False)
    return pose[:3, :3], pose[:3, 3]
