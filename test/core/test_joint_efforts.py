# SPDX-License-Identifier: Apache-2.0
"""Efforts of joints: closed forms, the work that they do, and exact repetition."""

import numpy as np
import pytest
from scene_files import cases, text_of

from liegroup_core import Simulation, load_scene
from liegroup_core.scene.load import scene_from_text

# A body of no symmetry on a tilted hinge away from its centre of mass; no gravity.
HINGE = text_of("hinge.yaml")
RAIL = text_of("rail_joint_efforts.yaml")
# Bodies that float, with an arm that turns and slides, and a nut: reactions act on every parent.
FLOATING = text_of("floating.yaml")
# A nut that was turned by 1.3 rad and three turns from where its thread begins.
NUT = text_of("nut.yaml")
ONE_OF_EACH = cases("joint_efforts_one_of_each")
IN_SPACE = [("rkmk4", "space"), ("constrained_rattle", "space"), ("generalized_alpha", "space")]


def made(text, method, group, step=1e-3, **options):
    if group == "space":
        group, options = "relative", options | {"space": "space"}
    scene = scene_from_text(text)
    return Simulation(scene, method, step, group, estimate=False, **options)


def coordinate(simulation, joint):
    return np.array(simulation.sample().joint_coordinates[joint])


@pytest.mark.parametrize("method, group", ONE_OF_EACH + IN_SPACE)
def test_a_constant_effort_on_a_hinge_gives_the_angular_acceleration(method, group):
    """alpha = tau / I, I = u J u + m d^2, from 20.3 ms to 70.7 ms: both inside a step.

    All methods are exact for a constant acceleration about a fixed axis, but for positions on
    so3xr3, where centres of mass move on arcs: 1e-9 is far above their error of order 4, or with
    order 2 (h w)^2 / 12 of an angle of 0.05 rad: 1e-8.
    """
    simulation = made(HINGE, method, group)
    body = simulation.scene.bodies[0]
    axis = body.rotation.T @ (np.array([1, 2, 2]) / 3.0)  # body axes
    hinge = body.rotation.T @ (np.array([0.2, 0.3, -0.1]) - body.position)
    arm = np.cross(axis, np.array(body.com) - hinge)
    alpha = 1.5 / (axis @ body.inertia_matrix @ axis + 2.0 * arm @ arm)
    simulation.apply_effort("hinge", 1.5, start=0.0203, duration=0.0504)
    simulation.advance(100)
    expected = alpha * 0.0504 * (0.1 - 0.0203 - 0.0252), alpha * 0.0504
    apart = np.abs(coordinate(simulation, "hinge") - expected)
    allowed = 1e-12 if method.startswith("rkmk") and group != "so3xr3" else 1e-8
    assert apart.max() <= allowed
    assert simulation.drain_applied()[0].start_ns == 20_300_000


@pytest.mark.parametrize("method, group", ONE_OF_EACH)
def test_a_constant_effort_on_a_rail_gives_the_acceleration(method, group):
    """a = f / m + g . u; the motion is a straight line, which every method integrates exactly."""
    simulation = made(RAIL, method, group)
    axis = np.array([2, -1, 2]) / 3.0
    simulation.apply_effort("rail", -6.0)
    simulation.advance(200)
    acceleration = -6.0 / 3.0 + axis @ [1.0, 0, -9.81]
    expected = 0.5 * acceleration * 0.2**2, acceleration * 0.2
    assert np.abs(coordinate(simulation, "rail") - expected).max() <= 2e-12


@pytest.mark.parametrize("method, group", ONE_OF_EACH)
def test_a_screw_has_one_coordinate(method, group):
    """Its angle with all turns, which encoders measure; (I + m p^2) alpha = tau - m g p, I about the centre of mass.

    The acceleration is constant and the motion about a fixed axis: errors as of a hinge.
    """
    pitch, start = 0.05, 1.3 + 6.0 * np.pi
    simulation = made(NUT % (1.0 - pitch * start), method, group)
    assert simulation.sample().joint_coordinates["thread"] == pytest.approx((start, 4.0), abs=1e-13)
    simulation.apply_effort("thread", 2.5)
    simulation.advance(100)
    alpha = (2.5 - 1.5 * 9.81 * pitch) / (0.012 + 1.5 * pitch**2)
    sample = simulation.sample()
    expected = start + 0.1 * 4.0 + 0.5 * 0.1**2 * alpha, 4.0 + 0.1 * alpha
    assert coordinate(simulation, "thread") == pytest.approx(expected, rel=1e-12)
    assert sample.sensors["encoder"] == sample.joint_coordinates["thread"][0]


