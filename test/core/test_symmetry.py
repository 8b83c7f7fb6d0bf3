# SPDX-License-Identifier: Apache-2.0
"""`conserved_momentum` lists the conserved components, and no others are conserved.

Checked along integrations of `liegroup_core.reference`, which does not use symmetries. Runs last
1.5 s at several rad/s; the reference is accurate to about 1e-11 for values of size 10.
"""

import numpy as np
import pytest
from scene_files import filled, text_of

from liegroup_core import Simulation, load_scene
from liegroup_core.mechanism.body_model import initial_state
from liegroup_core.mechanism.symmetry import conserved_momentum
from liegroup_core.observables.invariants import momentum_values
from liegroup_core.reference import integrate
from liegroup_core.scene.description import Body, Frame, Joint, Scene, SpringDamper
from liegroup_core.scene.load import scene_from_text

G = (0.0, 0.0, -9.81)
KEPT = 1e-9  # 1e-11 of values of size 10 to 100
SPOILT = 1e-4  # what is not kept changes by far more within 1.5 s


def body(name="a", position=(0.3, -0.2, 0.4), pivot=None, axis=None):
    """Body with a generic motion, consistent with a spherical or revolute joint at `pivot`."""
    turn = np.array(axis if axis is not None else (0.7, -1.1, 1.9))
    speed = np.cross(turn, np.subtract(position, pivot)) if pivot is not None else (0.5, 0.2, -0.3)
    return Body(
        name=name, mass=2.0, inertia=(0.05, 0.08, 0.11), position=position, angular_velocity=turn, linear_velocity=speed
    )


def ball(pivot, child="a", parent="world"):
    return Joint(name=f"ball_{child}", type="spherical", parent=parent, child=child, parent_frame=Frame(position=pivot))


def hinge(pivot, axis):
    at = Frame(position=pivot, axis=axis)
    return Joint(name="hinge_a", type="revolute", parent="world", child="a", parent_frame=at)


def spring(place, at=(0.0, 0.0, 0.0), rest=0.0, damping=0.0, child="a", parent="world"):
    ends = {"parent": parent, "parent_point": place, "child": child, "child_point": at}
    return SpringDamper(name=f"spring_{child}", stiffness=60.0, damping=damping, rest_length=rest, **ends)


def scene(bodies, joints=(), forces=(), gravity=G):
    return Scene(name="case", gravity=gravity, bodies=bodies, joints=joints, forces=forces)


PIVOT = (0.1, 0.2, -0.1)
TOP = body(pivot=PIVOT)
FIELD = 60.0 * np.subtract((0.5, 0.9, 0.3), PIVOT) + 2.0 * np.array(G)
CHAIN = [body("a", (0.3, 0.0, 0.0), (0.0, 0.0, 0.0)), body("b", (0.9, 0.0, 0.0), (0.0, 0.0, 0.0))]

