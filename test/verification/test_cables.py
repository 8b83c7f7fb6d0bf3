# SPDX-License-Identifier: Apache-2.0
"""Cables and struts: taut, slack, elastic, between free bodies, against closed forms."""

import math

import mpmath
import numpy as np
import pytest
import yaml
from convergence import fitted_order
from scene_files import cases, text_of
from scipy.optimize import brentq

from liegroup_core.engine import Engine
from liegroup_core.joint_events import has_impacts
from liegroup_core.scene.load import scene_from_text

pytestmark = pytest.mark.slow
G = 9.81
LENGTH = 0.9


def bob(position, velocity, cable, gravity=G, type="cable"):
    """Ball of 1.5 kg on a cable of LENGTH from the origin of the world."""
    body = {"name": "bob", "mass": 1.5, "inertia": [0.01, 0.02, 0.015]}
    for key, vector in (("position", position), ("linear_velocity", velocity)):
        body[key] = [float(x) for x in vector]
    rope = {"name": "rope", "type": type, "parent": "world", "child": "bob", "parent_frame": {}}
    rope |= {"child_frame": {}, "length": LENGTH} | cable
    scene = {"name": "bob", "gravity": [0, 0, -gravity], "bodies": [body], "joints": [rope]}
    return scene_from_text(yaml.safe_dump(scene))


def events_of(engine, time):
    """Events of a run."""
    engine.advance(round(time / engine.step))
    return engine.drain_events()


def swing(start, speed, way):
    """(time, angle, speed) at which a pendulum of LENGTH goes slack, or None; angles from the nadir.

    speed, way : at the angle `start`, and its direction, 1 or -1
    The cable bears m (v^2 / l + g cos): it is slack where cos = (2 - v0^2 / g l) / 3 with the speed v0
    at the nadir.
    """
    of_nadir = speed**2 + 2.0 * G * LENGTH * (1.0 - math.cos(start))
    cosine = (2.0 - of_nadir / (G * LENGTH)) / 3.0
    if not -1.0 < cosine < 0.0:
        return None
    end = math.acos(cosine)
    m = 4.0 * G * LENGTH / of_nadir
    begin, small = way * start, 2.0 * LENGTH / math.sqrt(of_nadir)
    time = small * float(mpmath.ellipf(0.5 * end, m) - mpmath.ellipf(0.5 * begin, m))
    return time, way * end, math.sqrt(-G * LENGTH * cosine)


@pytest.mark.parametrize("method, step", [("rkmk4", 5e-4), ("rkmk8", 1e-2), ("rkmk853", 1e-2)])
def test_swinging_slack_and_taut(method, step):
    """A ball swings on its cable, leaves the circle, falls, and is caught again by the cable.

    Where it leaves the circle, gravity alone gives its curvature: the distance from the anchor
    departs with the third power of time. It meets the circle again after 4 v sin / g. The cable takes
    the radial speed, and the ball swings on.
    """
    start = math.sqrt(4.2 * G * LENGTH)
    engine = Engine(bob([0, 0, -LENGTH], [start, 0, 0], {}), method, step)
    energy = engine.energy()
    found = events_of(engine, 4.0)
    time, angle, speed, way = 0.0, 0.0, start, 1.0
    expected, losses = [], []
    while swung := swing(angle, speed, way):
        swing_time, angle, speed = swung
        time += swing_time
        expected.append(("leave", time, 0.0))
        # Flight, tangential to the circle: `forwards` in the direction of growing angles.
        flight = 4.0 * speed * abs(math.sin(angle)) / G
        at = LENGTH * np.array([math.sin(angle), -math.cos(angle)])
        v = way * speed * np.array([math.cos(angle), math.sin(angle)])
        at, v = at + flight * v - [0.0, 0.5 * G * flight**2], v - [0.0, G * flight]
        time += flight
        angle = math.atan2(at[0], -at[1])
        radial = v @ at / LENGTH
        along = v @ [math.cos(angle), math.sin(angle)]
        expected += [("impact", time, -1.5 * radial), ("stop", time, 0.0)]
        losses.append(-0.75 * radial**2)
        speed, way = abs(along), math.copysign(1.0, along)
    expected = [entry for entry in expected if entry[1] < 4.0]
    assert len(losses) >= 1
    assert [event.kind for event in found] == [kind for kind, *_ in expected]
    # Event times have the error of the swing, 1e-10 of the methods at these steps. Impulses change
    # with them by the force of the cable, 50 N.
    for event, (_, time, impulse) in zip(found, expected):
        assert event.time == pytest.approx(time, abs=1e-9)
        assert event.impulse == pytest.approx(impulse, abs=1e-8)
    lost = [event.energy for event in found if event.kind == "impact"]
    assert lost == pytest.approx(losses[: len(lost)], abs=1e-8)
    assert engine.energy() - energy == pytest.approx(sum(lost), abs=1e-8)


