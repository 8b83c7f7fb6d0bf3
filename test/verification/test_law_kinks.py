# SPDX-License-Identifier: Apache-2.0
"""Kinks and jumps of laws are events: methods keep their order through them. Closed forms of a cart on a rail."""

import math

import numpy as np
import pytest
import scipy
from convergence import fitted_order
from numpy.testing import assert_allclose
from scene_files import cases, text_of

from liegroup_core import Simulation, SimulationError, load_scene
from liegroup_core.engine import Engine
from liegroup_core.identification import Given, Log, Measured, identify
from liegroup_core.linear import inverse_dynamics, linearise, sensitivities, transition, trim
from liegroup_core.mechanism.body_model import initial_state
from liegroup_core.reference.trajectory import WrenchSpan, integrate
from liegroup_core.scene.centres import at_centres_of_mass
from liegroup_core.scene.load import scene_from_text

START = 0.3  # m, of the cart of 1 kg: its acceleration is the effort
RAIL = text_of("rail_law_kinks.yaml")


def cart(effort, velocity=0.0, **keys):
    """Scene of the cart under a law; a dict of keys of its joint may be in keys["joint"]."""
    scene = scene_from_text(RAIL, "test")
    joint = keys.pop("joint", {})
    inputs = {"q": "rail.position", "v": "rail.velocity"}
    law = {"type": "law", "name": "own", "inputs": inputs, "outputs": [{"joint": "rail", "effort": effort}]} | keys
    body = scene.bodies[0].remade(linear_velocity=(0.0, 0.0, velocity))
    return scene.remade(bodies=[body], joints=[scene.joints[0].remade(**joint)], forces=[law])


def end_of(simulation, time):
    simulation.advance_to(time)
    return simulation.sample().joint_coordinates["rail"]


def springs(time, above=3.0, below=5.0):
    """(q, v) of the cart between two springs of these rates in rad/s, one on each side of zero."""
    at, speed = 0.5 * math.pi / above, START * above
    if time <= at:
        return START * math.cos(above * time), -speed * math.sin(above * time)
    sign, rate = -1.0, below
    while time > at + math.pi / rate:
        at, sign, rate = at + math.pi / rate, -sign, above if sign < 0.0 else below
    turn = rate * (time - at)
    return sign * speed / rate * math.sin(turn), sign * speed * math.cos(turn)


def parabolas(time):
    """(q, v) of the cart that a force of 1 N pulls to zero."""
    quarter = math.sqrt(2.0 * START)
    phase = (time + quarter) % (4.0 * quarter)  # rises through zero at 0
    sign, since = (1.0, phase) if phase < 2.0 * quarter else (-1.0, phase - 2.0 * quarter)
    return sign * since * (quarter - 0.5 * since), sign * (quarter - since)


def stepped(time, at=0.5537):
    """(q, v) of the cart with a force of 1 N from a time on."""
    since = max(time - at, 0.0)
    return START + 0.5 * since**2, since


def pushed(time, at=567 / 1024, short=2**-20):
    """(q, v) of the cart after an impulse of 1 N s in a short time from a time on, numbers without rounding."""
    return START + time - at - 0.5 * short, 1.0


