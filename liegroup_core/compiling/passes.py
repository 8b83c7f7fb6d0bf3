# SPDX-License-Identifier: Apache-2.0
"""Passes of the compiler: those of Numba that kernels need, and those that are replaced."""

import functools

from llvmlite import binding, ir
from numba.core import cgutils
from numba.core.base import BaseContext
from numba.core.compiler import Compiler
from numba.core.compiler_machinery import register_pass
from numba.core.ir import Return
from numba.core.ir_utils import build_definitions
from numba.core.lowering import Lower
from numba.core.ssa import reconstruct_ssa
from numba.core.typed_passes import NativeLowering, NopythonTypeInference, PreLowerStripPhis
from numba.core.untyped_passes import ReconstructSSA

from .libraries import InnerLibrary, OuterLibrary
from .signatures import Typing
from .struct_types import StructType
from .undisturbed import check_end

# Passes of Numba's compiler for features that kernels do not use: closures, generators, expressions of
# whole arrays, functions that are typed by values, parallel loops, annotated listings.
# IRProcessing finds control flow and lifetimes, which GenericRewrites does again.
OMITTED = {
    "IRProcessing",
    "WithLifting",
    "InlineClosureLikes",
    "RewriteSemanticConstants",
    "DeadBranchPrune",
    "RewriteDynamicRaises",
    "MakeFunctionToJitFunction",
    "InlineInlinables",
    "FindLiterallyCalls",
    "LiteralUnroll",
    "LiteralPropagationSubPipelinePass",
    "InlineOverloads",
    "NopythonRewrites",
    "NoPythonSupportedFeatureValidation",
    "AnnotateTypes",
    "DumpParforDiagnostics",
}

X86 = binding.get_process_triple().split("-")[0] in ("x86_64", "i686", "i386")
WORD32 = ir.IntType(32)
FLUSH_TO_ZERO_AND_DENORMALS_ARE_ZERO = ir.Constant(WORD32, 0x8040)  # bits of MXCSR


# Cached, because Numba writes a module and lets LLVM parse it each time it needs the size of a type.
_size = functools.cache(BaseContext.get_abi_sizeof)


class _Lower(Lower):
    """Mark Structs as dereferenceable, so that LLVM moves loads out of loops.

    Values without counted references are skipped when references are counted.
    """

    _counted = {}

    def __init__(self, context, *arguments, **options):
        typing, size = Typing(context.typing_context), functools.partial(_size, context)
        context = context.subtarget(typing_context=typing, get_abi_sizeof=size)
        super().__init__(context, *arguments, **options)

    def _counts(self, kind):
        if kind not in self._counted:
            model = self.context.data_model_manager[kind]
            self._counted[kind] = model.contains_nrt_meminfo()
        return self._counted[kind]

    def incref(self, typ, val):
        if self._counts(typ):
            super().incref(typ, val)

    def decref(self, typ, val):
        if self._counts(typ):
            super().decref(typ, val)

    def delvar(self, name):
        if self._counts(self.typeof(name)):
            super().delvar(name)

    def setup_function(self, fndesc):
        super().setup_function(fndesc)
        sizes = {
            f"arg.{name}": kind.size for name, kind in zip(fndesc.args, fndesc.argtypes) if isinstance(kind, StructType)
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
                self.builder.or_(self.builder.load(self._given), FLUSH_TO_ZERO_AND_DENORMALS_ARE_ZERO), flushing
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


@register_pass(mutates_CFG=False, analysis_only=False)
class _InnerLowering(NativeLowering):
    _name = "inner_lowering"
    lowering_class = _Lower

    def run_pass(self, state):
        state.library = InnerLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
        state.flags.no_compile = True
        super().run_pass(state)
        lowered = state["cr"]
        entry = [].append  # no entry point: a unique key of the type that Numba expects
        state.targetctx.insert_user_function(entry, lowered.fndesc, [state.library])
        state["cr"] = lowered._replace(cfunc=entry)
        return True


@register_pass(mutates_CFG=False, analysis_only=False)
class _OuterLowering(NativeLowering):
    _name = "outer_lowering"
    lowering_class = _Lower

    def run_pass(self, state):
        state.library = OuterLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        return super().run_pass(state)


@register_pass(mutates_CFG=False, analysis_only=False)
class _FlushingLowering(_OuterLowering):
    _name = "flushing_lowering"
    lowering_class = _FlushingLower


@register_pass(mutates_CFG=False, analysis_only=False)
class _TypeInference(NopythonTypeInference):
    _name = "type_inference"

    def run_pass(self, state):
        state.typingctx = Typing(state.typingctx)
        return super().run_pass(state)


# Numba finds the lifetimes of all variables after each of the next two passes. They are used
# only after IRLegalization, which finds them again.


@register_pass(mutates_CFG=True, analysis_only=False)
class _SingleAssignment(ReconstructSSA):
    _name = "single_assignment"

    def run_pass(self, state):
        state.func_ir = reconstruct_ssa(state.func_ir)
        self._patch_locals(state)
        state.func_ir._definitions = build_definitions(state.func_ir.blocks)
        return True


@register_pass(mutates_CFG=False, analysis_only=False)
class _NoPhis(PreLowerStripPhis):
    _name = "no_phis"

    def run_pass(self, state):
        state.func_ir = self._strip_phi_nodes(state.func_ir)
        state.func_ir._definitions = build_definitions(state.func_ir.blocks)
        return True


class InnerCompiler(Compiler):
    lowering = _InnerLowering

    def define_pipelines(self):
        check_end()
        managers = super().define_pipelines()
        own = {
            NativeLowering: self.lowering,
            NopythonTypeInference: _TypeInference,
            PreLowerStripPhis: _NoPhis,
            ReconstructSSA: _SingleAssignment,
        }
        for manager in managers:
            manager.passes = [
                (own.get(each, each), text) for each, text in manager.passes if each.__name__ not in OMITTED
            ]
            manager.finalize()
        return managers


class OuterCompiler(InnerCompiler):
    lowering = _OuterLowering


class Flushing(InnerCompiler):
    lowering = _FlushingLowering
