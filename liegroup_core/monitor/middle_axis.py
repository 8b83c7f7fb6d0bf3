# SPDX-License-Identifier: Apache-2.0
"""Watch over free bodies that turn next to their middle axis of inertia, which is unstable.

How near a free body comes to that axis is decided by the difference of two invariants,
    d = 2 T I_2 - |L|^2 = Q_1 - Q_3 ,  Q_1 = I_1 (I_2 - I_1) w_1^2 ,  Q_3 = I_3 (I_3 - I_2) w_3^2 ,
and where it is near, Q_1 + Q_3 is small. So an error of d that is none of the motion now is one of
the part error / (Q_1 + Q_3) when the body comes back to the axis, and keeps this part while the
body leaves it again, at the rate Omega sqrt((I_2 - I_1) (I_3 - I_2) / (I_1 I_3)) at the most. A
method that keeps the momentum and lets the energy drift makes it too.
"""

import math

import numpy as np

from liegroup_core.joints.elements import WORLD

# A body is next to the axis where what turns across it is below this part of its turning; it has
# left it where this has grown by so much, as it only does next to an unstable one.
NEAR, LEFT = 0.05, math.e
TINY = 1e-300  # above zero
ROUNDING = 1e-14  # of d, as a part of |L|^2: 2^-53 and the sums of a body's tensor


class MiddleAxis:
    """Watch over the bodies of a layout on which nothing acts but gravity."""

    def __init__(self, layout, step):
        self._step = step
        bodies = layout.model.bodies
        held = {
            int(element[end]) for element in layout.model.elements for end in ("parent", "child")
        } - {WORLD}
        named = {
            getattr(force, key, None)
            for force in layout.scene.forces
            for key in ("parent", "child", "body")
        }
        free = [
            i for i, name in enumerate(layout.body_names) if i not in held and name not in named
        ]
        moments, axes = np.linalg.eigh(bodies["inertia"][free].reshape(-1, 3, 3))
        one, two, three = moments.T
        rate = np.sqrt(np.maximum((two - one) * (three - two), 0.0) / (one * three))
        unstable = rate > 0.0
        self._rows = np.array(free, dtype=int)[unstable]
        self._axes, self._rate = axes[unstable], rate[unstable]
        # By squares of w: d, Q_1 + Q_3, rounding of d, Omega^2, and what of that is across.
        zero, whole = np.zeros_like(two), np.ones_like(two)
        weights = np.array([one * (two - one), zero, three * (two - three)])
        self._sums = np.array(
            [
                weights,
                np.abs(weights),
                ROUNDING * moments.T**2,
                [whole, whole, whole],
                [whole, zero, whole],
            ]
        ).T[unstable]
        self.restart()

    def restart(self):
        """Another state: what was before does not count."""
        self._first = None

    def look(self, twist):
        """How wrong bodies may be that have left the axis again, rad, at the end of a step.

        twist (n, 6)
        """
        if not len(self._rows):
            return 0.0
        square = (twist[self._rows, None, :3] @ self._axes)[:, 0] ** 2
        sums = (square[:, None] @ self._sums)[:, 0]
        d, self._size, rounding, self._square, self._across = sums.T
        if self._first is None:
            self._first, self._part = d, np.zeros(len(d))
            self._least = np.full(len(d), math.inf)
        self._floor = np.abs(d)
        self._drift = np.abs(d - self._first) - rounding
        near = self._across < NEAR**2 * self._square
        if not (near.any() or self._part.any()):
            return 0.0
        sine = self._sine()
        self._least = np.where(near, np.minimum(self._least, sine), self._least)
        part = np.clip(_over(self._drift, self._size), 0.0, 1.0)
        self._part = np.where(near, np.maximum(self._part, part), self._part)
        left = sine > LEFT * self._least
        return float((self._part * sine * left).max(initial=0.0))

    def _sine(self):
        """Of the angle between the axis a body turns about and the middle one."""
        return np.sqrt(_over(self._across, self._square))

    def steps_to(self, limit):
        """Steps after which the next `look` may say so much, at the earliest: inf, or more than 0."""
        if not len(self._rows):
            return math.inf
        # It comes near no more than its own d lets it: an error far below that is none.
        may = self._drift > limit * self._floor
        if not may.any():
            return math.inf
        drift, size, part, sine, rate = (
            each[may]
            for each in (
                self._drift,
                self._size,
                self._part,
                self._sine(),
                self._rate * np.sqrt(self._square) * self._step,
            )
        )
        nears = np.log(np.maximum(np.maximum(np.sqrt(limit * size / drift), sine / NEAR), TINY))
        grows = np.log(limit / np.maximum(part * sine, TINY))
        steps = np.where(part < limit, nears, grows) / rate
        return float(steps[steps > 0.0].min(initial=math.inf))


def _over(one, other):
    """Quotients; 0 where the divisor is."""
    return np.divide(one, other, out=np.zeros_like(one), where=other > 0.0)
