# SPDX-License-Identifier: Apache-2.0
"""Parameters of a scene: paths of its numbers, ranges of values, and changed scenes.

    bodies.top.mass     joints.pin.parent_frame.position.0      forces.spring.stiffness   gravity.2

Bodies, joints and forces appear by name, components of vectors by index from 0. A path can be
shortened to its ending if that is unambiguous: `mass` in a scene with one body, `spring.stiffness`.
A rotation is a rotation vector, whatever its form in the scene file.
"""

import difflib
import math
from dataclasses import dataclass, replace
from typing import Annotated, get_args

import numpy as np
from pydantic import TypeAdapter, ValidationError
from scipy.special import ndtri

from liegroup_core.errors import LieGroupSimError
from liegroup_core.fields.frames import ROTATIONS, Placed
from liegroup_core.fields.values import Described, Number
from liegroup_core.joints.kinds import TYPES
from liegroup_core.lie.groups import SO3

from .description import Body

SHOWN = 12  # names in a message
# Keys of a body that follow from its shape.
OF_SHAPE = ("mass", "inertia", "com")


class ParameterError(LieGroupSimError, ValueError):
    """Unknown parameter or invalid range; one line of text, exit code 2."""


def parameters(scene):
    """{path: number} of all numbers of a scene; None for numbers that the scene omits."""
    return {".".join(path): value for path, value in _numbers(scene, ())}


def _numbers(value, path):
    if value is None or isinstance(value, float):
        yield path, value
    elif isinstance(value, tuple):
        for i, entry in enumerate(value):
            yield from _numbers(entry, (*path, getattr(entry, "name", str(i))))
    elif isinstance(value, dict):
        for key, entry in value.items():
            yield from _numbers(entry, (*path, key))
    elif isinstance(value, Described):
        for key in type(value).model_fields:
            if _is_parameter(value, key):
                yield from _numbers(_entry(value, key), (*path, key))


def _omitted(value, path):
    """Paths of groups of numbers, such as the friction of a joint, that a scene omits."""
    if isinstance(value, tuple):
        for i, entry in enumerate(value):
            yield from _omitted(entry, (*path, getattr(entry, "name", str(i))))
    elif isinstance(value, Described):
        for key, field in type(value).model_fields.items():
            entry = getattr(value, key)
            if entry is not None:
                yield from _omitted(entry, (*path, key))
            elif any(isinstance(part, type) and issubclass(part, Described) for part in get_args(field.annotation)):
                yield ".".join((*path, key))


def _is_parameter(model, key):
    entry = _entry(model, key)
    if isinstance(model, Body) and model.shape is not None and key in OF_SHAPE:
        return False
    if key == "rate" and hasattr(model, "type"):
        return TYPES[model.type].rate is not None
    return key != "quaternion" and (key == "length" or isinstance(entry, (float, tuple, dict, Described)))


def _entry(model, key):
    """Entry of a model; rotations in any form are returned as rotation vectors."""
    entry = getattr(model, key)
    if key == "rotation_vector" and entry is None and isinstance(model, Placed):
        return tuple(SO3.log(model.rotation).tolist())
    return entry


def _short(path):
    """Path of a parameter of a law as law.NAME.PARAMETER; of others the path."""
    kind, *owner, key = path.split(".")
    is_of_law = kind == "forces" and owner[-1:] == ["parameters"]
    return ".".join(["", "law", *owner[:-1], key]) if is_of_law else path


def path_of(scene, name):
    """Path for a name: the path itself or its unambiguous ending, of a law also law.NAME.PARAMETER.

    raises ParameterError with the known names
    """
    known = parameters(scene)
    if name in known:
        return name
    found = [path for path in known if path.endswith(f".{name}") or _short(path).endswith(f".{name}")]
    if len(found) == 1:
        return found[0]
    if found:
        raise ParameterError(f"the parameter {name} is ambiguous: {_listed(found)}; give the full path")
    group, _, key = name.rpartition(".")
    for path in _omitted(scene, ()):
        if group and f".{path}".endswith(f".{group}"):
            where, _, entry = path.rpartition(".")
            raise ParameterError(f"{where} has no {entry}: write {entry}: {{{key}: ...}} there, with a first guess")
    ends = {".".join(text.split(".")[-k:]): path for path in known for text in (path, _short(path)) for k in (1, 2, 3)}
    close = [ends[end] for end in difflib.get_close_matches(name, list(ends), n=3, cutoff=0.7)]
    close += difflib.get_close_matches(name, list(known), n=3, cutoff=0.6)
    meant = f"did you mean {_listed(list(dict.fromkeys(close)), 3, 'or')}? " if close else ""
    raise ParameterError(f"the scene has no parameter {name[:60]}; {meant}choose from {_listed(list(known))}")


def _listed(names, most=SHOWN, word="and"):
    if len(names) > most:
        return f"{', '.join(names[:most])} and {len(names) - most} more"
    return f" {word} ".join(filter(None, (", ".join(names[:-1]), names[-1])))


