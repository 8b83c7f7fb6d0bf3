# SPDX-License-Identifier: Apache-2.0
"""Planar mechanisms move in their plane as in space.

Both are relative coordinates and the same sweeps, but the algebra and the functions of the motion
groups have six numbers for a twist in space and three in the plane. On SE(3)^n see
test/verification/test_relative_accelerations.py.
"""

import engine
import mechanisms
import numpy as np
import precise
import pytest
from scene_files import cases

from liegroup_core import Scene, Simulation, load_scene
from liegroup_core.describe import describe
from liegroup_core.layout import make_layout
from liegroup_core.lie.groups import SO3
from liegroup_core.mechanism.arrays import PlaneModel, RelativeModel
from liegroup_core.scene.description import Body, Drag, Frame, Joint, ScrewJoint, SpringDamper, TorsionalSpringDamper

NORMALS = ("x", "y", "z", "tilted")
# (parent, child, kind), the parents first; then what closes loops
TREES = cases("planar_trees")
LOOPS = {
    "chain with a loop": ("chain", [("world", "d", "spherical")]),
    "chain with a sleeve": ("chain", [("f", "d", "cylindrical")]),
}


def turned(angle):
    """Rotation about z."""
    R = np.eye(3)
    R[0, 0] = R[1, 1] = np.cos(angle)
    R[1, 0] = np.sin(angle)
    R[0, 1] = -R[1, 0]
    return R


def plane_of(normal):
    """Axes of a plane as columns, the normal last."""
    if normal == "tilted":
        return SO3.exp((0.4, -0.7, 1.1))
    return np.eye(3)[:, np.roll(range(3), "zxy".index(normal) * -1)]


def axis_turns(rng):
    """Random rotation that maps axes to axes."""
    R = np.eye(3)[rng.permutation(3)] * rng.choice([-1.0, 1.0], 3)
    return R if np.linalg.det(R) > 0.0 else -R


def mechanism(name, normal, seed=0):
    """Random planar mechanism, with joints and forces outside the plane.

    Body axes are permuted axes of the plane; those of a tilted plane are any.

    Inertias are full, and gravity and springs also act across the plane: joints balance this.
    """
    rng = np.random.default_rng([seed, len(normal), ord(normal[0]) - ord("x") & 3, len(name)])
    tree, loops = LOOPS.get(name, (name, []))
    plane = plane_of(normal)
    n = plane[:, 2]
    poses, frames, joints = {"world": np.eye(4)}, {}, []
    for parent, child, kind in TREES[tree]:
        pose = np.eye(4)
        any_axes = SO3.exp(rng.normal(size=3)) if normal == "tilted" else axis_turns(rng)
        pose[:3, :3] = plane @ turned(rng.uniform(-3.0, 3.0)) @ any_axes
        pose[:3, 3] = rng.normal(size=3)
        poses[child] = pose
        axis = n if kind in ("revolute", "planar") else plane @ turned(1.3)[:, 0]
        frames[child] = Frame(position=0.4 * rng.normal(size=3), axis=pose[:3, :3].T @ axis)
        joints.append(Joint(name=f"to_{child}", type=kind, parent=parent, child=child, child_frame=frames[child]))
    for parent, child, kind in loops:
        frame = Frame(position=0.3 * rng.normal(size=3), axis=poses[child][:3, :3].T @ n)
        joints.append(Joint(name=f"loop_{child}", type=kind, parent=parent, child=child, child_frame=frame))
    del poses["world"]
    bodies = []
    for body, pose in poses.items():
        made = mechanisms.random_body(rng, body, np.eye(4))
        bodies.append(made.remade(position=pose[:3, 3], rotation_vector=SO3.log(pose[:3, :3])))
    ends = {"parent_point": rng.normal(size=3), "child_point": rng.normal(size=3)}
    keys = {"name": "spring", "parent": "world", "child": bodies[-1].name} | ends
    forces = [
        SpringDamper(**keys, stiffness=30.0, damping=0.5, rest_length=0.3),
        Drag(name="drag", body=bodies[0].name, linear=0.3, quadratic=0.1, angular=0.2),
    ]
    forces += [
        TorsionalSpringDamper(name=f"coil_{joint.child}", joint=joint.name, stiffness=2.0, damping=0.1)
        for joint in joints
        if joint.type == "revolute"
    ]
    scene = Scene(name="made", gravity=(3.0, -4.0, 5.0), bodies=bodies, joints=joints, forces=forces)
    return mechanisms.moving(rng, scene)


