# SPDX-License-Identifier: Apache-2.0
"""Several impacts at one instant, and one after the other: Newton's cradle of pendulums and struts."""

import math

import numpy as np
import pytest
import yaml

from liegroup_core.engine import Engine
from liegroup_core.scene.load import scene_from_text

pytestmark = pytest.mark.slow
G, LENGTH, SIZE, MASS, LIFT = 9.81, 0.5, 0.04, 0.2, 0.5
INERTIA = 1e-4 + MASS * LENGTH**2  # about the pivot


def cradle(count, gap=0.0, restitution=1.0, lifted=1):
    """Pendulums side by side, the first ones lifted; struts between their balls are the contacts."""
    bodies, joints = [], []
    for i in range(count):
        place = i * (SIZE + gap)
        ball = {"name": f"ball{i}", "mass": MASS, "inertia": [1e-4] * 3, "com": [0, 0, -LENGTH]}
        tilt = LIFT if i < lifted else 0.0
        bodies.append(ball | {"position": [place, 0, 0], "rotation_vector": [0, tilt, 0]})
        pivot = {"name": f"pivot{i}", "type": "revolute", "parent": "world", "child": f"ball{i}"}
        pivot |= {"parent_frame": {"axis": [0, 1, 0], "position": [place, 0, 0]}}
        joints.append(pivot | {"child_frame": {"axis": [0, 1, 0]}})
        if i:
            touch = {"name": f"touch{i}", "type": "strut", "parent": f"ball{i - 1}"}
            centre = {"position": [0, 0, -LENGTH]}
            touch |= {"child": f"ball{i}", "parent_frame": centre, "child_frame": centre}
            joints.append(touch | {"length": SIZE, "restitution": restitution})
    scene = {"name": "cradle", "gravity": [0, 0, -G], "bodies": bodies, "joints": joints}
    return scene_from_text(yaml.safe_dump(scene))


# Rate of a lifted ball at its lowest point.
SPEED = math.sqrt(2.0 * MASS * G * LENGTH * (1.0 - math.cos(LIFT)) / INERTIA)


@pytest.mark.parametrize("count", [2, 3, 5, 8])
@pytest.mark.parametrize("e", [0.0, 0.6, 1.0])
def test_balls_that_touch_share_the_impulse(count, e):
    """Newton's law for all contacts at once: the first ball keeps (1 - (n - 1) e) / n of its speed.

    All others get (1 + e) / n: only the contact that is hit separates, with e times its speed. Which
    is not what steel balls do; see docs/how-to/stops.md.
    """
    engine = Engine(cradle(count, 0.0, e), "rkmk8", 1e-3)
    engine.drain_impacts()
    impulses = []
    while not impulses:
        engine.advance(1)
        impulses = [event for event in engine.drain_events() if event.kind == "impact"]
    # The impulse of contact k moves all balls beyond it; struts act at the arm LENGTH.
    expected = [INERTIA * SPEED / LENGTH * (1.0 + e) * (count - k) / count for k in range(1, count)]
    assert len({event.time for event in impulses}) == 1
    assert [event.impulse for event in impulses] == pytest.approx(expected, abs=1e-11)
    loss = 0.5 * INERTIA * SPEED**2 * (1.0 - e * e) * (count - 1) / count
    assert sum(event.energy for event in impulses) == pytest.approx(-loss, abs=1e-11)


@pytest.mark.parametrize("gap", [1e-3, 1e-6])
@pytest.mark.parametrize("lifted", [1, 2])
def test_balls_with_gaps_pass_the_impulse_on(gap, lifted):
    """With gaps the impacts follow each other: equal balls exchange their rates, and the last fly off.

    The gap turns the line of an impact by gap / length of the pendulum at most: what is left of the
    others' rates.
    """
    count = 5
    engine = Engine(cradle(count, gap, 1.0, lifted), "rkmk8", 1e-3)
    energy, events = engine.energy(), []
    while len(events) < lifted * (count - lifted):
        engine.advance(1)
        events += engine.drain_events()
    times = [event.time for event in events]
    assert times == sorted(times)
    order = [event.joint for event in events]
    if lifted == 1:
        assert order == [f"touch{k}" for k in range(1, count)]
        assert len(set(times)) == len(times)
    rates = np.abs(engine.sample().twist[:, 1]) / SPEED
    # Until the end of the step, 1 ms, gravity takes 1e-2 of them at most, by the angle of 4 mrad.
    assert rates[: count - lifted] == pytest.approx(np.zeros(count - lifted), abs=3.0 * gap / SIZE + 1e-6)
    assert rates[count - lifted :] == pytest.approx(np.ones(lifted), abs=1e-2)
    assert engine.energy() == pytest.approx(energy, abs=1e-11)


def test_plastic_balls_with_gaps_move_on_together():
    """Sequences of plastic impacts end: all balls have a fifth of the momentum, as if they touched.

    A gap of 0.1 mm is passed at 0.2 of 0.4 m/s in 1.2 ms; gravity changes rates by 1e-3 meanwhile.
    """
    engine = Engine(cradle(5, 1e-4, 0.0), "rkmk8", 1e-3)
    engine.advance(362)
    assert 4 <= engine.event_count <= 100
    assert -engine.sample().twist[:, 1] / SPEED == pytest.approx([-0.2] * 5, abs=1e-3) or (
        engine.sample().twist[:, 1] / SPEED == pytest.approx([-0.2] * 5, abs=1e-3)
    )
