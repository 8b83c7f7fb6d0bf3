# SPDX-License-Identifier: Apache-2.0
"""Types and checks of the numbers, vectors and names of a scene.

A check raises ValueError with a text that follows the name of the value ("must be greater than
0"), or SceneError with a whole sentence. `Described`, the base of all scene models, turns both
into one SceneError with the place, what is wrong, and the given value.
"""

import difflib
import math
import numbers
import re
import reprlib
from collections.abc import Mapping, Sequence
from typing import Annotated, Union, get_args

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    ValidationError,
    WithJsonSchema,
    model_validator,
)

from liegroup_core.errors import SceneError

# Squares and products of three numbers of this size still fit into a float (1.8e308).
LARGEST_NUMBER = 1e100
MOST_FRICTION = 100.0  # a slope of 89.4 degrees
QUOTE = "between braces or brackets, quote a text that has a comma"

# Four components rounded to three digits have errors up to 5e-4, their norm at most 1e-3.
QUATERNION_NORM_TOLERANCE = 1e-3

# A negative principal moment counts as zero if it is above minus this fraction of the largest one.
NEGATIVE_ROUND_OFF = 1e-12

# Moments rounded to seven digits have errors up to 5e-7 of the largest one. Both sides of the triangle
# inequality have this error, 1e-6 in sum. For a flat plate both sides are equal.
TRIANGLE_TOLERANCE = 1e-6

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,63}")


def _plain(value):
    """Value with NumPy's numbers converted to Python's."""
    if isinstance(value, (np.generic, np.ndarray)):
        return value.tolist()
    if type(value) in (list, tuple):
        return type(value)(map(_plain, value[: SHOWN + 1]))
    return value


SHOWN = 6  # entries of a list in a message


def shown(value):
    """Short text of any value, for a message."""
    if value is None:
        return "nothing"
    if isinstance(value, (list, tuple)) and len(value) > SHOWN and isinstance(value[0], (list, tuple)):
        return f"a list of {len(value)}"
    value = _plain(value)
    short = reprlib.Repr()
    short.maxlist = short.maxtuple = short.maxdict = SHOWN
    short.maxlevel = 2
    short.maxstring = short.maxother = short.maxlong = 40
    try:
        return short.repr(value)
    except ValueError:  # an integer too long to be written in decimal
        return f"a value of type {type(value).__name__}"


def suggestion(word, options):
    """Hint for an unknown word: the most similar option, if any, and all options."""
    close = difflib.get_close_matches(str(word), options, n=1, cutoff=0.7)
    meant = f'did you mean "{close[0]}"? ' if close else ""
    return f"{meant}choose one of: {', '.join(options[:20])}{', ...' if len(options) > 20 else ''}"


def _number(value):
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        raise ValueError("must be a number, without quotes or unit")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise ValueError("must be finite")
    if abs(number) > LARGEST_NUMBER:
        raise ValueError(f"must be at most {LARGEST_NUMBER:g} in magnitude")
    return number


def _positive(number):
    if not number > 0.0:
        raise ValueError("must be greater than 0")
    return number


def _not_negative(number):
    if number < 0.0:
        raise ValueError("must not be negative")
    return number


