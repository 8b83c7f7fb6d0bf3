# SPDX-License-Identifier: Apache-2.0
"""Reference solutions: exact motions, and an independent, tight integration of a scene.

Exact rotations of a free body and of a symmetric heavy top are in elliptic.py, for which mpmath is
needed.
"""

from .trajectory import Distance, Reference, Trajectory, WrenchChange, distance, integrate

__all__ = ["Distance", "Reference", "Trajectory", "WrenchChange", "distance", "integrate"]
