# SPDX-License-Identifier: Apache-2.0
"""Contacts: closed forms of drops, impacts, sliding, rolling and standing; distances against minimisation."""

import math
from contextlib import nullcontext
from itertools import product

import numpy as np
import pytest
import scipy
from convergence import fitted_order
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from liegroup_core import SceneError, Simulation
from liegroup_core.engine import Engine
from liegroup_core.forces.contact import SHORT, damping_of
from liegroup_core.lie.groups import SO3
from liegroup_core.linear import TrimError, linearise, modes_of, sensitivities, trim
from liegroup_core.reference import Reference
from liegroup_core.reports import explain
from liegroup_core.scene.load import scene_from_text
from liegroup_core.status import NOT_FINITE
from liegroup_core.stiffness import EXPLICIT, MethodChoice
from liegroup_sim_ros.messages.touching import patches

G, RADIUS = 9.81, 0.1
BALL = "{name: ball, shape: {type: sphere, radius: 0.1, mass: 2}, position: [0, 0, %s], linear_velocity: [%s, 0, %s]}"


def scene(bodies, contacts, gravity=G, more=""):
    entries = "\n".join(f"  - {{type: contact, {each}}}" for each in contacts)
    return scene_from_text(
        f"name: c\ngravity: [0, 0, {-gravity}]\nbodies:\n"
        + "\n".join(f"  - {each}" for each in bodies)
        + f"\nforces:\n{entries}\n{more}",
        "test",
    )


def ball(contact, height=RADIUS, along=0.0, up=0.0, gravity=G):
    """A ball of 2 kg and 0.1 m on the plane z = 0."""
    return scene([BALL % (height, along, up)], [f"name: floor, body: ball, {contact}"], gravity)


def bounce(stiffness, height):
    """(time of the fall, time in contact) of the ball with a linear contact: d'' = g - k/m d."""
    speed, rate = math.sqrt(2.0 * G * height), math.sqrt(stiffness / 2.0)
    return speed / G, 2.0 / rate * (math.pi - math.atan(speed * rate / G))


@pytest.mark.parametrize("stiffness", [1e3, 1e6])
def test_a_ball_on_a_linear_contact_keeps_its_height_through_a_thousand_bounces(stiffness):
    """Without damping the contact is a spring. The apex after n bounces, its time by the closed form."""
    height = 0.05
    fall, touch = bounce(stiffness, height)
    simulation = Simulation(ball(f"stiffness: {stiffness}, damping: 0", RADIUS + height), accuracy=1e-9, quiet=True)
    for bounces in (1, 100, 1000):
        simulation.advance_to(bounces * (2.0 * fall + touch))
        sample = simulation.sample()
        # The speed of the ball there is that of an error in time.
        assert abs(sample.pose[0, 11] - RADIUS - height) <= 1e-9
        assert abs(sample.twist[0, 5]) <= 1e-8 * bounces
    assert simulation._switching.tally.sum() == 2000


def test_no_touch_of_a_fast_slab_is_missed():
    """A flat box on four corners is the ball on a spring, between two planes too: v t = 2 n (gap + way in contact)."""
    stiffness, speed, gap = 4e6, 30.0, 0.5
    body = (
        "{name: slab, shape: {type: box, size: [0.3, 0.3, 0.2], mass: 2}, position: [0, 0, 0.35], "
        f"linear_velocity: [0, 0, {speed}]}}"
    )
    keys = f"body: slab, stiffness: {stiffness / 4}, damping: 0"
    planes = [f"name: floor, {keys}", f"name: roof, {keys}, plane: {{point: [0, 0, 0.7], normal: [0, 0, -1]}}"]
    simulation = Simulation(scene([body], planes, gravity=0.0), accuracy=1e-9, quiet=True)
    for count in (1, 50):
        # Half a turn of the spring at each plane; then it is in the middle again, and flies upwards.
        simulation.advance_to(2 * count * (gap / speed + math.pi / math.sqrt(stiffness / 2.0)))
        sample = simulation.sample()
        assert sample.pose[0, 11] == pytest.approx(0.35, abs=1e-8 * count)
        assert sample.twist[0, 5] == pytest.approx(speed, rel=1e-8)


def test_events_are_those_of_the_closed_form():
    """Touch and leave of the bounces on a spring, also after a snapshot; steps without error control have none."""
    height, bounces = 0.05, 20
    fall, touch = bounce(1e4, height)
    made = ball("stiffness: 1e4, damping: 0", RADIUS + height)
    simulation = Simulation(made, accuracy=1e-9, quiet=True)
    simulation.advance_to(2.5 * fall + 1.5 * touch)  # in the second contact
    events, middle = simulation.drain_events(), simulation.snapshot()
    for _ in range(2):
        simulation.restore(middle)
        simulation.advance_to(bounces * (2.0 * fall + touch))
        found = events + simulation.drain_events()
        assert [(event.joint, event.kind) for event in found] == [("floor", "touch"), ("floor", "leave")] * bounces
        starts = fall + np.arange(bounces) * (2.0 * fall + touch)
        # As the bounces above: 1e-8 m/s per bounce are 1e-9 s of fall.
        assert_allclose([event.time for event in found], np.ravel([starts, starts + touch], "F"), atol=1e-9 * bounces)
    assert simulation.event_count == 0  # at joints


def test_fixed_steps_have_events_of_stops_only():
    bodies = [BALL % (0.15, 0.0, 0.0), "{name: lid, mass: 1, inertia: [1, 1, 1]}"]
    joint = "joints: [{name: s, type: prismatic, parent: world, child: lid, parent_frame: {}, limits: {lower: -0.1}}]"
    made = scene(bodies, ["name: floor, body: ball, stiffness: 1e4, damping: 0"], more=joint)
    simulation = Simulation(made, "rkmk4", 1e-3, quiet=True)
    simulation.drain_instants()
    simulation.advance_to(0.2)
    (instant,) = [each for each in simulation.drain_instants() if each.events]
    assert simulation.drain_events() == instant.events and {event.joint for event in instant.events} == {"s"}
    assert instant.time == pytest.approx(math.sqrt(0.2 / G), abs=1e-12)


def test_events_say_when_a_tumbling_brick_touches():
    """By the force of the contact at a thousand times."""
    body = BRICK % (0.0, 0.3, "linear_velocity: [1, 0, 0], angular_velocity: [3, 2, 1]")
    brick = scene([body], ["name: floor, body: brick, sinks: 1e-4, restitution: 0.3, friction: 0.3"])
    simulation, presses = Simulation(brick, accuracy=1e-5, quiet=True), []
    times = np.linspace(0.0, 0.5, 1001)
    for time in times:
        simulation.advance_to(time)
        presses.append(simulation.sample().signals["floor.normal_force"] > 0.0)
    simulation.advance_to(0.6)  # events come with the whole step
    events = simulation.drain_events()
    both = [(event.time, event.kind) for event in events if event.kind in ("touch", "leave")]
    at, kinds = zip(*both)
    assert kinds[::2] == ("touch",) * len(kinds[::2]) and kinds[1::2] == ("leave",) * len(kinds[1::2])
    assert (np.searchsorted(at, times) % 2 == 1).tolist() == presses
    assert sum(presses) > 100 and {"slip", "stick"} < {event.kind for event in events}


@pytest.mark.parametrize("restitution, speed", [(0.9, 1.0), (0.5, 2.0), (0.1, 0.3), (0.02, 5.0)])
@pytest.mark.parametrize("stiffness", [1e2, 1e5])
def test_a_ball_leaves_with_its_restitution(restitution, speed, stiffness):
    """At the stated speed without gravity, whatever the stiffness."""
    contact = f"stiffness: {stiffness}, restitution: {restitution}, speed: {speed}"
    simulation = Simulation(ball(contact, 0.2, up=-speed, gravity=0.0), accuracy=1e-9, quiet=True)
    simulation.advance_to(0.2 / speed + 200.0 * math.sqrt(2.0 / stiffness))
    assert simulation.sample().twist[0, 5] == pytest.approx(restitution * speed, abs=1e-9)


@pytest.mark.parametrize("aside", [0.0, 0.03])
@pytest.mark.parametrize("angle", [0.3, 0.8, math.pi / 2])
def test_crossing_capsules_press_as_balls_and_keep_their_energy(angle, aside):
    """At their middles they exchange their speeds, in the time of two balls, without a spin."""
    radius, length, speed, stiffness = 0.05, 0.1, 1.0, 1e6
    shape = f"type: capsule, radius: {radius}, length: {length}, mass: 1"
    bodies = [
        f"{{name: a, shape: {{{shape}, axis: [1, 0, 0]}}, position: [{aside}, 0, 0.11], "
        f"linear_velocity: [0, 0, {-speed}]}}",
        f"{{name: b, shape: {{{shape}, axis: [{math.cos(angle)}, {math.sin(angle)}, 0]}}}}",
    ]
    made = scene(bodies, [f"name: c, body: a, other: b, stiffness: {stiffness}, damping: 0"], gravity=0.0)
    simulation = Simulation(made, accuracy=1e-9, quiet=True)
    touch = 0.01 / speed
    rate = math.sqrt(2.0 * stiffness)  # of a spring between two masses of 1 kg
    simulation.advance_to(touch + 0.5 * math.pi / rate)
    if not aside:
        assert simulation.sample().signals["c.depth"] == pytest.approx(speed / rate, abs=1e-9)
    simulation.advance_to(0.02)
    sample = simulation.sample()
    assert not sample.contact_points
    # Joule by errors of an accuracy of 1e-9 for each of 12 rates of about 1.
    assert sample.energy == pytest.approx(0.5 * speed**2, abs=12e-9)
    if not aside:
        assert_allclose(sample.twist[:, 5], (0.0, -speed), atol=1e-9)
        assert np.abs(sample.twist[:, :3]).max() < 1e-12