def listed(value):
    """List from a list, tuple or array."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, (str, bytes)) or not isinstance(value, Sequence):
        raise ValueError("must be a list")
    return list(value)


def _curve(value):
    value = listed(value)
    if len(value) > 3:
        raise ValueError("must have at most 3 numbers [a2, a3, a4]")
    return value


def _three(value):
    value = listed(value)
    if len(value) != 3:
        raise ValueError("must have 3 numbers [x, y, z]")
    return value


def _four(value):
    value = listed(value)
    if len(value) != 4:
        raise ValueError("must have 4 numbers [x, y, z, w]")
    return value


def _unit(quaternion):
    norm = math.hypot(*quaternion)
    if not abs(norm - 1.0) <= QUATERNION_NORM_TOLERANCE:
        raise ValueError(
            f"must have norm 1 within {QUATERNION_NORM_TOLERANCE:g} (it is then normalised), but the norm is {norm:.6g}"
        )
    return quaternion


def _sizes(vector):
    if not min(vector) > 0.0:
        raise ValueError("must be three lengths greater than 0")
    return vector


def _within_a_turn(vector):
    angle = math.hypot(*vector)
    if angle > 2.0 * math.pi:
        raise ValueError(f"must have a magnitude of at most 2 pi, but has {angle:.6g}; the unit is rad, not degrees")
    return vector


def _direction(vector):
    # The inverse of a smaller length would exceed LARGEST_NUMBER.
    if not math.hypot(*vector) >= 1.0 / LARGEST_NUMBER:
        raise ValueError("must not be zero: give the direction of the axis")
    return vector


def real_inertia(moments):
    """Return the moments of inertia; raise ValueError if no rigid body can have them.

    Principal moments may be zero, as for point masses and rods without thickness.
    """
    small, middle, large, scale = _principal(positive_inertia(moments))
    if large > small + middle + TRIANGLE_TOLERANCE * large:
        principal = ", ".join(f"{scale * moment:.6g}" for moment in (small, middle, large))
        raise ValueError(
            f"must belong to a physical body: the largest principal moment of {principal} "
            "must not exceed the sum of the other two; check units, order and signs"
        )
    return moments


def positive_inertia(moments):
    """Return the moments of inertia; raise ValueError if a principal moment is negative."""
    if len(moments) not in (3, 6):
        raise ValueError("must have 3 numbers [Ixx, Iyy, Izz] or 6 [Ixx, Iyy, Izz, Ixy, Ixz, Iyz]")
    small, middle, large, scale = _principal(moments)
    # Eigenvalues of a scaled 3x3 matrix have errors of a few 1e-16, and numbers written with 15 digits
    # errors of a few 1e-15. So the zero moment of a rod without thickness may become negative.
    if not small >= -NEGATIVE_ROUND_OFF:
        principal = ", ".join(f"{scale * moment:.6g}" for moment in (small, middle, large))
        raise ValueError(f"must not be negative, but its principal moments are {principal}; check order and signs")
    return moments


def _principal(moments):
    """(small, middle, large, scale): principal moments divided by the scale, in ascending order."""
    scale = max(abs(moment) for moment in moments) or 1.0
    return (*np.linalg.eigvalsh(inertia_matrix(moments) / scale), scale)


def inertia_matrix(moments):
    """(3, 3) symmetric matrix of [Ixx, Iyy, Izz] or [Ixx, Iyy, Izz, Ixy, Ixz, Iyz]."""
    xx, yy, zz, xy, xz, yz = (*moments, 0.0, 0.0, 0.0)[:6]
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _text(value):
    if not isinstance(value, str):
        raise ValueError("must be text")
    return value


def _flag(value):
    if not isinstance(value, (bool, np.bool_)):
        raise ValueError("must be true or false")
    return bool(value)


def _name(value):
    if not isinstance(value, str) or not _NAME.fullmatch(value):
        raise ValueError("must be a name: a letter, then letters, digits or _, at most 64 characters")
    return str(value)


def _array(item, least, most):
    """JSON schema of a list of numbers."""
    return WithJsonSchema({"type": "array", "items": item, "minItems": least, "maxItems": most})


_NUMBER = {"type": "number"}
_POSITIVE = {"type": "number", "exclusiveMinimum": 0}

Number = Annotated[float, BeforeValidator(_number)]
Positive = Annotated[Number, AfterValidator(_positive), WithJsonSchema(_POSITIVE)]
NotNegative = Annotated[Number, AfterValidator(_not_negative), WithJsonSchema(_NUMBER | {"minimum": 0})]
Curve = Annotated[tuple[Number, ...], BeforeValidator(_curve), _array(_NUMBER, 0, 3)]
Vector3 = Annotated[tuple[Number, Number, Number], BeforeValidator(_three), _array(_NUMBER, 3, 3)]
Sizes = Annotated[Vector3, AfterValidator(_sizes), _array(_POSITIVE, 3, 3)]
RotationVector = Annotated[Vector3, AfterValidator(_within_a_turn)]
Direction = Annotated[Vector3, AfterValidator(_direction)]
Quaternion = Annotated[
    tuple[Number, Number, Number, Number], BeforeValidator(_four), AfterValidator(_unit), _array(_NUMBER, 4, 4)
]
Inertia = Annotated[
    tuple[Number, ...], BeforeValidator(listed), AfterValidator(positive_inertia), _array(_NUMBER, 3, 6)
]
Flag = Annotated[bool, BeforeValidator(_flag)]
Text = Annotated[str, BeforeValidator(_text)]
Name = Annotated[str, BeforeValidator(_name), WithJsonSchema({"type": "string", "pattern": f"^{_NAME.pattern}$"})]


def one_of(classes):
    """Type of a value whose key `type` selects one of these models."""
    by_type = {name: cls for cls in classes for name in get_args(cls.model_fields["type"].annotation)}

    def make(value):
        if isinstance(value, classes):
            return value
        if not isinstance(value, Mapping):
            raise ValueError("must be a mapping of keys to values")
        kinds = " or ".join(by_type)
        if "type" not in value:
            raise SceneError(f"type is missing: give {kinds}", place=("type",))
        if not isinstance(value["type"], str) or value["type"] not in by_type:
            raise SceneError(
                f"type {value['type']!r:.40} is not known; {suggestion(value['type'], list(by_type))}", place=("type",)
            )
        return by_type[value["type"]].model_validate(value)

    return Annotated[Union[classes], BeforeValidator(make)]


def place_text(place, values):
    """Readable path inside a scene: `bodies[0] "top": parent_frame.position[2]`.

    place  : keys and indices, from the scene or from one of its parts inwards
    values : mapping that contains the place, for the name of the entry
    returns the text; empty for the scene itself
    """
    text = ""
    for step in place:
        text += f"[{step}]" if isinstance(step, int) else f".{step}" if text else str(step)
    if len(place) < 2 or not isinstance(place[1], int):
        return text
    head = f"{place[0]}[{place[1]}]"
    try:
        entry = values[place[0]][place[1]]
        name = entry["name"] if isinstance(entry, Mapping) else entry.name
    except (LookupError, TypeError, AttributeError):
        name = None
    label = f' "{name}"' if isinstance(name, str) and _NAME.fullmatch(name) else ""
    rest = text[len(head) :].removeprefix(".")
    return f"{head}{label}: {rest}" if rest else f"{head}{label}:"


def _refusal(cls, errors, values):
    """SceneError for the first of pydantic's errors."""
    first = errors[0]
    cause = first.get("ctx", {}).get("error")
    is_key = first["loc"][-1:] == ("[key]",)  # after the key itself
    loc = first["loc"][:-1] if is_key else first["loc"]
    path = place_text(loc[:-1], values) + ": a key" if is_key else place_text(loc, values)
    if isinstance(cause, SceneError):  # a whole sentence; its place is relative to `loc`
        place = loc + (cause.place or ())
        path = path if path.endswith(":") or not path else f"{path}:"
        message = f"{path} {cause}".strip()
    else:
        place = loc
        rules = {"dict_type": "must be a mapping {name: value}"}
        if first["type"] == "literal_error":
            rules["literal_error"] = f"must be {first['ctx']['expected']}"
        rule = str(cause) if cause else rules.get(first["type"], f"is refused: {first['msg']}")
        message = f"{path} {rule}, got {shown(first['input'])}".strip()
    if cls.__name__ not in ("Scene", "RobotFile"):
        name = values.get("name")
        label = f' "{name}"' if isinstance(name, str) and _NAME.fullmatch(name) else ""
        message = f"{cls.__name__}{label}: {message}"
    more = f" (and {len(errors) - 1} more)" if len(errors) > 1 else ""
    return SceneError(message + more, place)


