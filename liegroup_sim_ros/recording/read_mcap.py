# SPDX-License-Identifier: Apache-2.0
"""Sequential reader of MCAP files that returns the messages of a chunk as arrays.

The file is not trusted: every length is checked before anything of that size is read, decompressed
or allocated, and all checksums of the format are compared. Damaged chunks are skipped and reported.
Memory is bounded by one chunk, time is linear in the size of the file. An unfinished file is read up
to its last closed chunk.

The library `mcap` creates an object per message, about 5 us. Here a compiled loop finds the
messages of a chunk, about 10 ns each (benchmarks/recording_analysis.py).

Source: mcap.dev specification, version 0.
"""

from typing import NamedTuple

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Channel as ChannelRecord
from mcap.records import Schema, Statistics
from mcap.writer import MCAP0_MAGIC

from liegroup_core.compiling import subroutine

from .mcap_records import (
    GROWS,
    LARGEST,
    LARGEST_RATIO,
    RECORD,
    Damaged,
    attachment_of,
    check_claim,
    chunk_data,
    chunk_head,
    parsed,
    read_magic,
)

# Messages outside of chunks are collected into pieces of this size.
PIECE = 2**20  # bytes

_CHUNK_HEAD = 56  # bytes, at most
_MESSAGE_START = 22  # bytes of a message before its data
_READ = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.CHUNK, Opcode.ATTACHMENT, Opcode.STATISTICS)


class Channel(NamedTuple):
    id: int
    topic: str
    encoding: str
    type: str  # name of its schema
    schema: bytes  # text of the schema
    metadata: dict


class Messages(NamedTuple):
    """The messages of a chunk, in file order."""

    data: np.ndarray  # (bytes,) uint8, the decompressed chunk
    channel: np.ndarray  # (m,) channel id
    sequence: np.ndarray  # (m,)
    log_time: np.ndarray  # (m,) ns
    start: np.ndarray  # (m,) offset of the payload in data
    size: np.ndarray  # (m,) bytes of the payload

    def payload(self, k):
        """Bytes of message k."""
        return self.data[self.start[k] : self.start[k] + self.size[k]].tobytes()

    def rows(self, index):
        """(len(index), size) uint8: payloads of messages of one size."""
        size = int(self.size[index[0]])
        return self.data[self.start[index][:, None] + np.arange(size)]


@subroutine
def _find_messages(data, channel, sequence, log_time, start, size, other):
    """Fill the arrays; returns (number of messages, of other records, bytes read).

    other : (., 3) opcode, start and size of every record that is not a message
    """
    at, end, found, others = 0, len(data), 0, 0
    while at + 9 <= end:
        opcode = data[at]
        length = 0
        for k in range(4):
            length |= np.int64(data[at + 1 + k]) << (8 * k)
        if data[at + 5] | data[at + 6] | data[at + 7] | data[at + 8]:
            break
        at += 9
        if length > end - at:
            break
        if opcode == 5:
            if length < 22:
                break
            channel[found] = np.int64(data[at]) | np.int64(data[at + 1]) << 8
            number = np.int64(0)
            for k in range(4):
                number |= np.int64(data[at + 2 + k]) << (8 * k)
            sequence[found] = number
            time = np.int64(0)
            for k in range(8):
                time |= np.int64(data[at + 6 + k]) << (8 * k)
            log_time[found] = time
            start[found] = at + 22
            size[found] = length - 22
            found += 1
        else:
            other[others, 0] = opcode
            other[others, 1] = at
            other[others, 2] = length
            others += 1
        at += length
    return found, others, at


