# SPDX-License-Identifier: Apache-2.0
"""Scenes: what a user says there is, from a file or from code, checked."""

from .consistency import check_consistency, resolve_elements, resolve_frames
from .description import WORLD, Body, DistanceJoint, Frame, Joint, Scene, ScrewJoint
from .forces import (
    ConstantWrench,
    Drag,
    LinearMotor,
    LinearSpringDamper,
    Motor,
    SpringDamper,
    TorsionalSpringDamper,
)
from .load import find_scene, load_scene, scene_from_text

__all__ = [
    "WORLD",
    "Body",
    "ConstantWrench",
    "DistanceJoint",
    "Drag",
    "Frame",
    "Joint",
    "LinearMotor",
    "LinearSpringDamper",
    "Motor",
    "Scene",
    "ScrewJoint",
    "SpringDamper",
    "TorsionalSpringDamper",
    "check_consistency",
    "find_scene",
    "load_scene",
    "resolve_elements",
    "resolve_frames",
    "scene_from_text",
]