def test_a_sliding_ball_rolls_after_two_sevenths_of_its_speed():
    """It slides for t = 2 v / (7 mu g), then rolls with 5/7 v; the way differs with the order 1 of the slip length."""
    friction, speed = 0.3, 1.0
    slides = 2.0 * speed / (7.0 * friction * G)
    way = speed * slides - 0.5 * friction * G * slides**2 + 5.0 / 7.0 * speed * (1.0 - slides)
    lengths, errors = np.array([4e-4, 2e-4, 1e-4]), []
    for slip in lengths:
        contact = f"sinks: 1e-5, restitution: 0.5, friction: {friction}, slip: {slip}"
        simulation = Simulation(ball(contact, RADIUS - 1e-5, along=speed), accuracy=1e-8, quiet=True)
        simulation.advance_to(1.0)
        sample = simulation.sample()
        velocity = SO3.exp([0, 0, 0]) @ sample.pose[0, :9].reshape(3, 3) @ sample.twist[0, 3:]
        assert_allclose(velocity, (5.0 / 7.0, 0.0, 0.0), atol=1e-7)
        assert sample.twist[0, 1] == pytest.approx(5.0 / 7.0 / RADIUS, abs=1e-6)
        errors.append(abs(sample.pose[0, 9] - way))
    assert 0.9 <= fitted_order(lengths, errors) <= 1.1, errors


def order_of(contact, exact, error):
    """Fitted order in 1/k of the errors of two motions with a contact, from `contact` of a stiffness k."""
    stiffness, errors = np.array([4e4, 2e5, 1e6]), []
    for k in stiffness:
        simulation = Simulation(contact(k), accuracy=1e-8, quiet=True)
        simulation.advance_to(0.25)
        errors.append(error(simulation.sample(), exact))
    return fitted_order(1.0 / stiffness, errors), errors


def test_a_block_that_rocks_turns_about_its_edge():
    """Leaning by half of the angle at which it would tip over; its edge sinks and yields in proportion to 1/k."""
    lean, reach = 0.5 * math.atan(1.0 / 3.0), math.hypot(0.1, 0.3)

    def slopes(t, y):
        return y[1], -0.75 * G / reach * math.sin(2.0 * lean - y[0])

    turned = scipy.integrate.solve_ivp(slopes, (0.0, 0.25), (lean, 0.0), rtol=1e-11, atol=1e-13).y[0, -1]
    place = f"[{-reach * math.sin(lean)}, 0, {reach * math.cos(lean)}], rotation_vector: [0, {lean}, 0]"
    body = f"{{name: b, shape: {{type: box, size: [0.2, 0.2, 0.6], mass: 2}}, position: {place}}}"
    keys = "name: floor, body: b, restitution: 0.3, friction: 0.8, stiffness: {}, slip: {}"
    order, errors = order_of(
        lambda k: scene([body], [keys.format(k, 20.0 / k)]),
        turned,
        lambda sample, exact: abs(math.asin(sample.pose[0, 2]) - exact),
    )
    assert 0.9 <= order <= 1.1, errors


def test_a_coin_that_rolls_follows_the_joint_that_rolls():
    """On one rim of a cylinder, as a thin wheel, leaning by 0.3 rad; what differs is proportional to 1/k."""
    turn = Rotation.from_euler("x", 0.5 * math.pi + 0.3)
    axis, spin = turn.as_matrix()[:, 2], 12.0 * turn.as_matrix()[:, 2] + (0.0, 0.0, 1.0)
    across = np.array([0.0, 0.0, 1.0]) - axis[2] * axis
    to_rim = -0.1 * across / np.linalg.norm(across)
    rates = (turn.inv().apply(vector).tolist() for vector in (spin, np.cross(to_rim, spin)))
    body = (
        "{{name: coin, mass: 1, inertia: [0.0025, 0.0025, 0.005], position: [0, 0, {}], quaternion: {}, "
        "angular_velocity: {}, linear_velocity: {}}}"
    ).format(-to_rim[2], turn.as_quat().tolist(), *rates)
    wheel = "joints:\n  - {name: w, type: wheel, parent: world, child: coin, radius: 0.1, child_frame: {}}"
    rolls = Simulation(
        scene_from_text(f"name: c\ngravity: [0, 0, {-G}]\nbodies:\n  - {body}\n{wheel}", "test"),
        accuracy=1e-9,
        quiet=True,
    )
    rolls.advance_to(0.25)
    shape = f"{{type: cylinder, radius: 0.1, length: 0.02, position: [0, 0, {math.copysign(0.01, axis[2])}]}}"
    keys = f"name: floor, body: coin, shape: {shape}, restitution: 0.5, friction: 0.8"
    order, errors = order_of(
        lambda k: scene([body], [f"{keys}, stiffness: {k}, slip: {8.0 / k}"]),
        rolls.sample().pose[0],
        lambda sample, exact: np.abs(sample.pose[0] - exact).max(),
    )
    assert 0.9 <= order <= 1.1, errors


BRICK = "{name: brick, shape: {type: box, size: [0.4, 0.3, 0.1], mass: 3}, position: [%s, 0, %s], %s}"


def slope(angle, friction, along=0.0, slip=1e-5, sinks=1e-5):
    """A brick on a plane that falls along x with an angle; its speed down the slope."""
    normal = (math.sin(angle), 0.0, math.cos(angle))
    # Four corners bear a quarter each.
    out = 0.05 - 0.25 * sinks * math.cos(angle)
    turned = f"rotation_vector: [0, {angle}, 0], linear_velocity: [{along}, 0, 0]"
    body = BRICK % (out * normal[0], out * normal[2], turned)
    contact = f"name: floor, body: brick, plane: {{normal: [{normal[0]}, 0, {normal[2]}]}}, sinks: {sinks}"
    return scene([body], [f"{contact}, restitution: 0.1, friction: {friction}, slip: {slip}"])


def test_a_brick_on_a_slope_below_the_cone_stays_for_an_hour():
    """At 0.98 of the angle of friction: it settles, and then does not move at all.

    It starts without friction, so it has the energy m g sin a slip / 2 when 0.02 m g sin a is left to stop it: 25 slip.
    """
    friction, slip = 0.5, 1e-5
    brick = slope(math.atan(0.98 * friction), friction, slip=slip)
    simulation = Simulation(brick, accuracy=1e-3, step=0.5, quiet=True)
    start = simulation.sample().pose[0, 9:]
    simulation.advance_to(5.0)
    settled = simulation.sample().pose[0, 9:]
    assert np.abs(settled - start).max() <= 25.0 * slip
    simulation.advance_to(3600.0)
    assert np.abs(simulation.sample().pose[0, 9:] - settled).max() <= 1e-13


def test_a_brick_on_a_slope_beyond_the_cone_slides_with_its_acceleration():
    """g (sin a - mu cos a), once the bristle is bent."""
    friction, angle, slip = 0.5, math.atan(1.2 * 0.5), 1e-6
    simulation, speeds = Simulation(slope(angle, friction, slip=slip), accuracy=1e-6, quiet=True), []
    for time in (0.1, 0.2):
        simulation.advance_to(time)
        speeds.append(simulation.sample().twist[0, 3])
    expected = G * (math.sin(angle) - friction * math.cos(angle))
    assert (speeds[1] - speeds[0]) / 0.1 == pytest.approx(expected, rel=1e-5)
    shown = simulation.sample().signals["floor.normal_force"]
    assert shown == pytest.approx(3 * G * math.cos(angle), rel=1e-6)


@pytest.mark.parametrize("height", [0.0, 0.5])
def test_trim_finds_what_stands_on_a_slope_up_to_the_cone(height):
    """Also below a brick in the air. Its weight is that of the sum of depths; the tilt changes that by its square."""
    friction, sinks = 0.5, 1e-5
    for share in (0.5, 0.98, 0.9999, 1.0001):
        angle = math.atan(share * friction)
        made = slope(angle, friction, sinks=sinks)
        normal = np.array([math.sin(angle), 0.0, math.cos(angle)])
        body = made.bodies[0]
        start = Simulation(made.remade(bodies=[body.remade(position=body.position + height * normal)]), quiet=True)
        if share > 1.0:
            with pytest.raises(TrimError, match="no equilibrium near the state"):
                trim(start)
            continue
        found = trim(start)
        assert found.is_steady and found.residual <= 1e-7
        assert found.pose[0, 9:] @ normal == pytest.approx(0.05 - 0.25 * sinks * math.cos(angle), abs=1e-8)


