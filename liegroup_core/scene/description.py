# SPDX-License-Identifier: Apache-2.0
"""What a scene says: bodies, joints and forces, as frozen models that check themselves.

SI units, angles in radians. The world frame is `world`; a body frame is fixed to the body, its
centre of mass at `com` in it. Rotations turn body components into world components; quaternions
are x, y, z, w. Twists are (omega, v), angular first, in the axes of the body frame and about its
origin.

A model made from wrong values raises `SceneError`. A new kind of joint or force is one class with
a `type` (those of forces are in forces.py), and its entry in `JOINTS` or `FORCES`.
"""

from typing import Annotated, Any, Literal

import numpy as np
import yaml
from pydantic import BeforeValidator, Field, PrivateAttr, model_validator

from liegroup_core.errors import SceneError
from liegroup_core.fields.frames import ROTATIONS, Frame, Placed
from liegroup_core.fields.values import (
    Described,
    Flag,
    Inertia,
    Name,
    Number,
    Positive,
    Quaternion,
    RotationVector,
    Text,
    Vector3,
    inertia_matrix,
    listed,
    one_of,
    suggestion,
)
from liegroup_core.joints.elements import PLAIN_JOINTS

from .forces import (
    ConstantWrench,
    Drag,
    LinearMotor,
    LinearSpringDamper,
    Motor,
    SpringDamper,
    TorsionalSpringDamper,
)
from .shapes import SHAPES

WORLD = "world"
# Joints whose motion has one rate: which coordinate of the relative twist it is, the turn about z
# or, where there is none, the slide along z. Angular first, axes of the child's joint frame.
RATES = {"revolute": 2, "cylindrical": 2, "planar": 2, "screw": 2, "prismatic": 5}


class Body(Placed):
    """Rigid body and its state at the start. Mass, inertia and com are there also with a shape."""

    name: Name = Field(description="name: a letter, then letters, digits or _; unique, not world")
    mass: Positive | None = Field(
        None, description="mass in kg, greater than 0; required without a shape"
    )
    inertia: Inertia | None = Field(
        None,
        description="inertia about the centre of mass in kg m^2, body axes: "
        "[Ixx, Iyy, Izz], or [Ixx, Iyy, Izz, Ixy, Ixz, Iyz], the elements of the symmetric "
        "matrix; required without a shape",
    )
    com: Vector3 = Field((0.0, 0.0, 0.0), description="centre of mass in m, in the body frame")
    shape: one_of(SHAPES) | None = Field(
        None, description="solid that defines mass, inertia and com; replaces them"
    )
    position: Vector3 = Field(
        (0.0, 0.0, 0.0), description="initial position of the body frame origin in m, world axes"
    )
    quaternion: Quaternion | None = Field(
        None,
        description="initial rotation from body to world axes as unit quaternion x, y, z, w; "
        "default: no rotation",
    )
    rotation_vector: RotationVector | None = Field(
        None, description="the same rotation as rotation vector in rad; replaces quaternion"
    )
    angular_velocity: Vector3 = Field(
        (0.0, 0.0, 0.0), description="initial angular velocity in rad/s, body axes"
    )
    linear_velocity: Vector3 = Field(
        (0.0, 0.0, 0.0), description="initial velocity of the body frame origin in m/s, body axes"
    )
    initial: Literal["guess", "fixed"] = Field(
        "guess",
        description="use of the given pose and velocities in assembly: guess (starting values) or "
        "fixed (kept)",
    )

    @model_validator(mode="after")
    def _check(self):
        if self.name == WORLD:
            raise SceneError(
                f'name "{WORLD}" is reserved for the fixed frame: choose another', place=("name",)
            )
        if self.shape is None:
            for key in ("mass", "inertia"):
                if getattr(self, key) is None:
                    raise SceneError(
                        f"{key} is missing: give the {type(self).model_fields[key].description}",
                        place=(key,),
                    )
            return self
        for key in ("mass", "inertia", "com"):
            if key in self.model_fields_set:
                raise SceneError(
                    f"{key} and shape both define the {key}: keep one of them", place=(key,)
                )
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


