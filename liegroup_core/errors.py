# SPDX-License-Identifier: Apache-2.0
"""Errors that a user can mend: each is one line that says what, where and what to do."""


class LieGroupSimError(Exception):
    """Base of every error this package raises on purpose; `str()` is a single line."""

    def __str__(self):
        return " ".join(super().__str__().split())


class SceneError(LieGroupSimError, ValueError):
    """A scene that cannot be understood or simulated.

    message : what is wrong and what would be right
    place   : path inside the scene, for example ("bodies", 0, "mass"); None when it concerns all
    """

    def __init__(self, message, place=None):
        super().__init__(message)
        self.place = None if place is None else tuple(place)


class SimulationError(LieGroupSimError, RuntimeError):
    """An integration that had to stop; the simulation keeps its last good state.

    status : the kernel's status code (`liegroup_core.status`)
    """

    def __init__(self, message, status=None):
        super().__init__(message)
        self.status = status
