# SPDX-License-Identifier: Apache-2.0
"""Rotations and rigid-body motions: kernels on tuples (so3, se3) and matrices (SO3, SE3)."""

from .groups import SE3, SO3

__all__ = ["SE3", "SO3"]
