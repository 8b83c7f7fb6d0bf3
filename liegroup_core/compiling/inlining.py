# SPDX-License-Identifier: Apache-2.0
"""Kernels compiled with inner parts of Numba replaced: optimised and translated once.

By default, Numba optimises every function and translates it to machine code before a caller inlines
it, and repeats both with the caller. For kernels ten calls deep, that was two thirds of the compile
time. Here an inlined function stays LLVM code that is only simplified. Only the outermost function,
which Python calls, is optimised, together with all functions inlined in it. A function is also not
compiled again for every constant argument: LLVM sees the constant where it inlines the call.

A long function with several callers (the linear solver) becomes machine code of its own. Its
callers call it by a symbol.

Replaced: three steps of a code library, one compiler pass, the type of a function, and the handling
of damaged cache files. The package's README.md states what is assumed of Numba.
"""

import hashlib
import inspect
import logging
from contextlib import contextmanager
from dataclasses import dataclass

import numba
from llvmlite import binding, ir
from numba import njit
from numba.core import cgutils, types
from numba.core.base import BaseContext
from numba.core.caching import FunctionCache
from numba.core.codegen import CPUCodegen, JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.compiler_machinery import register_pass
from numba.core.datamodel import models
from numba.core.imputils import lower_constant
from numba.core.ir import Return
from numba.core.lowering import Lower
from numba.core.typed_passes import NativeLowering
from numba.extending import intrinsic, register_model, typeof_impl
from numba.np import arrayobj

from . import borrowed_arrays, struct_types
from .cache import cache_folder
from .kernels import Choice, Kernel
from .struct_types import StructType

log = logging.getLogger("liegroup_core")

name = "inlining"
words = struct_types.words
OPTIONS = {"nogil": True, "error_model": "numpy"}

X86 = binding.get_process_triple().split("-")[0] in ("x86_64", "i686", "i386")
WORD32 = ir.IntType(32)
FLUSH_TO_ZERO_AND_DENORMALS_ARE_ZERO = ir.Constant(WORD32, 0x8040)  # bits of MXCSR


class _Library(JITCodeLibrary):
    """Function whose LLVM code is only simplified before callers inline it.

    Optimising its loops is useless while the constants of the callers are unknown.
    """

    def _optimize_functions(self, ll_module):
        ll_module.data_layout = self._codegen._data_layout
        passes = binding.create_new_function_pass_manager()
        passes.add_sroa_pass()
        passes.add_simplify_cfg_pass()
        passes.add_instruction_combine_pass()
        for function in ll_module.functions:
            passes.run(function, self._codegen._pass_builder())


class _InnerLibrary(_Library):
    """LLVM code for callers, without machine code."""

    def _optimize_final_module(self):
        """Left to the outermost function."""

    def _finalize_final_module(self):
        self._finalize_dynamic_globals()
        self._finalized = True


class _OuterLibrary(_Library):
    """Machine code of a function with all functions inlined in it.

    Inlining comes first, otherwise functions are optimised repeatedly. The optimiser runs once.
    Numba runs it twice to prune reference counts in between, but kernels have none.
    """

    def _optimize_final_module(self):
        inline = binding.create_new_module_pass_manager()
        inline.add_always_inliner_pass()
        inline.add_global_dead_code_eliminate_pass()
        passes, builder = self._codegen._module_pass_manager()
        inline.run(self._final_module, builder)
        passes.run(self._final_module, builder)


class _Lower(Lower):
    """Mark Structs as dereferenceable, so that LLVM moves loads out of loops."""

    def setup_function(self, fndesc):
        super().setup_function(fndesc)
        sizes = {
            f"arg.{name}": kind.size
            for name, kind in zip(fndesc.args, fndesc.argtypes)
            if isinstance(kind, StructType)
        }
        for argument in self.function.args:
            if argument.name in sizes:
                argument.attributes.dereferenceable = sizes[argument.name]
                argument.attributes.align = 8


