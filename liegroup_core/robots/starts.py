# SPDX-License-Identifier: Apache-2.0
"""Starts of floating links and of joints with several coordinates, as users give them."""

import numpy as np
from pydantic import Field

from liegroup_core.fields.frames import Placed
from liegroup_core.fields.values import Quaternion, RotationVector, Vector3


class Start(Placed):
    """Start of a floating link in the world, or of a joint with several coordinates: child frame in parent frame."""

    position: Vector3 = Field(
        (0.0, 0.0, 0.0), description="origin in m; keys that are not given keep the value of the file or the pose"
    )
    quaternion: Quaternion | None = Field(None, description="rotation as unit quaternion x, y, z, w")
    rotation_vector: RotationVector | None = Field(
        None, description="rotation as rotation vector in rad; replaces quaternion"
    )
    angular_velocity: Vector3 = Field(
        (0.0, 0.0, 0.0), description="angular velocity in rad/s, axes of the link or of the child frame"
    )
    linear_velocity: Vector3 = Field((0.0, 0.0, 0.0), description="velocity of the origin in m/s, in the same axes")

    def over(self, pose, twist):
        """(pose (4, 4), twist (6,)) with the given keys in place of theirs."""
        pose, twist = pose.copy(), twist.copy()
        given = self.model_fields_set
        if "position" in given:
            pose[:3, 3] = self.position
        if given & {"quaternion", "rotation_vector"}:
            pose[:3, :3] = self.rotation
        for key, part in (("angular_velocity", slice(0, 3)), ("linear_velocity", slice(3, 6))):
            if key in given:
                twist[part] = getattr(self, key)
        return pose, twist


# {type of a joint with several coordinates: function of R, p, omega, v of the child's frame in the parent's ->
# numbers that are 0 in the motions that the type allows}
FORBIDDEN = {
    "spherical": lambda R, p, w, v: [*p, *v],
    "universal": lambda R, p, w, v: [*p, R[0, 1], *v, np.cross(R[0], (0.0, 1.0, 0.0)) @ w],
    "cylindrical": lambda R, p, w, v: [*p[:2], *R[2, :2], *w[:2], *v[:2]],
    "planar": lambda R, p, w, v: [p[2], *R[2, :2], *w[:2], v[2]],
}
