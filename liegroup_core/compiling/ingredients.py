# SPDX-License-Identifier: Apache-2.0
"""Hash of everything that the machine code of a kernel depends on. It names the kernel's file in the cache.

A kernel depends on its bytecode and on all that it refers to: constants, and other kernels with theirs. Of a
`shared` function it contains the symbol only, whose machine code has a file of its own. So an edit recompiles
only what it changes. Docstrings, comments, line numbers and paths of files do not count.
"""

import dataclasses
import hashlib
import sys
import types
from opcode import opmap

import numpy as np

from .kernels import Choice, Kernel
from .structs import Borrowed, Struct

PLAIN = (type(None), bool, int, float, complex, str, bytes, type(Ellipsis))
# Operations that read a global or an attribute, and the bits below the number of its name.
CACHE, EXTENDED, GLOBAL = (opmap.get(name, -1) for name in ("CACHE", "EXTENDED_ARG", "LOAD_GLOBAL"))
GLOBAL_FLAGS = 1 if sys.version_info >= (3, 11) else 0
ATTRIBUTES = {opmap["LOAD_ATTR"]: 1 if sys.version_info >= (3, 12) else 0}
if "LOAD_METHOD" in opmap:
    ATTRIBUTES.setdefault(opmap["LOAD_METHOD"], 0)
_names = {}  # code: its names
_known = {}  # id of a Kernel or Choice: (itself, hash)


def digest(kernel):
    """Hash of everything that a kernel depends on, the same in every process and for every path.

    Raises TypeError if its function refers to a kind of object that this module does not know.
    """
    return _of_function(kernel.function)


def _hash(*parts):
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()


def _of_kernel(called):
    """Hash of a Kernel or Choice as callers see it."""
    if id(called) not in _known:
        if isinstance(called, Choice):
            parts = [f"{_name(cls)} {_of(each)}" for cls, each in called.table.items()]
        elif called.role == "shared":
            parts = [called.role, _name(called.function)]
        else:
            parts = [called.role, _of_function(called.function)]
        _known[id(called)] = called, _hash(*parts)
    return _known[id(called)][1]


def _of_function(function):
    code = function.__code__
    cells = dict(zip(code.co_freevars, function.__closure__ or ()))
    parts = [_of_code(code, function.__doc__), _of(function.__defaults__)]
    parts += [f"{name} {_of(cell.cell_contents)}" for name, cell in cells.items()]
    for name, attribute in sorted(names_in(code), key=repr):
        if name in function.__globals__:
            value = function.__globals__[name]
            if attribute is not None and isinstance(value, types.ModuleType):
                value = getattr(value, attribute, None)
            parts.append(f"{name} {attribute} {_of(value)}")
    return _hash(*parts)


def names_in(code):
    """{(global, attribute that is read from it or None)} in a code object and in those inside it.

    Decoded by hand at every start, because dis takes a hundred times as long.
    """
    if code not in _names:
        found, last, high = set(), None, 0
        for op, low in zip(code.co_code[::2], code.co_code[1::2]):
            if op == CACHE:
                continue
            argument, high = high << 8 | low, 0
            if op == EXTENDED:
                high = argument
            elif op == GLOBAL:
                last = code.co_names[argument >> GLOBAL_FLAGS]
                found.add((last, None))
            else:
                if op in ATTRIBUTES and last is not None:
                    found.add((last, code.co_names[argument >> ATTRIBUTES[op]]))
                last = None
        inner = [each for each in code.co_consts if isinstance(each, types.CodeType)]
        _names[code] = found.union(*map(names_in, inner))
    return _names[code]


def _of_code(code, doc=None):
    constants = [
        _of_code(value) if isinstance(value, types.CodeType) else repr(value)
        for value in code.co_consts
        if doc is None or value != doc
    ]
    names = (code.co_names, code.co_varnames, code.co_freevars, code.co_argcount, code.co_flags)
    return _hash(code.co_code.hex(), repr(names), *constants)


def _name(value):
    return f"{value.__module__}.{value.__qualname__}"


def _of(value):
    """Text of a value that a function refers to."""
    if isinstance(value, (Kernel, Choice)):
        return _of_kernel(value)
    if isinstance(value, PLAIN):
        return repr(value)
    if isinstance(value, (tuple, list)):
        return f"{type(value).__name__}({', '.join(map(_of, value))})"
    if isinstance(value, (np.ndarray, np.generic)):
        return f"{np.asarray(value).dtype!r} {np.shape(value)} {_hash(np.asarray(value).tobytes().hex())}"
    if isinstance(value, np.dtype):
        return repr(value.descr if value.names else value)
    if isinstance(value, types.FunctionType) and value.__module__.partition(".")[0] != "numpy":
        return _of_function(value)
    if isinstance(value, type) and issubclass(value, Struct):
        return f"{_name(value)} {[(f.name, str(f.type)) for f in dataclasses.fields(value)]}"
    if isinstance(value, types.ModuleType):  # attributes read from it have their own entries
        return value.__name__
    if isinstance(value, Borrowed):
        return "borrowed"
    if callable(value) and hasattr(value, "__name__"):  # of Python, NumPy or Numba
        return f"{getattr(value, '__module__', None)}.{value.__name__}"
    raise TypeError(f"a kernel refers to {value!r}, which the cache cannot identify")
