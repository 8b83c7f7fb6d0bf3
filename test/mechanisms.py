# SPDX-License-Identifier: Apache-2.0
"""Scenes for tests: random mechanisms with every type of joint, consistent by construction."""

import functools
from typing import get_args

import naive
import numpy as np
import yaml
from scene_files import filled, text_of
from scipy.integrate import solve_ivp
from scipy.linalg import null_space

from liegroup_core import Scene
from liegroup_core.joints import forbidden_rows
from liegroup_core.joints.kinds import CONSTRAINTS, JOINTS
from liegroup_core.lie.groups import SE3, SO3
from liegroup_core.methods.table import METHODS
from liegroup_core.scene.consistency import resolve_elements, resolve_frames
from liegroup_core.scene.description import Body, Frame, Joint, SpringDamper
from liegroup_core.scene.load import scene_from_text

GRAVITY = (0.3, -0.2, -9.81)
KINDS = tuple(CONSTRAINTS)
PARAMETERS = {"pitch": 0.3, "length": 0.7, "radius": 0.2}  # m/rad, m, m
WX, WY, WZ, VX, VY, VZ = np.eye(6)
# Lower pairs: the directions of relative twist that they allow, in the axes of the child's joint frame.
FREE = {
    "spherical": lambda pitch: [WX, WY, WZ],
    "revolute": lambda pitch: [WZ],
    "prismatic": lambda pitch: [VZ],
    "cylindrical": lambda pitch: [WZ, VZ],
    "planar": lambda pitch: [WZ, VX, VY],
    "screw": lambda pitch: [WZ + pitch * VZ],
    "fixed": lambda pitch: [],
}


def random_pose(rng, size=1.0):
    pose = np.eye(4)
    pose[:3, :3] = SO3.exp(rng.normal(size=3))
    pose[:3, 3] = size * rng.normal(size=3)
    return pose


def random_body(rng, name, pose):
    """Random body with a full inertia matrix that satisfies the triangle inequality."""
    points = rng.normal(size=(4, 3)) * 0.3
    inertia = sum(0.5 * ((p @ p) * np.eye(3) - np.outer(p, p)) for p in points)
    return Body(
        name=name,
        mass=float(rng.uniform(0.5, 3.0)),
        inertia=[*np.diag(inertia), inertia[0, 1], inertia[0, 2], inertia[1, 2]],
        position=pose[:3, 3],
        rotation_vector=SO3.log(pose[:3, :3]),
    )


def allowed_motion(rng, kind):
    """Random relative pose that a type of joint allows, angles beyond a full turn included."""
    angle, slide, turn, far = 4.0 * rng.normal(), *(rng.normal(size=3) for _ in range(3))
    motion, shift = np.eye(4), far
    if kind == "universal":
        turn, shift = (angle, 0.0, 0.0), (0.0, 0.0, 0.0)
    elif kind != "distance":
        size = [angle if direction[2] else slide @ direction[3:] for direction in directions(kind)]
        twist = np.sum([q * d for q, d in zip(size, directions(kind))] or [np.zeros(6)], axis=0)
        turn, shift = turn if kind == "spherical" else twist[:3], twist[3:]
    motion[:3, :3], motion[:3, 3] = SO3.exp(turn), shift
    if kind == "universal":
        motion[:3, :3] = motion[:3, :3] @ SO3.exp((0, rng.normal(), 0))
    return motion


def directions(kind):
    """(k, 6) directions of FREE for the pitch of PARAMETERS."""
    return np.reshape(FREE[kind](PARAMETERS["pitch"]), (-1, 6))


def parameters(kind):
    """{name: value} of the parameters that a type of joint has."""
    return {name: PARAMETERS[name] for name in _class_of(kind).model_fields if name in PARAMETERS}


def _class_of(kind):
    (found,) = (each for each in JOINTS if kind in get_args(each.model_fields["type"].annotation))
    return found


def joint(kind, **keys):
    """Joint of any type between two frames; the poses determine a length."""
    pitch = {name: value for name, value in parameters(kind).items() if name == "pitch"}
    return _class_of(kind)(type=kind, **pitch | keys)


