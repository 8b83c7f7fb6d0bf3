# SPDX-License-Identifier: Apache-2.0
"""Broyden's method: Newton's method with a Jacobian that is updated from the corrections.

Source: Kelley, Iterative Methods for Linear and Nonlinear Equations, 1995, 7.3.
"""

from liegroup_core.compiling import kernel


@kernel
def broyden(corrections, k, bound):
    """Convert correction k of the initial Jacobian into Broyden's correction, in place.

    corrections (m, size) : rows 0 to k - 1 are the previous corrections; row k is changed
    bound : limit of the component of correction k along correction k - 1, relative to that one.
            At this limit correction k is not lengthened, as the Jacobian update would be too large
    """
    size = corrections.shape[1]
    for j in range(k):
        product = square = 0.0
        for r in range(size):
            product += corrections[j, r] * corrections[k, r]
            square += corrections[j, r] * corrections[j, r]
        ratio = product / square if square > 0.0 else 0.0
        if j < k - 1:
            for r in range(size):
                corrections[k, r] += ratio * corrections[j + 1, r]
        elif ratio < bound:
            for r in range(size):
                corrections[k, r] /= 1.0 - ratio
