# SPDX-License-Identifier: Apache-2.0
"""Stops of joints: impacts, contact and release, against closed forms."""

import itertools
import math

import mpmath
import numpy as np
import pytest
from convergence import fitted_order
from scene_files import cases, text_of
from stop_scenes import PRESS

from liegroup_core import SceneError, Simulation, SimulationError, reports
from liegroup_core.engine import Engine
from liegroup_core.scene.load import scene_from_text

pytestmark = pytest.mark.slow
G = 9.81

BALL = text_of("ball_stops.yaml")
# A block on a spring, at rest at -SIZE.
OSCILLATOR = text_of("oscillator_stops.yaml")
# A pendulum that hangs along -z at the angle 0 and swings in a tilted frame's plane.
PENDULUM = text_of("pendulum_stops.yaml")


def impacts(engine, count, steps):
    """The first impacts of an engine, in at most so many steps."""
    found = []
    for _ in range(steps):
        engine.advance(1)
        found += [event for event in engine.drain_events() if event.kind == "impact"]
        if len(found) >= count:
            return found[:count]
    return found


@pytest.mark.parametrize("method", ["rkmk4", "rkmk8", "rkmk853"])
def test_bouncing_ball(method):
    """Times of impacts are t0 (1 + 2 e + 2 e^2 + ...); speeds e^k v0. A ball is exact for every order."""
    e = 0.8
    engine = Engine(scene_from_text(BALL.replace("RESTITUTION", str(e))), method, 0.01)
    found = impacts(engine, 20, 500)
    speed = math.sqrt(2.0 * G)
    time = speed / G
    for event in found:
        assert event.time == pytest.approx(time, abs=1e-12)
        assert event.impulse == pytest.approx(2.0 * speed * (1.0 + e), abs=1e-11)
        assert event.energy == pytest.approx(-(1.0 - e * e) * speed**2, abs=1e-11)
        speed *= e
        time += 2.0 * speed / G
    assert len(found) == 20


@pytest.mark.parametrize("height", [1.0, 1e-4, 1e-8])
def test_small_balls_bounce_like_large_ones(height):
    """A drop from this height on a mechanism as small: all rebounds above 1e-10 of its size, and their times.

    Speeds e^k v0, heights e^2k h0. A ball is exact for every order. An impact is found to 1e-13 of a step,
    of 1/20 of the first fall: 53 of them to 3e-13 of it.
    """
    e, gyration = 0.8, 0.5
    inertia = repr([gyration**2 * height**2] * 3)
    text = BALL.replace("[0.1, 0.1, 0.1]", inertia).replace("[0, 0, 1]", repr([0, 0, height]))
    first = math.sqrt(2.0 * height / G)
    engine = Engine(scene_from_text(text.replace("RESTITUTION", str(e))), "rkmk4", first / 20.0)
    engine.advance(round(20 * (1.0 + e) / (1.0 - e)) + 20)
    found = [event for event in engine.drain_events() if event.kind == "impact"]
    time, flight = first, 2.0 * first
    size = math.sqrt(3.0 / 2.0) * gyration * height  # radius of gyration of mass 2
    # The impact after which a rebound would be too low is the last one.
    rebounds = math.floor(math.log(1e-10 * size / height) / (2.0 * math.log(e)))
    assert len(found) == rebounds + 1
    for event in found:
        assert event.time == pytest.approx(time, abs=1e-12 * first)
        flight *= e
        time += flight
    assert engine.modes == {"track": "lower"}


