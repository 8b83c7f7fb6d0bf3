# SPDX-License-Identifier: Apache-2.0
"""Types of the values in a scene: numbers, vectors, names, rotations, frames, and their checks.

Input: values from YAML or from a user's code. Output: checked values, or one SceneError. This package
does not depend on joints, forces or scenes.
"""
