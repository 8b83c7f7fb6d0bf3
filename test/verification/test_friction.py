# SPDX-License-Identifier: Apache-2.0
"""Dry friction of joints: sliding, sticking and breaking away, against closed forms."""

import math

import numpy as np
import pytest
import yaml
from scene_files import cases, text_of
from scipy.optimize import brentq
from stop_scenes import PRESS

from liegroup_core import Simulation
from liegroup_core.engine import Engine
from liegroup_core.scene.load import scene_from_text

pytestmark = pytest.mark.slow
G = 9.81

# A block on a plane that is inclined by TILT about y; its track is the slope downwards.
INCLINE = text_of("incline_friction.yaml")
# A block on a driven belt, with a spring to the world.
BELT = text_of("belt.yaml")
# A block on a stiff spring, with a weight of 10 N across its track.
OSCILLATOR = text_of("oscillator_friction.yaml")


def incline(tilt, coulomb, static, speed=0.0):
    """A block that slides down a slope; `tilt` rad from the horizontal."""
    text = INCLINE.replace("TURN", repr(0.5 * math.pi + tilt)).replace("SPEED", repr(speed))
    return scene_from_text(text.replace("COULOMB", repr(coulomb)).replace("STATIC", repr(static)))


def test_threshold_of_sticking():
    """A block sticks while its weight along the slope is below the static friction."""
    tilt = 0.4
    weight = 2.0 * G * math.sin(tilt)
    for static, mode in ((weight * (1.0 + 1e-9), "stick"), (weight * (1.0 - 1e-9), "free")):
        engine = Engine(incline(tilt, 0.5 * weight, static), "rkmk4", 1e-2)
        engine.advance(10)
        assert engine.modes == {"slope": mode}


@pytest.mark.parametrize("method", ["rkmk2", "rkmk4", "rkmk853"])
def test_stopping_on_a_slope(method):
    """A block that is pushed up a slope stops after v / a at v^2 / 2 a, and stays."""
    tilt, friction, speed = 0.3, 8.0, -1.7
    # z of the block points down the slope.
    brake = friction / 2.0 + G * math.sin(tilt)
    engine = Engine(incline(tilt, friction, friction, speed), method, 1e-2)
    engine.advance(100)
    (event,) = engine.drain_events()
    assert event.kind == "stick"
    assert event.time == pytest.approx(-speed / brake, abs=1e-12)
    place = engine.sample().joint_coordinates["slope"][0]
    assert place == pytest.approx(-(speed**2) / (2.0 * brake), abs=1e-12)


def test_sliding_back():
    """Where the slope is steeper than friction holds, the block turns round at once."""
    tilt, friction, speed = 0.6, 4.0, -1.7
    up, down = G * math.sin(tilt) + friction / 2.0, G * math.sin(tilt) - friction / 2.0
    engine = Engine(incline(tilt, friction, friction, speed), "rkmk4", 1e-2)
    engine.advance(100)
    turn = -speed / up
    far = -(speed**2) / (2.0 * up)
    place, rate = engine.sample().joint_coordinates["slope"]
    assert place == pytest.approx(far + 0.5 * down * (1.0 - turn) ** 2, abs=1e-12)
    assert rate == pytest.approx(down * (1.0 - turn), abs=1e-12)


def test_sticking_does_not_creep():
    """In a million steps no bit of the state changes."""
    engine = Engine(incline(0.3, 8.0, 9.0, -1.0), "rkmk4", 1e-2)
    engine.advance(100)
    pose, twist = engine.state()
    engine.advance(1_000_000)
    assert engine.state()[0].tobytes() == pose.tobytes()
    assert engine.state()[1].tobytes() == twist.tobytes()


def test_stick_slip_oscillator():
    """Block on a belt: it sticks until the spring exceeds stiction, then slides in an arc of a circle.

    With u = x - coulomb / k the slip is harmonic, from u0 = (static - coulomb) / k with the speed of
    the belt, forwards and back, until it has this speed again at -u0: a half turn, and twice the angle
    whose tangent is belt / (omega u0). To stick from -u0 to u0 takes 2 u0 / belt.
    """
    k, m, coulomb, static, belt = 25.0, 1.0, 2.0, 3.0, 0.1
    omega = math.sqrt(k / m)
    u = (static - coulomb) / k
    angle = math.atan2(belt / omega, u)
    slip = (math.pi + 2.0 * angle) / omega
    stick = 2.0 * u / belt
    engine = Engine(scene_from_text(BELT), "rkmk8", 5e-3)
    engine.advance(4000)
    events = engine.drain_events()
    away = [event.time for event in events if event.kind == "slip"]
    back = [event.time for event in events if event.kind == "stick"]
    assert away[0] == pytest.approx(static / k / belt, abs=1e-9)
    assert len(away) >= 8
    assert np.diff(away) == pytest.approx(slip + stick, abs=1e-8)
    assert np.subtract(back, away[: len(back)]) == pytest.approx(slip, abs=1e-8)


