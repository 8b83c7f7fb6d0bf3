# SPDX-License-Identifier: Apache-2.0
"""Contacts that begin and end within a step: passing points, fast rotors, grazing oscillators."""

import math

import numpy as np
import pytest
from scene_files import text_of
from scipy.integrate import quad
from scipy.optimize import brentq, minimize_scalar

from liegroup_core import Simulation
from liegroup_core.events.crossings import NONE, lowest
from liegroup_core.events.times import root_of
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


# What is held gives way for part of a step: a rope and a rubber go slack, stiction is exceeded.


MASS, STIFFNESS, PUSHED = 2.0, 50.0, 0.2  # of RUBBER; the last in s
# With the largest error of a pose at the event, parts of the size or rad: the accuracy, or that of the
# method at these steps, up to 0.8 rad of the motion each.
RELEASES = [
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


@pytest.mark.parametrize("settings, error", RELEASES, ids=str)
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


@pytest.mark.parametrize("settings, error", RELEASES, ids=str)
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


@pytest.mark.parametrize("settings, error", RELEASES, ids=str)
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


@pytest.mark.parametrize("root", [1e-9, 0.1, 0.71, 1.0 - 1e-6])
@pytest.mark.parametrize("beyond", [False, True])
@pytest.mark.parametrize(
    "guard, most",
    [
        (lambda t, r: r - t, 5),
        (lambda t, r: math.exp(-5.0 * t) - math.exp(-5.0 * r), 14),
        (lambda t, r: r * r - t * t, 40),  # nearly a double root
        (lambda t, r: math.inf if t < 0.5 * r else r - t, 50),  # a law skips it
        (lambda t, r: 1.0 if t < r else -1e-9, 50),
        (lambda t, r: r - t + 1e-14 * math.sin(1e12 * t), 20),  # round-off
    ],
)
def test_roots_of_guards_are_found_in_few_steps(guard, most, beyond, root):
    """To 1e-13, and where asked for, not before the root; a jump to the part of 1e-11 from which on it is round-off."""
    calls = []

    def counted(time):
        calls.append(time)
        return guard(time, root)

    found = root_of(counted, 0.0, 1.0, 1e-13, beyond)
    assert abs(found - root) <= (1e-11 if guard(root + 1e-9, root) == -1e-9 else 4e-13)
    assert found in calls and len(calls) <= most
    assert not beyond or guard(found, root) <= 0.0
