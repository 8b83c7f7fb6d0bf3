# SPDX-License-Identifier: Apache-2.0
"""Simulations to an accuracy: promised against true errors, through pushes, and bit-identical repeats."""

import math
import re

import mechanisms
import numpy as np
import pytest
import yaml
from scene_files import cases
from scipy.spatial.transform import Rotation
from true_error import distance_at

from liegroup_core import Simulation, load_scene
from liegroup_core.accuracy import AccuracyControl
from liegroup_core.reference import Reference, WrenchSpan
from liegroup_core.scene.description import Body, Scene
from liegroup_core.scene.library import four_bar_windows
from liegroup_core.scene.load import scene_from_text

FORCE = {"heavy_top": 40.0, "four_bar": 5.0, "double_pendulum": 2.0, "slider_crank": 3.0}  # N
ON, OFF = 0.3217, 0.7303  # s, inside a step


def pushed(name, **settings):
    """Simulation with a force in world axes on its first body, and the changes for the reference."""
    simulation = Simulation(load_scene(name), **settings)
    body = simulation.scene.bodies[0].name
    wrench = (0.0, 0.0, 0.0, FORCE[name], 0.0, 0.0)
    simulation.apply_wrench(body, wrench, ON, OFF - ON, axes="world")
    return simulation, [WrenchSpan(ON, OFF, body, wrench, "world")]


def true_error(simulation, changes, times):
    """Largest error at times in s: parts of the mechanism's size, or rad."""
    start = simulation.state()
    exact, uncertainty = Reference(simulation.scene, *start, changes, end=times[-1]).at(times)
    worst, length = 0.0, simulation.promise["length"]
    assert max(uncertainty.position.max() / length, uncertainty.angle.max()) < 1e-9
    for k, time in enumerate(times):
        simulation.advance(round(time / simulation.step) - simulation.steps)
        off = distance_at(simulation.sample(), exact, k)
        worst = max(worst, off.position.max() / length, off.angle.max())
    return worst


@pytest.mark.parametrize("accuracy", [1e-3, 1e-5, 1e-7])
@pytest.mark.parametrize("name", FORCE)
@pytest.mark.volume(2)
def test_the_accuracy_is_kept_through_a_push(name, accuracy):
    """Against the independent reference; the estimate says so, or that it is exceeded."""
    simulation, changes = pushed(name, accuracy=accuracy, horizon=2.0)
    step = simulation.step
    times = step * np.unique(np.linspace(0, round(2.0 / step), 21)[1:].astype(int))
    assert true_error(simulation, changes, times) <= accuracy
    assert simulation.method == "rkmk853" and simulation.promise["accuracy"] == accuracy


def scaled(entry, c, key=""):
    """Entries of a scene with all lengths and gravity times c; key: that of the entry."""
    if isinstance(entry, dict):
        return {key: scaled(value, c, key) for key, value in entry.items()}
    if key in ("position", "gravity"):
        return [c * x for x in entry]
    if key == "inertia":
        return [c * c * x for x in entry]
    return [scaled(part, c) for part in entry] if isinstance(entry, list) else entry


@pytest.mark.parametrize("factor", [2.0**-10, 2.0**10])
def test_an_accuracy_does_not_depend_on_the_size(factor):
    """With all lengths and gravity times a power of two the same substeps lead to the same bits, scaled."""
    entries, states = yaml.safe_load(load_scene("double_pendulum").text), []
    for c in (1.0, factor):
        text = yaml.safe_dump(scaled(entries, c))
        simulation = Simulation(scene_from_text(text), accuracy=1e-11, horizon=10.0)
        simulation.advance(200)
        pose = simulation.state()[0].copy()
        pose[:, 9:] /= c
        states.append((simulation.substeps, pose.tobytes()))
    assert states[0] == states[1]
    assert states[0][0][0] > 100


def test_the_default_is_an_accuracy():
    simulation = Simulation(load_scene("four_bar"))
    assert simulation.promise["accuracy"] == 1e-4 and simulation.promise["horizon"] == 60.0
    assert simulation.step == 0.01 and simulation.stabilisation == "projection"
    simulation.advance(6000)
    assert simulation.accurate_until == math.inf and simulation.doubt is None
    assert simulation.sample().constraint_residual < 1e-12
    # Lower pairs to the ground are closed without projection.
    assert Simulation(load_scene("heavy_top")).stabilisation == "none"


@pytest.mark.parametrize("n", [1, 5, 40])
@pytest.mark.volume(1)
def test_rows_of_windows_pass_all_their_flat_poses(n):
    """20 s at the default accuracy, against the equation of their single coordinate."""
    times = np.linspace(0.0, 20.0, 11)
    simulation, errors = Simulation(four_bar_windows(n)), []
    for time, (angle, _) in zip(times, mechanisms.windows_motion(n, times)):
        simulation.advance(round(time / simulation.step) - simulation.steps)
        pose = simulation.sample().poses["crank0"]
        errors.append(abs(np.sin(0.5 * (np.arctan2(pose[1, 0], pose[0, 0]) + np.pi / 2 - angle))))
    assert max(errors) < 1e-4
    # The estimate may be above the accuracy for a while: next to a flat pose the companion is lucky or not.
    assert simulation.predictable_until == math.inf


