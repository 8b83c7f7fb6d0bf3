# SPDX-License-Identifier: Apache-2.0
"""Sensitivities of runs against closed forms: smooth motions, and motions with impacts."""

import numpy as np
import pytest
import random_mechanisms
import scipy
from scene_files import filled, text_of

from liegroup_core import Simulation
from liegroup_core.errors import LieGroupSimError
from liegroup_core.linear import Misfit, sensitivities
from liegroup_core.linear.channels import OutputChannels
from liegroup_core.linear.probe import Probe
from liegroup_core.scene.load import load_scene, scene_as_written, scene_from_text
from liegroup_core.scene.parameters import changed, parameters

TIMES = [0.4, 1.0, 1.7]


def test_derivatives_of_a_throw():
    """x = v t, z = v_z t + g t^2 / 2."""
    scene = scene_from_text(
        "name: throw\ngravity: [0, 0, -9.81]\nbodies: [{name: b, mass: 2.0, inertia: [1, 2, 3], "
        "linear_velocity: [1, 0, 4]}]\n",
        source="t",
    )
    told = []
    found = sensitivities(scene, ["gravity.2", "linear_velocity.0", "mass"], TIMES, ["b.x", "b.z"], told.append)
    assert told[-1] == "derivatives, 1.7 of 1.7 s"
    t = np.array(TIMES)
    assert found.parameters == ("gravity.2", "bodies.b.linear_velocity.0", "bodies.b.mass")
    np.testing.assert_allclose(found.values, np.stack([t, 4 * t - 0.5 * 9.81 * t**2], 1), rtol=1e-12)
    np.testing.assert_allclose(found.derivatives[:, 1, 0], 0.5 * t**2, rtol=1e-9)
    np.testing.assert_allclose(found.derivatives[:, 0, 1], t, rtol=1e-9)
    assert np.abs(found.derivatives[:, :, 2]).max() < 1e-9 and not found.rough


def test_derivatives_of_a_rotor():
    """omega = (tau / d) (1 - exp(-d t / I)) with damping d: by tau, d and I."""
    tau, d, inertia = 2.0, 0.7, 0.4
    scene = scene_from_text(filled(text_of("rotor_damped.yaml"), inertia=inertia, tau=tau, d=d), source="t")
    found = sensitivities(scene, ["motor.torque", "bearing.damping", "wheel.inertia.2"], TIMES, ["axle.velocity"])
    t = np.array(TIMES)
    e = np.exp(-d * t / inertia)
    expected = [(1 - e) / d, -tau / d**2 * (1 - e) + tau / d * t / inertia * e, -tau / d * e * d * t / inertia**2]
    error = np.abs(found.derivatives[:, 0] - np.array(expected).T)
    assert (error <= 1e-8 * np.abs(expected).max()).all() and (error <= found.errors[:, 0] + 1e-12).all()


def test_the_time_of_an_impact_is_part_of_the_derivative():
    """A slide hits a stop at L with restitution e and goes back: x = L - e v t + e L after v t = L."""
    v, L, e = 2.0, 0.5, 0.6
    scene = scene_from_text(filled(text_of("slide_and_back.yaml"), v=v, l=L, e=e), source="t")
    found = sensitivities(
        scene, ["car.linear_velocity.2", "rail.limits.upper", "rail.limits.restitution"], TIMES, ["rail.position"]
    )
    t = np.array(TIMES)
    expected = np.stack([-e * t, np.full(3, 1.0 + e), L - v * t], axis=1)
    np.testing.assert_allclose(found.derivatives[:, 0], expected, rtol=1e-7)
    assert not found.rough


def test_a_run_that_just_meets_a_stop_is_said_to_be_rough():
    scene = scene_from_text(text_of("slide_to_stop.yaml"), source="t")
    assert sensitivities(scene, ["car.linear_velocity.2"], [0.5], ["rail.position"]).rough


def test_angles_that_pass_half_a_turn_have_no_jump():
    """A rotor at pi at the time of the output, on different sides for both changes."""
    scene = scene_from_text(
        "name: r\ngravity: [0, 0, 0]\nbodies: [{name: w, mass: 1.0, inertia: [1, 1, 1], "
        f"angular_velocity: [0, 0, {np.pi}]}}]\njoints: [{{name: a, type: revolute, parent: world, child: w, "
        "child_frame: {}}]\n",
        source="t",
    )
    found = sensitivities(scene, ["angular_velocity.2"], [1.0], ["a.position"])
    assert found.derivatives[0, 0, 0] == pytest.approx(1.0, rel=1e-8)


