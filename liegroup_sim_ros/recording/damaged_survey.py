# SPDX-License-Identifier: Apache-2.0
"""Survey of an MCAP file: contents, message counts, gaps in sequence numbers, problems.

The file may be truncated, damaged or hostile; it is read once, in bounded memory (damaged_scan.py).
For `info` and `recover`.
"""

import json
import os
import string
from dataclasses import dataclass, field
from pathlib import Path

from mcap.records import Channel, Header, Metadata, Schema

from .damaged_scan import Damage, End, pieces, summary_of
from .errors import RecordingError
from .mcap_records import AttachmentPiece, Block, Damaged

MOST_DEFINITIONS = 8 * 2**20  # bytes of all names and schemas
MOST_EXTRAS = 10_000  # attachments and metadata records
MOST_PROBLEMS = 20  # different problems that are listed
NO_END = (
    "its end is missing: it is still being recorded, the process was killed, the disk was full or the file is truncated"
)
_PARSED = ("settings.json", "initial_state.json")  # attachments that are parsed
_PLAIN = frozenset(string.printable) - frozenset("\t\n\r\x0b\x0c")


@dataclass
class ChannelFigures:
    """Counts of one channel."""

    topic: str
    type: str  # of its messages; empty without a schema
    count: int = 0
    lost: int = 0  # messages missing before the last one, by sequence number
    expected: int | None = None  # next sequence number; None: unknown, or not numbered
    first_ns: int | None = None
    last_ns: int | None = None

    def expect(self, before):
        """Set the last sequence numbers before this file, {topic: number}; None: unknown."""
        if before is not None and self.count == 0:
            self.expected = (before.get(self.topic, 0) + 1) % 2**32

    def add(self, sequence, stamp_ns):
        """Count one message."""
        expected = self.expected
        if expected is not None and sequence != expected:
            # Numbers have 32 bits and wrap around; a smaller one is not a gap.
            ahead = (sequence - expected) % 2**32
            self.lost += ahead if ahead < 2**31 else 0
        # All zero: the writer of the file does not number messages.
        self.expected = (sequence + 1) % 2**32 if sequence or expected else None
        self.count += 1
        if self.first_ns is None:
            self.first_ns = self.last_ns = stamp_ns
        elif stamp_ns > self.last_ns:
            self.last_ns = stamp_ns
        elif stamp_ns < self.first_ns:
            self.first_ns = stamp_ns

    @property
    def rate(self):
        """Messages per second by their stamps, or None."""
        span = self.last_ns - self.first_ns if self.count > 1 else 0
        return (self.count - 1) / (span * 1e-9) if span > 0 else None


@dataclass
class Survey:
    """Contents of a file."""

    path: Path
    size: int  # bytes
    profile: str = ""
    library: str = ""
    schemas: dict = field(default_factory=dict)  # id -> Schema
    channels: dict = field(default_factory=dict)  # id -> Channel
    figures: dict = field(default_factory=dict)  # id -> ChannelFigures
    attachments: list = field(default_factory=list)  # (name, media type, bytes)
    metadata: dict = field(default_factory=dict)  # name -> {key: text}
    contents: dict = field(default_factory=dict)  # name -> parsed JSON of _PARSED
    before: dict | None = None  # topic -> last sequence number before the file; None: unknown
    problems: dict = field(default_factory=dict)  # text -> number of occurrences
    chunks: int = 0
    unfinished: int = 0  # messages from a truncated chunk at the end
    stray: int = 0  # messages of undefined channels
    finished: bool = False  # summary, index and statistics are present

    @property
    def complete(self):
        """Whether the file is finished and undamaged."""
        return self.finished and not self.problems

    @property
    def count(self):
        """Number of messages."""
        return sum(channel.count for channel in self.figures.values())

    @property
    def lost(self):
        """{topic: messages missing by sequence number}."""
        return {channel.topic: channel.lost for channel in self.figures.values() if channel.lost}

    @property
    def stamps(self):
        """(smallest, largest) stamp in ns, zeros without messages."""
        channels = [channel for channel in self.figures.values() if channel.count]
        return (
            (min(channel.first_ns for channel in channels), max(channel.last_ns for channel in channels))
            if channels
            else (0, 0)
        )

    def problem(self, text):
        """Count a problem."""
        text = clean(text)
        if text in self.problems or len(self.problems) < MOST_PROBLEMS:
            self.problems[text] = self.problems.get(text, 0) + 1


def open_file(path):
    """(stream, size) of a file. Raises RecordingError."""
    try:
        stream = open(path, "rb")
    except (OSError, ValueError) as error:  # ValueError: a zero byte in the name
        raise RecordingError(f"{path}: {getattr(error, 'strerror', None) or error}") from None
    if not stream.seekable():
        stream.close()
        raise RecordingError(f"{path}: not a seekable file")
    return stream, stream.seek(0, os.SEEK_END)


