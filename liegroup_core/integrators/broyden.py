# SPDX-License-Identifier: Apache-2.0
"""Broyden's method: Newton's method with a Jacobian that is updated from the corrections.

Source: Kelley, Iterative Methods for Linear and Nonlinear Equations, 1995, 7.3.
"""

from liegroup_core.compiling import kernel


@kernel
def broyden(corrections, k, most):
    """Convert correction k of the initial Jacobian into Broyden's correction, in place.

    corrections (many, size) : rows 0 to k - 1 are the previous corrections; row k is changed
    most : bound on the component of correction k along the last one. Above it the correction is
           not lengthened: the update of the Jacobian would be too large
    """
    size = corrections.shape[1]
    for j in range(k):
        along = square = 0.0
        for r in range(size):
            along += corrections[j, r] * corrections[k, r]
            square += corrections[j, r] * corrections[j, r]
        part = along / square if square > 0.0 else 0.0
        if j < k - 1:
            for r in range(size):
                corrections[k, r] += part * corrections[j + 1, r]
        elif part < most:
            for r in range(size):
                corrections[k, r] /= 1.0 - part
