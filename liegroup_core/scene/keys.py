# SPDX-License-Identifier: Apache-2.0
"""Keys of scene files: one table for each part of a scene, read from the models."""

from typing import NamedTuple, get_args

from liegroup_core.fields.frames import Frame
from liegroup_core.forces.contact import CONTACT_SHAPES, Plane
from liegroup_core.forces.law import LawInput, LawOutput, LawState, LawTable
from liegroup_core.joints.coupling import Coupling
from liegroup_core.joints.motion import Motion
from liegroup_core.joints.rotor import Rotor
from liegroup_core.joints.stops import Backlash, Cone, CylinderFriction, CylinderLimits, Friction, Limits
from liegroup_core.robots.ground import Ground
from liegroup_core.robots.held_joints import Servos
from liegroup_core.robots.starts import Start

from .description import FORCES, JOINTS, SENSORS, Body, Scene
from .drive import Drive
from .robot_file import RobotFile
from .shapes import SHAPES

# {place of the keys: models of this place}
PARTS = {
    "scene": (Scene,),
    "bodies": (Body,),
    "shape of a body": SHAPES,
    "joints": JOINTS,
    "frame": (Frame,),
    "motion of a joint": (Motion,),
    "limits of a joint": (Limits, Cone, CylinderLimits),
    "friction of a joint": (Friction, CylinderFriction),
    "rotor of a joint": (Rotor,),
    "couplings": (Coupling,),
    "backlash of a coupling": (Backlash,),
    "forces": FORCES,
    "input of a law": (LawInput,),
    "table of a law": (LawTable,),
    "state of a law": (LawState,),
    "output of a law": (LawOutput,),
    "shape of a contact": CONTACT_SHAPES,
    "plane of a contact": (Plane,),
    "sensors": SENSORS,
    "drive": (Drive,),
    "file beside a robot": (RobotFile,),
    "start of a link": (Start,),
    "ground of a robot": (Ground,),
    "servos of a robot": (Servos,),
}


class Key(NamedTuple):
    """Name, meaning and default of a key, as texts."""

    name: str
    meaning: str
    default: str


class Table(NamedTuple):
    """Keys of one model, with its place, the values of its key `type` and its summary."""

    place: str
    types: tuple[str, ...]
    summary: str
    keys: tuple[Key, ...]

    @property
    def title(self) -> str:
        """Place, and types if there are any."""
        return f"{self.place}: {', '.join(self.types)}" if self.types else self.place


def key_tables():
    """Tables of all parts of a scene, in the order of PARTS."""
    return [_table(place, model) for place, models in PARTS.items() for model in models]


def _table(place, model):
    fields = model.model_fields
    types = get_args(fields["type"].annotation) if "type" in fields else ()
    keys = tuple(Key(name, field.description, _default(field)) for name, field in fields.items())
    return Table(place, types, model.__doc__.splitlines()[0], keys)


def _default(field):
    if field.is_required():
        return "required"
    value = list(field.default) if isinstance(field.default, tuple) else field.default
    if value is None:
        return "-"
    if value in ("", [], {}):
        return "empty"
    return str(value).lower() if isinstance(value, bool) else str(value)
