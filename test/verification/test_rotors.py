# SPDX-License-Identifier: Apache-2.0
"""Rotors of joints: closed forms, a real flywheel behind a gear, the reference integration, energy, reactions."""

import numpy as np
import pytest
from scene_files import cases, filled, text_of
from scipy.integrate import solve_ivp

from liegroup_core import SceneError, Simulation
from liegroup_core.engine import Engine
from liegroup_core.methods.table import METHODS
from liegroup_core.reference import integrate
from liegroup_core.scene.load import scene_from_text

# In space, and planar where the axes are parallel or in the plane.
ARM = text_of("arm_rotors.yaml")
# {name: (tilt of the first axis, type, axis, more keys)} of the second joint
SCENES = cases("rotors_scenes")
ON_JOINTS = [name for name, method in METHODS.items() if method.family != "rotation"]


def made(name):
    tilt, kind, axis, more = SCENES[name]
    return scene_from_text(filled(ARM, tilt=tilt, kind=kind, axis=axis, more=more))


@pytest.mark.parametrize("name", SCENES)
def test_the_reference_which_has_a_dense_mass_matrix_agrees_and_energy_is_kept(name):
    """rkmk8 at 1 ms for 0.5 s: round-off of 500 steps, some 1e-13; the reference has a tolerance of 1e-13."""
    scene = made(name)
    simulation = Simulation(scene, "rkmk8", 1e-3, estimate=False)
    start, energy = simulation.state(), simulation.energy()
    exact, uncertainty = integrate(scene, *start, [0.0, 0.5])
    simulation.advance(500)
    sample = simulation.sample()
    assert uncertainty.position.max() < 1e-11
    assert np.abs(sample.pose[:, 9:] - exact.position[-1]).max() < 1e-11
    assert np.abs(sample.twist - exact.twist[-1]).max() < 1e-10
    assert abs(sample.energy - energy) < 1e-12
    plain = Simulation(scene.remade(joints=[joint.remade(rotor=None) for joint in scene.joints]), "rkmk8", 1e-3)
    plain.advance(500)
    assert np.abs(plain.sample().pose - sample.pose).max() > 0.1  # the rotors matter


@pytest.mark.parametrize("method", ON_JOINTS)
def test_every_method_converges_to_that_motion_with_its_order(method):
    """Errors after 0.2 s with two steps; the slope, where they are above round-off."""
    scene, steps = made("hinges in space"), (8e-3, 4e-3)
    truth = Simulation(scene, "rkmk853", 1e-3, estimate=False, rtol=1e-13, atol=1e-13)
    truth.advance(200)
    errors = []
    for step in steps:
        options = {"rtol": 1e-9, "atol": 1e-9} if METHODS[method].controlled else {}
        simulation = Simulation(scene, method, step, estimate=False, **options)
        simulation.advance(round(0.2 / step))
        errors.append(np.abs(simulation.sample().pose - truth.sample().pose).max())
    if METHODS[method].controlled:
        assert max(errors) < 1e-7
    elif errors[1] > 1e-12:
        assert np.log2(errors[0] / errors[1]) > METHODS[method].order - 0.4, errors


FLYWHEEL = text_of("flywheel.yaml")


@pytest.mark.parametrize("kind, axis", [("revolute", [0, 1, 0]), ("prismatic", [0.3, 0, 1])])
def test_a_rotor_is_a_flywheel_behind_a_gear(kind, axis):
    """A wheel that a coupling with ratio 12 turns, beside a rotor with its inertia; 0.5 s, round-off of 500 steps."""
    rotor = ", rotor: {inertia: 3.0e-3, ratio: 12}"
    coupling = "couplings: [{name: gear, joint: shaft, other: hinge, ratio: 12}]"
    geared = scene_from_text(filled(FLYWHEEL, kind=kind, axis=axis, rotor="", coupling=coupling))
    reflected = scene_from_text(filled(FLYWHEEL, kind=kind, axis=axis, rotor=rotor, coupling=""))
    found = []
    for scene in (geared, reflected):
        simulation = Simulation(scene, "rkmk8", 1e-3, estimate=False)
        simulation.apply_effort("hinge", 3.0, 0.1, 0.3)
        simulation.advance(500)
        found.append(simulation.sample())
    assert found[0].joint_coordinates["hinge"] == pytest.approx(found[1].joint_coordinates["hinge"], abs=1e-12)
    assert abs(found[0].joint_coordinates["hinge"][0]) > 0.05