@pytest.mark.parametrize("rate", [1.0, 1e8])
def test_fast_small_oscillators_hit_their_stop_like_slow_large_ones(rate):
    """w = 1 rad/s and 1 m, 1e8 rad/s and 1 um, elastic stop at half of the amplitude: 119 impacts.

    From the stop back to it the phase w t advances by 2 (pi - arccos 0.5). rkmk8 with w h = 0.1 errs by
    less than 1e-14 a step; 5000 steps and the impacts, which only turn the phase back, by 5e-11 at most.
    """
    size = 1e-6 if rate > 1.0 else 1.0
    text = OSCILLATOR.replace("INERTIA", repr([0.1 * size**2] * 3)).replace("SIZE", repr(size))
    text = text.replace("STIFFNESS", repr(rate**2)).replace("STOP", repr(0.5 * size))
    engine = Engine(scene_from_text(text), "rkmk8", 0.1 / rate)
    period = 2.0 * (math.pi - math.acos(0.5))
    for _ in range(100):
        engine.advance(50)
        phase = rate * engine.time % period
        x = -size * math.cos(min(phase, period - phase))
        assert engine.sample().positions["block"][2] == pytest.approx(x, abs=5e-11 * size)
    assert engine.event_count == 119


@pytest.mark.parametrize("method, step", [("rkmk4", 1e-3), ("rkmk8", 1e-2), ("rkmk853", 1e-2)])
def test_bouncing_pendulum(method, step):
    """Twenty impacts of a pendulum at its lowest point: quarter periods are elliptic integrals."""
    start = 2.0
    text = PENDULUM.replace("ANGLE", str(start)).replace("LOWER", "0")
    engine = Engine(scene_from_text(text), method, step)
    found = impacts(engine, 20, round(30.0 / step))
    inertia, moment = 0.05 + 1.3 * 0.64, 1.3 * 0.8 * G
    small = math.sqrt(moment / inertia)
    rate = 2.0 * small * math.sin(0.5 * start)
    time = float(mpmath.ellipk(math.sin(0.5 * start) ** 2)) / small
    # The error of a time is that of the motion: for rkmk4 about 1e-10 s here, at 1 ms.
    for event in found:
        assert event.time == pytest.approx(time, abs=1e-9)
        assert event.impulse == pytest.approx(inertia * rate * 1.7, abs=1e-9)
        rate *= 0.7
        # It swings up and back: twice a quarter period, of the smaller amplitude.
        time += 2.0 * float(mpmath.ellipk((0.5 * rate / small) ** 2)) / small
    assert len(found) == 20


@pytest.mark.parametrize("method, order", [("rkmk2", 2), ("rkmk4", 4), ("rkmk8", 8)])
def test_order_of_event_times(method, order):
    """The time of the fifth impact converges with the order of the method."""
    text = PENDULUM.replace("ANGLE", "2.0").replace("LOWER", "-0.3")
    steps = {2: (8e-3, 4e-3, 2e-3), 4: (2e-2, 1e-2, 5e-3), 8: (0.2, 0.14, 0.1)}[order]
    exact = impacts(Engine(scene_from_text(text), "rkmk8", 5e-3), 5, 2000)[-1].time
    errors = [
        abs(impacts(Engine(scene_from_text(text), method, step), 5, round(10 / step))[-1].time - exact)
        for step in steps
    ]
    # Where in its step an impact is makes the error constant of single times irregular.
    assert fitted_order(steps, errors) == pytest.approx(order, abs=0.15 * order), errors


def test_contact_and_release():
    """A pendulum rests at a stop until its support force vanishes, under a torque that changes."""
    text = PENDULUM.replace("ANGLE", "0.4").replace("LOWER", "0.4")
    engine = Engine(scene_from_text(text), "rkmk4", 1e-2)
    engine.advance(50)
    assert engine.modes == {"pivot": "lower"}
    angle = engine.sample().joint_coordinates["pivot"]
    engine.advance(1000)
    # Bits do not change at rest.
    assert engine.sample().joint_coordinates["pivot"] == angle
    moment = 1.3 * 0.8 * G * math.sin(0.4)
    engine.apply_effort("pivot", 0.999999 * moment)
    engine.advance(100)
    assert engine.modes == {"pivot": "lower"}
    engine.apply_effort("pivot", 1.000001 * moment)
    engine.advance(1)
    assert engine.modes == {"pivot": "free"}
    assert [event.kind for event in engine.drain_events()] == ["leave"]


