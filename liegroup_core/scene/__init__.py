# SPDX-License-Identifier: Apache-2.0
"""Scenes: what a user says there is, from a file or from code, checked."""

from .consistency import check_consistency, resolve_frames
from .description import WORLD, Body, Frame, Joint, Scene
from .forces import (ConstantWrench, Drag, LinearMotor, LinearSpringDamper, Motor, SpringDamper,
                     TorsionalSpringDamper)
from .load import find_scene, load_scene, scene_from_text

__all__ = ["WORLD", "Body", "ConstantWrench", "Drag", "Frame", "Joint", "LinearMotor",
           "LinearSpringDamper", "Motor", "Scene", "SpringDamper", "TorsionalSpringDamper",
           "check_consistency", "find_scene", "load_scene", "resolve_frames", "scene_from_text"]
