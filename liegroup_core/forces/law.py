# SPDX-License-Identifier: Apache-2.0
"""Laws: efforts of joints and wrenches on bodies by formulas of the user, see formulas.py.

Inputs are numbers of a state (readings.py): coordinates and rates of joints, positions, attitudes and velocities of
points of bodies, numbers of sensors, and signals of earlier laws. Signals are formulas of the time, inputs, parameters,
tables and earlier signals. Outputs are formulas, too:

    effort of a joint      torque about or force along its z axis on the child, the opposite on the parent (axis.py)
    wrench on a body       torque and force at a point of the body, in its axes or in world axes
    target of a servo      position and velocity, in place of those of the servo (joint_law.py)

States have a start and a rate, a formula that may use all signals. A state is the rate of a link of its own in the tree
(mechanism/links.py), with unit inertia and the rate of the state as its effort: every method integrates it, with its
order, error control and derivatives. After a step its value is kept behind the unwrapped angles.

All laws of a scene are one program, evaluated once a stage. Its registers are memory of a run; the first is the time,
the next ones say which number was not finite last, and have the time of formulas.
Where a comparison, min, max, abs or table changes its branch is an event, which methods with error control locate
(events/crossings.py); other methods take the branch of each stage.

A law with a period is evaluated at exact instants, by instructions of its own (sampled.py). Its signals and outputs are
numbers that are held in between: they are kept behind the unwrapped angles, before the states.

Both sides of a comparison may lead back to where its two values are equal. The motion then slides along this surface,
see dynamics/sliding.py; after the held numbers is kept what its branch is: 0, or SHARED plus the share of one side.
"""

import math
import operator
from collections import Counter, deque
from contextlib import nullcontext
from itertools import chain
from keyword import iskeyword
from typing import Annotated, Literal, NamedTuple

import numpy as np
from pydantic import BeforeValidator, Field, PrivateAttr, WithJsonSchema, model_validator

from liegroup_core.compiling import Struct, borrowed, kernel, shared, subroutine
from liegroup_core.errors import SceneError
from liegroup_core.fields.values import (
    Described,
    Name,
    NotNegative,
    Number,
    Positive,
    Text,
    Vector3,
    listed,
    place_text,
    suggestion,
)
from liegroup_core.lie.vec3 import add3, cross3, dot3, load3, load9, tmatvec3, vector3

from . import axis
from .described import Force
from .formulas import (
    ABOVE,
    ADD,
    BELOW,
    BRANCHED,
    COMPARISONS,
    DIVIDE,
    MORE,
    MORE_EQUAL,
    MULTIPLY,
    RESERVED,
    SUBTRACT,
    TABLE,
    TIME,
    UNKNOWN,
    FormulaError,
    Program,
    branch_of_segment,
    differentiate,
    distances,
    evaluate,
    present_branch,
    table_arrays,
    tree,
)
from .instants import exact_seconds
from .readings import INPUT, POINTS, RATE, input_row, names_of, number_of, read_all, read_changes, reading, varies
from .skipping import arrange

OUTPUT = np.dtype(
    [
        ("under", "i8"),  # register f of the block that computes all of it, see skipping.py, or -1
        ("body", "i8"),  # -1: an effort of a joint
        ("registers", "i8", (6,)),  # torque, force; of an effort the first
        ("in_world", "i8"),  # 1: in world axes
        ("point", "f8", (3,)),
        ("unit", "i8"),  # first of the registers with the unit wrenches of the joint
        *axis.FIELDS,
    ],
    align=True,
)
# Points of contact: kink of the comparison of their depth with zero; bodies, -1 for a plane; m, from the origin of each
# body to the farthest point of its shape, and how far they may move in a step while they are near.
CLOSING = np.dtype([("kink", "i8"), ("bodies", "i8", (2,)), ("reach", "f8", (2,)), ("size", "f8")], align=True)
ORIGIN = (0.0, 0.0, 0.0)
# Register of 1.0 in a column if another program wrote results to this column after the last pass of Laws.code.
FOREIGN = 4
WITNESS = 1  # register of the last result that was not finite: its number from 1 on, and the time
LAW_TIME = 3  # register of the time in formulas
CAUSE = 2  # the next one: number of the first signal that was not finite then, 0 for none, and the value of the result
MOST_PERIODS = 1000  # of a delay
NO_AXIS = axis.fields(False, -1, -1, np.eye(4), np.eye(4))


class Laws(Struct):
    """All laws of a scene."""

    axes: np.ndarray  # (j,) of axis.ROW: joints that are read or driven
    units: np.ndarray  # (j, 2) first of the registers with their unit wrenches; 1: also needed without derivatives
    inputs: np.ndarray  # (k,) of INPUT
    code: np.ndarray  # (p, 5) instructions, and blocks that can be skipped, see skipping.py
    shown: np.ndarray  # (p', 5) the same, with signals that no output needs
    kinks: np.ndarray  # (q, 2) those with branches that can change; register f of the block it is in, or -1
    branches: int  # first of the registers with their branches, in this order
    surfaces: np.ndarray  # (s,) numbers of the kinks along which a motion can slide
    # (q,) 1 where laws may jump, which are the first ones, 2 where a motion can slide, -1 where nothing jumps, and a
    # branch that goes on beyond its end does not leave the other one at once: bends of contacts, -2 of their bristles
    compared: np.ndarray
    tables: np.ndarray  # (t + 1,) first points of the tables
    points: np.ndarray  # (n, 2) their points
    outputs: np.ndarray  # (o,) of OUTPUT
    owners: np.ndarray  # (o,) number of the law of each output
    closing: np.ndarray  # (c,) of CLOSING
    results: np.ndarray  # (r,) registers of outputs and of rates of states, of all continuous laws
    signals: np.ndarray  # (w,) registers of their signals; 0: not computed at any time
    # (s, 2 + p) registers of the value and of the rate of each state; of the conditions under which anything reads it,
    # the outer one first, then -1
    states: np.ndarray
    held: np.ndarray  # (h,) registers of the numbers of sampled laws, which follow the unwrapped angles, or -1
    first: int  # number of unwrapped angles
    sampled_inputs: np.ndarray  # of INPUT, of one sampled law after another
    sampled_code: np.ndarray  # (q, 5) instructions, as many
    start: np.ndarray  # held numbers, zeros of surfaces, and states at the start
    scales: np.ndarray  # (s,) magnitudes, to which the absolute tolerance of error control refers
    registers: np.ndarray  # (m, 2) at the start: value, derivative
    late: np.ndarray  # (1,) s by which the time of the run is later than that of formulas
    timed: bool  # whether any depends on the time


def _quantity(value):
    return {"quantity": value} if isinstance(value, str) else value


def _formula(value):
    if isinstance(value, bool) or not isinstance(value, (str, int, float, np.integer, np.floating)):
        raise ValueError('must be a formula, such as "k*(1 - q)", or a number')
    try:
        tree(value)
    except FormulaError as error:
        raise SceneError(f"{error}") from None
    return value if isinstance(value, str) else repr(float(value))


