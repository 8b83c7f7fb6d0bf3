# SPDX-License-Identifier: Apache-2.0
"""Run the compiler so that Ctrl-C does not interrupt it.

An exception at an arbitrary point leaves Numba in a state from which it may not recover: its tables of types
are half filled, and an exception in a callback of LLVM is lost. Python raises KeyboardInterrupt and the
exceptions of other signal handlers in the main thread only. So the compiler
works in a thread of its own, and the caller waits. If the wait is interrupted, the work continues, and
the next caller finds its result.
"""

import _thread
import atexit
import gc
import os
import signal
import sys
import threading
import time
from contextlib import contextmanager

_here = threading.local()
_IMPORTER = "<frozen importlib._bootstrap>"  # file of the functions that import a module
_working = set()  # the _Done of each thread
_ending = False  # the process ends


def undisturbed(function, *arguments):
    """Call function(*arguments) in a thread that no signal reaches; returns its result.

    Calls it in this thread if it would otherwise wait for a lock that this thread holds.
    """
    if getattr(_here, "apart", False) or _holds_numba() or _imports():
        return function(*arguments)
    # The waiting thread takes only locks of C: an interrupt in a `with` of Python may leave a lock taken.
    lock, results, errors = _thread.allocate_lock(), [], []
    lock.acquire()
    _thread.start_new_thread(_work, (_Done(lock), results, errors, function, arguments))
    lock.acquire()
    if errors:
        raise errors.pop()
    if not results:  # an exception for this thread reached the other one, which had just begun
        raise KeyboardInterrupt
    return results[0]


class _Done:
    """Releases a lock once: when it is called, or when a thread that never called it has ended."""

    def __init__(self, lock):
        self._locks = [lock]

    def __call__(self):
        if self._locks:
            self._locks.pop().release()

    __del__ = __call__


def compiling_apart(dispatcher, after=None):
    """Make a dispatcher of Numba compile undisturbed, and return it; after: called when it has compiled or failed."""
    numba_compiles = dispatcher.compile

    def compiler(arguments):
        try:
            return numba_compiles(arguments)
        finally:
            if after is not None:
                after()

    def compiled(arguments):
        found = dispatcher.overloads.get(arguments)
        return undisturbed(compiler, arguments) if found is None else found.entry_point

    dispatcher.compile = compiled
    return dispatcher


def _holds_numba():
    """Whether this thread compiles a function of the user that calls a kernel: Numba has one lock."""
    module = sys.modules.get("numba.core.compiler_lock")
    lock = getattr(module, "global_compiler_lock", None)
    return lock is not None and lock.is_locked()


def _imports():
    """Whether this thread imports a module that calls a kernel: Python has a lock for each module."""
    frame = sys._getframe()
    while frame is not None and frame.f_code.co_filename != _IMPORTER:
        frame = frame.f_back
    return frame is not None


def _work(done, results, errors, function, arguments):
    _here.apart = True
    _working.add(done)
    try:
        check_end()
        with _no_collection():
            results.append(function(*arguments))
    except BaseException as error:  # raised in the caller
        errors.append(error)
    finally:
        _working.discard(done)
        done()


@contextmanager
def _no_collection():
    """Switch the garbage collector off: with Numba's millions of objects it takes a tenth of the compile time.

    At the end it makes them old objects. As young ones they would be searched at once, and again later.
    """
    was = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.unfreeze()
        if was:
            gc.enable()


def check_end():
    """Raise SystemExit if the process is ending; called before each function that is compiled."""
    if _ending:
        raise SystemExit


@atexit.register
def _wait():
    """Wait for the function that is being compiled, before LLVM's code is unloaded."""
    global _ending
    _ending = True
    try:
        while _working:
            time.sleep(0.01)
    except KeyboardInterrupt:  # a second Ctrl-C
        os._exit(128 + signal.SIGINT)
