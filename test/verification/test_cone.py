# SPDX-License-Identifier: Apache-2.0
"""Ball joints with a cone: impacts and steady precession along it, against closed forms."""

import math

import numpy as np
import pytest
import yaml
from convergence import fitted_order
from scene_files import filled, text_of
from scipy.spatial.transform import Rotation

from liegroup_core.engine import Engine
from liegroup_core.scene.load import scene_from_text

pytestmark = pytest.mark.slow
G, MASS, ARM, CONE = 9.81, 1.2, 0.4, 0.6
# Principal moments about the pivot.
ACROSS, ALONG = 0.05 + MASS * ARM**2, 0.03


def top(tilt, rates, cone, height=-ARM, turn=None):
    """Symmetric top on a ball joint with a cone about the vertical.

    tilt : rad from the vertical, about x;  rates : (3,) angular velocity in body axes, rad/s
    height : of the centre of mass on the axis, m;  turn : of the whole scene, rotation vector
    """
    frame = Rotation.from_rotvec([0.0, 0.0, 0.0] if turn is None else turn)
    body = {"name": "top", "mass": MASS, "inertia": [0.05, 0.05, ALONG], "com": [0.0, 0.0, height]}
    body["rotation_vector"] = (frame * Rotation.from_rotvec([tilt, 0, 0])).as_rotvec().tolist()
    body["angular_velocity"] = [float(x) for x in rates]
    at = {"rotation_vector": frame.as_rotvec().tolist()}
    ball = {"name": "ball", "type": "spherical", "parent": "world", "child": "top", "child_frame": {}}
    ball |= {"parent_frame": at, "limits": {"cone": CONE} | cone}
    gravity = frame.apply([0.0, 0.0, -G]).tolist()
    scene = {"name": "top", "gravity": gravity, "bodies": [body], "joints": [ball]}
    return scene_from_text(yaml.safe_dump(scene))


@pytest.mark.parametrize("turn", [None, [0.4, -0.3, 0.8]])
def test_steady_precession_along_the_cone(turn):
    """A top that leans on the cone precesses steadily: the cone bears what gravity and gyration leave.

    With the precession p and the spin s of the axis, about the line of nodes:
    m g h sin a - load = p sin a (C (p cos a + s) - A p cos a), A and C about the pivot.
    """
    precession, spin = 7.0, 2.0
    sine, cosine = math.sin(CONE), math.cos(CONE)
    along = precession * cosine + spin
    # In body axes the vertical is (0, sin a, cos a).
    engine = Engine(
        top(CONE, [0.0, precession * sine, along], {}, turn=turn), "rkmk8", 2e-3, stabilisation="projection"
    )
    load = -MASS * G * ARM * sine - precession * sine * (ALONG * along - ACROSS * precession * cosine)
    assert load > 0.0
    frame = Rotation.from_rotvec([0.0, 0.0, 0.0] if turn is None else turn)
    for _ in range(10):
        engine.advance(100)
        sample = engine.sample()
        expected = (
            frame
            * Rotation.from_rotvec([0, 0, precession * engine.time])
            * Rotation.from_rotvec([CONE, 0, 0])
            * Rotation.from_rotvec([0, 0, spin * engine.time])
        )
        assert sample.pose[0, :9].reshape(3, 3) == pytest.approx(expected.as_matrix(), abs=1e-11)
        assert sample.modes == {"ball": "upper"}
        assert np.linalg.norm(sample.reactions["ball"][:3]) == pytest.approx(load, abs=1e-10)
    assert engine.event_count == 0


def test_slow_precession_leaves_the_cone():
    """Below the precession at which nothing presses on the cone, the top leaves it at once."""
    sine, cosine = math.sin(CONE), math.cos(CONE)
    free = math.sqrt(MASS * G * ARM / (cosine * (ACROSS - ALONG)))
    for precession, mode in ((free * (1.0 + 1e-6), "upper"), (free * (1.0 - 1e-6), "free")):
        rates = [0.0, precession * sine, precession * cosine]
        engine = Engine(top(CONE, rates, {}), "rkmk8", 2e-3)
        engine.advance(1)
        assert engine.modes == {"ball": mode}