def _three(value):
    value = listed(value)
    if len(value) != 3:
        raise ValueError("must be three formulas [x, y, z]; quote a formula that has a comma")
    return value


def _rising(values):
    if len(values) < 2 or not all(a < b for a, b in zip(values, values[1:])):
        raise ValueError("must be at least two numbers that increase")
    return values


def _period(value):
    if isinstance(value, bool) or not isinstance(value, (int, float, np.floating)) or not 1e-9 <= value <= 1e9:
        raise ValueError("must be a number of seconds from 1e-9 to 1e9")
    return float(value)


Formula = Annotated[str, BeforeValidator(_formula), WithJsonSchema({"type": ["string", "number"]})]
Formulas = Annotated[tuple[Formula, Formula, Formula], BeforeValidator(_three)]
Numbers = Annotated[tuple[Number, ...], BeforeValidator(listed)]
Period = Annotated[float, BeforeValidator(_period), WithJsonSchema({"type": "number", "exclusiveMinimum": 0})]


class LawInput(Described):
    """Number of a state that a law reads; a text alone is its quantity."""

    quantity: Text = Field(
        description="JOINT.position or JOINT.velocity of a joint with one coordinate; BODY.x y z (world axes), "
        "dx dy dz (their rates), ox oy oz (angular velocity, world axes), qx qy qz qw, wx wy wz or vx vy vz (body "
        "axes) of a body; SENSOR.PART of a sensor, such as imu.wx, but no accelerations and wrenches, and only with a "
        "period if it has noise or a resolution; LAW.SIGNAL or LAW.STATE of an earlier law"
    )
    point: Vector3 | None = Field(
        None, description="point of the body in m, in its frame, for its x y z dx dy dz vx vy vz; default: its origin"
    )


class LawTable(Described):
    """Function by linear interpolation between points; beyond them the value at the end."""

    x: Numbers = Field(description="values of the argument, increasing")
    y: Numbers = Field(description="values of the function, as many")

    @model_validator(mode="after")
    def _check(self):
        try:
            _rising(self.x)
        except ValueError as error:
            raise SceneError(f"x {error}", place=("x",)) from None
        if len(self.y) != len(self.x):
            raise SceneError(f"y must have as many values as x, {len(self.x)}, and has {len(self.y)}", place=("y",))
        return self


class LawState(Described):
    """Number that changes by its rate, or at the instants of a sampled law."""

    rate: Formula | None = Field(
        None, description="formula of its derivative by time, which may use all inputs, signals and states"
    )
    update: Formula | None = Field(
        None, description="of a law with a period, in place of rate: formula of its value after each instant"
    )
    start: Number = Field(0.0, description="value at the start")
    scale: Positive = Field(1.0, description="magnitude that counts as 1 in the tolerances of error control")


class LawOutput(Described):
    """What a law exerts: the effort of a joint, a wrench on a body, or the target of a servo."""

    joint: Text | None = Field(None, description="name of a joint with one coordinate")
    effort: Formula | None = Field(None, description="formula of its torque in N m or force in N on the child")
    body: Text | None = Field(None, description="name of a body, in place of joint and effort")
    torque: Formulas = Field(("0", "0", "0"), description="three formulas, N m")
    force: Formulas = Field(("0", "0", "0"), description="three formulas, N")
    point: Vector3 = Field((0.0, 0.0, 0.0), description="point of application in m, in the body frame")
    axes: Literal["body", "world"] = Field("body", description="axes of torque and force: body or world")
    servo: Text | None = Field(None, description="name of a servo or linear_servo, in place of joint and effort")
    position: Formula | None = Field(None, description="formula of its target position in rad or m; default: its own")
    velocity: Formula | None = Field(None, description="formula of its target velocity; default: its own")

    @model_validator(mode="after")
    def _check(self):
        owners = {"joint": {"effort"}, "body": {"torque", "force", "point", "axes"}, "servo": {"position", "velocity"}}
        given = [owner for owner in owners if getattr(self, owner) is not None]
        if len(given) != 1 or self.model_fields_set - owners[given[0]] - {given[0]}:
            raise SceneError("give either joint and effort, or body with torque and force, or servo with position")
        if self.servo is not None and (self.position, self.velocity) == (None, None):
            raise SceneError("position or velocity is missing", place=("position",))
        if self.joint is not None and self.effort is None:
            raise SceneError("effort is missing", place=("effort",))
        return self

    @property
    def formulas(self):
        """[(key, formula)]: one or two, or six."""
        if self.body is None:
            return [(key, text) for key in ("effort", "position", "velocity") if (text := getattr(self, key))]
        return [(key, text) for key in ("torque", "force") for text in getattr(self, key)]


