# SPDX-License-Identifier: Apache-2.0
"""All kinds of forces, and their sums.

A kind is a file with
    classes                 forces in a scene. If forces of a class can be conservative, it overrides `is_conservative`
    ROW                     record of one force for kernels
    make_row(force, ...)    makes this record from a force of the scene
    add_wrench(rows, ...)   adds wrenches in body axes about the centre of mass
    add_change(rows, ...)   adds their derivatives along displacements of the bodies, see `add_changes`
    energy(rows, ...)       potential energy, J; omitted for forces without a potential
    power(rows, ...)        power of the part without a potential, W; omitted if there is none
and its lines below: import, __all__, FORCES, Forces, make_forces, add_wrenches, add_changes, energy, powers. All forces
about or along the axis of a joint are one kind (joint_law.py): another one only needs a class with its law.
A scene without forces of a kind has zero rows of this kind, so that all scenes share the same
compiled code. test/contract/test_forces.py tests every class. Gravity acts on all bodies and is separate
(gravity.py).
"""

import numpy as np

from liegroup_core.compiling import Struct, borrowed, kernel, shared

from . import axis, drag, joint_law, law, spring_damper
from .applied_wrench import ConstantWrench
from .contact import Contact
from .drag import Drag
from .joint_law import LinearMotor, LinearServo, LinearSpringDamper, Motor, Servo, TorsionalSpringDamper
from .law import Law
from .spring_damper import SpringDamper

__all__ = [
    "ConstantWrench",
    "Contact",
    "Drag",
    "Law",
    "LinearMotor",
    "LinearServo",
    "LinearSpringDamper",
    "Motor",
    "Servo",
    "SpringDamper",
    "TorsionalSpringDamper",
]

# Classes of a scene. Joint laws act in this order.
FORCES = (
    SpringDamper,
    TorsionalSpringDamper,
    LinearSpringDamper,
    Motor,
    LinearMotor,
    Servo,
    LinearServo,
    Drag,
    Law,
    Contact,
    ConstantWrench,
)
POWERS = (*joint_law.GROUPS, "drag", "laws")  # groups of forces in `powers`


class Forces(Struct):
    """Forces of a scene: (k,) of ROW of each kind."""

    spring_damper: np.ndarray
    joint_law: np.ndarray  # in the order of `joint_laws`
    drag: np.ndarray
    laws: Struct  # law.Laws
    counted: np.ndarray  # (k,) of axis.ROW: joints whose angle is unwrapped
    exist: bool  # True if there are forces


def registers_at(forces, time, angles):
    """Registers (m, 2) of the laws for a call of their kernels at a time in s; angles : see `count`."""
    registers = forces.laws.registers.copy()
    registers[0, 0] = time
    states = forces.laws.states[:, 0]
    registers[states, 0] = angles[len(angles) - len(states) :]
    return registers


def count(forces):
    """Number of unwrapped angles and, after them, held numbers of sampled laws and states that a run keeps."""
    return len(forces.counted) + len(forces.laws.start)


def make_forces(described, index, ends, counted, slides=(), sensors=()):
    """Rows of the forces of a scene.

    described : the scene's forces
    index     : {body name: body index, "world": WORLD}
    ends      : {joint name: (parent's index, child's index, parent frame, child frame)}
    counted   : [(joint, force or coupling)] of `unwrapped`
    slides    : names of the joints whose coordinate is a displacement
    sensors   : of the scene, which laws may read
    """
    angles = {name: i for i, (_, name) in enumerate(counted)}
    targets, led = {servo.name: i for i, servo in enumerate(servos(described))}, law.target_registers(described)
    at_joints = [
        joint_law.make_row(
            force, ends, angles.get(force.name, -1), targets.get(force.name, -1), led.get(force.name, (-1, -1))
        )
        for force in joint_laws(described)
    ]

    def rows(module, cls):
        found = [module.make_row(force, index) for force in described if isinstance(force, cls)]
        return np.array(found, dtype=module.ROW)

    return Forces(
        spring_damper=rows(spring_damper, SpringDamper),
        joint_law=np.array(at_joints, dtype=joint_law.ROW),
        drag=rows(drag, Drag),
        laws=law.make_laws(
            described, index, ends, {joint: i for i, (joint, _) in enumerate(counted)}, slides, len(counted), sensors
        ),
        counted=np.array([axis.fields(False, *ends[joint]) for joint, _ in counted], dtype=axis.ROW),
        exist=any(not isinstance(force, ConstantWrench) for force in described),
    )


def joint_laws(described):
    """Forces of a scene about or along the axis of a joint, in the order in which they act."""
    return sorted((force for force in described if force.joint_moves), key=lambda force: FORCES.index(type(force)))


def servos(described):
    """Servos among the forces of a scene, in the order of their target values."""
    return [force for force in joint_laws(described) if force.group == "servos"]


