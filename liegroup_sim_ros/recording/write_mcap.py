# SPDX-License-Identifier: Apache-2.0
"""An MCAP file that is written chunk by chunk, with messages packed in about a microsecond each.

The records of the library `mcap` are used for all that is rare. Its Writer makes an object of
every message and writes it field by field, which costs more than simulating a small scene; here a
message is one struct and the index of a chunk one array. test_recorder.py reads the files with the
readers of mcap and of rosbags.

Source: mcap.dev specification, version 0.
"""

import struct
import zlib
from array import array

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.records import Chunk as ChunkRecord
from mcap.writer import MCAP0_MAGIC

_MESSAGE = struct.Struct("<BQHIQQ")  # opcode, size, channel, sequence, log and publish time
_MESSAGE_FIELDS = _MESSAGE.size - 9  # without opcode and size
_INDEX = struct.Struct("<BQHI")  # opcode, size, channel, size of the array
_FOOTER_START = struct.Struct("<BQQQ")  # what its check sum covers of a footer


class Chunk:
    """Messages packed as they will stand in a file; one thread at a time may add.

    size, count : bytes before compression, and messages
    index       : {channel id: array of stamp, offset of each message}
    """

    def __init__(self):
        self.parts, self.size, self.count, self.index = [], 0, 0, {}

    def add(self, channel, stamp_ns, data, sequence, publish_ns=None):
        """A message whose log time, and publish time if none is given, is its stamp."""
        if channel not in self.index:
            self.index[channel] = array("Q")
        self.index[channel].extend((stamp_ns, self.size))
        self.parts += (
            _MESSAGE.pack(
                Opcode.MESSAGE,
                _MESSAGE_FIELDS + len(data),
                channel,
                sequence,
                stamp_ns,
                stamp_ns if publish_ns is None else publish_ns,
            ),
            data,
        )
        self.size += _MESSAGE.size + len(data)
        self.count += 1