def table(feet, height, tilt):
    """A trunk on legs, which servos hold at 0.5 rad outwards, with balls without damping and friction as feet."""
    turn = Rotation.from_rotvec(tilt)

    def placed(at, lean=0.0):
        turned = (turn * Rotation.from_rotvec([0.0, -lean, 0.0])).as_rotvec().tolist()
        return f"position: {(turn.apply(at) + [0, 0, height]).tolist()}, rotation_vector: {turned}"

    bodies, joints, forces = [f"{{name: trunk, mass: 8, inertia: [0.1, 0.2, 0.25], {placed([0, 0, 0])}}}"], [], []
    for k, (x, y) in enumerate(feet):
        lean = math.copysign(0.5, x)
        place = placed([x + 0.2 * math.sin(lean), y, -0.2 * math.cos(lean)], lean)
        bodies.append(f"{{name: leg{k}, mass: 0.5, inertia: [0.01, 0.01, 0.001], {place}}}")
        frames = (
            f"parent_frame: {{position: [{x}, {y}, 0], axis: [0, -1, 0]}}, child_frame: {{position: [0, 0, 0.2], axis: "
        )
        joints.append(f"{{name: hip{k}, type: revolute, parent: trunk, child: leg{k}, {frames}[0, -1, 0]}}}}")
        forces.append(f"{{name: servo{k}, type: servo, joint: hip{k}, position: {lean}, stiffness: 60, damping: 1}}")
        ball = "shape: {type: sphere, radius: 0.02, position: [0, 0, -0.2]}, sinks: 1e-3, damping: 0"
        forces.append(f"{{name: foot{k}, type: contact, body: leg{k}, {ball}}}")
    entries = (", ".join(each) for each in (bodies, joints, forces))
    return scene_from_text(
        "{{name: t, gravity: [0, 0, -{}], bodies: [{}], joints: [{}], forces: [{}]}}".format(G, *entries)
    )


@pytest.mark.parametrize("height", [0.2, 0.37, 0.9])
@pytest.mark.parametrize("tilt", [(0.0, 0.0, 0.0), (0.2, 0.3, 0.0), (-0.4, 0.3, 0.2)])
def test_trim_stands_a_robot_on_its_legs_from_the_air_and_from_inside_the_ground(tilt, height):
    """Of each leg k (q - 0.5) = (N l - m g l / 2) sin q, N a quarter of the weight. On two feet it tips over."""
    feet = [(x, y) for x in (0.3, -0.3) for y in (0.2, -0.2)]
    found = trim(Simulation(table(feet, height, tilt), quiet=True))
    weight = 10.0 * G

    def moment(q):
        return (0.25 * weight * 0.4 - 0.5 * G * 0.2) * math.sin(q) - 60.0 * (q - 0.5)

    # 1e-10 of the first accelerations, 1e-8 rad/s^2 at most, may remain: over (60 N m/rad) / (0.03 kg m^2), 5e-12.
    q = scipy.optimize.brentq(moment, 0.1, 1.5, xtol=1e-14)
    assert_allclose(list(found.joints.values()), [q, q, -q, -q], atol=1e-11)
    assert found.pose[0, 11] == pytest.approx(0.4 * math.cos(q) + 0.02 - 0.25e-3, abs=1e-11)
    assert found.is_steady
    with pytest.raises(TrimError, match="left to itself trunk tips over or rolls away"):
        trim(Simulation(table(feet[:2], height, tilt), quiet=True))


REST = math.sqrt(1.0 + math.sqrt(2.0))  # the bristle of a point that slides: 2 b^2 (b^2 - 1) = b^4 + 1
BLOCK = "{name: block, mass: 2, inertia: [1, 1, 1], position: [0, 0, -1e-4], linear_velocity: [1, 0, 0]}"


def block(friction, slip):
    """A block that slides on one point below its centre of mass, at the depth of its weight: it does not tilt."""
    point = "shape: {type: hull, points: [[0, 0, 0]]}"
    return scene([BLOCK], [f"name: floor, body: block, {point}, sinks: 1e-4, damping: 1, {friction}, slip: {slip}"])


def way_of_block(friction, speed, slip, times):
    """Ways of the block by its law on a line, phase by phase: elastic to z = 1, yielding to v = 0, back to w = 1."""
    force, settles = friction * G, math.sqrt(slip / (friction * G))

    def rates(yields, limit):
        def of(_, y):
            bent = y[2] ** 2
            z_rate = y[1] * (1.0 - (2.0 * bent * (bent - 1.0) / (bent**2 + 1.0) if yields else 0.0)) / slip
            return [y[1], -force * (1.0 if limit else y[2] + settles * y[1] / slip), z_rate]

        return of

    phases = (
        (rates(False, True), lambda _, y: y[2] - 1.0),
        (rates(True, True), lambda _, y: y[1]),
        (rates(False, True), lambda _, y: y[2] + settles * y[1] / slip - 1.0),
        (rates(False, False), lambda _, y: 1.0),
    )
    begin, state, ways = 0.0, [0.0, speed, 0.0], {}
    for of, end in phases:
        end.terminal, tight = True, {"method": "DOP853", "rtol": 1e-13, "atol": 1e-18}
        inside = [time for time in times if time not in ways]
        found = scipy.integrate.solve_ivp(of, (begin, times[-1]), state, events=end, dense_output=True, **tight)
        ways |= {time: found.sol(time)[0] for time in inside if time <= found.t[-1]}
        begin, state = found.t[-1], found.y[:, -1]
    return np.array([ways[time] for time in times])


def test_a_sliding_block_stops_and_its_sensitivities_are_those_of_its_law():
    """It stops after v / (mu g), at v^2 / (2 mu g), from where the bristle takes it back by REST times its length.

    Derivatives by differences of order four, of a relative change of 1e-4 of motions to 1e-13: 1e-9. At rest they are
    v / (mu g) and - v^2 / (2 mu^2 g).
    """
    friction, slip, times = 0.3, 1e-4, [0.1, 0.34, 0.345, 1.0]
    found = sensitivities(block(f"friction: {friction}", slip), ["friction", "linear_velocity.0"], times, ["block.x"])
    assert not found.rough
    ways = way_of_block(friction, 1.0, slip, times)
    assert_allclose(found.values[:, 0], ways, atol=1e-11)
    assert ways[-1] == pytest.approx(0.5 / (friction * G) - REST * slip, abs=1e-11)
    change, sides = 1e-4, np.array([1.0, -1.0, 2.0, -2.0])
    weights = np.array([8.0, -8.0, -1.0, 1.0]) / 12.0 / change
    by_friction = weights @ [way_of_block(friction * (1 + change * k), 1.0, slip, times) for k in sides] / friction
    by_speed = weights @ [way_of_block(friction, 1.0 + change * k, slip, times) for k in sides]
    assert_allclose(found.derivatives[:, 0], np.transpose([by_friction, by_speed]), atol=1e-8)
    assert_allclose(found.derivatives[-1, 0], [-0.5 / (friction**2 * G), 1.0 / (friction * G)], atol=1e-9)


def test_fixed_steps_of_a_hundred_slip_lengths_keep_friction():
    """They do not locate the stop: within the step of the stop the speed, mu g h at most, is wrong."""
    friction, slip, step = 0.3, 1e-5, 1e-3
    simulation = Simulation(block(f"friction: {friction}", slip), "rkmk4", step, quiet=True)
    simulation.advance(1000)
    error = abs(simulation.sample().pose[0, 9] - (0.5 / (friction * G) - REST * slip))
    assert error <= 0.5 * friction * G * step**2
    assert simulation.sample().errors[0, 0] >= 0.5 * error


def test_a_bristle_that_is_too_stiff_for_fixed_steps_is_noted(caplog):
    """It is mu m g / slip as stiff: with 1e-7 m its time is sqrt(slip / (mu g)) = 0.18 ms."""
    simulation = Simulation(block("friction: 0.3", 1e-7), "rkmk4", 1e-3)
    simulation.advance(1)
    assert "contact floor acts within 0.00018 s" in caplog.text


def test_sensitivities_hold_through_bounces_of_a_box():
    """Its corners touch and leave, and slide whenever they press: p_x = m v - mu (m g t + p_z), of all impulses."""
    body = BRICK % (0.0, 0.06, "linear_velocity: [3, 0, 0]")
    brick = scene([body], ["name: floor, body: brick, sinks: 1e-4, restitution: 0.2, friction: 0.1, slip: 1e-3"])
    times, outputs = np.array([0.1, 0.2, 0.3]), ["momentum_x", "momentum_z"]
    found = sensitivities(brick, ["friction"], times, outputs)
    (x, z), (by_x, by_z) = found.values.T, found.derivatives[:, :, 0].T
    assert_allclose(x, 9.0 - 0.1 * (3.0 * G * times + z), atol=1e-9)
    assert_allclose(by_x, -(3.0 * G * times + z) - 0.1 * by_z, atol=1e-8)


