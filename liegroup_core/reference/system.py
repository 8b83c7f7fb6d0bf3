# SPDX-License-Identifier: Apache-2.0
"""Arrays of the reference integration, built from a scene."""

import numpy as np

from liegroup_core.errors import SimulationError
from liegroup_core.scene.consistency import resolve_frames
from liegroup_core.scene.massless import lack_of_inertia

from .equations import ANGLE, DISTANCE, JOINTS, LEVEL, Equations, X
from .laws import SHIFT, TURN, angles_of, build_laws, laws_of
from .loads import Loads
from .rigid_body_dae import System

# An angle within HALF_TURN rad of -pi is pi, independent of its round-off.
HALF_TURN = 1e-9
TURNING = ("torsional_spring_damper", "motor", "servo")
SLIDING = ("linear_spring_damper", "linear_motor", "linear_servo")
FREE = (0.0, 0.0, 0.0, np.inf)  # law of a joint whose angle is only integrated


def build_system(scene, pose, angles=None):
    """Arrays of a scene with body frames at the centres of mass.

    pose   : (n, 12) R row by row (body -> world), then r in m, at the start of the integration
    angles : (u,) rad, those of `scene.unwrapped` at that pose, then what sampled laws hold and the states of laws;
             None: angles in (-pi, pi], states at their start
    returns (System, (t,) angles in rad at that pose, of the joints that need one, then states, [PeriodicLaw])
    Raises SimulationError for a joint or force without equations here.
    """
    index = {body.name: i for i, body in enumerate(scene.bodies)} | {"world": len(scene.bodies)}
    supported = {*JOINTS, "spring_damper", *TURNING, *SLIDING, "drag", "applied_wrench", "law", "contact"}
    for entry in (*scene.joints, *scene.forces):
        if entry.type not in supported:
            raise SimulationError(f"the reference integration does not support {entry.type} ({entry.name})")
    for entry in (*scene.joints, *scene.couplings):
        if entry.switches:
            raise SimulationError(f"the reference integration has no stops and no friction ({entry.name})")
    lack = lack_of_inertia(scene)
    if lack:
        raise SimulationError(f"the reference integration needs inertia about all axes, but {lack}: give it inertia")
    frames = {joint.name: pair for joint, pair in zip(scene.joints, resolve_frames(scene))}
    relative = _relative(
        scene,
        frames,
        {
            body.name: np.block([[place[:9].reshape(3, 3), place[9:, None]], [0.0, 0.0, 0.0, 1.0]])
            for body, place in zip(scene.bodies, pose)
        },
    )
    joints = {joint.name: joint for joint in scene.joints}
    turns = [(joint, FREE) for joint in scene.joints if joint.type == "screw"]
    turns += [(joints[force.joint], _law(force)) for force in scene.forces if force.type in TURNING]
    read_angles = {joint.name: len(turns) + k for k, joint in enumerate(angles_of(scene, joints))}
    turns += [(joints[name], FREE) for name in read_angles]
    slides = [(joints[force.joint], _law(force)) for force in scene.forces if force.type in SLIDING]
    coupled = [joints[name] for entry in scene.couplings for name in (entry.joint, *entry.others)]
    coupled += [joint for joint in scene.joints if joint.driven for _ in range(2)]
    turns += [(joint, FREE) for joint in coupled if joint.type != "prismatic"]
    known = {} if angles is None else dict(zip((name for name, _ in scene.unwrapped), angles))
    start = np.array([known.get(joint.name, _angle(relative[joint.name])) for joint, _ in turns], dtype=float)
    equations = _equations(scene, index, frames, relative, (coupled, start))
    servos, screws = {}, sum(joint.type == "screw" for joint in scene.joints)
    for what, types, first in ((TURN, TURNING, screws), (SHIFT, SLIDING, 0)):
        own = [force for force in scene.forces if force.type in types]
        servos |= {force.name: (what, first + k, force) for k, force in enumerate(own)}
    laws, sampled = build_laws(scene, index, joints, frames, read_angles, servos)
    inertia = np.array([body.inertia_matrix for body in scene.bodies])
    system = System(
        mass=np.array([body.mass for body in scene.bodies], dtype=float),
        inertia=inertia.reshape(-1, 9),
        mobility=np.linalg.inv(inertia).reshape(-1, 9),
        size=float(np.linalg.norm(equations.point.reshape(-1, 2, 3), axis=2).max(initial=0.0)) or 1.0,
        equations=equations,
        loads=_loads(scene, index, frames, turns, slides),
        laws=laws,
    )
    states = [each.start for law in laws_of(scene) if law.period is None for each in law.states.values()]
    if angles is not None and len(angles) > len(scene.unwrapped):
        numbers = angles[len(scene.unwrapped) :]
        laws.held[:], states = numbers[: len(laws.held)], numbers[len(numbers) - len(states) :]
    return system, np.append(start, states), sampled


