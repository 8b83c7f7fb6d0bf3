# SPDX-License-Identifier: Apache-2.0
"""Laws of a scene in the reference integration: what their formulas read, and the forces that they give."""

from typing import NamedTuple

import numpy as np

from liegroup_core.compiling import kernel, subroutine

from .formulas import Postfix, evaluate
from .vectors import add_force, add_three, dot, point, slide, three, turned, turned_back, turning

ANGLE, RATE, SLIDE, SLIDE_RATE, PLACE, ATTITUDE, SPIN, SPEED = range(8)  # inputs
TORQUE, FORCE, BODY, WORLD = range(4)  # outputs: effort of a joint, or wrench in the axes of the body or the world
_OF_BODY = {"": PLACE, "q": ATTITUDE, "w": SPIN, "v": SPEED}


class LawLoads(NamedTuple):
    """All laws of a scene; values are the time, the inputs, the states and their rates, the signals and the outputs."""

    read: np.ndarray  # (i, 4) what, number of the value, then parent and child, or body and component
    read_at: np.ndarray  # (i, 9) axis in the parent's axes, origins of the joint frames in m; or point of the body, m
    read_angle: np.ndarray  # (i,) index of the integrated angle, or -1
    code: np.ndarray  # (p, 2) instructions
    numbers: np.ndarray
    first: np.ndarray  # (t + 1,) first points of the tables
    points: np.ndarray  # (q, 2) their points
    acts: np.ndarray  # (o, 4) what, number of the first of its 1 or 6 values, parent or body, child
    acts_at: np.ndarray  # (o, 9) as read_at
    states: np.ndarray  # (s, 2) numbers of the values of a state and of its rate
    scales: np.ndarray  # (s,) magnitudes of the states
    sizes: np.ndarray  # (2,) numbers of values and of places of the stack


def laws_of(scene):
    """Laws of a scene."""
    return [force for force in scene.forces if force.type == "law"]


def angles_of(scene, joints):
    """Joints whose angle the laws read; joints : {name: joint}."""
    read = [each.quantity.rpartition(".") for law in laws_of(scene) for each in law.inputs.values()]
    names = dict.fromkeys(owner for owner, _, part in read if owner in joints and part == "position")
    return [joints[name] for name in names if joints[name].type != "prismatic"]


def build_laws(scene, index, joints, frames, angles):
    """Laws of a scene whose body frames are at the centres of mass; angles : {joint: index of its angle}."""
    program, count, signals, states = Postfix(), 1, {}, []
    read, read_at, read_angle, acts, acts_at = [], [], [], [], []

    def geometry(name):
        joint, (F_a, F_b) = joints[name], frames[name]
        return (index[joint.parent], index[joint.child]), np.concatenate([F_a[:3, 2], F_a[:3, 3], F_b[:3, 3]])

    def at_point(place):
        return np.concatenate([(0.0, 0.0, 0.0) if place is None else place, np.zeros(6)])

    for law in laws_of(scene):
        names = {"t": 0} | law.parameters
        for name, each in law.inputs.items():
            if each.quantity in signals:
                names[name] = signals[each.quantity]
                continue
            owner, _, part = each.quantity.rpartition(".")
            names[name], angle = count, -1
            if owner in joints:
                what = 2 * (joints[owner].type == "prismatic") + (part == "velocity")
                angle = angles[owner] if what == ANGLE else -1
                ends, at = geometry(owner)
            else:
                what, ends, at = _OF_BODY[part[:-1]], (index[owner], "xyzw".index(part[-1])), at_point(each.point)
            read.append((what, count, *ends))
            read_at.append(at)
            read_angle.append(angle)
            count += 1
        for name in law.states:
            names[name] = signals[f"{law.name}.{name}"] = count
            states.append((count, count + 1))
            count += 2
        tables = {}
        for name, table in law.tables.items():
            tables[name] = len(program.tables)
            program.tables.append(np.transpose([table.x, table.y]))
        for name, text in law.signals.items():
            program.add(text, names, tables, count)
            names[name] = signals[f"{law.name}.{name}"] = count
            count += 1
        for name, each in law.states.items():
            program.add(each.rate, names, tables, names[name] + 1)
        for each in law.outputs:
            if each.body is None:
                what, texts = TORQUE if joints[each.joint].type != "prismatic" else FORCE, [each.effort]
                ends, at = geometry(each.joint)
            else:
                what, texts = BODY if each.axes == "body" else WORLD, [*each.torque, *each.force]
                ends, at = (index[each.body], -1), at_point(each.point)
            acts.append((what, count, *ends))
            acts_at.append(at)
            for text in texts:
                program.add(text, names, tables, count)
                count += 1
    return LawLoads(
        read=np.array(read, dtype=int).reshape(-1, 4),
        read_at=np.array(read_at, dtype=float).reshape(-1, 9),
        read_angle=np.array(read_angle, dtype=int),
        code=np.array(program.code, dtype=int).reshape(-1, 2),
        numbers=np.array(program.numbers, dtype=float),
        first=np.cumsum([0, *map(len, program.tables)]),
        points=np.concatenate([np.empty((0, 2)), *program.tables]),
        acts=np.array(acts, dtype=int).reshape(-1, 4),
        acts_at=np.array(acts_at, dtype=float).reshape(-1, 9),
        states=np.array(states, dtype=int).reshape(-1, 2),
        scales=np.array([each.scale for law in laws_of(scene) for each in law.states.values()], dtype=float),
        sizes=np.array([count, program.deepest]),
    )


