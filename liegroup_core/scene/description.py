# SPDX-License-Identifier: Apache-2.0
"""What a scene says: bodies, joints and forces, as frozen models that check themselves.

SI units, angles in radians. The world frame is `world`; a body frame is fixed to the body, its
centre of mass at `com` in it. Rotations turn body components into world components; quaternions
are x, y, z, w. Twists are (omega, v), angular first, in the axes of the body frame and about its
origin.

A model made from wrong values raises `SceneError`. A new kind of joint or force is one class with
a `type`, and its entry in `JOINTS` or `FORCES`.
"""

from typing import Annotated, Any, Literal

import numpy as np
import yaml
from pydantic import BeforeValidator, Field, PrivateAttr, model_validator

from ..errors import SceneError
from ..joints.pairs import LOWER_PAIRS
from .frames import ROTATIONS, Frame, Placed
from .shapes import SHAPES
from .values import (Described, Flag, Inertia, Name, NotNegative, Number, Positive, Quaternion,
                     RotationVector, Text, Vector3, inertia_matrix, listed, one_of, suggestion)

WORLD = "world"
# Joints whose motion has one rate: which coordinate of the relative twist it is, the turn about z
# or, where there is none, the slide along z. Angular first, axes of the child's joint frame.
RATES = {"revolute": 2, "cylindrical": 2, "planar": 2, "screw": 2, "prismatic": 5}


class Body(Placed):
    """Rigid body and its state at the start. Mass, inertia and com are there also with a shape."""

    name: Name = Field(description="name: a letter, then letters, digits or _; unique, not world")
    mass: Positive | None = Field(
        None, description="mass in kg, greater than 0; required without a shape")
    inertia: Inertia | None = Field(
        None, description="inertia about the centre of mass in kg m^2, body axes: "
        "[Ixx, Iyy, Izz], or [Ixx, Iyy, Izz, Ixy, Ixz, Iyz], the elements of the symmetric "
        "matrix; required without a shape")
    com: Vector3 = Field((0.0, 0.0, 0.0), description="centre of mass in m, in the body frame")
    shape: one_of(SHAPES) | None = Field(
        None, description="solid that gives mass, inertia and com, in place of them")
    position: Vector3 = Field(
        (0.0, 0.0, 0.0), description="origin of the body frame at the start in m, world axes")
    quaternion: Quaternion | None = Field(
        None, description="rotation from body to world axes at the start as unit quaternion "
        "x, y, z, w; no rotation if left out")
    rotation_vector: RotationVector | None = Field(
        None, description="the same rotation as rotation vector in rad, in place of quaternion")
    angular_velocity: Vector3 = Field(
        (0.0, 0.0, 0.0), description="angular velocity at the start in rad/s, body axes")
    linear_velocity: Vector3 = Field(
        (0.0, 0.0, 0.0), description="velocity of the origin of the body frame at the start in "
        "m/s, body axes")
    initial: Literal["guess", "fixed"] = Field(
        "guess", description="what assembly makes of the pose, and of the velocities, that are "
        "given here: guess, it starts from them; fixed, it keeps them")

    @model_validator(mode="after")
    def _check(self):
        if self.name == WORLD:
            raise SceneError(f'name "{WORLD}" is taken by the fixed frame: choose another',
                             place=("name",))
        if self.shape is None:
            for key in ("mass", "inertia"):
                if getattr(self, key) is None:
                    raise SceneError(f"{key} is missing: give the "
                                     f"{type(self).model_fields[key].description}", place=(key,))
            return self
        for key in ("mass", "inertia", "com"):
            if key in self.model_fields_set:
                raise SceneError(f"{key} and shape both give the {key}: keep one of them",
                                 place=(key,))
        try:
            self.__dict__.update(self.shape.body)
        except SceneError as error:
            raise SceneError(f"shape: {error}", place=("shape",)) from None
        return self

    @property
    def inertia_matrix(self):
        """(3, 3) inertia about the centre of mass, body axes, kg m^2."""
        return inertia_matrix(self.inertia)

    @property
    def has_pose(self):
        """True when the scene gives a position or a rotation."""
        return not self.model_fields_set.isdisjoint(("position", *ROTATIONS))

    @property
    def has_twist(self):
        """True when the scene gives a velocity."""
        return not self.model_fields_set.isdisjoint(("angular_velocity", "linear_velocity"))

    @property
    def twist(self):
        """(6,) twist at the start, angular first, body axes, rad/s and m/s."""
        return np.array(self.angular_velocity + self.linear_velocity)


class Joint(Described):
    """Lower pair between a body and another one or the world."""

    name: Name = Field(description="name, unique among joints and forces")
    type: Literal[tuple(LOWER_PAIRS)] = Field(
        description=f"kind of joint: {' or '.join(LOWER_PAIRS)}")
    parent: Text = Field(description="name of a body, or world")
    child: Text = Field(description="name of a body")
    parent_frame: Frame | None = Field(
        None, description="joint frame in the frame of the parent; if left out, it is where "
        "child_frame is at the start")
    child_frame: Frame | None = Field(
        None, description="joint frame in the frame of the child; if left out, it is where "
        "parent_frame is at the start")
    rate: Number | None = Field(
        None, description="rate at the start, for assembly: of the turn about z in rad/s, or of "
        "the slide along z in m/s if the joint does not turn")

    @model_validator(mode="after")
    def _check(self):
        if self.rate is not None and self.type not in RATES:
            raise SceneError(f"rate is not for a {self.type} joint, which has no single one: "
                             f"it goes with {', '.join(RATES)}", place=("rate",))
        if self.parent_frame is None and self.child_frame is None:
            raise SceneError("parent_frame or child_frame is missing: give at least one of them")
        return self


