# SPDX-License-Identifier: Apache-2.0
"""Methods and properties of a part of an object, which the object itself offers with their documentation."""

import functools
from collections.abc import Callable
from typing import Any, Concatenate, ParamSpec, TypeVar

P, R = ParamSpec("P"), TypeVar("R")


def method_of(part: str, method: Callable[Concatenate[Any, P], R]) -> Callable[Concatenate[Any, P], R]:
    """Method that calls the one of the part with this name."""

    @functools.wraps(method)
    def call(self, *args: P.args, **options: P.kwargs) -> R:
        return method(getattr(self, part), *args, **options)

    return call


def property_of(part: str, described: Any) -> Any:
    """Property that reads the one of the part with this name."""
    return property(lambda self: described.fget(getattr(self, part)), doc=described.__doc__)