class Law(Force):
    """Efforts and wrenches by formulas."""

    type: Literal["law"] = Field("law", description="law")
    period: Period | None = Field(
        None,
        description="s: it reads its inputs at 0 and all multiples of the period, and holds its signals and outputs "
        "in between; default: continuous",
    )
    delay: NotNegative = Field(
        0.0, description=f"s, of a law with a period, at most {MOST_PERIODS} of them: its outputs act so much later"
    )
    inputs: dict[Name, Annotated[LawInput, BeforeValidator(_quantity)]] = Field(
        {}, description="{name: quantity} that its formulas use"
    )
    parameters: dict[Name, Number] = Field({}, description="{name: number}, which sweep and identify can vary")
    tables: dict[Name, LawTable] = Field({}, description="{name: {x: [...], y: [...]}}, used as name(value)")
    states: dict[Name, LawState] = Field({}, description="{name: {rate: formula, start: number}}")
    signals: dict[Name, Formula] = Field(
        {}, description="{name: formula}, in order; recorded and plotted as LAW.SIGNAL; see the guide of laws"
    )
    outputs: Annotated[tuple[LawOutput, ...], BeforeValidator(listed)] = Field(
        (), description="list of efforts of joints and wrenches on bodies"
    )

    _jumps: bool = PrivateAttr(True)
    _closing: list = PrivateAttr([])  # [(signal of a depth, *CLOSING of it)]
    _follows: set = PrivateAttr(set())  # signals whose branches are always those of their arguments
    _bends: set = PrivateAttr(set())  # signals that do not jump where their comparisons change

    @model_validator(mode="after")
    def _check(self):
        known = {}
        for key in ("inputs", "parameters", "tables", "states", "signals"):
            for name in getattr(self, key):
                if name in RESERVED or iskeyword(name):
                    raise SceneError(f"{key}: the name {name} is taken by formulas: choose another", place=(key, name))
                if name in known:
                    raise SceneError(
                        f"{key}: {name} is also one of its {known[name]}: choose another", place=(key, name)
                    )
                known[name] = key
        wanted, other = ("rate", "update") if self.period is None else ("update", "rate")
        for name, each in self.states.items():
            place = ("states", name, wanted)
            if getattr(each, other) is not None:
                kind = "a law without a period" if self.period is None else "a law with a period"
                raise SceneError(f"states.{name}.{other}: {kind} has {wanted} in its place", place=place[:2] + (other,))
            if getattr(each, wanted) is None:
                raise SceneError(f"states.{name}: {wanted} is missing", place=place)
        if self.delay and (self.period is None or self.delay > MOST_PERIODS * self.period):
            raise SceneError(f"delay requires a period, at least {self.delay / MOST_PERIODS:g} s", place=("delay",))
        if not (self.signals or self.states or self.outputs):
            raise SceneError("outputs is missing: a law exerts efforts or wrenches, or has signals", place=("outputs",))
        try:
            self.compile(Program(), {})
        except _Misplaced as error:
            raise SceneError(error.text, place=error.place) from None
        return self

    @property
    def as_law(self):
        """Itself, see `laws_of`."""
        return self

    @property
    def shown(self):
        """Names of what others can read."""
        return [name for name in (*self.states, *self.signals) if name[0] != "_"]

    def compile(self, program, others):
        """_Compiled in a Program.

        others : {LAW.SIGNAL: register} of earlier laws; an input that is none of them gets a register of its own
        """
        inputs = {}
        for name, each in self.inputs.items():
            inputs[name] = others[each.quantity] if each.quantity in others else program.new()
        states = {name: program.new(each.start) for name, each in self.states.items()}
        parameters = {name: program.constant(value) for name, value in self.parameters.items()}
        names = {TIME: LAW_TIME} | inputs | states | parameters
        tables = {name: program.table(each.x, each.y) for name, each in self.tables.items()}
        signals, key, begin = {}, "rate" if self.period is None else "update", len(program.code)
        with nullcontext() if self.period is None else program.apart() as code:
            for name, text in self.signals.items():
                first, program.follows = len(program.code), name in self._follows
                signals[name] = names[name] = _compiled(program, text, names, tables, ("signals", name))
                program.follows = False
                if name in self._bends:
                    program.bent.update(range(first, len(program.code)))
            outputs = [
                [_compiled(program, text, names, tables, ("outputs", k, key)) for key, text in each.formulas]
                for k, each in enumerate(self.outputs)
            ]
            rates = [
                _compiled(program, getattr(each, key), names, tables, ("states", name, key))
                for name, each in self.states.items()
            ]
        if self.period is None:
            is_timed = LAW_TIME in program.read_from(begin) | {*rates, *signals.values(), *chain(*outputs)}
            return _Compiled(inputs, states, parameters, rates, signals, outputs, is_timed)
        found = [*rates, *signals.values(), *chain(*outputs)]
        signals = {name: program.new() for name in signals}
        outputs = [[program.new() for _ in each] for each in outputs]
        held = [*states.values(), *signals.values(), *chain(*outputs)]
        sampled = Held(found, held, code, self._names_held())
        return _Compiled(inputs, states, parameters, (), signals, outputs, False, sampled)

    def _names_held(self):
        """Names of the numbers that the law holds: states, signals, outputs."""
        outputs = [f"outputs[{k}].{key}" for k, each in enumerate(self.outputs) for key in numbered(each.formulas)]
        return [*self.states, *self.signals, *outputs]

    @property
    def can_slide(self):
        """Whether an output may jump at a comparison, so that a motion slides along it: not those of contacts."""
        return self.period is None and self._jumps

    def on_bodies(self, child_of):
        """Names of the bodies that it reads or acts on, and of laws; child_of : {joint, servo or sensor: body}."""
        found = [each.quantity.rpartition(".")[0] for each in self.inputs.values()]
        found += [each.joint or each.body or each.servo for each in self.outputs]
        return sorted({child_of.get(name, name) for name in found})

    def at_centres(self, com):
        """Entries that change if body frames are at the centres of mass; com : {body: (3,) m}."""

        def moved(entry, body, moves=True):
            return entry.remade(point=np.array(entry.point or ORIGIN) - com[body]) if moves and body in com else entry

        inputs = {}
        for name, each in self.inputs.items():
            owner, _, part = each.quantity.rpartition(".")
            inputs[name] = moved(each, owner, part in POINTS)
        return {"inputs": inputs, "outputs": [moved(each, each.body) for each in self.outputs]}


def numbered(formulas):
    """Keys of the formulas of an output, with a number where a key has three."""
    return [key if len(formulas) < 6 else f"{key}[{n % 3}]" for n, (key, _) in enumerate(formulas)]


class Held(NamedTuple):
    """What a sampled law computes and holds."""

    found: list  # registers of the results of its instructions: states after the instant, signals, outputs
    held: list  # registers that hold them
    code: list  # instructions
    names: list


class _Compiled(NamedTuple):
    """Registers of a law: by names of inputs, states, parameters, signals; of the rates of states, of each output."""

    inputs: dict
    states: dict
    parameters: dict
    rates: list
    signals: dict
    outputs: list
    is_timed: bool  # whether formulas that are evaluated at any time have the time
    sampled: Held | None = None

    @property
    def shown(self):
        """{name: register} of what others can read; names with _ are those of contacts."""
        return {name: at for name, at in (self.states | self.signals).items() if name[0] != "_"}


class _Misplaced(Exception):
    def __init__(self, text, place):
        super().__init__(text)
        self.text, self.place = text, place


def _compiled(program, text, names, tables, place):
    try:
        return program.compile(text, names, tables)
    except FormulaError as error:
        raise _Misplaced(f"{place_text(place, {})}: {error}", place) from None


def refuse_law(law, bodies, moves, earlier, sensors, servos, i):
    """Refuse a law whose quantities, joints, bodies or servos do not exist.

    bodies : names;  moves : names of the joints with one coordinate;  earlier : [LAW.SIGNAL];  sensors : of the scene
    servos : names of those that no earlier law leads
    """
    where = f'forces[{i}] "{law.name}": '
    known, named = [*names_of(bodies, moves, sensors), *earlier], {each.name: each for each in sensors}
    for name, each in law.inputs.items():
        place = ("forces", i, "inputs", name)
        if each.quantity not in known:
            hint = suggestion(each.quantity, known)
            raise SceneError(
                f"{where}inputs.{name}: {each.quantity!r:.60} is no quantity of a law; {hint}", place=place
            )
        owner, _, part = each.quantity.rpartition(".")
        if owner in named and law.period is None and varies(named[owner], number_of(named[owner], part)):
            raise SceneError(
                f"{where}inputs.{name}: {each.quantity} has noise or a resolution: give the law a period", place=place
            )
        if each.point is not None and not (owner in bodies and part in POINTS):
            raise SceneError(f"{where}inputs.{name}: {each.quantity} has no point: omit it", place=place)
    for k, each in enumerate(law.outputs):
        kinds = ("joint", moves, "joint with one coordinate"), ("body", bodies, "body"), ("servo", servos, "servo")
        for key, names, what in kinds:
            name = getattr(each, key)
            if name is not None and name not in names:
                hint = suggestion(name, list(names)) if names else f"the scene has no {what}"
                raise SceneError(
                    f"{where}outputs[{k}]: {key} {name!r:.40} is not a {what}; {hint}",
                    place=("forces", i, "outputs", k, key),
                )


