# SPDX-License-Identifier: Apache-2.0
"""Pulls: springs from points of bodies to points in the world, as commands."""

import copy

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scene_files import text_of

from liegroup_core import Simulation, load_scene
from liegroup_core.linear import linearise
from liegroup_core.methods.families import fitting_methods
from liegroup_core.reference import PullSpan, integrate
from liegroup_core.scene.load import scene_from_text

BODY = text_of("pulled.yaml")
POINT, TO = [0.2, 0.1, 0.3], [0.5, -0.2, 1.0]


def test_without_damping_it_is_a_spring_of_zero_length():
    """Of every method: the same numbers as those of a spring of the scene, to a few hundred roundings."""
    spring = {"name": "s", "type": "spring_damper", "parent": "world", "child": "a", "stiffness": 40.0}
    scene = scene_from_text(BODY, "test")
    held = scene.remade(forces=[spring | {"parent_point": TO, "child_point": POINT}])
    for method in fitting_methods(Simulation(scene, quiet=True).layout):
        runs = [Simulation(each, method, 1e-2, quiet=True, estimate=False) for each in (held, scene)]
        runs[1].pull("a", TO, 40.0, point=POINT)
        for run in runs:
            run.advance(50)
        one, other = (run.sample() for run in runs)
        assert_allclose(one.pose, other.pose, rtol=0, atol=1e-11, err_msg=method)
        assert_allclose(other.external_wrenches[0][3:] @ other.pose[0, :9].reshape(3, 3).T, _spring(other), atol=1e-9)


def _spring(sample):
    turn = sample.pose[0, :9].reshape(3, 3)
    return 40.0 * (np.array(TO) - sample.pose[0, 9:] - turn @ POINT)


def test_damping_and_torque():
    """A body on a spring with damper and one with a torque against a damper come to rest where forces balance."""
    simulation = Simulation(
        scene_from_text(BODY.replace("com: [0, 0.1, -0.5]", "com: [0, 0, 0]"), "test"), accuracy=1e-6
    )
    simulation.pull("a", [0, 0, 1], 40.0, 8.0, turning_damping=0.3, torque=[0, 0.6, 0])
    simulation.advance_to(20.0)
    sample = simulation.sample()
    assert_allclose(sample.pose[0, 9:], [0, 0, 1 - 0.8 * 9.81 / 40], atol=1e-5)
    assert_allclose(sample.twist[0], [0, 0.6 / 0.3, 0, 0, 0, 0], atol=1e-5)
    simulation.pull("a", [0, 0, 1], 0.0)  # it ends
    assert simulation.input_count <= 2
    simulation.advance_to(20.5)
    assert simulation.input_count == 0
    assert simulation.sample().pose[0, 11] < sample.pose[0, 11] - 0.5  # it falls


@pytest.mark.parametrize("name", ["four_bar", "slider_crank", "double_pendulum"])
def test_a_mechanism_that_is_held_has_a_small_error(name):
    """Each of the two runs of the estimate is pulled to where it should be, so their distance stays small.

    With the force of one run applied to both, as a spring outside of the steps does, they drift apart.
    """
    scene = load_scene(name)
    simulation = Simulation(scene, accuracy=1e-6, quiet=True)
    body, pose = scene.bodies[-1].name, simulation.sample().pose[-1]
    for _ in range(150):  # the mouse: thirty times a second, at rest
        simulation.pull(body, pose[9:], 400.0, 40.0, duration=0.3, source="view")
        simulation.advance_to(simulation.time + 1 / 30)
    assert simulation.largest_error < 1e-6
    assert np.abs(simulation.sample().twist).max() < 1e-3


def test_bits_of_replays_restores_and_branches():
    def fresh():
        return Simulation(load_scene("four_bar"), accuracy=1e-6, quiet=True)

    simulation, replay = fresh(), fresh()
    last = simulation.layout.body_names[-1]
    simulation.pull(last, TO, 20.0, 1.0, start=0.0313, duration=0.2, point=[0.1, 0, 0], source="x")
    simulation.advance_to(0.11)
    branch, restored = copy.deepcopy(simulation), fresh()
    restored.restore(simulation.snapshot())
    for command in simulation.drain_applied():
        assert type(command).from_json(command.as_json()) == command
        command.repeat(replay)
    for run in (simulation, replay, branch, restored):
        run.advance_to(0.3)
    poses = {run.sample().pose.tobytes() for run in (simulation, replay, branch, restored)}
    assert len(poses) == 1
    simulation.pull(last, TO, 20.0, source="x")
    simulation.clear_wrenches("x")
    simulation.advance(1)
    assert simulation.input_count == 0


def test_linear_systems_have_the_pull():
    """A pendulum pulled at its tip to a point below it: stiffness k (length of the lever)^2 by hand."""
    text = BODY.replace("linear_velocity: [0.3, 0, 0]", "rotation_vector: [0, 0.2, 0]").replace(
        "0, 0.1, -0.5", "0, 0, -0.5"
    )
    text += "joints:\n- {name: hinge, type: revolute, parent: world, child: a, parent_frame: {axis: [0, 1, 0]}, "
    simulation = Simulation(scene_from_text(text + "child_frame: {axis: [0, 1, 0]}}\n", "test"), quiet=True)
    simulation.pull("a", [0, 0, -2], 10.0, 0.5, point=[0, 0, -1])
    found, q, inertia = linearise(simulation).A, 0.2, 0.05 + 0.8 * 0.25
    # Energy k/2 |x* - x|^2 with x at 1 m: -k 2 cos(q) + const, so the torque is -2 k sin(q).
    slope = -(0.8 * 9.81 * 0.5 * np.cos(q) + 2 * 10.0 * np.cos(q)) / inertia
    assert_allclose(found, [[0, 1], [slope, -0.5 / inertia]], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    "given, reason",
    [
        (("b", TO, 1.0), "unknown body"),
        (("a", TO[:2], 1.0), "to must be three finite numbers"),
        (("a", TO, -1.0), "stiffness must not be negative"),
        (("a", TO, float("nan")), "stiffness must be a finite number"),
        (("a", TO, 1.0, 0.0, None, 0.0), "a duration must be positive"),
    ],
)
def test_wrong_arguments_are_refused(given, reason):
    with pytest.raises(ValueError, match=reason):
        Simulation(scene_from_text(BODY, "test"), quiet=True).pull(*given)


def test_the_reference_integration_has_pulls():
    """Two pulls after each other, with torque and damping; both are exact to 1e-10."""
    scene = scene_from_text(BODY, "test")
    simulation = Simulation(scene, accuracy=1e-10, quiet=True)
    start = simulation.state()
    given = {"torque": [0.1, 0.2, -0.3], "turning_damping": 0.05}
    simulation.pull("a", TO, 40.0, 1.5, start=0.2, duration=0.5, point=POINT, **given)
    simulation.pull("a", [0, 0, 2], 30.0, start=0.4)
    simulation.advance_to(1.0)
    spans = [
        PullSpan(0.2, 0.4, "a", tuple(TO), 40.0, 1.5, tuple(POINT), *given.values()),
        PullSpan(0.4, np.inf, "a", (0, 0, 2), 30.0, 0.0),
    ]
    found, uncertainty = integrate(scene, *start, np.array([1.0]), spans)
    sample = simulation.sample()
    assert_allclose(sample.pose[:, 9:], found.position[0], rtol=0, atol=1e-9)
    assert_allclose(sample.pose[:, :9].reshape(-1, 3, 3), found.rotation[0], rtol=0, atol=1e-9)
    assert max(part.max() for part in uncertainty) < 1e-10
