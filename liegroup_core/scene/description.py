# SPDX-License-Identifier: Apache-2.0
"""Scene description: bodies, joints and forces, as frozen models that check themselves.

SI units, angles in radians. The world frame is `world`. A body frame is fixed to its body; `com` is
the centre of mass in this frame. Rotations map body components to world components; quaternions
are x, y, z, w. Twists are (omega, v) in body axes, angular first; v is that of the body frame's origin.

A model made from wrong values raises `SceneError`. The classes of joints, forces and sensors are next
to their equations, in liegroup_core/joints/, liegroup_core/forces/ and liegroup_core/sensors/.
"""

from typing import Annotated, Any, Literal

import numpy as np
import yaml
from pydantic import BeforeValidator, Field, PrivateAttr, field_validator, model_validator

from liegroup_core.errors import SceneError
from liegroup_core.fields.frames import ROTATIONS, Frame, Placed
from liegroup_core.fields.values import (
    Described,
    Flag,
    Inertia,
    Name,
    Positive,
    Quaternion,
    RotationVector,
    Text,
    Vector3,
    inertia_matrix,
    listed,
    one_of,
    real_inertia,
)
from liegroup_core.forces import kinds as force_kinds
from liegroup_core.forces.kinds import *  # noqa: F403 (the classes of all forces)
from liegroup_core.forces.kinds import FORCES
from liegroup_core.forces.law import refuse_law
from liegroup_core.joints import kinds as joint_kinds
from liegroup_core.joints.coupling import COUPLED, Coupling
from liegroup_core.joints.kinds import *  # noqa: F403 (the classes of all joints)
from liegroup_core.joints.kinds import JOINTS, TYPES
from liegroup_core.sensors.kinds import SENSORS

from .drive import Drive, check_drive
from .names import (
    WORLD,
    refuse_coupling,
    refuse_ends,
    refuse_joint,
    refuse_motion,
    refuse_sensor,
    refuse_switches,
    refuse_twins,
    refuse_two_servos,
    refuse_unknown,
)
from .shapes import SHAPES

__all__ = ["WORLD", "Body", "Coupling", "Frame", "Scene"]
__all__ += force_kinds.__all__
__all__ += joint_kinds.__all__


class Body(Placed):
    """Rigid body and its initial state. A shape also sets mass, inertia and com."""

    name: Name = Field(description="name: a letter, then letters, digits or _; unique, not world")
    mass: Positive | None = Field(None, description="mass in kg, greater than 0; required without a shape")
    unphysical: Flag = Field(
        False,
        description="true: accept an inertia that no rigid body can have (largest principal moment "
        "above the sum of the other two), as in some robot descriptions",
    )
    inertia: Inertia | None = Field(
        None,
        description="inertia about the centre of mass in kg m^2, body axes: "
        "[Ixx, Iyy, Izz], or [Ixx, Iyy, Izz, Ixy, Ixz, Iyz], the elements of the symmetric "
        "matrix; principal moments may be 0; required without a shape",
    )
    com: Vector3 = Field((0.0, 0.0, 0.0), description="centre of mass in m, in the body frame")
    shape: one_of(SHAPES) | None = Field(None, description="solid that defines mass, inertia and com; replaces them")
    position: Vector3 = Field((0.0, 0.0, 0.0), description="initial position of the body frame origin in m, world axes")
    quaternion: Quaternion | None = Field(
        None, description="initial rotation from body to world axes as unit quaternion x, y, z, w; default: no rotation"
    )
    rotation_vector: RotationVector | None = Field(
        None, description="the same rotation as rotation vector in rad; replaces quaternion"
    )
    angular_velocity: Vector3 = Field((0.0, 0.0, 0.0), description="initial angular velocity in rad/s, body axes")
    linear_velocity: Vector3 = Field(
        (0.0, 0.0, 0.0), description="initial velocity of the body frame origin in m/s, body axes"
    )
    initial: Literal["guess", "fixed"] = Field(
        "guess", description="use of the given pose and velocities in assembly: guess (starting values) or fixed (kept)"
    )

    @field_validator("inertia")
    @classmethod
    def _of_a_body(cls, moments, info):
        return moments if moments is None or info.data.get("unphysical") else real_inertia(moments)

    @model_validator(mode="after")
    def _check(self):
        if self.name == WORLD:
            raise SceneError(f'name "{WORLD}" is reserved for the fixed frame: choose another', place=("name",))
        if self.shape is None:
            for key in ("mass", "inertia"):
                if getattr(self, key) is None:
                    raise SceneError(
                        f"{key} is missing: give the {type(self).model_fields[key].description}", place=(key,)
                    )
            return self
        for key in ("mass", "inertia", "com"):
            if key in self.model_fields_set:
                raise SceneError(f"{key} and shape both define the {key}: keep one of them", place=(key,))
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