def with_every_pair(links):
    """Links for `mechanism`, with a body on the world for every lower pair that they lack."""
    missing = FREE.keys() - {kind for _, _, kind in links} - {"fixed"}
    return [*links, *(("world", kind, kind) for kind in sorted(missing))]


def frame(pose):
    return Frame(position=pose[:3, 3], rotation_vector=SO3.log(pose[:3, :3]))


def mechanism(rng, links, springs=2, loops=(), place=random_pose, start=None):
    """Scene from links (parent, child, kind), parents first, and loops (a, b, kind).

    A link of kind None is a body without a joint. The joint of a loop has no frame on b, or no
    length: the poses determine it. Twists are random in the null space of the joints' Jacobian.
    place : function (rng, size in m) of a joint frame (4, 4) in a body
    start : function (rng, scene) of the scene with twists, default `moving`
    """
    poses, joints = {"world": np.eye(4)}, []
    for parent, child, kind in links:
        if kind is None:
            poses[child] = random_pose(rng)
            continue
        at_parent, at_child = place(rng, 0.4), place(rng, 0.4)
        poses[child] = poses[parent] @ at_parent @ allowed_motion(rng, kind) @ np.linalg.inv(at_child)
        ends = {"name": f"j{len(joints)}", "parent": parent, "child": child}
        joints.append(joint(kind, **ends, parent_frame=frame(at_parent), child_frame=frame(at_child)))
    for parent, child, kind in loops:
        keys = {"child_frame": frame(place(rng, 0.5))} if kind == "distance" else {}
        joints.append(
            joint(kind, name=f"j{len(joints)}", parent=parent, child=child, parent_frame=frame(place(rng, 0.5)), **keys)
        )
    del poses["world"]
    bodies = [random_body(rng, name, pose) for name, pose in poses.items()]
    names = [*poses, "world"]
    forces = []
    for i in range(springs):
        parent, child = rng.choice(len(names)), rng.choice(len(bodies))
        if parent != child:
            ends = {"parent": names[parent], "child": names[child]}
            ends |= {"parent_point": rng.normal(size=3), "child_point": rng.normal(size=3)}
            forces.append(SpringDamper(name=f"s{i}", stiffness=50.0, damping=float(i), rest_length=0.4 * i, **ends))
    scene = Scene(name="made", gravity=GRAVITY, bodies=bodies, joints=joints, forces=forces)
    return (start or moving)(rng, scene)


def moving(rng, scene):
    """Scene with random twists that its joints allow."""
    matrices = {body.name: body.pose for body in scene.bodies}
    rows = naive.jacobian(scene, resolve_frames(scene), matrices)
    free = null_space(rows, rcond=1e-6) if len(rows) else np.eye(6 * len(matrices))
    twists = (free @ rng.normal(size=free.shape[1])).reshape(-1, 6)
    # Differences leave an error of 1e-10; exact rows remove it.
    rows = exact_jacobian(scene)
    twists = twists.ravel() - np.linalg.pinv(rows) @ (rows @ twists.ravel())
    bodies = [
        body.model_copy(update={"angular_velocity": tuple(twist[:3]), "linear_velocity": tuple(twist[3:])})
        for body, twist in zip(scene.bodies, twists.reshape(-1, 6))
    ]
    return Scene(name=scene.name, gravity=scene.gravity, bodies=bodies, joints=scene.joints, forces=scene.forces)


def exact_jacobian(scene):
    """A V_rel of all joints as a dense matrix, from the definition of V_rel."""
    index = {body.name: i for i, body in enumerate(scene.bodies)}
    poses = {body.name: body.pose for body in scene.bodies} | {"world": np.eye(4)}
    rows = [np.zeros((0, 6 * len(index)))]
    for link, (at_parent, at_child), elements in zip(scene.joints, resolve_frames(scene), resolve_elements(scene)):
        relative = np.linalg.inv(poses[link.parent] @ at_parent) @ poses[link.child] @ at_child
        block = np.zeros((6, 6 * len(index)))
        if link.child in index:
            at = 6 * index[link.child]
            block[:, at : at + 6] = SE3.Ad(np.linalg.inv(at_child))
        if link.parent in index:
            at = 6 * index[link.parent]
            block[:, at : at + 6] = -SE3.Ad(np.linalg.inv(relative) @ np.linalg.inv(at_parent))
        rows.append(forbidden_rows(elements, relative) @ block)
    return np.concatenate(rows)


