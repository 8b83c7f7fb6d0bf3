# SPDX-License-Identifier: Apache-2.0
"""Homogeneous solids: mass, centre of mass and inertia of a body from its dimensions.

With the mass m, about the centre and in the axes of the solid:
    box       m/12 (y^2 + z^2, z^2 + x^2, x^2 + y^2)         edges x, y, z
    cylinder  m/12 (3 r^2 + l^2, 3 r^2 + l^2, 6 r^2)         radius r, length l along z
    sphere    2/5 m r^2
    capsule   a cylinder, and half a sphere of the same density at both ends: 2/5 m r^2 + m l (l/4 + 3 r/8) across
A rod is a thin cylinder. Tested against integration over the volume (test/core/test_shapes.py).
"""

import math
from typing import Literal

import numpy as np
from pydantic import Field, model_validator

from liegroup_core.errors import SceneError
from liegroup_core.fields.frames import Placed
from liegroup_core.fields.values import (
    LARGEST_NUMBER,
    Direction,
    Positive,
    Quaternion,
    RotationVector,
    Sizes,
    Vector3,
    real_inertia,
)

# Default radius of a rod in rod lengths: its axial inertia is 6e-6 of the transverse one.
THIN = 1e-3


class _Solid(Placed):
    """Common part of all solids: pose in the body frame, and mass or density."""

    position: Vector3 = Field((0.0, 0.0, 0.0), description="centre of the solid in m, in the body frame")
    quaternion: Quaternion | None = Field(
        None,
        description="rotation from axes of the solid to body axes as unit quaternion x, y, z, w; default: no rotation",
    )
    rotation_vector: RotationVector | None = Field(
        None, description="the same rotation as rotation vector in rad; replaces quaternion"
    )
    axis: Direction | None = Field(
        None,
        description="direction of the solid's z axis in body axes, a vector of any length; replaces "
        "quaternion; the rotation is the smallest one from z to this direction",
    )
    mass: Positive | None = Field(None, description="mass in kg, greater than 0; give either mass or density")
    density: Positive | None = Field(None, description="density in kg/m^3, greater than 0; replaces mass")

    @model_validator(mode="after")
    def _check(self):
        if (self.mass is None) == (self.density is None):
            raise SceneError(
                "mass is missing: give mass or density"
                if self.mass is None
                else "mass and density both define the mass: keep one of them",
                place=("mass",) if self.mass else None,
            )
        return self

    @property
    def body(self):
        """{"mass", "com", "inertia"} of a body of this shape, as in a scene file.

        Raises SceneError if mass or inertia is out of range.
        """
        with np.errstate(over="ignore", invalid="ignore"):
            mass = self.density * self.volume if self.mass is None else self.mass
            R = self.rotation
            inertia = mass * (R @ np.diag(self.moments) @ R.T)
        moments = inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]].tolist()
        if not 0.0 < mass <= LARGEST_NUMBER or not np.abs(moments).max() <= LARGEST_NUMBER:
            raise SceneError(f"its mass of {mass:.3g} kg or its inertia is out of range: check sizes and density")
        try:
            real_inertia(moments)
        except ValueError as error:
            raise SceneError(f"its inertia {error}") from None
        return {"mass": mass, "com": self.position, "inertia": tuple(moments)}


class Box(_Solid):
    """Solid box."""

    type: Literal["box"] = Field("box", description="box")
    size: Sizes = Field(description="lengths of the edges in m, [x, y, z] in axes of the solid")

    @property
    def volume(self):
        """Volume in m^3."""
        return math.prod(self.size)

    @property
    def moments(self):
        """(3,) principal moments of the unit mass in m^2, axes of the solid."""
        x, y, z = np.square(self.size)
        return np.array([y + z, z + x, x + y]) / 12.0


class _Round(_Solid):
    """Solid of revolution about its z axis."""

    length: Positive = Field(description="length along z in m, greater than 0")

    @property
    def volume(self):
        """Volume in m^3."""
        return math.pi * self.radius**2 * self.length

    @property
    def moments(self):
        """(3,) principal moments of the unit mass in m^2, axes of the solid."""
        across = (3.0 * self.radius**2 + self.length**2) / 12.0
        return np.array([across, across, 0.5 * self.radius**2])


class Cylinder(_Round):
    """Solid cylinder along its z axis."""

    type: Literal["cylinder"] = Field("cylinder", description="cylinder")
    radius: Positive = Field(description="radius in m, greater than 0")


class Rod(_Round):
    """Thin cylinder along its z axis; its radius has little influence."""

    type: Literal["rod"] = Field("rod", description="rod")
    radius: Positive | None = Field(
        None, description="radius in m, greater than 0; default: a thousandth of the length"
    )

    @model_validator(mode="after")
    def _thin(self):
        if self.radius is None:
            if self.density is not None:
                raise SceneError("radius is missing: give a radius, or mass instead of density", place=("density",))
            self.__dict__["radius"] = THIN * self.length
        return self


class Sphere(_Solid):
    """Solid sphere."""

    type: Literal["sphere"] = Field("sphere", description="sphere")
    radius: Positive = Field(description="radius in m, greater than 0")

    @property
    def volume(self):
        """Volume in m^3."""
        return 4.0 / 3.0 * math.pi * self.radius**3

    @property
    def moments(self):
        """(3,) principal moments of the unit mass in m^2, axes of the solid."""
        return np.full(3, 0.4 * self.radius**2)


class Capsule(_Round):
    """Solid cylinder along its z axis with half a sphere at both ends."""

    type: Literal["capsule"] = Field("capsule", description="capsule")
    radius: Positive = Field(description="radius in m, greater than 0")
    length: Positive = Field(description="length along z in m without the half spheres, greater than 0")

    @property
    def volume(self):
        """Volume in m^3."""
        return math.pi * self.radius**2 * (self.length + 4.0 / 3.0 * self.radius)

    @property
    def moments(self):
        """(3,) principal moments of the unit mass in m^2, axes of the solid."""
        radius, length = self.radius, self.length
        part = length / (length + 4.0 / 3.0 * radius)  # of the cylinder
        ends = 0.4 * radius**2 + length * np.array([length / 4.0 + 0.375 * radius] * 2 + [0.0])
        return part * super().moments + (1.0 - part) * ends


SHAPES = (Box, Capsule, Cylinder, Rod, Sphere)
