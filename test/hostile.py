# SPDX-License-Identifier: Apache-2.0
"""Random hostile expressions, files and messages, and a canary that each of them tries to make."""

import importlib
import math
import re

from scene_files import text_of

# Each runs code, or reads what it must not, if it is evaluated as Python; CANARY is a path.
PRIMITIVES = (
    "().__class__.__base__.__subclasses__()",
    "(lambda: 1)()",
    "(lambda: ().__class__)()",
    "[x for x in ().__class__.__mro__]",
    "list(x.gi_frame for x in [1])",
    "{x: 1 for x in 'ab'}",
    "{x for x in 'ab'}",
    "(y := 1)",
    "f'{1}'",
    "'{0.real}'.format(1)",
    "'{0[0]}'.format('a')",
    "'{x.__class__}'.format_map({'x': 1})",
    "__import__('os').system('touch CANARY')",
    "python.type(1).mro()",
    "xacro.load_yaml.__globals__",
    "str.join.__self__",
    "(1).real.as_integer_ratio",
    "python.vars(xacro).parent.root",
    "python.vars(python.type(python))['__init__']",
)
AROUND = (
    "[{}]",
    "({}, 1)",
    "{{1: {}}}",
    "({} if 1 else 2)",
    "str({})",
    "(1, {})[1]",
    "[1, 2][len(str({})):]",
    "({} == 1)",
    "python.list(python.map(str, [{}]))",
    "max(1, len(str({})))",
    "dict(a={})",
    "(1 and {})",
)


def expression(rng):
    """Text of an expression that must be refused: one of PRIMITIVES, deep in harmless ones."""
    text = PRIMITIVES[rng.integers(len(PRIMITIVES))]
    for _ in range(rng.integers(5)):
        text = AROUND[rng.integers(len(AROUND))].format(text)
    return text


XACRO = text_of("expression.xacro")


def xacro_text(value):
    """A xacro file with this value of a property that names a link."""
    return XACRO % value.replace("&", "&amp;").replace('"', "&quot;").replace("<", "&lt;")


def texts(canary, names=()):
    """Texts that requests may have; names : those of the scene, which are right."""
    return (
        "",
        "a" * 5000,
        "http://[",
        "//[",
        "/proc/self/mem",
        "/proc/self/environ",
        "/dev/zero",
        "/etc/passwd",
        "file:///etc/passwd",
        "file://%00",
        "../../../../../../etc/passwd",
        "package://../../etc/passwd",
        "model://x/../..",
        "(" * 50_000,
        r"(\w+)+!",
        "a{1000}{1000}",
        "[" * 5000,
        "{" * 5000,
        "description: " + "[" * 3000,
        "robot: /etc/passwd",
        f"robot: {canary}.xacro",
        f"!!python/object/apply:os.system ['touch {canary}']",
        "a: &a [1, 1]\nb: &b [*a, *a]\nc: [*b, *b]",
        "&a [*a]",
        "%s%n${1}$(eval 1)",
        "\u2603" * 300,
        "1e308",
        *names,
    )


NUMBERS = (0.0, 1.0, -1.0, 1e308, -1e308, math.nan, math.inf, -math.inf, 5e-324, 1e101, 3.7)
INTEGERS = {"int8": 8, "uint8": 8, "int16": 16, "uint16": 16, "int32": 32, "uint32": 32}
INTEGERS |= {"int64": 64, "uint64": 64, "octet": 8, "byte": 8}


class Messages:
    """Random messages of any type.

    rng   : numpy Generator
    texts : that their fields have
    """

    def __init__(self, rng, texts):
        self._rng, self._texts = rng, texts

    def of(self, message_class):
        """A message of a class."""
        message = message_class()
        for name, kind in message_class.get_fields_and_field_types().items():
            part = getattr(message, name)
            nested = hasattr(part, "get_fields_and_field_types")
            setattr(message, name, self.of(type(part)) if nested else self._value(kind))
        return message

    def _value(self, kind):
        rng = self._rng
        sequence = re.fullmatch(r"sequence<(.*?)(?:, (\d+))?>", kind)
        if sequence:
            return [self._value(sequence[1]) for _ in range(rng.integers(4))]
        array = re.fullmatch(r"(.*)\[(\d+)\]", kind)
        if array:
            return [self._value(array[1]) for _ in range(int(array[2]))]
        if kind.startswith(("string", "wstring")):
            return self._texts[rng.integers(len(self._texts))]
        if kind == "boolean":
            return bool(rng.integers(2))
        if kind in ("double", "float"):
            return NUMBERS[rng.integers(len(NUMBERS))] if kind == "double" else 1.5
        if kind in INTEGERS:
            bits = INTEGERS[kind]
            low, high = (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
            if kind.startswith(("u", "o", "b")):
                low, high = 0, 2**bits - 1
            value = (0, 1, 2, 4, 5, 7, low, high)[rng.integers(8)]
            return bytes([value]) if kind in ("octet", "byte") else value
        package, name = kind.split("/")
        return self.of(getattr(importlib.import_module(f"{package}.msg"), name))
