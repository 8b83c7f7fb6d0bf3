# SPDX-License-Identifier: Apache-2.0
"""Assembly: constraints are satisfied at position and velocity level, impossible scenes refused."""

import math
import re

import mechanisms
import numpy as np
import pytest
from other_frames import described_elsewhere
from scene_files import filled, text_of
from scipy.linalg import block_diag, null_space

from liegroup_core import Simulation, load_scene
from liegroup_core.describe import describe
from liegroup_core.errors import SceneError
from liegroup_core.joints import LOWER_PAIRS
from liegroup_core.lie.groups import SO3
from liegroup_core.scene import (
    Body,
    Frame,
    Joint,
    Scene,
    check_consistency,
    resolve_elements,
    resolve_frames,
    scene_from_text,
)
from liegroup_core.scene.assembly import assembled
from liegroup_core.study.extremes import problems as problems

CLOSED = {name for name, (_, loops) in mechanisms.MECHANISMS.items() if loops}


def disturbed(scene, rng, size, keep=()):
    """The scene with joints written out and all poses and velocities off by up to `size`."""
    joints = []
    for joint, (a, b), [element, *_] in zip(scene.joints, resolve_frames(scene), resolve_elements(scene)):
        length = {"length": element.parameter} if joint.type == "distance" else {}
        joints.append(joint.remade(parent_frame=mechanisms.frame(a), child_frame=mechanisms.frame(b), **length))
    bodies = []
    for body in scene.bodies:
        if body.name in keep:
            bodies.append(body.remade(initial="fixed"))
            continue
        turn = SO3.exp(size * rng.uniform(-1, 1, 3))
        bodies.append(
            body.remade(
                position=body.position + size * rng.uniform(-1, 1, 3),
                rotation_vector=SO3.log(body.rotation @ turn),
                angular_velocity=body.angular_velocity + size * rng.normal(size=3),
                linear_velocity=body.linear_velocity + size * rng.normal(size=3),
            )
        )
    return scene.remade(assemble=True, bodies=bodies, joints=joints)


def mass_matrix(scene):
    return block_diag(*(block_diag(body.inertia_matrix, body.mass * np.eye(3)) for body in scene.bodies))


def twists(scene):
    return np.concatenate([body.twist for body in scene.bodies])


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", mechanisms.MECHANISMS)
@pytest.mark.volume(12)
def test_assembly_satisfies_position_and_velocity_constraints(name, seed):
    scene = mechanisms.named(name, seed)
    rough = disturbed(scene, np.random.default_rng(seed), 0.1)
    with pytest.raises(SceneError, match="is violated"):
        check_consistency(rough)
    done = assembled(rough)
    assert not done.assemble
    sample = Simulation(done, method="rkmk4").sample()
    # residuals of places of size 1 to 5
    assert sample.constraint_residual <= 2e-14
    V, V0 = twists(done), twists(rough)
    J, M = mechanisms.exact_jacobian(done), mass_matrix(done)
    assert np.abs(J @ V).max() <= 1e-12
    # Least kinetic energy of the change: no motion that the joints allow does any work on it.
    free = null_space(J, rcond=1e-6)
    assert np.abs(free.T @ M @ (V - V0)).max(initial=0.0) <= 1e-11
    # The nearest poses: about as far as they were moved.
    for mine, theirs in zip(done.bodies, rough.bodies):
        assert np.linalg.norm(np.subtract(mine.position, theirs.position)) < 1.0


@pytest.mark.parametrize("ratio", [1e-4, 1e-8])
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", sorted(CLOSED))
def test_slender_and_light_bodies_in_loops_are_assembled(name, seed, ratio):
    """Which conditions on the velocities depend on others does not depend on masses and inertias."""
    scene = mechanisms.named(name, seed)
    rng = np.random.default_rng([seed, 1])
    bodies = []
    for k, body in enumerate(scene.bodies):
        axes = SO3.exp(rng.normal(size=3))
        slender = axes @ np.diag([ratio, 1.0, 1.0]) @ axes.T
        share = 1.0 if k % 2 else ratio
        inertia = (share * slender)[(0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)]
        bodies.append(body.remade(mass=share, inertia=inertia))
    rough = disturbed(scene.remade(bodies=bodies), rng, 0.1)
    done = assembled(rough)
    V, V0 = twists(done), twists(rough)
    J, M = mechanisms.exact_jacobian(done), mass_matrix(done)
    assert np.abs(J @ V).max() <= 1e-12
    free = null_space(J, rcond=1e-6)
    assert np.abs(free.T @ M @ (V - V0)).max(initial=0.0) <= 1e-11


