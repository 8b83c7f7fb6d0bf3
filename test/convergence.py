# SPDX-License-Identifier: Apache-2.0
"""Order of convergence that errors show."""

import numpy as np


def fitted_order(steps, errors):
    """Slope of the logarithm of the errors over that of the steps."""
    return np.polyfit(np.log(steps), np.log(errors), 1)[0]


def order_of(errors):
    """Fitted order of {step: error}."""
    return fitted_order(list(errors), list(errors.values()))


def order_by_count(counts, errors):
    """Fitted order over steps that are proportional to 1 / count."""
    return -fitted_order(counts, errors)
