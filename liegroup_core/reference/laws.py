# SPDX-License-Identifier: Apache-2.0
"""Laws of a scene in the reference integration: what their formulas read, and the forces that they give.

What sampled laws hold is constant from one of their instants to the next, at which each integration evaluates them.
"""

from fractions import Fraction
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from liegroup_core.compiling import kernel, subroutine

from .formulas import Postfix, evaluate
from .sliding import FREE
from .vectors import (
    FRAME,
    add_force,
    add_three,
    cross,
    dot,
    place,
    plus,
    point,
    slide,
    three,
    turned,
    turned_back,
    turning,
)

ANGLE, RATE, SLIDE, SLIDE_RATE = range(4)  # inputs, of joints
PLACE, PLACE_RATE, WORLD_SPIN, DIRECTION, ATTITUDE, SPIN, SPEED, APART, APART_RATE = range(4, 13)
TORQUE, FORCE, BODY, WORLD = range(4)  # outputs: effort of a joint, or wrench in the axes of the body or the world
TURN, SHIFT = 4, 5  # target of a servo about or along the axis of a joint
NS = 10**9  # instants are at whole ns
UNUSED = 0  # place of a held value that nothing reads: that of the time, which is written last
_OF_BODY = {"": PLACE, "d": PLACE_RATE, "o": WORLD_SPIN, "n": DIRECTION, "q": ATTITUDE, "w": SPIN, "v": SPEED}


class LawLoads(NamedTuple):
    """All laws of a scene; values are the time, the inputs, the states and their rates, the signals and the outputs."""

    read: np.ndarray  # (i, 4) what, number of the value, then parent and child, or body and component
    # (i, 10) axis in the parent's axes, origins of the joint frames in m, resolution or 0; two points in m of the two
    # bodies; or point of the body in m or quaternion w, x, y, z of a frame, then a direction in it, and an offset
    read_at: np.ndarray
    read_angle: np.ndarray  # (i,) index of the integrated angle, or -1
    code: np.ndarray  # (p, 2) instructions
    begins: np.ndarray  # (m,) and (v,) numbers of values: see formulas.evaluate
    needed: np.ndarray
    numbers: np.ndarray
    first: np.ndarray  # (t + 1,) first points of the tables
    points: np.ndarray  # (q, 2) their points
    acts: np.ndarray  # (o, 4) what, number of the first of its 1, 2 or 6 values, parent or body, child; of a servo its
    # row in loads, and 0, 1 or 2: both values, position, velocity
    acts_at: np.ndarray  # (o, 10) as read_at; of a servo its own target
    held_to: np.ndarray  # (h,) numbers of the values that sampled laws hold
    held: np.ndarray  # (h,) these values
    states: np.ndarray  # (s, 2) numbers of the values of a state and of its rate
    scales: np.ndarray  # (s,) magnitudes of the states
    sizes: np.ndarray  # (3,) numbers of values, of places of the stack and of surfaces


class PeriodicLaw(NamedTuple):
    """A law with a period; its values are in those of LawLoads."""

    period: Fraction  # s
    delay: Fraction  # s
    read: tuple  # rows of LawLoads.read, read_at, read_angle
    program: Postfix
    found: list  # numbers of what it computes: states after an instant, signals, outputs
    first: int  # number of its first held value, of states, signals, outputs, and sets of outputs, the oldest first
    outputs: int  # how many values they are
    waiting: int  # number of sets of outputs that start later
    noisy: list  # [(number of a value, sensor, number of the sensor)] that it reads


def laws_of(scene):
    """Laws of a scene."""
    return [force.as_law for force in scene.forces if hasattr(force, "as_law")]


def angles_of(scene, joints):
    """Joints whose angle the laws read; joints : {name: joint}."""
    read = [each.quantity.rpartition(".") for law in laws_of(scene) for each in law.inputs.values()]
    encoders = {each.name: (each.joint, "", "position") for each in scene.sensors if each.type == "encoder"}
    read = [encoders.get(each[0], each) for each in read]
    names = dict.fromkeys(owner for owner, _, part in read if owner in joints and part == "position")
    return [joints[name] for name in names if joints[name].type != "prismatic"]


def _exact(seconds):
    """Time in s as the simplest fraction that its float stands for."""
    return Fraction(repr(seconds)).limit_denominator(10**12)


