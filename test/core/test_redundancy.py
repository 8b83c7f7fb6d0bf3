# SPDX-License-Identifier: Apache-2.0
"""Closed loops: redundant rows, singular poses."""

import math
import re

import numpy as np
import pytest
import yaml
from mechanisms import bar, hinge, parallelogram
from scene_files import cases

from liegroup_core import Scene, Simulation, SimulationError, load_scene
from liegroup_core.engine import Engine
from liegroup_core.joints.linkage import Linkage
from liegroup_core.lie.groups import SO3
from liegroup_core.mechanism.redundancy import loop_groups, loop_joints
from liegroup_core.scene.consistency import resolve_elements, resolve_frames
from liegroup_core.scene.load import scene_from_text


def test_a_tree_has_no_loop_joints():
    assert loop_joints([("world", "a"), ("a", "b"), ("a", "c")]) == []
    assert loop_joints([("world", "a"), ("a", "b"), ("b", "world"), ("b", "c")]) == [0, 1, 2]
    assert loop_joints([("x", "a"), ("a", "b"), ("b", "c"), ("c", "a")]) == [1, 2, 3]


def test_loops_without_a_common_joint_are_analysed_alone():
    first = [("world", "a"), ("a", "b"), ("b", "world")]
    assert loop_groups(first) == [[0, 1, 2]]
    # A bridge to two more loops, which have the joint between d and e in common.
    second = [("c", "b"), ("c", "d"), ("d", "e"), ("e", "c"), ("e", "f"), ("f", "d")]
    assert loop_groups([*first, *second]) == [[0, 1, 2], [4, 5, 6, 7, 8]]
    # Two joints between the same bodies; two loops that touch in one body only.
    assert loop_groups([("a", "b"), ("b", "a"), ("b", "c"), ("c", "b")]) == [[0, 1], [2, 3]]
    assert loop_groups([("world", "a"), ("a", "b"), ("x", "y")]) == []


def test_a_four_bar_on_a_bar_of_another_one_loses_its_own_three_rows():
    """Each planar four-bar of hinges has 20 rows of rank 17, wherever its frame is mounted."""
    base = parallelogram(1.0, 2.0)
    shift = next(body.position for body in base.bodies if body.name == "coupler")
    upper = parallelogram(0.7, 0.0)
    speed = base.bodies[1].linear_velocity
    bodies = [
        body.remade(
            name=f"upper_{body.name}",
            position=np.add(body.position, shift),
            # A parallelogram moves its coupler without rotation.
            linear_velocity=body.rotation.T @ speed,
        )
        for body in upper.bodies
    ]
    joints = [
        joint.remade(
            name=f"upper_{joint.name}",
            parent="coupler" if joint.parent == "world" else f"upper_{joint.parent}",
            child=f"upper_{joint.child}",
        )
        for joint in upper.joints
    ]
    scene = base.remade(bodies=[*base.bodies, *bodies], joints=[*base.joints, *joints])
    layout = Simulation(scene, method="rkmk4").layout
    dropped = [name.startswith("upper_") for name, _ in layout.dropped_rows]
    assert dropped.count(True) == dropped.count(False) == 3
    linkage = Linkage(scene, resolve_frames(scene), resolve_elements(scene), range(8))
    jacobian = linkage.jacobian(linkage.start)
    kept = jacobian[layout.model.row_residual]
    # Singular values of unit rows: 34 of 40 rows are independent.
    assert np.linalg.svd(kept, compute_uv=False)[-1] > 1e-3
    assert np.linalg.matrix_rank(jacobian, tol=1e-12) == len(kept) == 34


@pytest.mark.parametrize("angle", [1.0, 0.0])
def test_a_singular_start_does_not_change_the_redundancy(angle):
    """Four revolute joints: 20 rows of rank 17, also for a flat start, where the rank is 16."""
    layout = Simulation(parallelogram(angle, 2.0), method="rkmk4").layout
    assert len(layout.dropped_rows) == 3
    assert {row for _, row in layout.dropped_rows} <= {"wx", "wy", "vz"}


def test_coaxial_revolute_joints_are_redundant():
    low = hinge("low", "world", "door", -0.5)
    high = low.remade(name="high", child_frame={"position": (-0.5, 0, 0.7)})
    scene = Scene(name="door", gravity=(0, 0, -9.81), bodies=[bar("door", (0, 0), (1, 0))], joints=[low, high])
    simulation = Simulation(scene, method="rkmk4")
    assert [joint for joint, _ in simulation.layout.dropped_rows] == ["high"] * 5
    simulation.apply_wrench("door", (0, 0, 1.0, 0, 0, 0))
    simulation.advance(1000)
    # (1/12 + 1/4) kg m^2 about the hinge, 1 N m for 1 s: 3 rad/s; RK4 is exact on a constant rate.
    assert simulation.sample().twists["door"][2] == pytest.approx(3.0, rel=1e-12)


