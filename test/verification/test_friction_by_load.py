# SPDX-License-Identifier: Apache-2.0
"""Friction by load: closed forms, an independent integration, and its law in random mechanisms."""

import math

import numpy as np
import pytest
import yaml
from convergence import fitted_order
from scene_files import cases, text_of
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from stop_scenes import chain

from liegroup_core import SceneError, Simulation, SimulationError
from liegroup_core.engine import Engine
from liegroup_core.scene.load import scene_from_text

ROD = text_of("rod_friction_by_load.yaml")
BLOCK = text_of("incline_friction_by_load.yaml")
MASS, ARM, INERTIA, RADIUS, G = 2.0, 0.5, 0.1 + 2.0 * 0.25, 0.1, 9.81


def rod(gravity=0.0, rate=0.0, start=0.0, mu=0.3):
    """Rod on a bearing at its end."""
    text = ROD.replace("GRAVITY", repr(gravity)).replace("START", repr(start))
    return scene_from_text(text.replace("RATE", repr(rate)).replace("MU", repr(mu)))


def block(slope, speed):
    """Block on an incline, which moves uphill."""
    text = BLOCK.replace("TILT", repr(0.5 * math.pi - slope))
    return scene_from_text(text.replace("RATE", repr(speed)))


def test_a_spinning_rod_loses_speed_as_a_rope_on_a_post_loses_force():
    """w' = -k w^2 with k = c / sqrt(1 - c^2), c = mu r m L / I: w = w0 exp(-k angle), and
    1/w = 1/w0 + k t. rkmk8 with 1 ms errs by round-off: 2000 steps of 1e-16.
    """
    engine = Engine(rod(rate=6.0), "rkmk8", 1e-3)
    engine.advance(2000)
    c = 0.3 * RADIUS * MASS * ARM / INERTIA
    k = c / math.sqrt(1.0 - c * c)
    assert abs(1.0 / engine.state()[1][0, 2] - (1.0 / 6.0 + 2.0 * k)) <= 1e-12


@pytest.mark.parametrize("slope", [0.0, 0.3, math.atan(0.5) - 1e-9])
def test_a_block_stops_on_an_incline_below_the_angle_of_friction(slope):
    """It stops after v^2 / 2a at v / a, a = g (sin + mu cos), and stays: to round-off of the sums."""
    speed = 2.0
    engine = Engine(block(slope, speed), "rkmk4", 1e-3)
    engine.advance(3000)
    brake = G * (math.sin(slope) + 0.4 * math.cos(slope))
    (event,) = engine.drain_events()
    assert event.kind == "stick" and abs(event.time - speed / brake) <= 1e-12
    moved = np.linalg.norm(engine.sample().poses["block"][:3, 3])
    assert abs(moved - speed**2 / (2.0 * brake)) <= 1e-12
    before = engine.state()[0].copy()
    engine.advance(1000)
    assert np.array_equal(engine.state()[0], before)


def test_a_block_slides_above_the_angle_of_friction():
    """From rest and after it has come to rest on its way up: g (sin - mu cos), to 1e-12."""
    slope = math.atan(0.5) + 1e-9
    down = G * (math.sin(slope) - 0.4 * math.cos(slope))
    for speed in (0.0, 2.0):
        up = G * (math.sin(slope) + 0.4 * math.cos(slope))
        engine = Engine(block(slope, speed), "rkmk4", 1e-3)
        engine.advance(1500)
        turn = speed / up
        path = 0.5 * speed * turn - 0.5 * down * (1.5 - turn) ** 2
        along = engine.sample().poses["block"][:3, 3] @ [math.cos(slope), 0.0, math.sin(slope)]
        assert abs(along - path) <= 1e-11


def swings(start, mu, turns):
    """Times and angles at which a pendulum with a bearing turns round, by SciPy (DOP853, 1e-13)."""

    def acceleration(angle, rate, sign):
        def rest(a):
            across = MASS * math.hypot(ARM * a + G * math.cos(angle), ARM * rate**2 - G * math.sin(angle))
            torque = -MASS * G * ARM * math.cos(angle) - sign * mu * RADIUS * across
            return INERTIA * a - torque

        return brentq(rest, -100.0, 100.0, xtol=1e-14, rtol=1e-14)

    time, angle, sign, found = 0.0, start, -1.0, []
    for _ in range(turns):

        def slope(t, y, sign=sign):
            return [y[1], acceleration(*y, sign)]

        def at_rest(t, y, sign=sign):
            return sign * y[1] if t > 1e-3 else 1.0

        at_rest.terminal = True
        run = solve_ivp(slope, (0.0, 5.0), [angle, 0.0], "DOP853", events=at_rest, rtol=1e-12, atol=1e-13)
        time, angle, sign = time + run.t_events[0][0], run.y_events[0][0][0], -sign
        found.append((time, angle))
    return found


def test_a_pendulum_on_a_bearing():
    """The first four turns of a pendulum beside an independent integration.

    That errs by 1e-12 a step, some 100 steps; a turn is found where the rate is zero, its angle is
    stationary there and its time as uncertain as the rate over the acceleration, 1e-10 / 10.
    """
    mu, times = 0.5, []
    engine = Engine(rod(gravity=-G, start=0.0, mu=mu), "rkmk8", 1e-3)
    before = 0.0
    for time, angle in swings(0.0, mu, 4):
        engine.drain_instants()
        while engine.time < time - 1e-3:
            engine.advance(1)
        engine.drain_instants()
        engine.advance(3)
        instants = engine.drain_instants()
        times.append(instants[0].time)
        assert abs(times[-1] - time) <= 1e-9
        q = instants[0].modes[0, 3]
        assert abs(q - angle) <= 1e-9 and q != before
        before = q


