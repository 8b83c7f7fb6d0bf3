# SPDX-License-Identifier: Apache-2.0
"""Decorators of the numerical kernels, and the compiler of this process, which backend.py selects."""

import functools
import importlib.util
import logging
import os
import threading
import time

from .undisturbed import undisturbed

log = logging.getLogger("liegroup_core")

# Without Numba the decorators return the function itself, so that calls cost no more than Python's.
OFTEN = 5.0  # s between two messages about the progress of compiling
_compiled = None  # kernels that the present warm_up has compiled; None: no warm_up takes place
_told = 0.0  # s, time of the last message about it
JIT = importlib.util.find_spec("numba") is not None and os.environ.get("NUMBA_DISABLE_JIT") != "1"

select = None  # function of backend.py that sets the compiler at the first use of a kernel
compiler = None
_selecting = threading.RLock()


def chosen():
    """Module of the compiler of this process: inlining, plain or python."""
    return compiler or undisturbed(_choose)


def _choose():
    with _selecting:
        if compiler is None:
            select()
    return compiler


class Kernel:
    """Function that is compiled on its first call: once for Python, once for other kernels.

    function : function to compile
    role     : name of its decorator, one of those below

    dispatcher : Numba's dispatcher of the function for Python
    inner      : Numba's dispatcher of the function for other kernels
    call       : callable for Python: takes Structs
    These are made on demand, by the functions of the compiler in _PARTS.
    """

    _PARTS = {"dispatcher": "for_python", "inner": "for_kernels", "call": "callable"}
    _lock = threading.RLock()

    def __init__(self, function, role):
        functools.update_wrapper(self, function)
        self.function, self.role = function, role

    def __getattr__(self, name):  # called for a part that is not made yet
        if name not in self._PARTS:
            raise AttributeError(f"a kernel has no attribute {name}")
        return undisturbed(self._made, name)

    def _made(self, name):
        make = getattr(chosen(), self._PARTS[name])
        with self._lock:
            if name not in vars(self):
                setattr(self, name, make(self))
        return vars(self)[name]

    def __call__(self, *arguments):
        return self.call(*arguments)

    def __reduce__(self):
        return self.__qualname__  # pickled by reference: compiled code is not copied

    def entry(self, *arguments):
        """Callable for arguments of exactly the same types, which it does not check."""
        return chosen().entry(self, arguments)


class SameTypes:
    """Kernel that is always called with arguments of the same types: those of the first call.

    Later calls do not check the types. That check takes longer than a small step.
    """

    def __init__(self, called):
        self._called = called
        self.machine_code = None  # the callable, from the first call on

    def __call__(self, *arguments):
        if self.machine_code is None:
            entry = isinstance(self._called, Kernel)
            self.machine_code = self._called.entry(*arguments) if entry else self._called
        return self.machine_code(*arguments)

    def __reduce__(self):
        return SameTypes, (self._called,)


class Choice:
    """Function that calls one of several kernels, selected by the class of its first argument.

    name  : name in messages
    table : {class of Struct: kernel}; all kernels take the same arguments
    The selection takes place when a caller is compiled: it costs nothing at run time.
    """

    def __init__(self, name, table):
        self.name, self.table = name, table

    def __call__(self, first, *rest):
        return self.table[type(first)](first, *rest)


def kernel(function):
    """Compile `function` on its first call, to run without the GIL.

    Kernels are inlined into the kernels that call them. Fast-math stays off: it would remove the
    small-angle code. Division follows IEEE 754 in machine code and raises ZeroDivisionError in
    plain Python, so kernels branch before they divide.
    """
    return Kernel(function, "kernel") if JIT else function


def stepper(function):
    """Compile a kernel that takes steps. On x86, subnormal numbers are flushed to zero in it.

    Motion decays along a long chain to below 2.2e-308, and x86 takes a hundred times as long with such
    numbers: a chain of a thousand ball joints was a third slower.
    """
    return Kernel(function, "stepper") if JIT else function


def subroutine(function):
    """Compile a kernel that is not inlined: for a function that one kernel calls several times."""
    return Kernel(function, "subroutine") if JIT else function


def shared(function):
    """Compile a long kernel once for all kernels that call it; it returns an integer.

    Callers call its machine code. Compile time is proportional to the size of the code, and the
    solver of the linear system would be half of every integrator.
    """
    return Kernel(function, "shared") if JIT else function


@functools.cache
def _warn_of_plain_python():
    """Log once that nothing is compiled."""
    log.warning(
        "Numba is not installed or is disabled. The simulation runs as plain Python, "
        "about a hundred times slower. Install it: pip install numba"
    )


def compiles():
    """Log that a kernel is compiled: at the first one of a warm_up, then every OFTEN seconds."""
    global _compiled, _told
    if _compiled is None:
        return
    if not _compiled:
        log.warning(
            "first run of this kind of mechanism: compiling about 20 kernels, 10 to 30 s, once: they are cached"
        )
        _told = time.perf_counter()
    elif time.perf_counter() - _told >= OFTEN:
        log.warning("compiling: %d kernels are done", _compiled)
        _told = time.perf_counter()
    _compiled += 1


def warm_up(call):
    """Run `call` once, so that its kernels are compiled or loaded.

    call : function without arguments that runs one small simulation
    """
    if chosen().name == "python":
        _warn_of_plain_python()
    global _compiled
    start, _compiled = time.perf_counter(), 0
    try:
        call()
        if _compiled:
            log.warning("compiled %d kernels in %.0f s", _compiled, time.perf_counter() - start)
    finally:
        _compiled = None