@pytest.mark.parametrize("e", [0.0, 0.5, 1.0])
@pytest.mark.turn(3)
def test_impacts_on_the_cone(e):
    """An impact turns round the rate of the tilt and keeps spin and angular momentum about the vertical.

    Impulse A (1 + e) rate about the line of nodes, energy A (1 - e^2) rate^2 / 2.
    """
    engine = Engine(top(0.3, [5.0, 3.0, 2.0], {"restitution": e}), "rkmk8", 1e-3, stabilisation="projection")
    inertia = np.diag([ACROSS, ACROSS, ALONG])

    def state():
        sample = engine.sample()
        R = sample.pose[0, :9].reshape(3, 3)
        w = sample.twist[0, :3]
        nodes = np.cross([0, 0, 1], R[:, 2])
        return (R @ inertia @ w)[2], w[2], nodes @ (R @ w) / np.linalg.norm(nodes)

    (momentum, spin, _), energy, impacts = state(), engine.energy(), 0
    for _ in range(2000):
        engine.advance(1)
        for event in engine.drain_events():
            energy += event.energy
            if event.kind == "impact":
                impacts += 1
                rate = -event.impulse / (ACROSS * (1.0 + e))
                loss = -0.5 * ACROSS * (1.0 - e * e) * rate**2
                assert event.energy == pytest.approx(loss, abs=1e-12)
        now = state()
        # rkmk8 with 1 ms: 1e-13 a step at most.
        assert now[:2] == pytest.approx((momentum, spin), abs=1e-11)
        assert engine.energy() == pytest.approx(energy, abs=1e-10)
    assert impacts >= (1 if e == 0.0 else 4)


def test_swinging_through_the_axis_of_the_cone():
    """A plane swing through the vertical, where the angle of the axes has no direction.

    It hits the cone on both sides as a hinge its two stops.
    """
    engine = Engine(top(0.3, [2.5, 0.0, 0.0], {"restitution": 0.9}), "rkmk8", 5e-3)
    text = filled(text_of("hinge_on_a_cone.yaml"), mass=MASS, along=ALONG, arm=-ARM, low=-CONE, low2=CONE)
    hinge = Engine(scene_from_text(text), "rkmk8", 5e-3)
    events = []
    for each in (engine, hinge):
        each.advance(400)
        events.append([event for event in each.drain_events() if event.kind == "impact"])
    assert len(events[0]) == len(events[1]) >= 4
    times = [[event.time for event in found] for found in events]
    assert times[0] == pytest.approx(times[1], abs=1e-11)
    for one, other in zip(*events):
        assert abs(one.impulse) == pytest.approx(abs(other.impulse), abs=1e-10)


def test_order_of_impacts_on_a_cone():
    """The time of the third impact of a spinning top converges with the order of the method."""
    scene = top(0.3, [5.0, 3.0, 8.0], {"restitution": 0.7})

    def time_of(method, step):
        engine = Engine(scene, method, step)
        engine.advance(round(0.8 / step))
        return [event.time for event in engine.drain_events() if event.kind == "impact"][2]

    exact = time_of("rkmk8", 5e-4)
    for method, order, steps in (("rkmk4", 4, (1e-2, 5e-3, 2.5e-3)), ("rkmk8", 8, (4e-2, 3e-2, 2e-2))):
        errors = [abs(time_of(method, step) - exact) for step in steps]
        assert fitted_order(steps, errors) >= order - 0.6, errors


# Several impacts at one instant, and one after the other: Newton's cradle of pendulums and struts.


LENGTH, SIZE, BALL_MASS, LIFT = 0.5, 0.04, 0.2, 0.5
INERTIA = 1e-4 + BALL_MASS * LENGTH**2  # about the pivot


def cradle(count, gap=0.0, restitution=1.0, lifted=1):
    """Pendulums side by side, the first ones lifted; struts between their balls are the contacts."""
    bodies, joints = [], []
    for i in range(count):
        place = i * (SIZE + gap)
        ball = {"name": f"ball{i}", "mass": BALL_MASS, "inertia": [1e-4] * 3, "com": [0, 0, -LENGTH]}
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
SPEED = math.sqrt(2.0 * BALL_MASS * G * LENGTH * (1.0 - math.cos(LIFT)) / INERTIA)


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