@pytest.mark.turn(3)
def test_the_errors_of_long_runs_hold():
    """x = cos(w t) with w^2 = k / m, many periods: by the mass and the stiffness."""
    scene = scene_from_text(text_of("oscillator_sensitivities.yaml"), source="t")
    t = np.array([1.0, 8.0, 40.0])
    found = sensitivities(scene, ["spring.stiffness", "car.mass"], t, ["rail.position"])
    expected = np.stack([-np.sin(10.0 * t) * t / 20.0, np.sin(10.0 * t) * t * 5.0], axis=1)
    error = np.abs(found.derivatives[:, 0] - expected)
    assert (error <= found.errors[:, 0]).all() and (error <= 1e-7 * np.abs(expected).max(axis=1)[:, None]).all()


def differences(scene, path, times, outputs, h=1e-3):
    """Central differences of order four between runs at tolerances of 1e-12: errors near h^4 and 1e-12 / h."""
    written = scene_as_written(scene.text, scene.source)
    value = parameters(written)[path]

    def values(step):
        other = scene_from_text(changed(written, {path: value + step * h * abs(value)}).text, source=scene.source)
        run = Simulation(other, "rkmk853", 1e-2, rtol=1e-12, atol=1e-12, estimate=False, quiet=True)
        seen = OutputChannels(Probe(run), outputs)
        return np.array([seen.of(sample) for sample in run.samples(times)])

    near, far = values(1) - values(-1), values(2) - values(-2)
    return (near * (2.0 / 3.0) - far / 12.0) / (h * abs(value))


@pytest.mark.parametrize(
    "name, number, times, outputs",
    [
        ("four_bar", "joints.ground_rocker.parent_frame.position.0", [0.2, 0.5], "joints"),
        ("four_bar", "bodies.crank.shape.size.0", [0.2, 0.5], "twists"),
        ("slider_crank", "gravity.2", [0.3, 0.5], "accelerations"),
        # Impacts at 0.8 s, 2.4 s and 7.1 s; friction reverses at 4.7 s.
        ("door", "joints.hinges.friction.coulomb", [0.5, 2.0, 8.0], "joints"),
        ("door", "joints.hinges.limits.restitution", [0.5, 2.0, 8.0], "joints"),
        ("door", "joints.hinges.limits.upper", [0.5, 2.0, 8.0], "joints"),
        ("stick_slip", "forces.spring.stiffness", [1.0, 1.6, 2.5], "joints"),
        ("bicycle", "gravity.2", [0.1, 0.2], "bodies"),
    ],
)
@pytest.mark.volume(2)
def test_the_derivatives_are_those_of_neighbouring_runs(name, number, times, outputs):
    scene = load_scene(name)
    found, expected = sensitivities(scene, [number], times, [outputs]), differences(scene, number, times, [outputs])
    error, size = np.abs(found.derivatives[:, :, 0] - expected), np.abs(expected).max()
    assert not found.rough and error.max() < 1e-7 * max(size, 1e-3)


@pytest.mark.parametrize("name", ["mass ratios", "loops", "planar loops", "couplings", "driven"])
@pytest.mark.volume(1)
def test_the_derivatives_of_random_mechanisms_are_those_of_neighbouring_runs(name):
    scene, _ = random_mechanisms.random_mechanism(name, 5)
    known = parameters(scene_as_written(scene.text, scene.source))
    forces = [path for path, value in known.items() if path.startswith("forces.") and value]
    for number in ("bodies.b1.mass", forces[0], forces[-1]):
        found = sensitivities(scene, [number], [0.04, 0.1], ["twists"])
        expected = differences(scene, number, [0.04, 0.1], ["twists"])
        error = np.abs(found.derivatives[:, :, 0] - expected).max()
        assert error < 1e-7 * max(np.abs(expected).max(), 1e-2)


def test_numbers_that_change_the_times_of_inputs_have_differences_of_runs():
    """A force F that acts for a time d: v = F d / m at its end."""
    scene = scene_from_text(
        "name: push\ngravity: [0, 0, 0]\nbodies: [{name: b, mass: 2.0, inertia: [1, 1, 1]}]\n"
        "forces: [{name: push, type: applied_wrench, body: b, force: [3, 0, 0], start: 0.1, end: 0.5}]\n",
        source="t",
    )
    found = sensitivities(scene, ["push.end", "push.force.0"], [1.0], ["b.vx"])
    np.testing.assert_allclose(found.derivatives[0, 0], [1.5, 0.2], rtol=1e-7)


SLIDERS = text_of("sliders.yaml")