def test_bouncing_becomes_contact():
    """A bouncing that never ends is contact after a finite time: t0 (1 + e) / (1 - e)."""
    engine = Engine(scene_from_text(BALL.replace("RESTITUTION", "0.5")), "rkmk4", 0.01)
    engine.advance(200)
    events = engine.drain_events()
    end = math.sqrt(2.0 / G) * 3.0
    assert [event.kind for event in events][-1] == "stop"
    # The last rebound that is taken is 1e-10 of the size high, which is 0.39 m: it lasts 6e-6 s.
    assert events[-1].time == pytest.approx(end, abs=2e-5)
    assert engine.modes == {"track": "lower"}


def test_bouncing_with_many_impacts_in_a_step_becomes_contact():
    """Restitution 0.998 and steps of 0.1 s: 1600 rebounds above 1e-10 m in the last one.

    After 500 of them rebounds below 1e-8 of the size, 0.39 m, are none. Such a flight lasts 2 sqrt(2 height / g)
    = 5.6e-5 s, and all that follow 500 times as long.
    """
    text = BALL.replace("RESTITUTION", "0.998").replace("[0, 0, 1]", "[0, 0, 9.477e-6]")
    engine = Engine(scene_from_text(text), "rkmk4", 0.1)
    engine.advance(15)
    end = math.sqrt(2.0 * 9.477e-6 / G) * 1.998 / 0.002
    (last,) = [event for event in engine.drain_events() if event.kind == "stop"]
    assert 0.0 <= end - last.time <= 0.029
    assert engine.modes == {"track": "lower"}


def test_elastic_bouncing_keeps_its_energy():
    engine = Engine(scene_from_text(BALL.replace("RESTITUTION", "1.0")), "rkmk4", 0.01)
    energy = engine.energy()
    engine.advance(2000)
    assert len(engine.drain_events()) == 22
    assert engine.energy() == pytest.approx(energy, rel=1e-12)


def test_state_beyond_a_stop():
    engine = Engine(scene_from_text(BALL.replace("RESTITUTION", "1.0")), "rkmk4", 0.01)
    pose, twist = engine.state()
    pose[0, 11] = -0.1
    engine.set_state(pose, twist)
    with pytest.raises(SimulationError, match="joint track is beyond its stop"):
        engine.advance(1)


def test_a_place_beyond_a_stop_is_refused():
    """Rigid stops refuse it with one line, and nothing changes; compliant ones take it."""
    text = PENDULUM.replace("ANGLE", "0.4").replace("LOWER", "0.1, upper: 2")
    engine = Engine(scene_from_text(text), "rkmk4", 1e-2)
    engine.advance(3)
    before = engine.state()
    for angle in (0.0999, 0.1 - 1e-8, -3.0):
        with pytest.raises(SceneError, match="joint pivot would be beyond its stop: its position"):
            engine.place(joints={"pivot": (angle, 0.0)})
        assert all(map(np.array_equal, engine.state(), before))
    turned = engine.sample().pose_matrices[0].copy()
    turned[:3, :3] = [[1, 0, 0], [0, math.cos(0.05), -math.sin(0.05)], [0, math.sin(0.05), math.cos(0.05)]]
    with pytest.raises(SceneError, match="0.05 rad is not between 0.1 and 2"):
        engine.place({"bob": turned})
    engine.place(joints={"pivot": (0.1, 0.0)})
    engine.advance(1)
    assert engine.modes == {"pivot": "lower"}
    soft = Engine(scene_from_text(text.replace("restitution: 0.7", "stiffness: 100")), "rkmk4", 1e-2)
    soft.place(joints={"pivot": (0.05, 0.0)})
    assert soft.sample().joint_coordinates["pivot"][0] == pytest.approx(0.05, abs=1e-12)


