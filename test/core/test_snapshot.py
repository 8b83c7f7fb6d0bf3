# SPDX-License-Identifier: Apache-2.0
"""Snapshots: a run that returns to one repeats its continuation bit for bit, wrenches included."""

import json

import numpy as np
import pytest

from liegroup_core import Simulation, load_scene
from liegroup_core.methods.table import METHODS
from liegroup_core.scene.load import scene_from_text
from liegroup_sim_ros.recording import attachments

SPRING = """
name: wound
gravity: [0, 0, -9.81]
bodies: [{name: arm, mass: 1, inertia: [0.1, 0.2, 0.3], com: [0.3, 0, 0], angular_velocity: [0, 30, 0]}]
joints:
  - {name: hinge, type: revolute, parent: world, child: arm,
     parent_frame: {position: [0, 0, 0], axis: [0, 1, 0]}, child_frame: {axis: [0, 1, 0]}}
forces: [{name: coil, type: torsional_spring_damper, joint: hinge, stiffness: 0.5, damping: 0.01}]
"""
PUSH = [0.3, 0.1, 0.0, 0.0, 0.2, 0.0]
CASES = [
    ("four_bar", {"accuracy": 1e-5, "step": 1e-3}),
    ("heavy_top", {"accuracy": 1e-6}),
    ("double_pendulum", {"method": "rkmk4", "step": 1e-3, "group": "se3"}),
    ("four_bar", {"method": "generalized_alpha", "step": 1e-3}),
    ("bricard", {"method": "constrained_rattle", "step": 1e-3}),
    ("heavy_top", {"method": "rkmk853", "step": 1e-2, "rtol": 1e-11, "atol": 1e-11}),
]


def trace(simulation, count=40):
    """Bits of every state, estimate and time on the way."""
    found = []
    for _ in range(count):
        simulation.advance(1)
        sample = simulation.sample()
        estimate = b"" if sample.errors is None else sample.errors.tobytes()
        found.append((sample.pose.tobytes(), sample.twist.tobytes(), sample.angles.tobytes(), estimate))
    return found, simulation.steps, simulation.largest_error, simulation.accurate_until


@pytest.mark.parametrize("steps", [24, 29])
@pytest.mark.parametrize("scene, options", CASES, ids=lambda v: v if isinstance(v, str) else "")
def test_the_continuation_of_a_snapshot_is_bit_identical(scene, options, steps):
    """One wrench acts at the snapshot and ends later, one starts later, one started just before."""
    simulation = Simulation(load_scene(scene), quiet=True, **options)
    body, h = simulation.layout.body_names[-1], simulation.step
    simulation.apply_wrench(body, PUSH, 5.3 * h, 40.2 * h, "a")
    simulation.apply_wrench(body, PUSH, (steps - 1.5) * h, None, "b", "world")
    simulation.apply_wrench(body, PUSH, (steps + 7.7) * h, 3.0 * h, "c")
    simulation.advance(steps)
    snapshot = simulation.snapshot()
    expected = trace(simulation)
    simulation.apply_wrench(body, np.multiply(PUSH, 50.0))
    simulation.advance(30)
    for _ in range(2):  # a snapshot can be used again
        simulation.restore(snapshot)
        assert simulation.steps == steps
        assert trace(simulation) == expected


def test_unwrapped_angles_return():
    simulation = Simulation(scene_from_text(SPRING), "rkmk4", 1e-3, quiet=True)
    simulation.advance(500)
    assert abs(simulation.sample().angles[0]) > 2.0 * np.pi
    snapshot = simulation.snapshot()
    expected = trace(simulation)
    simulation.reset()
    simulation.restore(snapshot)
    assert trace(simulation) == expected


@pytest.mark.parametrize("steps", [24, 29, 31])
@pytest.mark.parametrize("scene, options", CASES[:2] + CASES[3:4], ids=lambda v: "")
def test_the_recorded_state_continues_bit_for_bit_at_any_step(scene, options, steps):
    """As a re-simulation does it: state, memory and pending wrenches by JSON, then the totals."""
    simulation = Simulation(load_scene(scene), quiet=True, **options)
    body, h = simulation.layout.body_names[-1], simulation.step
    simulation.apply_wrench(body, PUSH, 5.3 * h, None, "a")
    simulation.apply_wrench(body, PUSH, (steps - 1.5) * h, None, "b", "world")
    simulation.advance(steps)
    entries = json.loads(json.dumps(attachments.state(simulation, 0)))
    acting, (expected, *_) = simulation.acting(), trace(simulation)
    other = Simulation(load_scene(scene), quiet=True, **options)
    assert attachments.restore(other, entries)
    for change in acting:
        change.repeat(other)
    found, *_ = trace(other)
    assert [row[:3] for row in found] == [row[:3] for row in expected]


