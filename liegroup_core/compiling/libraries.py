# SPDX-License-Identifier: Apache-2.0
"""LLVM code of kernels: inner functions are only simplified, outer ones optimised once."""

from llvmlite import binding
from numba.core.codegen import JITCodeLibrary


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
            if not function.is_declaration:
                passes.run(function, self._codegen._pass_builder())


class InnerLibrary(_Library):
    """LLVM code for callers, without machine code and without the functions that it calls.

    Callers link the code itself. Numba would make a copy for them to mark its functions in.
    """

    def finalize(self):
        for function in self._final_module.functions:
            if not function.is_declaration and function.linkage == binding.Linkage.external:
                function.linkage = "linkonce_odr"
        self._shared_module = self._final_module
        self._finalized = True


class OuterLibrary(_Library):
    """Machine code of a function with all functions inlined in it.

    Inlining comes first, otherwise functions are optimised repeatedly. The optimiser runs once.
    Numba runs it twice to prune reference counts in between, but kernels have none.
    """

    def finalize(self):
        # Callers before what they call: LLVM links a function only if something needs it by then.
        called_first = {}

        def visit(library):
            for each in library._linking_libraries:
                if each not in called_first:
                    visit(each)
            called_first[library] = None

        visit(self)
        self._linking_libraries = [each for each in reversed(called_first) if each is not self]
        super().finalize()

    def _optimize_final_module(self):
        inline = binding.create_new_module_pass_manager()
        inline.add_always_inliner_pass()
        inline.add_global_dead_code_eliminate_pass()
        passes, builder = self._codegen._module_pass_manager()
        inline.run(self._final_module, builder)
        passes.run(self._final_module, builder)