def laws_of(described):
    """Laws among the forces of a scene, and those of contacts."""
    return [force.as_law for force in described if hasattr(force, "as_law")]


def unwrapped_inputs(described, turning, sensors=()):
    """[(joint, name)] of the unwrapped angles of laws; turning : names of joints whose coordinate is an angle."""
    found, encoders = {}, {each.name: each.joint for each in sensors if each.type == "encoder"}
    for law in laws_of(described):
        for each in law.inputs.values():
            joint, _, part = each.quantity.rpartition(".")
            joint, part = (encoders[joint], "position") if joint in encoders else (joint, part)
            if part == "position" and joint in turning:
                found[joint] = f"{law.name} at {joint}"
    return list(found.items())


def signals_of(described):
    """{LAW.SIGNAL: register} of a scene, in order; those of `make_laws`."""
    return _compile_all(described).signals


def registers_of(described):
    """{(law, signal): register} of a scene, also of signals that others cannot read."""
    program = _compile_all(described)
    pairs = zip(program.laws, program.compiled)
    return {(law.name, name): register for law, own in pairs for name, register in own.signals.items()}


class _Program(NamedTuple):
    """Formulas of all laws of a scene.

    formulas : the Program
    code, shown, kinks : see Laws
    moments : numbers of its instructions that compare with what may be the time
    times   : [s] that are compared with the time, in order
    branches : first of the registers with the branches of kinks
    always  : registers of the results that are computed at any time, see skipping.py;  zero : register of the number 0
    under   : {register of a result: register f of its block, or -1};  numbers : registers of numbers and parameters
    read    : {register that others in `code` read: conditions of all blocks around those};  inputs : read by `shown`
    owners  : [name] of the law of each kink
    compared, surfaces : numbers of the kinks where laws may jump, and of those along which a motion can slide
    yields  : numbers of those where bristles of contacts yield, see Law._bends
    """

    laws: list
    compiled: list  # [_Compiled] of each
    signals: dict  # {LAW.SIGNAL: register}
    formulas: Program
    registers: list
    code: np.ndarray
    shown: np.ndarray
    kinks: np.ndarray
    branches: int
    owners: list
    compared: list
    yields: list
    surfaces: list
    moments: list
    times: list
    always: set
    under: dict
    numbers: set
    zero: int
    read: dict
    inputs: set


_LAST = deque(maxlen=4)  # _Programs: one scene asks for its own many times


def _differ_in_numbers(one, other):
    """Whether two laws are equal but for the values of their parameters."""
    one, other = (
        (law.parameters.keys(), {**dict(law), "parameters": None}, law._jumps, law._follows, law._bends)
        for law in (one, other)
    )
    return one == other


def _compile_all(described):
    laws = laws_of(described)
    # An analysis makes several simulations of one scene, and varies its numbers.
    for same in (operator.is_, operator.eq, _differ_in_numbers):
        for each in _LAST:
            if len(each.laws) == len(laws) and all(map(same, each.laws, laws)):
                return each if same is not _differ_in_numbers else _with_numbers(each, laws)
    program, signals, found, owners, needed = Program(), {}, [], [], []
    program.new(), program.new(), program.new(), program.new()  # WITNESS, CAUSE, LAW_TIME, FOREIGN
    zero = program.number(0.0)  # the first number: in each comparison with it, it is the first argument
    for law in laws:
        try:
            found.append(law.compile(program, signals))
        except _Misplaced as error:  # each law compiles alone, so there are too many
            raise SceneError(f'forces "{law.name}": {error.text.partition(": ")[2]}') from None
        owners += [law.name] * (len(program.code) - len(owners))
        signals |= {f"{law.name}.{name}": register for name, register in found[-1].shown.items()}
        if law.period is None:
            needed += [*chain(*found[-1].outputs), *found[-1].rates]
    kinks = program.branched(needed) - program.followed
    # Comparisons of one surface share its branch, so none is in a block that others skip; the first one is its kink.
    alike = Counter(program.code[i][4] for i in kinks)
    apart = {program.code[i][1] for i in kinks if alike[program.code[i][4]] > 1}
    kinks = {*{program.code[i][4]: i for i in sorted(kinks, reverse=True)}.values()}
    rows, read = arrange(program.code, {*needed, *apart}, zero, program.new)
    shown, read_by_all = arrange(program.code, {*needed, *apart, *signals.values()}, zero, program.new)
    # Comparisons first, as laws jump only there.
    bends = {i for i in kinks if program.code[i][0] not in COMPARISONS} | program.bent
    kinks = [(i, at, flag) for at, (_, i, flag) in enumerate(rows) if i in kinks]
    kinks.sort(key=lambda kink: (kink[0] in bends, kink[0]))
    compared = [k for k, (i, *_) in enumerate(kinks) if i not in bends]
    sliding = {law.name for law in laws if law.can_slide}
    codes = [np.array([row for row, *_ in each], dtype=np.int32).reshape(-1, 5) for each in (rows, shown)]
    renumbered, branches = np.arange(len(program.registers)), len(program.registers)
    for i, *_ in kinks:
        renumbered[program.code[i][4]] = program.new()
    for each in codes:
        branched = np.isin(each[:, 0], BRANCHED)
        each[branched, 4] = renumbered[each[branched, 4]]
    moments = [kinks[k][0] for k in compared]
    _LAST.append(
        _Program(
            laws,
            found,
            signals,
            program,
            program.registers,
            *codes,
            np.array([row for _, *row in kinks], dtype=np.int64).reshape(-1, 2),
            branches,
            [owners[i] for i, *_ in kinks],
            compared,
            [k for k, (i, *_) in enumerate(kinks) if i in program.bent],
            [k for k in compared if owners[kinks[k][0]] in sliding],
            moments,
            _times(program, program.registers, moments),
            {row[1] for row, i, flag in rows if i >= 0 and flag < 0},
            {row[1]: flag for row, i, flag in rows if i >= 0},
            program.constants,
            zero,
            read,
            read_by_all.keys(),
        )
    )
    return _LAST[-1]


def _with_numbers(program, laws):
    """_Program of laws that differ from its own in the values of parameters only."""
    registers = [*program.registers]
    for law, compiled in zip(laws, program.compiled):
        for name, value in law.parameters.items():
            registers[compiled.parameters[name]] = value
    times = _times(program.formulas, registers, program.moments)
    _LAST.append(program._replace(laws=laws, registers=registers, times=times))
    return _LAST[-1]