def test_the_modes_before_the_first_step_are_those_of_the_first_step():
    """To ask for them changes no bit of the run, also after another run."""
    text = PENDULUM.replace("ANGLE", "0.4").replace("LOWER", "0.4")
    engine, other = (Engine(scene_from_text(text), "rkmk8", 1e-2) for _ in range(2))
    for _ in range(2):
        assert engine.sample().modes == {"pivot": "lower"}
        # At rest its stop bears the weight: the reaction about the axis is not that of a free joint.
        assert abs(engine.sample().reactions["pivot"][2]) == pytest.approx(1.3 * 0.8 * G * math.sin(0.4), abs=1e-12)
        for each in (engine, other):
            each.apply_effort("pivot", 6.0, start=0.1)
            each.advance(100)
        assert all(map(np.array_equal, engine.state(), other.state()))
        assert engine.event_count == other.event_count > 0
        for each in (engine, other):
            each.reset()


def test_an_impact_at_the_start_is_an_event():
    """1 m/s towards the stop that it touches, and e = 0.9: p = m (1 + e) v, loss m (1 - e^2) v^2 / 2."""
    text = BALL.replace("RESTITUTION", "0.9")
    text = text.replace("position: [0, 0, 1]", "linear_velocity: [0, 0, -1]")
    engine = Engine(scene_from_text(text), "rkmk4", 0.01)
    engine.drain_impacts()
    engine.drain_instants()
    for speed, place in ((1.0, False), (2.0, True)):
        if place:
            engine.place(joints={"track": (0.0, -speed)})
        start = engine.time
        engine.sample()  # it shows the modes of the first step, and neither uses nor doubles events
        assert engine.event_count == 0
        assert engine.drain_events() == engine.drain_impacts() == engine.drain_instants() == []
        engine.advance(1)
        (event,) = engine.drain_events()
        assert event == (start, "track", "impact", pytest.approx(3.8 * speed), event.energy)
        assert event.energy == pytest.approx(-0.19 * speed**2)
        assert engine.event_count == 1
        (instant,) = engine.drain_instants()
        assert instant.events == [event]
        (impact,) = engine.drain_impacts()
        assert impact.impulses["track"][5] == pytest.approx(3.8 * speed)


def test_a_start_at_a_stop_is_no_event():
    """A ball that lies on its stop, and one that falls on it at the start and stays there."""
    text = BALL.replace("RESTITUTION", "0").replace("position: [0, 0, 1]", "")
    engine = Engine(scene_from_text(text), "rkmk4", 0.01)
    engine.advance(1)
    assert engine.modes == {"track": "lower"} and engine.drain_events() == []
    engine.place(joints={"track": (0.0, -1.0)})
    engine.advance(1)
    assert [event.kind for event in engine.drain_events()] == ["impact", "stop"]
    assert engine.event_count == 2


def test_instants_have_the_modes_after_their_events():
    """The modes of the last instant are those of the state; an undone step leaves none behind."""
    engine = Engine(scene_from_text(BALL.replace("RESTITUTION", "0.5")), "rkmk4", 0.01)
    assert engine.drain_instants() == []
    engine.advance(200)
    instants, events = engine.drain_instants(), engine.drain_events()
    assert [event for instant in instants for event in instant.events] == events
    assert {type(value) for event in events for value in event} == {float, str}  # none of NumPy
    assert np.array_equal(instants[-1].modes, engine.sample().switching)
    assert instants[0].events == [] and instants[0].time == 0.0
    # A rebound of 1 um takes 0.9 ms: more than a thousand in a step of 1 s.
    text = BALL.replace("RESTITUTION", "1").replace("position: [0, 0, 1]", "position: [0, 0, 1.0e-6]")
    engine = Engine(scene_from_text(text), "rkmk4", 1.0)
    engine.drain_instants()
    with pytest.raises(SimulationError, match="more than 1000 impacts"):
        engine.advance(1)
    assert engine.drain_events() == []
    assert all(instant.events == [] for instant in engine.drain_instants())
    assert engine.sample().joint_coordinates["track"][0] == pytest.approx(1e-6, abs=1e-18)