def test_a_standing_box_has_the_states_on_which_something_depends():
    """Springs of its four lower corners, across mu m g / slip each; the work, and bristles of upper ones, do nothing.

    12 states of the body and 8 bristles. They integrate the same three velocities, so 8 poles are zero. Its response to
    a slow push is that of statics, with its tilt; at 0.01 rad/s inertia and damping add 1e-9 of it, and LIGHT 1e-8.
    """
    mass, half, low, stiffness, depth, mu, slip = 3.0, 0.2, 0.05, 1e6, 3.0 * G / 4e6, 0.5, 1e-4
    body = BRICK % (0.0, low - depth, "linear_velocity: [0, 0, 0]")
    brick = scene(
        [body], [f"name: floor, body: brick, stiffness: {stiffness}, damping: 10, friction: {mu}, slip: {slip}"]
    )
    simulation = Simulation(brick, accuracy=1e-6, quiet=True)
    system = linearise(simulation, ["brick.force_x"], ["brick.x", "floor.normal_force"])
    bristles = [name for name in system.states if name.startswith("floor.")]
    assert bristles == [f"floor.bristle{4 * point + k}" for point in range(4) for k in range(2)]
    assert len(system.A) == 20 and (np.abs(system.poles) <= system.round_off).sum() == 8
    s = 0.01j
    (x,), _ = (system.C @ np.linalg.solve(s * np.eye(20) - system.A, system.B) + system.D).tolist()
    tilt = 4.0 * stiffness * half**2 - mass * G * low
    assert x.real == pytest.approx(slip / (4.0 * mu * mass * G) + low**2 / tilt, rel=2e-8)
    # The corners press with k d (1 + c d').
    heights = system.C[1, [system.states.index(name) for name in ("brick.z", "brick.z.rate")]]
    assert_allclose(heights, [-4.0 * stiffness, -4.0 * stiffness * 10 * depth], rtol=1e-9)
    assert linearise(simulation, [], ["floor.work"]).states == (*system.states, "floor.work")
    assert modes_of(linearise(simulation, [], []))[-1].pole.real < 0.0


def test_forces_of_supports_are_those_of_statics():
    """A beam on two supports: the lever rule."""
    body = "{name: beam, mass: 5, inertia: [0.1, 0.4, 0.4], position: [0, 0, 0]}"
    supports = [
        f"name: {name}, body: beam, shape: {{type: hull, points: [[{x}, -0.1, 0], [{x}, 0.1, 0]]}}, stiffness: 1e5, "
        "damping: 10"
        for name, x in (("left", -0.3), ("right", 0.5))
    ]
    simulation = Simulation(scene([body], supports), accuracy=1e-6, quiet=True)
    simulation.advance_to(3.0)
    shown = simulation.sample().signals
    assert shown["left.normal_force"] == pytest.approx(5 * G * 0.5 / 0.8, rel=1e-6)
    assert shown["right.normal_force"] == pytest.approx(5 * G * 0.3 / 0.8, rel=1e-6)
    assert shown["left.depth"] == pytest.approx(0.5 * shown["left.normal_force"] / 1e5, rel=1e-6)


@pytest.mark.parametrize(
    "shape, height, points",
    [
        ("type: sphere, radius: 0.1", 0.1, 1),
        ("type: capsule, radius: 0.1, length: 0.3, axis: [1, 0, 0]", 0.1, 2),
        ("type: cylinder, radius: 0.1, length: 0.3, axis: [1, 0, 0]", 0.1, 2),
        ("type: cylinder, radius: 0.1, length: 0.3", 0.15, 4),
        ("type: box, size: [0.3, 0.2, 0.1]", 0.05, 4),
    ],
)
def test_a_body_sinks_by_a_part_for_each_point(shape, height, points):
    """There its points carry its weight; 1e-9 of the depth is 1e-13 m, the round-off of heights."""
    depth = 1e-4 / points
    body = f"{{name: b, shape: {{{shape}, mass: 2}}, position: [0, 0, {height - depth}]}}"
    made = scene([body], ["name: floor, body: b, sinks: 1.0e-4, restitution: 0.5, friction: 0.3"])
    shown = Simulation(made, accuracy=1e-4, quiet=True).sample().signals
    assert shown["floor.normal_force"] == pytest.approx(2.0 * G, rel=1e-9)
    assert shown["floor.depth"] == pytest.approx(depth, rel=1e-9)


SHAPES = {
    "sphere": "type: sphere, radius: 0.1",
    "capsule": "type: capsule, radius: 0.1, length: 0.3",
    "cylinder": "type: cylinder, radius: 0.1, length: 0.3",
    "box": "type: box, size: [0.3, 0.2, 0.1]",
    "hull": "type: hull, points: [[0.1, 0, 0], [0, 0.2, 0], [0, 0, 0.3], [-0.1, -0.1, -0.1]]",
}


@pytest.mark.parametrize("friction", [0.0, 0.4])
@pytest.mark.parametrize("other", [False, True])
@pytest.mark.parametrize("kind", SHAPES)
def test_wrenches_and_points_are_those_of_newton_and_euler(kind, other, friction):
    """The wrench moves a free body as the engine says. About the point of contact it has no moment.

    Of several points with friction, which acts at different depths, this holds without friction only. The point of a
    sphere is below its centre in a plane, and in the middle of the region that two would occupy.
    """
    if other and kind not in ("sphere", "capsule"):
        return
    rng = np.random.default_rng(3)
    normal, turn = rng.normal(size=3), scipy.spatial.transform.Rotation.random(rng=rng)
    normal /= np.linalg.norm(normal)
    com, moments, place = np.array([0.05, -0.02, 0.03]), np.array([0.02, 0.03, 0.04]), np.array([0.02, 0.01, -0.03])
    shape = f"shape: {{{SHAPES[kind]}, position: {place.tolist()}}}, stiffness: 1e4, damping: 0.1"
    shape += f", friction: {friction}, slip: 1e-3" if friction else ""
    touches = "other: ball" if other else f"plane: {{point: [0.1, 0.2, 0.3], normal: {normal.tolist()}}}"
    bodies = [f"{{name: b, mass: 2, com: {com.tolist()}, inertia: {moments.tolist()}}}"]
    bodies += [BALL % (0.0, 0.0, 0.0)] if other else []
    made = Simulation(scene(bodies, [f"name: c, body: b, {shape}, {touches}"]), "rkmk4", 1e-3, quiet=True).layout
    pose, twist = np.tile([1.0, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0], (len(bodies), 1)), np.zeros((len(bodies), 6))
    pose[0, :9], twist[0] = turn.as_matrix().ravel(), rng.normal(size=6)
    if other:  # along the normal from the ball, which lets both overlap by 1 cm at the most
        pose[0, 9:] = 0.19 * normal - turn.apply(place)
    else:
        pose[0, 9:] += (made.sample(pose, twist).signals["c.depth"] - 0.01) * normal
    sample = made.sample(pose, twist)
    if not other:  # such a start, 0.01 m deep, is noted if that is above 3 times the weight over 1e4 N/m
        start = f"position: {pose[0, 9:].tolist()}, rotation_vector: {turn.as_rotvec().tolist()}"
        bodies = [f"{{name: b, mass: 2, inertia: [1, 1, 1], {start}}}"]
        deep, not_deep = (scene(bodies, [f"name: c, body: b, {shape}, {touches}"], g) for g in (1.6 * G, 1.8 * G))
        depth = deep.forces[0].depth_in_plane(deep.bodies[0])
        assert depth == pytest.approx(sample.signals["c.depth"], abs=1e-14) and not not_deep.notes
        assert "out b: 0.01 m deep in contact c, 3 times its depth under the load" in deep.notes[0]
    wrench, w, dv = sample.contact_wrenches["c"], twist[0, :3], sample.accelerations["b"]
    assert sample.signals["c.normal_force"] > 0.0
    force = 2.0 * (dv[3:] + np.cross(dv[:3], com) + np.cross(w, np.cross(w, com)) + turn.inv().apply([0, 0, G]))
    about_com = moments * dv[:3] + np.cross(w, moments * w)
    assert_allclose(wrench[3:], force, atol=1e-11 * np.abs(force).max())
    assert_allclose(wrench[:3], about_com + np.cross(com, force), atol=1e-11 * np.abs(force).max())
    point, centre = sample.contact_points["c"], pose[0, 9:] + turn.apply(place)
    assert_allclose(sample.contact_forces[0], [point, turn.apply(wrench[3:])], rtol=1e-14)
    if not friction or kind in ("sphere", "capsule"):
        arm = turn.inv().apply(point - pose[0, 9:])
        assert_allclose(wrench[:3], np.cross(arm, wrench[3:]), atol=1e-12 * np.abs(force).max())
    if kind == "sphere":
        down = -centre / np.linalg.norm(centre) if other else -normal
        deep = 0.5 * sample.signals["c.depth"] if other else 0.0
        assert_allclose(point, centre + (0.1 - deep) * down, atol=1e-14)


def test_a_sliding_cylinder_rolls_with_two_thirds_of_its_speed():
    """On its side, of moment m r^2 / 2 about its axis; it does not turn about the vertical."""
    body = (
        "{name: roll, shape: {type: cylinder, radius: 0.1, length: 0.4, mass: 2, axis: [0, 1, 0]}, "
        "position: [0, 0, 0.1], linear_velocity: [1, 0, 0]}"
    )
    floor = "name: floor, body: roll, sinks: 1e-5, restitution: 0.3, friction: 0.5, slip: 1e-5"
    simulation = Simulation(scene([body], [floor]), accuracy=1e-6, quiet=True)
    simulation.advance_to(0.5)
    sample = simulation.sample()
    velocity = sample.pose[0, :9].reshape(3, 3) @ sample.twist[0, 3:]
    assert_allclose(velocity, (2.0 / 3.0, 0.0, 0.0), atol=1e-6)
    assert_allclose(sample.twist[0, :3], (0.0, 2.0 / 3.0 / 0.1, 0.0), atol=1e-5)


