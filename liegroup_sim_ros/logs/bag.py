# SPDX-License-Identifier: Apache-2.0
"""Bags of ROS 2: topics, and numbers of their messages.

Files are read by rosbags: MCAP, SQLite, directories of `ros2 bag record`, definitions of any distribution. It generates
code from the definitions in a bag to decode messages. Here they are interpreted instead (`Decoder`).
"""

import heapq
import re
import sqlite3
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np
from mcap.writer import MCAP0_MAGIC

from liegroup_core.errors import LieGroupSimError
from liegroup_sim_ros.messages.codecs import Fields, MessageError

DEEPEST, MOST_ENTRIES = 20, 10**6
SHOWN = 8
LOOKED_AT = 50  # messages of a topic whose names are listed
GAP_NS = 10**9  # between files of one recording, at most
COMMON = {"/rosout", "/parameter_events", "/clock", "/tf_static", "/robot_description", "/diagnostics"}
FORMS = {"int8": "b", "uint8": "B", "byte": "B", "octet": "B", "char": "B", "bool": "B", "int16": "h", "uint16": "H"}
FORMS |= {"int32": "i", "uint32": "I", "int64": "q", "uint64": "Q", "float32": "f", "float64": "d"}
NAMES = ("name", "names", "joint_names", "interface_names")  # fields that name the entries of the fields beside them
OWN_NAMES = ("child_frame_id", "name")  # fields of an entry that name it
STEP = re.compile(r"([A-Za-z_][A-Za-z0-9_]*)((?:\[[^\[\]]+\])*)")


class BagError(LieGroupSimError):
    """A bag cannot be read, or has not what is wanted; one line of text, exit code 2."""


@dataclass(frozen=True, eq=False)
class TopicMessages:
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
    """Files of a recording that are open.

    topics : {topic: type}
    span   : (first, last) ns at which messages were recorded
    """

    def __init__(self, readers, definitions):
        self._readers, self._decode = readers, Decoder(definitions)
        self.topics = {each.topic: each.msgtype for reader in readers for each in reader.connections}
        self.span = min(each.start_time for each in readers), max(each.end_time for each in readers)

    def messages(self, topic):
        """Messages of a topic, decoded. Raises BagError."""
        return (self._decoded(connection, data) for connection, _, data in self._raw([topic]))

    def names(self, topic, most=LOOKED_AT):
        """Names in the first messages of a topic: of entries of lists. Raises BagError."""
        return names_of(islice(self.messages(topic), most))

    def read(self, wanted):
        """{topic: TopicMessages} of fields {topic: [Field]}. Raises BagError."""
        for topic in wanted:
            if topic not in self.topics:
                raise BagError(f"the bag has no topic {topic}; its topics: {listed(self.topics)}")
        rows = {topic: ([], [], []) for topic in wanted}
        for connection, log_ns, data in self._raw(list(wanted)):
            topic, message = connection.topic, self._decoded(connection, data)
            logs, stamps, values = rows[topic]
            logs.append(log_ns)
            stamps.append(stamp_of(message))
            values.append([number_of(field(message)) for field in wanted[topic]])
        found = {}
        for topic, (logs, stamps, values) in rows.items():
            if not logs:
                raise BagError(f"the bag has no message on {topic}")
            numbers = np.array(values, dtype=float).reshape(len(logs), -1)
            for field, column in zip(wanted[topic], numbers.T):
                if np.isnan(column).all():
                    names = self.names(topic)
                    raise BagError(
                        f"no message on {topic} ({self.topics[topic]}) has a number {field.text}"
                        + (f"; its names: {listed(names)}" if names else "")
                    )
            found[topic] = TopicMessages(np.array(logs, dtype=np.int64), np.array(stamps, dtype=np.int64), numbers)
        return found

    def _raw(self, topics):
        """(connection, log_ns, bytes) of the messages of topics, by time."""
        return heapq.merge(*(_messages(reader, topics) for reader in self._readers), key=lambda each: each[1])

    def _decoded(self, connection, data):
        try:
            return self._decode(connection.msgtype, data)
        except MessageError as error:
            raise BagError(f"{connection.topic}: {error}") from None