TABLE = {"x": [-1, 0, 1], "y": [25, 0, -9]}
KINKS = {
    "if": ({"effort": "-9*q if q > 0 else -25*q"}, springs),
    "not": ({"effort": "-25*q if not q >= 0 else -9*q"}, springs),
    "and": ({"effort": "-9*q if q > 0 and q < 7 else -25*q"}, springs),
    "min and max": ({"effort": "-25*min(q, 0) - 9*max(q, 0)"}, springs),
    "clip": ({"effort": "-25*clip(q, -7, 0) - 9*clip(q, 0, 7)"}, springs),
    "abs": ({"effort": "8*abs(q) - 17*q"}, springs),
    "table": ({"effort": "spring(q)", "tables": {"spring": TABLE}}, springs),
    "jump": ({"effort": "-1 if q > 0 else 1"}, parabolas),
    "table end": ({"effort": "pull(q)", "tables": {"pull": {"x": [-1e-13, 1e-13], "y": [1, -1]}}}, parabolas),
    "time": ({"effort": "1 if t > 0.5537 else 0"}, stepped),
    "time with max": (
        {"effort": "max(t - 0.5537, 0)"},
        lambda t: (START + (t - 0.5537) ** 3 / 6, (t - 0.5537) ** 2 / 2),
    ),
    # No stage of a step is within these pulses.
    "pulse": ({"effort": "2**20 if t > 567/1024 and t < 567/1024 + 2**-20 else 0"}, pushed),
    "pulse of shifted time": (
        {"effort": "2**20 if 0 < t - at <= d else 0", "parameters": {"at": 567 / 1024, "d": 2**-20}},
        pushed,
    ),
    # Beyond its end this branch has no value: a root of a negative number.
    "root": ({"effort": "-9*sqrt(q)*sqrt(q) if q > 0 else -25*q"}, springs),
}


BALL = text_of("ball_law_kinks.yaml")


@pytest.mark.parametrize("accuracy", [None, 1e-3])
def test_a_law_that_ends_with_a_step_ends(accuracy):
    """At the end of a step, or next to it, whose time the sizes of the substeps before miss by round-off."""
    settings = {} if accuracy is None else {"accuracy": accuracy}
    for end in (0.5, 0.5 + 1e-10, 0.3 + 1e-11, 0.07, 0.33):
        simulation = Simulation(scene_from_text(BALL.replace("END", repr(end))), quiet=True, **settings)
        simulation.advance_to(1.0)
        assert_allclose(simulation.sample().twist[0, 1], 2.0 * end / 0.008, rtol=1e-11)


@pytest.mark.parametrize("name", KINKS)
@pytest.mark.parametrize("method", ["rkmk54", "rkmk853", "radau5"])
@pytest.mark.volume(14)
def test_errors_are_those_of_the_tolerance_through_kinks(name, method):
    """At most ten times the tolerance, as of smooth motions."""
    law, known = KINKS[name]
    for tolerance in (1e-5, 1e-8, 1e-11):
        settings = {"rtol": tolerance, "atol": tolerance, "estimate": False}
        simulation = Simulation(cart(**law), method, 1 / 64, quiet=True, **settings)
        assert np.abs(np.subtract(end_of(simulation, 2.0), known(2.0))).max() <= 10 * tolerance
    assert simulation._switching.tally.sum() > 0


@pytest.mark.parametrize("name", KINKS)
@pytest.mark.parametrize("group", ["auto", "se3"])
@pytest.mark.volume(10)
def test_runs_to_an_accuracy_keep_it_through_kinks(name, group):
    law, known = KINKS[name]
    for accuracy in (1e-4, 1e-9):
        simulation = Simulation(cart(**law), accuracy=accuracy, group=group, quiet=True)
        found = end_of(simulation, 2.0)
        assert np.abs(np.subtract(found, known(2.0))).max() <= accuracy
        assert simulation.largest_error <= accuracy


@pytest.mark.parametrize("settings", [{"method": "rkmk4", "step": 0.01}, {"accuracy": 1e-8}])
def test_an_impact_changes_the_branch_of_a_law(settings):
    """The force 2 |v| slows the cart, v = -e^(-2 t), to its stop at -0.1 m; after it, it drives the cart away."""
    limits = {"limits": {"lower": -0.1, "restitution": 0.5}}
    simulation = Simulation(cart("2*abs(v)", velocity=-1.0, joint=limits), quiet=True, **settings)
    hit = -0.5 * math.log(1.0 - 2.0 * 0.4)
    after = 0.5 * math.exp(-2.0 * hit) * np.exp(2.0 * (1.0 - hit))
    q, v = end_of(simulation, 1.0)
    assert_allclose((q, v), (-0.1 + 0.5 * (after - 0.5 * math.exp(-2.0 * hit)), after), atol=1e-7)
    assert [event.kind for event in simulation.drain_events()] == ["impact"]