def both(scene, steps=200, step=1e-3, push=(0.3, -0.2, 0.4, 5.0, -4.0, 3.0), **settings):
    """(simulation in the plane, simulation in space) after the same run.

    Half of the push acts in body axes, half in world axes.
    """
    runs = []
    for space in ("auto", "space"):
        keys = {"method": "rkmk8", "group": "relative"} | settings
        simulation = Simulation(scene, step=step, space=space, **keys)
        for axes in ("body", "world"):
            simulation.apply_wrench(scene.bodies[-1].name, push, source=axes, axes=axes)
        simulation.advance(steps)
        runs.append(simulation)
    assert runs[0].layout.normal is not None
    return runs


def difference(first, second):
    """Largest difference of poses and twists, relative to magnitudes above 1."""
    return max(np.abs(a - b).max() / max(1.0, np.abs(b).max()) for a, b in zip(first.state(), second.state()))


@pytest.mark.parametrize("normal", NORMALS)
@pytest.mark.parametrize("name", [*TREES, *LOOPS])
@pytest.mark.volume(10)
def test_the_motion_is_that_in_space(name, normal):
    """Tolerance: round-off of 1e-16 at 1e3 m/s^2 and condition number 1e2, over 0.2 s.

    Both trees may cut different joints, whose gaps are errors of the method: of order 8 they are
    below round-off.
    """
    scene = mechanism(name, normal)
    planar, space = both(scene)
    assert difference(planar, space) <= 1e-11
    assert np.abs(planar.sample().angles - space.sample().angles).max(initial=0.0) <= 1e-11
    moved = np.abs(planar.state()[0] - Simulation(scene, method="rkmk4").state()[0]).max()
    assert moved > 1e-3
    sizes = {"hinge": 1, "slider": 1, "plate": 3, "chain": 7, "tree": 5}
    tree = LOOPS[name][0] if name in LOOPS else name
    assert int(planar.layout.relative.links["freedoms"].sum()) == sizes[tree]


@pytest.mark.parametrize("settings", cases("every_configuration_has_a_planar_form"))
def test_every_configuration_has_a_planar_form(settings):
    planar, space = both(mechanism("chain with a loop", "z"), **settings)
    assert difference(planar, space) <= 1e-11
    assert planar.substeps == space.substeps


@pytest.mark.parametrize("name", ["tree", "chain", *LOOPS])
@pytest.mark.volume(2)
def test_accelerations_of_unlike_masses_against_50_digits(name):
    """Masses that differ by up to 1e8; bound as in test_relative_accelerations.py."""
    for seed in range(3):
        scene = mechanism(name, "tilted", seed)
        factors = 10.0 ** np.random.default_rng([seed, 5]).uniform(-4, 4, len(scene.bodies))
        bodies = [
            body.remade(mass=body.mass * factor, inertia=np.multiply(factor, body.inertia))
            for body, factor in zip(scene.bodies, factors)
        ]
        scene = scene.remade(bodies=bodies)
        exact = precise.accelerations(scene, [])
        found = engine.engine_accelerations(scene, group="relative")
        size = np.maximum(np.abs(exact.acceleration.astype(float)).max(axis=1), np.linalg.norm(scene.gravity))
        bound = 1e-12 * size + 16.0 * exact.change.max(axis=1)
        assert (precise.errors(exact, found).max(axis=1) <= bound).all()


def test_planar_mechanisms_are_integrated_in_their_plane_unless_in_space():
    scene = load_scene("four_bar")
    models = [
        type(Simulation(scene, method="rkmk8", **keys)._integrator.mechanism[0])
        for keys in ({}, {"space": "space"}, {"group": "se3"})
    ]
    assert models == [PlaneModel, RelativeModel, RelativeModel]