@pytest.mark.parametrize("steps", [24, 30])
def test_a_wrench_that_ends_at_the_recorded_state_ends_for_the_estimate_too(steps):
    """The record has both totals at that stamp: the one that acts, and zero from then on."""
    scene, options = CASES[0]
    simulation = Simulation(load_scene(scene), quiet=True, **options)
    body, h = simulation.layout.body_names[-1], simulation.step
    simulation.apply_wrench(body, PUSH, 5.3 * h, None, "a")
    simulation.advance(steps)
    entries = json.loads(json.dumps(attachments.state(simulation, 0)))
    simulation.clear_wrenches("a")
    expected = trace(simulation)
    other = Simulation(load_scene(scene), quiet=True, **options)
    assert attachments.restore(other, entries)
    for wrench in (PUSH, [0.0] * 6):
        other.apply_wrench(body, wrench, steps * h, source="body", axes="body")
    assert trace(other) == expected


@pytest.mark.parametrize(
    "change",
    [
        lambda p: p["engine"][0].__setitem__(1, "sky"),
        lambda p: p["engine"][0].__setitem__(0, "nobody"),
        lambda p: p["engine"][0].pop(),
        lambda p: p["engine"][0].__setitem__(2, "x"),
        lambda p: p["companion"].pop("later"),
        lambda p: p["companion"]["later"].append(3),
    ],
)
def test_wrong_pending_wrenches_are_refused(change):
    simulation = Simulation(load_scene("four_bar"), quiet=True, accuracy=1e-5, step=1e-3)
    simulation.apply_wrench("rocker", PUSH)
    simulation.advance(24)
    pending = json.loads(json.dumps(simulation.pending))
    simulation.remember_pending(pending)
    change(pending)
    with pytest.raises((ValueError, KeyError, TypeError)):
        simulation.remember_pending(pending)


def test_all_method_families_are_covered():
    families = {METHODS[o["method"]].family for _, o in CASES if "method" in o}
    assert families == {method.family for method in METHODS.values()} - {"rotation"}


SERVO = SPRING.replace(
    "forces: [", "forces: [{name: drive, type: servo, joint: hinge, stiffness: 20, damping: 1, effort_limit: 4}, "
)


@pytest.mark.parametrize("options", [{"accuracy": 1e-5, "step": 1e-3}, CASES[2][1]], ids=["a", "m"])
def test_servos_and_efforts_return(options):
    """In a snapshot, and in the recorded state with what acts."""
    simulation = Simulation(scene_from_text(SERVO), quiet=True, **options)
    h = simulation.step
    simulation.command_servo("hinge", 0.7, 0.1, 3.4 * h)
    simulation.apply_effort("hinge", 0.5, 5.3 * h)
    simulation.advance(29)
    snapshot = simulation.snapshot()
    entries = json.loads(json.dumps(attachments.state(simulation, 0)))
    acting, expected = simulation.acting(), trace(simulation)
    assert len(acting) == 2 and acting[-1].position == 0.7
    simulation.command_servo("hinge", -2.0)
    simulation.advance(30)
    simulation.restore(snapshot)
    assert trace(simulation) == expected
    other = Simulation(scene_from_text(SERVO), quiet=True, **options)
    assert attachments.restore(other, entries)
    for change in acting:
        change.repeat(other)
    assert [row[:3] for row in trace(other)[0]] == [row[:3] for row in expected[0]]


def test_only_a_snapshot_of_this_simulation_is_restored():
    """Of another object with the same scene and arguments, too."""

    def made(scene="double_pendulum", method="rkmk4", **options):
        return Simulation(load_scene(scene), method, quiet=True, **{"step": 1e-3} | options)

    simulation = made()
    simulation.advance(30)
    mine, before = simulation.snapshot(), simulation.state()
    for wrong in (None, 3, {}, {"state": mine["state"]}, [mine], simulation.state(), "a"):
        with pytest.raises(ValueError, match="^expected what `snapshot` of this simulation returned"):
            simulation.restore(wrong)
    for other, said in (
        (made("four_bar"), "scene"),
        (made(method="rkmk8"), "method, 'rkmk8' instead of 'rkmk4'"),
        (made(step=2e-3), "step, 0.002 instead of 0.001"),
        (made(group="se3"), "group, 'se3' instead of 'relative'"),
        (made(estimate=False), "estimate, False instead of None"),
        (made(method=None, accuracy=1e-5), "method, None instead of 'rkmk4'"),
    ):
        with pytest.raises(ValueError) as error:
            simulation.restore(other.snapshot())
        assert str(error.value) == f"the snapshot is of a simulation with another {said}"
    assert all(np.array_equal(old, new) for old, new in zip(before, simulation.state()))
    expected, twin = trace(simulation), made()
    twin.restore(mine)
    assert trace(twin) == expected
