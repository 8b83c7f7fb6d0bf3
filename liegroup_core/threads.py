# SPDX-License-Identifier: Apache-2.0
"""One BLAS thread for the small matrices of models and references.

By default BLAS has a thread for each core. They busy-wait for each other: if another process
takes a core, a decomposition of a matrix of 50 rows takes up to a hundred times as long.
"""

import functools
from contextlib import contextmanager

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