class SpringDamper(Described):
    """Straight spring and damper between two points."""

    name: Name = Field(description="name, unique among joints and forces")
    type: Literal["spring_damper"] = Field("spring_damper", description="spring_damper")
    parent: Text = Field(description="name of a body, or world")
    parent_point: Vector3 = Field(description="attachment point in m, in the frame of the parent")
    child: Text = Field(description="name of a body")
    child_point: Vector3 = Field(description="attachment point in m, in the frame of the child")
    stiffness: NotNegative = Field(description="stiffness in N/m, not negative")
    damping: NotNegative = Field(
        0.0, description="damping along the line between the points in N s/m, not negative")
    rest_length: NotNegative = Field(
        0.0, description="length without force in m, not negative")


JOINTS = (Joint,)
FORCES = (SpringDamper,)


def _entries(classes):
    """Type of a list of entries, each made by the class that its `type` selects."""
    # a key without a value is an empty list
    return Annotated[tuple[one_of(classes), ...],
                     BeforeValidator(lambda value: [] if value is None else listed(value))]


class Scene(Described):
    """Whole scene: what there is, and how it starts."""

    name: Name = Field(description="name of the scene: a letter, then letters, digits or _")
    description: Text = Field("", description="free text")
    gravity: Vector3 = Field(description="gravity in m/s^2, world axes, such as [0, 0, -9.81]")
    assemble: Flag = Field(
        False, description="true: the joints close the poses and velocities that the bodies have "
        "here; false: these are those of the start")
    bodies: Annotated[tuple[Body, ...], BeforeValidator(listed)] = Field(
        description="list of bodies, at least one")
    joints: _entries(JOINTS) = Field((), description="list of joints")
    forces: _entries(FORCES) = Field((), description="list of forces")

    _text: str | None = PrivateAttr(None)
    _source: str | None = PrivateAttr(None)

    @property
    def text(self):
        """YAML text of the scene: as it was read, or written out if it was made in code."""
        return self._text if self._text is not None else _written_out(self)

    @property
    def source(self):
        """Path or name the scene was read from; its own name if it was made in code."""
        return self._source if self._source is not None else self.name

    @model_validator(mode="after")
    def _check(self):
        if not self.bodies:
            raise SceneError("bodies is empty: give at least one body", place=("bodies",))
        bodies = [body.name for body in self.bodies]
        _refuse_twins([("bodies", i, name) for i, name in enumerate(bodies)])
        links = [(key, i, link) for key in ("joints", "forces")
                 for i, link in enumerate(getattr(self, key))]
        _refuse_twins([(key, i, link.name) for key, i, link in links])
        for key, i, link in links:
            _refuse_ends(link, bodies, key, i)
        for key, name in (("bodies", "initial"), ("joints", "rate")):
            for i, entry in enumerate(getattr(self, key)):
                if not self.assemble and name in entry.model_fields_set:
                    raise SceneError(f'{key}[{i}] "{entry.name}": {name} is for assembly: leave '
                                     "it out, or give the scene assemble: true",
                                     place=(key, i, name))
        return self


def _refuse_twins(entries):
    """Refuse a name that two of the (list, index, name) entries have."""
    first = {}
    for key, i, name in entries:
        if name in first:
            raise SceneError(f'{key}[{i}] "{name}": name is already that of {first[name]}: '
                             "give each its own", place=(key, i, "name"))
        first[name] = f"{key}[{i}]"


def _refuse_ends(link, bodies, key, i):
    """Refuse a joint or force that does not hold a body to another one or to the world."""
    where = f'{key}[{i}] "{link.name}": '
    if link.child == WORLD:
        hint = "name a body" if link.parent == WORLD else "swap parent and child"
        raise SceneError(f"{where}child must be a body, not {WORLD}: {hint}",
                         place=(key, i, "child"))
    for end, known in (("parent", [WORLD, *bodies]), ("child", bodies)):
        name = getattr(link, end)
        if name not in known:
            raise SceneError(f"{where}{end} {name!r:.40} is no body; {suggestion(name, known)}",
                             place=(key, i, end))
    if link.parent == link.child:
        raise SceneError(f'{where}parent and child are both "{link.child}": '
                         "name two different ones", place=(key, i, "child"))


class _Dumper(yaml.SafeDumper):
    """Writes lists of numbers on one line, and free text in quotes so that it stays text."""

    def represent_str(self, text):
        style = None if text.replace("_", "").isalnum() and text.isascii() else '"'
        return self.represent_scalar("tag:yaml.org,2002:str", text, style=style)


_Dumper.add_representer(str, _Dumper.represent_str)


def _written_out(scene):
    """YAML text of a scene made in code; numbers are written so that they read back the same."""
    values: dict[str, Any] = scene.model_dump(exclude_unset=True)
    for force, written in zip(scene.forces, values.get("forces", ())):
        written.setdefault("type", force.type)
    for body, written in zip(scene.bodies, values["bodies"]):
        if written.get("shape"):
            written["shape"].setdefault("type", body.shape.type)
    return yaml.dump(values, Dumper=_Dumper, sort_keys=False, default_flow_style=None,
                     width=float("inf"))
