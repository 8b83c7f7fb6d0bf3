# SPDX-License-Identifier: Apache-2.0
"""Slack of couplings, and stops and friction of screws and cylindrical joints, against closed forms."""

import math

import numpy as np
import pytest
from scene_files import filled, text_of

from liegroup_core.engine import Engine
from liegroup_core.scene.load import scene_from_text

pytestmark = pytest.mark.slow
G = 9.81
WHEEL, PINION = 0.2, 0.03  # kg m^2
GEARS = text_of("gears_backlash.yaml")


def gears(speed, like=""):
    return scene_from_text(GEARS.replace("SPEED", repr(speed)).replace("LIKE", like))


def test_rattling_gears():
    """A wheel that turns at w hits a pinion at rest through the slack, and rattles in it.

    The slack changes at 3 w, and at e times that after every impact; it gets (1 + e) times the reduced
    inertia of both, 1 / (1 / J + 9 / I), times its rate. I w - 3 J v is kept.
    """
    e, speed = 0.6, 2.0
    engine = Engine(gears(speed, f", restitution: {e}"), "rkmk4", 1e-2)
    engine.advance(100)
    events = engine.drain_events()
    reduced = 1.0 / (1.0 / PINION + 9.0 / WHEEL)
    rate, time, travel, side = 3.0 * speed, 0.0, 0.05, -1.0
    for event in events[:6]:
        time += travel / rate
        assert (event.joint, event.kind) == ("gears", "impact")
        assert event.time == pytest.approx(time, abs=1e-13)
        # Positive pin - (-3) axle: the wheel closes the upper end, the impulse is negative.
        assert event.impulse == pytest.approx(side * (1.0 + e) * reduced * rate, abs=1e-13)
        assert event.energy == pytest.approx(-0.5 * (1.0 - e * e) * reduced * rate**2, abs=1e-13)
        rate, travel, side = e * rate, 0.1, -side
    twist = engine.sample().twist
    assert WHEEL * twist[0, 2] - 3.0 * PINION * twist[1, 2] == pytest.approx(WHEEL * speed, abs=1e-13)


def test_torque_reversal():
    """A driven wheel takes the pinion along, and loses it for as long as the slack takes."""
    engine = Engine(gears(0.0), "rkmk4", 1e-2)
    engine.apply_effort("axle", 1.0)
    engine.advance(100)
    hit = math.sqrt(2.0 * 0.05 / (3.0 / WHEEL))
    (impact, stop) = engine.drain_events()
    assert (impact.kind, stop.kind) == ("impact", "stop")
    assert impact.time == pytest.approx(hit, abs=1e-13)
    assert engine.modes == {"gears": "upper"}
    # Torque of 1 N m gives wheel and pinion the momentum I w - 3 J v.
    rates = engine.sample().twist[:, 2]
    assert rates[1] == pytest.approx(-3.0 * rates[0], abs=1e-14)
    assert rates[0] == pytest.approx(1.0 / (WHEEL + 9.0 * PINION), abs=1e-12)
    engine.apply_effort("axle", -1.0)
    engine.advance(100)
    leave, impact, stop = engine.drain_events()
    assert leave.kind == "leave"
    # At once; then from end to end, 0.1 rad.
    assert leave.time == pytest.approx(1.0, abs=1e-14)
    assert impact.time == pytest.approx(1.0 + math.sqrt(2.0 * 0.1 / (3.0 / WHEEL)), abs=1e-12)
    assert engine.modes == {"gears": "lower"}
    rates = engine.sample().twist[:, 2]
    assert rates == pytest.approx(np.zeros(2), abs=1e-12)


def test_compliant_teeth():
    """Elastic teeth: contact takes half a period of the reduced inertia, and turns the rate round."""
    stiffness, speed = 500.0, 2.0
    engine = Engine(gears(speed, f", stiffness: {stiffness}"), "rkmk8", 1e-3)
    engine.advance(100)
    reduced = 1.0 / (1.0 / PINION + 9.0 / WHEEL)
    contact, free = math.pi * math.sqrt(reduced / stiffness), 0.1 / (3.0 * speed)
    first = 0.05 / (3.0 * speed)
    times = [first, first + contact, first + contact + free, first + 2.0 * contact + free]
    events = engine.drain_events()
    assert [event.kind for event in events[:4]] == ["stop", "leave"] * 2
    # rkmk8 follows the half sine in 7 steps of 1 ms to 1e-11.
    assert [event.time for event in events[:4]] == pytest.approx(times, abs=1e-9)
    assert engine.energy() == pytest.approx(0.5 * WHEEL * speed**2, abs=1e-8)


def test_a_cam_takes_its_follower_along():
    """The profile p(q) = 0.1 q + 0.2 q^2 hits the follower after half the play, and pushes it, as p'' > 0.

    The impact keeps I w + m p' x' and ends with x' = p' w; then the energy (I + m p'^2) w^2 / 2 is kept.
    """
    text = GEARS.replace("SPEED", "1.5").replace("pin, type: revolute", "pin, type: prismatic")
    text = text.replace("ratio: -3.0, backlash: {gap: 0.1 LIKE}", "ratio: 0.1, curve: [0.2], backlash: {gap: 0.1}")
    engine = Engine(scene_from_text(text), "rkmk8", 1e-2)
    engine.advance(100)
    (impact, stop) = engine.drain_events()
    q = (-0.1 + math.sqrt(0.1**2 + 4 * 0.2 * 0.05)) / 0.4
    slope = 0.1 + 0.4 * q
    impulse = slope * 1.5 / (1.0 + slope**2 / WHEEL)
    assert (impact.kind, stop.kind, impact.time) == ("impact", "stop", pytest.approx(q / 1.5, abs=1e-13))
    assert impact.impulse == pytest.approx(impulse, abs=1e-13)
    energy = (WHEEL + slope**2) * (1.5 - slope * impulse / WHEEL) ** 2
    sample = engine.sample()
    (q, w), (x, v) = (sample.joint_coordinates[name] for name in ("axle", "pin"))
    slope = 0.1 + 0.4 * q
    assert (x, v) == pytest.approx((0.1 * q + 0.2 * q**2 - 0.05, slope * w), abs=1e-14)
    assert (WHEEL + slope**2) * w**2 == pytest.approx(energy, abs=1e-13)