def changed(scene, values):
    """Scene with changed numbers, {path: number}, fully checked. Raises SceneError."""
    tree = {}
    for path, value in values.items():
        *inner, last = path.split(".")
        branch = tree
        for step in inner:
            branch = branch.setdefault(step, {})
        branch[last] = float(value)
    return _changed(scene, tree)


def _changed(value, tree):
    if not isinstance(tree, dict):
        return tree
    if isinstance(value, tuple):
        labels = [getattr(entry, "name", str(i)) for i, entry in enumerate(value)]
        return [_changed(entry, tree[label]) if label in tree else entry for label, entry in zip(labels, value)]
    if isinstance(value, dict):
        return {key: _changed(entry, tree[key]) if key in tree else entry for key, entry in value.items()}
    update = {key: _changed(_entry(value, key), branch) for key, branch in tree.items()}
    other = [key for key in ROTATIONS if key != "rotation_vector"]
    return value.remade(other if "rotation_vector" in tree else (), **update)


@dataclass(frozen=True)
class Range:
    """Range of one parameter: maps u in 0..1 to values.

    kind : uniform (low, high), log (low, high), choice (values), normal (mean, deviation)
    """

    path: str
    kind: str
    numbers: tuple

    def at(self, u):
        """Values (k,) for u (k,)."""
        if self.kind == "choice":
            index = np.minimum((u * len(self.numbers)).astype(int), len(self.numbers) - 1)
            return np.array(self.numbers)[index]
        first, second = self.numbers
        if self.kind == "normal":
            tiny = np.finfo(float).eps
            return first + second * ndtri(np.clip(u, tiny, 1.0 - tiny))
        values = first * (second / first) ** u if self.kind == "log" else first + u * (second - first)
        return np.clip(values, first, second)

    def __str__(self):
        mark = {"choice": ",", "normal": "~"}.get(self.kind, ":")
        return f"{self.path}={mark.join(map(repr, self.numbers))}" + (":log" if self.kind == "log" else "")


def range_of(scene, text):
    """Range from a text: NAME=LOW:HIGH, NAME=LOW:HIGH:log, NAME=A,B,C or NAME=MEAN~DEVIATION.

    raises ParameterError for another form, an unknown name or an invalid number
    """
    found = unchecked(text)
    found = replace(found, path=path_of(scene, found.path))
    rule = _rule(scene, found.path)
    for number in found.numbers[:1] if found.kind == "normal" else found.numbers:
        try:
            rule.validate_python(number)
        except ValidationError as error:
            cause = error.errors()[0].get("ctx", {}).get("error", "is refused")
            raise _refused(text, f"{found.path} {cause}, got {number:g}") from None
    return found


def unchecked(text):
    """Range as of `range_of`, of any name. Raises ParameterError for another form."""
    name, equals, rest = text.partition("=")
    if not equals or not name.strip() or not rest.strip():
        raise _refused(text, "must be NAME=LOW:HIGH, NAME=LOW:HIGH:log, NAME=A,B,C or NAME=MEAN~DEVIATION")
    log = rest.endswith(":log")
    rest = rest.removesuffix(":log")
    mark = next((mark for mark in "~,:" if mark in rest), ",")
    try:
        numbers = tuple(float(part) for part in rest.split(mark))
    except ValueError:
        raise _refused(text, "contains something that is not a number") from None
    if not all(map(math.isfinite, numbers)):
        raise _refused(text, "contains a number that is not finite")
    kind = {"~": "normal", ",": "choice", ":": "log" if log else "uniform"}[mark]
    if log and kind != "log":
        raise _refused(text, "log requires LOW:HIGH")
    if kind != "choice" and len(numbers) != 2:
        raise _refused(text, f"must have two numbers, has {len(numbers)}")
    if kind in ("uniform", "log") and not numbers[0] < numbers[1]:
        raise _refused(text, f"{numbers[0]:g} must be below {numbers[1]:g}")
    if kind == "log" and not numbers[0] > 0.0:
        raise _refused(text, f"log needs numbers greater than 0, got {numbers[0]:g}")
    if kind == "normal" and not numbers[1] > 0.0:
        raise _refused(text, f"the deviation must be greater than 0, got {numbers[1]:g}")
    return Range(name.strip(), kind, numbers)


def _rule(scene, path):
    """Constraint on this number alone, independent of other numbers of the scene."""
    model, steps = scene, path.split(".")
    while steps:
        key = steps.pop(0)
        if isinstance(model, tuple):
            model = next((entry for entry in model if getattr(entry, "name", None) == key), None)
        elif steps:
            model = _entry(model, key)
        elif isinstance(model, Described):
            field = type(model).model_fields[key]
            return TypeAdapter(Annotated[field.annotation, *field.metadata] if field.metadata else field.annotation)
    return TypeAdapter(Number)


def _refused(text, why):
    return ParameterError(f"--vary {text[:80]}: {why}")
