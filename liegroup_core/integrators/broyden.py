# SPDX-License-Identifier: Apache-2.0
"""Broyden's method: Newton's with a Jacobian that is learnt from the corrections themselves.

Source: Kelley, Iterative Methods for Linear and Nonlinear Equations, 1995, 7.3.
"""

from liegroup_core.compiling import kernel


@kernel
def broyden(corrections, k, most):
    """Turn the correction number k, as the first Jacobian of the iteration asks for it, into
    Broyden's, by those made before.

    corrections (many, size) : rows 0 to k - 1 as they were made; row k is changed
    most : corrections whose part along the last one is more than this are not lengthened: the
           change of the Jacobian would be far from a small one
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