def _messages(reader, topics):
    connections = [each for each in reader.connections if each.topic in topics]
    if not connections:  # for rosbags, none means all
        return
    try:
        for connection, log_ns, data in reader.messages(connections=connections):
            yield connection, log_ns, bytes(data)
    except _broken() as error:
        raise BagError(f"{reader.path}: cannot be read further: {_line(error)}{_help(reader.path)}") from None


def listed(names):
    """Some names as text."""
    names = list(names)
    return (", ".join(names[:SHOWN]) or "none") + (f" and {len(names) - SHOWN} more" if len(names) > SHOWN else "")


def number_of(value):
    """A number of a message, NaN for anything else."""
    return float(value) if isinstance(value, (int, float)) else np.nan


def names_of(messages):
    """Names in messages: of entries of lists."""
    found = {}
    for message in messages:
        for key, value in message.items():
            if isinstance(value, list):
                own = value if key in NAMES else [e.get(n) for e in value if isinstance(e, dict) for n in OWN_NAMES]
                found |= dict.fromkeys(each for each in own if isinstance(each, str))
    return list(found)


def stamp_of(message):
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

    from backports.zstd import ZstdError
    from rosbags.rosbag2 import ReaderError
    from rosbags.typesys import TypesysError

    return (
        *(ReaderError, TypesysError, sqlite3.Error, struct.error, zlib.error, OSError, EOFError, MemoryError),
        *(ValueError, KeyError, IndexError, AssertionError, TypeError, AttributeError, RecursionError, OverflowError),
        ZstdError,
    )


def _line(error):
    return " ".join(str(error).split())[:200] or type(error).__name__


def _help(path):
    """What to do with a path that is no readable bag."""
    path = Path(path)
    if path.is_dir() and not (path / "metadata.yaml").exists():
        files = sorted(each.name for each in path.iterdir() if each.suffix in (".mcap", ".db3"))
        return (
            f": it has no metadata.yaml: give its files ({listed(files)}), or run `ros2 bag reindex {path}`"
            if files
            else ": the folder has no metadata.yaml and no *.mcap or *.db3: give a bag"
        )
    for each in sorted(path.glob("*.mcap")) if path.is_dir() else [path]:
        if each.suffix == ".mcap" and each.is_file() and not _has_end(each):
            return f": its end is missing; `liegroup_sim recover {each}` writes what is there to a new file"
    return ""


def _has_end(path):
    with open(path, "rb") as file:
        begins = file.read(len(MCAP0_MAGIC)) == MCAP0_MAGIC
        file.seek(-min(len(MCAP0_MAGIC), path.stat().st_size), 2)
        return not begins or file.read() == MCAP0_MAGIC


def recordings(paths, topics=None):
    """[[path]] of the files of each recording, by time: they go on within 1 s, or have other topics at the same time.

    topics : that count; None: all but those of every recording
    Raises BagError.
    """
    found, groups = [], []
    for path in paths:
        with open_bag(path) as bag:
            found.append((*bag.span, set(bag.topics) & set(topics) if topics else set(bag.topics) - COMMON, path))
    for first, last, own, path in sorted(found, key=lambda each: each[0]):
        for group in groups:
            near = min(GAP_NS, (last - first) // 2)
            begun = [end for _, end, of, _ in group if of & own]
            if first <= max(each[1] for each in group) + GAP_NS and max(begun, default=first) <= first + near:
                group.append((first, last, own, path))
                break
        else:
            groups.append([(first, last, own, path)])
    return [[each[3] for each in group] for group in groups]


@contextmanager
def open_bag(*paths):
    """Bag of the paths of one recording: MCAP or SQLite files, or folders of `ros2 bag record`. Raises BagError."""
    try:
        from rosbags.rosbag2 import Reader
        from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
    except ImportError:
        raise BagError("bags need the package rosbags: pip install liegroup_sim_ros[bags]") from None
    broken, definitions = _broken(), {}
    with ExitStack() as stack:
        readers = []
        for path in paths:
            try:
                reader = Reader(path)
                reader.open()
            except broken as error:
                reason = _help(path) or f" that can be read: {_line(error)}"
                raise BagError(f"{path}: is not a bag{reason}") from None
            readers.append(stack.enter_context(closing(reader)))
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
        yield Bag(readers, get_typestore(Stores.ROS2_JAZZY).fielddefs | definitions)
