# SPDX-License-Identifier: Apache-2.0
"""Threads: one of BLAS for the small matrices of models and references, and punctual ones.

By default BLAS has a thread for each core. They busy-wait for each other: if another process
takes a core, a decomposition of a matrix of 50 rows takes up to a hundred times as long.
"""

import ctypes
import functools
from contextlib import contextmanager, suppress

from threadpoolctl import ThreadpoolController


@functools.cache
def _libraries():
    """BLAS libraries of this process, those of NumPy and SciPy; found once, because that takes 1 ms."""
    return ThreadpoolController()


@contextmanager
def one_blas_thread():
    """Let BLAS use one thread; as a context or a decorator."""
    with _libraries().limit(limits=1, user_api="blas"):
        yield


PR_SET_TIMERSLACK = 29  # of Linux, prctl(2)


def wake_on_time():
    """Let the calling thread wake at the time it asks for; by default Linux adds 50 us, which saves power."""
    with suppress(OSError, AttributeError):  # another system
        ctypes.CDLL(None).prctl(PR_SET_TIMERSLACK, ctypes.c_ulong(1), 0, 0, 0)