def test_impulses_of_the_joints_at_an_impact():
    """The pivot of a pendulum that hits its stop gets the momentum of the bob, and the stop's impulse.

    With the jump dw of its rate: force impulse m l dw across the rod, torque impulse I dw + m l^2 dw
    about the pivot. The centre of mass hangs at its lowest point.
    """
    text = PENDULUM.replace("ANGLE", "2.0").replace("LOWER", "0")
    engine = Engine(scene_from_text(text), "rkmk8", 5e-3)
    assert engine.drain_impacts() == []
    (event,) = impacts(engine, 1, 500)
    (impact,) = engine.drain_impacts()
    assert impact.time == event.time
    jump = event.impulse / (0.05 + 1.3 * 0.64)
    impulse = impact.impulses["pivot"]
    assert impulse[2] == pytest.approx(event.impulse, abs=1e-12)
    assert np.linalg.norm(impulse[3:]) == pytest.approx(abs(1.3 * 0.8 * jump), abs=1e-12)
    # Products of inertia: the bob's about its x and y axes.
    assert np.linalg.norm(impulse[:2]) == pytest.approx(abs(0.01 * jump), abs=1e-12)


@pytest.mark.turn(3)
def test_impulses_in_a_closed_loop_are_the_changes_of_momentum():
    """At the stop of a slider-crank the impulses of the joints are what the momenta of its bodies lose."""
    scene = scene_from_text(PRESS)
    engine = Engine(scene, "rkmk4", 1e-5, stabilisation="projection")
    engine.drain_impacts()
    while not (found := engine.drain_impacts()):
        before = engine.sample()
        engine.advance(1)
    after, (impact, *_) = engine.sample(), found
    world = np.zeros(3)
    for joint in scene.joints:
        if joint.parent == "world":
            turn = after.poses[joint.child][:3, :3] @ after.child_frames[joint.name][:3, :3]
            world += turn @ np.nan_to_num(impact.impulses[joint.name][3:])
    change = after.spatial_momentum[3:] - before.spatial_momentum[3:]
    # In 1e-5 s joint forces of 100 N change it by 1e-3 of what the impact does.
    assert world[:2] == pytest.approx(change[:2], abs=5e-3 * np.abs(change).max())


SHUTTLE = text_of("shuttle.yaml")


def test_impacts_without_end_are_plastic_with_a_warning(caplog):
    """Between two elastic stops 0.5 um apart: 20 000 impacts in a step of 10 ms; no energy is gained."""
    engine = Engine(scene_from_text(SHUTTLE), "rkmk4", 1e-2)
    engine.advance(2)
    messages = [record.getMessage() for record in caplog.records]
    expected = "impacts follow each other without end at track: they are plastic"
    assert sum(expected in message for message in messages) == 1
    assert engine.energy() == 0.0


@pytest.mark.parametrize("options", [{"accuracy": 1e-3}, {"method": "rkmk4", "estimate": True}])
def test_the_estimate_knows_that_elastic_impacts_were_made_plastic(options):
    """The block of the test above is at rest, and the true one at 1 m/s for ever: the error is not known."""
    simulation = Simulation(scene_from_text(SHUTTLE), step=1e-2, quiet=True, **options)
    simulation.advance(2)
    kept = simulation.snapshot()
    for _ in range(2):  # also from a snapshot between two estimates
        simulation.advance(20)
        sample = simulation.sample()
        assert sample.twists["block"][5] == 0.0 and np.isinf(sample.error["block"]).all()
        assert simulation.predictable_until <= 0.1 and simulation.doubt
        assert simulation.accurate_until <= 0.1 or "method" in options
        simulation.restore(kept)
    simulation.reset()
    simulation.place(twists={"block": np.zeros(6)})
    simulation.advance(20)
    assert simulation.sample().error["block"].max() <= 1e-12 and not simulation.doubt


