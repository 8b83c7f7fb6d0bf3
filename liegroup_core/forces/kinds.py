# SPDX-License-Identifier: Apache-2.0
"""All kinds of forces, and their sums.

A kind is a file with
    a class                 the force in a scene; its `type` is the name of the kind. If forces of this
                            kind can be conservative, it overrides `is_conservative`
    ROW                     record of one force for kernels
    make_row(force, ...)    makes this record from a force of the scene
    add_wrench(rows, ...)   adds wrenches in body axes about the centre of mass
    add_change(rows, ...)   adds their derivatives along displacements of the bodies, see changes.py
    energy(rows, ...)       potential energy, J; omitted for forces without a potential
    power(rows, ...)        power of the part without a potential, W; omitted if there is none
and its lines below: import, __all__, FORCES and Forces in the same order, add_wrenches, energy,
powers. A scene without forces of a kind has zero rows of this kind, so that all scenes share the same
compiled code. test/contract/test_forces.py tests every kind. Gravity acts on all bodies and is separate
(gravity.py).
"""

import sys

import numpy as np

from liegroup_core.compiling import Struct, borrowed, kernel, shared

from . import (
    drag,
    linear_motor,
    linear_servo,
    linear_spring_damper,
    motor,
    servo,
    spring_damper,
    torsional_spring_damper,
    turn,
)
from .applied_wrench import ConstantWrench
from .drag import Drag
from .linear_motor import LinearMotor
from .linear_servo import LinearServo
from .linear_spring_damper import LinearSpringDamper
from .motor import Motor
from .servo import Servo
from .spring_damper import SpringDamper
from .torsional_spring_damper import TorsionalSpringDamper

__all__ = [
    "ConstantWrench",
    "Drag",
    "LinearMotor",
    "LinearServo",
    "LinearSpringDamper",
    "Motor",
    "Servo",
    "SpringDamper",
    "TorsionalSpringDamper",
]

# Classes of a scene, in the order of Forces.
FORCES = (
    SpringDamper,
    TorsionalSpringDamper,
    LinearSpringDamper,
    Motor,
    LinearMotor,
    Servo,
    LinearServo,
    Drag,
    ConstantWrench,
)
POWERS = ("dampers", "motors", "servos", "drag")  # groups of kinds in `powers`
# All but ConstantWrench, which is a command.
KINDS = {cls.model_fields["type"].default: sys.modules[cls.__module__] for cls in FORCES[:-1]}


class Forces(Struct):
    """Forces of a scene: (k,) of ROW of each kind, in the order of the scene."""

    spring_damper: np.ndarray
    torsional_spring_damper: np.ndarray
    linear_spring_damper: np.ndarray
    motor: np.ndarray
    linear_motor: np.ndarray
    servo: np.ndarray
    linear_servo: np.ndarray
    drag: np.ndarray
    counted: np.ndarray  # springs without stiffness that count the turns of joints: those of couplings, then of servos
    exist: bool  # True if there are forces other than `counted`


def make_forces(described, index, ends, counted=()):
    """Rows of the forces of a scene.

    described : the scene's forces
    index     : {body name: body index, "world": WORLD}
    ends      : {joint name: (parent's index, child's index, parent frame, child frame)}
    counted   : names of joints whose angle is unwrapped for a coupling
    """
    servos = [force.joint for force in described if force.type == "servo"]
    return Forces(
        **{
            kind: np.array(
                [module.make_row(force, index, ends) for force in described if force.type == kind], dtype=module.ROW
            )
            for kind, module in KINDS.items()
        },
        counted=np.array(
            [(*turn.fields(*ends[joint]), 0.0, 0.0, 0.0) for joint in [*counted, *servos]],
            dtype=torsional_spring_damper.ROW,
        ),
        exist=any(force.type in KINDS for force in described),
    )


def servos(described):
    """Servos among the forces of a scene, in the order of their target values."""
    return [force for kind in ("servo", "linear_servo") for force in described if force.type == kind]


def target_values(forces):
    """Target position and velocity (k, 2) of all servos without a command."""
    rows = [(row["position"], row["velocity"]) for row in (*forces.servo, *forces.linear_servo)]
    return np.array(rows, dtype=float).reshape(-1, 2)


def limits(forces):
    """Effort limits (k,) of all servos."""
    return np.concatenate([forces.servo["limit"], forces.linear_servo["limit"]])


def count_of_angles(forces):
    """Number of unwrapped joint angles: those of torsional springs, of couplings, of servos."""
    return len(forces.torsional_spring_damper) + len(forces.counted)