def decayed(time):
    """(q, v) of the cart that an effort of 5 N drives to v = -2 q, which holds from then on."""
    at = (-5.0 + math.sqrt(25.0 + 40.0 * START)) / 10.0  # of -5 t + 2 (START - 2.5 t^2) = 0
    q = (START - 2.5 * at**2) * math.exp(-2.0 * (time - at))
    return q, -2.0 * q


def dragged(time):
    """(q, v) of the cart under dry friction of 1 N, which a spring of 100 N/m pulls by its end at 0.1 m/s."""
    since = max(time - 0.1, 0.0)
    return START + 0.1 * since - 0.01 * math.sin(10.0 * since), 0.1 - 0.1 * math.cos(10.0 * since)


def filled(time):
    """(q, v) of the cart whose effort is a state with the rate 0.5 cos t, drawn to zero by 1."""
    at = scipy.optimize.brentq(lambda t: 0.3 + 0.5 * math.sin(t) - t, 0.1, 1.0)
    v = 0.3 * at + 0.5 * (1.0 - math.cos(at)) - 0.5 * at**2
    q = 0.15 * at**2 + 0.5 * (at - math.sin(at)) - at**3 / 6.0
    return START + q + v * (time - at), v


SIDE = "((v > 0) - (v < 0))"
# {name: (keys of `cart`, closed form, effort at 2 s)} of motions along a surface whose both sides lead back.
SLIDES = {
    "stops": ({"effort": "-1 if v > 0 else 1", "velocity": 1.0}, lambda t: (START + 0.5, 0.0), 0.0),
    "breaks away": ({"effort": f"t/2 - {SIDE}/2"}, lambda t: (START + (t - 1) ** 3 / 12, (t - 1) ** 2 / 4), 0.5),
    "stays": ({"effort": f"0.3*t - {SIDE}*exp(-v**2)"}, lambda t: (START, 0.0), 0.0),
    "sliding mode": ({"effort": "5 if not v + 2*q > 0 else -5"}, decayed, 4.0 * decayed(2.0)[0]),
    "both": ({"effort": "-5 if v + 2*q > 0 and v < 99 or q > 99 else 5"}, decayed, 4.0 * decayed(2.0)[0]),
    "stick and slip": ({"effort": f"100*(0.3 + 0.1*t - q) - {SIDE}"}, dragged, math.sin(19.0)),
    "not affine": ({"effort": f"0.3 - 3*{SIDE} + {SIDE}**2"}, lambda t: (START, 0.0), 0.0),
    "state": (
        {"effort": "x", "states": {"x": {"rate": "0.5*cos(t) - ((x > 0) - (x < 0))", "start": 0.3}}}, filled, 0.0,
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", SLIDES)
@pytest.mark.parametrize("group", ["auto", "se3"])
@pytest.mark.volume(8)
def test_motions_slide_where_both_sides_lead_back(name, group):
    """To an accuracy, and the effort is that on the surface."""
    law, known, effort = SLIDES[name]
    for accuracy in (1e-4, 1e-9):
        simulation = Simulation(cart(**law), accuracy=accuracy, group=group, quiet=True)
        assert np.abs(np.subtract(end_of(simulation, 2.0), known(2.0))).max() <= accuracy
        assert simulation.largest_error <= accuracy
        assert simulation.sample().law_efforts["rail"] == pytest.approx(effort, abs=accuracy)
        assert simulation._switching.count + simulation._switching.tally.sum() < 10


@pytest.mark.parametrize("method", ["rkmk54", "rkmk853", "radau5"])
@pytest.mark.parametrize("name", SLIDES)
@pytest.mark.volume(8)
def test_methods_keep_their_tolerance_along_surfaces(method, name):
    law, known, _ = SLIDES[name]
    for tolerance in (1e-5, 1e-11):
        settings = {"rtol": tolerance, "atol": tolerance, "estimate": False}
        simulation = Simulation(cart(**law), method, 1 / 64, quiet=True, **settings)
        assert np.abs(np.subtract(end_of(simulation, 2.0), known(2.0))).max() <= 10 * tolerance


def two_carts():
    """At rest s - r/2 = 0 and r - s/2 = 0.3 t / mu for the shares s, r of both signs; r is 1 after 2.5 mu s."""
    scene = scene_from_text(RAIL, "test")
    other, rail = scene.bodies[0].remade(name="other"), scene.joints[0].remade(name="next", child="other")
    law = {
        "type": "law", "name": "own", "inputs": {"v": "rail.velocity", "w": "next.velocity"}, "parameters": {"mu": 1.0},
        "signals": {"s": "(v > 0) - (v < 0)", "r": "1 if w > 0 else -1"},
        "outputs": [
            {"joint": "rail", "effort": "mu*(r/2 - s)"}, {"joint": "next", "effort": "mu*(s/2 - r) + 0.3*t"},
        ],
    }  # fmt: skip
    return scene.remade(bodies=[scene.bodies[0], other], joints=[scene.joints[0], rail], forces=[law])


def test_two_surfaces_share_what_laws_exert():
    simulation = Simulation(two_carts(), accuracy=1e-9, quiet=True)
    simulation.advance_to(1.3)
    assert_allclose(list(simulation.sample().signals.values()), (0.26, 0.52), atol=1e-9)
    simulation.advance_to(4.0)
    found = simulation.sample().joint_coordinates
    assert_allclose((found["rail"], found["next"]), ((0.3, 0.0), (0.3 + 0.05 * 1.5**3, 0.15 * 1.5**2)), atol=1e-9)


def test_a_body_that_turns_slides_along_a_surface_of_the_world():
    """Friction along x stops it after 2 s; y is accelerated by 0.15 m/s^2."""
    text = text_of("ball_in_a_pulse.yaml")
    for group in ("auto", "se3"):
        simulation = Simulation(scene_from_text(text, "test"), accuracy=1e-9, group=group, quiet=True)
        simulation.advance_to(4.0)
        assert_allclose(simulation.sample().pose[0, 9:], (1.0, 1.2, 0.0), atol=1e-9)


@pytest.mark.parametrize("name, size", [("slider_crank", 2.0), ("hinge_chain", 1.0), ("double_pendulum", 6.0)])
@pytest.mark.volume(1)
def test_a_sign_of_a_rate_is_dry_friction(name, size):
    """Against the switch of the joint, to the sum of both estimates."""
    scene = load_scene(name)
    joint = next(each for each in scene.joints if each.type == "revolute")
    joints = [each.remade(friction={"coulomb": size}) if each is joint else each for each in scene.joints]
    law = {
        "type": "law", "name": "own", "inputs": {"w": f"{joint.name}.velocity"}, "parameters": {"size": size},
        "outputs": [{"joint": joint.name, "effort": "size*((w < 0) - (w > 0))"}],
    }  # fmt: skip
    scenes = scene.remade(joints=joints), scene.remade(forces=[*scene.forces, law])
    runs = [Simulation(each, accuracy=1e-8, quiet=True) for each in scenes]
    held = 0
    for time in np.linspace(0.2, 2.6, 7):
        for run in runs:
            run.advance_to(time)
        one, other = (run.sample().joint_coordinates[joint.name] for run in runs)
        assert_allclose(one, other, atol=sum(run.largest_error for run in runs) + 1e-12)  # round-off
        held += one[1] == 0.0
    assert held


@pytest.mark.parametrize("name", SLIDES)
def test_the_reference_slides_in_its_own_way(name):
    """Errors of 1e-13 in each of some 100 steps, most of them where it finds the surface."""
    law, known, _ = SLIDES[name]
    simulation = Simulation(cart(**law), "rkmk4", 0.01, quiet=True)
    (times, _, position, twist), error = integrate(simulation.scene, *simulation.state(), [1.5, 2.0])
    found = position[:, 0, 2], twist[:, 0, 5]
    assert_allclose(np.transpose(found)[1], known(2.0), atol=1e-11)
    assert max(each.max() for each in error) < 1e-11


def test_the_reference_leaves_surfaces_at_shares_and_forces():
    """Two surfaces, of which one is left; a push of 2 N against friction of 1 N, which stops the cart again."""
    simulation = Simulation(two_carts(), "rkmk4", 0.01, quiet=True)
    found = integrate(simulation.scene, *simulation.state(), [4.0])[0].position[0, :, 2]
    assert_allclose(found, (0.3, 0.3 + 0.05 * 1.5**3), atol=1e-11)
    simulation = Simulation(cart(f"-{SIDE}"), "rkmk4", 0.01, quiet=True)
    push = WrenchSpan(0.5, 1.0, "cart", (0.0, 0.0, 0.0, 0.0, 0.0, 2.0))
    found = integrate(simulation.scene, *simulation.state(), [0.5, 1.0, 1.5, 3.0], [push])[0].position[:, 0, 2]
    assert_allclose(found - START, (0.0, 0.125, 0.25, 0.25), atol=1e-11)


def at_2_s(name):
    simulation = Simulation(cart(**SLIDES[name][0]), accuracy=1e-9, quiet=True)
    simulation.advance_to(2.0)
    return simulation


@pytest.mark.parametrize("name, states, A", [
    ("stops", ["rail"], [[0.0]]), ("sliding mode", ["rail"], [[-2.0]]), ("not affine", ["rail"], [[0.0]]),
    ("state", ["rail", "rail.rate"], [[0.0, 1.0], [0.0, 0.0]]),
])  # fmt: skip
def test_a_motion_on_a_surface_has_a_state_less(name, states, A):
    """v = 0, v = -2 q, or x = 0; the rest is linear, and what is 1.5 s later follows."""
    simulation = at_2_s(name)
    found = linearise(simulation)
    assert list(found.states) == states
    assert_allclose(found.A, A, atol=1e-12)
    assert_allclose(transition(simulation, 1.5).phi, scipy.linalg.expm(1.5 * np.array(A)), atol=1e-9)


def test_outputs_and_inputs_of_a_motion_on_a_surface():
    """v = -2 q needs the effort 4 q, whatever another one is."""
    found = linearise(at_2_s("sliding mode"), ["rail.effort"], ["rail.velocity", "rail.power", "own.power"])
    assert_allclose(found.B, 0.0, atol=1e-12)
    assert_allclose(found.C[0], -2.0, atol=1e-12)


@pytest.mark.parametrize("name, other", [("stops", "rail"), ("breaks away", None)])
def test_a_run_whose_states_on_surfaces_change_has_no_transition(name, other):
    simulation = Simulation(cart(**SLIDES[name][0]), accuracy=1e-9, quiet=True)
    simulation.advance_to(0.5)
    with pytest.raises(SimulationError, match="laws hold other joints at the end"):
        transition(simulation, 1.2)


@pytest.mark.parametrize(
    "function", [trim, lambda simulation: inverse_dynamics(simulation, *np.zeros((4, 1)), ["rail"])]
)
def test_what_needs_a_state_beside_surfaces_says_so(function):
    with pytest.raises(SimulationError, match="slides along a comparison of the law own at t = 2 s"):
        function(at_2_s("stops"))


@pytest.mark.parametrize("options", [{"accuracy": 1e-6}, {"method": "rkmk4", "step": 1e-3}])
@pytest.mark.parametrize("push", [0.0, 0.5])
@pytest.mark.parametrize("side", ["(1 if v > 0 else -1)", "((v > 0) - (v < 0))"])
def test_a_cart_that_starts_at_rest_on_dry_friction_is_held(side, push, options):
    """Also if nothing pushes it: where a neighbour goes is seen from the sides of the surface."""
    simulation = Simulation(cart(f"{push} - 2*{side}"), quiet=True, **options)
    assert_allclose(linearise(simulation).A, [[0.0]], atol=1e-12)
    with pytest.raises(SimulationError, match="slides along a comparison of the law own at t = 0 s"):
        trim(simulation)


@pytest.mark.parametrize("effort, way", [("1 + (2 if v > 0 else -2)", -1.0), ("1 - (2 if v < 0 else -2)", 3.0)])
def test_a_cart_between_sides_that_lead_away_is_not_held(effort, way):
    """It takes the side that holds at zero."""
    simulation = Simulation(cart(effort), accuracy=1e-6, quiet=True)
    assert len(linearise(simulation).A) == 2
    assert_allclose(end_of(simulation, 1.0), (START + 0.5 * way, way), atol=1e-9)


def test_a_cart_that_is_set_beside_its_surface_slides_no_more():
    simulation = at_2_s("stops")
    simulation.place(joints={"rail": (0.0, 1.0)})
    assert simulation.sample().law_efforts["rail"] == -1.0
    assert_allclose(end_of(simulation, 2.5), (0.375, 0.5), atol=1e-9)


def mode(c, time):
    """(q, v) of the cart that 5 N drive to v = -c q."""
    at = (-5.0 + (25.0 + 10.0 * c * c * START) ** 0.5) / (5.0 * c)
    q = (START - 2.5 * at**2) * np.exp(-c * (time - at))
    return q, -c * q


# {name: (law, number, times, derivatives of (q, v) by it)}, complex steps of closed forms among them.
DERIVATIVES = {
    # v = 1 - mu t, and q = 0.3 + 1 / (2 mu) from 1 / mu on
    "stops": ({"effort": "-mu*(1 if v > 0 else -1)", "velocity": 1.0}, 1.25, lambda p, t:
              (-0.5 * t * t, -t) if t < 0.8 else (-0.5 / p**2, 0.0)),
    # leaves at t = 2 mu
    "breaks away": ({"effort": f"t/2 - mu*{SIDE}"}, 0.4, lambda p, t:
                    (0.0, 0.0) if t < 0.8 else (-0.5 * (t - 2.0 * p) ** 2, 2.0 * p - t)),
    "surface": ({"effort": "5 if not v + mu*q > 0 else -5"}, 2.0, lambda p, t: np.imag(mode(p + 1e-30j, t)) / 1e-30),
}  # fmt: skip


@pytest.mark.parametrize("name", DERIVATIVES)
def test_sensitivities_pass_motions_on_surfaces(name):
    law, value, known = DERIVATIVES[name]
    scene, times = cart(**law, parameters={"mu": value}), [0.5, 1.1, 2.0]
    found = sensitivities(scene, ["own.parameters.mu"], times, ["rail.position", "rail.velocity"])
    assert_allclose(found.derivatives[:, :, 0], [known(value, time) for time in times], atol=1e-9)
    assert found.errors.max() < 1e-9 and not found.rough


def test_sensitivities_by_a_start_that_a_surface_takes_back():
    """The cart at rest under friction of 0.5 N comes to rest at once if it moves."""
    names = ["cart.linear_velocity.2", "cart.position.2"]
    found = sensitivities(cart(f"t/2 - {SIDE}/2"), names, [0.5, 2.0], ["cart.z"])
    assert_allclose(found.derivatives[:, 0], [[0.0, 1.0], [0.0, 1.0]], atol=1e-9)
    assert found.errors.max() < 1e-9 and not found.rough


def test_sensitivities_of_two_surfaces():
    """One is left at 2.5 mu, and the cart then has w' = 0.3 (t - 2.5 mu)."""
    found = sensitivities(two_carts(), ["own.parameters.mu"], [2.0, 4.0], ["rail.position", "next.position"])
    assert_allclose(found.derivatives[:, :, 0], [[0.0, 0.0], [0.0, -0.375 * 1.5**2]], atol=1e-9)


def braked(efforts, step, friction):
    """(k + 1, 2) q and v of the cart at rest, under dry friction and efforts (k,) N of one step each, in s."""
    q, v, found = START, 0.0, [(START, 0.0)]
    for effort in efforts:
        left = step
        while left > 0.0:
            side = np.sign(v) if v else np.sign(effort) * (abs(effort) > friction)
            a = (effort - friction * side) * (side != 0.0)
            end = min(left, -v / a) if v * a < 0.0 else left
            q, v, left = q + v * end + 0.5 * a * end**2, v + a * end if end == left else 0.0, left - end
        found.append((q, v))
    return np.array(found)


def test_friction_of_a_law_is_identified_where_it_holds_the_cart():
    """Of 0.7 N, from a log in which the cart rests four times; the interval of four deviations covers it.

    If the law were not known to hold, the deviation would be four times too small and the value outside.
    """
    step = 0.01
    t = step * np.arange(300)
    efforts = 1.2 * np.sin(1.6 * np.pi * t) + 0.3 * np.sin(9.0 * t)
    true, noise = braked(efforts, step, 0.7), np.array([1e-4, 1e-3])
    assert (true[:, 1] == 0.0).mean() > 0.1
    values = true + np.random.default_rng(1).normal(0.0, noise, true.shape)
    outputs = "rail.position", "rail.velocity"
    log = Log((Given("rail.effort", t, efforts),), (Measured("m", np.append(t, 3.0), outputs, values, noise, 0.0),))
    scene = cart("-mu*(1 if v > 0 else -1)", parameters={"mu": 0.5})
    found = identify(scene, log, ["own.parameters.mu"], workers=1)
    assert found.comparison.agrees and abs(found.values[0] - 0.7) < 4.0 * found.deviations[0] < 1e-3


def test_a_state_that_is_set_finds_its_branch():
    simulation = Simulation(cart(**KINKS["if"][0]), "rkmk4", 0.01, quiet=True)
    simulation.place(joints={"rail": (-0.2, 0.0)})
    q, v = end_of(simulation, 0.1)
    assert_allclose((q, v), (-0.2 * math.cos(0.5), math.sin(0.5)), atol=1e-6)


def test_sensitivities_jump_with_the_slope_at_an_event():
    """d q / d F of the parabolas: q(t) = q0 s(F t) with arcs of F, against differences of the closed form."""

    def known(force, time=1.7):
        # A force F for the time t is a force of 1 N for sqrt(F) t.
        return parabolas(math.sqrt(force) * time)[0]

    scene = cart("-F if q > 0 else F", parameters={"F": 1.3})
    found = sensitivities(scene, ["own.parameters.F"], [1.7], ["rail.position"])
    slope = (known(1.3 + 1e-5) - known(1.3 - 1e-5)) / 2e-5  # round-off 1e-11
    assert found.derivatives.item() == pytest.approx(slope, abs=1e-9)
    assert found.errors.item() < 1e-9


def test_sensitivities_of_states_pass_events():
    """d v and d x of v' = min(x, c), x' = -k x, whose branch changes at x = c."""
    x0, k, c, time = 0.8, 1.5, 0.5, 1.2
    law = {"effort": "min(x, c)", "states": {"x": {"rate": "-k*x", "start": x0}}, "parameters": {"k": k, "c": c}}
    names = ["own.states.x.start", "own.parameters.k", "own.parameters.c"]
    found = sensitivities(cart(**law), names, [time], ["rail.velocity", "own.x"])
    at, left = math.log(x0 / c) / k, math.exp(-k * time)
    by_k = -c * at / k - (c - x0 * left) / k**2 + x0 * time * left / k
    known = [[c / (k * x0) - left / k, by_k, at], [left, -x0 * time * left, 0.0]]
    assert_allclose(found.derivatives[0], known, atol=1e-9)
    assert found.errors.max() < 1e-9


def test_steps_of_equal_size_that_are_located_miss_no_contact():
    """Two balls exchange their speeds in half a period of their spring, with the order of the method through both ends.

    A law that can slide lets the steps be located. They are longer than those with error control near a contact.
    """

    class Locating(Engine):
        LOCATES = True

    rate, speed = math.pi / 0.16, 2.6
    balls = f"""
  - {{name: a, shape: {{type: sphere, radius: 0.1, mass: 1}}, position: [0, 5, 0], linear_velocity: [{speed}, 0, 0]}}
  - {{name: b, shape: {{type: sphere, radius: 0.1, mass: 1}}, position: [1, 5, 0]}}
joints:"""
    forces = f"""forces:
  - {{name: own, type: law, inputs: {{v: rail.velocity}}, outputs: [{{joint: rail, effort: 2 - (v > 0)}}]}}
  - {{name: hit, type: contact, body: a, other: b, stiffness: {0.5 * rate**2}, damping: 0}}
"""
    scene = scene_from_text(RAIL.replace("\njoints:", balls) + forces, "test")
    steps, errors = (0.04, 0.02, 0.01), []
    for step in steps:
        engine = Locating(scene, "rkmk4", step, "auto", "none", quiet=True)
        engine.advance(round(1.0 / step))
        errors.append(np.abs(engine.sample().twist[1:, 3] - (0.0, speed)).max())
    assert 4.0 < fitted_order(steps, errors) < 6.0
    assert errors[-1] < 1e-5


@pytest.mark.parametrize(("effort", "work"), cases("a_force_in_a_window_that_a_step_flies_through_is_seen"))
def test_a_force_in_a_window_that_a_step_flies_through_is_seen(effort, work):
    """No change has an effect at the end of the step, and no stage is in the window: v^2 = 1 + 2 W for the work W.

    To a thousandth of the accuracy, since both ends of the window are located. The reference to its uncertainty.
    """
    tables = {"bump": {"x": [0.4, 0.8, 0.805, 0.81, 5.0], "y": [0, 0, 3, 0, 0]}} if "bump" in effort else {}
    scene, exact = cart(effort, velocity=1.0, tables=tables), math.sqrt(1.0 + 2.0 * work)
    for accuracy in (1e-3, 1e-6):
        simulation = Simulation(scene, accuracy=accuracy, quiet=True)
        assert abs(end_of(simulation, 1.0)[1] - exact) < 1e-3 * accuracy
    found, uncertainty = integrate(scene, *initial_state(at_centres_of_mass(scene)), np.array([1.0]))
    assert abs(found.twist[0, 0, 5] - exact) < uncertainty.linear[0, 0] < 1e-8


@pytest.mark.turn(3)
def test_many_branches_may_change_in_a_step_each_up_to_a_thousand_times():
    """1034 kinks of two terms in a step of 1 s: the speed is the integral of |sin w t|, 2 / w for each half wave."""
    rates = 1600.0, 1650.0
    simulation = Simulation(cart(" + ".join(f"abs(sin({w}*t))" for w in rates)), accuracy=1e-6, step=1.0, quiet=True)
    simulation.advance(1)
    halves = [divmod(w, math.pi) for w in rates]
    speed = sum((2.0 * whole + 1.0 - math.cos(rest)) / w for (whole, rest), w in zip(halves, rates))
    assert simulation.sample().joint_coordinates["rail"][1] == pytest.approx(speed, abs=1e-9)