def _relative(scene, frames, start):
    """Poses (4, 4) of the child's joint frame relative to the parent's, by name of the joint.

    start : {body: pose (4, 4)}
    """
    start = start | {"world": np.eye(4)}
    return {
        joint.name: np.linalg.solve(
            start[joint.parent] @ frames[joint.name][0], start[joint.child] @ frames[joint.name][1]
        )
        for joint in scene.joints
    }


def _angle(relative):
    """Angle of the child's joint frame about z, in (-pi, pi]."""
    angle = np.arctan2(relative[1, 0], relative[0, 0])
    return angle if angle > HALF_TURN - np.pi else angle + 2.0 * np.pi


def _table(rows, shape, dtype=float):
    return np.array(rows, dtype=dtype).reshape((len(rows), *shape))


def _ends(link, index):
    return index[link.parent], index[link.child]


def _equations(scene, index, frames, relative, couplings):
    """Equations; couplings : (their joints, angles of all joints that need one)."""
    rows = []  # (kind, body, point, axis, normal, length, pitch, turn)
    described = _relative(scene, frames, {body.name: body.pose for body in scene.bodies})
    screws = 0
    for joint in scene.joints:
        (F_a, F_b), C_rel = frames[joint.name], relative[joint.name]
        for equation in JOINTS[joint.type][2 if getattr(joint, "frictionless", False) else 0 :]:
            e, f = (*equation[1:], X, X)[:2]
            axes, length, screw = (F_a[:3, e], F_b[:3, f]), getattr(joint, "radius", 0.0), (0.0, -1)
            if equation[0] == DISTANCE:
                length = _length(joint, described[joint.name])
            elif joint.type == "screw" and equation == JOINTS["screw"][-1]:
                length, screw = _thread(joint, C_rel), (joint.pitch, screws)
            ends, points = _ends(joint, index), (F_a[:3, 3], F_b[:3, 3])
            rows.append((equation[0], ends, points, axes, F_a[:3, 2], length, *screw))
        screws += joint.type == "screw"
    coupled, start = couplings
    angle, values = len(start) - sum(joint.type != "prismatic" for joint in coupled), []
    rotors = [joint for joint in scene.joints if joint.rotor]
    for number, joint in enumerate([*coupled, *rotors]):
        F_a, F_b = frames[joint.name]
        turns, axes = joint.type != "prismatic", (F_a[:3, 2], F_b[:3, 2])
        ends, points = _ends(joint, index), (F_a[:3, 3], F_b[:3, 3])
        turn = angle if turns and number < len(coupled) else -1
        rows.append((ANGLE if turns else LEVEL, ends, points, axes, F_a[:3, 2], 0.0, 0.0, turn))
        if number >= len(coupled):
            continue
        values.append(start[angle] if turns else relative[joint.name][2, 3])
        angle += turns
    drives = np.arange(sum(joint.driven for joint in scene.joints))
    ratio = np.array([entry.ratio for entry in scene.couplings] + [0.0 for _ in drives])
    curve = np.zeros((len(ratio), 3))
    for row, entry in zip(curve, scene.couplings):
        row[: len(entry.curve)] = entry.curve
    counts = [1 + len(entry.others) for entry in scene.couplings] + [2 for _ in drives]
    at, values = np.cumsum([0, *counts])[:-1], np.append(values, [0.0, 0.0])
    values[len(coupled) - 2 * len(drives) :] = 0.0
    offset = values[at] - ratio * values[at + 1] - (curve * values[at + 1, None] ** np.arange(2, 5)).sum(axis=1)
    shares = np.zeros((len(ratio), max(counts, default=2) - 2))
    for c, entry in enumerate(scene.couplings):
        shares[c, : len(entry.terms)] = list(entry.terms.values())
        offset[c] -= shares[c, : len(entry.terms)] @ values[at[c] + 2 : at[c] + counts[c]]
    kind, body, point, axis, normal, length, pitch, turn = zip(*rows) if rows else [()] * 8
    slots = 4 + 2 * shares.shape[1]
    compliance, bodies = np.zeros(len(kind)), np.full((len(kind), slots), len(scene.bodies))
    bodies[:, :2] = _table(body, (2,), int)
    compliance[len(kind) - len(rotors) :] = [1.0 / joint.rotor_inertia for joint in rotors]
    first = len(kind) - len(rotors) - len(coupled) + at
    for row, count in zip(first, counts):
        bodies[row, 2 : 2 * count] = bodies[row + 1 : row + count, :2].ravel()
    return Equations(
        _table(kind, (), int),
        bodies,
        _table(point, (6,)),
        _table(axis, (6,)),
        _table(normal, (3,)),
        _table(length, ()),
        _table(pitch, ()),
        _table(turn, (), int),
        first,
        ratio,
        curve,
        shares,
        offset,
        np.concatenate([np.full(len(scene.couplings), -1), drives]),
        compliance,
    )