class McapStream:
    """One pass over a file: `for item in stream` yields AttachmentPiece and Messages.

    file   : seekable binary file
    size   : bytes to read
    wanted : function (offset, start_ns, end_ns) -> whether to read a chunk; None: all chunks

    During and after the pass: `channels` {id: Channel}; `finished` whether the end of the file is
    intact; `damaged` number of skipped parts and `remarks` on them; `statistics` {channel id:
    message count} of the summary or None; `attachments_indexed` number of attachments in the summary
    or None; `offset` of the record of the last item.
    """

    def __init__(self, file, size, wanted=None):
        self._file, self._size, self._wanted = file, size, wanted
        self.channels, self._schemas = {}, {}
        self.finished, self.damaged, self.remarks = False, 0, []
        self.statistics = self.attachments_indexed = None
        self.offset = 0  # of the record that the last item came from
        self._loose = bytearray()
        self._budget = LARGEST + LARGEST_RATIO * size

    def __iter__(self):
        file = self._file
        file.seek(0)
        read_magic(file)
        at = len(MCAP0_MAGIC)
        while True:
            head = file.read(RECORD.size)
            if len(head) < RECORD.size:
                break
            opcode, length = RECORD.unpack(head)
            at += RECORD.size
            if opcode == 0 or length > self._size - at:
                break
            if opcode == Opcode.FOOTER:
                self.finished = (
                    length == 20 and len(file.read(20)) == 20 and (file.read(len(MCAP0_MAGIC)) == MCAP0_MAGIC)
                )
                break
            if opcode == Opcode.MESSAGE:
                self._loose += head + file.read(length)
                if len(self._loose) > PIECE:
                    yield from self._loose_messages()
            else:
                yield from self._loose_messages()
                yield from self._take(opcode, length, at)
            at += length
            file.seek(at)
        yield from self._loose_messages()

    def _loose_messages(self):
        if self._loose:
            data = np.frombuffer(bytes(self._loose), dtype=np.uint8)
            self._loose.clear()
            yield self._messages(data)

    def _take(self, opcode, length, at):
        self.offset = at
        if opcode not in _READ:
            return
        if length > LARGEST:
            self._skip(f"a record of {length} bytes; the limit is {LARGEST}")
            return
        try:
            if opcode == Opcode.CHUNK:
                found = self._chunk(length, at)
                if found is not None:
                    yield found
                return
            data = self._file.read(length)
            if opcode == Opcode.ATTACHMENT:
                yield attachment_of(data)
            elif opcode == Opcode.STATISTICS:
                statistics = parsed(Statistics, data)
                self.statistics = statistics.channel_message_counts
                self.attachments_indexed = statistics.attachment_count
            else:
                self._take_names(opcode, data)
        except Damaged as damage:
            self._skip(str(damage))

    def _skip(self, remark):
        self.damaged += 1
        if remark not in self.remarks and len(self.remarks) < 5:
            self.remarks.append(remark)

    def _chunk(self, length, at):
        """Messages of the chunk at an offset, or None if `wanted` rejects it."""
        body = self._file.read(min(length, _CHUNK_HEAD))
        head = chunk_head(body)
        if head.data_start + head.length != length:
            raise Damaged("a chunk with a damaged head")
        check_claim(head)
        self._budget -= head.size
        if self._budget < 0:
            raise Damaged(GROWS)
        if self._wanted is not None and not self._wanted(at, head.first_ns, head.last_ns):
            return None
        body += self._file.read(length - len(body))
        return self._messages(np.frombuffer(chunk_data(head, memoryview(body)[head.data_start :]), dtype=np.uint8))

    def _messages(self, data):
        room = len(data) // (RECORD.size + _MESSAGE_START) + 1
        channel, sequence, log_time, start, size = np.empty((5, room), dtype=np.int64)
        other = np.empty((len(data) // RECORD.size + 1, 3), dtype=np.int64)
        found, others, walked = _find_messages(data, channel, sequence, log_time, start, size, other)
        for opcode, begin, length in other[:others].tolist():
            if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._take_names(opcode, data[begin : begin + length].tobytes())
        if walked != len(data):
            self._skip("a chunk with inconsistent record lengths")
        return Messages(data, channel[:found], sequence[:found], log_time[:found], start[:found], size[:found])

    def _take_names(self, opcode, data):
        if opcode == Opcode.SCHEMA:
            schema = parsed(Schema, data)
            self._schemas[schema.id] = schema
            return
        record = parsed(ChannelRecord, data)
        schema = self._schemas.get(record.schema_id)
        found = Channel(
            record.id,
            record.topic,
            record.message_encoding,
            schema.name if schema else "",
            schema.data if schema else b"",
            record.metadata,
        )
        before = self.channels.setdefault(record.id, found)
        if before[:3] != found[:3]:
            raise Damaged(f"channel {record.id} has two different definitions")