class _FlushingLower(_Lower):
    """Flush subnormal numbers to zero on x86 while the function runs (kernels.stepper).

    An exception would leave the mode on. Kernels raise none, except with NUMBA_BOUNDSCHECK=1.
    """

    def pre_lower(self):
        super().pre_lower()
        if X86:
            self._given = self._control("stmxcsr", cgutils.alloca_once(self.builder, WORD32))
            flushing = cgutils.alloca_once(self.builder, WORD32)
            self.builder.store(
                self.builder.or_(
                    self.builder.load(self._given), FLUSH_TO_ZERO_AND_DENORMALS_ARE_ZERO
                ),
                flushing,
            )
            self._control("ldmxcsr", flushing)

    def lower_inst(self, inst):
        if X86 and isinstance(inst, Return):
            self._control("ldmxcsr", self._given)
        super().lower_inst(inst)

    def _control(self, instruction, place):
        """Store or load the control word of the floating-point unit (MXCSR)."""
        byte = ir.IntType(8).as_pointer()
        function = cgutils.get_or_insert_function(
            self.module, ir.FunctionType(ir.VoidType(), [byte]), f"llvm.x86.sse.{instruction}"
        )
        self.builder.call(function, [self.builder.bitcast(place, byte)])
        return place


@register_pass(mutates_CFG=True, analysis_only=False)
class _InnerLowering(NativeLowering):
    _name = "inner_lowering"
    lowering_class = _Lower

    def run_pass(self, state):
        state.library = _InnerLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
        state.flags.no_compile = True
        super().run_pass(state)
        lowered = state["cr"]
        entry = [].append  # no entry point: a unique key of the type that Numba expects
        state.targetctx.insert_user_function(entry, lowered.fndesc, [state.library])
        state["cr"] = lowered._replace(cfunc=entry)
        return True


@register_pass(mutates_CFG=True, analysis_only=False)
class _OuterLowering(NativeLowering):
    _name = "outer_lowering"
    lowering_class = _Lower

    def run_pass(self, state):
        state.library = _OuterLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        return super().run_pass(state)


@register_pass(mutates_CFG=True, analysis_only=False)
class _FlushingLowering(_OuterLowering):
    _name = "flushing_lowering"
    lowering_class = _FlushingLower


class _Inner(Compiler):
    lowering = _InnerLowering

    def define_pipelines(self):
        managers = super().define_pipelines()
        for manager in managers:
            manager.passes = [
                (self.lowering if each is NativeLowering else each, text)
                for each, text in manager.passes
            ]
            manager.finalize()
        return managers


class _Outer(_Inner):
    lowering = _OuterLowering


class _Flushing(_Inner):
    lowering = _FlushingLowering


def _inner(function, always):
    """Dispatcher of a function for compiled callers; always: inline it into them."""
    return njit(
        **OPTIONS,
        forceinline=always,
        pipeline_class=_Inner,
        no_cpython_wrapper=True,
        no_cfunc_wrapper=True,
    )(function)


