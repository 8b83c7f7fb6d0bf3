# SPDX-License-Identifier: Apache-2.0
"""MCAP files written chunk by chunk; packing a message takes about a microsecond.

The library `mcap` encodes all rare records. Its Writer creates an object for each message and
writes it field by field, which costs more than simulating a small scene. Here a message is one
struct and the index of a chunk is one array. test_recording.py reads the files with third-party
readers.

Source: mcap.dev specification, version 0.
"""

import os
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

from .errors import FileLostError
from .mcap_records import RECORD

_MESSAGE = struct.Struct("<BQHIQQ")  # opcode, size, channel, sequence, log and publish time
_MESSAGE_FIELDS = _MESSAGE.size - 9  # without opcode and size
_INDEX = struct.Struct("<BQHI")  # opcode, size, channel, size of the array
_FOOTER_START = struct.Struct("<BQQQ")  # the part of a footer that its checksum covers
_SKIPPED = 0x80  # opcode of a record that readers skip

CHUNK_SIZE = 128 * 1024  # bytes before compression
LARGEST_CHUNK = 2**20  # bytes; beyond them a chunk ends within an instant


class Chunk:
    """Messages packed as in a file. Only one thread at a time may add messages.

    A chunk ends between two instants, so chunks do not overlap in time if the stamps increase
    monotonically. Only an instant with more than LARGEST_CHUNK bytes is divided.

    size, count : bytes before compression, and messages
    limit       : size from which on the chunk ends with the current instant
    index       : {channel id: array of stamp, offset of each message}
    saved       : bytes of the file's tail that this chunk takes the place of
    """

    def __init__(self):
        self.parts, self.size, self.count, self.index = [], 0, 0, {}
        self.limit, self.saved, self._saved, self._last_ns = CHUNK_SIZE, 0, 0, -1

    def unsaved(self):
        """Bytes of the messages since the last call."""
        first, self._saved = self._saved, len(self.parts)  # another thread may add to them now
        return b"".join(self.parts[first : self._saved])

    def ends_before(self, stamp_ns):
        """Whether a message with this stamp belongs in the next chunk; if not, it must be added."""
        return self.size > self.limit and self.may_end_before(stamp_ns)

    def may_end_before(self, stamp_ns):
        """Whether no message has this stamp or a later one; if not, the message must be added."""
        return stamp_ns > self._last_ns or self.size > LARGEST_CHUNK

    def add(self, channel, stamp_ns, data, sequence, publish_ns=None):
        """Append a message. Its log time, and by default its publish time, is the stamp."""
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
        if stamp_ns > self._last_ns:
            self._last_ns = stamp_ns


class UnbufferedFile:
    """A new file without a buffer: data from a completed `write` or `append` survives the process.

    Behind what is written stands a tail, whose place later writes take: messages whose chunk is not finished.
    Between any two calls of the system, the file is a valid beginning of an MCAP file.
    """

    def __init__(self, path):
        self._raw = open(path, "xb", buffering=0)
        self._path, self._end, self._tail = os.path.abspath(path), 0, bytearray()
        self.close = self._raw.close

    def write(self, data, replaced=0):
        """Write all bytes in front of the tail, in place of its first `replaced` bytes, or raise OSError."""
        before = len(self._tail)
        del self._tail[:replaced]
        new = data + self._tail
        unused = before - len(new)
        # A reader skips the rest of the old tail in this record, if the process ends before the next lines.
        self._put(new + (RECORD.pack(_SKIPPED, max(0, unused - RECORD.size)) if unused > 0 else b""), self._end)
        if unused > 0:
            os.ftruncate(self._raw.fileno(), self._end + len(new))
        self._end += len(data)

    def append(self, data):
        """Write all bytes behind the tail, of which they become a part, or raise OSError."""
        self._put(data, self._end + len(self._tail))
        self._tail += data

    def _put(self, data, at):
        self._check_size()
        rest = memoryview(data)
        try:
            while rest:  # the system may accept a part of them and refuse the rest
                taken = os.pwrite(self._raw.fileno(), rest, at)
                at, rest = at + taken, rest[taken:]
        except OSError:
            self._end = at  # what it has accepted; nothing more is written
            raise

    def tell(self):
        """Bytes written so far, without the tail."""
        return self._end

    def check(self):
        """Raise FileLostError unless the file at the path is this one and has all written bytes."""
        try:
            there = os.stat(self._path)
        except (FileNotFoundError, NotADirectoryError):
            raise FileLostError("the file was removed or renamed") from None
        except OSError:  # such as a folder without permission any more: no conclusion
            return
        mine = os.fstat(self._raw.fileno())
        if (there.st_dev, there.st_ino) != (mine.st_dev, mine.st_ino):
            raise FileLostError("the file was replaced by another one")
        self._check_size()

    def _check_size(self):
        size = os.fstat(self._raw.fileno()).st_size
        if size < self._end + len(self._tail):
            raise FileLostError(f"the file was truncated to {size} bytes")


