# SPDX-License-Identifier: Apache-2.0
"""Errors that a user can correct: one line with what is wrong, where, and what to do."""


class LieGroupSimError(Exception):
    """Base of all errors of this package; `str()` is a single line."""

    def __str__(self):
        return " ".join(super().__str__().split())


class SceneError(LieGroupSimError, ValueError):
    """Scene that cannot be read or simulated.

    message : what is wrong and what to do
    place   : path inside the scene, for example ("bodies", 0, "mass"); None: the whole scene
    """

    def __init__(self, message, place=None):
        super().__init__(message)
        self.place = None if place is None else tuple(place)


class MissingFileError(SceneError):
    """Scene that refers to a file that does not exist."""


class SimulationError(LieGroupSimError, RuntimeError):
    """Integration that cannot continue; the simulation keeps its last valid state.

    status : the kernel's status code (`liegroup_core.status`)
    """

    def __init__(self, message, status=None):
        super().__init__(message)
        self.status = status
