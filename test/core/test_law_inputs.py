# SPDX-License-Identifier: Apache-2.0
"""Laws that read sensors: the numbers that the sensors measure, in the engine and in the reference integration."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scene_files import cases, text_of

from liegroup_core import SceneError, Simulation
from liegroup_core.reference import integrate
from liegroup_core.scene.load import scene_from_text

# Centres of mass away from the body frames, and sensors in frames of their own.
ARM = text_of("arm_law_inputs.yaml")
COUNTS = {"tracker": 13, "imu": 7, "wire": 2, "laser": 2, "coder": 1}


def arm(period="", noise="", resolution=""):
    # Numbers of sensors have two names.
    parts = {"imu": "qx qy qz qw wx wy wz", "wire": "distance rate", "coder": "position"}
    names = {name: dict(enumerate(text.split())) for name, text in parts.items()}
    inputs = ", ".join(
        f"{name}{k}: {name}.{names.get(name, {}).get(k, k)}" for name, count in COUNTS.items() for k in range(count)
    )
    signals = ", ".join(f"s_{name}{k}: {name}{k}" for name, count in COUNTS.items() for k in range(count))
    text = ARM.replace("NOISE", noise).replace("jointRESOLUTION: elbow", f"joint: elbow{resolution}")
    text = text.replace("PERIOD", f"{period}signals: {{{signals}}}")
    return scene_from_text(text.replace("INPUTS", inputs), "test")


def read(sample):
    """{SENSOR.k: number} as the law has read them, and as the sensors measure."""
    own = {name: sample.signals[f"own.s_{name.replace('.', '')}"] for name in measured(sample)}
    return own, measured(sample)


def measured(sample):
    return {f"{name}.{k}": sample.sensors[name][k] for name, count in COUNTS.items() for k in range(count)}


def test_a_law_reads_what_sensors_measure():
    """Sensors measure by NumPy from the poses of the body frames: to a few roundings of numbers near 1."""
    simulation = Simulation(arm(), accuracy=1e-8, quiet=True)
    start = simulation.state()
    for time in (0.0, 0.31, 1.0):
        simulation.advance_to(time)
        own, known = read(simulation.sample())
        assert len(own) == 25
        assert_allclose(list(own.values()), list(known.values()), rtol=0, atol=1e-14)
    found, _ = integrate(arm(), *start, np.array([1.0]))
    assert_allclose(simulation.sample().pose[:, 9:], found.position[0], rtol=0, atol=1e-7)


def test_a_sampled_law_reads_noise_and_resolution_as_they_are_recorded():
    """At its instants, in both runs of an estimate, and in the reference integration."""
    settings = "period: 0.05\n  ", ", position_noise: 0.03, seed: 4", ", resolution: 0.01"
    scene = arm(*settings)
    simulation, still = Simulation(scene, accuracy=1e-8, quiet=True), Simulation(arm(*settings[:1]), quiet=True)
    start = simulation.state()
    for k in range(20):
        simulation.advance_to(0.05 * k)
        own, known = read(simulation.sample())
        assert_allclose(list(own.values()), list(known.values()), rtol=0, atol=1e-14)
    assert simulation.largest_error < 1e-8
    still.advance_to(0.95)
    noise = np.abs(simulation.sample().pose - still.sample().pose).max()
    found, _ = integrate(scene, *start, np.array([0.95]))
    assert np.abs(simulation.sample().pose[:, 9:] - found.position[0]).max() < 1e-7 < 1e-4 < noise


@pytest.mark.parametrize("inputs, period, reason", cases("what_a_law_cannot_read_is_refused_in_one_line"))
def test_what_a_law_cannot_read_is_refused_in_one_line(inputs, period, reason):
    text = ARM.replace("NOISE", ", position_noise: 0.1")
    text = text.replace("jointRESOLUTION: elbow", "joint: elbow, resolution: 0.1")
    text = text[: text.index("forces:")]
    text += f"forces:\n- {{name: own, type: law, {period}inputs: {inputs}, signals: {{a: 1}}}}\n"
    if reason is None:
        scene_from_text(text, "test")
        return
    with pytest.raises(SceneError) as refused:
        scene_from_text(text, "test")
    assert reason in str(refused.value) and "\n" not in str(refused.value)
