# SPDX-License-Identifier: Apache-2.0
"""Slider-cranks whose crank and coupler fold onto each other, with unlike masses, against one angle."""

import math

import numpy as np
import pytest
from scene_files import cases, text_of
from scipy.integrate import solve_ivp

from liegroup_core import Simulation
from liegroup_core.layout import make_layout
from liegroup_core.lie.groups import SO3
from liegroup_core.scene.load import scene_from_text

pytestmark = pytest.mark.slow
G, START, INERTIA = 9.81, 0.3, 1.0 / 12.0
SCENE = text_of("slider_crank.yaml")


def centres(angle):
    """Positions of the bodies for the angle of the crank, m; crank and coupler are 1 m long."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[0.5 * c, 0.0, 0.5 * s], [1.5 * c, 0.0, 0.5 * s], [2.0 * c, 0.0, 0.0]])


def scene_of(masses, rate):
    c, s = math.cos(START), math.sin(START)
    slopes = np.array([[-0.5 * s, 0.0, 0.5 * c], [-1.5 * s, 0.0, 0.5 * c], [-2.0 * s, 0.0, 0.0]])
    values, turns = {"RATE": rate}, (-START, START, 0.0)
    parts = zip("CLS", masses, centres(START), rate * slopes, turns)
    for letter, mass, position, velocity, turn in parts:
        body = SO3.exp(np.array([0.0, turn, 0.0])).T @ velocity  # twists are in body axes
        values |= {f"M{letter}": mass, f"I{letter}0": 0.01 * mass, f"I{letter}": INERTIA * mass}
        values |= {f"P{letter}": position.tolist(), f"V{letter}": body.tolist()}
    text = SCENE
    for key in sorted(values, key=len, reverse=True):
        text = text.replace(key, str(values[key]))
    return scene_from_text(text)


def motion(masses, rate, times):
    """Angles of the crank: T = M(angle) rate^2 / 2, V = (m_crank + m_coupler) g sin(angle) / 2."""
    crank, coupler, slider = masses

    def inertia(a):
        own = INERTIA * (crank + coupler) + crank / 4.0
        moved = coupler * (2.25 * math.sin(a) ** 2 + 0.25 * math.cos(a) ** 2)
        return own + moved + 4.0 * slider * math.sin(a) ** 2

    def slope(_, y):
        bend = (2.0 * coupler + 4.0 * slider) * math.sin(y[0]) * math.cos(y[0])
        weight = 0.5 * (crank + coupler) * G * math.cos(y[0])
        return [y[1], -(weight + bend * y[1] ** 2) / inertia(y[0])]

    settings = {"rtol": 1e-13, "atol": 1e-14, "t_eval": times}
    found = solve_ivp(slope, (0.0, times[-1]), [START, rate], "DOP853", **settings)
    return found.y[0]


@pytest.mark.parametrize("masses, rate, accuracy", cases("folded_positions_are_passed_within_the_accuracy"))
@pytest.mark.turn(3)
def test_folded_positions_are_passed_within_the_accuracy(masses, rate, accuracy):
    """Up to `accurate_until`, which is the last checkpoint before the estimate exceeds the accuracy."""
    simulation = Simulation(scene_of(masses, rate), accuracy=accuracy, horizon=10.0, quiet=True)
    steps = round(10.0 / simulation.step)
    times = simulation.step * np.arange(1, steps + 1)
    length, errors = simulation.promise["length"], []
    for time, angle in zip(times, motion(masses, rate, times)):
        simulation.advance(1)
        positions = simulation.sample().positions
        found = np.array([positions[body.name] for body in simulation.scene.bodies])
        if simulation.accurate_until < time:
            break
        errors.append(np.abs(found - centres(angle)).max() / length)
    kept = times[: len(errors)] <= simulation.accurate_until
    assert np.array(errors)[kept].max() < accuracy
    assert times[: len(errors)][kept].max() > 4.0  # several folded positions


def test_the_usual_pivot_is_that_of_poses_which_are_not_folded():
    """Beside the folded pose it is as far from it as anywhere."""
    found = [
        make_layout(scene_of(masses, 8.0)).relative.usual_pivot
        for masses in ((1.0, 1.0, 1.0), (1.0, 1.0, 0.01), (1.0, 10.0, 0.01))
    ]
    assert found[0] > 0.5 and found == sorted(found, reverse=True) and found[2] > 1e-3