def test_planar_projection_satisfies_the_constraints():
    planar, _ = both(mechanism("chain with a loop", "x"), stabilisation="projection", step=5e-3)
    # Projection stops at 16 2^-52 of the lengths at a joint: places and arms of both bodies.
    distance = 1.0 + np.abs(planar.state()[0][:, 9:]).max()
    assert planar.sample().constraint_residual <= 1e-14 * distance


@pytest.mark.parametrize("normal", ["y", "tilted"])
def test_states_off_the_joints_are_moved_onto_them(normal):
    """Bodies that were moved and tilted out of the plane are in it again after a step."""
    simulation = Simulation(mechanism("tree", normal), method="rkmk4")
    pose, twist = simulation.state()
    tilt = SO3.exp((1e-3, 2e-3, -1e-3))
    pose[-1, 9:] += 0.05
    pose[1, :9] = (tilt @ pose[1, :9].reshape(3, 3)).ravel()
    twist[2] += 0.1
    simulation.set_state(pose, twist)
    simulation.advance(1)
    sample = simulation.sample()
    assert sample.constraint_residual <= 1e-14
    n = plane_of(normal)[:, 2]
    spins = np.einsum("nij,nj->ni", sample.pose_matrices[:, :3, :3], sample.twist[:, :3])
    assert np.abs(np.cross(spins, n)).max() <= 1e-14 * np.abs(spins).max()


@pytest.mark.parametrize("normal", ["y", "tilted"])
@pytest.mark.parametrize("name", TREES)
def test_trees_stay_closed_to_round_off(name, normal):
    simulation = Simulation(mechanism(name, normal), method="rkmk4", step=0.01)
    simulation.advance(200)
    assert simulation.group == "relative"
    # Poses follow from the joints anew in every step: only the round-off of one step is left.
    distance = 1.0 + np.abs(simulation.state()[0][:, 9:]).max()
    assert simulation.sample().constraint_residual <= 1e-14 * distance


def test_out_of_plane_components_stay_zero():
    """A normal along a world axis and axes of the bodies: no round-off leaves the plane."""
    simulation = Simulation(mechanism("chain", "z"), method="rkmk4")
    simulation.advance(1)
    heights = simulation.sample().pose_matrices[:, 2, 3]
    simulation.advance(100)
    sample = simulation.sample()
    normals = np.abs(sample.pose_matrices[:, 2, :3])
    assert (np.sort(normals, axis=1) == (0.0, 0.0, 1.0)).all()
    assert (sample.pose_matrices[:, 2, 3] == heights).all()


def test_slides_alone_have_a_normal_across_them():
    def rails(*directions):
        bodies = [Body(name=f"b{k}", mass=1, inertia=(1, 1, 1)) for k in range(len(directions))]
        joints, parent = [], "world"
        for body, axis in zip(bodies, directions):
            ends, parent = {"parent": parent, "child": body.name}, body.name
            joints.append(Joint(name=f"to_{parent}", type="prismatic", child_frame=Frame(axis=axis), **ends))
        return make_layout(Scene(name="rails", gravity=(0, 0, -9.81), bodies=bodies, joints=joints)).normal

    assert (rails((1, 0, 0)) == (0, 0, 1)).all() and (rails((0, 0, 1)) == (0, 1, 0)).all()
    for first, second in (((1, 2, 3), (3, -1, 0.5)), ((1, 2, 3), (1, 2, 3))):
        normal = rails(first, second)
        assert np.abs(normal @ np.transpose([first, second])).max() <= 1e-14
    assert rails((1, 0, 0), (0, 1, 0), (0, 0, 1)) is None


def hinged(axis, **body):
    """Scene of one body on a revolute joint about `axis`, or on another joint."""
    joint = {"type": "revolute", "child_frame": {"position": (-0.5, 0, 0), "axis": axis}}
    keys = {"position": (0.5, 0, 0), "inertia": (0.1, 0.2, 0.3)} | body
    return mechanisms.one_body(joint, (), (0, 0, -9.81), **keys)


