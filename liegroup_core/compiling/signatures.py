# SPDX-License-Identifier: Apache-2.0
"""Types of built-in functions that remember the signatures that Numba has found for them."""

import operator

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


class Typing:
    """Numba's typing context with built-in functions that remember their signatures."""

    _operators = {}

    def __init__(self, context):
        self._context = context

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
