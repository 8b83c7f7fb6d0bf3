# SPDX-License-Identifier: Apache-2.0
"""Types of the values in a scene: numbers, vectors, names, rotations, frames, and their checks.

In: what YAML or a user's code gives. Out: checked values, or one SceneError. A field knows no
joint, no force and no scene.
"""