def test_detection_of_planar_mechanisms():
    def plane(scene):
        return make_layout(scene).normal

    assert plane(hinged((0, 1, 0))) is not None
    # axes that are not those of the world, or not those of the body; either direction
    assert plane(hinged((0.6, 0.8, 0))) == pytest.approx((0.6, 0.8, 0), abs=1e-15)
    assert plane(hinged((0.6, -0.8, 0))) == pytest.approx((-0.6, 0.8, 0), abs=1e-15)
    tilted = hinged((0, 0.8, 0.6), rotation_vector=(np.arctan2(0.6, 0.8), 0, 0))
    assert plane(tilted) == pytest.approx((0, 0.28, 0.96), abs=1e-15)
    # axes that are not quite parallel
    scene = hinged((0, 1, 0))
    second = scene.bodies[0].model_copy(update={"name": "b"})
    for axis, planar in (((0, -1, 0), True), ((0, 1, 1e-6), False)):
        keys = {"name": "k", "parent": "a", "child": "b", "child_frame": Frame(axis=axis)}
        joint = scene.joints[0].model_copy(update=keys)
        pair = {"bodies": (*scene.bodies, second), "joints": (*scene.joints, joint)}
        assert (plane(scene.model_copy(update=pair)) is not None) == planar
    # joints that would let it out
    for name in ("spherical", "cylindrical"):
        scene = hinged((0, 1, 0))
        joint = scene.joints[0].model_copy(update={"type": name})
        assert plane(scene.model_copy(update={"joints": (joint,)})) is None
    at = Frame(position=(-0.5, 0, 0), axis=(0, 1, 0))
    screw = ScrewJoint(name="j", parent="world", child="a", pitch=0.1, child_frame=at)
    assert plane(hinged((0, 1, 0)).model_copy(update={"joints": (screw,)})) is None
    assert plane(load_scene("heavy_top")) is None and plane(load_scene("free_body")) is None
    assert plane(load_scene("ball_chain")) is None and plane(load_scene("bricard")) is None


@pytest.mark.parametrize("name", ["double_pendulum", "hinge_chain", "four_bar", "n_four_bar", "andrews_squeezer"])
def test_planar_example_scenes_are_detected_and_agree_with_space(name):
    planar, space = both(load_scene(name), steps=100, step=1e-4, push=np.zeros(6))
    assert difference(planar, space) <= 1e-11


def test_redundant_planar_constraints_are_eliminated():
    """Parallelogram with a third crank: 4 bars of 3 scalars, 12 rows of rank 11, one DOF."""
    bodies = [mechanisms.bar(f"crank{x}", (x, 0), (x + 0.3, 0.8)) for x in range(3)]
    bodies.append(mechanisms.bar("coupler", (0.3, 0.8), (2.3, 0.8)))
    foot = -0.5 * np.hypot(0.3, 0.8)
    joints = [mechanisms.hinge(f"foot{x}", "world", f"crank{x}", foot) for x in range(3)]
    joints += [mechanisms.hinge(f"head{x}", f"crank{x}", "coupler", x - 1.0) for x in range(3)]
    scene = Scene(name="three_cranks", gravity=(0, -9.81, 0), bodies=bodies, joints=joints)
    # Four hinges are the tree; of the two rows of each of the others one is redundant.
    assert len(make_layout(scene).relative.row_residual) == 2 * 2 - 1
    planar, space = both(scene, steps=300, push=np.zeros(6))
    # It falls as a pendulum of its own: w^2 (3 m l^2/3 + m l^2) / 2 = g (3 m/2 + m) drop.
    angle = np.arctan2(0.8, 0.3)
    turned = np.arctan2(*planar.sample().pose_matrices[0, 1::-1, 0])
    drop = np.hypot(0.3, 0.8) * (np.sin(angle) - np.sin(turned))
    length = np.hypot(0.3, 0.8)
    inertia = length**2 + length**2
    rate = np.sqrt(2 * 9.81 * (3 / 2 + 1) * drop / inertia)
    # RKMK4 at 1e-3 s: local errors of 1e-15 relative, 300 of them, and drift as small
    assert abs(planar.sample().twists["crank0"][2]) == pytest.approx(rate, rel=1e-9)
    assert difference(planar, space) <= 1e-9


def test_describe_names_the_plane():
    assert describe(make_layout(load_scene("four_bar")))["plane"] == "z"
    assert describe(make_layout(hinged((0.6, 0.8, 0))))["plane"] == "0.6 0.8 0"
    assert describe(make_layout(load_scene("heavy_top")))["plane"] is None