def _times(program, registers, comparisons):
    """Times in s of comparisons of t, or a sum with it, with a number, in order; comparisons : places in the code."""
    numbers, ahead = {k: registers[k] for k in program.constants}, {LAW_TIME: 0.0}  # ahead of t
    operations = {ADD: np.add, SUBTRACT: np.subtract, MULTIPLY: np.multiply, DIVIDE: np.divide}
    for operation, to, a, b, _ in program.code:
        if operation in operations and b in numbers:
            if a in numbers:
                with np.errstate(all="ignore"):
                    numbers[to] = float(operations[operation](numbers[a], numbers[b]))
            elif a in ahead and operation in (ADD, SUBTRACT):
                ahead[to] = float(operations[operation](ahead[a], numbers[b]))
        elif operation == ADD and a in numbers and b in ahead:
            ahead[to] = numbers[a] + ahead[b]
    pairs = [pair for i in comparisons for pair in (program.code[i][2:4], program.code[i][3:1:-1])]
    return sorted(filter(math.isfinite, {numbers[b] - ahead[a] for a, b in pairs if a in ahead and b in numbers}))


def owners_of_kinks(described):
    """Names of the laws of `Laws.kinks`."""
    return _compile_all(described).owners


def times_of_kinks(described):
    """Times in s that continuous laws compare with the time, in order."""
    return _compile_all(described).times


def target_registers(described):
    """{servo: [register of its target position or -1, of its target velocity or -1]} of the servos that laws lead."""
    found = {}
    program = _compile_all(described)
    for law, compiled in zip(program.laws, program.compiled):
        for each, own in zip(law.outputs, compiled.outputs):
            if each.servo is not None:
                places = dict(zip((key for key, _ in each.formulas), own))
                found[each.servo] = [places.get(key, -1) for key in ("position", "velocity")]
    return found


def law_with_time(described):
    """Name of a law that evaluates a formula with the time at any time, or ""."""
    program = _compile_all(described)
    return next((law.name for law, compiled in zip(program.laws, program.compiled) if compiled.is_timed), "")


def leaders(described):
    """{servo: law} of the servos whose target is an output of a law."""
    return {each.servo: law.name for law in laws_of(described) for each in law.outputs if each.servo is not None}


def results_of(described):
    """([(law, number)] of outputs and rates, the same of signals) of continuous laws, as Laws.results and signals."""
    results, signals = [], []
    for law in laws_of(described):
        if law.period is None:
            names = law._names_held()
            first = len(law.states) + len(law.signals)
            results += [(law.name, name) for name in names[first:]]
            results += [(law.name, f"states.{name}.rate") for name in law.states]
            signals += [(law.name, f"signals.{name}") for name in law.signals]
    return results, signals


def undefined_text(law, name, value, time, cause=""):
    """One line on a number of a law that is not finite; cause : the signal that was not finite."""
    because = f", because its signal {cause} is not finite" if cause else ""
    return f"the law {law} gives {name} = {value:g} at t = {time:.9g} s{because}: change its formula"


def undefined_of(described, registers):
    """(time in s, text) of the result of a law that was not finite last, or None."""
    number = int(registers[WITNESS, 0])
    if number == 0:
        return None
    results, signals = results_of(described)
    (law, name), cause, time = results[number - 1], int(registers[CAUSE, 0]), float(registers[WITNESS, 1])
    signal = signals[cause - 1] if cause else ("", "")
    known = signal[1].removeprefix("signals.") if signal[0] == law else ""
    return time, undefined_text(law, name, registers[CAUSE, 1], time, known)


def states_of(described):
    """[(LAW.STATE, LawState)] of the continuous laws of a scene, in order; hidden ones without the underline."""
    laws = [law for law in laws_of(described) if law.period is None]
    return [(f"{law.name}.{name.removeprefix('_')}", each) for law in laws for name, each in law.states.items()]


class SampledLaw(NamedTuple):
    """A law with a period, and where its numbers are."""

    law: Law
    first: int  # of its numbers, among all held ones: states, signals, outputs, then delayed outputs, the oldest first
    inputs: slice  # of Laws.sampled_inputs
    code: slice  # of Laws.sampled_code
    found: np.ndarray  # registers of what its instructions compute: states after the instant, signals, outputs
    outputs: int  # number of numbers of its outputs, the last ones
    delayed: int  # number of sets of outputs that wait
    noisy: list  # [(number of an input, sensor, number of the sensor)] of those that may have noise

    @property
    def names(self):
        """Names of its held numbers."""
        own = self.law._names_held()
        last = own[len(own) - self.outputs :]
        own += [f"{name} delayed {k + 1}" for k in range(self.delayed) for name in last]
        return [f"{self.law.name}.{name}" for name in own]


def sampled_laws(described, sensors=()):
    """[SampledLaw] of a scene, in order; sensors : of the scene."""
    found, first, inputs, code, signals = [], 0, 0, 0, set()
    sensors = {each.name: each for each in sensors}
    program = _compile_all(described)
    for law, compiled in zip(program.laws, program.compiled):
        known = {*signals}
        signals |= {f"{law.name}.{name}" for name in compiled.shown}
        if law.period is None:
            continue
        sampled, delayed = compiled.sampled, math.ceil(exact_seconds(law.delay) / exact_seconds(law.period))
        outputs = sum(map(len, compiled.outputs))
        noisy, rows = [], [each for each in law.inputs.values() if each.quantity not in known]
        for k, each in enumerate(rows):
            owner, _, part = each.quantity.rpartition(".")
            if owner in sensors and hasattr(sensors[owner], "noise_at"):
                noisy.append((k, sensors[owner], number_of(sensors[owner], part)))
        parts = slice(inputs, inputs + len(rows)), slice(code, code + len(sampled.code))
        registers = np.array(sampled.found, dtype=np.int64)
        found.append(SampledLaw(law, first, *parts, registers, outputs, delayed, noisy))
        first += len(sampled.held) + delayed * outputs
        inputs, code = inputs + len(rows), code + len(sampled.code)
    return found


def held_of(described):
    """Names of the numbers that sampled laws hold, and of branches of surfaces, as they follow the unwrapped angles."""
    program, names = _compile_all(described), []
    owners = [program.owners[k] for k in program.surfaces]
    for number, owner in enumerate(owners):
        names.append(f"{owner}.branches[{number - owners.index(owner)}]")
    return [name for each in sampled_laws(described) for name in each.names] + names


