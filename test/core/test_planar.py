# SPDX-License-Identifier: Apache-2.0
"""Planar mechanisms integrated in their plane have the same motion as in space.

In space the equations have six scalars per body; this code shares neither joint rows nor Lie group
with the planar one.
"""

import mechanisms
import numpy as np
import pytest

from liegroup_core import Scene, Simulation, load_scene
from liegroup_core.describe import describe
from liegroup_core.layout import make_layout
from liegroup_core.lie.groups import SO3
from liegroup_core.scene.description import (
    Body,
    Drag,
    Frame,
    Joint,
    ScrewJoint,
    SpringDamper,
    TorsionalSpringDamper,
)

NORMALS = {"x": 0, "y": 1, "z": 2}
GROUPS = ("se3", "so3xr3")
# (parent, child, kind), the parents first; then what closes loops
TREES = {
    "hinge": [("world", "a", "revolute")],
    "slider": [("world", "a", "prismatic")],
    "plate": [("world", "a", "planar")],
    "chain": [
        ("world", "a", "revolute"),
        ("a", "b", "revolute"),
        ("b", "c", "prismatic"),
        ("c", "d", "fixed"),
        ("a", "e", "planar"),
        ("e", "f", "revolute"),
    ],
    # Without a plate: solved as articulated bodies.
    "tree": [
        ("world", "a", "prismatic"),
        ("a", "b", "revolute"),
        ("b", "c", "prismatic"),
        ("c", "d", "fixed"),
        ("a", "e", "revolute"),
        ("e", "f", "revolute"),
    ],
}
LOOPS = {
    "chain with a loop": ("chain", [("world", "d", "spherical")]),
    "chain with a sleeve": ("chain", [("f", "d", "cylindrical")]),
}


def turned_about(normal, angle):
    """Rotation about a world axis; the entries of the axis are exact."""
    R = np.eye(3)
    i, j = (normal + 1) % 3, (normal + 2) % 3
    R[i, i] = R[j, j] = np.cos(angle)
    R[j, i] = np.sin(angle)
    R[i, j] = -R[j, i]
    return R


def axis_turns(rng):
    """Random rotation that maps axes to axes."""
    R = np.eye(3)[rng.permutation(3)] * rng.choice([-1.0, 1.0], 3)
    return R if np.linalg.det(R) > 0.0 else -R


def mechanism(name, normal, seed=0):
    """Random planar mechanism: permuted body axes, joints and forces outside the plane.

    Inertias are full, and gravity and springs also act across the plane: joints balance this.
    """
    rng = np.random.default_rng([seed, normal, len(name)])
    tree, loops = LOOPS.get(name, (name, []))
    n = np.eye(3)[normal]
    poses, frames, joints = {"world": np.eye(4)}, {}, []
    for parent, child, kind in TREES[tree]:
        pose = np.eye(4)
        pose[:3, :3] = turned_about(normal, rng.uniform(-3.0, 3.0)) @ axis_turns(rng)
        pose[:3, 3] = rng.normal(size=3)
        poses[child] = pose
        axis = (
            n
            if kind in ("revolute", "planar")
            else turned_about(normal, 1.3) @ np.eye(3)[(normal + 1) % 3]
        )
        frames[child] = Frame(position=0.4 * rng.normal(size=3), axis=pose[:3, :3].T @ axis)
        joints.append(
            Joint(
                name=f"to_{child}", type=kind, parent=parent, child=child, child_frame=frames[child]
            )
        )
    for parent, child, kind in loops:
        joints.append(
            Joint(
                name=f"loop_{child}",
                type=kind,
                parent=parent,
                child=child,
                child_frame=Frame(
                    position=0.3 * rng.normal(size=3), axis=poses[child][:3, :3].T @ n
                ),
            )
        )
    del poses["world"]
    bodies = []
    for body, pose in poses.items():
        made = mechanisms.random_body(rng, body, np.eye(4))
        bodies.append(
            made.model_copy(
                update={
                    "position": tuple(pose[:3, 3]),
                    "rotation_vector": tuple(SO3.log(pose[:3, :3])),
                }
            )
        )
    forces = [
        SpringDamper(
            name="spring",
            parent="world",
            child=bodies[-1].name,
            parent_point=rng.normal(size=3),
            child_point=rng.normal(size=3),
            stiffness=30.0,
            damping=0.5,
            rest_length=0.3,
        ),
        Drag(name="drag", body=bodies[0].name, linear=0.3, quadratic=0.1, angular=0.2),
    ]
    forces += [
        TorsionalSpringDamper(
            name=f"coil_{joint.child}", joint=joint.name, stiffness=2.0, damping=0.1
        )
        for joint in joints
        if joint.type == "revolute"
    ]
    scene = Scene(
        name="made", gravity=(3.0, -4.0, 5.0), bodies=bodies, joints=joints, forces=forces
    )
    return mechanisms.moving(rng, scene)


