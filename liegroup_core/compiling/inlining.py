# SPDX-License-Identifier: Apache-2.0
"""Kernels compiled by Numba with replaced internals: optimised and translated only once.

By default, Numba optimises every function and translates it to machine code before a caller inlines
it, and repeats both with the caller. For kernels ten calls deep, that was two thirds of the compile
time. Here an inlined function stays LLVM code that is only simplified. Only the outermost function,
which Python calls, is optimised, together with all functions inlined in it. A function is also not
compiled again for every constant argument: LLVM sees the constant where it inlines the call.

A long function with several callers (the forces, the accelerations, the linear solver) becomes
machine code of its own. Its callers call it by a symbol.

Replaced: steps of a code library (libraries.py), compiler passes (passes.py), types of functions
(here and in signatures.py), arrays (borrowed_arrays.py), and the handling of damaged cache files.
assumed.py and the package's README.md state what is assumed of Numba.
"""

import logging
import os
import pickle
import weakref
from contextlib import contextmanager, suppress
from dataclasses import dataclass

import llvmlite
import numba
from llvmlite import binding
from numba import njit
from numba.core import cgutils, types
from numba.core.caching import NullCache
from numba.core.compiler import CompileResult
from numba.core.datamodel import models
from numba.core.imputils import lower_constant
from numba.core.serialize import dumps
from numba.extending import intrinsic, register_model, typeof_impl

from . import borrowed_arrays, ingredients, struct_types
from .cache import CODE, cache_folder, lock, source_digest, write
from .kernels import Choice, Kernel, compiles
from .passes import Flushing, InnerCompiler, OuterCompiler
from .struct_types import digest, text
from .undisturbed import compiling_apart

log = logging.getLogger("liegroup_core")

name = "inlining"
words = struct_types.words
OPTIONS = {"nogil": True, "error_model": "numpy"}


def _inner(function, always):
    """Dispatcher of a function for compiled callers; always: inline it into them."""
    return njit(
        **OPTIONS, forceinline=always, pipeline_class=InnerCompiler, no_cpython_wrapper=True, no_cfunc_wrapper=True
    )(function)


class _Cache(NullCache):
    """Disk cache of a kernel: one file per contents (ingredients.py), argument types and processor.

    Only one process compiles a kernel, others wait for its file. Unreadable files are replaced, files
    that cannot be written are omitted.
    """

    warned = False

    def __init__(self, kernel):
        self._name = f"{kernel.function.__module__}.{kernel.__qualname__}"
        self._made_of = ingredients.digest(kernel)
        self._lock = None  # held while this process compiles

    def _file(self, signature, context):
        arguments = map(text, getattr(signature, "args", signature))
        found = digest(self._made_of, *arguments, repr(context.codegen().magic_tuple()))
        return cache() / f"{self._name}-{found}{CODE}"

    def load_overload(self, signature, context):
        context.refresh()
        path = self._file(signature, context)
        found = self._load(path, context)
        if found is None:
            compiles()
            with self._forgiving():
                self._lock = lock(path)
                found = self._load(path, context)  # of the process that had the lock
        return found

    def _load(self, path, context):
        try:
            found = CompileResult._rebuild(context, *pickle.loads(path.read_bytes()))
            os.utime(path)  # marks the file as used, so that it is kept
            return found
        except Exception:  # a truncated or corrupt file can raise any exception
            return None

    def save_overload(self, signature, data):
        with self._forgiving():
            write(self._file(signature, data.target_context), dumps(data._reduce()))

    def release(self):
        """Release the lock: the file is written, or the attempt failed."""
        held, self._lock = self._lock, None
        if held is not None:
            with suppress(OSError):
                os.unlink(held.name)
            held.close()

    @contextmanager
    def _forgiving(self):
        try:
            yield
        except (OSError, MemoryError) as error:
            if not _Cache.warned:
                _Cache.warned = True
                log.warning(
                    "Compiled kernels cannot be cached in %s: %s. Every start compiles them again",
                    cache(),
                    getattr(error, "strerror", "out of memory"),
                )


@dataclass(frozen=True)
class _Symbol:
    """Symbol of the machine code of a function, for arguments of these types.

    Calling this object compiles or loads the function and defines the symbol. Numba does so before
    it loads a cached kernel that calls the function.
    """

    function: object  # Kernel
    arguments: tuple

    @property
    def name(self):
        function = f"{self.function.__module__}.{self.function.__qualname__}"
        return f"liegroup_core.{digest(function, *map(text, self.arguments))}"

    def __call__(self):
        dispatcher = self.function.dispatcher
        dispatcher.compile(self.arguments)
        compiled = dispatcher.overloads[self.arguments]
        if types.unliteral(compiled.signature.return_type) != types.int64:
            raise TypeError(f"{dispatcher.__qualname__} must return an integer")
        binding.add_symbol(self.name, compiled.library.get_pointer_to_function(compiled.fndesc.llvm_func_name))