@kernel
def add_wrenches(forces, angle, targets, pose, twist, wrench_out):
    """Add the wrenches of all forces to wrench_out (n, 6).

    angle  : (k,) rad, the unwrapped angles after the last step
    targets : (k, 2) target position and velocity of each servo
    pose (n, 12), twist (n, 6)
    """
    if forces.exist:
        _add_wrenches(forces, borrowed(angle), borrowed(targets), borrowed(pose), borrowed(twist), borrowed(wrench_out))


@shared
def _add_wrenches(forces, angle, targets, pose, twist, wrench_out):
    spring_damper.add_wrench(forces.spring_damper, pose, twist, wrench_out)
    torsional_spring_damper.add_wrench(forces.torsional_spring_damper, angle, pose, twist, wrench_out)
    linear_spring_damper.add_wrench(forces.linear_spring_damper, pose, twist, wrench_out)
    motor.add_wrench(forces.motor, pose, twist, wrench_out)
    linear_motor.add_wrench(forces.linear_motor, pose, twist, wrench_out)
    servo.add_wrench(forces.servo, angle, targets, pose, twist, wrench_out)
    linear_servo.add_wrench(forces.linear_servo, targets, pose, twist, wrench_out)
    drag.add_wrench(forces.drag, twist, wrench_out)
    return 0


@shared
def add_changes(forces, angle, targets, pose, twist, moves, rates, shifts, at, wrench_out):
    """Add the derivatives of the wrenches along displacements, and changes of twists and targets: see changes.py.

    shifts : changes of the targets of all servos, from row `at` on
    """
    angle, targets = borrowed(angle), borrowed(targets)
    pose, twist, moves, rates = borrowed(pose), borrowed(twist), borrowed(moves), borrowed(rates)
    shifts, wrench_out = borrowed(shifts), borrowed(wrench_out)
    spring_damper.add_change(forces.spring_damper, pose, twist, moves, rates, wrench_out)
    torsional_spring_damper.add_change(forces.torsional_spring_damper, angle, pose, twist, moves, rates, wrench_out)
    linear_spring_damper.add_change(forces.linear_spring_damper, pose, twist, moves, rates, wrench_out)
    motor.add_change(forces.motor, pose, twist, moves, rates, wrench_out)
    linear_motor.add_change(forces.linear_motor, pose, twist, moves, rates, wrench_out)
    servo.add_change(forces.servo, angle, targets, pose, twist, moves, rates, shifts, at, wrench_out)
    linear_servo.add_change(forces.linear_servo, targets, pose, twist, moves, rates, shifts, at, wrench_out)
    drag.add_change(forces.drag, twist, rates, wrench_out)
    return 0


@kernel
def energy(forces, angle, pose):
    """Potential energy of all forces, J."""
    return (
        spring_damper.energy(forces.spring_damper, pose)
        + torsional_spring_damper.energy(forces.torsional_spring_damper, angle, pose)
        + linear_spring_damper.energy(forces.linear_spring_damper, pose)
    )


@kernel
def powers(forces, angle, targets, pose, twist):
    """Powers of the non-conservative forces by POWERS, W."""
    return (
        spring_damper.power(forces.spring_damper, pose, twist)
        + torsional_spring_damper.power(forces.torsional_spring_damper, pose, twist)
        + linear_spring_damper.power(forces.linear_spring_damper, pose, twist),
        motor.power(forces.motor, pose, twist) + linear_motor.power(forces.linear_motor, pose, twist),
        servo.power(forces.servo, angle, targets, pose, twist)
        + linear_servo.power(forces.linear_servo, targets, pose, twist),
        drag.power(forces.drag, twist),
    )


@kernel
def power(forces, angle, targets, pose, twist):
    """Power of the non-conservative forces, W: the rate of the mechanical energy."""
    dampers, motors, servos, drags = powers(forces, angle, targets, pose, twist)
    return dampers + motors + servos + drags


@kernel
def servo_efforts(forces, angle, targets, pose, twist, out):
    """Write effort and rate of each servo to out (k, 2); arguments as for `add_wrenches`."""
    servo.efforts(forces.servo, angle, targets, pose, twist, out)
    linear_servo.efforts(forces.linear_servo, targets, pose, twist, out)


@kernel
def too_fast(forces, h, pose, twist):
    """Index of an unwrapped angle whose joint rotates by pi or more in a step h, or -1.

    pose, twist : at the end of the step
    """
    found = turn.too_fast(forces.torsional_spring_damper, h, pose, twist)
    if found < 0 and len(forces.counted) > 0:
        found = turn.too_fast(forces.counted, h, pose, twist)
        if found >= 0:
            found += len(forces.torsional_spring_damper)
    return found


@kernel
def count_turns(forces, pose, angle):
    """Unwrap the angles (k,) at the end of a step, in which they changed by less than pi."""
    turn.count_turns(forces.torsional_spring_damper, pose, angle, 0)
    turn.count_turns(forces.counted, pose, angle, len(forces.torsional_spring_damper))
