# SPDX-License-Identifier: Apache-2.0
"""Structs: named arrays, numbers and other Structs that kernels read in place."""

import dataclasses

import numpy as np

from .kernels import chosen


class _Once:
    """Attribute that is computed at its first use.

    Unlike cached_property of Python 3.11 it has no lock, because the compiler's thread needs the same
    attributes of other Structs while its caller waits.
    """

    def __init__(self, compute):
        self._compute, self.__doc__ = compute, compute.__doc__

    def __set_name__(self, owner, name):
        self._name = name

    def __get__(self, instance, owner=None):
        if instance is None:
            return self
        return vars(instance).setdefault(self._name, self._compute(instance))


def shaped(*shape):
    """Field of a Struct that `Struct.zeros` allocates: in shaped("bodies", 6) a name stands for a size."""
    return dataclasses.field(metadata={"shape": shape})


class Struct:
    """Base of classes whose fields are arrays, numbers and other Structs, for kernels to read.

    A subclass is a frozen dataclass. Arrays are C-contiguous and writable; their contents may
    change. Fields cannot be assigned: use `replace`.
    """

    def __init_subclass__(cls):
        dataclasses.dataclass(frozen=True, eq=False)(cls)

    def __post_init__(self):
        for field in dataclasses.fields(self):
            value, name = getattr(self, field.name), f"{type(self).__name__}.{field.name}"
            if isinstance(value, np.ndarray):
                if not (value.flags.c_contiguous and value.flags.writeable):
                    raise ValueError(f"{name} must be a C-contiguous array that can be written")
            elif not isinstance(value, (Struct, bool, int, float, np.generic)):
                raise TypeError(f"{name} must be an array, a number or a Struct, got {value!r}")

    @classmethod
    def zeros(cls, sizes, **given):
        """Struct with zeros in its `shaped` fields; sizes: {name: size}; given: the other fields."""
        for field in dataclasses.fields(cls):
            if field.metadata and field.name not in given:
                shape = [sizes.get(size, size) for size in field.metadata["shape"]]
                given[field.name] = np.zeros(shape)
        return cls(**given)

    def replace(self, **changes):
        """Copy with other values in some fields."""
        return dataclasses.replace(self, **changes)

    def __reduce__(self):
        return type(self), self.values()  # a copy has its own addresses

    def values(self):
        """Values of the fields, in order."""
        return tuple(getattr(self, field.name) for field in dataclasses.fields(self))

    @_Once
    def _words(self):
        return chosen().words(self)

    @_Once
    def numba_type(self):
        """StructType with the position of each field."""
        return self._words[0]

    @_Once
    def address(self):
        """Address of the words (struct_types.py). They live as long as the Struct."""
        return self._words[1].ctypes.data


class Record(Struct):
    """Base of Structs of single numbers that kernels read and write: each field is a view (1,) of `numbers`."""

    numbers: np.ndarray  # all of them, in the order of the fields

    def __init_subclass__(cls):
        super().__init_subclass__()
        cls._places = {name: k - 1 for k, name in enumerate(cls.__dataclass_fields__)}

    @classmethod
    def make(cls, numbers=None):
        """Record with these numbers, or zeros."""
        count = len(cls._places) - 1
        numbers = np.zeros(count) if numbers is None else numbers
        return cls(numbers, *(numbers[k : k + 1] for k in range(count)))

    def __reduce__(self):
        return type(self).make, (self.numbers,)

    def part_of(self, first, last):
        """View of the numbers from one field to another."""
        return self.numbers[self._places[first] : self._places[last] + 1]


class Borrowed:
    """Function that returns its argument; in kernels, an array without reference counts.

    For use at the entry of a kernel, whose caller holds the array until the kernel returns. Counting every
    use of it by atomic operations took three quarters of the time of a step.
    """

    def __call__(self, array):
        return array


borrowed = Borrowed()
