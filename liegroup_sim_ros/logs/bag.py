# SPDX-License-Identifier: Apache-2.0
"""Bags of ROS 2: topics, and numbers of their messages.

Files are read by rosbags: MCAP, SQLite, directories of `ros2 bag record`, definitions of any distribution. It generates
code from the definitions in a bag to decode messages. Here they are interpreted instead (`Decoder`).
"""

import re
import sqlite3
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from liegroup_core.errors import LieGroupSimError
from liegroup_sim_ros.messages.codecs import Fields, MessageError

DEEPEST, MOST_ENTRIES = 20, 10**6
SHOWN = 8
FORMS = {"int8": "b", "uint8": "B", "byte": "B", "octet": "B", "char": "B", "bool": "B", "int16": "h", "uint16": "H"}
FORMS |= {"int32": "i", "uint32": "I", "int64": "q", "uint64": "Q", "float32": "f", "float64": "d"}
NAMES = ("name", "names", "joint_names", "interface_names")  # fields that name the entries of the fields beside them
OWN_NAMES = ("child_frame_id", "name")  # fields of an entry that name it
STEP = re.compile(r"([A-Za-z_][A-Za-z0-9_]*)((?:\[[^\[\]]+\])*)")


class BagError(LieGroupSimError):
    """A bag cannot be read, or has not what is wanted; one line of text, exit code 2."""


@dataclass(frozen=True, eq=False)
class Messages:
    """Numbers of the messages of one topic.

    log_ns   : (k,) ns at which they were recorded
    stamp_ns : (k,) ns of their headers, 0 without one
    values   : (k, p), NaN where a message has no such entry
    """

    log_ns: np.ndarray
    stamp_ns: np.ndarray
    values: np.ndarray


class Decoder:
    """Interpreter of CDR messages: values as dictionaries, tuples and texts.

    definitions : {type: (constants, fields)} of rosbags
    Raises MessageError for bytes that are not of the type.
    """

    def __init__(self, definitions):
        self._definitions = definitions

    def __call__(self, name, payload):
        """{field: value} of a message."""
        return self._message(Fields(name, payload), name, 0)

    def _message(self, fields, name, depth):
        if name not in self._definitions or depth > DEEPEST:
            raise MessageError(f"{name}: the bag has no usable definition of this type")
        return {key: self._value(fields, kind, depth) for key, kind in self._definitions[name][1]}

    def _value(self, fields, kind, depth):
        node, what = int(kind[0]), kind[1]
        if node == 1:  # a number or a text
            return self._base(fields, what[0])
        if node == 2:
            return self._message(fields, what, depth + 1)
        element, length = what
        count = length if node == 3 else fields.count(MOST_ENTRIES, "entries")
        if int(element[0]) == 1 and element[1][0] in FORMS:
            return fields.numbers(FORMS[element[1][0]], count)
        return [self._value(fields, element, depth) for _ in range(count)]

    @staticmethod
    def _base(fields, kind):
        if kind == "string":
            return fields.text()
        if kind not in FORMS:
            raise MessageError(f"fields of type {kind} cannot be read")
        return fields.number(FORMS[kind])


class Field:
    """Path to a number of a message, such as position[elbow] or wrench.force.x.

    In brackets: an index from 0, or a name that the message has beside the list or in its entries.
    Raises BagError for another text.
    """

    def __init__(self, text):
        self.text, self._steps = text, []
        for part in _parts(text):
            found = STEP.fullmatch(part)
            if found is None:
                raise BagError(f"field {text!r:.80}: give names with dots and brackets, such as position[elbow]")
            self._steps.append(found[1])
            self._steps += [_key(key) for key in re.findall(r"\[([^\[\]]+)\]", found[2])]

    def __call__(self, message):
        """The number, or what else is there; None if there is nothing."""
        value, beside = message, {}
        for step in self._steps:
            if isinstance(step, tuple):
                value = _entry(value, step[0], beside)
            elif isinstance(value, dict) and step in value:
                value, beside = value[step], value
            else:
                return None
        return value


def _parts(text):
    """Parts between dots that are not in brackets."""
    return re.findall(r"(?:[^.\[\]]|\[[^\]]*\]?|\])+", text) if text else []


def _key(text):
    return (int(text) if text.isdigit() and len(text) < 7 else text,)


def _entry(value, key, beside):
    if not isinstance(value, (list, tuple)):
        return None
    if not isinstance(key, int):
        own = [k for k, one in enumerate(value) if isinstance(one, dict) and key in [one.get(n) for n in OWN_NAMES]]
        lists = [beside[name] for name in NAMES if isinstance(beside.get(name), list)]
        found = own or [names.index(key) for names in lists if key in names]
        if not found:
            return None
        key = found[0]
    return value[key] if key < len(value) else None


