# SPDX-License-Identifier: Apache-2.0
"""Motion of a robot in a simulation to an accuracy, compared with that of another code."""

import numpy as np
from scipy.integrate import solve_ivp

from liegroup_core import Simulation, SimulationError

ACCURACY = 1e-10  # relative to the mechanism's size, or rad
LEAST_STEP = 1e-5  # s; a second in smaller steps takes minutes
CLOSE = 1e-8  # m; a larger difference is computed again
DISTURBANCE = 1e-12  # relative change of the twists at the start
MOST = 1_000_000  # evaluations by SciPy's Radau, about a minute


def motion_against(scene, pose, twist, seconds, steps, their_end, rows=slice(None)):
    """Differences after a motion from poses (n, 12) and twists (n, 6), m: a dict.

    steps     : s, of the other code's explicit method, tried in turn while the ends differ; then its implicit one
    their_end : function of a step, or None for the implicit method -> positions of the bodies `rows`

    motion_m : largest difference of positions, for the best integration of the other code
    moved_m  : largest displacement
    stiff    : True if that is the implicit method
    grown_m  : if all differ, our own difference after a start with twists larger by DISTURBANCE
    Raises SimulationError.
    """
    end = end_of(scene, pose, twist, seconds)
    best = {"motion_m": np.inf}
    for step in (*steps, None):
        found = float(np.abs(end[rows] - their_end(step)).max())
        if found < best["motion_m"]:
            best = {"motion_m": found, "stiff": step is None}
        if found < CLOSE:
            break
    else:
        other = end_of(scene, pose, twist * (1.0 + DISTURBANCE), seconds)
        best["grown_m"] = float(np.abs(end - other).max())
    return best | {"moved_m": float(np.abs(end - pose[:, 9:])[rows].max())}


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
    """State of SciPy's Radau after some seconds; infinite if it fails or needs more than MOST evaluations."""
    left = iter(range(MOST))

    def counted(time, state):
        if next(left, None) is None:
            raise ValueError("too many evaluations")
        return slope(time, state)

    # Its default first step overflows if dampers stop light joints.
    settings = {"rtol": 1e-10, "atol": 1e-12, "first_step": 1e-13}
    try:
        with np.errstate(all="ignore"):
            solution = solve_ivp(counted, (0.0, seconds), start, "Radau", **settings)
    except ValueError:  # also if its matrix is not finite
        return np.full_like(start, np.inf)
    return solution.y[:, -1] if solution.success else np.full_like(start, np.inf)