def both(scene, steps=200, step=1e-3, push=(0.3, -0.2, 0.4, 5.0, -4.0, 3.0), **settings):
    """(simulation in the plane, simulation in space) after the same run."""
    runs = []
    for space in ("auto", "space"):
        simulation = Simulation(scene, step=step, space=space, **{"method": "rkmk4"} | settings)
        simulation.apply_wrench(scene.bodies[-1].name, push)
        simulation.advance(steps)
        runs.append(simulation)
    assert runs[0].layout.plane is not None
    return runs


def difference(first, second):
    """Largest difference of poses and twists, relative to magnitudes above 1."""
    return max(
        np.abs(a - b).max() / max(1.0, np.abs(b).max())
        for a, b in zip(first.state(), second.state())
    )


@pytest.mark.parametrize("group", GROUPS)
@pytest.mark.parametrize("normal", NORMALS)
@pytest.mark.parametrize("name", [*TREES, *LOOPS])
def test_the_motion_is_that_in_space(name, normal, group):
    """Tolerance: round-off of 1e-16 at 1e3 m/s^2 and condition number 1e2, over 0.2 s."""
    planar, space = both(mechanism(name, NORMALS[normal]), group=group)
    assert difference(planar, space) <= 1e-11
    assert np.abs(planar.sample().angles - space.sample().angles).max(initial=0.0) <= 1e-11
    assert (len(planar.layout.plane.links) > 0) == (name in ("hinge", "slider", "tree"))
    moved = np.abs(planar.state()[0] - Simulation(planar.scene, method="rkmk4").state()[0]).max()
    assert moved > 1e-3


@pytest.mark.parametrize(
    "settings",
    [
        {"method": "rkmk54", "rtol": 1e-9, "atol": 1e-9},
        {"method": "rkmk8"},
        {"dexpinv": "truncated"},
        {"stabilisation": "projection"},
    ],
)
def test_every_configuration_has_a_planar_form(settings):
    planar, space = both(mechanism("chain with a loop", 2), **settings)
    assert difference(planar, space) <= 1e-11
    assert planar.substeps == space.substeps


def test_extreme_mass_ratios_use_the_saddle_point_solve():
    scene = mechanism("tree", 2)
    heavy = scene.bodies[-1].model_copy(
        update={"mass": 1e6, "inertia": tuple(1e6 * value for value in scene.bodies[-1].inertia)}
    )
    plane = make_layout(scene.model_copy(update={"bodies": (*scene.bodies[:-1], heavy)})).plane
    assert len(plane.links) == 0 and plane.refinements == 1


def test_planar_projection_satisfies_the_constraints():
    planar, _ = both(mechanism("chain with a loop", 0), stabilisation="projection", step=5e-3)
    assert planar.sample().constraint_residual <= 1e-14


