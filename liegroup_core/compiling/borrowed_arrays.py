# SPDX-License-Identifier: Apache-2.0
"""Arrays without reference counts, and faster access to their elements."""

import operator

from llvmlite import ir
from numba.core import cgutils, types
from numba.core.datamodel import models
from numba.core.errors import TypingError
from numba.core.registry import cpu_target
from numba.extending import NativeValue, box, intrinsic, lower_builtin, register_model, typeof_impl, unbox
from numba.np import arrayobj

from .struct_types import WORD, digest, native_array, native_value, text
from .structs import Borrowed

DATA, SHAPE = 0, 1  # members of the model of an array


def array_value(context, builder, kind, data, shape):
    """LLVM value of an array: its address and shape."""
    array = ir.Constant(context.get_data_type(kind), None)
    pointer = builder.inttoptr(data, array.type.elements[DATA])
    array = builder.insert_value(array, pointer, DATA)
    for axis in range(kind.ndim):
        array = builder.insert_value(array, shape[axis], (SHAPE, axis))
    return array


class BorrowedArray(types.Array):
    """Type of a C-contiguous array whose references are not counted: its owner is elsewhere.

    It consists of address and shape only, which shortens the code of every access.
    """

    def __init__(self, dtype, ndim):
        super().__init__(dtype, ndim, "C", name=f"borrowed({dtype}, {ndim}d)")

    @property
    def mangling_args(self):
        return "borrowed", (digest(text(self.dtype)), self.ndim)


@register_model(BorrowedArray)
class _BorrowedArrayModel(models.StructModel):
    def __init__(self, manager, kind):
        shape = types.UniTuple(types.intp, kind.ndim)
        super().__init__(manager, kind, [("data", types.CPointer(kind.dtype)), ("shape", shape)])


@box(BorrowedArray)
def _to_python(kind, array, c):
    """NumPy's view of the memory; the owner must outlive it."""
    native = native_array(kind.dtype, kind.ndim)
    data = c.builder.ptrtoint(c.builder.extract_value(array, DATA), WORD)
    shape = cgutils.unpack_tuple(c.builder, c.builder.extract_value(array, SHAPE))
    return c.box(native, native_value(c.context, c.builder, native, data, shape))


@unbox(BorrowedArray)
def _not_from_python(kind, array, c):
    c.pyapi.err_set_string("PyExc_TypeError", "a borrowed array can only be passed from kernel to kernel")
    return NativeValue(ir.Constant(c.context.get_value_type(kind), None), is_error=cgutils.true_bit)


def _element(context, builder, kind, array, index_type, index):
    """Address of an element. Subarrays are not supported.

    Negative indices are not supported: testing for them took a third of the time of a step. With
    NUMBA_BOUNDSCHECK=1 they raise IndexError.
    """
    kinds, indices = [index_type], [index]
    if isinstance(index_type, types.BaseTuple):
        kinds, indices = index_type.types, cgutils.unpack_tuple(builder, index)
    if len(kinds) < kind.ndim or not all(isinstance(each, types.Integer) for each in kinds):
        raise TypingError(f"{index_type} does not select an element of {kind}")
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
    return arrayobj.load_item(context, builder, kind, address)


@lower_builtin(operator.setitem, BorrowedArray, types.Any, types.Any)
def _set(context, builder, signature, arguments):
    kind, index_type, value_type = signature.args
    address = _element(context, builder, kind, arguments[0], index_type, arguments[1])
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
        shape = cgutils.unpack_tuple(builder, given.shape)
        return array_value(context, builder, kind, builder.ptrtoint(given.data, WORD), shape)

    return kind(array), codegen


@typeof_impl.register(Borrowed)
def _type_of_borrowed(borrowed, context):
    return cpu_target.typing_context.resolve_value_type(_borrow)