def test_tension():
    """The reaction of a taut cable is its tension m (v^2 / l + g cos); of a slack one zero."""
    engine = Engine(bob([0, 0, -LENGTH], [math.sqrt(4.2 * G * LENGTH), 0, 0], {}), "rkmk8", 5e-3)
    modes = set()
    for _ in range(200):
        engine.advance(1)
        sample = engine.sample()
        at, v = sample.positions["bob"], sample.pose_matrices[0][:3, :3] @ sample.twist[0, 3:]
        modes.add(sample.modes["rope"])
        taut = sample.modes["rope"] == "upper"
        tension = 1.5 * (v @ v / LENGTH - G * at[2] / LENGTH) if taut else 0.0
        assert np.linalg.norm(sample.reactions["rope"][3:]) == pytest.approx(tension, abs=1e-10)
        assert np.abs(sample.reactions["rope"][:3]).max() == 0.0
        assert np.linalg.norm(at) <= LENGTH + 1e-12
    assert modes == {"upper", "free"}


def flights(at, v, e, inside):
    """(time, speed of impact) of a ball that bounces off a sphere of LENGTH about the origin.

    at, v : (3,) on the sphere, after an impact.  inside : True: it is within the sphere
    |at + v t - g t^2 / 2|^2 = l^2 is a cubic in t; with 40 digits
    """
    with mpmath.workdps(40):
        at, v = mpmath.matrix(at), mpmath.matrix(v)
        g = mpmath.matrix([0, 0, -mpmath.mpf(G)])
        time = mpmath.mpf(0)
        while True:
            dot = lambda a, b: (a.T * b)[0]  # noqa: E731
            p = [dot(g, g) / 4, dot(g, v), dot(v, v) + dot(g, at), 2 * dot(at, v)]
            roots = np.roots([float(x) for x in p])
            start = min(r.real for r in roots if abs(r.imag) < 1e-9 * abs(r) and r.real > 0.0)
            flight = mpmath.findroot(lambda t, p=p: ((p[0] * t + p[1]) * t + p[2]) * t + p[3], start)
            time += flight
            at, v = at + v * flight + g * (flight**2 / 2), v + g * flight
            normal = at / mpmath.norm(at)
            speed = dot(v, normal)
            v = v - normal * ((1 + mpmath.mpf(e)) * speed)
            yield float(time), float(speed)


@pytest.mark.parametrize("method", ["rkmk2", "rkmk8"])
def test_bouncing_on_a_cable(method):
    """A ball that bounces in its cable: flights are parabolas, exact for every order."""
    e, at, v = 0.8, np.array([0.3, -0.2, 0.0]), np.array([0.4, 0.3, 0.2])
    engine = Engine(bob(at, v, {"restitution": e}), method, 1e-2)
    found = [event for event in events_of(engine, 3.0) if event.kind == "impact"]
    gap = lambda t: np.linalg.norm(at + v * t - [0, 0, 0.5 * G * t * t]) - LENGTH  # noqa: E731
    first = brentq(gap, 0.0, 1.0, xtol=1e-16, rtol=1e-15)
    at, v = at + v * first - [0, 0, 0.5 * G * first**2], v - [0, 0, G * first]
    normal = at / np.linalg.norm(at)
    expected = [(first, v @ normal)]
    for time, speed in flights(at, v - 1.8 * (v @ normal) * normal, e, True):
        if first + time > 3.0 or speed < 1e-3:
            break
        expected.append((first + time, speed))
    assert len(expected) >= 10
    # The first time is known to round-off; from bounce to bounce it grows by the ratio of their times.
    for event, (time, speed) in zip(found, expected):
        assert event.time == pytest.approx(time, abs=1e-11)
        assert event.impulse == pytest.approx(-1.5 * speed * 1.8, abs=1e-10)
        assert event.energy == pytest.approx(-0.75 * speed**2 * 0.36, abs=1e-10)


