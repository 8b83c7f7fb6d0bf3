# SPDX-License-Identifier: Apache-2.0
"""Map of a bag: which fields of its topics are inputs and outputs of a scene.

inputs:
- {input: elbow.effort, topic: /commands, field: "data[0]"}
measurements:
- {output: elbow.position, topic: /joint_states, field: "position[elbow]", noise: 0.001}
- {output: imu, topic: /imu}                  a sensor of the scene, with all its numbers
- {output: hand.pose, topic: /mocap, field: pose}
clocks:
- {topic: /imu, delay: 0.004}
"""

from typing import Annotated, Literal

import numpy as np
from pydantic import AfterValidator, model_validator
from pydantic import Field as Described_Field

from liegroup_core.errors import SceneError
from liegroup_core.fields.frames import Frame
from liegroup_core.fields.values import Described, Number, Positive, Text
from liegroup_core.identification.log import HOLDS, MOTION, PREVIOUS, SPLINE
from liegroup_core.scene.yaml_text import Lines, read_yaml

LARGEST_FILE = 2**20  # bytes
LEAST_NOISE = 1e-12
UNITS = {"deg": np.pi / 180.0, "deg/s": np.pi / 180.0, "rpm": np.pi / 30.0, "mm": 1e-3, "cm": 1e-2, "g": 9.80665}


def _above_round_off(noise):
    if noise < LEAST_NOISE:
        raise ValueError(f"below {LEAST_NOISE:g} is round-off")
    return noise


Noise = Annotated[Positive, AfterValidator(_above_round_off)]


class Value(Described):
    """Where a value is: topic, field and unit."""

    topic: Text = Described_Field(description="name of the topic")
    field: str = Described_Field("", description="path in the message, such as position[elbow]")
    scale: Number = Described_Field(1.0, description="factor to SI units, with the sign")
    unit: Literal["deg", "deg/s", "rpm", "mm", "cm", "g"] | None = Described_Field(
        None, description="unit of the field; default: SI"
    )
    offset: Number = Described_Field(0.0, description="added after the scale, SI units: the zero of a joint")

    @model_validator(mode="after")
    def _check_scale(self):
        if self.scale == 0.0:
            raise SceneError("a scale of 0 leaves nothing of the values", place=("scale",))
        return self

    @property
    def factor(self):
        """Scale with the unit."""
        return self.scale * (UNITS[self.unit] if self.unit else 1.0)


class InputEntry(Value):
    """Value that acts on the mechanism."""

    input: Text = Described_Field(
        description="JOINT.effort, JOINT.target, JOINT.motion (position of a driven joint), BODY.force_x, ... or "
        "BODY.wrench"
    )
    hold: Literal[HOLDS] | None = Described_Field(
        None, description="between two messages: previous (default), linear, or spline, which JOINT.motion always has"
    )
    noise: Noise | None = Described_Field(
        None,
        description="standard deviation, SI units, of values that a spline smooths; default: it passes through them",
    )

    @model_validator(mode="after")
    def _check(self):
        if self.input.endswith(MOTION) and self.hold not in (None, SPLINE):
            raise SceneError(f"{self.input} is a spline, as its acceleration acts: remove hold", place=("hold",))
        if self.noise is not None and self.way != SPLINE:
            raise SceneError(f"noise of {self.input} needs hold: spline", place=("noise",))
        return self

    @property
    def way(self):
        """How values go on between messages."""
        return self.hold or (SPLINE if self.input.endswith(MOTION) else PREVIOUS)


class MeasurementEntry(Value):
    """Value that was measured."""

    output: Text = Described_Field(description="JOINT.position, BODY.pose, BODY.twist, name of a sensor, ...")
    noise: Noise | None = Described_Field(None, description="standard deviation, SI units; default: estimated")
    world: Frame | None = Described_Field(None, description="frame of the measured poses in the world of the scene")

    @model_validator(mode="after")
    def _check_world(self):
        if self.world is not None and not self.output.endswith(".pose"):
            raise SceneError(f"{self.output} is no pose: remove world", place=("world",))
        return self


class Clock(Described):
    """Clock of a topic."""

    topic: Text = Described_Field(description="name of the topic")
    delay: Number = Described_Field(description="s by which its stamps are late against the inputs")


class Map(Described):
    """Map of a bag."""

    inputs: tuple[InputEntry, ...] = Described_Field((), description="list of values that act")
    measurements: tuple[MeasurementEntry, ...] = Described_Field(description="list of values that were measured")
    clocks: tuple[Clock, ...] = Described_Field((), description="list of known delays; the others are estimated")

    @model_validator(mode="after")
    def _check(self):
        if not self.measurements:
            raise SceneError("measurements must have at least one entry", place=("measurements",))
        known = {entry.topic for entry in self.measurements}
        for k, clock in enumerate(self.clocks):
            if clock.topic not in known:
                raise SceneError(f"{clock.topic} has no measurements: remove its clock", place=("clocks", k))
        for kind, key in (("inputs", "input"), ("measurements", "output"), ("clocks", "topic")):
            seen = set()
            for k, entry in enumerate(getattr(self, kind)):
                name = getattr(entry, key), entry.topic
                name = name[0] if kind != "measurements" else name
                if name in seen:
                    raise SceneError(f"{getattr(entry, key)} is given twice: keep one", place=(kind, k))
                seen.add(name)
        return self


def load_map(path):
    """Map of a YAML file. Raises SceneError, one line with file and line."""
    try:
        with open(path, "rb") as file:
            content = file.read(LARGEST_FILE + 1)
        text = content.decode("utf-8")
    except OSError as error:
        raise SceneError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise SceneError(f"{path}: is not UTF-8 text: give a map (.yaml)") from None
    if len(content) > LARGEST_FILE:
        raise SceneError(f"{path}: is larger than 1 MiB: give a map (.yaml)")
    root = read_yaml(text, str(path), "a map", Map.model_fields)
    try:
        if not isinstance(root.value, dict):
            raise SceneError(f"a map must be a mapping with the keys {', '.join(Map.model_fields)}")
        return Map(**root.value)
    except SceneError as error:
        raise Lines(str(path), root).located(error) from None
