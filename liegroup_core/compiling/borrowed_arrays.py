# SPDX-License-Identifier: Apache-2.0
"""Arrays without reference counts, and faster access to their elements."""

import operator

from numba.core import cgutils, types
from numba.core.datamodel import models
from numba.core.errors import TypingError
from numba.core.registry import cpu_target
from numba.extending import intrinsic, lower_builtin, register_model, typeof_impl
from numba.np import arrayobj

from .struct_types import DATA, SHAPE, WORD, array_value, digest
from .structs import Borrowed


class BorrowedArray(types.Array):
    """Type of a C-contiguous array whose references are not counted: its owner is elsewhere."""

    def __init__(self, dtype, ndim):
        super().__init__(dtype, ndim, "C")

    @property
    def mangling_args(self):
        return "borrowed", (digest(self.dtype), self.ndim)


@register_model(BorrowedArray)
class _BorrowedArrayModel(models.StructModel):
    def __init__(self, manager, kind):
        shape = types.UniTuple(types.intp, kind.ndim)
        super().__init__(
            manager,
            kind,
            [
                ("meminfo", types.voidptr),
                ("parent", types.voidptr),
                ("nitems", types.intp),
                ("itemsize", types.intp),
                ("data", types.CPointer(kind.dtype)),
                ("shape", shape),
                ("strides", shape),
            ],
        )


def _element(context, builder, kind, array, index_type, index):
    """Address of an element; None if the index selects a subarray.

    Negative indices are not supported: testing for them took a third of the time of a step. With
    NUMBA_BOUNDSCHECK=1 they raise IndexError.
    """
    kinds, indices = [index_type], [index]
    if isinstance(index_type, types.BaseTuple):
        kinds, indices = index_type.types, cgutils.unpack_tuple(builder, index)
    if len(kinds) < kind.ndim or not all(isinstance(each, types.Integer) for each in kinds):
        return None
    place = None
    for axis, (value, each) in enumerate(zip(indices, kinds)):
        value = context.cast(builder, value, each, types.intp)
        length = builder.extract_value(array, (SHAPE, axis))
        if context.enable_boundscheck:
            cgutils.do_boundscheck(context, builder, value, length, axis)
        place = value if place is None else builder.add(builder.mul(place, length), value)
    return builder.gep(builder.extract_value(array, DATA), [place], inbounds=True)


@lower_builtin(operator.getitem, BorrowedArray, types.Integer)
@lower_builtin(operator.getitem, BorrowedArray, types.BaseTuple)
def _get(context, builder, signature, arguments):
    kind, index_type = signature.args
    address = _element(context, builder, kind, arguments[0], index_type, arguments[1])
    if address is None:
        return (
            arrayobj.getitem_array_tuple(context, builder, signature, arguments)
            if (isinstance(index_type, types.BaseTuple))
            else (arrayobj.getitem_arraynd_intp(context, builder, signature, arguments))
        )
    return arrayobj.load_item(context, builder, kind, address)


@lower_builtin(operator.setitem, BorrowedArray, types.Any, types.Any)
def _set(context, builder, signature, arguments):
    kind, index_type, value_type = signature.args
    address = _element(context, builder, kind, arguments[0], index_type, arguments[1])
    if address is None:
        return arrayobj.setitem_array(context, builder, signature, arguments)
    value = context.cast(builder, arguments[2], value_type, kind.dtype)
    return arrayobj.store_item(context, builder, kind, value, address)


@lower_builtin(len, BorrowedArray)
def _length(context, builder, signature, arguments):
    return builder.extract_value(arguments[0], (SHAPE, 0))


@intrinsic
def _borrow(typing_context, array):
    if not isinstance(array, types.Array) or array.layout != "C":
        raise TypingError(f"only C-contiguous arrays can be borrowed, got {array}")
    kind = BorrowedArray(array.dtype, array.ndim)

    def codegen(context, builder, signature, arguments):
        given = context.make_array(array)(context, builder, arguments[0])
        return array_value(
            context,
            builder,
            kind,
            builder.ptrtoint(given.data, WORD),
            cgutils.unpack_tuple(builder, given.shape),
        )

    return kind(array), codegen


@typeof_impl.register(Borrowed)
def _type_of_borrowed(borrowed, context):
    return cpu_target.typing_context.resolve_value_type(_borrow)