def test_an_assembled_scene_is_not_changed_bitwise():
    for name in ("heavy_top", "double_pendulum", "free_body"):
        scene = load_scene(name)
        again = scene_from_text(scene.text.replace("gravity:", "assemble: true\ngravity:"))
        assert [body.model_dump() for body in again.bodies] == [body.model_dump() for body in scene.bodies]


@pytest.mark.parametrize("keep", ["a", "c"])
@pytest.mark.parametrize("name", sorted(CLOSED))
def test_a_fixed_body_keeps_its_pose_and_velocity_bitwise(name, keep):
    scene = mechanisms.named(name, 1)
    rough = disturbed(scene, np.random.default_rng(2), 0.05, keep=[keep])
    done = assembled(rough)
    for mine, theirs in zip(done.bodies, rough.bodies):
        same = (mine.position, mine.rotation_vector, mine.angular_velocity) == (
            theirs.position,
            theirs.rotation_vector,
            theirs.angular_velocity,
        )
        assert same == (mine.name == keep)
    check_consistency(done)


def test_a_fixed_body_keeps_only_the_values_in_the_scene():
    """A crank set to an angle, its velocity from a rate: the four-bar; and the other way round."""
    scene = load_scene("four_bar")
    text = scene.text.replace("    initial: fixed  ", "    # ")
    assert text != scene.text
    free = scene_from_text(text)
    assert free.bodies[0].position != scene.bodies[0].position
    check_consistency(free)
    [joint] = [joint for joint in load_scene("heavy_top").joints]
    keys = {"name": "top", "angular_velocity": (0, 0, 2), "linear_velocity": (0, 1, 0), "initial": "fixed"}
    spun = mechanisms.one_body(None, assemble=True, **keys)
    spun = spun.remade(joints=[joint.remade(parent_frame=Frame(position=(0.1, 0, 0)))])
    body = assembled(spun).bodies[0]
    np.testing.assert_allclose(body.position, (0.6, 0, 0), atol=1e-16)
    assert (body.angular_velocity, body.linear_velocity) == ((0, 0, 2), (0, 1, 0))


def test_assembly_imposes_the_joint_rates_of_a_chain():
    """Every child rotates relative to its parent about z at the joint's rate, in world axes."""
    scene = mechanisms.named("chain of hinges", 2)
    rates = (0.7, -2.0, 3.0)
    joints = [joint.remade(rate=rate) for joint, rate in zip(scene.joints, rates)]
    done = assembled(scene.remade(assemble=True, joints=joints))
    turning = {body.name: body.rotation @ body.angular_velocity for body in done.bodies}
    rotation = {body.name: body.rotation for body in done.bodies}
    turning["world"], rotation["world"] = np.zeros(3), np.eye(3)
    for joint, (frame, _), rate in zip(done.joints, resolve_frames(done), rates):
        axis = rotation[joint.parent] @ frame[:3, 2]
        np.testing.assert_allclose(turning[joint.child] - turning[joint.parent], rate * axis, atol=1e-13)
        assert joint.rate is None


@pytest.mark.parametrize("pair", LOWER_PAIRS)
def test_a_rate_belongs_to_a_free_direction_of_its_joint(pair):
    rows = LOWER_PAIRS[pair].forbidden()  # of a screw for a pitch of zero
    rate = LOWER_PAIRS[pair].rate
    if rate is not None:
        assert not rows[:, rate].any()
    else:  # nothing moves, or no axis is marked out
        assert len(rows) == 6 or not rows[:, :3].any()


