# SPDX-License-Identifier: Apache-2.0
"""Search for a step size that works after an implicit method has failed."""

import math

from liegroup_core.status import OK

# Fractions of the failed step that are tried first, number of bisections between a step that works
# and one that fails, and safety factor of the recommended step.
SMALLEST_PART, HALVINGS, PART = 1e-9, 6, 0.95


def step_that_works(integrator, h, pose, twist, external):
    """Step below h, s, two digits, that the integrator can take from a state; None: not found.

    pose (n, 12), twist (n, 6), external (n, 6): not changed; the integrator is restarted
    """
    work = integrator.work
    kept = work.report.copy(), work.angle.copy()

    def works(size):
        integrator.restart()
        work.angle[:] = kept[1]
        return integrator.advance(size, 1, pose.copy(), twist.copy(), external)[1] == OK

    def largest_below(too_large):
        size = 0.5 * too_large
        while size >= SMALLEST_PART * h and not works(size):
            size *= 0.5
        return size

    good = largest_below(h)
    bad = 2.0 * good
    for _ in range(HALVINGS):
        middle = 0.5 * (good + bad)
        if works(middle):
            good = middle
        else:
            bad = middle
    good = _two_digits(PART * good)
    while good >= SMALLEST_PART * h and not works(good):
        good = _two_digits(PART * good)
    found = good if good >= SMALLEST_PART * h else None
    work.report[:], work.angle[:] = kept
    integrator.restart()
    return found


def _two_digits(value):
    """Value rounded down to two digits."""
    unit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return float(f"{math.floor(value / unit + 1e-9) * unit:.2g}")
