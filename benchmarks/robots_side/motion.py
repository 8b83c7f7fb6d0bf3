# SPDX-License-Identifier: Apache-2.0
"""Motion of a robot as a simulation to an accuracy gives it."""

import numpy as np
from scipy.integrate import solve_ivp

from liegroup_core import Simulation, SimulationError

ACCURACY = 1e-10  # parts of the mechanism's size, or rad
LEAST_STEP = 1e-5  # s; a second in smaller steps takes minutes


def end_of(scene, pose, twist, seconds):
    """Positions (n, 3) in m of the body frames after a motion from poses (n, 12) and twists (n, 6).

    Raises SimulationError.
    """
    simulation = Simulation(scene, accuracy=ACCURACY, horizon=seconds, quiet=True)
    if simulation.step < LEAST_STEP:
        raise SimulationError(f"steps of {simulation.step:g} s are needed")
    simulation.set_state(*simulation.layout.offsets.to_centres(pose, twist))
    simulation.advance(round(seconds / simulation.step))
    found = simulation.sample().positions
    return np.array([found[body.name] for body in scene.bodies])


def radau(slope, start, seconds):
    """State of SciPy's Radau after some seconds; infinite if it fails."""
    # Its own first step overflows where dampers stop light joints.
    settings = {"rtol": 1e-10, "atol": 1e-12, "first_step": 1e-13}
    try:
        with np.errstate(all="ignore"):
            solution = solve_ivp(slope, (0.0, seconds), start, "Radau", **settings)
    except ValueError:  # its matrix is not finite
        return np.full_like(start, np.inf)
    return solution.y[:, -1] if solution.success else np.full_like(start, np.inf)