def test_projection_removes_gaps_along_the_normal_too():
    simulation = Simulation(mechanism("tree", 1), method="rkmk4", stabilisation="projection")
    pose, twist = simulation.state()
    pose[-1, 10] += 0.05
    simulation.set_state(pose, twist)
    simulation.advance(5)
    assert simulation.sample().constraint_residual <= 1e-14


@pytest.mark.parametrize("name", ["hinge", "slider", "plate"])
def test_pairs_to_ground_stay_closed_to_round_off(name):
    simulation = Simulation(mechanism(name, 1), method="rkmk4", step=0.01)
    simulation.advance(1000)
    assert simulation.layout.plane is not None
    # Every step adds to the place, rounded to 1e-16 of it: a random walk of 1000 steps is 30 of
    # them long, and one in a hundred three times as long.
    distance = 1.0 + np.abs(simulation.state()[0][:, 9:]).max()
    assert simulation.sample().constraint_residual <= 1e-14 * distance


def test_a_planar_run_does_not_depend_on_the_advance_calls():
    """Conversions between plane and space at the ends of calls are bit-identical."""
    scene = mechanism("chain with a loop", 0)
    runs = [
        Simulation(scene, group=group, method=method)
        for group in GROUPS
        for method in ("rkmk4", "rkmk54")
    ]
    for run in runs:
        whole = Simulation(scene, group=run.group, method=run.method)
        whole.advance(30)
        for _ in range(30):
            run.advance(1)
        assert all((a == b).all() for a, b in zip(whole.state(), run.state()))


def test_out_of_plane_components_stay_zero():
    simulation = Simulation(mechanism("chain", 2), method="rkmk4")
    simulation.advance(100)
    sample = simulation.sample()
    normals = np.abs(sample.pose_matrices[:, 2, :3])
    assert (np.sort(normals, axis=1) == (0.0, 0.0, 1.0)).all()
    assert (
        sample.pose_matrices[:, 2, 3]
        == Simulation(simulation.scene, method="rkmk4").sample().pose_matrices[:, 2, 3]
    ).all()


def test_an_out_of_plane_state_is_integrated_in_space():
    scene = mechanism("hinge", 2)
    runs = [Simulation(scene, method="rkmk4", space=space) for space in ("auto", "space")]
    pose, twist = runs[0].state()
    tilt = SO3.exp((1e-9, 0.0, 0.0))
    pose[0, :9] = (tilt @ pose[0, :9].reshape(3, 3)).ravel()
    for run in runs:
        run.set_state(pose, twist)
        run.advance(20)
    assert all((a == b).all() for a, b in zip(runs[0].state(), runs[1].state()))
    assert np.abs(runs[0].state()[0][0, :9].reshape(3, 3)[2]).min() > 0.0


def hinged(axis, **body):
    """Scene of one body on a revolute joint about `axis`, or on another joint."""
    keys = {"position": (0.5, 0, 0)} | body
    return Scene(
        name="hinged",
        gravity=(0, 0, -9.81),
        bodies=[Body(name="a", mass=1.0, inertia=(0.1, 0.2, 0.3), **keys)],
        joints=[
            Joint(
                name="j",
                type="revolute",
                parent="world",
                child="a",
                child_frame=Frame(position=(-0.5, 0, 0), axis=axis),
            )
        ],
    )


def test_scenes_not_confined_to_a_coordinate_plane_are_integrated_in_space():
    def plane(scene):
        return make_layout(scene).plane

    assert plane(hinged((0, 1, 0))) is not None
    # axes that are not those of the world, or not those of the body
    assert plane(hinged((0, 1, 1e-6))) is None
    assert plane(hinged((0.6, 0.8, 0))) is None
    assert plane(hinged((0, 0.8, 0.6), rotation_vector=(np.arctan2(0.6, 0.8), 0, 0))) is None
    # joints that would let it out
    for name in ("spherical", "cylindrical"):
        scene = hinged((0, 1, 0))
        joint = scene.joints[0].model_copy(update={"type": name})
        assert plane(scene.model_copy(update={"joints": (joint,)})) is None
    screw = ScrewJoint(
        name="j",
        parent="world",
        child="a",
        pitch=0.1,
        child_frame=Frame(position=(-0.5, 0, 0), axis=(0, 1, 0)),
    )
    assert plane(hinged((0, 1, 0)).model_copy(update={"joints": (screw,)})) is None
    assert plane(load_scene("heavy_top")) is None and plane(load_scene("free_body")) is None
    assert plane(load_scene("ball_chain")) is None and plane(load_scene("bricard")) is None