def make_laws(described, index, ends, angles, slides, first, sensors=()):
    """Laws of the forces of a scene, with its sensors.

    index, ends : see kinds.make_forces;  angles : {joint: index of its unwrapped angle};  first : number of these
    slides : names of the joints whose coordinate is a displacement
    """
    program = _compile_all(described)
    compared, surfaces = set(program.compared), set(program.surfaces)
    contacts = {law.name for law in program.laws if not law._jumps}
    kinds = [
        (k in compared) + (k in surfaces) or -(owner in contacts) - (k in program.yields)
        for k, owner in enumerate(program.owners)
    ]
    all_registers = [*program.registers]
    outputs, owners, states, held, start, sampled_code, results, shown = [], [], [], [], [], [], [], []
    reads = {False: [], True: []}  # of continuous laws, and of sampled ones
    waiting = iter(sampled_laws(described))
    sensors, joints = {each.name: each for each in sensors}, {}

    def unit_of(joint, always):
        """First register of the unit wrenches of a joint."""
        first, before = joints.get(joint) or (len(all_registers), False)
        if joint not in joints:
            all_registers.extend([0.0] * 6)
        joints[joint] = first, before or always
        return first

    for number, (law, compiled) in enumerate(zip(program.laws, program.compiled)):
        inputs = reads[law.period is not None]
        if law.period is None:
            paths = [program.read.get(at, (program.zero,)) for at in compiled.states.values()]
            states += zip(compiled.states.values(), compiled.rates, paths)
            results += [*chain(*compiled.outputs), *compiled.rates]
            shown += [at if at in program.always else 0 for at in compiled.signals.values()]
        else:
            own, late = compiled.sampled, next(waiting)
            later = late.delayed * late.outputs
            held += own.held + [-1] * later
            start += [each.start for each in law.states.values()] + [0.0] * (len(own.held) - len(law.states) + later)
            sampled_code += own.code
        for name, each in law.inputs.items():
            if each.quantity in program.signals or law.period is None and compiled.inputs[name] not in program.inputs:
                continue
            found = reading(each.quantity, ends, sensors, each.point)
            motion = axis.fields(found.joint in slides, *ends[found.joint]) if found.joint else NO_AXIS
            unit = unit_of(found.joint, found.what == RATE) if found.joint else -1
            inputs.append(input_row(found, compiled.inputs[name], index, angles, unit, motion))
        for each, own in zip(law.outputs, compiled.outputs):
            if each.joint is not None:
                motion = axis.fields(each.joint in slides, *ends[each.joint])
                outputs.append((-1, -1, own * 6, 0, each.point, unit_of(each.joint, True), *motion))
            elif each.body is not None:
                under = {program.under.get(at, -1) for at in own if at not in program.numbers} or {-1}
                under = under.pop() if len(under) == 1 else -1
                outputs.append((under, index[each.body], own, each.axes == "world", each.point, -1, *NO_AXIS))
        owners += [number] * (len(outputs) - len(owners))
    kink_of = {each: k for k in program.compared for each in program.code[program.kinks[k, 0], 2:4].tolist()}
    closing = [
        (kink_of[compiled.signals[depth]], [index.get(body, -1) for body in bodies], reach, size)
        for law, compiled in zip(program.laws, program.compiled)
        for depth, bodies, reach, size in law._closing
    ]
    deepest = max((len(path) for *_, path in states), default=0)
    states = [(*own, *path, *[-1] * (deepest - len(path))) for *own, path in states]
    begins, points = table_arrays(program.formulas.tables)
    registers = np.zeros((len(all_registers), 2))
    registers[:, 0] = all_registers
    inputs, sampled_inputs = (np.array(rows, dtype=INPUT) for rows in reads.values())
    return Laws(
        axes=np.array([axis.fields(joint in slides, *ends[joint]) for joint in joints], dtype=axis.ROW),
        units=np.array(list(joints.values()), dtype=np.int64).reshape(-1, 2),
        inputs=inputs,
        code=program.code,
        shown=program.shown,
        kinks=program.kinks,
        branches=program.branches,
        surfaces=np.array(program.surfaces, dtype=np.int64),
        compared=np.array(kinds, dtype=np.int64),
        tables=begins,
        points=points,
        outputs=np.array(outputs, dtype=OUTPUT),
        owners=np.array(owners, dtype=np.int64),
        closing=np.array(closing, dtype=CLOSING),
        results=np.array(results, dtype=np.int64),
        signals=np.array(shown, dtype=np.int64),
        states=np.array(states, dtype=np.int64).reshape(-1, 2 + deepest),
        held=np.array(held, dtype=np.int64),
        first=first,
        sampled_inputs=sampled_inputs,
        sampled_code=np.array(sampled_code, dtype=np.int32).reshape(-1, 5),
        start=np.array([*start, *[0.0] * len(program.surfaces), *(each.start for _, each in states_of(described))]),
        scales=np.array([each.scale for _, each in states_of(described)]),
        registers=registers,
        late=np.zeros(1),
        timed=law_with_time(described) != "",
    )


def places_of_branches(laws):
    """Slice of the unwrapped angles of a state that has the branches of its surfaces; 0: the motion does not slide."""
    first = laws.first + len(laws.held)
    return slice(first, first + len(laws.surfaces))


@kernel
def state_matters(laws, registers, s):
    """Whether anything depends on state s, at computed registers."""
    for k in range(2, laws.states.shape[1]):  # a register in a block that is skipped keeps an old number
        under = laws.states[s, k]
        if under >= 0 and registers[under, 0] == 0.0:
            return False
    return True


@kernel
def is_table(laws, k):
    """Whether kink k is that of a table: its branch is the number of a segment."""
    return laws.code[laws.kinks[k, 0], 0] == TABLE


@kernel
def next_branch(laws, branch, k, above):
    """Branch of kink k beyond the lower or the upper end of a branch."""
    i = laws.kinks[k, 0]
    if not is_table(laws, k):
        return -branch if branch <= 1.0 else (BELOW if above else ABOVE)
    number = laws.code[i, 3]
    segments = laws.tables[number + 1] - laws.tables[number] - 1
    place = branch - branch_of_segment(0)
    if branch == branch_of_segment(-1):
        place = -1.0
    elif branch == branch_of_segment(-2):
        place = 1.0 * segments
    place += 1.0 if above else -1.0
    if place < 0.0:
        return branch_of_segment(-1)
    return branch_of_segment(-2) if place >= segments else place + branch_of_segment(0)


@kernel
def is_shared(laws, branch, k):
    """Whether a branch of kink k is that of a sliding motion."""
    return laws.compared[k] == 2 and branch > 1.0


@kernel
def may_be_beyond(laws, branch, k):
    """Whether a branch of kink k may begin beyond its end by the error of the method: after a sliding motion."""
    return laws.compared[k] == 2 and branch <= 1.0


@kernel
def _read(laws, angle, pose, twist, registers):
    """Write the time, the values of all inputs and the numbers that are held to their registers."""
    time, late = registers[0, 0] - laws.late[0], laws.late[0]
    if late != 0.0:  # comparisons of formulas see whole ns, not the round-off of the difference
        whole = np.round(time * 1e9) / 1e9
        time = whole if abs(time - whole) <= 2.3e-16 * late else time
    registers[LAW_TIME, 0] = time
    for j in range(len(laws.held)):
        if laws.held[j] >= 0:
            registers[laws.held[j], 0] = angle[laws.first + j]
    for j in range(len(laws.surfaces)):
        at = laws.branches + laws.surfaces[j]
        if registers[at, 0] == UNKNOWN:
            registers[at, 0] = angle[laws.first + len(laws.held) + j]
    for e in range(len(laws.axes)):
        if laws.units[e, 1] == 1:
            axis.keep_unit(axis.unit_wrenches(laws.axes[e], pose), registers, laws.units[e, 0])
    read_all(laws.inputs, angle, pose, twist, registers)