@pytest.mark.parametrize("method,order", [("rkmk4", 4), ("rkmk8", 8)])
def test_the_order_of_the_method_is_kept(method, order):
    """Error of the rate of a pendulum on a bearing after three turns, fitted over halved steps."""
    steps = [0.05, 0.025, 0.0125] if order == 4 else [0.2, 0.1, 0.05]
    exact = Engine(rod(gravity=-G, mu=0.5), "rkmk8", 1e-3)
    exact.advance(3000)
    errors = []
    for step in steps:
        engine = Engine(rod(gravity=-G, mu=0.5), method, step)
        engine.advance(round(3.0 / step))
        errors.append(np.abs(engine.state()[1] - exact.state()[1]).max())
    assert fitted_order(steps, errors) > order - 0.5, errors


def loaded(scene, rng, mu):
    """The chain of test_many_events with friction by load everywhere."""
    joints = []
    for joint in scene.joints:
        bearing = {"mu": float(rng.uniform(0.1, 1.0)) * mu, "coulomb": 0.01}
        if joint.type == "revolute":
            bearing["radius"] = 0.03
        joints.append(joint.remade(friction=bearing))
    return scene.remade(joints=joints)


def check_law(sample, scene, slack):
    """Friction of every joint that moves is coulomb + mu r N against its rate, N of its reaction."""
    moving = 0
    for joint in scene.joints:
        if joint.friction is None or sample.modes[joint.name] != "free":
            continue
        wrench, friction = sample.reactions[joint.name], joint.friction
        rate = sample.joint_coordinates[joint.name][1]
        along = wrench[2] if joint.type == "revolute" else wrench[5]
        lever = friction.radius or 1.0
        load = math.hypot(*wrench[3:5])
        most = friction.coulomb + friction.mu * lever * load
        assert abs(along + math.copysign(most, rate)) <= slack * (1.0 + load), joint.name
        moving += 1
    return moving


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.turn(3)
def test_random_chains_obey_the_law(seed):
    """Trees of nine hinges and slides with stops and friction by load, falling: the law holds in every
    sample, and energy is never gained. Loads settle to 1e-14 of the largest one.
    """
    rng = np.random.default_rng(seed)
    scene = loaded(chain(seed, 8, False), rng, 0.3)
    engine = Engine(scene, "rkmk4", 1e-3)
    energy, moving = engine.energy(), 0
    for _ in range(300):
        engine.advance(1)
        now = engine.energy()
        assert now <= energy + 1e-7
        energy = now
        moving += check_law(engine.sample(), scene, 1e-10)
    assert moving > 100


FOUR_BAR = text_of("four_bar.yaml")


@pytest.mark.turn(3)
def test_a_loop_with_bearings_everywhere():
    """The law in a four-bar, whose cut joint has friction, too, until all of it is at rest."""
    bearing = "friction: {mu: 0.2, radius: 0.05, coulomb: 0.01}"
    scene = scene_from_text(FOUR_BAR.replace("BEARING", bearing))
    engine = Engine(scene, "rkmk4", 1e-3, stabilisation="projection")
    moving, energy = 0, engine.energy()
    for _ in range(4000):
        engine.advance(1)
        now = engine.energy()
        assert now <= energy + 1e-9
        energy = now
        moving += check_law(engine.sample(), scene, 1e-9)
    assert moving > 1000
    assert set(engine.sample().modes.values()) == {"stick"}
    before = engine.state()[0].copy()
    engine.advance(500)
    assert np.array_equal(engine.state()[0], before)


def test_too_much_friction_is_reported():
    """c = mu r m L / I > 1: friction causes more load than it needs, and the rod has no acceleration."""
    engine = Engine(rod(rate=6.0, mu=7.0), "rkmk4", 1e-3)
    with pytest.raises(SimulationError, match="Painleve"):
        engine.advance(1)
    assert engine.time == 0.0


def test_the_running_error_covers_the_true_error():
    """Of a pendulum on a bearing, beside the same motion with a tenth of the step."""
    scene = rod(gravity=-G, mu=0.5)
    run = Simulation(scene, method="rkmk4", step=0.02)
    exact = Engine(scene, "rkmk8", 1e-3)
    for _ in range(20):
        run.advance(10)
        exact.advance(200)
        true = np.abs(run.state()[1] - exact.state()[1])[0, :3].max()
        assert run.sample().error["rod"][3] >= 0.5 * true


@pytest.mark.parametrize("joint,text", cases("what_does_not_fit_is_refused"))
def test_what_does_not_fit_is_refused(joint, text):
    body = {"name": "b", "mass": 1.0, "inertia": [1.0, 1.0, 1.0]}
    joint = {"name": "j", "parent": "world", "child": "b", "child_frame": {}} | joint
    scene = {"name": "s", "gravity": [0, 0, 0], "bodies": [body], "joints": [joint]}
    with pytest.raises(SceneError, match=text):
        scene_from_text(yaml.safe_dump(scene))
