# SPDX-License-Identifier: Apache-2.0
"""A run continued from a saved state is bit-identical, for methods with any memory."""

import pytest

from liegroup_core import Simulation, load_scene
from liegroup_core.integrators.methods import METHODS

# A wrench begins before the state is saved and goes on: who restarts at changes must not there.
SAVED, END = 23, 60
# Tolerances that substeps are needed for, else their size would be that of a step all the time.
FINE = {"step": 1e-2, "rtol": 1e-12, "atol": 1e-12}
OPTIONS = {name: FINE for name, method in METHODS.items() if method.controlled}


def run(scene, method, steps, start=None):
    simulation = Simulation(load_scene(scene), method, **OPTIONS.get(method, {}))
    if start is not None:
        simulation.set_state(*start)
    body = simulation.layout.body_names[0]
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
def test_a_run_goes_on_to_the_bit_from_a_saved_state(method):
    scene = "free_body" if METHODS[method].family == "rotation" else "four_bar"
    saved = run(scene, method, SAVED)
    state = (*saved.state(), SAVED, saved.sample().angles)
    expected = bits(run(scene, method, END))
    assert bits(run(scene, method, END, (*state, saved.memory()))) == expected
    if saved.memory():  # else what is saved beside the state is nothing
        assert bits(run(scene, method, END, state)) != expected


def test_the_memory_of_another_method_is_refused():
    simulation = run("four_bar", "rkmk54", SAVED)
    with pytest.raises(ValueError, match="expected 32 bytes of method memory, got 3"):
        simulation.set_state(*simulation.state(), memory=b"abc")