@kernel
def _wrench(row, registers, column):
    """(torque, force) of an output; column 1: their changes."""
    at = row["registers"]
    torque = (registers[at[0], column], registers[at[1], column], registers[at[2], column])
    return torque, (registers[at[3], column], registers[at[4], column], registers[at[5], column])


@kernel
def _in_body(row, pose, torque, force):
    """Torque about the origin of the body frame and force, body axes."""
    if row["in_world"] == 1:
        rot = load9(pose, row["body"], 0)
        torque, force = tmatvec3(rot, torque), tmatvec3(rot, force)
    return add3(torque, cross3(vector3(row["point"]), force)), force


@kernel
def _add(body, torque, force, wrench_out):
    for c in range(3):
        wrench_out[body, c] += torque[c]
        wrench_out[body, 3 + c] += force[c]


@kernel
def forget_branches(laws, registers):
    """Let surfaces have the branches that were kept, see `_read`."""
    for j in range(len(laws.surfaces)):
        registers[laws.branches + laws.surfaces[j], 0] = UNKNOWN


@kernel
def set_branches(laws, branches, registers):
    """Set the branches (q,) of the kinks; (0,): those of the arguments hold, or those that were kept."""
    if len(branches) == 0:
        forget_branches(laws, registers)
    for k in range(len(branches)):
        registers[laws.branches + k, 0] = branches[k]


@kernel
def distances_in(laws, branch, registers, k):
    """Distances of kink k to the ends of a branch, at computed registers, see formulas.distances.

    Infinite where its block is skipped. Then its branch is any; once that holds no more, its end is passed.
    """
    if laws.kinks[k, 1] >= 0 and registers[laws.kinks[k, 1], 0] == 0.0:
        return math.inf, math.inf
    i = laws.kinks[k, 0]
    a, b = laws.code[i, 2], laws.code[i, 3]
    return distances(laws.code[i, 0], registers[a, 0], registers[b, 0], branch, laws.tables, laws.points, b)


@kernel
def branch_of(laws, registers, k):
    """Branch of kink k, at computed registers; where its block is skipped always the same."""
    i = laws.kinks[k, 0]
    if laws.kinks[k, 1] >= 0 and registers[laws.kinks[k, 1], 0] == 0.0:
        if laws.code[i, 0] == TABLE:
            return branch_of_segment(-1)
        return BELOW if laws.code[i, 0] == MORE or laws.code[i, 0] == MORE_EQUAL else ABOVE  # it does not hold
    a, b = laws.code[i, 2], laws.code[i, 3]
    return present_branch(laws.code[i, 0], registers[a, 0], registers[b, 0], laws.tables, laws.points, b)


@kernel
def _change_to(now, before):
    """Change between two numbers; infinite if either is none."""
    change = abs(now - before)
    return change if change == change else math.inf


@kernel
def _evaluate_all(laws, registers):
    evaluate(laws.code, laws.tables, laws.points, registers, registers[FOREIGN, 0] == 0.0)
    registers[FOREIGN, 0] = 0.0


@subroutine
def _evaluate(laws, registers):
    _evaluate_all(laws, registers)


@subroutine
def _differentiate(laws, registers):
    known = registers[FOREIGN, 0] == registers[FOREIGN, 1] == 0.0
    differentiate(laws.code, laws.tables, laws.points, registers, known)
    registers[FOREIGN, 0] = registers[FOREIGN, 1] = 0.0


@shared
def branch_matters(laws, branches, registers, k, branch, force, span, part, least):
    """1 if another branch of kink k changes outputs or states by more than `least`, at the inputs in registers.

    Also if only one of both evaluates a block with kinks: these may have been passed.

    force : N, sum of all forces;  span : s, in which rates change states
    part : of the change that counts, for a continuous kink
    """
    branches, registers = borrowed(branches), borrowed(registers)
    set_branches(laws, branches, registers)
    _evaluate(laws, registers)
    for e in range(len(laws.outputs)):
        at = laws.outputs[e]["registers"]
        for c in range(6):
            registers[at[c], 1] = registers[at[c], 0]
    for s in range(len(laws.states)):
        registers[laws.states[s, 1], 1] = registers[laws.states[s, 1], 0]
    for j in range(len(laws.kinks)):
        if laws.kinks[j, 1] >= 0:
            registers[laws.kinks[j, 1], 1] = registers[laws.kinks[j, 1], 0]
    registers[laws.branches + k, 0] = branch
    _evaluate(laws, registers)
    if laws.compared[k] > 0:
        part = 1.0
    found = 0
    for j in range(len(laws.kinks)):
        if laws.kinks[j, 1] >= 0 and registers[laws.kinks[j, 1], 0] != registers[laws.kinks[j, 1], 1]:
            found = 1
    for e in range(len(laws.outputs)):
        at = laws.outputs[e]["registers"]
        for c in range(6):
            if part * _change_to(registers[at[c], 0], registers[at[c], 1]) > least * force:
                found = 1
    for s in range(len(laws.states)):
        to = laws.states[s, 1]
        if part * span * _change_to(registers[to, 0], registers[to, 1]) > least * laws.scales[s]:
            found = 1
    for e in range(len(laws.outputs)):  # column 1 has derivatives: those of parameters are zero
        for c in range(6):
            registers[laws.outputs[e]["registers"][c], 1] = 0.0
    for s in range(len(laws.states)):
        registers[laws.states[s, 1], 1] = 0.0
    registers[FOREIGN, 1] = 1.0
    set_branches(laws, branches, registers)
    _evaluate(laws, registers)
    if _open_branches(laws, registers, 0):
        _evaluate(laws, registers)
    return found


@kernel
def is_computed(laws, registers, e):
    """Whether output e is computed, at computed registers; elsewhere it is zero."""
    under = laws.outputs[e]["under"]
    return under < 0 or registers[under, 0] != 0.0


@kernel
def _are_finite(laws, registers, column):
    """Whether all outputs and rates of states are finite."""
    total = 0.0
    for e in range(len(laws.outputs)):
        if is_computed(laws, registers, e):
            at = laws.outputs[e]["registers"]
            for k in range(6):
                total += 0.0 * registers[at[k], column]
    for s in range(len(laws.states)):
        total += 0.0 * registers[laws.states[s, 1], column]
    return total == 0.0


@kernel
def _are_numbers(laws, registers, column):
    """Whether no output and no rate of a state is NaN."""
    found = True
    for e in range(len(laws.outputs)):
        at = laws.outputs[e]["registers"]
        for k in range(6):
            found = found and registers[at[k], column] == registers[at[k], column]
    for s in range(len(laws.states)):
        at = laws.states[s, 1]
        found = found and registers[at, column] == registers[at, column]
    return found


