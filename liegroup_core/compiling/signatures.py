# SPDX-License-Identifier: Apache-2.0
"""Types of built-in functions that remember the signatures that Numba has found for them."""

import operator
from contextlib import nullcontext

from numba.core import types
from numba.core.datamodel import models
from numba.extending import register_model


class Operator(types.Function):
    """Type of a built-in function that finds the signature for given types only once.

    Otherwise Numba tries all definitions of `+` at every sum, in the same order, twice.
    """

    def __init__(self, function):
        self._found = {}
        super().__init__(function.templates)

    def get_call_type(self, context, args, kws):
        if kws:
            return super().get_call_type(context, args, kws)
        if args not in self._found:
            self._found[args] = super().get_call_type(context, args, kws)
        return self._found[args]


class _Calls:
    """Stack of the functions that are being typed, which do not collect warnings.

    To collect them, Numba changes and restores Python's warning filters at every assignment.
    """

    def __init__(self, calls):
        self._calls = calls

    def __getattr__(self, name):
        return getattr(self._calls, name)

    def __getitem__(self, index):
        return self._calls[index]

    def __len__(self):
        return len(self._calls)

    def register(self, target, inference, *function):
        inference.warnings.catch_warnings = self._nothing
        return self._calls.register(target, inference, *function)

    @staticmethod
    def _nothing(**place):
        return nullcontext()


class Typing:
    """Numba's typing context with built-in functions that remember their signatures."""

    _operators = {}

    def __init__(self, context):
        self._context, self.callstack = context, _Calls(context.callstack)

    def __getattr__(self, name):
        return getattr(self._context, name)

    def resolve_value_type(self, value):
        return self._remembering(self._context.resolve_value_type(value))

    def resolve_function_type(self, function, args, kws):
        if function is operator.getitem:
            return self.resolve_value_type(function).get_call_type(self._context, args, kws)
        return self._context.resolve_function_type(function, args, kws)

    def resolve_setitem(self, target, index, value):
        function = self.resolve_value_type(operator.setitem)
        return function.get_call_type(self._context, (target, index, value), {})

    def _remembering(self, kind):
        if type(kind) is not types.Function:
            return kind
        if kind not in self._operators:
            self._operators[kind] = Operator(kind)
        return self._operators[kind]


register_model(Operator)(models.OpaqueModel)
