# SPDX-License-Identifier: Apache-2.0
"""A user's script that mypy checks with --strict: the public API is annotated."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from liegroup_core import Sample, Scene, SceneError, Simulation, SimulationError, load_scene
from liegroup_sim_ros.recording import read_recording


def heights(scene: Scene, seconds: float) -> NDArray[np.float64]:
    """Height of the first body over time, with a wrench on the way."""
    simulation = Simulation(scene, method="rkmk8", step=1e-2, stabilisation="projection")
    body = simulation.sample().body_names[0]
    simulation.apply_wrench(body, [0, 0, 0, 0, 0, 1.0], start=0.5, duration=0.1, axes="world")
    found: list[float] = []
    while simulation.time < seconds:
        simulation.advance(10)
        sample: Sample = simulation.sample()
        found.append(float(sample.positions[body][2]))
    if simulation.doubt is not None:
        print(simulation.doubt, sample.energy, sample.constraint_residual)
    state = simulation.snapshot()
    simulation.set_state(state.pose, state.twist, state.steps)
    simulation.restore(state)
    return np.array(found)


def main() -> int:
    """Run, and read a recording if there is one."""
    try:
        print(heights(load_scene("heavy_top"), 1.0).max())
    except (SceneError, SimulationError) as error:
        print(error)
        return 1
    if Path("run.mcap").exists():
        print(read_recording("run.mcap").complete)
    return 0