# name: (scene, [(point or None for the centre of mass, angular directions, linear directions)])
CASES = {
    "free in space": (scene([body()], gravity=(0, 0, 0)), [(None, np.eye(3), np.eye(3))]),
    "free in gravity": (scene([body()]), [(None, np.eye(3), np.eye(3)[:2])]),
    "free pair with spring and damper": (
        scene([body("a"), body("b", (1, 0, 0))], forces=[spring((0.1, 0, 0), (0, 0.1, 0), 0.4, 0.5, "b", "a")]),
        [(None, np.eye(3), np.eye(3)[:2])],
    ),
    "top": (scene([TOP], [ball(PIVOT)]), [(PIVOT, [(0, 0, 1)], [])]),
    "top without gravity": (scene([TOP], [ball(PIVOT)], gravity=(0, 0, 0)), [(PIVOT, np.eye(3), [])]),
    "top, spring without rest length to its centre": (
        scene([TOP], [ball(PIVOT)], [spring((0.5, 0.9, 0.3))]),
        [(PIVOT, [FIELD], [])],
    ),
    "top, such a spring elsewhere on it": (
        scene([TOP], [ball(PIVOT)], [spring((0.5, 0.9, 0.3), (0.1, 0.2, 0.05))]),
        [],
    ),
    "top, such a spring elsewhere, to a point above the pivot": (
        scene([TOP], [ball(PIVOT)], [spring((0.1, 0.2, 0.7), (0.1, 0.2, 0.05))]),
        [(PIVOT, [(0, 0, 1)], [])],
    ),
    "top, spring with rest length": (scene([TOP], [ball(PIVOT)], [spring((0.5, 0.9, 0.3), rest=0.2)]), []),
    "top, spring with rest length and damper above the pivot": (
        scene([TOP], [ball(PIVOT)], [spring((0.1, 0.2, 0.7), rest=0.2, damping=0.4)]),
        [(PIVOT, [(0, 0, 1)], [])],
    ),
    "top, damped spring to a point beside the pivot": (
        scene([TOP], [ball(PIVOT)], [spring((0.5, 0.9, 0.3), damping=0.4)]),
        [],
    ),
    "upright hinge": (
        scene([body(pivot=PIVOT, axis=(0, 0, 1.5))], [hinge(PIVOT, (0, 0, 1))]),
        [(PIVOT, [(0, 0, 1)], [])],
    ),
    "lying hinge off the centre": (scene([body(pivot=PIVOT, axis=(0, 1.5, 0))], [hinge(PIVOT, (0, 1, 0))]), []),
    "lying hinge through the centre": (
        scene([body(position=(0.1, 0.5, -0.1), pivot=PIVOT, axis=(0, 1.5, 0))], [hinge(PIVOT, (0, 1, 0))]),
        [(PIVOT, [(0, 1, 0)], [])],
    ),
    "free body, spring to its centre": (
        scene([body()], forces=[spring((0.5, 0.9, 0.3))]),
        [(None, np.eye(3), []), (np.add((0.5, 0.9, 0.3), np.array(G) * 2.0 / 60.0), np.eye(3), [])],
    ),
    "free body, spring with rest length": (
        scene([body()], forces=[spring((0.5, 0.9, 0.3), (0.1, 0.2, 0.05), 0.2)]),
        [((0.5, 0.9, 0.3), [(0, 0, 1)], [])],
    ),
    "two balls in a chain": (
        scene(CHAIN, [ball((0, 0, 0)), ball((0.3, 0, 0), "b", "a")]),
        [((0, 0, 0), [(0, 0, 1)], [])],
    ),
    "two separate tops": (
        scene([TOP, body("b", (1.0, 0.0, 0.0), (0.8, 0.3, 0.1))], [ball(PIVOT), ball((0.8, 0.3, 0.1), "b")]),
        [(PIVOT, [(0, 0, 1)], []), ((0.8, 0.3, 0.1), [(0, 0, 1)], [])],
    ),
}


def motion(case):
    return integrate(case, *initial_state(case), np.linspace(0.0, 1.5, 151))[0]


@pytest.mark.parametrize("name", CASES)
def test_expected_components_are_named(name):
    """Exactly the expected points and directions; the last case has one entry per group."""
    case, expected = CASES[name]
    kept = conserved_momentum(case)
    assert len(kept) == len(expected)
    for found, (point, angular, linear) in zip(kept, expected):
        angular = np.reshape(angular, (-1, 3)) / np.reshape(
            np.linalg.norm(np.reshape(angular, (-1, 3)), axis=1), (-1, 1)
        )
        assert (found.point is None) == (point is None)
        assert found.angular == pytest.approx(angular, abs=1e-9)
        assert found.linear == pytest.approx(np.reshape(linear, (-1, 3)), abs=1e-9)
        assert len(found.labels) == len(found.units) == len(angular) + len(found.linear)
        if point is not None and len(angular) == 1:  # any point of the axis would do
            assert np.cross(found.point - np.array(point), angular[0]) == pytest.approx(np.zeros(3), abs=1e-9)
        elif point is not None:
            assert found.point == pytest.approx(np.array(point), abs=1e-9)


@pytest.mark.parametrize("name", CASES)
@pytest.mark.volume(8)
def test_named_components_are_conserved(name):
    case, _ = CASES[name]
    run = motion(case)
    for kept in conserved_momentum(case):
        values = momentum_values(case, kept, run.rotation, run.position, run.twist)
        assert values.shape == (151, len(kept.labels))
        assert np.abs(values - values[0]).max() <= KEPT