def unwrapped(described, coupled=(), turning=(), sensors=()):
    """[(joint, name of a force or coupling)] of each unwrapped angle; sensors : of the scene, which laws may read.

    coupled : those of couplings and drives;  turning : names of the joints whose coordinate is an angle
    """

    def named(kind):
        return [(force.joint, force.name) for force in described if force.type == kind]

    by_laws = law.unwrapped_inputs(described, turning, sensors)
    return [*named("torsional_spring_damper"), *coupled, *named("servo"), *by_laws]


def target_values(forces):
    """Target position and velocity (k, 2) of all servos without a command.

    With sampled laws a last row has the time of their last instant: what was computed for another one is computed again
    """
    rows = forces.joint_law[forces.joint_law["target"] >= 0]
    targets = [*rows[["position", "velocity"]].tolist(), *([(0.0, 0.0)] if len(forces.laws.held) else [])]
    return np.array(targets, dtype=float).reshape(-1, 2)


@kernel
def add_wrenches(forces, angle, targets, registers, pose, twist, wrench_out):
    """Add the wrenches of all forces to wrench_out (n, 6).

    angle  : (k,) rad, the unwrapped angles after the last step
    targets : (k, 2) target position and velocity of each servo
    registers : (m, 2) of the laws, scratch memory; [0, 0] is the time in s
    pose (n, 12), twist (n, 6)
    """
    if forces.exist:
        angle, targets, registers = borrowed(angle), borrowed(targets), borrowed(registers)
        _add_wrenches(forces, angle, targets, registers, borrowed(pose), borrowed(twist), borrowed(wrench_out))


@shared
def _add_wrenches(forces, angle, targets, registers, pose, twist, wrench_out):
    spring_damper.add_wrench(forces.spring_damper, pose, twist, wrench_out)
    law.measure(forces.laws, angle, pose, twist, registers)
    joint_law.add_wrench(forces.joint_law, angle, targets, registers, pose, twist, wrench_out)
    drag.add_wrench(forces.drag, twist, wrench_out)
    law.add_wrench(forces.laws, registers, pose, wrench_out)
    return 0


@shared
def add_changes(forces, angle, targets, registers, pose, twist, moves, rates, shifts, at, wrench_out):
    """Add the derivatives of the wrenches along displacements, and changes of twists and targets.

    moves (n, 6) : displacement of every body, X exp(s moves), in its axes;  rates (n, 6) : change of its twist
    shifts : changes of the targets of all servos, from row `at` on
    """
    angle, targets, registers = borrowed(angle), borrowed(targets), borrowed(registers)
    pose, twist, moves, rates = borrowed(pose), borrowed(twist), borrowed(moves), borrowed(rates)
    shifts, wrench_out = borrowed(shifts), borrowed(wrench_out)
    spring_damper.add_change(forces.spring_damper, pose, twist, moves, rates, wrench_out)
    law.measure_changes(forces.laws, angle, pose, twist, moves, rates, registers)
    joint_law.add_change(forces.joint_law, angle, targets, registers, pose, twist, moves, rates, shifts, at, wrench_out)
    drag.add_change(forces.drag, twist, rates, wrench_out)
    law.add_change(forces.laws, registers, pose, twist, moves, rates, wrench_out)
    return 0


@kernel
def energy(forces, angle, pose):
    """Potential energy of all forces, J."""
    return spring_damper.energy(forces.spring_damper, pose) + joint_law.energy(forces.joint_law, angle, pose)


@kernel
def powers(forces, angle, targets, registers, pose, twist):
    """Powers of the non-conservative forces by POWERS, W; registers : after law.measure in this state."""
    dampers, motors, servos = joint_law.powers(forces.joint_law, angle, targets, registers, pose, twist)
    return (
        spring_damper.power(forces.spring_damper, pose, twist) + dampers,
        motors,
        servos,
        drag.power(forces.drag, twist),
        law.power(forces.laws, registers, pose, twist),
    )


@kernel
def power(forces, angle, targets, registers, pose, twist):
    """Power of the non-conservative forces, W: the rate of the mechanical energy; arguments as for `powers`."""
    dampers, motors, servos, drags, by_laws = powers(forces, angle, targets, registers, pose, twist)
    return dampers + motors + servos + drags + by_laws


@kernel
def efforts(forces, angle, targets, registers, pose, twist, out):
    """Write the efforts of the joint laws, N m or N, to out (k,); arguments as for `powers`."""
    joint_law.efforts(forces.joint_law, angle, targets, registers, pose, twist, out)


@kernel
def too_fast(forces, h, pose, twist):
    """Index of an unwrapped angle whose joint rotates by pi or more in a step h, or -1.

    pose, twist : at the end of the step
    """
    return axis.too_fast(forces.counted, h, pose, twist)


@kernel
def count_turns(forces, pose, angle):
    """Unwrap the angles (k,) at the end of a step, in which they changed by less than pi."""
    axis.count_turns(forces.counted, pose, angle)