@pytest.mark.parametrize("angle", [0.0, 0.3])
def test_a_moving_parallelogram_passes_its_flat_pose(angle):
    """Closed form without gravity: crank and rocker at angle + rate t, for 0.6 turns.

    The pose is flat, and K singular, after half a turn, from angle 0 at a step exactly. There the
    loop's drift, 1e-9 m at these steps, is divided by the sine of the angle that the nearest stage
    has to the flat pose, 1e-5 at least: 1e-3 is that quotient, with ten times for its rate.
    """
    rate = 2.0 * np.pi
    for step in (1e-3, 2.5e-4):
        simulation = Simulation(parallelogram(angle, rate), method="rkmk4", step=step)
        start = simulation.sample().energy
        for _ in range(40):
            simulation.advance(round(0.6 / step) // 40)
            sample = simulation.sample()
            expected = SO3.exp([0.0, 0.0, angle + rate * sample.time])
            for name in ("crank", "rocker"):
                assert np.abs(sample.poses[name][:3, :3] - expected).max() <= 1e-3
            assert sample.energy == pytest.approx(start, rel=1e-3)
        assert (simulation.singular_solves > 0) == (angle == 0.0)


@pytest.mark.parametrize("settings", [{"accuracy": 1e-6}, {"method": "constrained_rattle", "step": 1e-3}])
def test_a_passage_of_a_flat_pose_is_said_once(settings, caplog):
    """Without gravity the angle is a + 2 pi t. The flat poses are at 0 and pi, others above 0.2 rad away.

    Steps to an accuracy run ahead; the time that is said is that of their end.
    """
    Simulation(parallelogram(-1.5, 0.1 * np.pi), **settings).advance(100)  # up to -1.2
    Simulation(load_scene("slider_crank"), **settings).advance(250)  # its dead centres are no flat poses
    assert "singular" not in caplog.text
    simulation = Simulation(parallelogram(0.5, 2.0 * np.pi), **settings)
    simulation.advance(round(0.6 / simulation.step))
    simulation.advance(round(0.6 / simulation.step))
    (text,) = [each for each in caplog.messages if "passes a singular configuration" in each]
    said = float(re.search(r"t = (\S+) s", text)[1])
    assert (np.pi - 0.5 - 0.1) / (2.0 * np.pi) < said < 0.6


def test_an_energy_jump_at_a_flat_pose_has_a_large_estimate():
    """Next to a flat pose RATTLE may jump to another motion that satisfies the joints: 3 of 6 do."""
    jumps = 0
    for angle in (0.5, 0.37, 1.0):
        for step in (7e-4, 5e-3):
            simulation = Simulation(parallelogram(angle, 0.3), "constrained_rattle", step)
            start = simulation.energy()
            try:
                simulation.advance(round(10.0 / step))
            except SimulationError:
                continue
            if abs(simulation.energy() / start - 1.0) > 0.1:
                jumps += 1
                assert "may differ completely from the true one" in simulation.doubt
    assert jumps


def test_rattle_on_links_passes_flat_poses():
    """Twice in a turn. Where a step ends within round-off of the flat pose it may stop or jump.

    16 of 18 passed with a change of the energy below 1e-13.
    """
    passed = 0
    for angle in (0.5, 0.37, 1.0):
        for rate in (1.0, 3.0):
            for step in (7e-4, 1e-3, 2e-3):
                simulation = Engine(parallelogram(angle, rate), "constrained_rattle", step, "relative", quiet=True)
                start = simulation.energy()
                try:
                    simulation.advance(round(6.0 / rate / step))
                except SimulationError:
                    continue
                passed += abs(simulation.energy() / start - 1.0) < 1e-12
    assert passed >= 12


# A driven joint of a loop that is commanded beyond its reach ends the run with its name.


# Rocker of the four-bar: its end is 1.5 m from the crank's pin where crank and coupler are in line,
# and 0.5 m where they are folded. All other links are 1 m, and its angle counts from the ground line.
OUTER, INNER = (math.pi - math.acos(1.0 - 0.5 * d * d) for d in (1.5, 0.5))


def driven_rocker():
    scene = yaml.safe_load(load_scene("four_bar").text)
    for joint in scene["joints"]:
        joint.pop("rate", None)
        if joint["name"] == "ground_rocker":
            joint |= {"driven": True, "rate": 0.0}
    return scene_from_text(yaml.safe_dump(scene))


@pytest.mark.parametrize("options", cases("a_position_beyond_the_reach_of_a_loop_is_named"), ids=str)
@pytest.mark.parametrize("change, end, sign", [(1.5, INNER, 1.0), (-3.0, OUTER, -1.0)])
@pytest.mark.turn(3)
def test_a_position_beyond_the_reach_of_a_loop_is_named(options, change, end, sign):
    """Within what the joint moves in four steps, at most 3 * 15/8 rad/s."""
    simulation = Simulation(driven_rocker(), quiet=True, **options)
    start = simulation.sample().prescribed["ground_rocker"][0]
    simulation.command_motion("ground_rocker", [1.0], [start + change])
    with pytest.raises(SimulationError) as caught:
        simulation.advance(round(1.0 / simulation.step))
    text = str(caught.value)
    assert "beyond their reach: 'ground_rocker' at " in text and "\n" not in text
    position = float(text.partition("'ground_rocker' at ")[2].split()[0])
    most = 3.0 * 1.875 * 4 * simulation.step
    assert 0.0 < sign * (position - end) < most
    assert "coupler_rocker" not in text


def test_a_failure_within_the_reach_keeps_its_reason():
    """Tolerances below round-off, which no substep meets."""
    simulation = Simulation(driven_rocker(), "rkmk54", 1e-2, quiet=True, rtol=1e-30, atol=1e-30)
    simulation.command_motion("ground_rocker", [1.0], None, [0.2])
    with pytest.raises(SimulationError, match="tolerance"):
        simulation.advance(10)
