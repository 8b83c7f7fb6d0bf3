# SPDX-License-Identifier: Apache-2.0
"""What acts on a mechanism at one time: one value for all that asks for it."""

from typing import NamedTuple

import numpy as np


class Acting(NamedTuple):
    """Inputs that act.

    external : (n, COLUMNS) external wrenches, see external.py
    targets  : (k, 2) target positions and velocities of the servos, rad and rad/s, or m and m/s
    motions  : (d, 7) motions of the driven joints, see joints/motion.py
    """

    external: np.ndarray
    targets: np.ndarray
    motions: np.ndarray

    def copy(self):
        """The same numbers in arrays of its own."""
        return Acting(self.external.copy(), self.targets.copy(), self.motions.copy())

    def set(self, other):
        """Take over the numbers of another one."""
        for mine, part in zip(self, other):
            mine[...] = part

    def is_same(self, other):
        """Whether another one has the same numbers."""
        return all(map(np.array_equal, self, other))