@pytest.mark.parametrize("speed, spin", [(1.0, 0.1), (0.01, 10.0), (0.0, 10.0)])
def test_a_puck_slides_and_spins_as_a_rim(speed, spin):
    """The friction of a rim with even pressure, if it mostly slides or spins: both end together, or v / v0 goes with
    (w / w0)^(1/4). Both are off by squares of the ratio of their speeds, 0.01 to 0.03, and of slip / (settles v).
    """
    body = (
        "{name: puck, shape: {type: cylinder, radius: 0.1, length: 0.002, mass: 1}, position: [0, 0, 0.00099999], "
        f"linear_velocity: [{speed}, 0, 0], angular_velocity: [0, 0, {spin}]}}"
    )
    floor = "name: floor, body: puck, sinks: 1e-5, restitution: 0.3, friction: 0.2, slip: 1e-6"
    simulation = Simulation(scene([body], [floor]), accuracy=1e-6, quiet=True)
    for time in (0.1, 0.2):
        simulation.advance_to(time)
        sample, slower = simulation.sample(), 0.2 * G * time
        velocity, spins = sample.pose[0, :9].reshape(3, 3) @ sample.twist[0, 3:], sample.twist[0, 2]
        if speed > 0.1 * spin:
            part = 1.0 - slower / speed
            assert_allclose((velocity[0], spins), (speed * part, spin * part), atol=2e-4 * speed)
        else:
            part = 1.0 - 2.0 * slower / 0.1 / spin
            assert_allclose(spins, spin * part, atol=2e-4 * spin)
            assert_allclose(velocity[0], speed * part**0.25, atol=1e-3 * speed + 1e-9)


@pytest.mark.parametrize("shape", ["cylinder, radius: 0.05, length: 0.15", "box, size: [0.07, 0.07, 0.15]"])
def test_what_stands_on_one_edge_of_three_points_does_not_vibrate(shape):
    """A side force of 0.9 of what tips it lifts a point: friction that grew with the normal force would feed the rest.

    The box is pushed along its diagonal.
    """
    turn = "" if shape.startswith("cylinder") else f", rotation_vector: [0, 0, {0.25 * math.pi}]"
    body = f"{{name: b, shape: {{type: {shape}, mass: 1}}, position: [0, 0, 0.0749975]{turn}}}"
    floor = "name: floor, body: b, sinks: 1e-5, restitution: 0.3, friction: 0.9"
    edge = 0.05 if turn == "" else 0.035 * math.sqrt(2.0)
    push = f"name: push, type: law, signals: {{f: '{0.9 * G * edge / 0.135} * (1 - exp(-20*t))'}}, "
    push += "outputs: [{body: b, force: [f, 0, 0], point: [0, 0, 0.06], axes: world}]"
    simulation = Simulation(scene([body], [floor], more=f"  - {{{push}}}\n"), accuracy=1e-5, quiet=True)
    simulation.advance_to(1.0)
    poles = linearise(simulation).poles
    assert len(poles) and poles.real.max() <= 1e-6 * np.abs(poles).max()
    assert simulation.sample().signals["floor.normal_force"] == pytest.approx(G, rel=1e-4)


def test_a_can_that_wobbles_without_loss_keeps_its_energy():
    """It leans by 0.6 degrees and less and stands on up to four points, which turn with its lean; seen in the air."""
    motion = "rotation_vector: [0.008, 0.006, 0], angular_velocity: [0.1, 0, 5]"
    shape = "{type: cylinder, radius: 0.1, length: 0.1, mass: 1}"
    body = f"{{name: can, shape: {shape}, position: [0, 0, 0.0515], {motion}}}"
    simulation = Simulation(
        scene([body], ["name: floor, body: can, stiffness: 1e5, damping: 0"]), accuracy=1e-7, quiet=True
    )
    start, seen = simulation.sample().energy, []
    for sample in simulation.samples(np.arange(0.05, 1.0, 0.05)):
        if sample.signals["floor.normal_force"] == 0.0:
            seen.append(sample.energy - start)
    assert len(seen) > 5 and np.abs(seen).max() <= 1e-7 * start


def test_two_balls_exchange_their_momentum():
    """A central impact with restitution 0.5 of the reduced mass: v' = (m1 v1 -+ ...) / (m1 + m2)."""
    bodies = [
        "{name: a, shape: {type: sphere, radius: 0.1, mass: 1}, linear_velocity: [1, 0, 0]}",
        "{name: b, shape: {type: sphere, radius: 0.2, mass: 3}, position: [0.5, 0, 0]}",
    ]
    hit = "name: hit, body: a, other: b, stiffness: 1e4, restitution: 0.5, speed: 1"
    simulation = Simulation(scene(bodies, [hit], gravity=0.0), accuracy=1e-9, quiet=True)
    simulation.advance_to(1.0)
    speeds = simulation.sample().twist[:, 3]
    assert_allclose(speeds, (0.25 - 0.5 * 0.75, 0.25 + 0.5 * 0.25), atol=1e-8)
    assert abs(simulation.sample().twist[:, :3]).max() < 1e-12


def random_turn(rng):
    return SO3.exp(rng.normal(size=3))


SKELETONS = {
    "sphere": (0, "type: sphere, radius: 0.3"),
    "capsule": (1, "type: capsule, radius: 0.3, length: 0.8"),
    "box": (3, "type: box, size: [0.4, 0.6, 0.8]"),
}
PAIRS = [("sphere", "sphere"), ("sphere", "capsule"), ("capsule", "capsule"), ("sphere", "box"), ("box", "sphere")]
PAIRS += [("capsule", "box"), ("box", "capsule")]


@pytest.mark.parametrize("kinds", PAIRS)
@pytest.mark.parametrize("seed", range(3))
def test_depths_are_those_of_the_nearest_points(kinds, seed):
    """Against a minimisation over both skeletons: a point, an axis, a solid box."""
    rng = np.random.default_rng(seed)
    places, turns, offset = rng.uniform(-0.8, 0.8, (2, 3)), [random_turn(rng) for _ in range(2)], (0.1, -0.2, 0.15)
    bodies = [
        f"{{name: {name}, mass: 1, inertia: [1, 1, 1], position: {place.tolist()}, "
        f"rotation_vector: {SO3.log(turn).tolist()}}}"
        for name, place, turn in zip("ab", places, turns)
    ]
    shapes = [f"{{{SKELETONS[kind][1]}, position: {list(offset)}, axis: [1, 2, 2]}}" for kind in kinds]
    contact = f"name: c, body: a, other: b, shape: {shapes[0]}, other_shape: {shapes[1]}, stiffness: 1, damping: 0"
    made = scene(bodies, [contact], gravity=0.0)
    own = [made.forces[0].shape, made.forces[0].other_shape]

    def point(side, where):
        kind, shape = kinds[side], own[side]
        size = {"sphere": (), "capsule": (0.8,), "box": (0.4, 0.6, 0.8)}[kind]
        local = np.zeros(3)
        if size:
            local[3 - len(size) :] = 0.5 * np.array(size) * where
        return places[side] + turns[side] @ (np.array(offset) + shape.rotation @ local)

    counts, radii = [SKELETONS[kind][0] for kind in kinds], sum(0.3 for kind in kinds if kind != "box")
    # Of two axes, or an axis and a box, b (s - 1/2)^2 is added for the (first) axis.
    side = kinds.index("capsule") if "capsule" in kinds and "sphere" not in kinds else None
    barrel = 0.8 * SHORT * 0.3 * radii

    def square(x):
        parts = x[: counts[0]], x[counts[0] :]
        away = 0.0 if side is None else 0.5 * parts[side][0]
        return np.sum((point(0, parts[0]) - point(1, parts[1])) ** 2) + barrel * away**2

    best = square(np.zeros(0)) if sum(counts) == 0 else np.inf
    if sum(counts):
        options = {"ftol": 1e-16, "gtol": 1e-12}
        for start in product((-0.5, 0.5), repeat=sum(counts)):
            bounds = [(-1.0, 1.0)] * sum(counts)
            found = scipy.optimize.minimize(square, start, bounds=bounds, options=options)
            best = min(best, found.fun)
    shown = Simulation(made, "rkmk4", 1e-3, quiet=True).sample().signals
    assert shown["c.depth"] == pytest.approx(radii - math.sqrt(best), abs=1e-6)


