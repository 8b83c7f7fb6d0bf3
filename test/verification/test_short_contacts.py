# SPDX-License-Identifier: Apache-2.0
"""Contacts that begin and end within a step: passing points, fast rotors, grazing oscillators."""

import math

import numpy as np
import pytest
from scene_files import text_of
from scipy.optimize import brentq

from liegroup_core import Simulation
from liegroup_core.events.crossings import NONE, lowest
from liegroup_core.scene.load import scene_from_text

G = 9.81
RUNS = [
    {},
    {"accuracy": 1e-8},
    {"method": "rkmk8", "step": 1e-2},
    {"method": "rkmk4", "step": 1e-2},
    {"method": "rkmk4", "step": 1e-3},
]
DROP = text_of("drop.yaml")
ROTOR = text_of("rotor_short_contacts.yaml")
OSCILLATOR = text_of("oscillator_short_contacts.yaml")


def impacts(text, end, settings):
    """Impacts of a run up to a time, and the simulation."""
    simulation = Simulation(scene_from_text(text), quiet=True, **settings)
    simulation.advance(round(end / simulation.step))
    return [event for event in simulation.drain_events() if event.kind == "impact"], simulation


@pytest.mark.parametrize("settings", RUNS, ids=str)
@pytest.mark.parametrize("length", [1e-4, 2e-3, 2e-2])
def test_a_ball_meets_the_end_of_a_short_strut(length, settings):
    """It falls 1 m and would be beyond the strut after 2 length / v, 0.05 to 9 ms.

    A constant acceleration is exact for these methods: times are exact to round-off of the root.
    """
    (impact,), simulation = impacts(DROP.replace("LENGTH", str(length)), 0.6, settings)
    speed = math.sqrt(2.0 * G * (1.0 - length))
    assert impact.time == pytest.approx(speed / G, abs=1e-12)
    assert impact.impulse == pytest.approx(1.5 * 1.5 * speed, rel=1e-11)
    assert simulation.doubt is None


@pytest.mark.parametrize("settings", RUNS, ids=str)
@pytest.mark.parametrize("speed", [30.0, 100.0, 300.0])
@pytest.mark.parametrize("length, away", [(0.05, 0.34), (0.02, 0.31)])
def test_the_tip_of_a_rotor_hits_a_ball(length, away, speed, settings):
    """Within a step of 10 ms it turns by up to 3 rad. Uniform rotation is exact for these methods."""

    def tip(angle):
        return np.array([0.3 * math.cos(angle), 0.3 * math.sin(angle)])

    ball = np.array([0.0, away])
    angle = brentq(lambda x: np.linalg.norm(ball - tip(x)) - length, 0.5, 0.5 * math.pi, xtol=1e-15)
    normal = (ball - tip(angle)) / length
    arm = tip(angle)
    lever = arm[0] * normal[1] - arm[1] * normal[0]
    impulse = 1.5 * speed * lever / (1.0 / 0.2 + lever**2 / 0.02)
    text = ROTOR.replace("SPEED", str(speed)).replace("AWAY", str(away))
    end = math.ceil(1e2 * angle / speed) * 1e-2
    first, simulation = impacts(text.replace("LENGTH", str(length)), end, settings)
    assert first[0].time == pytest.approx(angle / speed, abs=1e-12)
    assert first[0].impulse == pytest.approx(impulse, rel=1e-9)
    assert simulation.doubt is None


@pytest.mark.parametrize("like", ["restitution: 0.5", "stiffness: 1.0e+9, damping: 1.0e+2"])
@pytest.mark.parametrize("settings", RUNS[2:], ids=str)
@pytest.mark.parametrize("above", [1e-5, 1e-3])
def test_a_grazing_oscillator_meets_its_stop(above, settings, like):
    """10 rad/s with an amplitude of 1 + above; the time of the first contact is asin(1 / A) / 10 s.

    At the turning point an error e of the amplitude moves it by e / sqrt(2 above) / 10 s. Over a
    step of 0.1 rad that of rkmk4 is about 1e-7; dips of 1e-5 are far above.
    """
    amplitude = 1.0 + above
    text = OSCILLATOR.replace("RATE", repr(10.0 * amplitude)).replace("LIKE", like)
    simulation = Simulation(scene_from_text(text), quiet=True, **settings)
    simulation.advance(round(0.3 / simulation.step))
    event = simulation.drain_events()[0]
    assert event.kind == ("impact" if "restitution" in like else "stop")
    error = 1e-6 if settings == {"method": "rkmk4", "step": 1e-2} else 1e-10
    true = math.asin(1.0 / amplitude) / 10.0
    assert event.time == pytest.approx(true, abs=error / math.sqrt(2.0 * above))


def test_no_dip_of_a_gap_is_overlooked():
    """Points that pass each other at any distance, oscillations of up to 3 rad, and parabolas."""
    rng = np.random.default_rng(5)
    found = 0
    for number in range(3000):
        if number % 3 == 0:
            b2, t0 = 10.0 ** rng.uniform(-8, 0), rng.uniform()

            def gap(t, b2=b2, t0=t0):
                q = math.sqrt(b2 + (t - t0) ** 2)
                return q, (t - t0) / q, b2 / q**3
        elif number % 3 == 1:
            w, phase = rng.uniform(0.1, 3.0), rng.uniform(0.0, 2.0 * math.pi)

            def gap(t, w=w, phase=phase):
                c, s = math.cos(w * t + phase), math.sin(w * t + phase)
                return c, -w * s, -w * w * c
        else:
            a, b = rng.normal(size=2)

            def gap(t, a=a, b=b):
                return a * t + b * t * t, a + 2.0 * b * t, 2.0 * b

        values = np.array([gap(t)[0] for t in np.linspace(0.0, 1.0, 501)])
        stop = values.min() + 10.0 ** rng.uniform(-6, 0)
        (q0, *more0), (q1, *more1) = gap(0.0), gap(1.0)
        if q0 - stop > 0.0 and q1 - stop > 0.0:
            found += 1
            assert lowest(q0 - stop, *more0, q1 - stop, *more1, 1.0, 1e-13, 0.0) != NONE
    assert found > 300


HIT = text_of("hit.yaml")


@pytest.mark.parametrize("method, step", [("rkmk4", 0.02), ("rkmk4", 0.01), ("rkmk2", 0.005)])
def test_an_impact_hands_errors_on(method, step):
    """A ball at rest has no error until a pendulum hits it; then the estimate covers it at once.

    Against rkmk8 with 0.5 ms, whose error is below 1e-12.
    """
    scene = scene_from_text(HIT)
    simulation = Simulation(scene, method, step, quiet=True)
    exact = Simulation(scene, "rkmk8", 5e-4, estimate=False, quiet=True)
    ratios = []
    while simulation.time < 1.0:
        simulation.advance(1)
        exact.advance(round(step / 5e-4))
        ours, theirs = simulation.sample(), exact.sample()
        true = np.linalg.norm(ours.pose[1, 9:] - theirs.pose[1, 9:])
        if true > 1e-10:
            ratios.append(ours.errors[1, 0] / true)
    assert len(ratios) > 20
    assert min(ratios) >= 0.5
