# SPDX-License-Identifier: Apache-2.0
"""YAML text of a scene made from a robot, with comments on the origin of each entry."""

import json
import re
from itertools import chain

import numpy as np

INDENT = "    "
_PLAIN = re.compile("[A-Za-z][A-Za-z0-9_]*")


def scene_text(parts):
    """Text of a scene file from SceneParts; numbers read back bit-identical."""
    lines = [
        f"name: {_value(parts.name)}",
        f"description: {json.dumps(parts.description, ensure_ascii=False)}",
        f"gravity: {_value(parts.gravity)}",
    ]
    if parts.assemble:
        lines.append("assemble: true  # the closing joints move the poses below to the nearest ones")
    if parts.notes:
        lines.append("notes:")
        lines += [f"  - {json.dumps(note, ensure_ascii=False)}" for note in parts.notes]
    for key in ("bodies", "joints", "couplings", "forces", "sensors"):
        entries = getattr(parts, key)
        if entries:
            lines.append(f"{key}:")
            lines += chain.from_iterable(_entry(entry, parts.comments.get((key, i))) for i, entry in enumerate(entries))
    if parts.drive:
        lines.append(f"drive: {_value(parts.drive)}")
    return "\n".join(lines) + "\n"


def _entry(entry, comment):
    """Lines of one entry of a list."""
    first = True
    for key, value in entry.items():
        head = "  - " if first else INDENT
        tail = f"  # {_comment(comment)}" if first and comment else ""
        yield f"{head}{key}: {_value(value)}{tail}"
        first = False


def _comment(text):
    """Text of a comment: one line of printable characters."""
    return "".join(c if c.isprintable() else " " for c in text)


def _value(value):
    """YAML of a value on one line."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}: {_value(each)}" for key, each in value.items()) + "}"
    if isinstance(value, str):
        plain = _PLAIN.fullmatch(value) and value.lower() not in ("true", "false", "null")
        return value if plain else json.dumps(value)
    if value is None or isinstance(value, (bool, np.bool_)):
        return {None: "null", True: "true", False: "false"}[value]
    if hasattr(value, "__len__"):
        return "[" + ", ".join(_value(each) for each in value) + "]"
    number = float(value)
    return repr(int(number)) if number == int(number) and abs(number) < 1e15 else repr(number)