@pytest.mark.parametrize(
    "name", ["double_pendulum", "hinge_chain", "four_bar", "n_four_bar", "andrews_squeezer"]
)
def test_planar_example_scenes_are_detected_and_agree_with_space(name):
    """Loops drift alike, up to round-off, as long as the drift is small."""
    planar, space = both(load_scene(name), steps=100, step=1e-4, push=np.zeros(6))
    assert difference(planar, space) <= 1e-9


def test_redundant_planar_constraints_are_eliminated():
    """Parallelogram with a third crank: 4 bars of 3 scalars, 12 rows of rank 11, one DOF."""

    def bar(name, start, end):
        (x0, y0), (x1, y1) = start, end
        return Body(
            name=name,
            mass=1.0,
            inertia=(0.01, 0.1, 0.1),
            position=((x0 + x1) / 2, (y0 + y1) / 2, 0),
            rotation_vector=(0, 0, np.arctan2(y1 - y0, x1 - x0)),
        )

    def hinge(name, parent, child, at):
        body = next(b for b in bodies if b.name == child)
        point = body.rotation.T @ (np.array([*at, 0.0]) - body.position)
        return Joint(
            name=name,
            type="revolute",
            parent=parent,
            child=child,
            child_frame=Frame(position=point),
        )

    bodies = [bar(f"crank{x}", (x, 0), (x + 0.3, 0.8)) for x in range(3)]
    bodies.append(bar("coupler", (0.3, 0.8), (2.3, 0.8)))
    joints = [hinge(f"foot{x}", "world", f"crank{x}", (x, 0)) for x in range(3)]
    joints += [hinge(f"head{x}", f"crank{x}", "coupler", (x + 0.3, 0.8)) for x in range(3)]
    scene = Scene(name="three_cranks", gravity=(0, -9.81, 0), bodies=bodies, joints=joints)
    plane = make_layout(scene).plane
    assert int(plane.joints["rows"].sum()) == 3 * 4 - 1
    planar, space = both(scene, steps=300, push=np.zeros(6))
    # It falls as a pendulum of its own: w^2 (3 m l^2/3 + m l^2) / 2 = g (3 m/2 + m) drop.
    angle = np.arctan2(0.8, 0.3)
    turned = np.arctan2(*planar.sample().pose_matrices[0, 1::-1, 0])
    drop = np.hypot(0.3, 0.8) * (np.sin(angle) - np.sin(turned))
    length = np.hypot(0.3, 0.8)
    inertia = 3 * (0.1 + length**2 / 4) + length**2
    rate = np.sqrt(2 * 9.81 * (3 / 2 + 1) * drop / inertia)
    # RKMK4 at 1e-3 s: local errors of 1e-15 relative, 300 of them, and drift as small
    assert abs(planar.sample().twists["crank0"][2]) == pytest.approx(rate, rel=1e-9)
    assert difference(planar, space) <= 1e-9


def test_describe_names_the_plane():
    facts = describe(make_layout(load_scene("four_bar")))
    # Three bars of 3 scalars, four hinges of 2 rows.
    assert facts["plane"] == "z" and facts["solve"]["unknowns"] == 3 * 3 + 4 * 2
    assert describe(make_layout(load_scene("heavy_top")))["plane"] is None
