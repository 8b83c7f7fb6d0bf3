# SPDX-License-Identifier: Apache-2.0
"""What kernels read in place: a Struct, and arrays whose references nobody counts.

A tuple of arrays would be taken apart at every call from Python, and copied into every kernel that
it is handed to. Of a Struct a kernel gets the address, and loads from there what it uses.
"""

import dataclasses
import functools
import hashlib
import operator

import numpy as np

from .presence import compiled


class Struct:
    """Base of classes of arrays, numbers and other Structs under names, for kernels to read.

    A class of it is a dataclass with these as its fields. Arrays are C-contiguous and their
    contents may change; a field is never set anew, see `replace`.
    """

    def __init_subclass__(cls):
        dataclasses.dataclass(frozen=True, eq=False)(cls)

    def __post_init__(self):
        if compiled():
            self._lay_out()

    def replace(self, **changes):
        """The same with other values in some fields."""
        return dataclasses.replace(self, **changes)

    def __reduce__(self):
        return type(self), self.values()  # a copy has addresses of its own

    def values(self):
        """Its fields in their order."""
        return tuple(getattr(self, field.name) for field in dataclasses.fields(self))

    def _lay_out(self):
        """Write down for kernels, a word of memory each: addresses and shapes of arrays, numbers.

        numba_type : StructType, which knows where each field is
        address    : of the words
        """
        words, fields = [], []
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            kind, found = _words_of(value, f"{type(self).__name__}.{field.name}")
            fields.append((field.name, len(words), kind))
            words += found
        memory = np.array(words, dtype=np.uint64)
        # Frozen for others; the words must live as long as the Struct.
        self.__dict__.update(
            numba_type=StructType(type(self), tuple(fields)),
            _memory=memory,
            address=memory.ctypes.data,
        )


if compiled():
    from llvmlite import ir
    from numba.core import cgutils, types
    from numba.core.datamodel import models
    from numba.core.errors import TypingError
    from numba.core.typing.templates import AttributeTemplate
    from numba.extending import (
        NativeValue,
        infer_getattr,
        intrinsic,
        lower_builtin,
        lower_getattr_generic,
        register_model,
        typeof_impl,
        unbox,
    )
    from numba.np import arrayobj
    from numba.np.numpy_support import from_dtype

    WORD = ir.IntType(64)

    def _digest(kind):
        """Short text for a type within the names of functions: the same in every process."""
        return hashlib.sha256(str(kind).encode()).hexdigest()[:8]

    class BorrowedArray(types.Array):
        """Type of an array that somebody else keeps alive: its references are not counted."""

        def __init__(self, dtype, ndim):
            super().__init__(dtype, ndim, "C")

        @property
        def mangling_args(self):
            return "borrowed", (_digest(self.dtype), self.ndim)

    # Made for every field of every Struct, and slow to make: half of what a Simulation costs.
    @functools.lru_cache(maxsize=None)
    def _borrowed_array(dtype, ndim):
        return BorrowedArray(from_dtype(dtype), ndim)

    DATA, SHAPE, STRIDES = 4, 5, 6  # members of an array below

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
        """Address of an element; None for an index that stands for several.

        Kernels count from the front: asking of every index whether it counts from the end took a
        third of a step. With NUMBA_BOUNDSCHECK=1 one that does raises IndexError.
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

    class StructType(types.Type):
        """Type of a Struct: its class, and name, first word and type of each field."""

        def __init__(self, cls, fields):
            self.instance_class, self._fields = cls, fields
            self.fields = {name: (word, kind) for name, word, kind in fields}
            super().__init__(f"{cls.__module__}.{cls.__name__}")

        @property
        def size(self):
            """Bytes of its words."""
            return 8 * sum(1 + getattr(kind, "ndim", 0) for _, _, kind in self._fields)

        @property
        def key(self):
            return self.instance_class, self._fields

        def __hash__(self):
            # Of all fields and theirs it would take longer than many a kernel.
            return hash((self.instance_class, len(self._fields)))

        @property
        def mangling_args(self):
            return self.instance_class.__name__, (_digest(self._fields),)

    register_model(StructType)(models.OpaqueModel)

    def _words_of(value, name):
        """Numba type of a field, and the words that stand for it."""
        if isinstance(value, np.ndarray):
            if not (value.flags.c_contiguous and value.flags.writeable):
                raise ValueError(f"{name} must be a C-contiguous array that can be written")
            return (
                _borrowed_array(value.dtype, value.ndim),
                [value.__array_interface__["data"][0], *value.shape],
            )
        if isinstance(value, Struct):
            return value.numba_type, [value.address]
        if isinstance(value, (bool, np.bool_)):
            return types.boolean, [int(value)]
        if isinstance(value, (int, np.integer)):
            return types.int64, [int(np.int64(value).view(np.uint64))]
        if isinstance(value, (float, np.floating)):
            return types.float64, [int(np.float64(value).view(np.uint64))]
        raise TypeError(f"{name} is nothing that kernels read: {value!r}")

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
        """LLVM value of a field. Words never change: what they say may be kept in registers."""
        first, kind = struct.fields[name]

        def word(number, of=WORD):
            words = builder.bitcast(pointer, of.as_pointer())
            value = builder.load(builder.gep(words, [ir.Constant(WORD, first + number)]))
            value.set_metadata("invariant.load", builder.module.add_metadata([]))
            return value

        if isinstance(kind, BorrowedArray):
            return _array(
                context, builder, kind, word(0), [word(1 + axis) for axis in range(kind.ndim)]
            )
        if isinstance(kind, StructType):
            inner = word(0, pointer.type)
            for name, number in (("dereferenceable", kind.size), ("align", 8)):
                inner.set_metadata(name, builder.module.add_metadata([ir.Constant(WORD, number)]))
            return inner
        if kind == types.float64:
            return word(0, ir.DoubleType())
        return builder.trunc(word(0), ir.IntType(1)) if kind == types.boolean else word(0)

    def _array(context, builder, kind, data, shape):
        """LLVM value of a BorrowedArray."""
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

    @lower_builtin(len, BorrowedArray)
    def _length(context, builder, signature, arguments):
        return builder.extract_value(arguments[0], (SHAPE, 0))

    @intrinsic
    def borrowed(typing_context, array):
        """The same array without reference counts.

        For the entry of a kernel: its caller holds the array until it returns, so counting every
        use of it with atomic operations is in vain; it took three quarters of a step's time.
        """
        if not isinstance(array, types.Array) or array.layout != "C":
            raise TypingError(f"only C-contiguous arrays are borrowed, not {array}")
        kind = BorrowedArray(array.dtype, array.ndim)

        def codegen(context, builder, signature, arguments):
            given = context.make_array(array)(context, builder, arguments[0])
            return _array(
                context,
                builder,
                kind,
                builder.ptrtoint(given.data, WORD),
                cgutils.unpack_tuple(builder, given.shape),
            )

        return kind(array), codegen
else:

    def borrowed(array):
        """The same array; plain Python counts references by itself."""
        return array