class _Refusing(type(BaseModel)):
    """Metaclass: a model that is made from wrong values raises SceneError."""

    def __call__(cls, /, **values):
        try:
            return super().__call__(**values)
        except ValidationError as error:
            refusal = _refusal(cls, error.errors(include_url=False), values)
        raise refusal


class Described(BaseModel, metaclass=_Refusing):
    """Base of all scene models: frozen, checked when made, unknown keys refused."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    @model_validator(mode="before")
    @classmethod
    def _keys(cls, data):
        """Refuse unknown or missing keys, and values that are not a mapping.

        Unknown keys are reported first, because a misspelt key is both unknown and missing.
        """
        if isinstance(data, cls):
            return data
        if not isinstance(data, Mapping):
            raise ValueError(f"must be a mapping with the keys {', '.join(cls.model_fields)}")
        for key in data:
            if key not in cls.model_fields:
                torn = str(key).count(")") > str(key).count("(")  # between braces a comma begins a key
                hint = QUOTE if torn else suggestion(key, list(cls.model_fields))
                raise SceneError(f"unknown key {shown(key)}; {hint}", place=(key,))
        for key, field in cls.model_fields.items():
            if field.is_required() and key not in data:
                raise SceneError(f"{key} is missing: give the {field.description}", place=(key,))
        return data

    def model_copy(self, *, update=None, deep=False):
        """Changed copy, checked like a new one; values are immutable, so `deep` has no effect."""
        return self.remade(**(update or {}))

    def remade(self, leave_out=(), **update):
        """Changed copy, checked like a new one; the keys in leave_out take their defaults."""
        values = {key: getattr(self, key) for key in self.model_fields_set if key not in leave_out}
        return type(self)(**values | update)
