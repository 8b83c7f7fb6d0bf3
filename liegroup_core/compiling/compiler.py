# SPDX-License-Identifier: Apache-2.0
"""Compiler of this process, which backend.py selects at the first use of a kernel."""

import threading

from .undisturbed import undisturbed

select = None  # function that calls `use`: backend.py sets it
_lock = threading.RLock()
_chosen = None


def chosen():
    """Module of the compiler of this process: inlining, plain or python."""
    return _chosen or undisturbed(_choose)


def _choose():
    with _lock:
        if _chosen is None:
            select()
    return _chosen


def use(module):
    """Compile kernels by a module from now on."""
    global _chosen
    _chosen = module