def one_body(joint=None, forces=(), gravity=(0, 0, 0), assemble=False, **keys):
    """Scene of a body, `a` of 1 kg and 1 kg m^2 unless `keys` say otherwise, on a joint to the world of these keys."""
    body = Body(**{"name": "a", "mass": 1.0, "inertia": (1, 1, 1)} | keys)
    joints = [{"name": "j", "parent": "world", "child": body.name} | joint] if joint else []
    return Scene(name="one", gravity=gravity, assemble=assemble, bodies=[body], joints=joints, forces=forces)


def chain(n, kind="spherical", length=0.1, mass=0.1):
    """Chain of n equal rods along x; axes of revolute joints along y."""
    inertia = (mass * length**2 / 600, mass * length**2 / 12, mass * length**2 / 12)
    bodies = [Body(name=f"rod{i}", mass=mass, inertia=inertia, position=((i + 0.5) * length, 0, 0)) for i in range(n)]
    names = ["world"] + [body.name for body in bodies]
    end = Frame(position=(-length / 2, 0, 0), axis=(0, 1, 0))
    joints = [Joint(name=f"pin{i}", type=kind, parent=names[i], child=names[i + 1], child_frame=end) for i in range(n)]
    return Scene(name="chain", gravity=(0, 0, -9.81), bodies=bodies, joints=joints)


def with_every_group():
    """Links for `mechanism`: a branched tree with every group of a joint and every lower pair, and a free body."""
    chain = ("planar", "universal", "cylindrical", "spherical", "screw")
    links = list(zip(("world", "a", "b", "c", "d"), "abcde", chain))
    return with_every_pair([*links, ("b", "f", "prismatic"), ("world", "g", None), ("g", "h", "revolute")])


def bar(name, start, end, rate=0.0, start_velocity=(0.0, 0.0), mass=1.0):
    """Bar in the x-y plane from start to end, rotating about z at `rate`; x along the bar."""
    start, end = np.array(start, dtype=float), np.array(end, dtype=float)
    along = end - start
    length, angle = np.linalg.norm(along), np.arctan2(along[1], along[0])
    velocity = np.append(start_velocity + rate * np.array([-along[1], along[0]]) / 2, 0.0)
    keys = {"position": (*(start + end) / 2, 0.0), "rotation_vector": (0, 0, angle), "angular_velocity": (0, 0, rate)}
    keys["linear_velocity"] = SO3.exp([0.0, 0.0, angle]).T @ velocity
    return Body(name=name, mass=mass, inertia=(mass * 1e-3, *[mass * length**2 / 12] * 2), **keys)


def hinge(name, parent, child, offset, kind="revolute"):
    """Joint of a bar at `offset` from its centre."""
    return Joint(name=name, type=kind, parent=parent, child=child, child_frame=Frame(position=(offset, 0.0, 0.0)))


def parallelogram(angle, rate, kinds=("revolute",) * 4, gravity=(0.0, 0.0, 0.0)):
    """Crank and rocker of 1 m, coupler and ground of 2 m, moving as a parallelogram."""
    tip, pin = np.array([np.cos(angle), np.sin(angle)]), np.array([2.0, 0.0])
    speed = rate * np.array([-tip[1], tip[0]])
    bodies = [bar("crank", (0, 0), tip, rate), bar("coupler", tip, tip + pin, 0.0, speed)]
    bodies.append(bar("rocker", pin, tip + pin, rate))
    ends = ("world", "crank", -0.5), ("crank", "coupler", -1.0), ("coupler", "rocker", 0.5), ("world", "rocker", -0.5)
    joints = [hinge(name, *end, kind) for name, end, kind in zip("abcd", ends, kinds)]
    return Scene(name="parallelogram", gravity=gravity, bodies=bodies, joints=joints)