def test_a_start_velocity_that_friction_takes_away_changes_nothing():
    """a rests, and comes to rest at once if it moves; b slides on it without friction."""
    scene = scene_from_text(SLIDERS.replace("PUSH", "1"), source="t")
    found = sensitivities(scene, ["a.linear_velocity.0"], [0.5, 1.0], ["a.x", "b.x", "b.vx"])
    assert np.abs(found.derivatives).max() < 1e-8 and (np.abs(found.derivatives) <= found.errors + 1e-12).all()


@pytest.mark.parametrize("number, times", [("a.linear_velocity.0", [0.5]), ("push.end", [0.8])])
def test_a_number_with_another_slope_on_either_side_has_no_derivative(number, times):
    """From rest a starts to slide; a velocity against the push is braked first. v = 2 t ends at the end of the push."""
    scene = scene_from_text(SLIDERS.replace("PUSH", "4"), source="t")
    found = sensitivities(scene, [number], times, ["ja.velocity"])
    assert found.rough and np.isnan(found.derivatives).all()


@pytest.mark.turn(3)
def test_undetermined_outputs_leave_the_others_their_errors():
    """A planar four-bar has redundant rows: reactions normal to its plane are undetermined."""
    found = sensitivities(load_scene("four_bar"), ["crank.shape.mass"], [0.1], ["ground_crank.force_z", "crank.rz"])
    assert np.isnan(found.derivatives[0, 0, 0]) and not found.rough
    assert np.isfinite(found.derivatives[0, 1, 0]) and found.errors[0, 1, 0] < 1e-9


@pytest.mark.turn(3)
def test_errors_do_not_grow_where_friction_makes_differences_small():
    """The block sticks, slides and sticks again: at rest on the belt its place does not depend on the spring."""
    found = sensitivities(load_scene("stick_slip"), ["spring.rest_length"], [3.3, 5.0], ["block.x"])
    expected = differences(load_scene("stick_slip"), "forces.spring.rest_length", [3.3, 5.0], ["block.x"], 1e-4)
    assert np.abs(found.derivatives[:, :, 0] - expected).max() < 1e-6 and found.errors.max() < 1e-6


def test_unknown_numbers_are_refused():
    with pytest.raises(LieGroupSimError, match="the scene has no parameter masss"):
        sensitivities(load_scene("heavy_top"), ["masss"], [1.0])


@pytest.mark.parametrize("gaps", [False, True])
@pytest.mark.volume(1)
def test_numbers_of_a_scene_are_found_from_measurements(gaps):
    """Torque and damping of a rotor, from its angle (modulo 2 pi) and rate in closed form."""
    tau, d, inertia = 2.0, 0.7, 0.4
    text = text_of("rotor_with_motor.yaml")
    t = np.linspace(0.2, 3.0, 8)
    e = np.exp(-d * t / inertia)
    measured = np.stack([tau / d * (t - inertia / d * (1 - e)), tau / d * (1 - e)], 1)
    measured[:, 0] = np.angle(np.exp(1j * measured[:, 0]))
    if gaps:
        measured[::2, 0] = measured[1::3, 1] = np.nan
    names, outputs = ["motor.torque", "bearing.damping"], ["axle.position", "axle.velocity"]
    misfit = Misfit(scene_from_text(text, "t"), names, t, measured, outputs, [0.01, 0.1])
    found = scipy.optimize.least_squares(misfit.residuals, misfit.start, misfit.jacobian, xtol=1e-12, ftol=1e-14)
    assert misfit.start.tolist() == [1.7, 0.9] and np.abs(found.x - [tau, d]).max() < 1e-8
    cost, gradient = misfit.cost(misfit.start)
    near = [misfit.cost(misfit.start + h)[0] for h in ([1e-4, 0], [-1e-4, 0], [0, 1e-4], [0, -1e-4])]
    slopes = np.subtract(near[::2], near[1::2]) / 2e-4  # a central difference: 1e-8 of the third derivative
    assert cost > 1.0 and np.abs(gradient - slopes).max() < 1e-5 * np.abs(gradient).max()


def test_a_simulation_has_the_sensitivities_of_its_run():
    simulation, text = Simulation(load_scene("double_pendulum"), "rkmk8", 1e-2, estimate=False), "bodies.upper.mass"
    simulation.advance(3)
    found = simulation.sensitivities([text], [0.3], ["elbow.position"])
    expected = sensitivities(simulation.scene, [text], [0.3], ["elbow.position"])
    assert found.derivatives[0, 0, 0] == pytest.approx(expected.derivatives[0, 0, 0], rel=1e-6)
    assert simulation.steps == 3