def build_laws(scene, index, joints, frames, angles, servos):
    """Laws of a scene whose body frames are at the centres of mass.

    angles : {joint: index of its angle};  servos : {name: (TURN or SHIFT, row in loads, force)}

    returns (LawLoads, [PeriodicLaw])
    """
    continuous, count, signals, states, effects = Postfix(), 1, {}, [], []
    own_reads, acts, acts_at, held_to, held, sampled = ([], [], []), [], [], [], [], []

    def geometry(name):
        joint, (F_a, F_b) = joints[name], frames[name]
        return (index[joint.parent], index[joint.child]), np.array([*F_a[:3, 2], *F_a[:3, 3], *F_b[:3, 3], 0.0])

    def at_point(place):
        return np.concatenate([(0.0, 0.0, 0.0) if place is None else place, np.zeros(7)])

    def of_body(name, part, place, axes=None, offset=0.0):
        what, k = _OF_BODY[part[:-1]], "xyzw".index(part[-1])
        at, axes = at_point(place), np.eye(3) if axes is None else axes
        if what == ATTITUDE:
            at[[1, 2, 3, 0]] = Rotation.from_matrix(axes).as_quat()
        elif what in (SPIN, SPEED):
            at[3:6], at[9] = axes[:, k], offset
        return what, (index[name], k), at

    def number_in(sensor, part):
        return int(part) if part.isdigit() else [text.split()[0] for text in sensor.parts].index(part)

    def of_sensor(sensor, number):
        if sensor.type == "encoder":
            what = ANGLE if joints[sensor.joint].type != "prismatic" else SLIDE
            ends, at = geometry(sensor.joint)
            at[9] = sensor.resolution or 0.0
            return what, ends, at
        if sensor.type == "distance":
            ends = index[sensor.parent], index[sensor.child]
            return APART + number, ends, np.array([*sensor.parent_point, *sensor.child_point, *np.zeros(4)])
        parts = "x y z qx qy qz qw vx vy vz wx wy wz" if sensor.type == "pose" else "qx qy qz qw wx wy wz"
        part, frame, offset = parts.split()[number], sensor.frame, 0.0
        axes, place = (None, None) if frame is None else (frame.pose[:3, :3], frame.pose[:3, 3])
        if sensor.type == "imu" and part[0] == "w":
            offset = sensor.angular_velocity_bias["xyz".index(part[1])]
        return of_body(sensor.body, part, place, axes, offset)

    sensors = {each.name: each for each in scene.sensors}
    for law in laws_of(scene):
        noisy = []
        program, (read, read_at, read_angle) = continuous, own_reads
        if law.period is not None:
            program, (read, read_at, read_angle) = Postfix(), ([], [], [])
        names = {"t": 0} | law.parameters
        for name, each in law.inputs.items():
            if each.quantity in signals:
                names[name] = signals[each.quantity]
                continue
            owner, _, part = each.quantity.rpartition(".")
            names[name], angle = count, -1
            if owner in sensors:
                number = number_in(sensors[owner], part)
                what, ends, at = of_sensor(sensors[owner], number)
                angle = angles[sensors[owner].joint] if what == ANGLE else -1
                if hasattr(sensors[owner], "noise_at"):
                    noisy.append((count, sensors[owner], number))
            elif owner in joints:
                what = 2 * (joints[owner].type == "prismatic") + (part == "velocity")
                angle = angles[owner] if what == ANGLE else -1
                ends, at = geometry(owner)
            else:
                what, ends, at = of_body(owner, part, each.point)
            read.append((what, count, *ends))
            read_at.append(at)
            read_angle.append(angle)
            count += 1
        for name in law.states:
            names[name] = signals[f"{law.name}.{name}"] = count
            if law.period is None:
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
            program.add(each.rate or each.update, names, tables, names[name] + 1)
        outputs = []
        for each in law.outputs:
            if each.servo is not None:
                what, row, force = servos[each.servo]
                texts = [text for text in (each.position, each.velocity) if text is not None]
                ends = row, 0 if len(texts) == 2 else 1 if each.velocity is None else 2
                at = np.array([force.position, force.velocity, *np.zeros(8)])
            elif each.body is None:
                what, texts = TORQUE if joints[each.joint].type != "prismatic" else FORCE, [each.effort]
                ends, at = geometry(each.joint)
            else:
                what, texts = BODY if each.axes == "body" else WORLD, [*each.torque, *each.force]
                ends, at = (index[each.body], -1), at_point(each.point)
            acts.append((what, count, *ends))
            acts_at.append(at)
            outputs += [(text, count + k) for k, text in enumerate(texts)]
            count += len(texts)
        if law.period is None:
            for text, number in outputs:
                program.add(text, names, tables, number)
            effects += [number for _, number in outputs]
            continue
        # Others read held values; what is computed at an instant has values of its own.
        found = [names[name] + 1 for name in law.states] + [names[name] for name in law.signals]
        for text, _ in outputs:
            program.add(text, names, tables, count)
            found.append(count)
            count += 1
        first, waiting = len(held), -(-_exact(law.delay) // _exact(law.period))
        held_to += [names[name] for name in law.states]
        for name in law.signals:
            signals[f"{law.name}.{name}"] = count
            held_to.append(count)
            count += 1
        held_to += [number for _, number in outputs] + [UNUSED] * (waiting * len(outputs))
        held += [each.start for each in law.states.values()] + [0.0] * (len(held_to) - first - len(law.states))
        times = _exact(law.period), _exact(law.delay)
        reads = read, read_at, read_angle
        sampled.append(PeriodicLaw(*times, reads, program, found, first, len(outputs), waiting, noisy))
    programs = continuous, *(each.program for each in sampled)
    needed = continuous.begins if sampled else effects + [rate for _, rate in states]
    loads = LawLoads(
        **_program(own_reads, continuous, count, needed),
        acts=np.array(acts, dtype=int).reshape(-1, 4),
        acts_at=np.array(acts_at, dtype=float).reshape(-1, 10),
        held_to=np.array(held_to, dtype=int),
        held=np.array(held, dtype=float),
        states=np.array(states, dtype=int).reshape(-1, 2),
        scales=np.array([each.scale for law in laws_of(scene) if law.period is None for each in law.states.values()]),
        sizes=np.array([count, max(each.deepest for each in programs), len(continuous.surfaces)]),
    )
    return loads, sampled


def _program(reads, program, count, needed):
    """Entries of LawLoads of inputs (read, read_at, read_angle) and a Postfix; count : of all values."""
    read, read_at, read_angle = reads
    begins = np.full(count, -1)
    begins[list(program.begins)] = list(program.begins.values())
    return {
        "read": np.array(read, dtype=int).reshape(-1, 4),
        "read_at": np.array(read_at, dtype=float).reshape(-1, 10),
        "read_angle": np.array(read_angle, dtype=int),
        "code": np.array(program.code, dtype=int).reshape(-1, 2),
        "begins": begins,
        "needed": np.array(list(needed), dtype=int),
        "numbers": np.array(program.numbers, dtype=float),
        "first": np.cumsum([0, *map(len, program.tables)]),
        "points": np.concatenate([np.empty((0, 2)), *program.tables]),
    }


@kernel
def _input(read, read_at, read_angle, i, state, frame, angle):
    """Value of an input."""
    what, a, b, at = read[i, 0], read[i, 2], read[i, 3], three(read_at, i, 0)
    last = read_at[i, 9]
    if what == ANGLE:
        value = angle[read_angle[i]]
        return np.floor(value / last) * last if last > 0.0 else value
    if what == RATE:
        return dot(turned(frame, a, at), turning(frame, a, b))
    if what <= SLIDE_RATE:
        _, _, value, rate = slide(frame, a, b, at, three(read_at, i, 3), three(read_at, i, 6))
        value = np.floor(value / last) * last if last > 0.0 else value
        return value if what == SLIDE else rate
    if what == ATTITUDE:
        w, x, y, z = state[a, 0], state[a, 1], state[a, 2], state[a, 3]
        length = np.sqrt(w * w + x * x + y * y + z * z)
        r, own = read_at[i, 0], three(read_at, i, 1)
        scalar = w * r - dot((x, y, z), own)
        found = plus(plus(cross((x, y, z), own), w, own), r, (x, y, z))
        part = scalar if b == 3 else found[b % 3]
        return part / (length if scalar >= 0.0 else -length)
    if what == SPIN:
        return last + dot(three(read_at, i, 3), three(state, a, 10))
    if what == SPEED:
        return last + dot(three(read_at, i, 3), turned_back(frame, a, point(frame, a, at)[1]))
    begin, end = point(frame, a, at), point(frame, b, three(read_at, i, 3))
    apart = plus(end[0], -1.0, begin[0])
    length = np.sqrt(dot(apart, apart))
    return length if what == APART else dot(apart, plus(end[1], -1.0, begin[1])) / length


@subroutine
def _read(laws, state, frame, angle, values):
    """Write the inputs of laws."""
    read, read_at, read_angle = laws.read, laws.read_at, laws.read_angle
    for i in range(len(read)):
        what, number, a, b = read[i, 0], read[i, 1], read[i, 2], read[i, 3]
        if what < PLACE or what > DIRECTION:
            values[number] = _input(read, read_at, read_angle, i, state, frame, angle)
        elif what == WORLD_SPIN:
            values[number] = frame[a, 15 + b]
        elif what == DIRECTION:
            values[number] = dot(three(frame, a, 3 * b), three(read_at, i, 0))
        elif what == PLACE:
            values[number] = frame[a, 9 + b] + dot(three(frame, a, 3 * b), three(read_at, i, 0))
        else:
            arm = turned(frame, a, three(read_at, i, 0))
            values[number] = frame[a, 12 + b] + cross(three(frame, a, 15), arm)[b]


@subroutine
def set_values(laws, time, state, frame, angle, stack, values, sides, heights):
    """Write all values at a state.

    state : (n, 13), see vectors.place;  angle : see `add_laws`;  sides, heights : see formulas.evaluate
    stack, values : scratch memory of the sizes of the laws
    """
    for j in range(len(laws.held)):
        values[laws.held_to[j]] = laws.held[j]
    values[0] = time
    first = len(angle) - len(laws.states)
    for s in range(len(laws.states)):
        values[laws.states[s, 0]] = angle[first + s]
    _read(laws, state, frame, angle, values)
    evaluate(laws.code, laws.begins, laws.needed, laws.numbers, laws.first, laws.points, stack, values, sides, heights)


@subroutine
def set_targets(laws, values, turn_law, slide_law):
    """Set the targets of servos in loads.Loads to the values of laws."""
    for i in range(len(laws.acts)):
        what, k, row, part = laws.acts[i, 0], laws.acts[i, 1], laws.acts[i, 2], laws.acts[i, 3]
        if what < TURN:
            continue
        position = laws.acts_at[i, 0] if part == 2 else values[k]
        velocity = laws.acts_at[i, 1] if part == 1 else values[k + (part == 0)]
        law = turn_law if what == TURN else slide_law
        law[row, 0] = law[row, 1] * position + law[row, 2] * velocity


class HeldValues:
    """Sampled laws of one integration.

    loads : LawLoads, whose held values change
    laws  : [PeriodicLaw]
    bodies : number of bodies
    """

    def __init__(self, loads, laws, bodies):
        self.loads = loads._replace(held=loads.held.copy())
        self._laws, self._bodies = laws, bodies
        sizes = [(loads.sizes[0], law.program.begins) for law in laws]
        self._own = [loads._replace(**_program(law.read, law.program, *size)) for law, size in zip(laws, sizes)]

    def _next(self, law, first, after):
        """Time in ns of a law's next instant after one, from `first` s on; -1: also the first."""
        k = max(0, int((Fraction(after, NS) - first) / law.period) - 1)
        while round((first + k * law.period) * NS) <= after:
            k += 1
        return round((first + k * law.period) * NS)

    def _starts(self, law):
        """Time in s from which on, once in a period, outputs start that wait."""
        return law.delay % law.period

    def before(self, begin, end):
        """First time in s after `begin` at which held values change; `end` if none is earlier."""
        now = round(begin * NS)
        found = [self._next(law, 0, now) for law in self._laws]
        found += [self._next(law, self._starts(law), now) for law in self._laws if law.waiting]
        first = min(found, default=np.inf)
        return first / NS if first < end * NS - 0.5 else end

    def meet(self, time, state, sides=None):
        """Change the held values at a time in s, in a state and with sides (c,) as of rigid_body_dae.rates.

        sides : None at the start: the arguments of comparisons decide
        """
        sides = np.full(self.loads.sizes[2], FREE) if sides is None else sides
        now, held = round(time * NS), self.loads.held
        for law in self._laws:
            if law.waiting and self._next(law, self._starts(law), now - 1) == now:
                begin = law.first + len(law.found) - law.outputs
                end = begin + (1 + law.waiting) * law.outputs
                held[begin : end - law.outputs] = held[begin + law.outputs : end].copy()
        n = self._bodies
        frame = np.zeros((n + 1, FRAME))
        bodies, angle = state[: 13 * n].reshape(n, 13), state[13 * n :]
        place(bodies, frame)
        stack, values = np.empty(self.loads.sizes[1]), np.empty(self.loads.sizes[0])
        for law, own in zip(self._laws, self._own):
            if self._next(law, 0, now - 1) == now:
                set_values(self.loads, time, bodies, frame, angle, stack, values, sides, np.empty_like(sides))
                _read(own, bodies, frame, angle, values)
                for number, sensor, k in law.noisy:
                    values[number] += sensor.noise_at(now)[k]
                free = np.full(len(law.program.surfaces), FREE)
                program = own.code, own.begins, own.needed, own.numbers, own.first, own.points
                evaluate(*program, stack, values, free, np.empty_like(free))
                found = values[law.found]
                shown = len(found) - law.outputs
                held[law.first : law.first + shown] = found[:shown]
                last = law.first + len(found) + law.waiting * law.outputs
                held[last - law.outputs : last] = found[shown:]


@subroutine
def add_laws(laws, frame, angle, values, force, rate_out):
    """Add the forces of all laws at one state, and write the rates of their states; see loads.add_loads.

    values : after `set_values` at this state;  angle, rate_out : the states and their rates are the last of them
    """
    first = len(angle) - len(laws.states)
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
        elif what <= WORLD:
            torque, push = (values[k], values[k + 1], values[k + 2]), (values[k + 3], values[k + 4], values[k + 5])
            if what == BODY:
                torque, push = turned(frame, a, torque), turned(frame, a, push)
            add_three(force, a, 3, 1.0, torque)
            add_force(force, frame, a, point(frame, a, at)[0], 1.0, push)