@pytest.mark.parametrize(
    "name", [name for name, (_, kept) in CASES.items() if len(kept) <= 1 and not (kept and kept[0][0] is None)]
)
@pytest.mark.volume(6)
def test_no_other_component_is_conserved(name):
    """Of all combinations xi . L + eta . P only the listed ones are constant: the others span 6 - k.

    L and P are recorded about the world origin; their changes from the mean are a matrix whose
    null space are the kept combinations of this motion. Hinges are left with those that a plane
    motion keeps by itself, so they are only checked along their own axis.
    """
    case, expected = CASES[name]
    run = motion(case)
    mass = np.array([b.mass for b in case.bodies])
    inertia = np.array([b.inertia_matrix for b in case.bodies])
    linear = mass[:, None] * np.einsum("knij,knj->kni", run.rotation, run.twist[..., 3:])
    angular = np.einsum("knij,njl,knl->kni", run.rotation, inertia, run.twist[..., :3])
    momentum = np.concatenate([(angular + np.cross(run.position, linear)).sum(axis=1), linear.sum(axis=1)], axis=1)
    count = sum(len(np.reshape(angular, (-1, 3))) for _, angular, _ in expected)
    if any(joint.type == "revolute" for joint in case.joints):
        axis = case.joints[0].parent_frame.rotation[:, 2]
        along = momentum @ np.concatenate([axis, np.cross(PIVOT, axis)])
        assert (np.ptp(along) <= KEPT) == (count == 1)
        assert count == 1 or np.ptp(along) > SPOILT
        return
    values = np.linalg.svd(momentum - momentum.mean(axis=0))[1]
    assert (values <= 20 * KEPT).sum() == count  # sqrt(151) samples
    assert (values > SPOILT).sum() == 6 - count


MOVING = "linear_velocity: [0.3, 0.2, 0], angular_velocity: [0, 0, 0.4]}"
FREE = (None, np.eye(3), np.eye(3)[:2])
WHEEL = "{name: w, mass: 1, inertia: [0.02, 0.02, 0.03], position: [0.2, 0, 0]}"
ROPE = "parent: world, child: base, parent_frame: {position: [0, 0, 1]}, child_frame: {}"
RAIL = "{name: rail, type: prismatic, parent: world, child: base, parent_frame: {axis: [1, 0, 0]}}"
AXLE = "parent: world, child: base, parent_frame: {}"
HINGE = "parent: base, child: w, parent_frame: {position: [0.1, 0, 0]}"
PLANE = "parent: base, child: w, parent_frame: {position: [0.1, 0, -0.05]}"
# name: (joints of `base` and `w`, further text, expected as in CASES)
BETWEEN = {
    "stops": (f"{{name: h, type: revolute, {HINGE}, rate: 2, limits: {{lower: -0.2, upper: 0.2}}}}", "", [FREE]),
    "friction": (f"{{name: h, type: revolute, {HINGE}, rate: 2, friction: {{coulomb: 0.03}}}}", "", [FREE]),
    "rotor": (f"{{name: h, type: revolute, {HINGE}, rate: 2, rotor: {{inertia: 0.1}}}}", "", [FREE]),
    "drive": (f"{{name: h, type: revolute, {HINGE}, rate: 2, driven: true}}", "", [FREE]),
    "universal joint": (f"{{name: h, type: universal, {HINGE}}}", "", [FREE]),
    "cable": (f"{{name: h, type: cable, {HINGE}, child_frame: {{}}, length: 0.2}}", "", [FREE]),
    "rod": (f"{{name: h, type: distance, {HINGE}, child_frame: {{}}}}", "", [FREE]),
    "wheel": (f"{{name: h, type: ball_on_plane, {PLANE}, child_frame: {{}}, radius: 0.05}}", "", [FREE]),
    "coupling": (
        f"{{name: h, type: revolute, {HINGE}, rate: 2}}, "
        "{name: g, type: revolute, parent: base, child: v, parent_frame: {position: [-0.2, 0, 0]}}",
        "couplings: [{name: c, joint: g, other: h, ratio: -2}]",
        [FREE],
    ),
    "crane": (
        f"{RAIL}, {{name: h, type: cable, {HINGE}, child_frame: {{}}, length: 0.2}}",
        "",
        [((0, 0, 0), [], [(1, 0, 0)])],
    ),
    "cable to the ground": (f"{{name: r, type: cable, {ROPE}, length: 1}}", "", [((0, 0, 1), [(0, 0, 1)], [])]),
    "rod to the ground": (f"{{name: r, type: distance, {ROPE}}}", "", [((0, 0, 1), [(0, 0, 1)], [])]),
    "friction on the ground": (f"{{name: r, type: revolute, {AXLE}, friction: {{coulomb: 0.1}}}}", "", []),
    "rotor on the ground": (
        f"{{name: r, type: revolute, {AXLE}, rotor: {{inertia: 1}}}}, {{name: h, type: revolute, {HINGE}, rate: 2}}",
        "",
        [],
    ),
}


