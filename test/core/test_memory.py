# SPDX-License-Identifier: Apache-2.0
"""A run continued from a saved state is bit-identical, for methods with any memory."""

import pickle

import numpy as np
import pytest

from liegroup_core import Simulation, load_scene
from liegroup_core.methods.table import METHODS
from liegroup_core.state import State

# A wrench starts before the state is saved and continues. Methods that restart when a wrench
# changes must not restart at SAVED.
SAVED, END = 23, 60
# Tolerances tight enough to need substeps; otherwise the substep size would always be the step.
FINE = {"step": 1e-2, "rtol": 1e-12, "atol": 1e-12}
OPTIONS = {name: FINE for name, method in METHODS.items() if method.controlled}


def run(scene, method, steps, start=None):
    """Run from the start, from a State, or from (pose, twist, steps, angles)."""
    simulation = Simulation(load_scene(scene), method, **OPTIONS.get(method, {}))
    body = simulation.layout.body_names[0]
    if isinstance(start, State):
        simulation.restore(start)
    else:
        if start is not None:
            simulation.set_state(*start)
        if METHODS[method].family != "rotation":
            if start is None:
                simulation.advance(11)
            simulation.apply_wrench(body, (0.3, 0.1, 0.0, 0.0, 0.2, 0.0))
    simulation.advance(steps - simulation.steps)
    return simulation


def bits(simulation):
    pose, twist = simulation.state()
    return pose.tobytes(), twist.tobytes()


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.volume(10)
def test_a_run_continued_from_a_saved_state_is_bit_identical(method):
    scene = "free_body" if METHODS[method].family == "rotation" else "four_bar"
    saved = run(scene, method, SAVED)
    state = (*saved.state(), SAVED, saved.sample().angles)
    expected = bits(run(scene, method, END))
    kept = saved.snapshot()
    assert bits(run(scene, method, END, pickle.loads(pickle.dumps(kept)))) == expected
    if kept.parts["memory"]:
        without = run(scene, method, END, state)
        entry = METHODS[method]
        if saved.group == "relative" and entry.family == "rkmk" and not entry.controlled:
            # Relative coordinates are found again from the poses, to their round-off.
            for mine, exact in zip(without.state(), run(scene, method, END).state()):
                assert np.abs(mine - exact).max() <= 1e-13 * np.abs(exact).max()
        else:
            assert bits(without) != expected