@kernel
def _input(laws, i, state, frame, angle):
    """Value of an input."""
    what, a, b, at = laws.read[i, 0], laws.read[i, 2], laws.read[i, 3], three(laws.read_at, i, 0)
    if what == ANGLE:
        return angle[laws.read_angle[i]]
    if what == RATE:
        return dot(turned(frame, a, at), turning(frame, a, b))
    if what <= SLIDE_RATE:
        _, _, value, rate = slide(frame, a, b, at, three(laws.read_at, i, 3), three(laws.read_at, i, 6))
        return value if what == SLIDE else rate
    if what == PLACE:
        return point(frame, a, at)[0][b]
    if what == ATTITUDE:
        w, x, y, z = state[a, 0], state[a, 1], state[a, 2], state[a, 3]
        length = np.sqrt(w * w + x * x + y * y + z * z)
        return state[a, (b + 1) % 4] / (length if w >= 0.0 else -length)
    if what == SPIN:
        return state[a, 10 + b]
    return turned_back(frame, a, point(frame, a, at)[1])[b]


@subroutine
def add_laws(laws, time, state, frame, angle, stack, values, force, rate_out):
    """Add the forces of all laws at one state, and write the rates of their states; see loads.add_loads.

    state : (n, 13), see vectors.place;  stack, values : scratch memory of the sizes of the laws
    angle, rate_out : the states and their rates are the last of them
    """
    if len(laws.acts) == 0 and len(laws.states) == 0:
        return
    values[0] = time
    first = len(angle) - len(laws.states)
    for s in range(len(laws.states)):
        values[laws.states[s, 0]] = angle[first + s]
    for i in range(len(laws.read)):
        values[laws.read[i, 1]] = _input(laws, i, state, frame, angle)
    evaluate(laws.code, laws.numbers, laws.first, laws.points, stack, values)
    for s in range(len(laws.states)):
        rate_out[first + s] = values[laws.states[s, 1]]
    for i in range(len(laws.acts)):
        what, k, a, b, at = (
            laws.acts[i, 0],
            laws.acts[i, 1],
            laws.acts[i, 2],
            laws.acts[i, 3],
            three(laws.acts_at, i, 0),
        )
        if what == TORQUE:
            axis = turned(frame, a, at)
            add_three(force, b, 3, values[k], axis)
            add_three(force, a, 3, -values[k], axis)
        elif what == FORCE:
            axis, position, _, _ = slide(frame, a, b, at, three(laws.acts_at, i, 3), three(laws.acts_at, i, 6))
            add_force(force, frame, b, position, values[k], axis)
            add_force(force, frame, a, position, -values[k], axis)
        else:
            torque, push = (values[k], values[k + 1], values[k + 2]), (values[k + 3], values[k + 4], values[k + 5])
            if what == BODY:
                torque, push = turned(frame, a, torque), turned(frame, a, push)
            add_three(force, a, 3, 1.0, torque)
            add_force(force, frame, a, point(frame, a, at)[0], 1.0, push)
