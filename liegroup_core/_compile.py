# SPDX-License-Identifier: Apache-2.0
"""Compilation of the numerical kernels: one decorator, one cache that notices every source edit.

Numba's own cache checks only the file a kernel stands in, so an edit in a helper leaves its
callers with the old code. Here the cache folder is named after a hash of all our sources: any
edit, in any file, starts a new folder.

Without Numba the same functions run as plain Python: the same results, slowly.
"""
import hashlib
import logging
import os
import shutil
import sys
import tempfile
import time
from pathlib import Path

try:
    import numba
    import numba.extending
    from numba.core import cgutils
except ImportError:
    numba = None

log = logging.getLogger("liegroup_core")

# How many caches of other versions stay: a developer switches between a few.
KEPT_CACHES = 6


def compiled():
    """True when kernels run as machine code, False when they run as plain Python."""
    return numba is not None and not numba.config.DISABLE_JIT


def _source_hash():
    """Hash of all that the compiler keeps apart: sources and their place, versions."""
    root = Path(__file__).parent
    digest = hashlib.sha256(f"{root} {sys.version} {numba.__version__}".encode())
    for path in sorted(root.rglob("*.py")):
        digest.update(str(path.relative_to(root)).encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _cache_root():
    """The user's cache folder, or one in the temporary folder where that cannot be written."""
    default = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    wanted = Path(os.environ.get("LIEGROUP_CACHE_DIR") or Path(default) / "liegroup_core")
    spare = Path(tempfile.gettempdir()) / f"liegroup_core-{os.getuid()}"
    for root in (wanted, spare):
        try:
            root.mkdir(parents=True, exist_ok=True)
            tempfile.TemporaryFile(dir=root).close()
            return root
        except OSError:
            continue
    return None


def _cache_folder():
    """The cache folder of exactly these sources, made if need be; old ones are removed."""
    root = _cache_root()
    if root is None:
        return None
    folder = root / _source_hash()
    if not folder.exists():
        folder.mkdir(exist_ok=True)
        others = sorted((p for p in root.iterdir() if p.is_dir() and p != folder),
                        key=lambda p: p.stat().st_mtime, reverse=True)
        for old in others[KEPT_CACHES:]:
            shutil.rmtree(old, ignore_errors=True)
    return folder


CACHE_FOLDER = _cache_folder() if numba is not None else None


def _compile(function, inlined):
    """Let Numba compile `function` on its first call; without Numba, return it as it is."""
    if numba is None:
        return function
    # Only while decorating: other packages of the same process keep their own cache folder.
    before = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = str(CACHE_FOLDER or "")
    try:
        return numba.njit(nogil=True, error_model="numpy", forceinline=inlined,
                          cache=CACHE_FOLDER is not None)(function)
    finally:
        numba.config.CACHE_DIR = before


def kernel(function):
    """Compile `function` on its first call, without the GIL; without Numba, return it as it is.

    Kernels are inlined into their callers: handing a tuple of arrays to a function copies them all
    and counts references, which was measured to cost as much as the mechanics.
    Fast-math stays off: it would undo the small-angle code. Division follows IEEE 754 in machine
    code and raises ZeroDivisionError in plain Python, so kernels branch before they divide.
    """
    return _compile(function, True)


def subroutine(function):
    """A kernel that is not inlined: for what is long and is called once a step at most.

    It is compiled once, however many callers it has; its arrays should be `borrowed` again.
    """
    return _compile(function, False)


def _without_owner(context, builder, kind, value):
    """LLVM value of an array, or of a tuple of them, whose reference count nobody keeps."""
    if isinstance(kind, numba.types.Array):
        array = context.make_array(kind)(context, builder, value)
        for field in ("meminfo", "parent"):
            setattr(array, field, cgutils.get_null_value(getattr(array, field).type))
        return array._getvalue()
    if isinstance(kind, numba.types.BaseTuple):
        return context.make_tuple(builder, kind, [
            _without_owner(context, builder, item, builder.extract_value(value, i))
            for i, item in enumerate(kind)])
    return value


if compiled():
    @numba.extending.intrinsic
    def borrowed(typing_context, arrays):
        """The same arrays (an array or a tuple of them) without reference counts.

        For the entry of a kernel: its caller holds the arrays until it returns, so counting every
        use of them with atomic operations is in vain; it took three quarters of a step's time.
        """
        def codegen(context, builder, signature, arguments):
            return _without_owner(context, builder, signature.args[0], arguments[0])
        return arrays(arrays), codegen
else:
    def borrowed(arrays):
        """The same arrays; plain Python counts references by itself."""
        return arrays


def by_type(name, table):
    """A kernel that stands for one of several: which one, the type of its first argument says.

    name  : what it is called in messages
    table : {NamedTuple class: kernel}; all take the same arguments
    The choice is made when a caller is compiled: it costs nothing at run time.
    """
    def call(first, *rest):
        return table[type(first)](first, *rest)
    call.__name__ = name
    if compiled():
        def choose(first, *rest):
            chosen = table.get(getattr(first, "instance_class", None))
            if chosen is None:
                return None

            def forward(first, *rest):
                return chosen(first, *rest)
            return forward
        numba.extending.overload(call, jit_options={
            "forceinline": True, "nogil": True, "error_model": "numpy"})(choose)
    return call


def warm_up(call, name):
    """Run `call` once so that all kernels it uses are compiled, and say so when that takes time.

    call : a function without arguments that runs one small simulation
    name : which kernels these are; every name is compiled once
    returns the seconds it took
    """
    done = CACHE_FOLDER / f"complete-{name}" if CACHE_FOLDER is not None else None
    if not compiled():
        log.warning("numba is not installed or is disabled: the simulation runs as plain Python, "
                    "some hundred times slower (pip install numba)")
    elif done is None or not done.exists():
        log.warning("compiling the kernels for their first use on this machine "
                    "(a minute or two, kept for the next start)")
    start = time.perf_counter()
    call()
    if done is not None and compiled():
        done.touch()
    return time.perf_counter() - start
