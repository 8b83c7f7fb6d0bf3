# SPDX-License-Identifier: Apache-2.0
"""Inertia that momentum methods add about the long axis of a slender body.

Methods that conserve the angular momentum rotate a free rod about its long axis as if its moment of inertia were

    I_1 + (h w)^2 I_3 / 12

with w the rate about the other axes, and 8 instead of 12 for `lie_midpoint` (measured to 1e-3,
test/verification/test_added_inertia.py). If that is far above I_1, the rod hardly rotates at any step size. The
same holds for compositions of `constrained_rattle`.
"""

import numpy as np

ROUND_OFF = 1e-14  # relative to the largest moment of inertia: smaller ones count as zero
SLENDER = 100.0  # ratio of moments of inertia
SHARES = {"lie_midpoint": 8.0, "constrained": 12.0}  # of a method or family, see above


class AddedInertia:
    """Long axes and slenderness of the bodies of a model.

    shares : (n,) added inertia over I_1, divided by (h w)^2; 0 for bodies without inertia about an axis
    axes   : (n, 3) long axes
    """

    def __init__(self, shares, axes):
        self.shares, self.axes = shares, axes

    @classmethod
    def of(cls, method, model):
        """AddedInertia of the bodies of a model, or None if the method adds none or no body is slender."""
        share = SHARES.get(method.name) or SHARES.get(method.family)
        moments, vectors = np.linalg.eigh(model.bodies["inertia"].reshape(-1, 3, 3))
        least, largest = moments[:, 0], moments[:, 2]
        has = least > ROUND_OFF * largest
        ratios = np.where(has, largest / np.where(has, least, 1.0), 0.0)
        if share is None or ratios.max() < SLENDER:
            return None
        return cls(ratios / share, vectors[:, :, 0])

    def wrong_turn(self, twist, step, steps):
        """Largest rotation about a long axis in `steps` steps, rad, among bodies whose I_1 is more than doubled."""
        rate = twist[:, :3]
        along = np.abs(np.sum(self.axes * rate, axis=1))
        across = np.sum(rate * rate, axis=1) - along * along
        wrong = step * step * across * self.shares > 1.0
        return step * steps * float(np.max(along, where=wrong, initial=0.0))
