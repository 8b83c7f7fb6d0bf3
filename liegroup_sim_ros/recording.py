# SPDX-License-Identifier: Apache-2.0
"""Read a recording back: what the run was started with, and all that happened in it, as arrays.

The file is read from front to back, chunk by chunk, so one that was never finished (killed
process, full disk) gives everything up to its last flush without being repaired first; `complete`
and `problem` say so. Damaged chunks are skipped and told; `lost` counts what is missing by
sequence number. No ROS is needed. Every failure is a RecordingError, one line of text.
"""

import json
import struct
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import NamedTuple

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Schema
from mcap.records import Message as McapMessage
from mcap.stream_reader import StreamReader, get_chunk_data_stream
from mcap.writer import MCAP0_MAGIC
from mcap_ros2.decoder import DecoderFactory

from liegroup_sim_ros.messages import (MessageError, PoseStampedCodec, TwistStampedCodec,
                                       WrenchStampedCodec)

FORMAT = 1                      # of settings.json and all that goes with it

_RECORD = struct.Struct("<BQ")          # opcode, size of what follows
_MESSAGE = struct.Struct("<HIQQ")       # channel, sequence, log time, publish time


class RecordingError(Exception):
    """The file is not a recording that can be read; one line of text, exit code 2."""


class PoseTrack(NamedTuple):
    stamp_ns: np.ndarray        # (n,) int64, ns
    position: np.ndarray        # (n, 3) m, world
    quaternion: np.ndarray      # (n, 4) x, y, z, w, body -> world
    payloads: list              # n serialized messages, for comparing bits


class TwistTrack(NamedTuple):
    stamp_ns: np.ndarray        # (n,) int64, ns
    twist: np.ndarray           # (n, 6) (omega, v), rad/s and m/s, body axes
    payloads: list              # n serialized messages


class AppliedWrench(NamedTuple):
    stamp_ns: int
    body: str
    wrench: tuple               # (6,) (torque, force), body axes: the total from stamp_ns on


class Event(NamedTuple):
    stamp_ns: int
    name: str                   # "start", "pause", "resume", "reset", "step", "fault", "stop", ...
    text: str


@dataclass(frozen=True)
class Recording:
    path: Path
    scene_text: str
    settings: dict              # settings.json
    initial_state: dict         # initial_state.json
    pacing: dict | None         # pacing.json; None if the run did not come to its end
    bodies: tuple               # names, in the order of initial_state
    pose: dict                  # {body: PoseTrack}
    twist: dict                 # {body: TwistTrack}
    applied_wrench: list        # AppliedWrench
    events: list                # Event
    diagnostics: list           # (stamp_ns, {key: text}), all statuses of an array together
    topics: dict                # {topic: message count}
    complete: bool              # the file was finished and no part of it is damaged
    lost: dict                  # {topic: messages missing by sequence number}; empty if none
    problem: str | None         # None or one line for the user


def read_recording(path):
    """Recording in a *.mcap file. Raises RecordingError."""
    path = Path(path)
    try:
        content = _read_file(path)
        settings = content.json("settings.json")
        if settings.get("format") != FORMAT:
            raise RecordingError(f"it has format {settings.get('format')}, this version reads "
                                 f"format {FORMAT}")
        initial_state = content.json("initial_state.json")
        pacing = content.json("pacing.json") if "pacing.json" in content.attachments else None
        bodies, topics = tuple(initial_state["bodies"]), settings["topics"]
        lost = {channel.topic: channel.lost() for channel in content.channels.values()}
        return Recording(
            path=path, scene_text=content.attachment("scene.yaml").decode(), settings=settings,
            initial_state=initial_state, pacing=pacing, bodies=bodies,
            pose={body: _pose_track(content, topics["pose"][body]) for body in bodies},
            twist={body: _twist_track(content, topics["twist"][body]) for body in bodies},
            applied_wrench=_applied_wrenches(content, topics["applied_wrench"]),
            events=[Event(_stamp_ns(log.stamp), log.name, log.msg)
                    for log in content.decoded(topics["events"])],
            diagnostics=[(_stamp_ns(array.header.stamp),
                          {pair.key: pair.value
                           for status in array.status for pair in status.values})
                         for array in content.decoded(topics["diagnostics"])],
            topics={channel.topic: len(channel.payloads)
                    for channel in content.channels.values()},
            complete=content.problem is None,
            lost={topic: count for topic, count in lost.items() if count},
            problem=content.problem and f"{path}: {content.problem}")
    except RecordingError as error:
        raise RecordingError(f"{path}: {error}") from None
    except MessageError as error:
        raise RecordingError(f"{path}: damaged message: {error}") from None
    except (KeyError, AttributeError, TypeError, UnicodeDecodeError) as error:
        raise RecordingError(f"{path}: its settings or initial state lack an entry: {error!r}"
                             ) from None
    except OSError as error:
        raise RecordingError(f"{path}: {error.strerror or error}") from None