def _length(joint, relative):
    return np.linalg.norm(relative[:3, 3]) if joint.length is None else joint.length


def _thread(joint, relative):
    """Offset of a screw: the nearest integer number of leads, m."""
    lead = 2.0 * np.pi * joint.pitch
    return lead * round((relative[2, 3] - joint.pitch * _angle(relative)) / lead) if lead else 0.0


def _law(force):
    """(constant, stiffness, damping, limit) of a force, see loads.py."""
    if force.type == "motor":
        limit = force.rate_limit
        return force.torque, 0.0, 0.0 if limit is None else abs(force.torque) / limit, np.inf
    if force.type == "linear_motor":
        limit = force.speed_limit
        return force.force, 0.0, 0.0 if limit is None else abs(force.force) / limit, np.inf
    if force.type in ("servo", "linear_servo"):
        return servo_law(force, force.position, force.velocity)
    at_rest = {
        "spring_damper": "rest_length",
        "torsional_spring_damper": "rest_angle",
        "linear_spring_damper": "rest_position",
    }[force.type]
    return force.stiffness * getattr(force, at_rest), force.stiffness, force.damping, np.inf


def servo_law(servo, position, velocity):
    """Law of a servo with a target position and velocity."""
    limit = np.inf if servo.effort_limit is None else servo.effort_limit
    constant = servo.stiffness * position + servo.damping * velocity
    return constant, servo.stiffness, servo.damping, limit


def with_targets(system, scene, targets):
    """System with other targets of its servos; targets : {joint: (position, velocity)}."""
    laws = system.loads.turn_law.copy(), system.loads.slide_law.copy()
    screws = sum(joint.type == "screw" for joint in scene.joints)
    for law, types, row in zip(laws, (TURNING, SLIDING), (screws, 0)):
        for force in scene.forces:
            if force.type in types:
                if force.type.endswith("servo") and force.joint in targets:
                    law[row] = servo_law(force, *targets[force.joint])
                row += 1
    loads = system.loads._replace(turn_law=laws[0], slide_law=laws[1])
    return system._replace(loads=loads)


def _loads(scene, index, frames, turns, slides):
    lines = [force for force in scene.forces if force.type == "spring_damper"]
    drag = np.zeros((len(scene.bodies), 4))
    for force in scene.forces:
        if force.type == "drag":
            drag[index[force.body]] += (force.linear, force.quadratic, force.angular, force.angular_quadratic)
    return Loads(
        gravity=np.array([scene.gravity], dtype=float),
        line_body=_table([_ends(s, index) for s in lines], (2,), int),
        line_point=_table([(s.parent_point, s.child_point) for s in lines], (6,)),
        line_law=_table([_law(s) for s in lines], (4,)),
        turn_body=_table([_ends(joint, index) for joint, _ in turns], (2,), int),
        turn_axis=_table([frames[joint.name][0][:3, 2] for joint, _ in turns], (3,)),
        turn_law=_table([law for _, law in turns], (4,)),
        slide_body=_table([_ends(joint, index) for joint, _ in slides], (2,), int),
        slide_point=_table([[F[:3, 3] for F in frames[joint.name]] for joint, _ in slides], (6,)),
        slide_axis=_table([frames[joint.name][0][:3, 2] for joint, _ in slides], (3,)),
        slide_law=_table([law for _, law in slides], (4,)),
        drag=drag,
    )
