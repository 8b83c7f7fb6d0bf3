# SPDX-License-Identifier: Apache-2.0
"""One pass over the file of a recording: attachments, rare messages, counts, missing messages."""

import json
from pathlib import Path

import numpy as np
from mcap.records import Attachment

from liegroup_sim_ros.messages import diagnostics, inputs, joint_modes
from liegroup_sim_ros.messages.codecs import LogCodec, MessageError, WrenchStampedCodec, decode_rows
from liegroup_sim_ros.messages.commands import JointStateDecoder, decode_motions

from . import old_inputs
from .addresses import fetch, is_remote
from .checkpoints import stamp_of
from .errors import AddressError, RecordingError
from .input_track import KINDS, InputTrack
from .mcap_records import RECORD, Damaged, attachment_of
from .tracks import Event
from .walk import ChunkMessages, Tally, Walk

MOST_EVENTS = 10**6  # limit of events and of diagnostics; a run has about one a second


class ErrorsWithPath:
    """Context that converts all errors of reading to a RecordingError that begins with the path."""

    def __init__(self, path):
        self._path = path

    def __enter__(self):
        return self

    def __exit__(self, kind, error, _):
        if isinstance(error, AddressError):
            raise RecordingError(str(error)) from None
        if isinstance(error, (RecordingError, Damaged)):
            text = str(error)
            raise RecordingError(text if text.startswith(f"{self._path}: ") else f"{self._path}: {text}") from None
        if isinstance(error, MessageError):
            raise RecordingError(f"{self._path}: damaged message: {error}") from None
        if isinstance(error, OSError):
            raise RecordingError(f"{self._path}: {error.strerror or error}") from None
        if isinstance(error, (KeyError, AttributeError, TypeError, UnicodeDecodeError)):
            raise RecordingError(f"{self._path}: its settings or initial state lack an entry: {error!r:.120}") from None


class Attachments:
    """Attachments by name."""

    def __init__(self, found, stream):
        self._found, self._stream = found, stream

    def __getitem__(self, name):
        if name not in self._found:
            stream = self._stream
            raise RecordingError(
                f"damaged: {next(iter(stream.problems))}"
                if stream.problems
                else "truncated before the first attachment"
                if not (self._found or stream.finished)
                else f'no attachment "{name}": not a recording of this simulator'
            )
        return self._found[name]

    def json(self, name):
        try:
            data = json.loads(self[name])
        except (ValueError, RecursionError) as error:
            raise RecordingError(f'its attachment "{name}" is damaged: {error}') from None
        if not isinstance(data, dict):
            raise RecordingError(f'its attachment "{name}" is damaged: it is not a JSON object')
        return data


class RecordingBytes:
    """The bytes of a recording, which can be read several times."""

    def __init__(self, path):
        self._copy = fetch(path) if is_remote(path) else None
        self.path = Path(self._copy.name) if self._copy else path
        with open(self.path, "rb") as file:
            self.size = file.seek(0, 2)  # the file may grow while it is read

    def attachments(self):
        """({name: bytes}, Walk) without the checkpoints; chunks are not decompressed."""
        found, self._checkpoints = {}, {}
        with open(self.path, "rb") as file:
            stream = Walk(file, self.size, wanted=lambda *_: False)
            for item in stream:
                if isinstance(item, Attachment):
                    stamp = stamp_of(item.name)
                    if stamp is None:
                        found.setdefault(item.name, item.data)
                    else:
                        self._checkpoints.setdefault(stamp, stream.offset)
        return found, stream

    @property
    def checkpoints(self):
        """Stamps of the checkpoints in ns, sorted."""
        return sorted(self._checkpoints)

    def checkpoint(self, stamp):
        """Entries of the checkpoint with a stamp, a dict. Raises RecordingError."""
        with open(self.path, "rb") as file:
            file.seek(self._checkpoints[stamp])
            _, length = RECORD.unpack(file.read(RECORD.size))
            piece = attachment_of(file.read(length))
        return Attachments({piece.name: piece.data}, None).json(piece.name)

    def messages(self):
        """(ChunkMessages, [(Channel, indices of its messages)]) of each chunk; `stream` is the reader."""
        with open(self.path, "rb") as file:
            self.stream = stream = Walk(file, self.size)
            last_ns = 0
            for item in stream:
                if isinstance(item, ChunkMessages) and item.is_whole:
                    # Damage may repeat or exchange chunks, which otherwise do not overlap.
                    if stream.problems and item.log_time.min() < last_ns:
                        stream.problem("messages that are earlier than those before")
                        continue
                    last_ns = max(last_ns, int(item.log_time.max()))
                    parts = item.by_channel()
                    yield item, [(stream.channels[k], index) for k, index in parts if k in stream.channels]