class _Joint(Described):
    """What all joints between a body and another one or the world have."""

    name: Name = Field(description="name, unique among joints and forces")
    type: str
    parent: Text = Field(description="name of a body, or world")
    child: Text = Field(description="name of a body")
    parent_frame: Frame | None = Field(
        None, description="joint frame in the parent frame; default: where child_frame is initially"
    )
    child_frame: Frame | None = Field(
        None, description="joint frame in the child frame; default: where parent_frame is initially"
    )
    rate: Number | None = Field(
        None,
        description="initial joint velocity for assembly: about z in rad/s, or along z in m/s if "
        "the joint does not rotate",
    )

    @model_validator(mode="after")
    def _check(self):
        if self.rate is not None and self.type not in RATES:
            raise SceneError(
                f"rate cannot be given for a {self.type} joint, which has no single joint "
                f"velocity; use it with {', '.join(RATES)}",
                place=("rate",),
            )
        if self.parent_frame is None and self.child_frame is None:
            raise SceneError("parent_frame or child_frame is missing: give at least one of them")
        return self


class Joint(_Joint):
    """Joint without a parameter: a lower pair, or a universal joint."""

    type: Literal[PLAIN_JOINTS] = Field(
        description=f"kind of joint: {', '.join(PLAIN_JOINTS[:-1])} or {PLAIN_JOINTS[-1]}"
    )


class ScrewJoint(_Joint):
    """Nut on a bolt: turning about z moves the child along z."""

    type: Literal["screw"] = Field("screw", description="screw")
    pitch: Number = Field(
        description="displacement along z in m per radian, positive for a right-handed thread"
    )


class DistanceJoint(_Joint):
    """Massless rod between the origins of two frames."""

    type: Literal["distance"] = Field("distance", description="distance")
    parent_frame: Frame = Field(description="frame in the parent frame; only its origin is used")
    child_frame: Frame = Field(description="frame in the child frame; only its origin is used")
    length: Positive | None = Field(
        None,
        description="distance of the origins in m, greater than 0; default: the initial distance",
    )


JOINTS = (Joint, ScrewJoint, DistanceJoint)
FORCES = (
    SpringDamper,
    TorsionalSpringDamper,
    LinearSpringDamper,
    Motor,
    LinearMotor,
    Drag,
    ConstantWrench,
)


def _entries(classes):
    """Type of a list of entries, each made by the class that its `type` selects."""
    # a key without a value is an empty list
    return Annotated[
        tuple[one_of(classes), ...],
        BeforeValidator(lambda value: [] if value is None else listed(value)),
    ]


class Scene(Described):
    """Whole scene: what there is, and how it starts."""

    name: Name = Field(description="name of the scene: a letter, then letters, digits or _")
    description: Text = Field("", description="free text")
    gravity: Vector3 = Field(description="gravity in m/s^2, world axes, such as [0, 0, -9.81]")
    assemble: Flag = Field(
        False,
        description="true: assemble, correct the given poses and velocities until they satisfy the "
        "joints; false: use them as given",
    )
    bodies: Annotated[tuple[Body, ...], BeforeValidator(listed)] = Field(
        description="list of bodies, at least one"
    )
    joints: _entries(JOINTS) = Field((), description="list of joints")
    forces: _entries(FORCES) = Field((), description="list of forces")

    _text: str | None = PrivateAttr(None)
    _source: str | None = PrivateAttr(None)
    _line_of: Any = PrivateAttr(None)  # function: place in the scene -> line of its text

    @property
    def text(self):
        """YAML text of the scene: as it was read, or written out if it was made in code."""
        return self._text if self._text is not None else _written_out(self)

    @property
    def source(self):
        """Path or name the scene was read from; its own name if it was made in code."""
        return self._source if self._source is not None else self.name

    def located(self, error):
        """A SceneError about this scene with file and line, if it was read from a text."""
        if self._line_of is None:
            return error
        return SceneError(f"{self.source}:{self._line_of(error.place or ())}: {error}", error.place)

    @model_validator(mode="after")
    def _check(self):
        if not self.bodies:
            raise SceneError("bodies is empty: give at least one body", place=("bodies",))
        bodies = [body.name for body in self.bodies]
        _refuse_twins([("bodies", i, name) for i, name in enumerate(bodies)])
        links = [
            (key, i, link)
            for key in ("joints", "forces")
            for i, link in enumerate(getattr(self, key))
        ]
        _refuse_twins([(key, i, link.name) for key, i, link in links])
        kinds = {joint.name: joint.type for joint in self.joints}
        for key, i, link in links:
            if hasattr(link, "joint"):
                _refuse_joint(link, kinds, i)
            elif hasattr(link, "body"):
                _refuse_unknown("body", link, bodies, key, i)
            else:
                _refuse_ends(link, bodies, key, i)
        for key, name in (("bodies", "initial"), ("joints", "rate")):
            for i, entry in enumerate(getattr(self, key)):
                if not self.assemble and name in entry.model_fields_set:
                    raise SceneError(
                        f'{key}[{i}] "{entry.name}": {name} is only used in assembly: omit it, or add '
                        "assemble: true to the scene",
                        place=(key, i, name),
                    )
        return self


