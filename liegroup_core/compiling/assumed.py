# SPDX-License-Identifier: Apache-2.0
"""Internals of Numba that `inlining` relies on."""

import inspect

from llvmlite import binding
from numba.core import cgutils, ssa, types
from numba.core.base import BaseContext
from numba.core.caching import NullCache
from numba.core.callconv import CPUCallConv
from numba.core.codegen import CPUCodegen, JITCodeLibrary, JITCPUCodegen
from numba.core.compiler import Compiler, CompileResult
from numba.core.compiler_lock import global_compiler_lock
from numba.core.datamodel import models
from numba.core.dispatcher import Dispatcher
from numba.core.errors import WarningsFixer
from numba.core.lowering import Lower
from numba.core.typed_passes import NativeLowering, NopythonTypeInference, PreLowerStripPhis
from numba.core.typing.context import BaseContext as TypingContext
from numba.core.typing.context import CallStack
from numba.core.untyped_passes import ReconstructSSA
from numba.np import arrayobj

# Internals that are overridden or called, with their parameters.
ASSUMED = {
    JITCodeLibrary: {
        "__init__": "self codegen name",
        "finalize": "self",
        "_optimize_functions": "self ll_module",
        "_optimize_final_module": "self",
        "_finalize_final_module": "self",
        "_finalize_dynamic_globals": "self",
        "enable_object_caching": "self",
        "get_pointer_to_function": "self name",
        "_get_module_for_linking": "self",
    },
    CPUCodegen: {"_module_pass_manager": "self kwargs", "_pass_builder": "self kwargs"},
    Lower: {
        "__init__": "self context library fndesc func_ir metadata",
        "setup_function": "self fndesc",
        "pre_lower": "self",
        "lower_inst": "self inst",
        "incref": "self typ val",
        "decref": "self typ val",
        "delvar": "self name",
    },
    NativeLowering: {"run_pass": "self state"},
    NopythonTypeInference: {"run_pass": "self state"},
    PreLowerStripPhis: {"run_pass": "self state", "_strip_phi_nodes": "self func_ir"},
    ReconstructSSA: {"run_pass": "self state", "_patch_locals": "self state"},
    ssa: {"reconstruct_ssa": "func_ir"},
    CallStack: {"register": "self target typeinfer func_id args"},
    WarningsFixer: {"catch_warnings": "self filename lineno"},
    Compiler: {"define_pipelines": "self"},
    Dispatcher: {"compile": "self sig"},
    type(global_compiler_lock): {"is_locked": "self"},
    BaseContext: {
        "insert_user_function": "self func fndesc libs",
        "subtarget": "self kws",
        "get_abi_sizeof": "self ty",
        "get_dummy_value": "self",
        "cast": "self builder val fromty toty",
    },
    CPUCallConv: {
        "get_function_type": "self restype argtypes",
        "call_function": "self builder callee resty argtys args attrs",
    },
    TypingContext: {
        "resolve_value_type": "self val",
        "resolve_function_type": "self func args kws",
        "resolve_setitem": "self target index value",
    },
    models.DataModel: {"contains_nrt_meminfo": "self"},
    types.Function: {"__init__": "self template", "get_call_type": "self context args kws"},
    types.Dispatcher: {
        "get_call_type": "self context args kws",
        "get_call_signatures": "self",
        "get_impl_key": "self sig",
    },
    NullCache: {"load_overload": "self sig target_context", "save_overload": "self sig cres"},
    CompileResult: {
        "_reduce": "self",
        "_rebuild": (
            "target_context libdata fndesc env signature objectmode lifted typeann reload_init referenced_envs"
        ),
    },
    JITCPUCodegen: {"magic_tuple": "self"},
    cgutils: {
        "get_or_insert_function": "module fnty name",
        "unpack_tuple": "builder tup count",
        "alloca_once": "builder ty size name zfill",
        "do_boundscheck": "context builder ind dimlen axis",
    },
    arrayobj: {"load_item": "context builder arrayty ptr", "store_item": "context builder arrayty val ptr"},
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
