# SPDX-License-Identifier: Apache-2.0
"""Kinks and jumps of laws are events: methods keep their order through them. Closed forms of a cart on a rail."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from liegroup_core import Simulation
from liegroup_core.forces.formulas import OPEN
from liegroup_core.linear import sensitivities
from liegroup_core.scene.load import scene_from_text

START = 0.3  # m, of the cart of 1 kg: its acceleration is the effort
RAIL = """
name: rail
gravity: [0, 0, 0]
bodies:
  - {name: cart, mass: 1, inertia: [0.1, 0.1, 0.1], position: [0, 0, 0.3]}
joints:
  - {name: rail, type: prismatic, parent: world, child: cart, parent_frame: {}, child_frame: {}}
"""


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
    # Beyond its end this branch has no value: a root of a negative number.
    "root": ({"effort": "-9*sqrt(q)*sqrt(q) if q > 0 else -25*q"}, springs),
}


@pytest.mark.parametrize("name", KINKS)
@pytest.mark.parametrize("method", ["rkmk54", "rkmk853", "radau5"])
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


def test_where_both_sides_of_a_jump_lead_back_the_branch_is_open():
    """A sign of the rate as friction: it stops after 1 s, and stays there within the accuracy."""
    simulation = Simulation(cart("-1 if v > 0 else 1", velocity=1.0), accuracy=1e-3, quiet=True)
    assert np.abs(np.subtract(end_of(simulation, 1.01), (START + 0.5, 0.0))).max() <= 1e-3
    assert simulation._integrator.mechanism[1].branches[0] == OPEN


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
