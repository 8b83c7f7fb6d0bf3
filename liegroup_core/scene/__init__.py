# SPDX-License-Identifier: Apache-2.0
"""Scenes: checked models of what a user describes in a file or in code.

Input: YAML text or Python values. Output: a frozen Scene, or one SceneError with file and line. A scene
contains no arrays of the solver.
"""

from . import description
from .consistency import check_consistency, resolve_elements, resolve_frames
from .description import *  # noqa: F403 (Scene, Body, and the classes of all joints and forces)
from .load import find_scene, load_scene, scene_from_text

__all__ = ["check_consistency", "find_scene", "load_scene", "resolve_elements", "resolve_frames", "scene_from_text"]
__all__ += description.__all__
