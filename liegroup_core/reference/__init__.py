# SPDX-License-Identifier: Apache-2.0
"""Reference solutions: an independent integration with tight tolerances.

elliptic.py has the exact rotations of a free body and of a symmetric heavy top; it needs mpmath.
"""

from .trajectory import Distance, JointChange, PullSpan, Reference, Trajectory, WrenchSpan, distance, integrate

__all__ = ["Distance", "JointChange", "PullSpan", "Reference", "Trajectory", "WrenchSpan", "distance", "integrate"]