class _Cache(FunctionCache):
    """Disk cache: unreadable files are replaced, files that cannot be written are omitted."""

    warned = False

    def load_overload(self, *arguments):
        try:
            return super().load_overload(*arguments)
        except Exception:  # a truncated or corrupt file can raise any exception
            with self._forgiving():
                self.flush()
            return None

    def save_overload(self, *arguments):
        with self._forgiving():
            super().save_overload(*arguments)

    @contextmanager
    def _forgiving(self):
        try:
            yield
        except OSError as error:
            if not _Cache.warned:
                _Cache.warned = True
                log.warning(
                    "Compiled kernels cannot be cached, so every start compiles them again: %s: %s",
                    self.cache_path,
                    error.strerror,
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
        text = f"{self.function.dispatcher.__qualname__} {self.arguments}"
        return f"liegroup_core.{hashlib.sha256(text.encode()).hexdigest()[:16]}"

    def __call__(self):
        dispatcher = self.function.dispatcher
        dispatcher.compile(self.arguments)
        compiled = dispatcher.overloads[self.arguments]
        if compiled.signature.return_type != types.int64:
            raise TypeError(f"{dispatcher.__qualname__} must return an integer")
        binding.add_symbol(
            self.name,
            compiled.library.get_pointer_to_function(compiled.fndesc.llvm_cfunc_wrapper_name),
        )


def _shared(kernel):
    """Dispatcher for compiled callers that calls the machine code of the function for Python."""

    @intrinsic
    def call(typing_context, given):
        symbol = _Symbol(kernel, tuple(map(types.unliteral, given)))
        symbol()

        def codegen(context, builder, signature, values):
            numbers = [
                context.cast(builder, value, kind, wanted)
                for value, kind, wanted in zip(
                    cgutils.unpack_tuple(builder, values[0]), given, symbol.arguments
                )
            ]
            function = cgutils.get_or_insert_function(
                builder.module,
                ir.FunctionType(ir.IntType(64), [each.type for each in numbers]),
                symbol.name,
            )
            context.active_code_library._reload_init.add(symbol)
            return builder.call(function, numbers)

        return types.int64(given), codegen

    def stub(*given):
        return call(given)

    return _inner(stub, True)


class InnerFunction(types.Dispatcher):
    """Type of a function for compiled callers: constant arguments do not compile it again.

    LLVM sees the constants where it inlines the function.
    """

    def get_call_type(self, context, args, kws):
        return super().get_call_type(context, tuple(map(types.unliteral, args)), kws)


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
        return InnerFunction(self._table[arguments[0].instance_class])

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
    return cache_folder(f"{name} {numba.__version__} {numba.config.BOUNDSCHECK}")


def for_python(kernel):
    """Dispatcher of a kernel for Python."""
    # The setting of other packages in the process is restored: they have their own cache folder.
    before = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = str(cache() or "")
    try:
        pipeline = _Flushing if kernel.role == "stepper" else _Outer
        dispatcher = njit(**OPTIONS, pipeline_class=pipeline)(kernel.function)
        if cache() is not None:
            dispatcher._cache = _Cache(kernel.function)
        return dispatcher
    finally:
        numba.config.CACHE_DIR = before


def for_kernels(kernel):
    """Dispatcher of a kernel for compiled callers."""
    if kernel.role == "shared":
        return _shared(kernel)
    return _inner(kernel.function, always=kernel.role != "subroutine")


def callable(kernel):
    return kernel.dispatcher


def entry(kernel, arguments):
    """Machine code of a kernel for arguments of the types of these."""
    return kernel.dispatcher.compile(tuple(map(numba.typeof, arguments)))


struct_types.array_type = borrowed_arrays.BorrowedArray


@typeof_impl.register(Kernel)
def _type_of_kernel(kernel, context):
    return InnerFunction(kernel.inner)


@typeof_impl.register(Choice)
def _type_of_choice(choice, context):
    return ChoiceType(choice.name, {cls: each.inner for cls, each in choice.table.items()})


# Inner parts that are overridden or called, with their parameters.
ASSUMED = {
    JITCodeLibrary: {
        "__init__": "self codegen name",
        "_optimize_functions": "self ll_module",
        "_optimize_final_module": "self",
        "_finalize_final_module": "self",
        "_finalize_dynamic_globals": "self",
        "enable_object_caching": "self",
        "get_pointer_to_function": "self name",
    },
    CPUCodegen: {"_module_pass_manager": "self kwargs", "_pass_builder": "self kwargs"},
    Lower: {"setup_function": "self fndesc", "pre_lower": "self", "lower_inst": "self inst"},
    NativeLowering: {"run_pass": "self state"},
    Compiler: {"define_pipelines": "self"},
    BaseContext: {
        "insert_user_function": "self func fndesc libs",
        "get_dummy_value": "self",
        "cast": "self builder val fromty toty",
    },
    types.Dispatcher: {
        "get_call_type": "self context args kws",
        "get_call_signatures": "self",
        "get_impl_key": "self sig",
    },
    FunctionCache: {
        "__init__": "self py_func",
        "load_overload": "self sig target_context",
        "save_overload": "self sig data",
        "flush": "self",
    },
    cgutils: {
        "get_or_insert_function": "module fnty name",
        "unpack_tuple": "builder tup count",
        "alloca_once": "builder ty size name zfill",
        "do_boundscheck": "context builder ind dimlen axis",
    },
    arrayobj: {
        "getitem_array_tuple": "context builder sig args",
        "getitem_arraynd_intp": "context builder sig args",
        "setitem_array": "context builder sig args",
        "load_item": "context builder arrayty ptr",
        "store_item": "context builder arrayty val ptr",
    },
    binding: {
        "create_new_function_pass_manager": "",
        "create_new_module_pass_manager": "",
        "add_symbol": "name address",
    },
}


def check_signatures():
    """Raise TypeError if a part in ASSUMED is missing or has other parameters."""
    for owner, parts in ASSUMED.items():
        for part, expected in parts.items():
            function = getattr(owner, part, None)
            text = f"{owner.__name__}.{part}"
            if function is None:
                raise TypeError(f"{text} is missing")
            parameters = " ".join(inspect.signature(function).parameters)
            if parameters != expected:
                raise TypeError(f"{text} takes ({parameters}), expected ({expected})")