def test_assembled_velocities_do_not_depend_on_body_frames():
    """The velocity change of least kinetic energy is independent of the body frames' origins."""
    scene = mechanisms.named("loop of hinges and balls", 4)
    rng = np.random.default_rng(0)
    com = {body.name: 0.3 * rng.normal(size=3) for body in scene.bodies}
    rough = disturbed(scene, rng, 0.03)
    one = Simulation(assembled(rough), method="rkmk4").sample()
    other = Simulation(assembled(described_elsewhere(rough, com)), method="rkmk4").sample()
    assert other.energy == pytest.approx(one.energy, abs=1e-11)
    np.testing.assert_allclose(other.spatial_momentum, one.spatial_momentum, atol=1e-11)


def test_bodies_without_a_pose_are_placed_by_their_joints():
    scene = load_scene("hinge_chain")
    for i, body in enumerate(scene.bodies):
        np.testing.assert_allclose(body.position, (0.1 * i, 0, 0), atol=1e-15)
        np.testing.assert_allclose(body.rotation, np.eye(3), atol=1e-15)
    # parents that follow their children, and branches
    bodies = [Body(name=name, mass=1, inertia=(1, 1, 1)) for name in "abc"]
    frame, end = Frame(rotation_vector=(0, 0, 0.5)), Frame(position=(1, 0, 0))
    joints = [
        Joint(name="j", type="revolute", parent="c", child="b", parent_frame=end, child_frame=frame),
        Joint(name="k", type="revolute", parent="world", child="b", parent_frame=frame, child_frame=frame),
        Joint(name="l", type="spherical", parent="c", child="a", parent_frame=frame, child_frame=end),
    ]
    tree = Scene(name="t", gravity=(0, 0, 0), assemble=True, bodies=bodies, joints=joints)
    a, b, c = assembled(tree).bodies
    np.testing.assert_allclose(b.pose, np.eye(4), atol=1e-15)
    np.testing.assert_allclose(c.pose @ end.pose, frame.pose, atol=1e-15)
    np.testing.assert_allclose(a.pose @ end.pose, c.pose @ frame.pose, atol=1e-15)


def test_an_omitted_joint_frame_is_the_other_frame_before_assembly():
    text = load_scene("four_bar").text
    scene = scene_from_text(text.replace("    child_frame: {position: [0.5, 0.0, 0.0]}  ", "    # "))
    [_, _, joint, _] = scene.joints
    coupler, rocker = (
        Body(name="b", mass=1, inertia=(1, 1, 1), position=p, rotation_vector=r)
        for p, r in (((0.44, 0.75, 0), (0, 0, 0.5)), ((0.94, 0.5, 0), (0, 0, 1.7)))
    )
    at = np.linalg.inv(rocker.pose) @ coupler.pose @ (0.5, 0, 0, 1)
    np.testing.assert_allclose(joint.child_frame.position, at[:3], atol=1e-15)


def test_pose_guesses_choose_the_assembly_branch():
    text = load_scene("four_bar").text
    below = (
        text.replace("[0.44, 0.75, 0.0]", "[0.1, 0.1, 0.0]")
        .replace("[0.0, 0.0, 0.5] ", "[0.0, 0.0, -1.3]")
        .replace("[0.94, 0.5, 0.0]", "[0.55, -0.25, 0.0]")
        .replace("[0.0, 0.0, 1.7]", "[0.0, 0.0, -2.6]")
    )
    corner = scene_from_text(below).bodies[1].pose @ (0.5, 0, 0, 1)
    # the mirror image of (0.870810, 0.991620) at the line from (0, 0.5) to (1, 0)
    np.testing.assert_allclose(corner[:2], [0.1291901, -0.4916198], atol=1e-6)


def test_any_pose_guess_assembles_or_is_refused_in_one_line():
    rng = np.random.default_rng(3)
    closed = 0
    for name in ("loop of hinges and balls", "net"):
        for _ in range(5):
            try:
                check_consistency(assembled(disturbed(mechanisms.named(name), rng, 1.5)))
                closed += 1
            except SceneError as error:
                assert "\n" not in str(error) and "cannot be assembled" in str(error)
    # random starts half a turn away: most do close
    assert closed >= 5


