# SPDX-License-Identifier: Apache-2.0
"""Differential drive of a mobile robot: speeds of its wheels for a wanted forward and turning speed.

With radius r and track b of the wheels, a forward speed v and a turning speed w need

    rate of the left wheels (v - w b / 2) / r ,   of the right wheels (v + w b / 2) / r

about axes to the left. Radius, track and the directions of the axes are those of the scene at the start.
"""

from typing import Annotated, Literal, NamedTuple

import numpy as np
from pydantic import BeforeValidator, Field, WithJsonSchema

from liegroup_core.errors import SceneError
from liegroup_core.fields.values import Described, Positive, Text, listed, suggestion


def _names(value):
    return listed([value] if isinstance(value, str) else value)


Joints = Annotated[
    tuple[Text, ...],
    BeforeValidator(_names),
    WithJsonSchema({"anyOf": [{"type": "string"}, {"type": "array", "items": {"type": "string"}}]}),
]


class Drive(Described):
    """Drive of a scene, which the node commands by ~/cmd_vel."""

    type: Literal["differential"] = Field("differential", description="differential: wheels on both sides")
    left: Joints = Field(description="revolute joint, or list of them, of the wheels on the left")
    right: Joints = Field(description="the same on the right")
    radius: Positive | None = Field(
        None, description="radius of the wheels in m; default: that of the joints of type wheel of their children"
    )


class Wheels(NamedTuple):
    """Wheels of a drive: {joint: (rate for a forward speed of 1 m/s, for a turning speed of 1 rad/s)}, in rad."""

    rates: dict

    def at(self, forward, turning):
        """{joint: rate} for a forward speed in m/s and a turning speed in rad/s."""
        return {joint: forward * ahead + turning * around for joint, (ahead, around) in self.rates.items()}


def check_drive(scene):
    """Raise SceneError for a drive whose joints are unknown, not revolute, or neither driven nor with a servo."""
    drive = scene.drive
    if drive is None:
        return
    joints = {joint.name: joint for joint in scene.joints}
    servos = {force.joint for force in scene.forces if force.type == "servo"}
    rolling = {joint.child for joint in scene.joints if joint.type == "wheel"}
    for side in ("left", "right"):
        if not getattr(drive, side):
            raise SceneError(f"drive: {side} has no joint", place=("drive", side))
        for name in getattr(drive, side):
            if name not in joints:
                hint = suggestion(name, list(joints))
                raise SceneError(f'drive: {side}: unknown joint "{name}"; {hint}', ("drive", side))
            joint, text = joints[name], ""
            if joint.type != "revolute":
                text = f"is a {joint.type} joint, not revolute"
            elif not (joint.driven or name in servos):
                text = "is neither driven nor has a servo"
            elif drive.radius is None and joint.child not in rolling:
                text = "has no wheel that rolls as its child: give the radius"
            if text:
                raise SceneError(f'drive: joint "{name}" {text}', place=("drive", side))
    if set(drive.left) & set(drive.right):
        raise SceneError("drive: a joint is on both sides", place=("drive", "right"))


def wheels_of(scene, frames):
    """Wheels of the drive of a scene; frames: (parent frame, child frame), (4, 4) each, of its joints."""
    drive = scene.drive
    poses = {body.name: body.pose for body in scene.bodies}
    radii = {joint.child: joint.radius for joint in scene.joints if joint.type == "wheel"}
    places, axes, sizes = {}, {}, {}
    for joint, (_, F_b) in zip(scene.joints, frames):
        if joint.name in (*drive.left, *drive.right):
            pose = poses[joint.child] @ F_b
            places[joint.name], axes[joint.name] = pose[:3, 3], pose[:3, 2]
            sizes[joint.name] = radii[joint.child] if drive.radius is None else drive.radius
    middles = [np.mean([places[name] for name in side], axis=0) for side in (drive.left, drive.right)]
    across = middles[0] - middles[1]
    track = np.linalg.norm(across)
    if not track > 0.0:
        raise SceneError("drive: the wheels on both sides have the same place", place=("drive", "left"))
    rates = {}
    for side, names in ((-1.0, drive.left), (1.0, drive.right)):
        for name in names:
            direction = float(np.sign(axes[name] @ across)) or 1.0
            rates[name] = direction / sizes[name], side * direction * 0.5 * float(track) / sizes[name]
    return Wheels(rates)
