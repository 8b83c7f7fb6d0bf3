# SPDX-License-Identifier: Apache-2.0
"""Dynamics of multibody systems integrated on their Lie group SE(3)^n. Imports no ROS.

from liegroup_core import Simulation, load_scene

simulation = Simulation(load_scene("heavy_top"), method="rkmk4", step=1e-3)
simulation.advance(1000)
print(simulation.sample().poses["top"])
"""

from liegroup_core.observables.sample import Sample
from liegroup_core.scene.description import Scene
from liegroup_core.scene.load import load_scene

from .errors import SceneError, SimulationError
from .simulation import Simulation

__all__ = ["Sample", "Scene", "SceneError", "Simulation", "SimulationError", "load_scene"]