def _bytes_of(record):
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()


class McapFile:
    """An MCAP file under construction: zstd chunks, message index, statistics, checksums.

    stream  : object with write(bytes) and tell(), an UnbufferedFile for `save`; its errors are passed on
    library : name and version of the writer
    """

    def __init__(self, stream, library, profile="ros2"):
        self._stream = stream
        self._compress = zstandard.ZstdCompressor(level=1).compress
        self._schemas, self._channels, self._definitions, self._saved = [], [], bytearray(), 0
        self._chunks, self._attachments, self._metadata = [], [], []
        self.counts = {}  # channel id -> messages
        self._first_ns = self._last_ns = None
        self._checksum = 0  # CRC-32 of all bytes written so far
        self._put(MCAP0_MAGIC)
        self._write(Header(profile, library))

    def _put(self, data, replaced=()):
        """Write bytes; replaced : () or (bytes of the tail of an UnbufferedFile that they take the place of,)."""
        self._checksum = zlib.crc32(data, self._checksum)
        self._stream.write(data, *replaced)

    def _write(self, record):
        """Write one record; returns its offset and length."""
        data, offset = _bytes_of(record), self._stream.tell()
        self._put(data)
        return offset, len(data)

    def _define(self, record):
        """Add a definition to the next chunk, so that a checksum covers it."""
        self._definitions += _bytes_of(record)

    def add_schema(self, name, encoding, data):
        """Add a schema; returns its id."""
        self._schemas.append(Schema(id=len(self._schemas) + 1, data=data, encoding=encoding, name=name))
        self._define(self._schemas[-1])
        return self._schemas[-1].id

    def add_channel(self, topic, encoding, schema, metadata):
        """Add a channel; returns its id."""
        channel = Channel(
            id=len(self._channels) + 1, topic=topic, message_encoding=encoding, schema_id=schema, metadata=metadata
        )
        self._channels.append(channel)
        self.counts[channel.id] = 0
        self._define(channel)
        return channel.id

    def add_attachment(self, create_ns, stamp_ns, name, media_type, data):
        """Add an attachment."""
        offset, length = self._write(
            Attachment(create_time=create_ns, log_time=stamp_ns, name=name, media_type=media_type, data=data)
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
        """Add a metadata record {key: text}."""
        offset, length = self._write(Metadata(name=name, metadata=entries))
        self._metadata.append(MetadataIndex(offset=offset, length=length, name=name))

    @property
    def stamps(self):
        """Smallest and largest stamp in written chunks, ns; zeros without messages."""
        return (0, 0) if self._first_ns is None else (self._first_ns, self._last_ns)

    def save(self, chunk):
        """Write the messages of a chunk so far to the tail of the stream, after all chunks before."""
        if data := chunk.unsaved():
            data = bytes(self._definitions[self._saved :]) + data
            self._stream.append(data)
            self._saved = len(self._definitions)
            chunk.saved += len(data)

    def write_chunk(self, chunk):
        """Write a chunk and its index; an empty chunk is omitted."""
        if not chunk.count:
            return
        front, index = bytes(self._definitions), chunk.index
        if front:
            self._definitions.clear()
            self._saved = 0
            for entries in index.values():
                entries[1::2] = array("Q", [len(front) + offset for offset in entries[1::2]])
        data = front + b"".join(chunk.parts)
        first, last = (edge(edge(entries[::2]) for entries in index.values()) for edge in (min, max))
        compressed = self._compress(data)
        record = _bytes_of(
            ChunkRecord(
                compression="zstd",
                data=compressed,
                message_start_time=first,
                message_end_time=last,
                uncompressed_crc=zlib.crc32(data),
                uncompressed_size=len(data),
            )
        )
        offset, length = self._stream.tell(), len(record)
        start, offsets, parts = offset + length, {}, b""
        for channel, entries in index.items():
            offsets[channel] = start + len(parts)
            size = len(entries) * entries.itemsize
            parts += _INDEX.pack(Opcode.MESSAGE_INDEX, 2 + 4 + size, channel, size)
            parts += struct.pack(f"<{len(entries)}Q", *entries)
        self._put(record + parts, (chunk.saved,) if chunk.saved else ())
        for channel, entries in index.items():
            self.counts[channel] += len(entries) // 2
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
        """Write the summary and the footer."""
        end, (first, last) = _bytes_of(DataEnd(self._checksum)), self.stamps
        start = self._stream.tell() + len(end)
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
                    SummaryOffset(group_opcode=opcode, group_start=start + begin, group_length=summary.count - begin)
                )
        offsets_start = start + summary.count
        for group in groups:
            group.write(summary)
        data = summary.end()
        checksum = zlib.crc32(_FOOTER_START.pack(Opcode.FOOTER, 8 + 8 + 4, start, offsets_start), zlib.crc32(data))
        footer = Footer(summary_start=start, summary_offset_start=offsets_start, summary_crc=checksum)
        self._stream.write(end + data + _bytes_of(footer) + MCAP0_MAGIC)
