# SPDX-License-Identifier: Apache-2.0
"""Published robots as problems: URDF and SDF files of the package example-robot-data.

All codes get the bodies of this project's import: links connected by fixed joints are one body. Springs,
dampers, limits, motors and mimic couplings are omitted. The robots fall from a bent pose with all
joints turning. Loops are cut at ball joints, which every code can close.
"""

from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from liegroup_core.robots.mapping import scene_parts
from liegroup_core.robots.options import Options
from liegroup_core.robots.read import read_robot
from liegroup_core.robots.text import scene_text
from liegroup_core.scene.load import scene_from_text

from .mechanism_reference import end_attitudes
from .problems import BALL, FREE, GROUND, HINGE, SLIDE, Body, Joint, Problem

# Some links of iCub have no inertia: MuJoCo refuses them, and they whirl. Links with radii of gyration below
# the smallest one get the inertia of the added one, m.
SMALLEST_RADIUS, ADDED_RADIUS = 1e-3, 0.01
KINDS = {"revolute": HINGE, "prismatic": SLIDE, "spherical": BALL}
ARMS, LOOPS = (3.0, 6.0, 12.0), (4.0, 6.0, 15.0)
# Bounds of the initial state, rad and rad/s; for slides a fifth of these, m and m/s. Joints of a free tree
# turn faster, because it only floats.
BENT, TURNING, FREE_TURNING = 0.5, 1.0, 4.0
# Cassie's driven hinges: its loops have two degrees of freedom less than ball joints.
CASSIE = ("roll-op", "yaw-op", "pitch-op", "knee-op", "foot-op", "tarsus-spring-joint")
FILES = {
    "UR5": ("ur_description/urdf/ur5_robot.urdf", "fixed"),
    "Panda": ("panda_description/urdf/panda.urdf", "fixed"),
    "Talos": ("talos_data/robots/talos_full_v2.urdf", "fixed"),
    "Talos, free": ("talos_data/robots/talos_full_v2.urdf", "floating"),
    "iCub": ("icub_description/robots/icub.urdf", "fixed"),
    "iCub, free": ("icub_description/robots/icub.urdf", "floating"),
    "Cassie, free": ("cassie_description/robots/cassie_v2.sdf", "floating"),
}


def path_of(name):
    """Path of a robot's file, or None if the package is not installed."""
    spec = find_spec("cmeel")
    if spec is None:
        return None
    share = Path(spec.origin).parents[1] / "cmeel.prefix" / "share"
    path = share / "example-robot-data" / "robots" / FILES[name][0]
    return path if path.is_file() else None


def problem_of(name, duration=1.0):
    """Problem of a robot of FILES that falls for `duration` s."""
    path, base = path_of(name), FILES[name][1]
    rng = np.random.default_rng(11)
    joints = [j for j in read_robot(path).joints if KINDS.get(j.type) in (HINGE, SLIDE)]
    closed = any(joint.closes for joint in joints) or path.suffix == ".sdf"
    start, speeds = {}, {}
    for joint in joints:
        size = 0.2 if joint.type == "prismatic" else 1.0
        if closed and not joint.name.endswith(CASSIE):
            continue
        if not closed:
            start[joint.name] = size * rng.uniform(-BENT, BENT)
        turning = FREE_TURNING if base == "floating" and not closed else TURNING
        speeds[joint.name] = size * rng.uniform(-turning, turning)
    robot = read_robot(path)
    robot.couplings.clear()
    robot.sensors.clear()  # with force-torque sensors the import keeps fixed joints, which other codes lack
    parts = scene_parts(robot, Options(base=base, start=start, start_velocity=speeds))
    scene = scene_from_text(scene_text(parts), str(path))
    tree, loops, order = _spanning(scene)
    number = {"world": GROUND} | {body: i for i, body in enumerate(order)}
    bodies = {body.name: body for body in scene.bodies}
    problem = Problem(
        name,
        f"{len(order)} bodies",
        tuple(_body(bodies[body]) for body in order),
        tuple(_joint(bodies, number, *entry) for entry in tree),
        tuple(_joint(bodies, number, joint, joint.parent, joint.child) for joint in loops),
        np.array(scene.gravity),
        duration,
        12,
        True,
        wanted=LOOPS if loops else ARMS,
        redundant=bool(loops),
    )
    return replace(problem, exact=lambda fineness: end_attitudes(problem, fineness))


def _spanning(scene):
    """([(joint or None, parent, child)] of a spanning tree, [cut joints], [bodies in its order]).

    A ball is cut if other joints already connect its body.
    """
    leader = {name: name for name in ("world", *(body.name for body in scene.bodies))}

    def find(name):
        while leader[name] != name:
            name = leader[name]
        return name

    held, loops = [], []
    for joint in sorted(scene.joints, key=lambda joint: KINDS[joint.type] == BALL):
        a, b = find(joint.parent), find(joint.child)
        (loops if a == b else held).append(joint)
        leader[b] = a
    if any(KINDS[joint.type] != BALL for joint in loops):
        raise ValueError("a loop without a ball joint")
    tree, order, placed = [], [], {"world"}
    while len(order) < len(scene.bodies):
        found = [j for j in held if (j.parent in placed) != (j.child in placed)]
        if found:
            joint = found[0]
            ends = joint.parent, joint.child
            parent, child = ends if joint.parent in placed else ends[::-1]
        else:
            joint, parent = None, "world"
            child = next(body.name for body in scene.bodies if body.name not in placed)
        tree.append((joint, parent, child))
        order.append(child)
        placed.add(child)
    return tree, loops, order


def _body(body):
    """Body of a problem: at its centre of mass, in world axes."""
    R, (w, v) = body.rotation, body.twist.reshape(2, 3)
    own = body.inertia_matrix
    if np.linalg.eigvalsh(own)[0] < SMALLEST_RADIUS**2 * body.mass:
        own = own + ADDED_RADIUS**2 * body.mass * np.eye(3)
    inertia = R @ own @ R.T
    centre = R @ np.array(body.com)
    velocity = R @ (v + np.cross(w, body.com))
    return Body(body.mass, inertia, np.array(body.position) + centre, R @ w, velocity)


def _joint(bodies, number, joint, parent, child):
    """Joint of a problem; a body without a joint to an earlier one is free."""
    if joint is None:
        return Joint(FREE, GROUND, number[child], _body(bodies[child]).position)
    frame = bodies[joint.child].pose @ joint.child_frame.pose
    axis = frame[:3, 2]
    nearest = np.round(axis)
    if np.abs(axis - nearest).max() < 1e-9:  # the reference pose is exact to round-off only
        axis = nearest
    kind = KINDS[joint.type]
    given = {} if kind == BALL else {"axis": axis}
    return Joint(kind, number[parent], number[child], frame[:3, 3], **given)