def entries_of(classes):
    """Type of a list of entries; the `type` of an entry selects its class."""
    return list_of(one_of(classes))


def list_of(item):
    """Type of a list; a key without a value is an empty list."""
    return Annotated[tuple[item, ...], BeforeValidator(lambda value: [] if value is None else listed(value))]


class Scene(Described):
    """Whole scene: mechanism and initial state."""

    name: Name = Field(description="name of the scene: a letter, then letters, digits or _")
    description: Text = Field("", description="free text")
    gravity: Vector3 = Field(description="gravity in m/s^2, world axes, such as [0, 0, -9.81]")
    assemble: Flag = Field(
        False,
        description="true: assemble, that is, correct the given poses and velocities so that they satisfy "
        "the joints; false: use them as given",
    )
    notes: Annotated[tuple[Text, ...], BeforeValidator(listed)] = Field(
        (), description="remarks that `liegroup_sim describe` prints, such as what an import left out"
    )
    bodies: Annotated[tuple[Body, ...], BeforeValidator(listed)] = Field(description="list of bodies, at least one")
    joints: entries_of(JOINTS) = Field((), description="list of joints")
    couplings: list_of(Coupling) = Field((), description="list of couplings of joints: gears, belts, racks")
    forces: entries_of(FORCES) = Field((), description="list of forces")
    sensors: entries_of(SENSORS) = Field((), description="list of sensors")
    drive: Drive | None = Field(None, description="wheels of a mobile robot that the node commands by ~/cmd_vel")

    _text: str | None = PrivateAttr(None)
    _source: str | None = PrivateAttr(None)
    _where: Any = PrivateAttr(None)  # yaml_text.Lines, or an object with its methods
    _robot: Any = PrivateAttr(None)

    @property
    def text(self):
        """YAML text of the scene: as read, or generated if the scene was made in code."""
        return self._text if self._text is not None else _written_out(self)

    @property
    def source(self):
        """Path or name that the scene was read from; its own name if it was made in code."""
        return self._source if self._source is not None else self.name

    @property
    def differences(self):
        """Notes on deviations from the robot file that change the motion."""
        return [note for note in self.notes if note.startswith("changes the motion")]

    @property
    def unwrapped(self):
        """[(joint, force or coupling)]: names for each unwrapped angle; see forces/axis.py."""
        types = {joint.name: joint.type for joint in self.joints}
        coupled = [(name, e.name) for e in self.couplings for name in e.counted if TYPES[types[name]].turns]
        turning = [name for name, kind in types.items() if TYPES[kind].coordinate == "rad"]
        return force_kinds.unwrapped(self.forces, coupled, turning, self.sensors)

    @property
    def robot(self):
        """RobotNames of a scene that was read from a robot file, else None."""
        return self._robot

    def located(self, error):
        """SceneError with file and line added, if the scene was read from a text."""
        if self._where is None:
            return error
        return self._where.located(error)

    @model_validator(mode="after")
    def _check(self):
        if not self.bodies:
            raise SceneError("bodies is empty: give at least one body", place=("bodies",))
        bodies = [body.name for body in self.bodies]
        refuse_twins([("bodies", i, name) for i, name in enumerate(bodies)])
        links = [(key, i, link) for key in ("joints", "forces") for i, link in enumerate(getattr(self, key))]
        refuse_two_servos(self.forces)
        couplings = [("couplings", i, entry.name) for i, entry in enumerate(self.couplings)]
        refuse_twins([*((key, i, link.name) for key, i, link in links), *couplings])
        for i, joint in enumerate(self.joints):
            if joint.rate is not None and TYPES[joint.type].rate is None:
                raise SceneError(
                    f'joints[{i}] "{joint.name}": rate cannot be given for a {joint.type} joint, '
                    "which has no single joint velocity; use it with "
                    f"{', '.join(name for name, kind in TYPES.items() if kind.rate is not None)}",
                    place=("joints", i, "rate"),
                )
            if joint.coordinate is not None and joint.type not in COUPLED:
                raise SceneError(
                    f'joints[{i}] "{joint.name}": coordinate cannot be given for a {joint.type} joint; '
                    f"use it with {', '.join(COUPLED)}",
                    place=("joints", i, "coordinate"),
                )
            refuse_motion(joint, self.forces, i)
            refuse_switches(joint, i)
        kinds = {joint.name: joint.type for joint in self.joints}
        moves, signals = [joint.name for joint in self.joints if TYPES[joint.type].coordinate], []
        servos = [force.name for force in self.forces if force.type in ("servo", "linear_servo")]
        for key, i, link in links:
            if link.type == "contact":
                try:
                    link.complete({body.name: body for body in self.bodies}, self.gravity)
                except SceneError as error:
                    where = f'forces[{i}] "{link.name}": {error}'
                    raise SceneError(where, place=("forces", i, *(error.place or ()))) from None
                signals += [f"{link.name}.{name}" for name in link.as_law.shown]
            elif link.type == "law":
                refuse_law(link, bodies, moves, signals, self.sensors, servos, i)
                led = [each.servo for each in link.outputs if each.servo is not None]
                if len({*led}) < len(led):
                    raise SceneError(f'forces[{i}] "{link.name}": two of its outputs are for the same servo')
                servos = [name for name in servos if name not in led]
                signals += [f"{link.name}.{name}" for name in link.shown]
            elif hasattr(link, "joint"):
                refuse_joint(link, kinds, i)
            elif hasattr(link, "body"):
                refuse_unknown("body", link, bodies, key, i)
            else:
                refuse_ends(link, bodies, key, i)
        for i, coupling in enumerate(self.couplings):
            refuse_coupling(coupling, kinds, i)
        named = [*links, *(("couplings", i, entry) for i, entry in enumerate(self.couplings))]
        for i, sensor in enumerate(self.sensors):
            taken = [*bodies, *(each.name for *_, each in named)]
            taken += [each.name for each in self.sensors[:i]]
            refuse_sensor(sensor, bodies, kinds, taken, i)
        check_drive(self)
        for key, name in (("bodies", "initial"), ("joints", "rate"), ("joints", "coordinate")):
            for i, entry in enumerate(getattr(self, key)):
                if not self.assemble and name in entry.model_fields_set:
                    raise SceneError(
                        f'{key}[{i}] "{entry.name}": {name} is only used in assembly: omit it, or add '
                        "assemble: true to the scene",
                        place=(key, i, name),
                    )
        return self


class _Dumper(yaml.SafeDumper):
    """YAML dumper: lists of numbers on one line, free text in quotes so that it stays text."""

    def represent_str(self, text):
        style = None if text.replace("_", "").isalnum() and text.isascii() else '"'
        return self.represent_scalar("tag:yaml.org,2002:str", text, style=style)


_Dumper.add_representer(str, _Dumper.represent_str)


def _written_out(scene):
    """YAML text of a scene made in code; numbers read back bit-identical."""
    values: dict[str, Any] = scene.model_dump(exclude_unset=True)
    for key in ("joints", "forces", "sensors"):
        for entry, written in zip(getattr(scene, key), values.get(key, ())):
            written.setdefault("type", entry.type)
    for body, written in zip(scene.bodies, values["bodies"]):
        if written.get("shape"):
            written["shape"].setdefault("type", body.shape.type)
    return yaml.dump(values, Dumper=_Dumper, sort_keys=False, default_flow_style=None, width=float("inf"))
