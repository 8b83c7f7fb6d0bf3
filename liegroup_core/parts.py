# SPDX-License-Identifier: Apache-2.0
"""Methods of an object that one of its parts, or a package above, carries out; they keep their documentation."""

import functools
from collections.abc import Callable
from typing import Any, Concatenate, ParamSpec, TypeVar

from liegroup_core.errors import LieGroupSimError

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


def attached(name):
    """Function that a package above attaches to Simulation, see setup.py. Raises LieGroupSimError if none does."""
    from importlib.metadata import entry_points  # slow to import

    for entry in entry_points(group="liegroup_core.attached", name=name):
        return entry.load()
    raise LieGroupSimError(f"Simulation.{name}: no installed package has it: install liegroup_sim_ros")