CHAIN = text_of("chain_friction.yaml")


@pytest.mark.parametrize("shoulder, elbow, modes", cases("which_joints_of_a_chain_stick"))
def test_which_joints_of_a_chain_stick(shoulder, elbow, modes):
    """Two horizontal rods bend the shoulder with 2 m g l, the elbow with m g l / 2, l = 1 m."""
    text = CHAIN.replace("SHOULDER", str(shoulder)).replace("ELBOW", str(elbow))
    engine = Engine(scene_from_text(text), "rkmk4", 1e-3)
    engine.advance(1)
    assert engine.modes == modes


@pytest.mark.parametrize("friction", ["coulomb: 1.0", "mu: 0.1"])
@pytest.mark.parametrize("stiffness", [1e5, 1e9])
def test_a_stiff_oscillator_turns_round(friction, stiffness):
    """Each half period pi sqrt(m/k) takes 2 F / k off the amplitude, with friction F = 1 N and m = 1 kg.

    Where it turns its acceleration is 5e4 to 5e8 m/s^2: the last bit of the time leaves a rate. rkmk8 with
    1/40 of a period errs by round-off: 400 steps of 1e-16 of 0.5 m.
    """
    text = OSCILLATOR.replace("STIFFNESS", repr(stiffness)).replace("FRICTION", friction)
    engine = Engine(scene_from_text(text), "rkmk8", math.pi / math.sqrt(stiffness) / 20.0)
    for turns in range(1, 21):
        engine.advance(20)
        amplitude = 0.5 - 2.0 * turns / stiffness
        assert abs(abs(engine.sample().positions["block"][0]) - amplitude) <= 1e-12
    assert engine.drain_events() == []  # it never sticks


@pytest.mark.turn(3)
def test_energy_that_friction_takes():
    """What the energy loses is friction times the angle that it slid, in both joints."""
    text = CHAIN.replace("SHOULDER", "4.0").replace("ELBOW", "1.0")
    engine = Engine(scene_from_text(text), "rkmk8", 2e-3)
    energy, before, slid = engine.energy(), np.zeros(2), np.zeros(2)
    for _ in range(10000):
        engine.advance(1)
        angles = np.array([q for q, _ in engine.sample().joint_coordinates.values()])
        slid += np.abs(angles - before)
        before = angles
    assert set(engine.modes.values()) == {"stick"}
    # Steps in which a joint turns round count too little: twenty of them at 1e-5 rad.
    assert energy - engine.energy() == pytest.approx(slid @ [4.0, 1.0], abs=2e-3)


def test_crank_with_friction_and_a_stop():
    """In a closed loop a stop of the slider and friction of the crank act together.

    A slider-crank in a line with its slide: the crank turns until the slider is at its stop. The
    impulse at the stop stops the crank through the loop, and friction holds it there.
    """
    simulation = Simulation(scene_from_text(PRESS), "rkmk4", 1e-3, stabilisation="projection")
    simulation.advance(1000)
    events = simulation.drain_events()
    hit = next(event for event in events if event.kind == "impact")
    sample = simulation.sample()
    assert sample.joint_coordinates["slide"][0] == pytest.approx(0.38, abs=1e-12)
    assert simulation.modes["slide"] == "upper"
    # Cosine rule of the triangle of crank, rod and slide.
    cosine = (0.1**2 + 0.38**2 - 0.3**2) / (2.0 * 0.1 * 0.38)
    assert sample.joint_coordinates["main"][0] == pytest.approx(math.acos(cosine) - 1.0, abs=1e-12)
    assert sample.joint_coordinates["main"][1] == 0.0
    assert np.abs(sample.twist).max() < 1e-14
    assert sample.constraint_residual < 1e-14
    assert hit.energy < 0.0