def test_rack_with_play():
    """A carriage hits the tooth of its pinion after half the play, and takes it along."""
    text = text_of("rack_backlash.yaml")
    engine = Engine(scene_from_text(text), "rkmk4", 1e-2)
    engine.advance(10)
    impact, stop = engine.drain_events()
    assert stop.kind == "stop"
    assert impact.time == pytest.approx(0.004, abs=1e-15)
    # The pinion is a mass of J / r^2 = 12 kg.
    together = 2.0 * 0.5 / (2.0 + 12.0)
    assert impact.impulse == pytest.approx(-2.0 * (0.5 - together), abs=1e-13)
    sample = engine.sample()
    assert sample.twist[0, 3] == pytest.approx(together, abs=1e-14)
    assert sample.twist[1, 2] == pytest.approx(together / 0.05, abs=1e-13)


def test_sleeve_with_stops_and_friction():
    """A turning ring on a vertical rod bounces on its end, while friction stops its rotation.

    Both coordinates of the cylindrical joint have closed forms: bounces at t0 (1 + 2 e + ...), the
    rotation J w / torque; the translation has no friction, and the rotation no influence.
    """
    text = text_of("ring_with_stops.yaml")
    engine = Engine(scene_from_text(text), "rkmk4", 1e-2)
    engine.advance(300)
    events = engine.drain_events()
    bounces = [e for e in events if e.joint == "rod/translation" and e.kind == "impact"]
    speed, time = math.sqrt(G), math.sqrt(1.0 / G)
    for event in bounces[:8]:
        assert event.time == pytest.approx(time, abs=1e-12)
        assert event.impulse == pytest.approx(2.0 * 1.5 * speed, abs=1e-12)
        speed *= 0.5
        time += 2.0 * speed / G
    turns = [event for event in events if event.joint == "rod/rotation"]
    assert [event.kind for event in turns] == ["impact", "stick"]
    brake = 0.1 / 0.04
    hit = (7.0 - math.sqrt(49.0 - 2.0 * brake * 5.0)) / brake
    rate = 7.0 - brake * hit
    assert turns[0].time == pytest.approx(hit, abs=1e-12)
    assert turns[0].impulse == pytest.approx(-0.04 * 1.8 * rate, abs=1e-12)
    assert turns[1].time == pytest.approx(hit + 0.8 * rate / brake, abs=1e-12)
    assert engine.modes == {"rod/rotation": "stick", "rod/translation": "lower"}


def test_sleeve_with_friction_along_and_about():
    """A ring slides down a rod against friction; it turns against other friction."""
    text = text_of("ring_along_and_about.yaml")
    engine = Engine(scene_from_text(text), "rkmk4", 1e-2)
    engine.advance(300)
    events = {event.joint: event for event in engine.drain_events()}
    assert {name: event.kind for name, event in events.items()} == {"rod/translation": "stick", "rod/rotation": "stick"}
    brake = G + 12.0 / 2.0
    assert events["rod/translation"].time == pytest.approx(1.5 / brake, abs=1e-13)
    assert events["rod/rotation"].time == pytest.approx(3.0 * 0.04 / 0.05, abs=1e-12)
    position = engine.sample().positions["ring"]
    assert position[2] == pytest.approx(1.5**2 / (2.0 * brake), abs=1e-13)


@pytest.mark.parametrize("pitch", [0.02, -0.02])
def test_nut_on_a_bolt(pitch):
    """A nut runs down its bolt by its weight against friction, and bounces at its end.

    About the axis the nut has the inertia J + m h^2 and the torque m g h - friction.
    """
    text = filled(text_of("nut_backlash.yaml"), pitch=pitch, limit="lower: -12" if pitch > 0 else "upper: 12")
    engine = Engine(scene_from_text(text), "rkmk4", 1e-3)
    engine.advance(2000)
    events = engine.drain_events()
    inertia, load = 0.002 + 3.0 * pitch**2, 3.0 * G * abs(pitch)
    down, up = (load - 0.2) / inertia, (load + 0.2) / inertia
    time = math.sqrt(2.0 * 12.0 / down)
    rate = down * time
    impacts = [event for event in events if event.kind == "impact"]
    for event in impacts[:5]:
        assert event.time == pytest.approx(time, abs=1e-12)
        assert abs(event.impulse) == pytest.approx(1.4 * inertia * rate, abs=1e-12)
        # Up until friction and weight stop it, and down again.
        rate *= 0.4
        height = rate**2 / (2.0 * up)
        time += rate / up + math.sqrt(2.0 * height / down)
        rate = math.sqrt(2.0 * down * height)
    assert len(impacts) >= 5
    assert engine.sample().positions["nut"][2] == pytest.approx(-12.0 * abs(pitch), abs=1e-13)
