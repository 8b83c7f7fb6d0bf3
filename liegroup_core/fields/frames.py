# SPDX-License-Identifier: Apache-2.0
"""Frames: position and rotation of a frame relative to another one."""

import math

import numpy as np
from pydantic import Field, model_validator

from liegroup_core.errors import SceneError
from liegroup_core.lie.groups import SO3

from .values import Described, Direction, Quaternion, RotationVector, Vector3

# Keys for a rotation; at most one of them may be given.
ROTATIONS = ("quaternion", "rotation_vector", "axis")


def rotation_z_to(axis):
    """Smallest rotation R with R (0, 0, 1) = axis; for axis = -z, the rotation by pi about y.

    axis : (3,) unit vector
    returns (3, 3)

    Uses the unit vector u of the axis' horizontal part instead of the usual 1 / (1 + z), which is
    singular at axis = -z. The result is orthogonal to machine precision
    (`test_rotation_z_to_is_a_rotation_to_round_off`).
    """
    x, y, z = (float(component) for component in axis)
    horizontal = math.hypot(x, y)
    u_x, u_y = (x / horizontal, y / horizontal) if horizontal > 0.0 else (1.0, 0.0)
    bend = 1.0 - z
    return np.array(
        [[1.0 - bend * u_x * u_x, -bend * u_x * u_y, x], [-bend * u_x * u_y, 1.0 - bend * u_y * u_y, y], [-x, -y, z]]
    )


class Placed(Described):
    """Base of models with a position and at most one rotation."""

    @model_validator(mode="after")
    def _one_rotation(self):
        given = [key for key in ROTATIONS if getattr(self, key, None) is not None]
        if len(given) > 1:
            raise SceneError(f"{' and '.join(given)} both define the rotation: keep one of them", place=(given[1],))
        return self

    @property
    def rotation(self):
        """(3, 3) rotation matrix."""
        if self.rotation_vector is not None:
            return SO3.exp(self.rotation_vector)
        if self.quaternion is not None:
            return SO3.from_quaternion(self.quaternion)
        axis = getattr(self, "axis", None)
        return np.eye(3) if axis is None else rotation_z_to(np.array(axis) / math.hypot(*axis))

    @property
    def pose(self):
        """(4, 4) homogeneous matrix of rotation and position, m."""
        pose = np.eye(4)
        pose[:3, :3] = self.rotation
        pose[:3, 3] = self.position
        return pose


class Frame(Placed):
    """Joint frame, relative to the body (or world) that it is fixed to."""

    position: Vector3 = Field((0.0, 0.0, 0.0), description="origin in m, in the frame to which it is fixed")
    quaternion: Quaternion | None = Field(
        None, description="rotation as unit quaternion x, y, z, w; default: no rotation"
    )
    rotation_vector: RotationVector | None = Field(
        None, description="rotation as rotation vector in rad; replaces quaternion"
    )
    axis: Direction | None = Field(
        None,
        description="direction of the joint axis, a vector of any length; replaces quaternion; the "
        "rotation is the smallest one from z to this direction",
    )