@pytest.mark.parametrize("method", ON_JOINTS)
def test_a_hinge_at_rest_accelerates_by_torque_over_inertia(method):
    """tau / (I + c^2 I_r) for 0.1 s from rest about a principal axis: the angle is alpha t^2 / 2."""
    text = text_of("disc_rotors.yaml")
    simulation = Simulation(scene_from_text(text), method, 1e-3, estimate=False)
    simulation.apply_effort("hinge", 1.5)
    simulation.advance(100)
    alpha = 1.5 / (0.2 + 100**2 * 2.0e-5)
    angle, rate = simulation.sample().joint_coordinates["hinge"]
    assert rate == pytest.approx(alpha * 0.1, abs=1e-12)
    # Euler's method keeps the rate of the start of each step.
    assert angle == pytest.approx(alpha * (0.005 - (0.5e-4 if METHODS[method].order == 1 else 0.0)), abs=1e-12)
    assert simulation.energy() == pytest.approx(0.5 * 0.4 * (alpha * 0.1) ** 2, rel=1e-12)
    # The rotor's torque on the disc is part of what the joint transmits: of 1.5 N m half accelerate the rotor.
    assert simulation.sample().reactions["hinge"][2] == pytest.approx(-0.75, abs=1e-12)
    assert simulation.sample().transmitted["hinge"][2] == pytest.approx(0.75, abs=1e-12)


def test_a_driven_joint_needs_the_effort_of_its_rotor_too():
    text = filled(ARM, tilt=0, kind="revolute", axis=[0, 1, 0], more="").replace(
        "ratio: 50}", "ratio: 50}, driven: true"
    )
    simulation = Simulation(scene_from_text(text), "rkmk4", 1e-3, estimate=False)
    simulation.command_motion("j1", [0.5], [0.4], [0.0], start=0.0)
    simulation.advance(100)
    plain = scene_from_text(text.replace("rotor: {inertia: 1.0e-4, ratio: 50}, driven", "driven"))
    other = Simulation(plain, "rkmk4", 1e-3, estimate=False)
    other.command_motion("j1", [0.5], [0.4], [0.0], start=0.0)
    other.advance(100)
    more = simulation.sample().drive_efforts["j1"] - other.sample().drive_efforts["j1"]
    assert more == pytest.approx(0.25 * simulation.sample().prescribed["j1"][2], rel=1e-9)


HELD = text_of("held.yaml")


@pytest.mark.parametrize("space", ["auto", "space"])
def test_friction_holds_a_link_beneath_a_rotor_until_its_torque_is_too_large(space):
    """b swings like a pendulum with the rotor's inertia, and a breaks away; the times are accurate to 1e-11 s."""
    g, length, mass, inertia, pivot = 9.81, 0.3, 1.0, 0.03, 0.5

    def swing(_, state):
        angle, rate = state
        return [rate, mass * g * length * np.cos(angle) / (inertia + mass * length**2 + 40**2 * 2.0e-4)]

    def breaks_away(t, state):
        (angle, rate), (_, a) = state, swing(t, state)
        c, s = length * np.cos(angle), length * np.sin(angle)
        momentum = inertia * a + mass * (-s * (-s * a - c * rate**2) - (pivot + c) * (-c * a + s * rate**2))
        return momentum - g * (2.0 * 0.3 + mass * (pivot + c)) + 13.0

    breaks_away.terminal = True
    found = solve_ivp(swing, (0.0, 1.0), [0.0, 0.0], "DOP853", rtol=1e-13, atol=1e-13, events=breaks_away)
    engine = Engine(scene_from_text(HELD), "rkmk8", 1e-3, space=space)
    engine.advance(600)
    event = engine.drain_events()[0]
    assert (event.joint, event.kind) == ("j1", "slip")
    assert event.time == pytest.approx(found.t_events[0][0], abs=1e-10)


FOUR_BAR = text_of("four_bar_of_hinges.yaml")


def test_where_a_rotor_is_not_possible_one_line_says_so():
    with pytest.raises(SceneError, match="a rotor needs a joint with one coordinate.*this one is spherical"):
        scene_from_text(filled(ARM, tilt=0, kind="spherical", axis=[0, 1, 0], more=""))
    scene = made("hinges in space")
    with pytest.raises(ValueError, match="its joints have rotors"):
        Simulation(scene, "rkmk4", group="se3")
    four_bar = scene_from_text(FOUR_BAR)
    joints = [joint.remade(rotor={"inertia": 1e-3}) for joint in four_bar.joints]
    with pytest.raises(SceneError, match="it has a rotor, but closes a loop of joints with rotors"):
        Simulation(four_bar.remade(joints=joints), "rkmk4")
    # All but one: the loop is cut at the other joint.
    for k in range(len(joints)):
        some = [four_bar.joints[j] if j == k else joints[j] for j in range(len(joints))]
        simulation = Simulation(four_bar.remade(joints=some), "rkmk8", 1e-3, estimate=False)
        energy = simulation.energy()
        simulation.advance(200)
        assert simulation.energy() == pytest.approx(energy, rel=1e-11)