@pytest.mark.parametrize("turn, more", [((0.0, 0.0), 1e4), ((0.0, 1e-3), 1e4), ((0.0, 1e-3), 1e6), ((0.3, 0.2), 1e6)])
@pytest.mark.parametrize(
    "other", ["box, size: [0.4, 0.8, 0.8]", "capsule, radius: 0.2, length: 0.3, axis: [0, 1, 0.1]"]
)
def test_capsules_that_meet_broadside_keep_their_energy(other, turn, more):
    """Their nearest points may be anywhere on the axis for a moment; without damping, 0.5 J remain."""
    bodies = [
        "{name: a, shape: {type: capsule, radius: 0.1, length: 0.4, mass: 1, axis: [0, 1, 0]}, "
        f"linear_velocity: [1, 0, 0], rotation_vector: [0, {turn[0]}, {turn[1]}]}}",
        f"{{name: b, shape: {{type: {other}, mass: 2}}, position: [0.7, 0.1, 0.1]}}",
    ]
    hit = f"name: hit, body: a, other: b, stiffness: {more}, damping: 0"
    simulation = Simulation(scene(bodies, [hit], gravity=0.0), accuracy=1e-6, quiet=True)
    simulation.advance_to(0.8)
    sample = simulation.sample()
    assert sample.twist[0, 3] < 0.95 and not sample.contact_points  # it has hit, and left
    assert simulation.largest_error <= 1e-6
    # Speeds are 1 m/s, of masses and moments below 2 kg: J by errors of an accuracy of 1e-6 for each of 12 rates.
    assert sample.energy == pytest.approx(0.5, abs=12 * 1e-6)


@pytest.mark.parametrize("speed, depth", [(1.0, 0.15), (30.0, 0.15), (1.0, 0.4)])
def test_a_ball_that_dives_into_a_box_is_pushed_out(speed, depth, caplog):
    """Its centre is behind the face for a time: the spring acts on, x = v/w sin w t, and the speed is reversed.

    Beyond the radius and half the box, 0.6 m, it would come out on the other side: at half of that there is a warning.
    """
    rate = speed / depth
    bodies = [
        f"{{name: ball, shape: {{type: sphere, radius: 0.1, mass: 1}}, linear_velocity: [{speed}, 0, 0]}}",
        "{name: box, mass: 1, inertia: [1, 1, 1], position: [0.8, 0, 0]}",
    ]
    box = "shape: {type: sphere, radius: 0.1}, other_shape: {type: box, size: [1, 1, 1]}"
    hit = f"name: hit, body: ball, other: box, {box}, stiffness: {rate**2}, damping: 0"
    held = "joints:\n  - {name: fix, type: fixed, parent: world, child: box, parent_frame: {}}\n"
    simulation = Simulation(scene(bodies, [hit], gravity=0.0, more=held), accuracy=1e-8)
    touch, end = 0.2 / speed, 0.2 / speed + math.pi / rate
    simulation.advance_to(0.5 * (touch + end))
    assert simulation.sample().pose[0, 9] == pytest.approx(0.2 + depth, abs=1e-7)
    simulation.advance_to(end + 0.1 / speed)
    assert simulation.sample().twist[0, 3] == pytest.approx(-speed, rel=1e-7)
    assert ("m deep; its bodies pass through each other at 0.6 m" in caplog.text) == (depth > 0.3)


@pytest.mark.parametrize("first", [True, False])
def test_balls_that_are_far_apart_have_no_depth(first, caplog):
    """Wherever their contact is in the list: 1 m apart, then one passes the other at 0.21 m, and none touches."""
    bodies = [
        "{name: a, shape: {type: sphere, radius: 0.1, mass: 1}}",
        "{name: b, shape: {type: sphere, radius: 0.1, mass: 1}, position: [1, 0.21, 0], linear_velocity: [-9, 0, 0]}",
    ]
    hit, floor = "name: hit, body: a, other: b", "name: floor, body: a, plane: {point: [0, 0, -5]}"
    contacts = [f"{each}, stiffness: 1e5, damping: 0.5" for each in ((hit, floor) if first else (floor, hit))]
    simulation = Simulation(scene(bodies, contacts, gravity=0.0), accuracy=1e-6)
    simulation.advance_to(0.3)
    assert not caplog.text and simulation.event_count == 0
    assert simulation.sample().signals["hit.depth"] == pytest.approx(0.2 - math.hypot(1 - 9 * 0.3, 0.21), rel=1e-12)


@pytest.mark.parametrize("aside", [0.0, 0.04])
@pytest.mark.parametrize("length, friction", [(0.2, 0.5), (0.6, 0.5), (0.6, 0.0)])
def test_a_bar_on_a_box_bears_where_its_weight_is(length, friction, aside):
    """It leans until f(s) + b (s - 1/2)^2 of `_touch_each_other` is least below its centre of mass."""
    radius, stiffness = 0.05, 1e5
    bodies = [
        f"{{name: bar, mass: 3, inertia: [0.1, 0.1, 0.1], position: [{aside}, 0, {0.1 + radius}]}}",
        "{name: table, mass: 1, inertia: [1, 1, 1]}",
    ]
    shape = f"{{type: capsule, radius: {radius}, length: {length}, axis: [1, 0, 0], position: [{-aside}, 0, 0]}}"
    contact = f"name: c, body: bar, other: table, shape: {shape}, stiffness: {stiffness}, damping: 5"
    held = "joints:\n  - {name: fix, type: fixed, parent: world, child: table, parent_frame: {}}\n"
    table = "other_shape: {type: box, size: [0.3, 0.4, 0.2]}" + f", friction: {friction}, slip: 1e-4" * (friction > 0)
    simulation = Simulation(scene(bodies, [f"{contact}, {table}"], more=held), accuracy=1e-6, quiet=True)
    simulation.advance_to(3.0)
    sample, weight = simulation.sample(), 3 * G
    assert sample.signals["c.normal_force"] == pytest.approx(weight, rel=1e-9)
    rotation = sample.pose[0, :9].reshape(3, 3)
    # f = (r - d + slope * x)^2 at x along the axis: its derivative by s is 2 r slope * length, of 1e-3 relative by d.
    load = G / (1 / 3 + 1 / 1)  # of the reduced mass
    slope = 0.8 * load / stiffness / length * aside / length
    assert rotation[2, 0] == pytest.approx(-slope, abs=1e-2 * abs(slope) + 1e-12)
    depth = weight / stiffness
    assert sample.signals["c.depth"] == pytest.approx(depth, rel=2e-3)
    assert np.abs(sample.twist[0]).max() < 1e-6


@pytest.mark.parametrize("heavy", [1.0, 1000.0])
def test_the_tip_of_a_capsule_presses_on_whatever_is_heavy(heavy):
    """Its depth lacks b / (8 r), see `_touch_each_other`: a tenth of the depth under the weight of the reduced mass."""
    radius, depth, stiffness = 0.05, 1e-3, 1e5
    tip, table = f"capsule, radius: {radius}, length: 0.4, mass: 1", f"box, size: [1, 0.6, 0.2], mass: {heavy}"
    bodies = [
        f"{{name: tip, shape: {{type: {tip}}}, position: [0, 0, {0.35 - depth}]}}",
        f"{{name: table, shape: {{type: {table}}}}}",
    ]
    made = scene(bodies, [f"name: c, body: tip, other: table, stiffness: {stiffness}, damping: 0"])
    force = Simulation(made, accuracy=1e-6, quiet=True).sample().signals["c.normal_force"]
    short = max(SHORT * radius, G / (1.0 + 1.0 / heavy) / stiffness)
    least = math.hypot(radius - depth, math.sqrt(0.8 * short * radius / 4.0))
    assert force == pytest.approx(stiffness * (radius - least) * (radius - depth) / least, rel=1e-9)
    assert force > 0.98 * stiffness * depth


def test_a_standing_ball_is_a_spring_and_its_motion_is_linear():
    """lambda^2 = -k/m for the height; rolling is free, and friction holds the point of contact."""
    made = ball("stiffness: 2e4, damping: 0, friction: 0.5, slip: 1e-4, settles: 1e-4", RADIUS - 2 * G / 2e4)
    values = np.linalg.eigvals(linearise(Simulation(made, quiet=True)).A)
    assert np.abs(values.imag).max() >= math.sqrt(2e4 / 2) * (1 - 1e-9)
    # The bristle: stiffness mu m g / slip at the mass 2/7 m, as the ball turns, too; lambda^2 = -w^2 (1 + tau lambda).
    square = 0.5 * G / 1e-4 * 7 / 2
    for rate in (1j * math.sqrt(2e4 / 2), np.roots([1.0, square * 1e-4, square])[0]):
        assert np.abs(values - rate).min() <= 1e-6 * abs(rate)


def test_derivatives_of_a_bounce_are_those_of_its_closed_form():
    """d z / d k of a ball in free flight after an elastic impact: it leaves later by d t_c / d k."""
    height, stiffness = 0.05, 1e4
    made = ball(f"stiffness: {stiffness}, damping: 0", RADIUS + height)
    found = sensitivities(made, ["floor.stiffness"], [0.3], ["ball.z"])
    ends = [bounce(stiffness * (1.0 + h), height) for h in (-1e-4, 1e-4)]
    rate = (ends[1][1] - ends[0][1]) / (2e-4 * stiffness)
    fall, touch = bounce(stiffness, height)
    speed = G * fall - G * (0.3 - fall - touch)  # at 0.3 s, upwards
    assert found.derivatives.item() == pytest.approx(-rate * speed, rel=1e-6)


