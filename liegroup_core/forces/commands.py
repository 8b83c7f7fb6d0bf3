# SPDX-License-Identifier: Apache-2.0
"""Commands that act on a run from one time to another: wrenches, efforts, targets, motions.

A Command is what was asked for, with all that repeats it: it is what a run logs, records, keeps in its state and
passes to the companion of its error estimate.
"""

from typing import Any, NamedTuple

from liegroup_core.fields.arguments import got, is_finite
from liegroup_core.joints.motion import COLUMNS

from .instants import NS

WRENCH, EFFORT, PULL, TARGET, MOTION, CLEAR = "wrench", "effort", "pull", "target", "motion", "clear"
# {kind: number of its values} in what a run logs, records and keeps
KINDS = {WRENCH: 6, EFFORT: 1, PULL: 9, TARGET: 2, MOTION: COLUMNS, CLEAR: 0}
LOADS = (WRENCH, EFFORT, PULL)  # what a clear ends, and zeros
MOVE = "move"  # becomes motions when it starts, from where the joint is then
AXES = ("body", "world")
SCENE = "scene"  # source of what acts by the scene itself


class Command(NamedTuple):
    """Input of a run.

    kind   : "wrench" and "pull" on a body; "effort" at a joint; "target" of a servo; "motion" and "move" of a driven
             joint; "clear", the end of all loads of a source
    name   : of the body or joint
    values : torque N m, force N (6,); effort N m or N (1,); pull (9,): stiffness N/m, damping N s/m, point m in the
             world, torque N m in world axes, damping of the rotation N m s/rad; target (2,): position and
             velocity, rad or m; motion (7,), see joints/motion.py; of a move, the position (NaN: any) and velocity
             that it reaches, and in how many s (3,)
    start_ns, end_ns : simulated time in ns, whole numbers where the time is one; None: now, and until it is replaced
    source : a command replaces that of the same kind, source and name
    axes   : "body" or "world", of a wrench
    point  : (3,) m, in the body frame, at which the force of a wrench or pull acts; None: the origin
    cleared_ns : in a state, simulated time in ns at which a clear ends it, before its end; else None
    """

    kind: str
    name: str
    values: tuple[float, ...]
    start_ns: int | float | None = None
    end_ns: int | float | None = None
    source: str = ""
    axes: str = "body"
    point: tuple[float, ...] | None = None
    cleared_ns: int | float | None = None

    @property
    def start(self) -> float:
        """Simulated time at which it starts, s."""
        return self.start_ns / NS

    @property
    def key(self) -> tuple:
        """A later command with the same key replaces this one before it starts."""
        return self.kind, self.source, self.name, self.start_ns

    def since(self, base_ns: int) -> "Command":
        """Command of a run that began at a stamp; `start_ns` of this one is a stamp."""
        return self if self.start_ns is None else self._replace(start_ns=self.start_ns - base_ns)

    def repeat(self, simulation: Any) -> None:
        """Give it to another simulation of the same scene, from its time on, without checks of limits.

        Raises ValueError for an unknown body or joint.
        """
        simulation.inputs.accept(self)

    def as_json(self) -> dict[str, Any]:
        """JSON types, without entries that have their defaults."""
        entries = zip(self._fields, self)
        left_out = self._field_defaults
        return {name: value for name, value in entries if name not in left_out or value != left_out[name]}

    @classmethod
    def from_json(cls, data: Any, where: str = "a command") -> "Command":
        """Inverse of `as_json`. Raises ValueError."""
        if not isinstance(data, dict) or not data.keys() <= set(cls._fields):
            raise ValueError(f"{where} must have entries of {', '.join(cls._fields)}, {got(data)}")
        kind = data.get("kind")
        checks = {
            "kind": kind in KINDS if isinstance(kind, str) else False,
            "name": isinstance(data.get("name"), str),
            "values": isinstance(kind, str) and _numbers(data.get("values"), KINDS.get(kind)),
            "start_ns": is_finite(data.get("start_ns")),
            "end_ns": data.get("end_ns") is None or is_finite(data["end_ns"]),
            "source": isinstance(data.get("source", ""), str),
            "axes": data.get("axes", "body") in AXES,
            "point": data.get("point") is None or _numbers(data["point"], 3),
            "cleared_ns": data.get("cleared_ns") is None or is_finite(data["cleared_ns"]),
        }
        for name, fits in checks.items():
            if not fits:
                raise ValueError(f"{where} has a wrong {name}, {got(data.get(name))}")
        lists = {name: tuple(map(float, data[name])) for name in ("values", "point") if data.get(name) is not None}
        return cls(**(data | lists))


def _numbers(values, count):
    return isinstance(values, (list, tuple)) and len(values) == count and all(map(is_finite, values))


def _as_it_ends(command):
    cleared = command.cleared_ns
    return command if cleared is None else command._replace(end_ns=cleared, cleared_ns=None)


class Commands(NamedTuple):
    """Commands that act, and those that start later, in the order in which they were given."""

    acting: tuple[Command, ...] = ()
    waiting: tuple[Command, ...] = ()

    @property
    def as_they_end(self) -> "Commands":
        """Commands with the ends that hold; a run that continues also knows those that were given."""
        return Commands(*(tuple(map(_as_it_ends, part)) for part in self))

    def as_json(self) -> dict[str, Any]:
        """JSON types."""
        return {name: [command.as_json() for command in part] for name, part in zip(self._fields, self)}

    @classmethod
    def from_json(cls, data: Any, where: str = "commands") -> "Commands":
        """Inverse of `as_json`. Raises ValueError."""
        if not isinstance(data, dict) or data.keys() != set(cls._fields):
            raise ValueError(f"{where} must have the entries acting and waiting, {got(data)}")
        if not all(isinstance(part, list) for part in data.values()):
            raise ValueError(f"{where} must have two lists, {got(data)}")
        return cls(*(tuple(Command.from_json(one, f"{where}.{name}") for one in data[name]) for name in cls._fields))