@kernel
def _open_branches(laws, registers, column):
    """Whether a branch has no values beyond its end, as a root has none; then all are those of the arguments."""
    if len(laws.kinks) == 0 or _are_finite(laws, registers, column) or _are_numbers(laws, registers, column):
        return False
    for k in range(len(laws.kinks)):
        registers[laws.branches + k, 0] = UNKNOWN
    return True


@kernel
def measure(laws, angle, pose, twist, registers):
    """Compute all registers (m, 2) in a state; those of the time, the first one, and of states are given.

    angle : (k,) rad, all unwrapped angles after the last step, and what sampled laws hold
    """
    _read(laws, angle, pose, twist, registers)
    _evaluate_all(laws, registers)
    if not _are_finite(laws, registers, 0):
        if _open_branches(laws, registers, 0):
            _evaluate(laws, registers)
        _note_undefined(laws, registers)


@kernel
def measure_all(laws, angle, pose, twist, registers):
    """As `measure`, with signals that no output needs."""
    measure(laws, angle, pose, twist, registers)
    evaluate(laws.shown, laws.tables, laws.points, registers, False)
    registers[FOREIGN, 0] = 1.0


@kernel
def _note_undefined(laws, registers):
    """Note the first result that is not finite, where all inputs and states are."""
    if _are_finite(laws, registers, 0):
        return
    for e in range(len(laws.inputs)):
        total = registers[laws.inputs[e]["to"], 0]
        if total - total != 0.0:
            return
    for s in range(len(laws.states)):
        total = registers[laws.states[s, 0], 0]
        if total - total != 0.0:
            return
    for j in range(len(laws.results) - 1, -1, -1):
        total = registers[laws.results[j], 0]
        if total - total != 0.0:
            registers[WITNESS, 0], registers[WITNESS, 1], registers[CAUSE, 1] = j + 1.0, registers[LAW_TIME, 0], total
    registers[CAUSE, 0] = 0.0
    for j in range(len(laws.signals) - 1, -1, -1):
        total = registers[laws.signals[j], 0]
        if total - total != 0.0:
            registers[CAUSE, 0] = j + 1.0


@kernel
def sample(laws, inputs, noise, code, angle, pose, twist, registers):
    """As `measure_all`, then the instructions (p, 5) of a sampled law with its inputs (k,) and their noise (k,)."""
    measure_all(laws, angle, pose, twist, registers)
    read_all(inputs, angle, pose, twist, registers)
    for e in range(len(inputs)):
        registers[inputs[e]["to"], 0] += noise[e]
    evaluate(code, laws.tables, laws.points, registers, True)


@kernel
def add_wrench(laws, registers, pose, wrench_out):
    """Add the wrenches of all laws; registers : after `measure` in this state."""
    for e in range(len(laws.outputs)):
        row = laws.outputs[e]
        if row["body"] < 0:
            effort = registers[row["registers"][0], 0]
            axis.apply(row, axis.kept_unit(registers, row["unit"]), effort, wrench_out)
        elif is_computed(laws, registers, e):  # most points of contact do not touch
            torque, force = _wrench(row, registers, 0)
            torque, force = _in_body(row, pose, torque, force)
            _add(row["body"], torque, force, wrench_out)


@kernel
def power_of(laws, e, registers, pose, twist):
    """Power of output e, W; registers : after `measure` in this state."""
    row = laws.outputs[e]
    if row["body"] < 0:
        rate = axis.rate(row, axis.kept_unit(registers, row["unit"]), twist)
        return registers[row["registers"][0], 0] * rate
    torque, force = _wrench(row, registers, 0)
    torque, force = _in_body(row, pose, torque, force)
    return dot3(torque, load3(twist, row["body"], 0)) + dot3(force, load3(twist, row["body"], 3))


@kernel
def power(laws, registers, pose, twist):
    """Power of all laws, W; registers : after `measure` in this state."""
    total = 0.0
    for e in range(len(laws.outputs)):
        total += power_of(laws, e, registers, pose, twist)
    return total


@kernel
def measure_changes(laws, angle, pose, twist, moves, rates, registers):
    """As `measure`, also the derivatives along displacements, see kinds.add_changes."""
    _read(laws, angle, pose, twist, registers)
    for e in range(len(laws.axes)):
        if laws.units[e, 1] == 0:
            axis.keep_unit(axis.unit_wrenches(laws.axes[e], pose), registers, laws.units[e, 0])
    read_changes(laws.inputs, pose, twist, moves, rates, registers)
    _differentiate(laws, registers)
    if _open_branches(laws, registers, 1):
        _differentiate(laws, registers)


@kernel
def measure_slopes(laws, angle, pose, twist, rates, registers, out):
    """Rates of a - b of all surfaces of comparisons of a and b, to out (s,).

    rates (n, 6) : rates of the twists;  registers : values, and the rates of the states
    """
    registers[0, 1] = registers[LAW_TIME, 1] = 1.0
    measure_changes(laws, angle, pose, twist, twist, rates, registers)
    registers[0, 1] = registers[LAW_TIME, 1] = 0.0
    for j in range(len(laws.surfaces)):
        i = laws.kinks[laws.surfaces[j], 0]
        out[j] = registers[laws.code[i, 2], 1] - registers[laws.code[i, 3], 1]


@kernel
def enter_numbers(laws, time, angle, registers):
    """Write the time and the states of a state that was read to their registers, for `measure`."""
    registers[0, 0] = time
    first = len(angle) - len(laws.states)
    for s in range(len(laws.states)):
        registers[laws.states[s, 0], 0] = angle[first + s]
    forget_branches(laws, registers)


@kernel
def add_change(laws, registers, pose, twist, moves, rates, wrench_out):
    """Add the changes of the wrenches along displacements; registers : after `measure_changes` along them."""
    for e in range(len(laws.outputs)):
        row = laws.outputs[e]
        body = row["body"]
        if body < 0:
            at = row["registers"][0]
            unit = axis.kept_unit(registers, row["unit"])
            axis.add_change(
                row, unit, pose, twist, moves, rates, registers[at, 0], 0.0, 0.0, registers[at, 1], wrench_out
            )
            continue
        if not is_computed(laws, registers, e):
            continue
        torque, force = _wrench(row, registers, 1)
        torque, force = _in_body(row, pose, torque, force)
        _add(body, torque, force, wrench_out)
        if row["in_world"] == 1:  # constant in the world: it turns back in the body
            torque, force = _wrench(row, registers, 0)
            rot, turn = load9(pose, body, 0), load3(moves, body, 0)
            torque, force = cross3(tmatvec3(rot, torque), turn), cross3(tmatvec3(rot, force), turn)
            _add(body, add3(torque, cross3(vector3(row["point"]), force)), force, wrench_out)