class McapFile:
    """A file under construction: zstd, with message index, statistics and check sums.

    stream  : has write(bytes) and tell()
    library : free text, who wrote the file
    Errors of the stream are passed on.
    """

    def __init__(self, stream, library, profile="ros2"):
        self._stream = stream
        self._compress = zstandard.ZstdCompressor(level=1).compress
        self._schemas, self._channels, self._definitions = [], [], bytearray()
        self._chunks, self._attachments, self._metadata = [], [], []
        self.counts = {}  # channel id -> messages
        self._first_ns = self._last_ns = None
        self._checksum = 0  # of all written so far
        self._put(MCAP0_MAGIC)
        self._write(Header(profile, library))

    def _put(self, data):
        self._checksum = zlib.crc32(data, self._checksum)
        self._stream.write(data)

    def _write(self, record):
        """Write one record; (its offset, its length)."""
        builder = RecordBuilder()
        record.write(builder)
        data, offset = builder.end(), self._stream.tell()
        self._put(data)
        return offset, len(data)

    def _define(self, record):
        """Into the next chunk: its check sum covers it, and its readers need no other place."""
        builder = RecordBuilder()
        record.write(builder)
        self._definitions += builder.end()

    def add_schema(self, name, encoding, data):
        """Number of a new schema."""
        self._schemas.append(
            Schema(id=len(self._schemas) + 1, data=data, encoding=encoding, name=name)
        )
        self._define(self._schemas[-1])
        return self._schemas[-1].id

    def add_channel(self, topic, encoding, schema, metadata):
        """Number of a new channel."""
        channel = Channel(
            id=len(self._channels) + 1,
            topic=topic,
            message_encoding=encoding,
            schema_id=schema,
            metadata=metadata,
        )
        self._channels.append(channel)
        self.counts[channel.id] = 0
        self._define(channel)
        return channel.id

    def add_attachment(self, create_ns, stamp_ns, name, media_type, data):
        """A file within the file."""
        offset, length = self._write(
            Attachment(
                create_time=create_ns,
                log_time=stamp_ns,
                name=name,
                media_type=media_type,
                data=data,
            )
        )
        self._attachments.append(
            AttachmentIndex(
                offset=offset,
                length=length,
                create_time=create_ns,
                log_time=stamp_ns,
                data_size=len(data),
                name=name,
                media_type=media_type,
            )
        )

    def add_metadata(self, name, entries):
        """{key: text} under a name."""
        offset, length = self._write(Metadata(name=name, metadata=entries))
        self._metadata.append(MetadataIndex(offset=offset, length=length, name=name))

    @property
    def stamps(self):
        """Least and largest stamp in closed chunks, ns; zeros without messages."""
        return (0, 0) if self._first_ns is None else (self._first_ns, self._last_ns)

    def write_chunk(self, chunk):
        """Write a chunk with its index; nothing for one without a message."""
        if not chunk.count:
            return
        front, index = bytes(self._definitions), chunk.index
        if front:
            self._definitions.clear()
            for each in index.values():
                each[1::2] = array("Q", [len(front) + offset for offset in each[1::2]])
        data = front + b"".join(chunk.parts)
        first, last = (edge(edge(each[::2]) for each in index.values()) for edge in (min, max))
        compressed = self._compress(data)
        offset, length = self._write(
            ChunkRecord(
                compression="zstd",
                data=compressed,
                message_start_time=first,
                message_end_time=last,
                uncompressed_crc=zlib.crc32(data),
                uncompressed_size=len(data),
            )
        )
        start, offsets, parts = offset + length, {}, b""
        for channel, each in index.items():
            offsets[channel] = start + len(parts)
            size = len(each) * each.itemsize
            parts += _INDEX.pack(Opcode.MESSAGE_INDEX, 2 + 4 + size, channel, size)
            parts += struct.pack(f"<{len(each)}Q", *each)
            self.counts[channel] += len(each) // 2
        self._put(parts)
        self._chunks.append(
            ChunkIndex(
                message_start_time=first,
                message_end_time=last,
                chunk_start_offset=offset,
                chunk_length=length,
                message_index_offsets=offsets,
                message_index_length=len(parts),
                compression="zstd",
                compressed_size=len(compressed),
                uncompressed_size=len(data),
            )
        )
        if self._first_ns is None:
            self._first_ns, self._last_ns = first, last
        self._first_ns, self._last_ns = min(self._first_ns, first), max(self._last_ns, last)

    def finish(self):
        """Write the summary and the end."""
        self._write(DataEnd(self._checksum))
        start, (first, last) = self._stream.tell(), self.stamps
        statistics = Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self._channels),
            channel_message_counts=self.counts,
            chunk_count=len(self._chunks),
            message_count=sum(self.counts.values()),
            message_start_time=first,
            message_end_time=last,
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )
        summary, groups = RecordBuilder(), []
        for opcode, records in (
            (Opcode.SCHEMA, self._schemas),
            (Opcode.CHANNEL, self._channels),
            (Opcode.STATISTICS, [statistics]),
            (Opcode.CHUNK_INDEX, self._chunks),
            (Opcode.ATTACHMENT_INDEX, self._attachments),
            (Opcode.METADATA_INDEX, self._metadata),
        ):
            begin = summary.count
            for record in records:
                record.write(summary)
            if records:
                groups.append(
                    SummaryOffset(
                        group_opcode=opcode,
                        group_start=start + begin,
                        group_length=summary.count - begin,
                    )
                )
        offsets_start = start + summary.count
        for group in groups:
            group.write(summary)
        data = summary.end()
        self._stream.write(data)
        checksum = zlib.crc32(
            _FOOTER_START.pack(Opcode.FOOTER, 8 + 8 + 4, start, offsets_start), zlib.crc32(data)
        )
        self._write(
            Footer(summary_start=start, summary_offset_start=offsets_start, summary_crc=checksum)
        )
        self._stream.write(MCAP0_MAGIC)
