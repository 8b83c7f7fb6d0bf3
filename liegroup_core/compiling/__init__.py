# SPDX-License-Identifier: Apache-2.0
"""Compilation of the numerical kernels by Numba.

In: plain Python functions and classes of arrays (structs). Out: machine code, cached on disk; without
Numba the same functions as they are. It knows nothing of mechanics.
"""
