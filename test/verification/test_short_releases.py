# SPDX-License-Identifier: Apache-2.0
"""What is held gives way for part of a step: a rope and a rubber go slack, stiction is exceeded."""

import math

import numpy as np
import pytest
from scene_files import text_of
from scipy.integrate import quad
from scipy.optimize import brentq, minimize_scalar

from liegroup_core import Simulation
from liegroup_core.scene.load import scene_from_text

G = 9.81
MASS, STIFFNESS, PUSHED = 2.0, 50.0, 0.2  # of RUBBER; the last in s
# With the largest error of a pose at the event, parts of the size or rad: the accuracy, or that of the
# method at these steps, up to 0.8 rad of the motion each.
RUNS = [
    ({}, 1e-4),
    ({"accuracy": 1e-2, "horizon": 1.0}, 1e-2),
    ({"accuracy": 1e-4, "horizon": 1.0}, 1e-4),
    ({"accuracy": 1e-6}, 1e-6),
    ({"method": "rkmk8", "step": 0.15, "stabilisation": "projection"}, 1e-5),
    ({"method": "rkmk54", "step": 0.15, "stabilisation": "projection"}, 1e-4),
    ({"method": "rkmk4", "step": 0.05, "stabilisation": "projection"}, 1e-3),
]
ROPE = text_of("rope.yaml")
RUBBER = text_of("rubber.yaml")
TURNING = text_of("turning.yaml")


def first_event(text, end, settings):
    """First event of a run up to a time in s."""
    simulation = Simulation(scene_from_text(text), quiet=True, **settings)
    simulation.advance(math.ceil(end / simulation.step))
    return simulation.drain_events()[0]


@pytest.mark.parametrize("settings, error", RUNS, ids=str)
@pytest.mark.parametrize("missing", [1e-1, 1e-2, 1e-3])
def test_a_rope_goes_slack_near_the_top_of_its_circle(missing, settings, error):
    """With v^2 = (5 - missing) g L below, for 10 to 100 ms, from cos x = (2 g - v^2 / L) / 3 g on.

    An error of the pose or of the rate, of 3 rad/s, moves this by error / sin x.
    """
    square = (5.0 - missing) * G
    angle = math.acos((2.0 * G - square) / (3.0 * G))
    time, _ = quad(lambda x: 1.0 / math.sqrt(square - 2.0 * G * (1.0 - math.cos(x))), 0.0, angle)
    event = first_event(ROPE.replace("SPEED", repr(math.sqrt(square))), 1.0, settings)
    assert event.kind == "leave"
    assert event.time == pytest.approx(time, abs=error / math.sin(angle))


def oscillation(damping, force, start, t):
    """(depth, rate) of the rubber's end t seconds after a start (depth, rate), under a constant force."""
    decay = damping / (2.0 * MASS)
    w = math.sqrt(STIFFNESS / MASS - decay**2)
    rest = force / STIFFNESS
    x, v = start[0] - rest, start[1]
    y = (v + decay * x) / w
    fade, c, s = math.exp(-decay * t), math.cos(w * t), math.sin(w * t)
    x, v = fade * (x * c + y * s), fade * ((w * y - decay * x) * c - (w * x + decay * y) * s)
    return rest + x, v


@pytest.mark.parametrize("settings, error", RUNS, ids=str)
@pytest.mark.parametrize("damping", [0.0, 0.5, 4.0])
@pytest.mark.parametrize("share", [1e-2, 1e-3])
def test_a_rubber_goes_slack_at_the_top_of_its_oscillation(damping, share, settings, error):
    """A force in the first 0.2 s makes its own force -share m g at the top, if it could push.

    It is zero before its depth is. An error moves this by error / sqrt(2 share) / (5 rad/s).
    """
    weight = MASS * G

    def pressure(t, push):
        start = oscillation(damping, weight + push, (0.0, 0.0), PUSHED)
        depth, rate = oscillation(damping, weight, start, t - PUSHED)
        return STIFFNESS * depth + damping * rate

    def top(push):
        return minimize_scalar(pressure, args=(push,), bounds=(0.8, 1.5), method="bounded", options={"xatol": 1e-9})

    push = brentq(lambda p: top(p).fun + share * weight, 0.0, 100.0, xtol=1e-12)
    time = brentq(pressure, 0.8, top(push).x, args=(push,), xtol=1e-14)
    text = RUBBER.replace("DAMPING", repr(damping))
    simulation = Simulation(scene_from_text(text), quiet=True, **settings)
    simulation.apply_wrench("bob", (0, 0, 0, 0, 0, -push), 0.0, PUSHED, axes="world")
    simulation.advance(math.ceil(1.4 / simulation.step))
    event = next(event for event in simulation.drain_events() if event.kind == "leave")
    assert event.time == pytest.approx(time, abs=error / math.sqrt(2.0 * share))


@pytest.mark.parametrize("settings, error", RUNS, ids=str)
@pytest.mark.parametrize("share", [1e-2, 1e-3])
def test_a_block_on_a_turning_track_slips_where_it_is_steepest(share, settings, error):
    """Its weight along the track is m g sin(2 t); stiction holds 1 - share of m g, for all but 0.1 s."""
    force = (1.0 - share) * G
    event = first_event(TURNING.replace("FORCE", repr(force)), 1.0, settings)
    assert (event.kind, event.joint) == ("slip", "track")
    time = math.asin(1.0 - share) / 2.0
    assert event.time == pytest.approx(time, abs=error / math.sqrt(2.0 * share))


def test_weights_of_the_stages_are_those_of_polynomials():
    """Exact up to the degree of the nodes, and without one node up to one less."""
    from liegroup_core.events.crossings import PARTS, rows_and_weights
    from liegroup_core.methods.table import METHODS

    s = np.arange(1, PARTS) / PARTS
    for method in METHODS.values():
        if method.family != "rkmk":
            continue
        times = np.append(method.tableau.c, 1.0)
        rows, weights = rows_and_weights(times)
        chosen = rows >= 0
        assert rows[0] == 0 and rows[-1] == 1 and len(set(times[chosen])) == chosen.sum()
        count = int(chosen.sum())
        for degree in range(count):
            values = np.zeros(weights.shape[2])
            values[rows[chosen]] = times[chosen] ** degree
            assert weights[0] @ values == pytest.approx(s**degree, abs=1e-13)
            if degree < count - 1 or count == 2:
                assert weights[1] @ values == pytest.approx(s**degree, abs=1e-13)
