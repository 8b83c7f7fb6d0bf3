# SPDX-License-Identifier: Apache-2.0
"""Kernels compiled by plain `numba.njit`, with Structs implemented by Numba's extension API.

Results are bit-identical to those of `inlining`,
except for numbers below 2.2e-308, which `stepper` does not flush to zero here.
"""

import functools
from contextlib import suppress
from pathlib import Path

import numba
from numba.extending import overload, typeof_impl

from . import struct_types
from .cache import cache_folder, cached_in, source_digest
from .kernels import Choice, Kernel
from .structs import Borrowed
from .undisturbed import compiling_apart

name = "plain"
words = struct_types.words
OPTIONS = {"nogil": True, "error_model": "numpy"}


def cache():
    """Cache folder of this compiler; None if nothing can be cached."""
    # Numba names files by the path of the sources, and checks only the source that defines the kernel.
    place = Path(__file__).parents[1]
    return cache_folder(f"{name} {numba.__version__} {numba.config.BOUNDSCHECK} {place} {source_digest()}")


def for_python(kernel):
    """Dispatcher whose machine code is cached."""
    with cached_in(cache(), numba.config):
        if cache() is not None:
            with suppress(RuntimeError):  # its folder cannot be made: the disk is full
                return compiling_apart(numba.njit(**OPTIONS, cache=True)(kernel.function))
        return compiling_apart(numba.njit(**OPTIONS)(kernel.function))


def for_kernels(kernel):
    """Dispatcher whose machine code is linked into that of the callers."""
    return numba.njit(**OPTIONS)(kernel.function)


def callable(kernel):
    """The function for Python. If the cache on disk is damaged, it compiles again."""
    cached = kernel.dispatcher

    def call(*arguments):
        nonlocal cached
        try:
            return cached(*arguments)
        except Exception:  # kernels raise none: a cache file that is truncated or not writable
            if cached is not kernel.dispatcher:
                raise
            cached = kernel.inner
            return cached(*arguments)

    return call


def entry(kernel, arguments):
    return kernel.call


@functools.cache
def _choice(choice):
    """Dispatcher of a function that calls the kernel for the type of its first argument."""

    def selected(first, *rest):
        """Replaced below in compiled code."""

    @overload(selected, strict=False)
    def select(first, *rest):
        kernel = choice.table[first.instance_class].inner
        return lambda first, *rest: kernel(first, *rest)

    return numba.njit(**OPTIONS)(lambda first, *rest: selected(first, *rest))


@numba.njit(**OPTIONS)
def _same(array):
    return array


struct_types.array_type = struct_types.native_array
struct_types.array_value = struct_types.native_value


@typeof_impl.register(Kernel)
def _type_of_kernel(kernel, context):
    return numba.typeof(kernel.inner)


@typeof_impl.register(Choice)
def _type_of_choice(choice, context):
    return numba.typeof(_choice(choice))


@typeof_impl.register(Borrowed)
def _type_of_borrowed(borrowed, context):
    return numba.typeof(_same)
