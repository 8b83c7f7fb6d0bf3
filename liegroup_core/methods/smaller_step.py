# SPDX-License-Identifier: Apache-2.0
"""Search for a smaller step size after a step of an implicit method has failed."""

import math

from liegroup_core.status import OK

SMALLEST_FRACTION = 1e-9  # relative to the failed step: smaller ones are not tried
BISECTIONS = 6  # between a step that succeeds and one that fails
SAFETY = 0.95  # factor of the recommended step


def step_that_works(integrator, h, pose, twist, external):
    """Step size below h with two digits, in s, that succeeds from a state; None if none is found.

    pose (n, 12), twist (n, 6), external : unchanged; the integrator is restarted
    """
    work = integrator.work
    report, angle = work.report.copy(), work.angle.copy()

    def succeeds(size):
        integrator.restart()
        work.angle[:] = angle
        return integrator.advance(size, 1, pose.copy(), twist.copy(), external)[1] == OK

    def largest_below(too_large):
        size = 0.5 * too_large
        while size >= SMALLEST_FRACTION * h and not succeeds(size):
            size *= 0.5
        return size

    good = largest_below(h)
    bad = 2.0 * good
    for _ in range(BISECTIONS):
        candidate = 0.5 * (good + bad)
        if succeeds(candidate):
            good = candidate
        else:
            bad = candidate
    good = _two_digits(SAFETY * good)
    while good >= SMALLEST_FRACTION * h and not succeeds(good):
        good = _two_digits(SAFETY * good)
    work.report[:], work.angle[:] = report, angle
    integrator.restart()
    return good if good >= SMALLEST_FRACTION * h else None


def _two_digits(value):
    """Round a positive value down to two significant digits."""
    unit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return float(f"{math.floor(value / unit + 1e-9) * unit:.2g}")