def _refuse_twins(entries):
    """Refuse a name that two of the (list, index, name) entries have."""
    first = {}
    for key, i, name in entries:
        if name in first:
            raise SceneError(
                f'{key}[{i}] "{name}": this name is already used by {first[name]}: choose another',
                place=(key, i, "name"),
            )
        first[name] = f"{key}[{i}]"


def _refuse_ends(link, bodies, key, i):
    """Refuse a joint or force that does not hold a body to another one or to the world."""
    where = f'{key}[{i}] "{link.name}": '
    if link.child == WORLD:
        hint = "name a body" if link.parent == WORLD else "swap parent and child"
        raise SceneError(
            f"{where}child must be a body, not {WORLD}: {hint}", place=(key, i, "child")
        )
    _refuse_unknown("parent", link, [WORLD, *bodies], key, i)
    _refuse_unknown("child", link, bodies, key, i)
    if link.parent == link.child:
        raise SceneError(
            f'{where}parent and child are both "{link.child}": they must differ',
            place=(key, i, "child"),
        )


def _refuse_unknown(end, link, known, key, i):
    """Refuse a joint or force whose `end` is none of the known bodies."""
    name = getattr(link, end)
    if name not in known:
        raise SceneError(
            f'{key}[{i}] "{link.name}": {end} {name!r:.40} is not a body; '
            f"{suggestion(name, known)}",
            place=(key, i, end),
        )


def _refuse_joint(force, kinds, i):
    """Refuse a force on a joint that is not there or does not move the way the force needs."""
    where, place = f'forces[{i}] "{force.name}": ', ("forces", i, "joint")
    if force.joint not in kinds:
        hint = suggestion(force.joint, list(kinds)) if kinds else "the scene has no joints"
        raise SceneError(f"{where}joint {force.joint!r:.40} is not a joint; {hint}", place=place)
    if kinds[force.joint] not in force.joint_types:
        raise SceneError(
            f'{where}joint "{force.joint}" is {kinds[force.joint]}, but {force.type} '
            f"requires a joint that is {' or '.join(force.joint_types)}",
            place=place,
        )


class _Dumper(yaml.SafeDumper):
    """Writes lists of numbers on one line, and free text in quotes so that it stays text."""

    def represent_str(self, text):
        style = None if text.replace("_", "").isalnum() and text.isascii() else '"'
        return self.represent_scalar("tag:yaml.org,2002:str", text, style=style)


_Dumper.add_representer(str, _Dumper.represent_str)


def _written_out(scene):
    """YAML text of a scene made in code; numbers are written so that they read back the same."""
    values: dict[str, Any] = scene.model_dump(exclude_unset=True)
    for key in ("joints", "forces"):
        for entry, written in zip(getattr(scene, key), values.get(key, ())):
            written.setdefault("type", entry.type)
    for body, written in zip(scene.bodies, values["bodies"]):
        if written.get("shape"):
            written["shape"].setdefault("type", body.shape.type)
    return yaml.dump(
        values, Dumper=_Dumper, sort_keys=False, default_flow_style=None, width=float("inf")
    )
