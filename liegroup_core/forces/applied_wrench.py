# SPDX-License-Identifier: Apache-2.0
"""Constant wrench on a body, in body or world axes, between a start and an end time.

It is a command of the scene, see schedule.py, and a part of the external wrenches (external.py).
"""

from typing import Literal

from pydantic import Field, model_validator

from liegroup_core.errors import SceneError
from liegroup_core.fields.values import NotNegative, Positive, Text, Vector3

from .commands import SCENE, WRENCH, Command
from .described import Force
from .external import no_wrenches, parts_of_wrench, set_wrench


class ConstantWrench(Force):
    """Constant torque and force on a body, between a start and an end time."""

    type: Literal["applied_wrench"] = Field("applied_wrench", description="applied_wrench")
    body: Text = Field(description="name of a body")
    torque: Vector3 = Field((0.0, 0.0, 0.0), description="torque in N m")
    force: Vector3 = Field((0.0, 0.0, 0.0), description="force in N")
    point: Vector3 = Field((0.0, 0.0, 0.0), description="point of application in m, in the body frame")
    axes: Literal["body", "world"] = Field(
        "body", description="axes in which torque and force are constant: body or world"
    )
    start: NotNegative = Field(0.0, description="start time in s, not negative")
    end: Positive | None = Field(None, description="end time in s, after start; default: no end")

    @model_validator(mode="after")
    def _check(self):
        if self.end is not None and self.end <= self.start:
            raise SceneError(
                f"end {self.end:g} must be later than start {self.start:g}: give a later end or omit it", place=("end",)
            )
        return self

    @property
    def command(self):
        """The same wrench as a Command."""
        point = self.point if any(self.point) else None
        return Command(WRENCH, self.body, (*self.torque, *self.force), source=SCENE, axes=self.axes, point=point)

    def acts(self, time):
        """Whether it acts from a time in s on."""
        return self.start <= time and (self.end is None or time < self.end)


def wrenches_of(forces, index, offsets, time=None):
    """(n, COLUMNS) external wrenches by the ConstantWrenches among forces; index : {body: number}, offsets : Offsets.

    time : s, from which they act; None: all of them, whenever they act
    """
    external, totals = no_wrenches(offsets), {}
    for force in forces:
        if isinstance(force, ConstantWrench) and (time is None or force.acts(time)):
            command = force.command
            for axes, values in parts_of_wrench(command.values, command.axes, command.point):
                totals.setdefault((index[force.body], axes), []).append(values)
    for (body, axes), parts in totals.items():
        set_wrench(external, body, [sum(column) for column in zip(*parts)], axes)
    return external