@pytest.mark.parametrize(
    "change, reason",
    [
        ("stiffness: 1, sinks: 1, damping: 1", "stiffness and sinks: keep one"),
        ("damping: 1", "stiffness is missing: give stiffness or sinks"),
        ("stiffness: 1, restitution: 2", "restitution must be from 0.01 to 1"),
        ("stiffness: 1, damping: 1, friction: 1", "slip is missing"),
        ("stiffness: 1, damping: 1, other: bal", "other 'bal' is not a body"),
        ("stiffness: 1, damping: 1, other: ball", "other must be another body"),
        (
            "stiffness: 1, damping: 1, other_shape: {type: sphere, radius: 1}",
            "^test:6: .*other is missing: name the body that has other_shape",
        ),
        (
            f"stiffness: 1, damping: 1, shape: {{type: hull, points: {[[0, 0, 0]] * 65}}}",
            "64 points .*got a list of 65$",
        ),
        (
            "sinks: 1e-300, damping: 1",
            "sinks 1e-300 gives a depth of 1e-300 m at rest; double precision resolves 2.2e-14",
        ),
        ("sinks: 1e-3, damping: 1, plane: {point: [0, 0, 1e18]}", "at coordinates of 1e.18 m: give a larger sinks"),
        ("sinks: 1e-3, load: 1e90, damping: 1", "sinks 0.001 under the load 1e.90 N gives a depth of 2e-92 m"),
        ("sinks: 1e-3, load: 1e-20, damping: 1", "must be from 1e-09 to 100000 s: change sinks or load"),
        ("stiffness: 1e-300, damping: 1", "must be from 1e-09 to 100000 s: change stiffness"),
        (
            "sinks: 5, damping: 1",
            "sinks 5 lets the body sink 5 m by its own weight, more than the size of the shape, 0.2",
        ),
        (
            "sinks: 1e-3, restitution: 0.5, speed: 1e-9",
            "damping must be at most 1e.06 s/m, got 1.43e.09 of restitution",
        ),
        ("sinks: 1e-3, damping: 1, friction: 1e3", "friction must be at most 100"),
        ("sinks: 1e-3, damping: 1, friction: 1, slip: 1e-20", "slip of 1e-20 m; double precision resolves 2.2e-14 m"),
        ("sinks: 1e-3, damping: 1, friction: 1, settles: 1e9", "settles must be at most"),
        ("sinks: 1e-3, damping: 1, friction: 1, settles: 0", "settles must be at least 1e-05 s, 0.001 times sqrt"),
        ("stiffness: 1e5, damping: 1, load: 20", "^test:6: .*load has no effect without sinks or friction"),
        ("sinks: 1e-3, damping: 1, slip: 1e-4", "slip has no effect without friction"),
    ],
)
def test_a_wrong_contact_is_refused_in_one_line(change, reason):
    with pytest.raises(SceneError, match=reason):
        ball(change)


@pytest.mark.parametrize(
    "other, place, is_refused",
    [
        ("sphere, radius: 0.2", (1, 2, 3), True),
        ("sphere, radius: 0.2", (1, 2, 3.01), False),
        ("capsule, radius: 0.1, length: 0.4", (1, 2, 3.1), True),  # its axis begins 0.1 m below
        ("capsule, radius: 0.1, length: 0.4, axis: [1, 0, 0]", (1.1, 2, 3), True),
        ("capsule, radius: 0.1, length: 0.4, axis: [1, 0, 0]", (1.1, 2, 2.95), False),
    ],
)
@pytest.mark.parametrize("mine", ["sphere, radius: 0.1", "capsule, radius: 0.1, length: 0.2, axis: [0, 1, 0]"])
def test_round_bodies_that_start_in_one_point_are_refused(mine, other, place, is_refused):
    """Nothing says in which direction they push; they would pass through each other."""
    bodies = [
        f"{{name: {name}, mass: 1, inertia: [1, 1, 1], position: {list(at)}}}"
        for name, at in (("a", (1, 2, 3)), ("b", place))
    ]
    keys = f"sinks: 1e-3, damping: 1, shape: {{type: {mine}}}, other: b, other_shape: {{type: {other}}}"
    with pytest.raises(SceneError, match="a and b start with .* in one point") if is_refused else nullcontext():
        scene(bodies, [f"name: c, body: a, {keys}"])


def test_figures_of_the_page_on_weight_and_on_unloaded_friction():
    """A drop at 1 m/s for the restitution 0.5, by an integration of its own; and the first slip of a block."""
    load, sinks = 2 * G, 1e-4
    k, c = load / sinks, damping_of(0.5, 1.0)

    def leaves(_, y):
        return y[0]

    leaves.terminal, leaves.direction = True, -1.0
    fall = scipy.integrate.solve_ivp(
        lambda _, y: (y[1], G - k * y[0] * (1.0 + c * y[1]) / 2.0), (0.0, 0.1), (0.0, 1.0), events=leaves,
        rtol=1e-10, atol=1e-14,
    )  # fmt: skip
    expected = -fall.y_events[0][0][1]
    assert f"{expected:.3f}" == "0.470"
    simulation = Simulation(ball(f"sinks: {sinks}, restitution: 0.5", RADIUS, 0.0, -1.0), accuracy=1e-8, quiet=True)
    while simulation.sample().signals["floor.normal_force"] > 0.0 or simulation.time == 0.0:
        simulation.advance_to(simulation.time + 1e-5)
    # Since then it has lost g 1e-5 s at the most.
    assert simulation.sample().twist[0, 5] == pytest.approx(expected, abs=G * 1e-5 + 1e-7)
    angle, body = math.atan(0.98 * 0.5), "{name: block, shape: {type: box, size: [0.4, 0.3, 0.2], mass: 2}, %s}"
    above = 0.1 - 0.25 * sinks * math.cos(angle)  # where its weight rests on four points
    turned = f"rotation_vector: [0, {angle}, 0], position: [{above * math.sin(angle)}, 0, {above * math.cos(angle)}]"
    plane = f"plane: {{point: [0, 0, 0], normal: [{math.sin(angle)}, 0, {math.cos(angle)}]}}"
    keys = f"body: block, sinks: {sinks}, restitution: 0.1, friction: 0.5, {plane}"
    block = scene([body % turned], [f"name: floor, {keys}"])
    simulation = Simulation(block, accuracy=1e-6, quiet=True)
    start = simulation.sample().pose[0, 9:]
    simulation.advance_to(5.0)
    moved = simulation.sample().pose[0, 9:] - start
    assert f"{1e3 * moved @ (math.cos(angle), 0.0, -math.sin(angle)):.2f}" == "0.10"


def test_points_that_press_are_known_and_planes_are_drawn_around_them():
    """A box of 2 kg that stands, and a ball that skids; the patch of z = 0 is below a box about both."""
    bodies = [
        "{name: box, shape: {type: box, size: [0.4, 0.3, 0.2], mass: 2}, position: [0, 0, 0.1]}",
        "{name: ball, shape: {type: sphere, radius: 0.1, mass: 2}, position: [1, 0, 0.1], linear_velocity: [1, 0, 0]}",
    ]
    keys = "sinks: 1e-3, restitution: 0.1, friction: 0.3"
    made = scene(bodies, [f"name: a, body: box, {keys}", f"name: b, body: ball, {keys}"])
    simulation = Simulation(made, accuracy=1e-6, quiet=True)
    simulation.advance_to(0.05)  # it rolls from 2 v / 7 mu g = 0.097 s on
    sample = simulation.sample()
    points = sample.pressing[sample.pressing[:, 0] == 1.0, 1:]
    assert_allclose(points[:4, :2], [(x, y) for x in (-0.2, 0.2) for y in (-0.15, 0.15)], atol=1e-9)
    assert_allclose(points[4, :2], sample.pose[1, 9:11], atol=1e-12)
    assert points[:, 3].tolist() == [0.0, 0.0, 0.0, 0.0, 1.0] and len(sample.pressing) == 9
    (patch,) = patches(made, np.array([-0.2, -0.15, 0.5]), np.array([1.1, 0.15, 1.0]))
    # Of the long side 1.3 m there is a tenth more; the other one is half as wide.
    assert_allclose(np.sort(np.ptp(patch, axis=0)), [0.0, 0.65, 1.43], rtol=1e-6)
    assert_allclose(patch.mean(axis=0), [0.45, 0.0, 0.0], atol=1e-9)


@pytest.mark.parametrize("step, told", [(0.02, True), (0.002, False)])
def test_a_step_that_is_too_long_for_a_contact_is_told(step, told, caplog):
    """sqrt(2 kg / 2e4 N/m) is 0.01 s; a run that stops says it, too."""
    made = ball("stiffness: 2e4, damping: 0", RADIUS + 0.01)
    simulation = Simulation(made, "rkmk4", step)
    text = "contact floor acts within 0.01 s, sqrt(mass / stiffness): give steps well below that"
    simulation.advance_to(0.1)
    assert (text in caplog.text) == told
    assert (text in explain(simulation, NOT_FINITE)) == told
    caplog.clear()
    Simulation(made, accuracy=1e-3).advance_to(0.1)
    assert text not in caplog.text