def test_an_elastic_cable_bounces_for_ever():
    """A ball falls into an elastic cable: times of twenty contacts, of flight and half swing."""
    stiffness, drop = 400.0, 0.5
    scene = bob([0, 0, drop - LENGTH], [0, 0, 0], {"stiffness": stiffness})
    engine = Engine(scene, "rkmk8", 2e-3)
    found = events_of(engine, 10.0)
    omega, speed = math.sqrt(stiffness / 1.5), math.sqrt(2.0 * G * drop)
    sag = 1.5 * G / stiffness
    contact = (2.0 * math.pi - 2.0 * math.atan2(speed / omega, sag)) / omega
    fall = speed / G
    times = [fall + k * (contact + 2.0 * fall) + part for k in range(20) for part in (0.0, contact)]
    times = [time for time in times if time < 10.0]
    assert [event.kind for event in found] == ["stop", "leave"] * (len(times) // 2) + ["stop"] * (len(times) % 2)
    # The method follows the swing to 1e-12 in each contact.
    assert [event.time for event in found] == pytest.approx(times, abs=1e-10)
    assert engine.energy() == pytest.approx(scene_energy(drop - LENGTH), abs=1e-9)


def scene_energy(height):
    """Energy of the ball at rest at a height."""
    return 1.5 * G * height


def test_a_damped_cable_does_not_push():
    """With damping the cable is slack again where stiffness and damping cancel, before its length."""
    stiffness, damping, drop = 400.0, 12.0, 0.5
    cable = {"stiffness": stiffness, "damping": damping}
    engine = Engine(bob([0, 0, drop - LENGTH], [0, 0, 0], cable), "rkmk8", 1e-3)
    taut, slack = events_of(engine, 0.6)[:2]
    m, begin, speed = 1.5, math.sqrt(2.0 * drop / G), math.sqrt(2.0 * G * drop)
    decay = 0.5 * damping / m
    omega, sag = math.sqrt(stiffness / m - decay**2), m * G / stiffness
    # Depth d = sag + exp(-decay t) (a cos + b sin), from 0 with the speed of the fall.
    a = -sag
    b = (speed + decay * a) / omega

    def depth(t):
        return sag + math.exp(-decay * t) * (a * math.cos(omega * t) + b * math.sin(omega * t))

    def rate(t):
        c, s = math.cos(omega * t), math.sin(omega * t)
        return math.exp(-decay * t) * ((b * omega - decay * a) * c - (a * omega + decay * b) * s)

    off = brentq(lambda t: stiffness * depth(t) + damping * rate(t), 1e-3, 1.3 * math.pi / omega, xtol=1e-15)
    assert depth(off) > 1e-2
    assert (taut.kind, slack.kind) == ("stop", "leave")
    assert taut.time == pytest.approx(begin, abs=1e-13)
    assert slack.time == pytest.approx(begin + off, abs=1e-11)


def test_a_ball_slides_off_a_sphere():
    """On a strut a ball moves on a sphere, and leaves it where cos = 2/3 + v^2 / 3 g r from the top."""
    speed = 0.5
    engine = Engine(bob([0, 0, LENGTH], [speed, 0, 0], {}, type="strut"), "rkmk8", 2e-3)
    (event,) = events_of(engine, 0.75)
    end = math.acos(2.0 / 3.0 + speed**2 / (3.0 * G * LENGTH))
    time = mpmath.quad(lambda x: 1 / mpmath.sqrt(speed**2 + 4 * G * LENGTH * mpmath.sin(x / 2) ** 2), [0, end])
    assert event.kind == "leave"
    assert event.time == pytest.approx(LENGTH * float(time), abs=1e-11)
    assert engine.modes == {"rope": "free"}


@pytest.mark.parametrize("method", ["rkmk2", "rkmk853"])
def test_bouncing_on_a_strut(method):
    """A ball that falls on a strut and bounces off it, as off a sphere."""
    at, v, e = np.array([0.02, 0.01, 1.2]), np.array([0.0, 0.03, 0.0]), 0.9
    engine = Engine(bob(at, v, {"restitution": e}, type="strut"), method, 1e-2)
    found = [event for event in events_of(engine, 2.0) if event.kind == "impact"]
    gap = lambda t: np.linalg.norm(at + v * t - [0, 0, 0.5 * G * t * t]) - LENGTH  # noqa: E731
    first = brentq(gap, 0.0, 0.3, xtol=1e-16, rtol=1e-15)
    at, v = at + v * first - [0, 0, 0.5 * G * first**2], v - [0, 0, G * first]
    normal = at / np.linalg.norm(at)
    times, speeds = [first], [v @ normal]
    chain = flights(at, v - 1.9 * (v @ normal) * normal, e, False)
    for _ in range(2):
        time, speed = next(chain)
        times.append(first + time)
        speeds.append(speed)
    assert len(found) >= 3
    # A sphere turns an error of the place by 2 t v / r: every bounce multiplies it by about 5.
    for event, time, speed in zip(found, times, speeds):
        assert event.time == pytest.approx(time, abs=1e-12)
        assert event.impulse == pytest.approx(-1.5 * 1.9 * speed, abs=1e-11)


def two_bodies(ends, e):
    """Two tumbling bodies with a slack cable; ends: (2, 3) where it is fixed."""
    bodies = [
        {
            "name": "left",
            "mass": 1.2,
            "inertia": [0.02, 0.03, 0.025],
            "linear_velocity": [-1.0, 0.2, 0.1],
            "angular_velocity": [1.0, 2.0, -3.0],
        },
        {
            "name": "right",
            "mass": 0.7,
            "inertia": [0.01, 0.03, 0.03],
            "position": [0.5, 0.0, 0.0],
            "linear_velocity": [0.4, -0.1, 0.3],
            "angular_velocity": [-2.0, 1.0, 0.5],
        },
    ]
    rope = {"name": "rope", "type": "cable", "parent": "left", "child": "right", "length": LENGTH}
    rope |= {"parent_frame": {"position": ends[0]}, "child_frame": {"position": ends[1]}}
    scene = {"name": "two", "gravity": [0, 0, 0], "bodies": bodies}
    return scene_from_text(yaml.safe_dump(scene | {"joints": [rope | {"restitution": e}]}))


def test_a_cable_between_two_free_bodies():
    """It takes half the reduced mass times the square of the speed of separation, less the rebound."""
    e = 0.5
    engine = Engine(two_bodies([[0, 0, 0], [0, 0, 0]], e), "rkmk8", 5e-3)
    sample = engine.sample()
    momentum, energy = sample.spatial_momentum, sample.energy
    d, v = np.array([0.5, 0, 0]), np.array([1.4, -0.3, 0.2])
    p = [v @ v, 2.0 * (d @ v), d @ d - LENGTH**2]
    time = max(np.roots(p).real)
    speed = v @ (d + v * time) / LENGTH
    reduced = 1.2 * 0.7 / 1.9
    (event,) = events_of(engine, 1.0)
    assert event.time == pytest.approx(time, abs=1e-13)
    assert event.impulse == pytest.approx(-reduced * (1.0 + e) * speed, abs=1e-13)
    assert event.energy == pytest.approx(-0.5 * reduced * (1.0 - e * e) * speed**2, abs=1e-13)
    sample = engine.sample()
    assert sample.spatial_momentum == pytest.approx(momentum, abs=1e-13)
    # Rotations about the centres of mass are those of free bodies, with the error of the method.
    assert sample.energy - energy == pytest.approx(event.energy, abs=1e-11)


CHAIN = text_of("chain_cables.yaml")


def test_a_taut_cable_is_a_rod():
    """As long as the cable is taut, a chain moves as with a rod of its length, and bears the same force."""
    samples = []
    for kind in ("cable", "distance"):
        text = CHAIN.replace("KIND", kind).replace(" LENGTH", "")
        if kind == "cable":
            text = text.replace("[0.4, 0, 0]}", f"[0.4, 0, 0]}}, length: {math.sqrt(0.13)}")
        engine = Engine(scene_from_text(text), "rkmk8", 2e-3, group="relative")
        engine.advance(150)
        samples.append(engine.sample())
    assert samples[0].modes == {"rope": "upper"}
    # Both solve the same equations: 1e-15 in each of 150 steps.
    assert samples[0].pose == pytest.approx(samples[1].pose, abs=1e-11)
    assert samples[0].twist == pytest.approx(samples[1].twist, abs=1e-10)
    for joint in ("shoulder", "elbow", "rope"):
        reactions = [np.nan_to_num(sample.reactions[joint]) for sample in samples]
        assert reactions[0] == pytest.approx(reactions[1], abs=1e-9)


def test_a_cable_that_is_too_long_to_matter():
    """A cable beyond the reach of the chain changes nothing."""
    engines = []
    for text in (CHAIN.replace("LENGTH", ", length: 3.0"), CHAIN.split("  - {name: rope")[0]):
        engine = Engine(scene_from_text(text.replace("KIND", "cable")), "rkmk8", 2e-3, group="relative")
        engine.advance(1000)
        engines.append(engine)
    assert engines[0].event_count == 0
    # Bit-identical motion of a chaotic chain, or else it would differ by 1e-10 at the end.
    assert engines[0].state()[0].tobytes() == engines[1].state()[0].tobytes()


@pytest.mark.parametrize("method, order", [("rkmk4", 4), ("rkmk8", 8)])
@pytest.mark.parametrize("count, restitution", [(1, 0.0), (3, 0.4)])
def test_order_of_event_times(method, order, count, restitution):
    """Times at which the cable of a chain becomes taut converge with the order of the method."""
    text = CHAIN.replace("KIND", "cable").replace("LENGTH", f", length: 0.75, restitution: {restitution}")
    steps = {4: (1e-2, 5e-3, 2.5e-3), 8: (4e-2, 2.8e-2, 2e-2)}[order]

    def time_of(method, step):
        engine = Engine(scene_from_text(text), method, step, stabilisation="projection")
        impacts = [e.time for e in events_of(engine, 1.2) if e.kind == "impact"]
        return impacts[count - 1]

    exact = time_of("rkmk8", 1e-3)
    errors = [abs(time_of(method, step) - exact) for step in steps]
    # Where in its step an impact is makes the error constant of single times irregular.
    assert fitted_order(steps, errors) >= order - 0.6, errors


def test_a_slack_cable_through_its_anchor():
    """The distance has no direction at its zero: a slack cable passes there as if it were not."""
    for start in (-0.5, -0.503):
        engine = Engine(bob([start, 0, 0], [1.0, 0, 0], {"restitution": 1.0}, gravity=0.0), "rkmk4", 0.01)
        found = events_of(engine, 4.9)
        times = LENGTH - start + 2.0 * LENGTH * np.arange(3)
        assert [event.time for event in found] == pytest.approx(times[times < 4.9], abs=1e-12)
        assert {event.kind for event in found} == {"impact"}


def test_cables_in_parallel():
    """A plate falls into four cables at once: one of them depends on the others, and it rests at once.

    The impulses sum up to its momentum, with equal shares by symmetry; then each bears a quarter.
    """
    corners = [[x, y, 0] for x in (-0.5, 0.5) for y in (-0.5, 0.5)]
    body = {"name": "plate", "mass": 2.0, "inertia": [0.2, 0.2, 0.4], "position": [0, 0, -0.6]}
    ropes = [
        {
            "name": f"rope{i}",
            "type": "cable",
            "parent": "world",
            "child": "plate",
            "parent_frame": {"position": corner},
            "child_frame": {"position": corner},
            "length": 1.0,
        }
        for i, corner in enumerate(corners)
    ]
    scene = {"name": "swing", "gravity": [0, 0, -G], "bodies": [body], "joints": ropes}
    engine = Engine(scene_from_text(yaml.safe_dump(scene)), "rkmk4", 1e-3)
    found = events_of(engine, 0.5)
    speed = math.sqrt(2.0 * G * 0.4)
    impacts = [event for event in found if event.kind == "impact"]
    assert {round(event.time, 12) for event in found} == {round(math.sqrt(0.8 / G), 12)}
    assert [event.impulse for event in impacts] == pytest.approx([-0.5 * speed] * 4, abs=1e-12)
    sample = engine.sample()
    assert sample.positions["plate"] == pytest.approx([0, 0, -1.0], abs=1e-13)
    assert np.abs(sample.twist).max() < 1e-14
    loads = [np.linalg.norm(sample.reactions[rope["name"]][3:]) for rope in ropes]
    assert sum(loads) == pytest.approx(2.0 * G, abs=1e-11)
    assert set(sample.modes.values()) == {"upper"}


@pytest.mark.parametrize("kind, more, expected", cases("what_has_impacts"))
def test_what_has_impacts(kind, more, expected):
    """Rigid stops of every kind have impacts; compliant ones and friction have none."""
    joint = {"name": "j", "type": kind, "parent": "world", "child": "bob", "parent_frame": {}}
    scene = {
        "name": "bob",
        "gravity": [0, 0, -G],
        "bodies": [{"name": "bob", "mass": 1.5, "inertia": [0.01, 0.02, 0.015]}],
        "joints": [joint | {"child_frame": {}} | more],
    }
    assert has_impacts(scene_from_text(yaml.safe_dump(scene))) == expected
