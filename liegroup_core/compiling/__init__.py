# SPDX-License-Identifier: Apache-2.0
"""Compilation of the numerical kernels by Numba. See README.md in this folder for the contract.

In: plain Python functions and classes of arrays (Structs). Out: machine code, cached on disk, or
the functions themselves without Numba. This package does not depend on mechanics.
"""

from .backend import compiled
from .cache import cache_root, source_digest
from .kernels import Choice, Kernel, SameTypes, kernel, shared, stepper, subroutine, warm_up
from .structs import Record, Struct, borrowed, shaped

__all__ = [
    "Choice",
    "Kernel",
    "Record",
    "SameTypes",
    "Struct",
    "borrowed",
    "cache_root",
    "compiled",
    "kernel",
    "shaped",
    "shared",
    "source_digest",
    "stepper",
    "subroutine",
    "warm_up",
]
