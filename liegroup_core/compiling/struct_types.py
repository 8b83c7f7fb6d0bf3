# SPDX-License-Identifier: Apache-2.0
"""Numba type of Structs, implemented by Numba's extension API.

Numba unpacks a tuple of arrays at every call from Python and copies it into every kernel that it is passed
to. Of a Struct, a kernel gets only the address, and loads the fields that it uses from there.
A Struct is a sequence of 64-bit words: address and shape of each array, value of each number,
address of the words of each Struct.
"""

import dataclasses
import functools
import hashlib

import numpy as np
from llvmlite import ir
from numba.core import types
from numba.core.datamodel import models
from numba.core.typing.templates import AttributeTemplate
from numba.extending import NativeValue, infer_getattr, lower_getattr_generic, register_model, typeof_impl, unbox
from numba.np.numpy_support import from_dtype

from .structs import Struct

WORD = ir.IntType(64)


def text(kind):
    """Text that identifies a type, the same in every process."""
    if isinstance(kind, StructType):
        return f"{kind} {[(name, word, text(field)) for name, word, field in kind.key[1]]}"
    return str(kind)


def digest(*parts):
    """Short hash of texts."""
    return hashlib.sha256(" ".join(parts).encode()).hexdigest()[:16]


def native_array(dtype, ndim):
    """Numba's own type of a C-contiguous array."""
    return types.Array(dtype, ndim, "C")


DATA, SHAPE, STRIDES = 4, 5, 6  # members of Numba's model of an array


def native_value(context, builder, kind, data, shape):
    """LLVM value of an array of Numba's own type, without an owner."""
    size = ir.Constant(WORD, context.get_abi_sizeof(context.get_data_type(kind.dtype)))
    strides = [size]
    for length in shape[:0:-1]:
        strides.insert(0, builder.mul(strides[0], length))
    count = shape[0]
    for length in shape[1:]:
        count = builder.mul(count, length)
    array = ir.Constant(context.get_data_type(kind), None)
    pointer = builder.inttoptr(data, array.type.elements[DATA])
    for member, value in enumerate((count, size, pointer), start=2):
        array = builder.insert_value(array, value, member)
    for axis in range(kind.ndim):
        array = builder.insert_value(array, shape[axis], (SHAPE, axis))
        array = builder.insert_value(array, strides[axis], (STRIDES, axis))
    return array


# Type of the arrays in Structs, and the function that makes their values.
array_type, array_value = native_array, native_value


# Cached: constructing the type of every field each time took half of the time to build a Simulation.
@functools.lru_cache(maxsize=None)
def _array_type(make, dtype, ndim):
    return make(from_dtype(dtype), ndim)


class StructType(types.Type):
    """Type of a Struct: its class; name, first word and type of each field."""

    def __init__(self, cls, fields):
        self.instance_class, self._fields = cls, fields
        self.fields = {name: (word, kind) for name, word, kind in fields}
        super().__init__(f"{cls.__module__}.{cls.__name__}")

    @property
    def size(self):
        """Size of the words in bytes."""
        return 8 * sum(1 + getattr(kind, "ndim", 0) for _, _, kind in self._fields)

    @property
    def key(self):
        return self.instance_class, self._fields

    def __hash__(self):
        # Hashing all nested fields would take longer than many kernels.
        return hash((self.instance_class, len(self._fields)))

    @property
    def mangling_args(self):
        return self.instance_class.__name__, (digest(text(self)),)


register_model(StructType)(models.OpaqueModel)


def words(struct):
    """Numba type and array of the words of a Struct."""
    numbers, fields = [], []
    for field in dataclasses.fields(struct):
        kind, values = _words_of(getattr(struct, field.name))
        fields.append((field.name, len(numbers), kind))
        numbers += values
    return StructType(type(struct), tuple(fields)), np.array(numbers, dtype=np.uint64)


def _words_of(value):
    """Numba type and words of the value of a field."""
    if isinstance(value, np.ndarray):
        kind = _array_type(array_type, value.dtype, value.ndim)
        return kind, [value.__array_interface__["data"][0], *value.shape]
    if isinstance(value, Struct):
        return value.numba_type, [value.address]
    if isinstance(value, (bool, np.bool_)):
        return types.boolean, [int(value)]
    if isinstance(value, (int, np.integer)):
        return types.int64, [int(np.int64(value).view(np.uint64))]
    return types.float64, [int(np.float64(value).view(np.uint64))]


@typeof_impl.register(Struct)
def _type_of(struct, context):
    return struct.numba_type


@unbox(StructType)
def _unbox(kind, struct, c):
    address = c.pyapi.object_getattr_string(struct, "address")
    pointer = c.pyapi.long_as_voidptr(address)
    c.pyapi.decref(address)
    return NativeValue(pointer)


@infer_getattr
class _Fields(AttributeTemplate):
    key = StructType

    def generic_resolve(self, kind, name):
        return kind.fields[name][1] if name in kind.fields else None


@lower_getattr_generic(StructType)
def _load(context, builder, struct, pointer, name):
    """LLVM value of a field. Words never change, so loads may be moved and merged."""
    first, kind = struct.fields[name]

    def word(number, of=WORD):
        words = builder.bitcast(pointer, of.as_pointer())
        value = builder.load(builder.gep(words, [ir.Constant(WORD, first + number)]))
        value.set_metadata("invariant.load", builder.module.add_metadata([]))
        return value

    if isinstance(kind, types.Array):
        return array_value(context, builder, kind, word(0), [word(1 + axis) for axis in range(kind.ndim)])
    if isinstance(kind, StructType):
        inner = word(0, pointer.type)
        for name, number in (("dereferenceable", kind.size), ("align", 8)):
            inner.set_metadata(name, builder.module.add_metadata([ir.Constant(WORD, number)]))
        return inner
    if kind == types.float64:
        return word(0, ir.DoubleType())
    return builder.trunc(word(0), ir.IntType(1)) if kind == types.boolean else word(0)