@pytest.mark.parametrize("horizon", [1.0, 3.0, 10.0])
@pytest.mark.parametrize("accuracy", [1e-4, 1e-6])
@pytest.mark.parametrize("n", [1, 5])
@pytest.mark.volume(4)
def test_no_accuracy_is_given_up_that_is_kept(n, accuracy, horizon):
    """The estimate stays below the accuracy at the steps of a long and of a short horizon, too."""
    for step in (0.01, horizon / 50.0):
        simulation = Simulation(four_bar_windows(n), accuracy=accuracy, horizon=horizon, step=step)
        simulation.advance(round(horizon / step))
        assert simulation.accurate_until == math.inf, (step, simulation.doubt)


@pytest.mark.parametrize("accuracy", [1e-4, 1e-6, 1e-9])
def test_flat_poses_are_passed_with_steps_of_normal_size(accuracy):
    """Ten seconds pass ten of them. A relative error of the accuracy is one of the energy, too."""
    simulation = Simulation(load_scene("n_four_bar"), accuracy=accuracy)
    energy = simulation.energy()
    simulation.advance(round(10.0 / simulation.step))
    assert abs(simulation.energy() - energy) < accuracy * energy
    assert simulation.sample().constraint_residual < 1e-12
    accepted, attempted = simulation.substeps
    assert attempted <= 1.3 * accepted <= 1.3 * simulation.steps


def test_a_fast_spin_keeps_the_accuracy_from_the_first_step_on():
    """A symmetric rotor at 4e4 rad/s against its closed form; its first step has thousands of substeps.

    R(t) = exp(t L / A) exp(t (1 - C / A) r e3), inertia diag(A, A, C), angular momentum L, spin r.
    """
    inertia, rate = np.array([0.02, 0.02, 0.03]), np.array([3e4, 0.0, 3e4])
    body = Body(name="rotor", mass=1.0, inertia=inertia, angular_velocity=rate)
    simulation = Simulation(Scene(name="rotor", gravity=(0, 0, 0), bodies=[body]), quiet=True)
    precession, spin = inertia * rate / inertia[0], np.array([0.0, 0.0, (1.0 - inertia[2] / inertia[0]) * rate[2]])
    for time in (0.01, 0.1, 1.0):
        simulation.advance_to(time)
        exact = Rotation.from_rotvec(time * precession) * Rotation.from_rotvec(time * spin)
        error = (Rotation.from_matrix(simulation.sample().pose_matrices[0][:3, :3]) * exact.inv()).magnitude()
        # The rounding of an angle of 1e5 rad is 1.5e-11. Errors that grow with the time keep 1e-4 for 60 s.
        assert error <= simulation.largest_error + 1e-10 and simulation.largest_error <= 1e-4 * time / 60.0
    assert simulation.accurate_until == math.inf


def test_in_chaos_the_accuracy_ends_with_a_line_and_the_joints_stay_closed():
    simulation = Simulation(load_scene("hinge_chain"), accuracy=1e-6)
    energy = simulation.energy()
    simulation.advance(round(20.0 / simulation.step))
    assert 1.0 < simulation.accurate_until <= simulation.predictable_until < 20.0
    assert "above the accuracy of 1e-06" in simulation.doubt
    assert "may differ completely from the true one" in simulation.doubt
    assert simulation.sample().constraint_residual < 1e-12
    # 1e-6 of the energy that is exchanged, about m g h of the chain.
    assert simulation.energy() == pytest.approx(energy, abs=1e-6 * max(1.0, abs(energy)))


def time_of(simulation, error):
    """Time in s at which the estimate first exceeds an error."""
    while not simulation.largest_error > error:
        simulation.advance(4)
    return simulation.time


@pytest.mark.parametrize("name, accuracy", [("double_pendulum", 1e-4), ("double_pendulum", 1e-5)])
def test_in_chaos_the_line_says_what_a_finer_accuracy_would_give(name, accuracy):
    """Within a factor of two of what it does give."""
    simulation = Simulation(load_scene(name), accuracy=accuracy)
    ended = time_of(simulation, accuracy)
    while simulation.accurate_until == math.inf:
        simulation.advance(4)
    why = simulation.inaccurate_because
    said = r"errors grow tenfold in about (\S+) s: with .* 100 times .* about (\S+) s later"
    tenfold, later = map(float, re.fullmatch(said, why).groups())
    finer = Simulation(simulation.scene, accuracy=accuracy / 100.0)
    assert 0.5 < (time_of(finer, accuracy) - ended) / later < 2.0
    assert later == pytest.approx(2.0 * tenfold, rel=0.05)
    assert simulation.doubt.endswith(f"above the accuracy of {accuracy:.2g}: {why}")
    # A run that is continued from a recording says the same.
    other = Simulation(simulation.scene, **simulation.arguments)
    other.restore(simulation.snapshot())
    assert (other.doubt, other.inaccurate_because) == (simulation.doubt, why)


