# SPDX-License-Identifier: Apache-2.0
"""Servos that hold joints of a robot at their start."""

import math
from typing import Annotated

from pydantic import BeforeValidator, Field

from liegroup_core.fields import values
from liegroup_core.fields.values import Described, NotNegative, Positive, Text

from .description import ONE_COORDINATE


class Servos(Described):
    """Servos that hold the joints of a robot at their start."""

    stiffness: Positive = Field(description="N m/rad, of slides N/m")
    damping: NotNegative = Field(description="N m s/rad, of slides N s/m")
    joints: Annotated[tuple[Text, ...], BeforeValidator(values.listed)] = Field(
        (), description="default: all that turn and that nothing else leads"
    )


def add_servos(robot, options, grouping, parts, at_start, taken):
    """Append a servo for each joint that is held; at_start: {joint: coordinate at the start}.

    A limit of the effort in the file is that of the servo.
    """
    servos = options.servos
    if servos is None:
        return
    moving = {joint.name: joint for joint in grouping.moving if joint.type in ONE_COORDINATE}
    for name in servos.joints:
        if name not in moving:
            raise options.unknown(("servos", "joints"), "servos: moving joint with one coordinate", name, moving)
    names = {file: name for (kind, name), file in parts.names.items() if kind == "joints"}
    led = options.led | {each.first for each in (*robot.couplings, *robot.relations)} | options.roll.keys()
    actuated = {force["joint"] for force in parts.forces if force["type"] in ("servo", "linear_servo")}
    turning = [name for name, joint in moving.items() if joint.type != "prismatic"]
    held = servos.joints or [name for name in turning if name not in led and names[name] not in actuated]
    for name in held:
        joint, effort = moving[name], moving[name].data.get("effort", math.inf)
        kind = "linear_servo" if joint.type == "prismatic" else "servo"
        force = {"name": f"{names[name][:50]}_hold", "type": kind, "joint": names[name]}
        force |= {"stiffness": servos.stiffness, "damping": servos.damping}
        force |= {"position": at_start[name] - joint.turned(at_start[name])}
        force |= {"effort_limit": effort} if 0.0 < effort < math.inf else {}
        parts.add("forces", force, joint.line, f"holds {name}", taken)
    if not held:
        raise options.error(
            ("servos",), "servos: no joint that turns is free of other servos and couplings: name joints"
        )
