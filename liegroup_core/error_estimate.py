# SPDX-License-Identifier: Apache-2.0
"""Estimated errors of bodies, from their distances to the companion of a simulation (running_error.py).

The error of a method of order p follows from the distance d = |x_h - x_qh| of two states with steps h and
q h:

    order seen     : d / (q^p - 1), the errors being c h^p and c (q h)^p
    order not seen : about d, the two errors being independent of each other

The estimate is the larger of the two, the first one times SEEN, the second one a given fraction of d. They are
close to each other (a factor of 2 for p = 4, of 3 for p = 8), so no decision is needed. For q = 2 the factor
would be 15 and 255: a third run would have to tell whether the order is seen, and would often be wrong. The
estimate of a body is multiplied by up to 1 + LARGE, reached linearly at an error of NOT_SMALL relative to the
characteristic length. Two errors of that size do not follow the linearised motion, and their difference may be
a fraction of either by chance.

An estimate is at least FADING times the largest of the last checkpoints, because a distance may pass through
zero where the error does not. If it exceeds LOST times the body's motion so far at a checkpoint, it does not
fade at all. If both runs lose the motion, for example an oscillation that their steps do not resolve, they may
agree again, but not with the true motion.
"""

import math

import numpy as np

from .compiling import SameTypes, kernel

WINDOW, FADING = 4, 0.36  # checkpoints
LOST = 0.1  # of the motion of a body
SEEN = 1.35
LARGE, NOT_SMALL = 2.5, 0.03
# Relative to the characteristic length, or rad: an error of this size makes a motion unpredictable.
UNPREDICTABLE = 0.1


def scale_of(position, angle, factor):
    """Estimate divided by distance, for distances relative to the characteristic length and in rad."""
    return factor * (1.0 + LARGE * min(1.0, factor * max(position, angle) / NOT_SMALL))


_scale = kernel(scale_of)


@kernel
def _set_errors(distance, window, size, factor, least, out):
    """Estimates from the distances of all bodies (n, 4), those of the window, and at least `least`."""
    for i in range(len(distance)):
        for c in range(4):
            kept = 0.0
            for k in range(len(window)):
                kept = max(kept, window[k, i, c])
            out[i, c] = max(distance[i, c], FADING * kept)
        scale = _scale(out[i, 0] / size, out[i, 1], factor)
        for c in range(4):
            out[i, c] = max(scale * out[i, c], least[i, c])


@kernel
def _note_lost(distance, moved, motion, size, factor, least):
    """Raise `least` to the errors that are a large part of the motion so far; all (n, 4).

    returns the largest m and rad of `least`
    """
    position = angle = 0.0
    for i in range(len(distance)):
        scale = _scale(distance[i, 0] / size, distance[i, 1], factor)
        for c in range(4):
            motion[i, c] = max(motion[i, c], moved[i, c])
            error = scale * distance[i, c]
            if error > LOST * motion[i, c]:
                least[i, c] = max(least[i, c], error)
        position, angle = max(position, least[i, 0]), max(angle, least[i, 1])
    return position, angle


class ErrorEstimate:
    """Estimated errors of n bodies of a mechanism, and how long its motion is predictable.

    size  : characteristic length, m
    ratio : q, of the steps
    order : p
    least : ratio of estimate to distance if the order is not seen

    distance : (n, 4) m, rad, m/s, rad/s of the last checkpoint
    largest  : largest m and rad of them
    checkpoints       : number of checkpoints so far
    predictable_until : s, the last checkpoint before the estimate was UNPREDICTABLE; inf: never
    whole : whether all of a distance counts
    """

    KEPT = (
        *("distance", "largest", "checkpoints", "predictable_until", "_kept_at"),
        *("_window", "_largest_m", "_largest_rad", "_motion", "_least", "_least_pose", "whole"),
    )

    def __init__(self, n, size, ratio, order, least):
        self.size, self._part = size, max(least, SEEN / (ratio**order - 1.0))
        self.distance, self._window = np.zeros((n, 4)), np.zeros((WINDOW, n, 4))
        # The largest motion of each body, and least estimates.
        self._motion, self._least = np.zeros((n, 4)), np.zeros((n, 4))
        self._errors, self._lost = SameTypes(_set_errors), SameTypes(_note_lost)
        self.restart(0.0)
        self.errors(self.distance)  # compiles it
        self.note_motion(self.distance)

    @property
    def _factor(self):
        return 1.0 if self.whole else self._part

    def restart(self, time):
        """Clear the errors, because the state was set at a time in s."""
        self.distance[:] = self._window[:] = self._motion[:] = self._least[:] = 0.0
        self._least_pose, self.whole = 0.0, False
        # Largest m and rad of all bodies, of the distance and of each part of the window.
        self.largest, self._largest_m, self._largest_rad = ((0.0, 0.0), [0.0] * WINDOW, [0.0] * WINDOW)
        self.checkpoints, self.predictable_until, self._kept_at = 0, math.inf, time

    def set_infinite(self):
        """Set the distances of the present meeting to infinity."""
        self.distance[:] = np.inf
        self.largest = math.inf, math.inf

    def keep(self, time):
        """Store the distances of the present meeting, a checkpoint at a time in s."""
        part = self.checkpoints % WINDOW
        self._window[part] = self.distance
        self._largest_m[part], self._largest_rad[part] = self.largest
        self.checkpoints += 1
        if self.largest_error(self.largest) > UNPREDICTABLE:
            self.predictable_until = min(self.predictable_until, self._kept_at)
        self._kept_at = time

    def note_motion(self, moved):
        """Update the largest motion of each body; moved : (n, 4) distances from its start."""
        state = self._motion, self.size, self._factor, self._least
        self._set_least_pose(*self._lost(self.distance, moved, *state))

    def _set_least_pose(self, m, rad):
        self._least_pose = max(m / self.size, rad)

    @property
    def growth(self):
        """Ratio of the largest distances of the last two checkpoints, at least 1."""
        if self.checkpoints < 2:
            return 1.0
        parts = [(self.checkpoints - k) % WINDOW for k in (1, 2)]
        last, before = (max(self._largest_m[k], self._largest_rad[k]) for k in parts)
        return max(1.0, last / before) if before > 0.0 else 1.0

    def largest_error(self, largest):
        """Largest estimated error of a pose, relative to the characteristic length or in rad.

        largest : m and rad of the present distances
        """
        position = max(largest[0], FADING * max(self._largest_m))
        angle = max(largest[1], FADING * max(self._largest_rad))
        scale = scale_of(position / self.size, angle, self._factor)
        return max(scale * position / self.size, scale * angle, self._least_pose)

    def errors(self, distance):
        """(n, 4) estimates of the errors of the bodies, as `largest_error`."""
        errors = np.empty_like(distance)
        self._errors(distance, self._window, self.size, self._factor, self._least, errors)
        return errors
