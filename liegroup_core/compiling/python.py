# SPDX-License-Identifier: Apache-2.0
"""Kernels as plain Python functions, used if Numba is missing or disabled."""

name = "python"


def cache():
    return None


def for_python(kernel):
    return kernel.function


for_kernels = callable = for_python


def entry(kernel, arguments):
    return kernel.function
