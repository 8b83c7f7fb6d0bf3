# SPDX-License-Identifier: Apache-2.0
"""Dynamics of multibody systems integrated on Lie groups. Imports no ROS.

    from liegroup_core import Simulation, load_scene

    simulation = Simulation(load_scene("heavy_top"), method="rkmk4", step=1e-3)
    simulation.advance(1000)
    print(simulation.sample().poses["top"])

Names are imported when they are first used, which keeps `import liegroup_core` fast.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .errors import SceneError, SimulationError
    from .observables.sample import Sample
    from .scene.description import Scene
    from .scene.load import load_scene
    from .simulation import Simulation

_MODULES = {
    "Sample": "observables.sample",
    "Scene": "scene.description",
    "SceneError": "errors",
    "Simulation": "simulation",
    "SimulationError": "errors",
    "load_scene": "scene.load",
}
__all__ = ["Sample", "Scene", "SceneError", "Simulation", "SimulationError", "load_scene"]


def __getattr__(name):
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
    globals()[name] = value
    return value