def integrated(rates, start, begin, end, longest):
    """State at an end, by SciPy with steps that resolve a short contact."""
    return scipy.integrate.solve_ivp(rates, (begin, end), start, "DOP853", rtol=1e-12, atol=1e-14, max_step=longest).y[
        :, -1
    ]


@pytest.mark.parametrize("overlap", [1e-2, 1e-4, 1e-6])
def test_balls_that_graze_after_a_long_flight_touch(overlap):
    """Steps of free flight would pass them: they touch at 5 m, for 2 sqrt(2 overlap 0.2 m) / (1 m/s)."""
    bodies = [
        "{name: a, shape: {type: sphere, radius: 0.1, mass: 1}, linear_velocity: [1, 0, 0]}",
        f"{{name: b, shape: {{type: sphere, radius: 0.1, mass: 1}}, position: [5, {0.2 - overlap!r}, 0]}}",
    ]
    hit = "name: hit, body: a, other: b, stiffness: 1e4, damping: 0"
    simulation = Simulation(scene(bodies, [hit], gravity=0.0), accuracy=1e-9, quiet=True)
    simulation.advance_to(10.0)

    def rates(_, state):
        apart = np.array([state[0] - 5.0, state[1] - 0.2 + overlap])  # of a from b, which keeps its place so shortly
        force = 1e4 * max(0.2 - math.hypot(*apart), 0.0) * apart / math.hypot(*apart)
        return [*(state[2:4]), *(2.0 * force)]

    x, y, vx, vy = integrated(rates, [4.9, 0.0, 1.0, 0.0], 0.0, 0.2, 1e-4)
    # The relative motion is that of the reduced mass; b goes on with the rest of the momentum.
    expected = [(0.5 + 0.5 * vx, 0.5 * vy), (0.5 - 0.5 * vx, -0.5 * vy)]
    assert_allclose(simulation.sample().twist[:, 3:5], expected, atol=1e-8)


@pytest.mark.parametrize("rate", [1.0, 50.0])
@pytest.mark.parametrize("dip", [1e-3, 1e-6])
def test_a_corner_that_dips_into_the_plane_as_its_body_turns_is_seen(rate, dip):
    """A step of a free rotation would pass the dip: 0.1 rad and 0.004 rad of a turn; against SciPy."""
    arm, inertia = 0.2, 0.01
    bodies = [
        f"{{name: b, mass: 1, inertia: [{inertia}, {inertia}, {inertia}], position: [0, 0, {arm - dip!r}], "
        f"angular_velocity: [0, {rate}, 0]}}"
    ]
    shape = f"{{type: hull, points: [[{arm}, 0, 0], [-0.05, 0, 0]]}}"
    floor = f"name: floor, body: b, shape: {shape}, stiffness: 1e4, damping: 0"
    simulation = Simulation(scene(bodies, [floor], gravity=0.0), accuracy=1e-9, quiet=True)
    simulation.advance_to(3.0 / rate)

    def rates(_, state):
        force = 1e4 * max(-state[0] + arm * math.sin(state[1]), 0.0)
        return [state[2], state[3], force, -force * arm * math.cos(state[1]) / inertia]

    z, _, climb, turn = integrated(rates, [arm - dip, 0.0, 0.0, rate], 0.0, 3.0 / rate, 1e-3 / rate)
    sample = simulation.sample()
    velocity = sample.pose[0, :9].reshape(3, 3) @ sample.twist[0, 3:]
    assert_allclose((sample.pose[0, 11], velocity[2], sample.twist[0, 1]), (z, climb, turn), rtol=1e-8, atol=1e-8)
    assert climb > 1e-7


def test_boxes_do_not_touch_each_other():
    bodies = [f"{{name: {name}, shape: {{type: box, size: [1, 1, 1], mass: 1}}}}" for name in "ab"]
    with pytest.raises(SceneError, match="a box can touch a plane or a round body"):
        scene(bodies, ["name: c, body: a, other: b, stiffness: 1, damping: 1"])


def test_points_that_touch_nothing_cost_an_implicit_method_no_evaluation():
    """Its derivatives and its equations leave out what nothing depends on: a stumbling block with 48 more points."""
    feet, found = list(product((-0.1, 0.1), (-0.1, 0.1), (-0.05,))), []
    above = [(0.09 * math.cos(k), 0.09 * math.sin(k), 0.05) for k in range(48)]
    block = "{name: block, mass: 2, inertia: [0.01, 0.01, 0.015], position: [0, 0, 0.05], linear_velocity: [0.1, 0, 0]}"
    for points in (feet, feet + above):
        keys = "name: floor, body: block, sinks: 1e-3, restitution: 0.5, friction: 0.5, settles: 0.1"
        made = scene([block], [f"{keys}, shape: {{type: hull, points: {list(map(list, points))}}}"])
        engine = Engine(made, "radau5", 0.01, rtol=1e-6, atol=1e-6)
        engine.advance(50)
        found.append((engine._integrator.evaluations, engine.sample().pose))
    assert found[0][0] == found[1][0]
    assert_allclose(found[0][1], found[1][1], rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("accuracy", [1e-4, 1e-7])
def test_a_disc_that_drops_flat_and_spins_slows_by_the_impulse_of_its_contact(accuracy):
    """All points of a rim touch and leave at one instant: I w' = -mu N r while it slips, m (v + g t) the impulse of N.

    From each touch on the bristle yields for slip / (r w) = 25 us, while N grows to 2 N: 5e-5 rad/s, twice.
    """
    disc = "{name: disc, shape: {type: cylinder, radius: 0.2, length: 0.05, mass: 2}, position: [0, 0, 0.026], %s}"
    keys = "name: floor, body: disc, sinks: 1e-4, restitution: 0.2, friction: 0.5"
    made = scene([disc % "angular_velocity: [0, 0, 10]"], [keys])
    simulation = Simulation(made, accuracy=accuracy, horizon=1.0, quiet=True)
    for time in (0.02, 0.05, 0.1):
        simulation.advance_to(time)
        twist = simulation.sample().twist[0]
        assert twist[2] == pytest.approx(10.0 - 0.5 * 2.0 / 0.2 * (twist[5] + G * time), abs=1e-4)
    simulation.advance_to(0.4)
    assert abs(simulation.sample().twist[0, 2]) < 1e-3  # it stands


def test_without_gravity_friction_is_as_stiff_as_the_normal_force():
    """Its load is that at which both yield alike, and its damping is critical: tau = sqrt(m / k)."""
    (floor,) = ball("stiffness: 1e5, damping: 0, friction: 0.2, slip: 1e-5", gravity=0.0).forces
    assert floor.numbers["settles"] == pytest.approx(math.sqrt(2.0 / 1e5), rel=1e-12)


def test_steps_of_the_reference_end_where_contacts_change():
    """Its error is that of smooth motions, and each of the changes that the engine finds costs it a few steps.

    A change takes two steps up to it, and at most four of double length from there to those of the free motion. A step
    with a change inside would have to be repeated 40 times, in halves, until the tolerance hides the change.
    """
    scene = scene_from_text(
        """
name: skid
gravity: [0, 0, -9.81]
bodies:
  - {name: ball, shape: {type: sphere, radius: 0.1, mass: 2}, position: [0, 0, 0.3], linear_velocity: [1, 0, 0]}
forces:
  - {name: floor, type: contact, body: ball, sinks: 1.0e-4, restitution: 0.5, friction: 0.3}
"""
    )
    simulation = Simulation(scene, accuracy=1e-6, quiet=True)
    reference = Reference(scene, *simulation.state()[:2])
    _, uncertainty = reference.up_to_limit(np.array([1.0]))
    simulation.advance_to(1.0)
    changes = len(simulation.drain_events())
    assert 20 < changes and reference.steps < 12 * changes and uncertainty.position[0, 0] < 1e-12


def test_an_implicit_method_that_fails_is_left(monkeypatch):
    """A cylinder that stands and spins begins with tiny substeps, in which the implicit method fails.

    The friction of a rim decelerates the spin by 2 mu / R times the impulse of the normal force per mass, g t + v, from
    the yielding on: by then the rim, at R omega = 1 m/s, has slipped by mu 0.1 mm under the load.
    """
    body = "{name: b, shape: {type: cylinder, radius: 0.1, length: 0.1, mass: 2}, position: [0, 0, 0.05], "
    keys = "name: f, body: b, sinks: 1e-4, restitution: 0.5, friction: 0.5"
    made = scene([body + "angular_velocity: [0, 0, 10]}"], [keys])
    left = []
    original = MethodChoice.leave
    monkeypatch.setattr(MethodChoice, "leave", lambda self: left.append(original(self)) or left[-1])
    monkeypatch.setattr(MethodChoice, "_cost", lambda self, number, most, steps: 1e4 if number == EXPLICIT else 1.0)
    simulation = Simulation(made, accuracy=1e-6, quiet=True)
    simulation.advance_to(0.05)
    assert left == [True] and simulation.largest_error < 1e-6
    twist = simulation.sample().twist[0]
    lost = 2.0 * 0.5 / 0.1 * (9.81 * 0.05 + twist[5])
    assert abs(10.0 - lost - twist[2]) < 2.0 * 0.5 * 9.81 / 0.1 * 5e-5  # the deceleration by the weight in that time