class Bag:
    """A bag that is open.

    topics : {topic: type}
    """

    def __init__(self, reader, definitions):
        self._reader, self._decode = reader, Decoder(definitions)
        self.topics = {each.topic: each.msgtype for each in reader.connections}

    def first(self, topic, count=1):
        """The first messages of a topic, decoded. Raises BagError."""
        found = []
        for _, data in self._raw([topic]):
            found.append(self._decoded(topic, data[1]))
            if len(found) == count:
                break
        return found

    def read(self, wanted):
        """{topic: Messages} of fields {topic: [Field]}. Raises BagError."""
        for topic in wanted:
            if topic not in self.topics:
                known = ", ".join(list(self.topics)[:SHOWN]) or "none"
                raise BagError(f"the bag has no topic {topic}; its topics: {known}")
        rows = {topic: ([], [], []) for topic in wanted}
        for topic, (log_ns, data) in self._raw(list(wanted)):
            message = self._decoded(topic, data)
            logs, stamps, values = rows[topic]
            logs.append(log_ns)
            stamps.append(_stamp(message))
            values.append([_number(field(message)) for field in wanted[topic]])
        found = {}
        for topic, (logs, stamps, values) in rows.items():
            if not logs:
                raise BagError(f"the bag has no message on {topic}")
            numbers = np.array(values, dtype=float).reshape(len(logs), -1)
            for field, column in zip(wanted[topic], numbers.T):
                if np.isnan(column).all():
                    raise BagError(f"no message on {topic} ({self.topics[topic]}) has a number {field.text}")
            found[topic] = Messages(np.array(logs, dtype=np.int64), np.array(stamps, dtype=np.int64), numbers)
        return found

    def _raw(self, topics):
        connections = [each for each in self._reader.connections if each.topic in topics]
        try:
            for connection, log_ns, data in self._reader.messages(connections=connections):
                yield connection.topic, (log_ns, bytes(data))
        except _broken() as error:
            raise BagError(f"{self._reader.path}: cannot be read further: {_line(error)}") from None

    def _decoded(self, topic, data):
        try:
            return self._decode(self.topics[topic], data)
        except MessageError as error:
            raise BagError(f"{topic}: {error}") from None


def _number(value):
    return float(value) if isinstance(value, (int, float)) else np.nan


def _stamp(message):
    """ns of the header of a message, or of its first part with one; 0 without."""
    for part in (message, *(value[0] for value in message.values() if isinstance(value, list) and value)):
        stamp = part.get("header", {}).get("stamp") if isinstance(part, dict) else None
        if isinstance(stamp, dict):
            return stamp["sec"] * 10**9 + stamp["nanosec"]
    return 0


def _broken():
    """What damaged bags raise."""
    import struct
    import zlib

    from rosbags.rosbag2 import ReaderError
    from rosbags.typesys import TypesysError

    return (
        *(ReaderError, TypesysError, sqlite3.Error, struct.error, zlib.error, OSError, EOFError, MemoryError),
        *(ValueError, KeyError, IndexError, AssertionError, TypeError, AttributeError, RecursionError, OverflowError),
        _zstd_error(),
    )


def _zstd_error():
    from backports import zstd

    return zstd.ZstdError


def _line(error):
    return " ".join(str(error).split())[:200] or type(error).__name__


@contextmanager
def open_bag(path):
    """Bag of a path: an MCAP or SQLite file, or a directory of `ros2 bag record`. Raises BagError."""
    try:
        from rosbags.rosbag2 import Reader
        from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
    except ImportError:
        raise BagError("bags need the package rosbags: pip install liegroup_sim_ros[bags]") from None
    broken = _broken()
    try:
        reader = Reader(path)
        reader.open()
    except broken as error:
        raise BagError(f"{path}: is not a bag that can be read: {_line(error)}") from None
    try:
        definitions = {}
        for each in reader.connections:
            kind, text = each.msgdef.format.name, each.msgdef.data
            try:
                if kind == "MSG":
                    definitions.update(get_types_from_msg(text, each.msgtype))
                elif kind == "IDL":
                    for part in re.split(r"^=+\nIDL: [^\n]*\n", text, flags=re.M):
                        definitions.update(get_types_from_idl(part) if part.strip() else {})
            except broken as error:
                raise BagError(f"{path}: the definition of {each.msgtype} cannot be read: {_line(error)}") from None
        yield Bag(reader, get_typestore(Stores.ROS2_JAZZY).fielddefs | definitions)
    finally:
        reader.close()
