# SPDX-License-Identifier: Apache-2.0
"""Compilation of the numerical kernels: one decorator, one cache that notices every source edit.

Numba's own cache checks only the file a kernel stands in, so an edit in a helper leaves its
callers with the old code. Here the cache folder is named after a hash of all our sources: any
edit, in any file, starts a new folder.

Without Numba the same functions run as plain Python: the same results, slowly, but for numbers that
are next to zero (`stepper`).
"""

import functools
import hashlib
import logging
import os
import re
import shutil
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path

from .presence import compiled, numba

if compiled():
    from . import inlining as _inlined

log = logging.getLogger("liegroup_core")

# How many caches of other versions stay: a developer switches between a few.
KEPT_CACHES = 6
COMPILED = re.compile("[0-9a-f]{16}(-[0-9]+)?")  # names of the folders of compiled code


@functools.lru_cache(maxsize=None)
def source_digest():
    """Hash of the sources that results depend on: all but `study`, which has no kernels."""
    root = Path(__file__).parents[1]
    digest = hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        place = path.relative_to(root)
        if place.parts[0] != "study":
            digest.update(str(place).encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()


def _source_hash():
    """Hash of all that the compiler keeps apart: sources and their place, versions."""
    kept_apart = (
        f"{Path(__file__).parents[1]} {sys.version} {numba.__version__} "
        f"{numba.config.BOUNDSCHECK} {source_digest()}"
    )
    return hashlib.sha256(kept_apart.encode()).hexdigest()[:16]


def cache_root():
    """The user's cache folder, or one in the temporary folder where that cannot be written."""
    default = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    wanted = Path(os.environ.get("LIEGROUP_CACHE_DIR") or Path(default) / "liegroup_core")
    roots = [wanted]
    try:
        roots.append(Path(tempfile.gettempdir()) / f"liegroup_core-{os.getuid()}")
    except FileNotFoundError:  # it tries to write: all disks are full
        pass
    for root in roots:
        try:
            root.mkdir(parents=True, exist_ok=True, mode=0o777 if root is wanted else 0o700)
            tempfile.TemporaryFile(dir=root).close()
        except OSError:
            continue
        # What is loaded from there is run: not where somebody else was first with the name.
        if root is wanted or root.lstat().st_uid == os.getuid():
            return root
    return None


def _cache_folder():
    """The cache folder of exactly these sources, made if need be; old ones are removed."""
    root = cache_root()
    if root is None:
        return None
    folder = root / _source_hash()
    if folder.exists() and not os.access(folder, os.W_OK):
        folder = root / f"{folder.name}-{os.getuid()}"  # that is another user's
    if not folder.exists():
        try:
            folder.mkdir(exist_ok=True)
        except OSError:  # the disk is full
            return None
        others = sorted(
            (
                p
                for p in root.iterdir()
                if p.is_dir() and p != folder and COMPILED.fullmatch(p.name)
            ),
            key=lambda p: p.stat().st_mtime,
            reverse=True,
        )
        for old in others[KEPT_CACHES:]:
            shutil.rmtree(old, ignore_errors=True)
    return folder


CACHE_FOLDER = _cache_folder() if numba is not None else None


class Kernel:
    """A function that Numba compiles on its first call: once for Python, once for other kernels.

    function   : what is compiled
    make_inner : function (this, function) that returns what other kernels take in
    flushes    : True: numbers next to zero are zero while Python's call of it runs
    """

    def __init__(self, function, make_inner, flushes=False):
        functools.update_wrapper(self, function)
        self.inner = make_inner(self, function)
        # Only while decorating: other packages of the same process keep their own cache folder.
        before = numba.config.CACHE_DIR
        numba.config.CACHE_DIR = str(CACHE_FOLDER or "")
        try:
            self.dispatcher = _inlined.outer(function, CACHE_FOLDER is not None, flushes)
        finally:
            numba.config.CACHE_DIR = before

    def __call__(self, *arguments):
        return self.dispatcher(*arguments)

    def __reduce__(self):
        return self.__qualname__  # where to find it: compiled code is not copied

    def entry(self, *arguments):
        """Its machine code for arguments of the types of these, to be called with no others."""
        return self.dispatcher.compile(tuple(map(numba.typeof, arguments)))


class SameTypes:
    """A kernel that is always called with arguments of the same types: those of the first call.

    They are not looked at again, which would take longer than a small step.
    """

    def __init__(self, called):
        self._called = called
        self._machine_code = None if compiled() else called

    def __call__(self, *arguments):
        if self._machine_code is None:
            self._machine_code = self._called.entry(*arguments)
        return self._machine_code(*arguments)

    def __reduce__(self):
        return SameTypes, (self._called,)


class Choice:
    """A kernel that stands for one of several: which one, the class of its first argument says.

    name  : what it is called in messages
    table : {class of Struct: kernel}; all take the same arguments
    The choice is made when a caller is compiled: it costs nothing at run time.
    """

    def __init__(self, name, table):
        self.name, self.table = name, table

    def __call__(self, first, *rest):
        return self.table[type(first)](first, *rest)


if compiled():

    @numba.extending.typeof_impl.register(Kernel)
    def _type_of_kernel(kernel, context):
        return _inlined.InnerFunction(kernel.inner)

    @numba.extending.typeof_impl.register(Choice)
    def _type_of_choice(choice, context):
        return _inlined.Chosen(
            choice.name, {cls: kernel.inner for cls, kernel in choice.table.items()}
        )


def kernel(function):
    """Compile `function` on its first call, without the GIL; without Numba, leave it as it is.

    Kernels are inlined into the kernels that call them. Fast-math stays off: it would undo the
    small-angle code. Division follows IEEE 754 in machine code and raises ZeroDivisionError in
    plain Python, so kernels branch before they divide.
    """
    return Kernel(function, lambda _, each: _inlined.inner(each, True)) if compiled() else function


def stepper(function):
    """A kernel that takes steps: numbers below 2.2e-308 are zero while it runs, on x86.

    Motions fade out along a chain: from some body on they are that small, and x86 takes a hundred
    times as long with such numbers. A chain of a thousand balls was a third slower for it.
    """
    if not compiled():
        return function
    return Kernel(function, lambda _, each: _inlined.inner(each, True), flushes=True)


def subroutine(function):
    """A kernel that is not inlined: for what is called in several places of one kernel."""
    return Kernel(function, lambda _, each: _inlined.inner(each, False)) if compiled() else function


def shared(function):
    """A kernel that returns an integer and is compiled once, for all kernels that call it.

    They call its machine code. For what is long: how long a compilation takes goes with the size
    of what it makes, and the solve would be half of every integrator.
    """
    return Kernel(function, lambda own, _: _inlined.shared_inner(own)) if compiled() else function


def warm_up(call, name):
    """Run `call` once so that all kernels it uses are compiled, and say so when that takes time.

    call : a function without arguments that runs one small simulation
    name : which kernels these are; every name is compiled once
    returns the seconds it took
    """
    done = CACHE_FOLDER / f"complete-{name}" if CACHE_FOLDER is not None else None
    if not compiled():
        log.warning(
            "numba is not installed or is disabled: the simulation runs as plain Python, "
            "some hundred times slower (pip install numba)"
        )
    elif done is None or not done.exists():
        log.warning(
            "compiling the kernels for their first use on this machine "
            "(some twenty seconds, kept for the next start)"
        )
    start = time.perf_counter()
    call()
    if done is not None and compiled():
        with suppress(OSError):
            done.touch()
    return time.perf_counter() - start