class Scan:
    """One pass over a file: events, diagnostics, wrenches, counts and the last stamp in ns."""

    def __init__(self, source, settings, bodies):
        topics, before = settings["topics"], settings.get("sequences")
        self._before = before if isinstance(before, dict) else {}  # of the previous part
        self.events, self.diagnostics = [], []
        self.last_ns = 0
        self._tallies = {}  # channel id -> Tally
        self.inputs = InputTrack()
        prefix, world = settings.get("frame_prefix", ""), settings.get("world_frame", "world")
        self._frames = old_inputs.frames(bodies, prefix, world)
        self.servo_targets = []  # (stamp_ns, names, positions, velocities)
        self.motions, self.joint_modes = [], []  # (stamp_ns, names, numbers)
        joint_states = JointStateDecoder()
        # Functions (log time, payload) of the topics that are read here.
        take = {
            topics["events"]: lambda _, data: self.events.append(_event(data)),
            topics["diagnostics"]: lambda _, data: self.diagnostics.append(diagnostics.decode(data)),
            topics.get("inputs"): self._add_inputs,
            topics.get("applied_wrench"): self._add_total,
            topics.get("servo_targets"): lambda _, data: self.servo_targets.append(
                joint_states.decode(data).complete()[:4]
            ),
            topics.get("joint_modes"): lambda ns, data: self.joint_modes.append((ns, *joint_modes.decode(data))),
            topics.get("motions"): lambda ns, data: self.motions.append((ns, *decode_motions(data))),
        }
        for messages, channels in source.messages():
            self.last_ns = max(self.last_ns, int(messages.log_time.max()))
            for channel, index in channels:
                self._tallies.setdefault(channel.id, Tally()).add(messages.sequence[index], messages.log_time[index])
                if channel.topic in take:
                    for k in index:
                        take[channel.topic](int(messages.log_time[k]), messages.payload(k))
            if max(len(self.events), len(self.diagnostics)) > MOST_EVENTS:
                raise RecordingError(f"contains more than {MOST_EVENTS} events or diagnostics")
        self.channels = source.stream.channels
        self._written = None  # {channel id: number of messages} by a summary
        if source.stream.statistics and source.stream.finished:
            self._written = source.stream.statistics.channel_message_counts

    def _add_inputs(self, log_ns, payload):
        base_ns, commands = inputs.decode(payload)
        for command in commands:
            if command.kind not in KINDS:
                raise RecordingError(f"its inputs contain a command of the kind {command.kind!r:.40}")
            self._add(log_ns, base_ns, command)

    def _add_total(self, _, payload):
        """Add a total wrench of a recording up to version 0.2."""
        stamp, frame, wrench = WrenchStampedCodec.decode_one(payload)
        if frame not in self._frames:
            raise RecordingError(f"a wrench acts on {frame!r:.60}, which is not a body of the scene")
        for command in old_inputs.commands(*self._frames[frame], wrench):
            self._add(stamp, stamp, command)

    def _add(self, stamp_ns, base_ns, command):
        try:
            self.inputs.add(stamp_ns, base_ns, command)
        except OverflowError:
            raise RecordingError("the stamps of its inputs are out of range") from None

    def counts(self):
        """{topic: number of messages}."""
        result = {}
        for channel in self.channels.values():
            result[channel.topic] = result.get(channel.topic, 0) + self._tally(channel).count
        return result

    def lost(self):
        """{topic: missing messages}: sequence numbers begin with 1, continue those of the previous part, or are 0."""
        result = {}
        for channel in self.channels.values():
            tally, before = self._tally(channel), self._before.get(channel.topic)
            absent = 0 if self._written is None else self._written.get(channel.id, 0) - tally.count
            result[channel.topic] = max(tally.lost(before if isinstance(before, int) else 0), absent)
        return result

    def _tally(self, channel):
        return self._tallies.get(channel.id) or Tally()

    def problem(self, source, attachments):
        """Problems of the file as one line of text, or None."""
        stream, problems = source.stream, []
        if stream.problems:
            texts = list(stream.problems)[:5]
            problems.append(f"{sum(stream.problems.values())} damaged part(s) skipped: {', '.join(texts)}")
        if not stream.finished:
            problems.append(
                "not finished: it is still being recorded, the process was killed or the "
                "disk was full; it is read up to the last flush"
            )
        elif stream.statistics is None:
            problems.append("it has no summary")
        elif any(self._tally(each).count != self._written.get(each.id, 0) for each in self.channels.values()):
            problems.append("the number of messages differs from its summary")
        elif len(attachments) + len(source.checkpoints) < stream.statistics.attachment_count:
            problems.append("an attachment is missing")
        return "; ".join(problems) or None


def _event(payload):
    stamp_ns, _, name, text = LogCodec.decode_one(payload)
    return Event(stamp_ns, name, text)


def decode(codec, messages, index):
    """Results of decode_rows for runs of messages of one size, in file order."""
    for part in of_one_size(messages, index):
        yield decode_rows(codec, messages.rows(part))


def of_one_size(messages, index):
    """Parts of the indices: runs of messages of one size."""
    return np.split(index, np.flatnonzero(np.diff(messages.size[index])) + 1)
