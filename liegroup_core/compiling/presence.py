# SPDX-License-Identifier: Apache-2.0
"""Numba, or None where it is not installed."""

try:
    import numba
    import numba.extending
except ImportError:
    numba = None


def compiled():
    """True when kernels run as machine code, False when they run as plain Python."""
    return numba is not None and not numba.config.DISABLE_JIT
