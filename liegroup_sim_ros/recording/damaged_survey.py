# SPDX-License-Identifier: Apache-2.0
"""Survey of an MCAP file: contents, message counts, gaps in sequence numbers, problems.

The file may be truncated, damaged or hostile; it is read once, in bounded memory (walk.py).
For `info` and `recover`.
"""

import json
import os
from dataclasses import dataclass, field
from pathlib import Path

from mcap.records import Attachment, Header, Metadata

from .errors import RecordingError
from .mcap_records import Damaged
from .walk import Tally, Walk, clean

NO_END = (
    "its end is missing: it is still being recorded, the process was killed, the disk was full or the file is truncated"
)
_PARSED = ("settings.json", "initial_state.json")  # attachments that are parsed


@dataclass
class Survey:
    """Contents of a file."""

    path: Path
    size: int  # bytes
    header: Header
    channels: dict  # id -> Channel
    problems: dict  # text -> number of occurrences
    tallies: dict = field(default_factory=dict)  # id -> Tally
    attachments: list = field(default_factory=list)  # (name, media type, bytes)
    metadata: dict = field(default_factory=dict)  # name -> {key: text}
    contents: dict = field(default_factory=dict)  # name -> parsed JSON of _PARSED
    unfinished: int = 0  # messages from a truncated chunk at the end
    finished: bool = False  # summary, index and statistics are present

    @property
    def complete(self):
        """Whether the file is finished and undamaged."""
        return self.finished and not self.problems

    @property
    def count(self):
        """Number of messages."""
        return sum(tally.count for tally in self.tallies.values())

    @property
    def figures(self):
        """[(Channel, Tally, messages missing by sequence number)] by topic."""
        settings = self.contents.get("settings.json", {})
        before = settings.get("sequences")
        before = before if isinstance(before, dict) else {}
        start = 0 if settings.get("format") == 1 else None  # other software may not number messages
        found = []
        for number, channel in self.channels.items():
            tally, last = self.tallies.get(number, Tally()), before.get(channel.topic)
            found.append((channel, tally, tally.lost(last if isinstance(last, int) else start)))
        return sorted(found, key=lambda each: each[0].topic)

    @property
    def lost(self):
        """{topic: messages missing by sequence number}."""
        return {channel.topic: lost for channel, _, lost in self.figures if lost}

    @property
    def stamps(self):
        """(smallest, largest) stamp in ns, zeros without messages."""
        found = [(tally.first_ns, tally.last_ns) for tally in self.tallies.values()]
        return (min(first for first, _ in found), max(last for _, last in found)) if found else (0, 0)


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
        try:
            result = _survey(path, Walk(stream, size, is_thorough=True), size)
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


def _survey(path, walk, size):
    result, stray = Survey(path, size, walk.header, walk.channels, walk.problems), False
    for item in walk:
        if isinstance(item, Attachment):
            result.attachments.append((item.name, item.media_type, len(item.data)))
            if item.name in _PARSED and item.name not in result.contents:
                result.contents |= _parsed(item)
        elif isinstance(item, Metadata):
            result.metadata[item.name] = item.metadata
        else:
            for number, index in item.by_channel():
                if number in walk.channels:
                    result.tallies.setdefault(number, Tally()).add(item.sequence[index], item.log_time[index])
                    result.unfinished += 0 if item.is_whole else len(index)
                else:
                    stray = True
    result.header, result.finished, statistics = walk.header, walk.finished, walk.statistics
    counts = {number: tally.count for number, tally in result.tallies.items()}
    if statistics is not None and (
        statistics.message_count != result.count
        or any(statistics.channel_message_counts.get(number, 0) != counts.get(number, 0) for number in walk.channels)
    ):
        walk.problem("its statistics contradict its messages")
    if stray:
        walk.problem("messages of an undefined channel")
    if not result.finished:
        walk.problem(NO_END)
    return result


def _parsed(piece):
    """{name: content} of an attachment with a JSON object; {} if other software wrote another content."""
    try:
        content = json.loads(piece.data)
        json.dumps(content, allow_nan=False)
    except (ValueError, RecursionError):
        return {}
    return {piece.name: content} if isinstance(content, dict) and _is_flat(content) else {}


def _is_flat(value, levels=20):
    """Whether a JSON value has at most this many levels."""
    inner = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return levels > 0 and all(_is_flat(entry, levels - 1) for entry in inner)