def test_the_reason_is_that_of_the_time_at_which_the_accuracy_ended():
    """A push after it, which makes the substeps short, does not change it."""
    simulation = Simulation(load_scene("double_pendulum"), accuracy=1e-2, step=5e-4)
    while simulation.accurate_until == math.inf:
        simulation.advance(8)
    why, doubt = simulation.inaccurate_because, simulation.doubt
    substeps = simulation.substeps[0]
    assert substeps < simulation.steps and why.startswith("errors grow tenfold")
    simulation.apply_wrench("lower", [0, 0, 0, 1e5, 0, 1e5], duration=0.01)
    simulation.advance(100)
    assert simulation.substeps[0] > substeps + 30
    assert simulation.inaccurate_because == why and simulation.doubt.startswith(doubt)


@pytest.mark.parametrize("name, accuracy", [("heavy_top", 1e-13), ("four_bar", 1e-12)])
def test_the_line_says_that_an_accuracy_ended_by_rounding(name, accuracy):
    simulation = Simulation(load_scene(name), accuracy=accuracy)
    while simulation.accurate_until == math.inf:
        simulation.advance(4)
    assert "this is round-off: smaller steps do not help" in simulation.doubt


@pytest.mark.parametrize(
    "estimate, said",
    [
        (lambda t: 1e-9 * 10.0**t, "errors grow tenfold in about 1 s: with"),
        (lambda t: 2e-5 * t**2, ""),
        (lambda t: 1e-8 if t < 4.0 else 1.0, ""),
        (lambda t: 1e-8 if t < 4.0 else math.inf, ""),
        (lambda t: 1e-8 if t < 4.0 else 1e-8 * 10.0 ** ((t - 3.9) / 0.08), ""),
    ],
    ids=["exponential", "quadratic", "jump", "unknown", "steep"],
)
def test_only_exponential_growth_is_called_so(estimate, said):
    control = AccuracyControl(1e-4, 60.0, lambda part: None)
    for k in range(1, 100):
        control.update(0.1 * k, estimate(0.1 * k), True)
    assert control.ended < 10.0
    assert control.reason.startswith(said) and bool(control.reason) == bool(said)


def test_a_finer_accuracy_is_exceeded_from_its_change_on_at_the_earliest():
    """Until then the coarser one was kept; the later checkpoints are 0.1 s apart."""
    simulation = Simulation(load_scene("double_pendulum"), quiet=True)
    simulation.advance_to(1.234)
    assert 1e-12 < simulation.largest_error < 1e-4 and simulation.accurate_until == math.inf
    simulation.set_accuracy(1e-12)
    since, said = simulation.time, simulation.doubt
    assert simulation.accurate_until == since and said.endswith("above the accuracy of 1e-12")
    simulation.advance(50)
    assert (simulation.accurate_until, simulation.doubt) == (since, said)
    control = AccuracyControl(1e-4, 60.0, lambda part: None)
    for k in range(1, 11):
        control.update(0.1 * k, 1e-9, True)
    control.change(2e-9, 1.05, 1e-9)
    assert control.ended == math.inf
    control.update(1.1, 3e-9, True)
    assert control.ended == 1.05


def test_another_accuracy_counts_anew_only_while_the_error_allows_it():
    simulation = Simulation(load_scene("double_pendulum"), accuracy=1e-10)
    while simulation.accurate_until == math.inf:
        simulation.advance(4)
    assert "above the accuracy of 1e-10" in simulation.doubt
    simulation.set_accuracy(1e-5)
    assert simulation.accurate_until == math.inf and simulation.doubt is None
    while simulation.predictable_until == math.inf:
        simulation.advance(4)
    since, said = simulation.accurate_until, simulation.doubt
    assert since <= simulation.predictable_until and said.count("above the accuracy of 1e-05") == 1
    simulation.set_accuracy(1e-4)
    simulation.advance(8)
    assert (simulation.accurate_until, simulation.doubt) == (since, said)
    assert simulation.accuracy == simulation.promise["accuracy"] == 1e-4
    simulation.reset()
    assert simulation.accurate_until == math.inf and simulation.doubt is None
    assert simulation.accuracy == 1e-10


@pytest.mark.parametrize("horizon, step", [(60.0, 0.01), (1000.0, 0.01), (0.5, 0.01), (0.3, 5e-3), (1e-9, 2e-7)])
def test_the_default_step_is_at_most_a_fiftieth_of_the_horizon(horizon, step):
    assert Simulation(load_scene("heavy_top"), horizon=horizon).step == step


def test_an_accuracy_is_not_set_as_an_attribute():
    simulation = Simulation(load_scene("free_body"))
    with pytest.raises(AttributeError, match="set_accuracy"):
        simulation.accuracy = 1e-6
    assert simulation.accuracy == simulation.promise["accuracy"] == 1e-4
    assert Simulation(simulation.scene, "rkmk4", 1e-2).accuracy is None


@pytest.mark.parametrize("wrong, text", cases("wrong_settings_are_refused_in_one_line"))
def test_wrong_settings_are_refused_in_one_line(wrong, text):
    with pytest.raises(ValueError, match=text) as refusal:
        Simulation(load_scene("free_body"), **wrong)
    assert "\n" not in str(refusal.value)
