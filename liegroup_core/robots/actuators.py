# SPDX-License-Identifier: Apache-2.0
"""Actuators of a robot file as servos and motors of a scene.

An actuator has a length, linear in joint coordinates, and a force that is affine in this length and its rate:

    l = l0 + sum share q   ,   f = p0 + p1 l + p2 ldot   ,   p = bias + gain control   ,   effort = share f

With one joint this is the law of a servo with stiffness -share^2 p1 and damping -share^2 p2, else a constant
effort. The control is that of the pose at the start; commands of a scene give targets or efforts instead.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

FREE = -math.inf, math.inf


@dataclass
class Actuator:
    """Actuator of joints with one coordinate.

    shares   : {joint: change of the length by that of its coordinate};  length : l0, at coordinates 0
    bias, gain : (3,): p0, p1, p2, and their changes by the control
    controls, forces : (least, largest)
    dynamics : none, integrator or filter: how the activation, which acts as control, follows the control
    """

    name: str
    line: int
    shares: dict
    length: float
    bias: np.ndarray
    gain: np.ndarray
    controls: tuple = FREE
    forces: tuple = FREE
    dynamics: str = "none"

    def control(self, start):
        """Control that acts at the start, or None if it changes while the command does not.

        start : (command, activation) of the pose at the start
        """
        command, activation = start
        command = min(max(command, self.controls[0]), self.controls[1])
        if self.dynamics == "none":
            return command
        return activation if (command if self.dynamics == "integrator" else command - activation) == 0.0 else None


class _Law(NamedTuple):
    """Effort on one joint: effort - stiffness q - damping qdot, between two limits.

    ends : efforts at both ends of the range of the control, or None
    """

    name: str
    line: int
    stiffness: float
    damping: float
    effort: float
    limits: tuple
    ends: tuple | None

    @property
    def is_constant(self):
        return self.stiffness == self.damping == 0.0

    def target(self, effort):
        """(position, velocity) of a servo with this effort at coordinate and rate 0."""
        return (effort / self.stiffness, 0.0) if self.stiffness else (0.0, effort / self.damping)


def add_drives(robot, options, parts, values, taken):
    """Append servos and motors for the actuators, and the ranges of their commands to the data of joints.

    values : {joint: coordinate at the start};  taken : names of joints and forces
    """
    if not options.actuators:
        for actuator in robot.actuators:
            robot.leave_out("actuators", actuator.name, changes_motion=True)
        return
    entries = {parts.names["joints", entry["name"]]: entry for entry in parts.joints}
    own, of_joint = options.led, {}
    for actuator in robot.actuators:
        for name, law in _laws(robot, actuator, options.pose, entries, values):
            if name in own:
                robot.remark("actuators replaced by a servo or a motion that you gave", actuator.name)
            else:
                of_joint.setdefault(name, []).append(law)
    for name, laws in of_joint.items():
        joint = next(each for each in robot.joints if each.name == name)
        servo, constant = _together(robot, joint, laws)
        entry, turns = entries[name], joint.type != "prismatic"
        if servo is not None:
            turned = joint.turned(values[name])
            position, velocity = servo.target(servo.effort - servo.stiffness * turned)
            force = {"type": "servo" if turns else "linear_servo", "joint": entry["name"]}
            force |= {"stiffness": servo.stiffness, "damping": servo.damping}
            force |= {"effort_limit": servo.limits[1]} if servo.limits != FREE else {}
            _append(parts, servo, force | {"position": position, "velocity": velocity}, taken)
            robot.remark("actuators as servos", f"{servo.name} of {name}")
            if servo.ends:
                _narrow(entry, servo, turned)
        elif all(law.is_constant for law in laws):
            _add_to(robot, joint, laws, constant, entry)
        if constant:
            force = {"type": "motor", "joint": entry["name"], "torque": constant}
            if not turns:
                force = {"type": "linear_motor", "joint": entry["name"], "force": constant}
            _append(parts, laws[0], force, taken)


def _add_to(robot, joint, laws, constant, entry):
    """Note the motors of a joint, and limit commands so that their sum with the constant effort keeps its range.

    The limit of a scene is symmetric: the nearer end of the range, or the other one if the effort is at this end.
    """
    ends = [sorted(_clamped(end, law.limits) for end in law.ends or law.limits) for law in laws]
    low, high = (_clamped(sum(each), joint.efforts) for each in zip(*ends))
    near, far = sorted((constant - low, high - constant))
    unit, details = "N" if joint.type == "prismatic" else "N m", []
    if constant:
        details.append(f"{constant:.6g} {unit} of the file's control keep acting, and commands add to them")
    if near != far:
        most = f"commands up to {near:.6g} {unit}" if near > 0.0 else "only commands of one sign keep it"
        details.append(f"range from {low:.6g} to {high:.6g} {unit}: {most}")
    said = f"{', '.join(law.name for law in laws)} of {joint.name}" + (f" ({'; '.join(details)})" if details else "")
    robot.remark("actuators whose commands are efforts of joints", said)
    _tighten(entry, "effort", near if near > 0.0 else far)


def _laws(robot, actuator, pose, entries, values):
    """[(joint, _Law)] of an actuator at the start; [] with a note if a scene has no such law."""
    control = actuator.control(robot.commands.get(pose, {}).get(actuator.name, (0.0, 0.0)))
    shares, length = _of_leaders(robot, actuator, entries, values)
    if not shares:
        return []  # its joints do not move
    p = None if control is None else actuator.bias + actuator.gain * control
    if p is None:
        what = "actuators whose activation changes at the start"
    elif p[1] > 0.0 or p[2] > 0.0:
        what = "actuators that push away from their target"
    elif len(shares) > 1 and p[1:].any():
        what = "servos of tendons with several joints that are not coupled"
    else:
        if actuator.dynamics != "none":
            robot.remark("actuators whose commands act at once, without dynamics of the activation", actuator.name)
        return [(name, _law(actuator, p, share, length)) for name, share in shares.items()]
    robot.leave_out(what, actuator.name, changes_motion=True)
    return []


def _law(actuator, p, share, length):
    def effort(p):
        return share * (p[0] + p[1] * length)

    ends = None
    if actuator.controls != FREE and not actuator.gain[1:].any():
        ends = tuple(effort(actuator.bias + actuator.gain * control) for control in actuator.controls)
    limits = tuple(sorted(share * force for force in actuator.forces))
    stiffness, damping = (0.0 - share**2 * p[1:]).tolist()
    return _Law(actuator.name, actuator.line, stiffness, damping, float(effort(p)), limits, ends)


def _of_leaders(robot, actuator, entries, values):
    """(shares, length) of an actuator; couplings replace joints, joints that do not move count by their values."""
    shares, length = dict(actuator.shares), actuator.length
    for name in shares.keys() - entries.keys():
        length += shares.pop(name) * values[name]
    known = [*robot.couplings, *(each for each in robot.relations if each.terms.keys() <= shares.keys())]
    for coupling in known * len(known) if len(shares) > 1 else ():
        first, terms = coupling.first, coupling.terms
        if not coupling.curve and first in shares and len(shares) > 1 and terms.keys() <= entries.keys():
            share = shares.pop(first)
            length += share * sum(c * values[name] for name, c in terms.items())
            shares |= {name: shares.get(name, 0.0) - share * c for name, c in terms.items() if name != first}
    least = 1e-12 * max(map(abs, actuator.shares.values()))  # round-off: couplings may cancel the shares
    return {name: share for name, share in shares.items() if abs(share) > least}, length


def _together(robot, joint, laws):
    """(_Law of a servo or None, constant effort) of all actuators of a joint."""
    springs = [law for law in laws if not law.is_constant]
    constant = sum(_clamped(law.effort, law.limits) for law in laws if law.is_constant)
    if not springs:
        return None, _clamped(constant, joint.efforts)
    servo, rest = springs[0], constant
    if all(law.limits == FREE for law in springs):
        stiffness, damping, effort = (sum(law[i] for law in springs) for i in (2, 3, 4))
        servo, rest = servo._replace(stiffness=stiffness, damping=damping, effort=effort + constant), 0.0
        if len(laws) > 1:
            servo = servo._replace(name="_".join(law.name for law in laws), ends=None)
    elif len(springs) > 1:
        servo = None
    if servo is not None:
        low, high = (pick(ends) for pick, ends in zip((max, min), zip(servo.limits, joint.efforts)))
        servo = servo._replace(limits=(low, high))
        if low == high == 0.0:
            return None, rest
        if low == -high and (joint.efforts == FREE or not rest):
            return servo, rest
    names = ", ".join(law.name for law in springs)
    robot.leave_out("servos with several or unequal limits of their force", names, changes_motion=True)
    return None, constant


def _clamped(value, limits):
    return min(max(value, limits[0]), limits[1])


def _append(parts, law, force, taken):
    comment = f"line {law.line}" if law.line else "of an actuator"
    parts.add("forces", {"name": law.name} | force, law.line, comment, taken)


def _narrow(entry, servo, turned):
    """Limit the commands of a servo to the range of the control."""
    ends = sorted(servo.target(end)[0 if servo.stiffness else 1] for end in servo.ends)
    if not servo.stiffness:
        _tighten(entry, "velocity", max(map(abs, ends)))
        return
    data = entry.setdefault("data", {})
    lower = max(data.get("lower", -math.inf), ends[0] - turned)
    upper = min(data.get("upper", math.inf), ends[1] - turned)
    if lower <= upper:
        data |= {"lower": lower, "upper": upper}


def _tighten(entry, key, most):
    """Lower a limit of commands in the data of a joint; 0 would be no limit."""
    if 0.0 < most < math.inf:
        data = entry.setdefault("data", {})
        data[key] = min(most, data.get(key) or math.inf)