def _pose_track(content, topic):
    payloads = content.payloads(topic)
    poses = PoseStampedCodec.decode(payloads)
    return PoseTrack(poses.stamp_ns, poses.position, poses.quaternion, payloads)


def _twist_track(content, topic):
    payloads = content.payloads(topic)
    twists = TwistStampedCodec.decode(payloads)
    return TwistTrack(twists.stamp_ns, twists.twist, payloads)


def _applied_wrenches(content, topic):
    decoded = WrenchStampedCodec.decode(content.payloads(topic))
    return [AppliedWrench(stamp_ns, body, tuple(wrench)) for stamp_ns, body, wrench
            in zip(decoded.stamp_ns.tolist(), decoded.frame_id, decoded.wrench.tolist())]


def _stamp_ns(stamp):
    return stamp.sec * 1_000_000_000 + stamp.nanosec


class _ChannelContent:
    """One channel of the file: its messages in file order."""

    def __init__(self, channel, schema):
        self.topic = channel.topic
        self.encoding = channel.message_encoding
        self.schema = schema
        self.payloads = []
        self.sequences = []

    def lost(self):
        """Messages missing before the last one there is; sequences count from 1, or are all 0."""
        return max(0, max(self.sequences, default=0) - len(set(self.sequences)))


class _Content:
    """What is in the file, not yet interpreted."""

    def __init__(self):
        self.attachments = {}
        self.channels = {}      # channel id -> _ChannelContent
        self.schemas = {}       # schema id -> Schema
        self.problem = None

    def attachment(self, name):
        if name not in self.attachments:
            raise RecordingError(self.problem if self.problem and not self.attachments else
                                 f'no attachment "{name}": not a recording of this simulator')
        return self.attachments[name]

    def json(self, name):
        try:
            return json.loads(self.attachment(name))
        except ValueError as error:
            raise RecordingError(f'its attachment "{name}" is damaged: {error}') from None

    def payloads(self, topic):
        return [payload for channel in self.channels.values() if channel.topic == topic
                for payload in channel.payloads]

    def decoded(self, topic):
        """Messages of any type, by the definition in the file. Slow; for the rare ones."""
        for channel in self.channels.values():
            if channel.topic == topic:
                decode = DecoderFactory().decoder_for(channel.encoding, channel.schema)
                if decode is None:
                    raise RecordingError(f"{topic}: its messages are not CDR with a ros2msg "
                                         f"definition")
                for payload in channel.payloads:
                    try:
                        yield decode(payload)
                    except Exception as error:  # damaged bytes can make a decoder raise anything
                        raise RecordingError(f"{topic}: damaged message: {error}") from None

    def add(self, record):
        if isinstance(record, Schema):
            self.schemas[record.id] = record
        elif isinstance(record, Channel):
            self.channels.setdefault(
                record.id, _ChannelContent(record, self.schemas.get(record.schema_id)))
        elif isinstance(record, Attachment):
            self.attachments[record.name] = record.data
        elif isinstance(record, McapMessage):
            self.add_message(record.channel_id, record.sequence, record.data)

    def add_message(self, channel_id, sequence, payload):
        channel = self.channels[channel_id]
        channel.payloads.append(payload)
        channel.sequences.append(sequence)

    def add_chunk(self, chunk):
        stream, size = get_chunk_data_stream(chunk, validate_crc=True)
        data, at = stream.read(size), 0
        while at < size:
            opcode, length = _RECORD.unpack_from(data, at)
            at += _RECORD.size
            if opcode == Opcode.MESSAGE:        # most of the time of reading is spent here
                channel_id, sequence, _, _ = _MESSAGE.unpack_from(data, at)
                self.add_message(channel_id, sequence, data[at + _MESSAGE.size:at + length])
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                kind = Schema if opcode == Opcode.SCHEMA else Channel
                self.add(kind.read(ReadDataStream(BytesIO(data[at:at + length]))))
            at += length


def _read_file(path):
    """_Content of the file, as far as it can be read."""
    content = _Content()
    damaged = 0
    with open(path, "rb") as stream:
        if stream.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
            raise RecordingError("not an MCAP file")
        stream.seek(0)
        try:
            for record in StreamReader(stream, emit_chunks=True,
                                       record_size_limit=path.stat().st_size).records:
                if isinstance(record, Chunk):
                    try:
                        content.add_chunk(record)
                    except Exception:  # damaged bytes can make a decompressor raise anything
                        damaged += 1
                else:
                    content.add(record)
        except Exception:  # likewise: the stream ends inside a record, or in garbage
            content.problem = ("not finished, the run was ended hard or the disk was full; "
                               "everything up to the last flush is read")
    if damaged:
        content.problem = f"{damaged} damaged chunk(s) skipped" + (
            f"; {content.problem}" if content.problem else "")
    if content.problem and not content.attachments:
        content.problem = "ends before anything was written to it"
    return content