@pytest.mark.parametrize("name", BETWEEN)
def test_what_acts_between_bodies_conserves_their_momentum(name):
    """By Newton's third law; on the ground the same element adds or removes angular momentum along its axis."""
    joints, more, expected = BETWEEN[name]
    bodies = ["{name: base, mass: 2, inertia: [0.03, 0.05, 0.04], position: [0, 0, 0], " + MOVING]
    bodies += [WHEEL] * ("child: w" in joints) + [WHEEL.replace("name: w", "name: v")] * ("child: v" in joints)
    text = f"bodies: [{', '.join(bodies)}]\njoints: [{joints}]\n{more}\n"
    case = scene_from_text(f"name: case\ngravity: [0, 0, -9.81]\nassemble: true\n{text}")
    kept = conserved_momentum(case)
    assert len(kept) == len(expected)
    simulation = Simulation(case, accuracy=1e-9, quiet=True)
    samples = []
    for time in np.linspace(0.0, 1.0, 21):
        simulation.advance_to(time)
        samples.append(simulation.sample())
    pose, twist = np.array([s.pose_matrices for s in samples]), np.array([s.twist for s in samples])
    for found, (point, angular, linear) in zip(kept, expected):
        assert (found.point is None) == (point is None)
        assert found.angular == pytest.approx(np.reshape(angular, (-1, 3)), abs=1e-9)
        assert found.linear == pytest.approx(np.reshape(linear, (-1, 3)), abs=1e-9)
        if len(angular) == 1:
            assert found.point == pytest.approx(np.array(point), abs=1e-9)
        values = momentum_values(case, found, pose[..., :3, :3], pose[..., :3, 3], twist)
        assert np.abs(values - values[0]).max() <= KEPT
    if not expected:
        spin = np.array([s.spatial_momentum[2] for s in samples])
        assert np.ptp(spin) > SPOILT


def test_conserved_momentum_of_the_example_scenes():
    """Heavy top: along k p0 + m g = (1e4, 0, 4788.104) N about the pivot at the origin."""
    field = np.array([1e4, 0.0, 1e4 * 0.5 - 21.6 * 9.81])
    (heavy,) = conserved_momentum(load_scene("heavy_top"))
    assert heavy.bodies == ("top",)
    assert heavy.point == pytest.approx(np.zeros(3), abs=1e-12)
    assert heavy.angular[0] == pytest.approx(field / np.linalg.norm(field), abs=1e-12)
    assert heavy.labels == ("angular momentum about (0, 0, 0) along (0.9019, 0, 0.4319)",)
    (lagrange,) = conserved_momentum(load_scene("lagrangian_top"))
    assert lagrange.angular == pytest.approx(np.array([[0, 0, 1]]), abs=1e-12)
    (free,) = conserved_momentum(load_scene("free_body"))
    assert free.point is None and len(free.angular) == len(free.linear) == 3
    assert conserved_momentum(load_scene("double_pendulum")) == ()


def test_values_agree_with_the_sample():
    """momentum_values against Sample.spatial_momentum, components and centre of mass apart."""
    case, _ = CASES["free pair with spring and damper"]
    simulation = Simulation(case)
    simulation.advance(100)
    sample = simulation.sample()
    (kept,) = conserved_momentum(case)
    poses = sample.pose_matrices[None]
    values = momentum_values(case, kept, poses[..., :3, :3], poses[..., :3, 3], sample.twist[None])
    centre = poses[0, :, :3, 3].mean(axis=0)  # the two masses are equal
    L, P = sample.spatial_momentum[:3], sample.spatial_momentum[3:]
    assert values[0] == pytest.approx([*(L - np.cross(centre, P)), P[0], P[1]], abs=1e-12)


@pytest.mark.parametrize("friction, count", [(0.0, 2), (0.5, 0)])
def test_a_plane_conserves_what_is_across_its_normal_without_friction(friction, count):
    """It touches at few of the generic poses. Horizontal momentum and the angular one along the normal are kept."""
    text = filled(text_of("thrown_symmetry.yaml"), friction=friction)
    labels = [label for one in conserved_momentum(scene_from_text(text, "test")) for label in one.labels]
    linear = ["linear momentum along (1, 0, 0)", "linear momentum along (0, 1, 0)"][:count]
    assert sorted(label for label in labels if label.startswith("linear")) == sorted(linear)
    angular = [label for label in labels if label.startswith("angular")]
    assert len(angular) == count / 2 and all(label.endswith("along (0, 0, 1)") for label in angular)