def balance(method, group, step):
    """(energy that is no work, J; largest momentum) of the floating arm after 0.5 s."""
    simulation = made(FLOATING, method, group, step)
    before = simulation.sample()
    efforts = {"shoulder": 0.8, "slide": -1.2, "thread": 0.3}
    for joint, effort in efforts.items():
        simulation.apply_effort(joint, effort)
    simulation.advance(round(0.5 / step))
    after = simulation.sample()
    assert after.joint_efforts == efforts
    work = sum(
        effort * (after.joint_coordinates[joint][0] - before.joint_coordinates[joint][0])
        for joint, effort in efforts.items()
    )
    assert work > 0.5
    return abs(after.energy - before.energy - work), np.abs(after.spatial_momentum).max()


@pytest.mark.parametrize("method, group", ONE_OF_EACH)
def test_efforts_are_internal_and_do_their_work(method, group):
    """No momentum comes from them, and energy as effort times change of the coordinate.

    Up to the error of the method: 1e-10 at 1 ms with order 4 and more; with order 2 it is a fourth
    at half the step, unless it is round-off.
    """
    if method.startswith("rkmk"):
        assert max(balance(method, group, 1e-3)) <= 1e-10
        return
    for large, small in zip(balance(method, group, 1e-3), balance(method, group, 5e-4)):
        assert large <= 1e-12 or 3.5 < large / small < 4.5


@pytest.mark.parametrize("group", ["relative", "se3", "so3xr3"])
def test_the_work_on_the_crank_of_a_loop_is_its_energy(group):
    """Four-bar linkage, 1.6 turns of the crank, by error control: 1e-9 of the energy."""
    options = {"group": group, "stabilisation": "projection", "rtol": 1e-12, "atol": 1e-12}
    simulation = Simulation(load_scene("four_bar"), "rkmk853", 1e-3, estimate=False, **options)
    start, angles = simulation.energy(), [coordinate(simulation, "ground_crank")[0]]
    simulation.apply_effort("ground_crank", 5.0)
    for _ in range(300):
        simulation.advance(1)
        angles.append(coordinate(simulation, "ground_crank")[0])
    turned = np.unwrap(angles)[-1] - angles[0]
    assert turned > 10.0
    assert abs(simulation.energy() - start - 5.0 * turned) <= 1e-9 * simulation.energy()


def test_sources_add_and_replace_and_zero_ends():
    simulation = made(HINGE, "rkmk4", "relative")
    for source, effort, start in (
        ("a", 1.0, 0.0),
        ("b", 2.0, 0.001),
        ("a", 4.0, 0.002),
        ("b", 0.0, 0.003),
        ("a", 0.0, 0.004),
    ):
        simulation.apply_effort("hinge", effort, start=start, source=source)
    assert simulation.input_count == 5 and simulation.wrench_sources == {"a", "b"}
    seen = []
    for _ in range(5):
        simulation.advance(1)
        seen.append(simulation.sample().joint_efforts)
    assert seen == [{"hinge": 1.0}, {"hinge": 3.0}, {"hinge": 6.0}, {"hinge": 4.0}, {}]
    simulation.apply_effort("hinge", 1.0)
    simulation.clear_wrenches()
    simulation.advance(1)
    assert not simulation.sample().joint_efforts and simulation.input_count == 0
    simulation.apply_effort("hinge", 1.0)
    simulation.reset()
    simulation.advance(1)
    assert not coordinate(simulation, "hinge")[1]


def test_a_source_may_command_efforts_and_push_a_body():
    """An effort and a wrench of one source are different commands and add."""
    simulation = made(HINGE, "rkmk4", "relative")
    simulation.apply_effort("hinge", 1.0)
    simulation.apply_wrench("arm", (0, 0, 0, 0, 0, 1.0))
    simulation.advance(1)
    assert simulation.input_count == 2
    assert [(c.kind, c.name) for c in simulation.drain_applied()] == [("effort", "hinge"), ("wrench", "arm")]
    wrench = simulation.sample().external_wrenches[0]
    assert wrench[5] == 1.0 and any(wrench[:3])


@pytest.mark.parametrize("effort", [np.nan, np.inf, "1", None, True])
def test_an_invalid_effort_is_refused_and_changes_nothing(effort):
    simulation = made(FLOATING, "rkmk4", "relative")
    with pytest.raises(ValueError, match="an effort must be a finite number, got"):
        simulation.apply_effort("shoulder", effort)
    with pytest.raises(ValueError, match="'elbow' is not a joint.*one of: shoulder, slide"):
        simulation.apply_effort("elbow", 1.0)
    with pytest.raises(ValueError, match="duration must be positive"):
        simulation.apply_effort("slide", 1.0, duration=0.0)
    with pytest.raises(ValueError, match="; the scene has none"):
        Simulation(load_scene("heavy_top"), "rkmk4").apply_effort("pivot", 1.0)
    simulation.advance(1)
    assert simulation.drain_applied() == []
