# SPDX-License-Identifier: Apache-2.0
"""An independent, tight integration of a scene: what recordings and methods are judged against."""
from .trajectory import Distance, Trajectory, WrenchChange, distance, integrate

__all__ = ["Distance", "Trajectory", "WrenchChange", "distance", "integrate"]