def test_bouncing_that_ends_by_itself_is_made_plastic_without_a_doubt():
    """In a step of 1 s the bouncing of restitution 0.99 ends, at t0 (1 + e) / (1 - e), after 500 impacts.

    Rebounds that last below 1e-2 exp(-0.01 500) s = 7e-5 s are 6e-9 m high: so much the ball may err.
    """
    ball = scene_from_text(BALL.replace("RESTITUTION", "0.99"))
    simulation = Simulation(ball, "rkmk4", 1.0, estimate=True, quiet=True)
    simulation.advance(math.floor(math.sqrt(2.0 / G) * 199.0) + 8)
    assert simulation._switching.endless is not None  # that it is made plastic
    assert simulation.modes == {"track": "lower"}
    assert abs(simulation.sample().positions["ball"][2]) <= 6e-9
    assert simulation.predictable_until == math.inf and not simulation.doubt


def test_events_at_very_short_intervals_are_found_with_a_warning(caplog, monkeypatch):
    """Between two elastic stops 50 um apart at 1 m/s: an impact each 50 us, and no energy is lost."""
    scene = SHUTTLE.replace("5.0e-7", "5.0e-5")
    clock = itertools.count(step=0.02)  # s of CPU time at each look, two in a call
    monkeypatch.setattr(reports, "thread_time", lambda: next(clock))
    engine = Engine(scene_from_text(scene), "rkmk4", 1e-3)
    for _ in range(60):
        engine.advance(1)
    messages = [record.getMessage() for record in caplog.records]
    expected = "takes 20 s of CPU time at t = 0.05 s: 999 events, most at track (999)"
    assert sum(expected in message for message in messages) == 1
    assert engine.event_count in (1199, 1200)  # the last one is at 0.06 s
    assert engine.energy() == 0.5


# A rotor that runs freely about z at RATE towards an elastic stop at the angle STOP.
ROTOR = text_of("rotor_stops.yaml")
STOP = 628.3


def rotor(rate, kind="revolute"):
    limits = f"limits: {{upper: {STOP}, restitution: 1}}"
    if kind == "cylindrical":
        limits = f"limits: {{rotation: {{upper: {STOP}, restitution: 1}}}}"
    linear = "[0, 0, 0]"
    if kind == "screw":
        limits, linear = f"pitch: 0.001, {limits}", f"[0, 0, {0.001 * rate}]"
    text = ROTOR.replace("RATE", f"{rate}").replace("LIMITS", limits)
    return scene_from_text(text.replace("KIND", kind).replace("LINEAR", linear))


@pytest.mark.parametrize("kind, rate, step", cases("a_stop_after_many_turns_is_met_at_more_than_half_a_turn_per_step"))
def test_a_stop_after_many_turns_is_met_at_more_than_half_a_turn_per_step(kind, rate, step):
    """The angle is rate t until STOP, and then 2 STOP - rate t.

    Tolerance: the rounding of sums of n angles of up to STOP, one per substep of at most half a turn.
    """
    simulation = Simulation(rotor(rate, kind), step=step)
    steps = round(1.5 * STOP / rate / step)
    simulation.advance(steps)
    sample = simulation.sample()
    x = sample.pose_matrices[0]
    angle, true = math.atan2(x[1, 0], x[0, 0]), 2.0 * STOP - rate * simulation.time
    tolerance = (steps + 2.0 * STOP / math.pi) * STOP * 2.0**-52
    assert abs(math.remainder(angle - true, 2.0 * math.pi)) < tolerance
    assert sample.twists["rotor"][2] == pytest.approx(-rate, rel=1e-12)
    assert sample.switching[0, 3] == pytest.approx(true, abs=tolerance)
    assert simulation.accurate_until == math.inf


def test_a_fixed_step_in_which_the_turn_is_lost_is_refused():
    """The rotor turns by 3.2 rad in a step."""
    engine = Engine(rotor(400.0), "rkmk4", 0.008)
    with pytest.raises(SimulationError, match="stops 'bearing' rotates by pi or more within one step"):
        engine.advance(1)
    assert engine.steps == 0
    Engine(rotor(400.0), "rkmk4", 0.0078).advance(10)  # 3.12 rad