@pytest.mark.slow
def test_the_same_text_assembles_bit_identically_and_is_preserved():
    text = load_scene("four_bar").text
    one, other = scene_from_text(text), scene_from_text(text)
    assert one.text == text and not one.assemble
    assert repr(one.model_dump()) == repr(other.model_dump())
    for mine, theirs in zip(Simulation(one, method="rkmk4").state(), Simulation(other, method="rkmk4").state()):
        assert mine.tobytes() == theirs.tobytes()
    # A copy with a change is written out with what was found, and says the same to the bit.
    calm = one.model_copy(update={"description": "calm"})
    assert repr(scene_from_text(calm.text).model_dump()) == repr(calm.model_dump())


def test_a_scene_built_in_code_is_assembled_by_simulation():
    joint = {"type": "spherical", "parent_frame": {}, "child_frame": {"position": (0, 0, 1)}}
    scene = mechanisms.one_body(joint, (), (0, 0, -1), assemble=True, position=(0.2, 0.1, 0.9))
    simulation = Simulation(scene, method="rkmk4")
    assert simulation.sample().constraint_residual <= 1e-15
    assert simulation.scene is scene and "assemble: true" in scene.text
    moved = scene_from_text(scene.text)
    assert moved.bodies == simulation.layout.scene.bodies
    simulation.advance(10)
    simulation.reset()
    assert simulation.sample().positions["a"] == pytest.approx(moved.bodies[0].position, abs=1e-15)


def bar_between(distance, **keys):
    """Bar of 1 m, attached by spherical joints to two world points at a distance in m."""
    left = {"name": "left", "type": "spherical", "parent_frame": {"position": (-distance / 2, 0, 0)}}
    scene = mechanisms.one_body(
        left | {"child_frame": {"position": (-0.5, 0, 0)}}, assemble=True, name="bar", inertia=(0.1, 1, 1), **keys
    )
    ends = {"parent_frame": {"position": (distance / 2, 0, 0)}, "child_frame": {"position": (0.5, 0, 0)}}
    return scene.remade(joints=[*scene.joints, scene.joints[0].remade(name="right", **ends)])


def test_an_impossible_loop_is_refused_with_joint_and_gap():
    check_consistency(assembled(bar_between(1.0, position=(0.3, 0.2, 0.1))))
    with pytest.raises(SceneError) as caught:
        assembled(bar_between(1.2, position=(0.01, 0.1, 0)))
    # 0.2 m too long: half of it at each end
    assert re.match(
        r'joints\[[01]\] "(left|right)": cannot be assembled, the remaining constraint '
        r"violation is 0\.1 m and 0 rad; check the lengths",
        str(caught.value),
    )
    with pytest.raises(SceneError, match=r'"left": cannot be assembled, .* is 0\.5 m'):
        assembled(bar_between(1.5, position=(0.25, 0, 0), initial="fixed"))


def test_a_rod_that_is_too_short_says_which_length_is_possible():
    """Two cranks of 0.25 m whose pivots are 1 m apart: their ends come to 0.5 m."""
    crank = (
        "{{name: {0}, type: revolute, parent: world, child: {1}, parent_frame: {{position: [{2}, 0, 0]}}, "
        "child_frame: {{}}}}"
    )
    text = text_of("short_assembly.yaml")
    text = text.replace("CRANK0", crank.format("a", "left", 0)).replace("CRANK1", crank.format("b", "right", 1))
    with pytest.raises(SceneError, match=r'"rod": .*: its length is 0\.3 m, the nearest possible one 0\.5 m'):
        scene_from_text(text)


SLIDER_CRANK = text_of("crank.yaml")


def test_the_nearest_coordinate_of_a_rod_that_is_too_short_assembles():
    """A crank of 0.2 m and a rod of 0.1 m on the line of the slider turn to asin(0.1 / 0.2) = pi / 6.

    Assembly accepts a coordinate that is off by up to 1e-3 rad, and so is the proposed one.
    """
    dead = {"rod": 0.1, "length": 0.3, "axis": ", axis: [0, 1, 0]"}
    with pytest.raises(SceneError, match="the nearest ones: main -0.52") as caught:
        scene_from_text(filled(SLIDER_CRANK, **dead, angle=-0.6))
    near = float(str(caught.value).rpartition("main ")[2])
    assert near == pytest.approx(-math.pi / 6.0, abs=1e-3)
    scene_from_text(filled(SLIDER_CRANK, **dead, angle=near))