def two_links(second_length):
    """Links of 1 m and `second_length` m on spherical joints between ground points 2 m apart."""
    angle = np.arccos((1 + 4 - second_length**2) / 4)
    corner = np.array([np.cos(angle), np.sin(angle), 0.0])
    pin = np.array([2.0, 0.0, 0.0])
    other = np.arctan2(*(corner - pin)[[1, 0]])
    text = filled(
        text_of("two_links.yaml"),
        first=(corner / 2).tolist(),
        angle=repr(float(angle)),
        second=((corner + pin) / 2).tolist(),
        other=repr(float(other)),
        half=-second_length / 2,
    )
    return scene_from_text(text)


TREE = [
    ("world", "a", "revolute"),
    ("a", "b", "spherical"),
    ("a", "c", "revolute"),
    ("c", "d", "revolute"),
    ("world", "e", "spherical"),
]
MECHANISMS = {
    "ball": ([("world", "a", "spherical")], []),
    "pendulum": ([("world", "a", "revolute")], []),
    "chain of balls": ([("world", "a", "spherical"), ("a", "b", "spherical"), ("b", "c", "spherical")], []),
    "chain of hinges": ([("world", "a", "revolute"), ("a", "b", "revolute"), ("b", "c", "revolute")], []),
    "tree": (TREE, []),
    "loop of hinges and balls": (
        [("world", "a", "revolute"), ("a", "b", "spherical"), ("b", "c", "spherical")],
        [("world", "c", "revolute")],
    ),
    "net": (TREE, [("b", "e", "spherical"), ("world", "d", "spherical")]),
    **{f"{kind} to ground": ([("world", "a", kind)], []) for kind in KINDS},
    **{f"{kind} between bodies": ([("world", "a", "spherical"), ("a", "b", kind)], []) for kind in KINDS},
    "every kind": (
        [
            ("world", "a", "cylindrical"),
            ("a", "b", "universal"),
            ("b", "c", "screw"),
            ("a", "d", "planar"),
            ("d", "e", "prismatic"),
            ("e", "f", "fixed"),
            ("f", "g", "distance"),
            ("g", "h", "revolute"),
        ],
        [("c", "g", "distance"), ("world", "h", "universal")],
    ),
    "floating": (
        [("world", "a", None), ("a", "b", "universal"), ("b", "c", "prismatic"), ("b", "d", "spherical")],
        [("c", "d", "distance")],
    ),
}

FORCES_ON_HINGES = yaml.safe_load(text_of("forces_on_hinges.yaml"))

# Those without a joint that welds bodies together.
UNWELDED = [name for name, joints in MECHANISMS.items() if not any(kind == "fixed" for _, _, kind in sum(joints, []))]


@functools.lru_cache(maxsize=None)
def named(name, seed=0):
    """Mechanism of MECHANISMS, random with a fixed seed."""
    links, loops = MECHANISMS[name]
    return mechanism(np.random.default_rng([seed, len(name)]), links, loops=loops)


def under_many_forces():
    """Chain with three revolute joints and every kind of force that applies to them."""
    scene = named("chain of hinges")
    return scene.remade(forces=[*scene.forces, *FORCES_ON_HINGES])


@functools.lru_cache(maxsize=None)
def rotors():
    """Bodies, free or on a spherical joint, coupled by springs and dampers."""
    return mechanism(
        np.random.default_rng(7),
        [("world", "a", "spherical"), ("world", "b", None), ("world", "c", "spherical")],
        springs=6,
    )


def fitting(method, name="net"):
    """Mechanism of MECHANISMS that fits a method; "rotors" for rotation methods."""
    return rotors() if METHODS[method].family == "rotation" else named(name)


def windows_motion(n, times):
    """Angle and rate (k, 2) of all cranks of a row of n four-bar windows.

    n + 1 rods rotate about their ends, n rods translate.
    """
    inertia = (n + 1) * (0.25 + (1.0 + 3e-6) / 12.0) + n
    lever = (n + 1) * 0.5 + n
    found = solve_ivp(
        lambda t, y: [y[1], -9.81 * lever / inertia * np.cos(y[0])],
        (0.0, times[-1]),
        [np.pi / 2, -1.0],
        t_eval=times,
        method="DOP853",
        rtol=1e-12,
        atol=1e-13,
    )
    return found.y.T