def _shared(kernel):
    """Dispatcher for compiled callers that calls the machine code of the function for Python."""

    @intrinsic
    def call(typing_context, given):
        symbol = _Symbol(kernel, tuple(map(types.unliteral, given)))
        symbol()

        def codegen(context, builder, signature, values):
            numbers = [
                context.cast(builder, value, kind, wanted)
                for value, kind, wanted in zip(cgutils.unpack_tuple(builder, values[0]), given, symbol.arguments)
            ]
            convention = context.call_conv
            function = cgutils.get_or_insert_function(
                builder.module, convention.get_function_type(types.int64, symbol.arguments), symbol.name
            )
            context.active_code_library._reload_init.add(symbol)
            return convention.call_function(builder, function, types.int64, symbol.arguments, numbers)[1]

        return types.int64(given), codegen

    def stub(*given):
        return call(given)

    return _inner(stub, True)


class InnerFunction(types.Dispatcher):
    """Type of a function for compiled callers: constant arguments do not compile it again.

    LLVM sees the constants where it inlines the function. Its signature is found once for given types.
    """

    _found = weakref.WeakKeyDictionary()  # for each dispatcher, because Numba makes this type at every use

    def get_call_type(self, context, args, kws):
        args = tuple(map(types.unliteral, args))
        if kws:
            return super().get_call_type(context, args, kws)
        found = self._found.setdefault(self.dispatcher, {})
        if args not in found:
            found[args] = super().get_call_type(context, args, kws)
        return found[args]


class ChoiceType(types.Callable, types.Dummy):
    """Type of a function that calls one of several, selected by the type of its first argument.

    table : {class of Struct: inner dispatcher}
    """

    def __init__(self, name, table):
        self._table = table
        super().__init__(f"choice({name})")

    @property
    def key(self):
        return frozenset(self._table.items())  # names are for messages: two may have the same

    def _type(self, arguments):
        first = arguments[0]
        if isinstance(first, types.StarArgTuple):  # all arguments of a shared function
            first = first.types[0]
        return InnerFunction(self._table[first.instance_class])

    def get_call_type(self, context, args, kws):
        return self._type(args).get_call_type(context, args, kws)

    def get_call_signatures(self):
        return (), True

    def get_impl_key(self, sig):
        return self._type(sig.args).get_impl_key(sig)


register_model(InnerFunction)(models.OpaqueModel)
register_model(ChoiceType)(models.OpaqueModel)


@lower_constant(ChoiceType)
def _no_value(context, builder, kind, value):
    return context.get_dummy_value()


def cache():
    """Cache folder of this compiler; None if nothing can be cached."""
    return cache_folder(
        f"{name} {numba.__version__} {llvmlite.__version__} {numba.config.BOUNDSCHECK} {source_digest('compiling')}"
    )


def for_python(kernel):
    """Dispatcher of a kernel for Python."""
    pipeline = Flushing if kernel.role == "stepper" else OuterCompiler
    dispatcher = njit(**OPTIONS, pipeline_class=pipeline)(kernel.function)
    if cache() is None:
        return compiling_apart(dispatcher)
    try:
        dispatcher._cache = _Cache(kernel)
    except TypeError as error:  # a user's function that refers to an unknown kind of object
        log.warning("Every start compiles %s again: %s", kernel.__qualname__, error)
        return compiling_apart(dispatcher)
    return compiling_apart(dispatcher, dispatcher._cache.release)


def for_kernels(kernel):
    """Dispatcher of a kernel for compiled callers."""
    if kernel.role == "shared":
        return _shared(kernel)
    return _inner(kernel.function, always=kernel.role != "subroutine")


def callable(kernel):
    return kernel.dispatcher


def entry(kernel, arguments):
    """Machine code of a kernel for arguments of the same types."""
    return kernel.dispatcher.compile(tuple(map(numba.typeof, arguments)))


struct_types.array_type = borrowed_arrays.BorrowedArray
struct_types.array_value = borrowed_arrays.array_value


@typeof_impl.register(Kernel)
def _type_of_kernel(kernel, context):
    return InnerFunction(kernel.inner)


@typeof_impl.register(Choice)
def _type_of_choice(choice, context):
    return ChoiceType(choice.name, {cls: each.inner for cls, each in choice.table.items()})