def test_a_forgotten_axis_is_said_without_lengths():
    text = filled(SLIDER_CRANK, rod=0.5, length=0.7, angle=-0.6, axis="")
    with pytest.raises(SceneError, match='"small": cannot be assembled') as caught:
        scene_from_text(text)
    assert str(caught.value).endswith(
        "; check the axes in both frames, or start from poses closer to the assembled ones"
    )


def test_an_assembly_error_names_the_line_in_the_file():
    text = load_scene("four_bar").text.replace("{position: [1.0, 0.0, 0.0]}", "{position: [5.0, 0.0, 0.0]}")
    with pytest.raises(SceneError) as caught:
        scene_from_text(text, source="x.yaml")
    line, name = re.match(r'x\.yaml:(\d+): joints\[\d\] "(\w+)": cannot be assembled', str(caught.value)).groups()
    assert f"name: {name}" in text.splitlines()[int(line) - 1]


def test_contradictory_rates_are_refused_with_joint_names():
    text = load_scene("four_bar").text
    twice = text.replace(
        "parent_frame: {position: [1.0, 0.0, 0.0]}", "rate: 1.0\n    parent_frame: {position: [1.0, 0.0, 0.0]}"
    )
    assert twice != text
    with pytest.raises(
        SceneError,
        match=r'x.yaml:\d+: joints\[\d\] "\w+": the given joint velocities and '
        "velocities of fixed bodies contradict each other",
    ):
        scene_from_text(twice, source="x.yaml")
    # the same rate twice is no contradiction: the rocker's is what it is anyway
    rate = load_scene("four_bar").bodies[2].angular_velocity[2]
    check_consistency(scene_from_text(twice.replace("rate: 1.0", f"rate: {rate!r}")))


def test_a_rate_without_assembly_is_refused():
    scene = mechanisms.one_body({"type": "revolute", "child_frame": {}, "rate": 1}, assemble=True)
    with pytest.raises(SceneError, match='joints\\[0\\] "j": rate is only used in assembly: omit it'):
        scene.remade(assemble=False)


def test_bodies_with_an_undetermined_pose_are_named():
    bodies = [Body(name="a", mass=1, inertia=(1, 1, 1), position=(1, 0, 0)), Body(name="b", mass=1, inertia=(1, 1, 1))]
    with pytest.raises(SceneError, match='bodies\\[1\\] "b": cannot be placed: it has no position, no rotation and no'):
        assembled(Scene(name="s", gravity=(0, 0, 0), assemble=True, bodies=bodies))
    joint = Joint(name="j", type="revolute", parent="a", child="b", child_frame=Frame())
    with pytest.raises(
        SceneError, match='joints\\[0\\] "j": must have both frames, because they determine the pose of "b"'
    ):
        assembled(Scene(name="s", gravity=(0, 0, 0), assemble=True, bodies=bodies, joints=[joint]))


@pytest.mark.parametrize("length", [1e-6, 1e6])
def test_assembly_does_not_depend_on_the_length_unit(length):
    """A four-bar in other length units assembles to the same scaled poses, to round-off."""
    found = {}
    for size in (1.0, length):
        problem = problems.length_bars(size)
        simulation = Simulation(problem.scene, method="rkmk4", step=problem.step)
        found[size] = (simulation.layout, simulation.sample())
    (layout, sample), (other, scaled) = found[1.0], found[length]
    assert [joint["dropped"] for joint in describe(layout)["joints"]] == [
        joint["dropped"] for joint in describe(other)["joints"]
    ]
    # Closed to 1e-12 of the length, CLOSED, whatever it is.
    assert scaled.constraint_residual <= 1e-12 * length
    for name, position in sample.positions.items():
        assert np.abs(scaled.positions[name] / length - position).max() <= 1e-11
