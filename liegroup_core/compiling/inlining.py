# SPDX-License-Identifier: Apache-2.0
"""How Numba compiles functions within functions: optimised, and made into machine code, once.

Left alone, Numba optimises every function and makes machine code of it before a caller takes it
in, and does all of that again with the caller. For kernels ten deep that was two thirds of the time
of a compilation. Here a function that others take in stays LLVM code, made smaller and no more, and
only the outermost one, which Python calls, is optimised with all that is in it. Nor is a function
compiled anew for every constant that it is called with: LLVM knows it where it inlines the call.

A function that is long and called by several of those, the solve, is made into machine code of its
own, which they find under a name.

Of Numba's inner parts this replaces three steps of a code library, one compiler pass, the type of a
function, and what is done when the cache on the disk is damaged.
"""

import hashlib
import logging
from contextlib import contextmanager
from dataclasses import dataclass

from llvmlite import binding, ir
from numba import njit
from numba.core import cgutils, types
from numba.core.caching import FunctionCache
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.compiler_machinery import register_pass
from numba.core.datamodel import models
from numba.core.imputils import lower_constant
from numba.core.ir import Return
from numba.core.lowering import Lower
from numba.core.typed_passes import NativeLowering
from numba.extending import intrinsic, register_model

from .structs import StructType

log = logging.getLogger("liegroup_core")

OPTIONS = {"nogil": True, "error_model": "numpy"}

X86 = binding.get_process_triple().split("-")[0] in ("x86_64", "i686", "i386")
WORD32 = ir.IntType(32)
FLUSH_TO_ZERO_AND_DENORMALS_ARE_ZERO = ir.Constant(WORD32, 0x8040)  # bits of MXCSR


class _Library(JITCodeLibrary):
    """A function whose LLVM code is made smaller, and no more, before callers take it in.

    What is done to loops while a caller's constants are not known yet is done in vain.
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
    """LLVM code for callers."""

    def _optimize_final_module(self):
        """The outermost function does it."""

    def _finalize_final_module(self):
        self._finalize_dynamic_globals()
        self._finalized = True


class _OuterLibrary(_Library):
    """Machine code of a function with all that it has taken in.

    Inlined first: optimised before that, functions would be optimised over and over. Once and not
    twice as usual: no references are counted that could be pruned in between.
    """

    def _optimize_final_module(self):
        inline = binding.create_new_module_pass_manager()
        inline.add_always_inliner_pass()
        inline.add_global_dead_code_eliminate_pass()
        passes, builder = self._codegen._module_pass_manager()
        inline.run(self._final_module, builder)
        passes.run(self._final_module, builder)


class _Lower(Lower):
    """Says of Structs that they can be read at any time, so that loads are moved out of loops."""

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
    """While the function runs, x86 takes numbers below 2.2e-308 for zero: see _compile.stepper.

    An exception would leave it so; kernels raise none, but for NUMBA_BOUNDSCHECK=1.
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
        """Store or load the control word of the floating-point unit."""
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
        entry = [].append  # there is none; a key of its own, of the type that Numba expects
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


def inner(function, always):
    """Dispatcher of a function for compiled callers; always: it is inlined into them."""
    return njit(
        **OPTIONS,
        forceinline=always,
        pipeline_class=_Inner,
        no_cpython_wrapper=True,
        no_cfunc_wrapper=True,
    )(function)


class _Cache(FunctionCache):
    """Machine code on the disk; what cannot be read is made anew, what cannot be written is not
    kept.
    """

    told = False

    def load_overload(self, *arguments):
        try:
            return super().load_overload(*arguments)
        except Exception:  # whatever a file that was cut or garbled leads to
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
            if not _Cache.told:
                _Cache.told = True
                log.warning(
                    "compiled kernels cannot be kept, so that every start compiles them "
                    "again: %s: %s",
                    self.cache_path,
                    error.strerror,
                )


def outer(function, cache, flushes):
    """Dispatcher of the same function for Python; flushes: see _compile.stepper."""
    dispatcher = njit(**OPTIONS, pipeline_class=_Flushing if flushes else _Outer)(function)
    if cache:
        dispatcher._cache = _Cache(function)
    return dispatcher


@dataclass(frozen=True)
class _Symbol:
    """Machine code that kernels call by a name: a function for arguments of these types.

    Calling this compiles it, or loads it, and makes the name known. Numba does so before it loads a
    kernel out of the cache that calls it.
    """

    function: object  # a kernel, with the dispatcher of the function for Python
    arguments: tuple

    @property
    def name(self):
        text = f"{self.function.dispatcher.__qualname__} {self.arguments}"
        return f"liegroup_core.{hashlib.sha256(text.encode()).hexdigest()[:16]}"

    def __call__(self):
        dispatcher = self.function.dispatcher
        dispatcher.compile(self.arguments)
        found = dispatcher.overloads[self.arguments]
        if found.signature.return_type != types.int64:
            raise TypeError(f"{dispatcher.__qualname__} must return an integer")
        binding.add_symbol(
            self.name, found.library.get_pointer_to_function(found.fndesc.llvm_cfunc_wrapper_name)
        )


def shared_inner(outer_kernel):
    """Dispatcher for compiled callers that call the machine code which Python calls, too.

    outer_kernel : picklable, with a dispatcher; it returns an int64
    """

    @intrinsic
    def call(typing_context, given):
        symbol = _Symbol(outer_kernel, tuple(map(types.unliteral, given)))
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

    return inner(stub, True)


class InnerFunction(types.Dispatcher):
    """Type of a function for compiled callers: for all numbers of a type it is compiled once.

    LLVM sees the constants among them, where it is inlined.
    """

    def get_call_type(self, context, args, kws):
        return super().get_call_type(context, tuple(map(types.unliteral, args)), kws)


class Chosen(types.Callable, types.Dummy):
    """Type of a function that stands for one of several, as the type of its first argument says.

    table : {class of Struct: inner dispatcher}
    """

    def __init__(self, name, table):
        self._table = table
        super().__init__(f"chosen({name})")

    def _type(self, arguments):
        return InnerFunction(self._table[arguments[0].instance_class])

    def get_call_type(self, context, args, kws):
        return self._type(args).get_call_type(context, args, kws)

    def get_call_signatures(self):
        return (), True

    def get_impl_key(self, sig):
        return self._type(sig.args).get_impl_key(sig)


register_model(InnerFunction)(models.OpaqueModel)
register_model(Chosen)(models.OpaqueModel)


@lower_constant(Chosen)
def _nothing(context, builder, kind, value):
    return context.get_dummy_value()