def test_release_time_under_a_growing_load():
    """A servo pulls ever more: the joint breaks away when its torque reaches the stiction."""
    text = text_of("lever_friction.yaml")
    engine = Engine(scene_from_text(text), "rkmk4", 1e-3)
    engine.advance(2500)
    event = engine.drain_events()[0]
    assert event.kind == "slip"
    assert event.time == pytest.approx(brentq(lambda t: 2.0 * 0.3 * t - 1.2, 0, 5), abs=1e-12)


KINDS = ("revolute", "prismatic", "screw", "spherical", "cylindrical", "planar", "universal")


def mechanism(seed, closed, held):
    """Random chain at rest whose joints with one freedom are welded, or held by friction."""
    rng = np.random.default_rng(seed)
    bodies, joints = [], []
    for i in range(6):
        bodies.append(
            {
                "name": f"b{i}",
                "mass": float(rng.uniform(0.5, 2.0)),
                "inertia": [0.02, 0.03, 0.025, 0.002, 0.001, -0.003],
                "com": rng.normal(scale=0.1, size=3).tolist(),
                "position": [0.4 * (i + 1), *rng.normal(scale=0.1, size=2).tolist()],
                "rotation_vector": rng.normal(scale=0.5, size=3).tolist(),
            }
        )
        kind = KINDS[int(rng.integers(len(KINDS)))]
        holds = kind in KINDS[:3] and rng.random() < 0.6
        joint = {
            "name": f"j{i}",
            "type": "fixed" if holds and not held else kind,
            "parent": "world" if i == 0 else f"b{i - 1 if rng.random() < 0.7 else int(rng.integers(i))}",
            "child": f"b{i}",
            "child_frame": {"rotation_vector": rng.normal(scale=0.8, size=3).tolist()},
        }
        if joint["type"] == "screw":
            joint["pitch"] = 0.05
        if holds and held:
            joint["friction"] = {"static": 1e9}
        joints.append(joint)
    if closed:
        end = {"position": [0, 0.2, 0]}
        rod = {"name": "rod", "type": "distance", "parent": "world", "child": "b5"}
        joints.append(rod | {"parent_frame": {"position": [2.0, -1.0, 0.3]}, "child_frame": end})
    scene = {"name": "chain", "gravity": [1.0, 2.0, -9.81], "bodies": bodies, "joints": joints}
    return scene_from_text(yaml.safe_dump(scene))


@pytest.mark.parametrize("closed", [False, True])
@pytest.mark.parametrize("seed", range(12))
@pytest.mark.volume(4)
def test_held_joints_are_welds(seed, closed):
    """Joints that friction holds move as if they were welded: poses after 0.4 s, and reactions.

    Both runs solve the same equations with other sweeps: 1e-10 is 1000 times what 40 steps of 1e-15
    grow to in mechanisms of 2 m that are not chaotic so early.
    """
    samples = []
    for held in (True, False):
        engine = Engine(mechanism(seed, closed, held), "rkmk4", 0.01, group="relative")
        engine.advance(40)
        samples.append(engine.sample())
    assert samples[0].pose == pytest.approx(samples[1].pose, abs=1e-10)
    assert samples[0].twist == pytest.approx(samples[1].twist, abs=1e-9)


def test_reactions_with_stops_and_friction():
    """The axis component of a reaction is the effort of stop and friction; the rest that of a weld.

    A rod on a sticking hinge: torque m g l, force m g. The same rod sliding: the torque is coulomb.
    """
    text = CHAIN.replace("SHOULDER", "19.7").replace("ELBOW", "5.0")
    engine = Engine(scene_from_text(text), "rkmk4", 1e-3)
    engine.advance(5)
    reactions = engine.sample().reactions
    assert abs(reactions["shoulder"][2]) == pytest.approx(2.0 * G, abs=1e-12)
    assert np.linalg.norm(reactions["shoulder"][3:]) == pytest.approx(2.0 * G, abs=1e-12)
    assert abs(reactions["elbow"][2]) == pytest.approx(0.5 * G, abs=1e-12)
    engine = Engine(scene_from_text(CHAIN.replace("SHOULDER", "4.0").replace("ELBOW", "0.1")), "rkmk4", 1e-3)
    engine.advance(50)
    sample = engine.sample()
    for joint, size in (("shoulder", 4.0), ("elbow", 0.1)):
        rate = sample.joint_coordinates[joint][1]
        assert sample.reactions[joint][2] == pytest.approx(-math.copysign(size, rate), abs=1e-12)