def survey(path):
    """Survey of an MCAP file. Raises RecordingError if it cannot be read or is not MCAP."""
    path = Path(path)
    stream, size = open_file(path)
    with stream:
        result = Survey(path, size)
        try:
            walk(stream, result)
        except Damaged as error:
            raise RecordingError(f"{path}: {clean(str(error))}") from None
        except OSError as error:
            raise RecordingError(f"{path}: {error.strerror or error}") from None
    if not result.count and not result.attachments:
        reasons = [text for text in result.problems if text != NO_END]
        raise RecordingError(
            f"{path}: "
            + (
                "an MCAP file without content"
                if result.complete
                else f"has no readable content: {reasons[0]}"
                if reasons
                else "truncated before the first content"
            )
        )
    return result


def walk(stream, result, on_block=None, on_attachment=None, on_metadata=None):
    """Read a file and fill in a Survey; the functions receive each block and record.

    raises Damaged if it is not an MCAP file
    """
    definitions, extras = _Definitions(result), 0
    try:  # the definitions before the messages may be damaged
        for definition in summary_of(stream, result.size).definitions:
            definitions.add(definition)
    except Damaged:
        pass
    for piece in pieces(stream, result.size):
        if isinstance(piece, Block):
            result.chunks += 1
            for definition in piece.definitions:
                definitions.add(definition)
            _count(result, piece, on_block)
        elif isinstance(piece, (AttachmentPiece, Metadata)):
            extras += 1
            if extras > MOST_EXTRAS:
                result.problem(f"more than {MOST_EXTRAS} attachments; the rest is omitted")
            elif isinstance(piece, AttachmentPiece):
                _attachment(result, piece)
                if on_attachment:
                    on_attachment(piece)
            else:
                result.metadata[piece.name] = piece.metadata
                if on_metadata:
                    on_metadata(piece)
        elif isinstance(piece, Damage):
            result.problem(piece.text)
        elif isinstance(piece, Header):
            result.profile, result.library = piece.profile, piece.library
        elif isinstance(piece, End):
            _end(result, piece)
    if result.stray:
        result.problem("messages of an undefined channel")
    if not result.finished:
        result.problem(NO_END)


def _count(result, block, on_block):
    figures, stray = result.figures, 0
    for channel, sequence, stamp_ns, _, _, _ in block.messages():
        try:
            figures[channel].add(sequence, stamp_ns)
        except KeyError:
            stray += 1
    result.stray += stray
    if not block.is_whole:
        result.unfinished += len(block.starts) - stray
    if on_block:
        on_block(block)


def _attachment(result, piece):
    result.attachments.append((piece.name, piece.media_type, len(piece.data)))
    if piece.name in _PARSED and piece.name not in result.contents:
        try:
            content = json.loads(piece.data)
            json.dumps(content, allow_nan=False)
        except (ValueError, RecursionError):
            return  # written by other software
        if isinstance(content, dict) and _is_flat(content):
            result.contents[piece.name] = content
            if piece.name == "settings.json":
                _first_numbers(result, content)


def _is_flat(value, levels=20):
    """Whether a JSON value has at most this many levels."""
    inner = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return levels > 0 and all(_is_flat(entry, levels - 1) for entry in inner)


def _first_numbers(result, settings):
    """Read the last sequence numbers of the previous part from settings.json; default: zeros."""
    if settings.get("format") != 1:
        return
    before = settings.get("sequences")
    result.before = (
        {}
        if not isinstance(before, dict)
        else {topic: number for topic, number in before.items() if isinstance(number, int)}
    )
    for figures in result.figures.values():
        figures.expect(result.before)


def _end(result, end):
    statistics = end.statistics
    if statistics is not None and (
        statistics.message_count != result.count
        or any(
            statistics.channel_message_counts.get(each, 0) != figures.count for each, figures in result.figures.items()
        )
    ):
        result.problem("its statistics contradict its messages")
    result.finished = True


class _Definitions:
    """Adds schemas and channels to a Survey."""

    def __init__(self, found):
        self._found, self._size = found, 0

    def add(self, each):
        found = self._found
        kept = found.schemas if isinstance(each, Schema) else found.channels
        if each.id in kept:
            if kept[each.id] != each:
                found.problem("contradictory definitions of a channel or schema")
            return
        self._size += len(str(each))
        if self._size > MOST_DEFINITIONS:
            raise Damaged(f"its definitions exceed {MOST_DEFINITIONS} bytes")
        kept[each.id] = each
        if isinstance(each, Channel):
            schema = found.schemas.get(each.schema_id)
            figures = ChannelFigures(each.topic, schema.name if schema else "")
            figures.expect(found.before)
            found.figures[each.id] = figures


def clean(text, longest=200):
    """Text without control characters, for a terminal: names in a file are arbitrary bytes."""
    text = "".join(c if c in _PLAIN or c.isprintable() else "\ufffd" for c in text)
    return text if len(text) <= longest else text[: longest - 3] + "..."
