# SPDX-License-Identifier: Apache-2.0
"""Selection of the compiler: Numba with replaced internals, plain Numba, or none.

The selection takes place at the first use of a kernel, so that importing kernels does not import
Numba. Each compiler is a module with the functions

    cache() -> folder of compiled code, or None
    for_python(kernel), for_kernels(kernel) -> Numba's dispatcher
    callable(kernel) -> callable for Python
    entry(kernel, arguments) -> callable for arguments of the same types
    words(struct) -> Numba type and words of a Struct
"""

import logging
import os
from contextlib import suppress

from . import kernels, python
from .kernels import chosen

log = logging.getLogger("liegroup_core")

TESTED = "0.63 to 0.68"  # releases of Numba whose internals are as expected
PLAIN = "LIEGROUP_PLAIN_NUMBA"  # environment variable; 1: plain Numba


def _select():
    try:
        import numba
        import numba.extending
    except ImportError:
        numba = None
    if numba is None or numba.config.DISABLE_JIT:
        kernels.compiler = python
        return
    try:
        if os.environ.get(PLAIN, "0") in ("", "0"):
            kernels.compiler = _inlining()
            return
    except Exception as error:  # changed internals can raise any exception
        log.warning(
            "Numba %s is not as expected: %s. Kernels are compiled by plain numba.njit instead. The "
            "results are the same, but compiling takes 4 times and a step takes 5 times as long. "
            "Tested releases of Numba: %s.",
            numba.__version__,
            _line(error),
            TESTED,
        )
    try:
        from . import plain

        kernels.compiler = plain
    except Exception as error:
        kernels.compiler = python
        log.warning(
            "Numba %s cannot compile the kernels: %s. The simulation runs as plain Python, about "
            "a hundred times slower. Tested releases of Numba: %s.",
            numba.__version__,
            _line(error),
            TESTED,
        )


def _inlining():
    """Module inlining, if all parts of Numba that it replaces are as expected."""
    from . import assumed, check, inlining

    assumed.check_signatures()
    folder = inlining.cache()
    done = None if folder is None else folder / "checked"
    if done is None or not done.exists():
        kernels.compiler = inlining  # it compiles the kernels of the check
        check.check()
        if done is not None:
            with suppress(OSError):
                done.touch()
    return inlining


def _line(error):
    """First line of an error, with its type."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return f"{type(error).__name__}: {lines[0] if lines else ''}"


def compiled():
    """True if kernels run as machine code, False if they run as plain Python."""
    return chosen().name != "python"


kernels.select = _select
