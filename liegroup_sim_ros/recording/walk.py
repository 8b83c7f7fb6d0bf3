# SPDX-License-Identifier: Apache-2.0
"""One pass over an MCAP file that may be truncated, damaged or hostile; all readers of this folder use it.

Records are read if their checksum is correct. After damage, the pass continues at the next chunk with a
correct checksum. Sizes claimed by the file are not trusted: memory is bounded by LARGEST, time by
LARGEST_RATIO times the size of the file.

The library `mcap` creates an object per message, about 5 us. Here the messages of a chunk are arrays, about
0.1 us each (benchmarks/recording_analysis.py).

Source: mcap.dev specification, version 0.
"""

import string
import struct
import zlib
from contextlib import suppress
from typing import NamedTuple

import numpy as np
import yaml
from mcap.opcode import Opcode
from mcap.records import Channel as ChannelRecord
from mcap.records import Footer, Header, Schema, Statistics
from mcap.writer import MCAP0_MAGIC
from numpy.lib.stride_tricks import sliding_window_view

from .mcap_records import (
    CHUNK,
    GROWS,
    KINDS,
    LARGEST,
    LARGEST_RATIO,
    RECORD,
    Damaged,
    DamagedLength,
    attachment_of,
    beginning,
    check_claim,
    chunk_data,
    chunk_head,
    parsed,
    read_magic,
)

MOST_DEFINITIONS = 8 * 2**20  # bytes of all names and schemas
MOST_EXTRAS = 10_000  # attachments and metadata records
MOST_PROBLEMS = 20  # different problems that are listed
LONGEST_QOS = 65536  # characters of YAML
PIECE = 2**20  # bytes: messages outside of chunks are collected into pieces of this size
MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
_HEAD = np.dtype([("opcode", "u1"), ("size", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("times", "<i8", 2)])
_CHUNK_HEAD = 56  # bytes, at most
_TRIES = 16  # the search for chunks reads at most this many times the file size
_FOOTER = RECORD.size + 20
_ZSTD = struct.pack("<I", 4) + b"zstd"  # present in every chunk of the recorder
_PLAIN = frozenset(string.printable) - frozenset("\t\n\r\x0b\x0c")


class Channel(NamedTuple):
    id: int
    topic: str
    encoding: str
    schema: Schema | None
    metadata: dict

    @property
    def type(self):
        """Type of its messages; empty without a schema."""
        return self.schema.name if self.schema else ""

    @property
    def qos(self):
        """[QoS profile] that the publishers offered, as in schemas.qos_profile; [] if the file has no valid one."""
        text = self.metadata.get("offered_qos_profiles", "")
        try:
            offered = yaml.safe_load(text) if len(text) <= LONGEST_QOS else None
        except (yaml.YAMLError, RecursionError, ValueError):
            offered = None
        return offered if isinstance(offered, list) else []


class ChunkMessages(NamedTuple):
    """The messages of a chunk, in file order."""

    data: np.ndarray  # (bytes,) uint8, the decompressed chunk
    channel: np.ndarray  # (m,) channel id
    sequence: np.ndarray  # (m,)
    log_time: np.ndarray  # (m,) ns
    start: np.ndarray  # (m,) offset of the payload in data
    size: np.ndarray  # (m,) bytes of the payload
    is_whole: bool  # False: the beginning of a truncated chunk

    def payload(self, k):
        """Bytes of message k."""
        return self.data[self.start[k] : self.start[k] + self.size[k]].tobytes()

    def rows(self, index):
        """(len(index), size) uint8: payloads of messages of one size."""
        size = int(self.size[index[0]])
        return sliding_window_view(self.data, size)[self.start[index]]

    def by_channel(self):
        """[(channel id, indices of its messages)]."""
        order = np.argsort(self.channel, kind="stable")
        numbers, first = np.unique(self.channel[order], return_index=True)
        return list(zip(numbers.tolist(), np.split(order, first[1:])))


class Tally:
    """Counts of one channel: messages, and missing ones by sequence number."""

    def __init__(self):
        self.count = 0
        self.first_ns, self.last_ns = 2**64, -1
        self._first = self._at = self._largest = 0
        self._different = 0  # numbers up to the largest that are there

    def add(self, sequence, stamps):
        """Count messages, given their numbers and stamps (k,)."""
        if not self.count:
            self._first = self._at = int(sequence[0])
            self._largest = self._first - 1
        # Numbers have 32 bits and wrap around; a smaller one is not a gap.
        steps = np.diff(sequence, prepend=self._at % 2**32)
        numbers = self._at + np.cumsum((steps + 2**31) % 2**32 - 2**31)
        reached = np.maximum.accumulate(np.concatenate([[self._largest], numbers]))
        self._different += int((numbers > reached[:-1]).sum())
        self._at, self._largest = int(numbers[-1]), int(reached[-1])
        self.count += len(sequence)
        edges = stamps.view(np.uint64)
        self.first_ns, self.last_ns = min(self.first_ns, int(edges.min())), max(self.last_ns, int(edges.max()))

    def lost(self, before):
        """Missing messages before the last one.

        before : last number before this file; None: unknown
        """
        if not self.count:
            return 0
        gap = 0 if before is None else (self._first - 1 - before) % 2**32
        return self._largest - self._first + 1 - self._different + (gap if gap < 2**31 else 0)

    @property
    def rate(self):
        """Messages per second by their stamps, or None."""
        span = self.last_ns - self.first_ns if self.count > 1 else 0
        return (self.count - 1) / (span * 1e-9) if span > 0 else None


class Walk:
    """One pass over a file: `for item in walk` yields Attachment, Metadata and ChunkMessages.

    file        : seekable binary file
    size        : bytes to read
    wanted      : function (offset, start_ns, end_ns) -> whether to read a chunk; None: all chunks
    is_thorough : whether to compare the checksum of the whole file

    During and after the pass: `channels` {id: Channel}; `header`; `finished` whether the end of the file is
    there; `problems` {text: number of occurrences}; `statistics` of the summary, or None; `offset` of
    the record of the last item.
    Iteration raises Damaged for a file that is not an MCAP file.
    """

    def __init__(self, file, size, wanted=None, is_thorough=False):
        self._file, self._size, self._wanted, self._is_thorough = file, size, wanted, is_thorough
        self._schemas, self.channels, self._defined, self._extras = {}, {}, 0, 0
        self.header, self.problems, self.finished, self.statistics = Header("", ""), {}, False, None
        self.offset = 0
        self._loose, self._first_loose = bytearray(), 0  # messages outside of chunks, offset of the first one
        self._before = np.empty(0, dtype=np.int64)  # offsets in the chunk before
        self._budget = LARGEST + LARGEST_RATIO * size

    def __iter__(self):
        file, size = self._file, self._size
        file.seek(0)
        read_magic(file)
        self._define_by_summary()
        search = _Search(file, size)
        good_end = at = len(MCAP0_MAGIC)  # everything before good_end is intact
        while True:
            self.offset = at
            opcode, length, damage = _record_at(file, at, size)
            start, end = at + RECORD.size, at + RECORD.size + length
            # In a file that is being written a chunk takes the place of its messages.
            if damage and self._loose and _record_at(file, self._first_loose, size)[0] != Opcode.MESSAGE:
                self._loose.clear()
                at = self._first_loose
                continue
            if opcode != Opcode.MESSAGE or damage:
                yield from self._loose_messages()
            if damage:
                found = search.next_chunk(max(good_end, search.done))
                if found is None:
                    if opcode == Opcode.CHUNK:
                        file.seek(start)
                        with suppress(Damaged):
                            yield from self._messages(beginning(file.read(min(size - start, LARGEST))), is_whole=False)
                    elif opcode == 0:
                        self.problem(damage)
                    return
                self.problem(damage)
                good_end = at = found
                continue
            try:
                if opcode == Opcode.DATA_END:
                    self._end(at, self._is_thorough)
                    return
                yield from self._take(opcode, start, length)
                if opcode in KINDS:
                    good_end = end
            except Damaged as error:
                self.problem(str(error))
                if opcode == Opcode.DATA_END:
                    return
                if isinstance(error, DamagedLength):  # the next record need not begin at its end
                    found = search.next_chunk(max(good_end, search.done, at + 1))
                    if found is None:
                        return
                    good_end = end = found
            at = end

    def problem(self, text):
        """Count a problem."""
        text = clean(text)
        if text in self.problems or len(self.problems) < MOST_PROBLEMS:
            self.problems[text] = self.problems.get(text, 0) + 1

    def _take(self, opcode, start, length):
        """Read a record; yields what it contains. Raises Damaged."""
        if opcode not in KINDS:
            return
        if length > LARGEST and opcode != Opcode.CHUNK:
            raise DamagedLength(f"a record of {length} bytes; the limit is {LARGEST}")
        self._file.seek(start)
        if opcode == Opcode.CHUNK:
            yield from self._chunk(start, length)
            return
        body = self._file.read(length)
        if opcode == Opcode.MESSAGE:
            if length < MESSAGE.size:
                raise Damaged("a damaged message")
            self._first_loose = self._first_loose if self._loose else start - RECORD.size
            self._loose += RECORD.pack(opcode, length) + body
            if len(self._loose) > PIECE:
                yield from self._loose_messages()
            return
        piece = attachment_of(body) if opcode == Opcode.ATTACHMENT else parsed(KINDS[opcode], body)
        if opcode == Opcode.HEADER:
            self.header = piece
        elif opcode in (Opcode.ATTACHMENT, Opcode.METADATA):
            self._extras += 1
            if self._extras <= MOST_EXTRAS:
                yield piece
            else:
                self.problem(f"more than {MOST_EXTRAS} attachments; the rest is omitted")
        else:
            self._define(piece)

    def _chunk(self, start, length):
        """Yield the messages of a chunk that is wanted."""
        body = self._file.read(min(length, _CHUNK_HEAD))
        head = chunk_head(body)
        if head.data_start + head.length != length:
            raise DamagedLength("a damaged chunk")
        check_claim(head)
        self._budget -= head.size
        if self._budget < 0:
            raise Damaged(GROWS)
        if self._wanted is None or self._wanted(start - RECORD.size, head.first_ns, head.last_ns):
            body += self._file.read(length - len(body))
            yield from self._messages(chunk_data(head, memoryview(body)[head.data_start :]))

    def _loose_messages(self):
        if self._loose:
            data = bytes(self._loose)
            self._loose.clear()
            yield from self._messages(data)

    def _messages(self, data, is_whole=True):
        """Yield ChunkMessages if there are any, and take the definitions among them. Raises Damaged."""
        size, raw = len(data), np.frombuffer(data, dtype=np.uint8)
        before, at = self._alike(raw)
        starts = []
        message, head, unpack, append = int(Opcode.MESSAGE), RECORD.size, RECORD.unpack_from, starts.append
        while at + head <= size:
            opcode, length = unpack(data, at)
            end = at + head + length
            if end > size:
                break
            if opcode == message:
                append(at)
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._define(parsed(KINDS[opcode], data[at + RECORD.size : end]))
            elif opcode < 0x80:
                raise Damaged("a chunk with a record of a wrong kind")
            at = end
        if is_whole and at != size:
            raise Damaged("a chunk with a truncated record")
        begin = np.concatenate([before, np.array(starts, dtype=np.int64)])
        if len(begin):
            self._before = begin if len(starts) > 1 else self._before
            heads = _heads(raw, begin)
            channel, sequence, sizes = (heads[name].astype(np.int64) for name in ("channel", "sequence", "size"))
            if sizes.min() < MESSAGE.size:
                raise Damaged("a damaged message")
            times = heads["times"][:, 0].astype(np.int64)
            yield ChunkMessages(raw, channel, sequence, times, begin + _HEAD.itemsize, sizes - MESSAGE.size, is_whole)

    def _alike(self, raw):
        """(offsets (k,) of messages that are where those of the chunk before were, offset of the next record)."""
        begin = self._before[: np.searchsorted(self._before, len(raw) - _HEAD.itemsize, "right")]
        if not len(begin) or begin[0]:
            return begin[:0], 0
        heads = _heads(raw, begin)
        fits = (heads["opcode"][:-1] == Opcode.MESSAGE) & (heads["size"][:-1] == np.diff(begin) - RECORD.size)
        count = len(fits) if fits.all() else int(fits.argmin())
        return begin[:count], int(begin[count])

    def _define(self, record):
        """Take a Schema, or a Channel of the library."""
        kept, found = self._schemas, record
        if isinstance(record, ChannelRecord):
            schema = self._schemas.get(record.schema_id)
            kept, found = (
                self.channels,
                Channel(record.id, record.topic, record.message_encoding, schema, record.metadata),
            )
        if record.id not in kept:
            self._defined += len(str(record))
            if self._defined > MOST_DEFINITIONS:
                raise Damaged(f"its definitions exceed {MOST_DEFINITIONS} bytes")
            kept[record.id] = found
        elif kept[record.id] != found:
            self.problem("contradictory definitions of a channel or schema")

    def _define_by_summary(self):
        """Take the definitions of the summary: those before the messages may be damaged."""
        file, size = self._file, self._size
        file.seek(max(0, size - len(MCAP0_MAGIC) - _FOOTER))
        try:
            at = parsed(Footer, file.read(_FOOTER)[RECORD.size :]).summary_start - 4 - RECORD.size
            if 0 <= at <= size and _record_at(file, at, size) == (Opcode.DATA_END, 4, None):
                self._end(at, False)
        except Damaged:
            pass
        self.finished, self.statistics = False, None

    def _end(self, at, is_thorough):
        """Take the summary of a file whose data end at an offset. Raises Damaged if anything after it is damaged."""
        file = self._file
        file.seek(at + RECORD.size)
        tail_start = self._size - len(MCAP0_MAGIC) - _FOOTER
        summary_start = at + RECORD.size + 4
        if tail_start < summary_start or tail_start - summary_start > LARGEST:
            raise Damaged("the end of the file is damaged")
        (data_checksum,) = struct.unpack("<I", file.read(4))
        summary, footer = file.read(tail_start - summary_start), file.read(_FOOTER)
        if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC or RECORD.unpack_from(footer) != (Opcode.FOOTER, 20):
            raise Damaged("the end of the file is damaged")
        self.finished = True
        footer_record = parsed(Footer, footer[RECORD.size :])
        checksum = footer_record.summary_crc
        if checksum and zlib.crc32(summary + footer[:-4]) != checksum:
            raise Damaged("the summary is damaged")
        if summary and footer_record.summary_start != summary_start:
            raise Damaged("the footer does not point to the summary")
        if is_thorough and data_checksum and _checksum(file, at) != data_checksum:
            raise Damaged("wrong checksum of the data")
        place = 0
        while place + RECORD.size <= len(summary):
            opcode, length = RECORD.unpack_from(summary, place)
            place += RECORD.size
            if place + length > len(summary):
                raise Damaged("the summary is damaged")
            body = summary[place : place + length]
            if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._define(parsed(KINDS[opcode], body))
            elif opcode == Opcode.STATISTICS:
                self.statistics = parsed(Statistics, body)
            place += length


def _heads(raw, starts):
    """Heads (m,) of the messages at these offsets in the bytes of a chunk."""
    return sliding_window_view(raw, _HEAD.itemsize)[starts].view(_HEAD)[:, 0]


def _record_at(file, at, size):
    """(opcode, length, None) of the record at an offset; else what is wrong in place of None, and opcode 0 or None."""
    file.seek(at)
    head = file.read(RECORD.size)
    if len(head) < RECORD.size or at + RECORD.size > size:
        return None, 0, "a damaged record"
    opcode, length = RECORD.unpack(head)
    if opcode == 0 or Opcode.DATA_END < opcode < 0x80 or opcode == Opcode.DATA_END and length != 4:
        return 0, 0, "bytes that are not a record"
    return opcode, length, "a damaged record" if at + RECORD.size + length > size else None


def _checksum(file, end):
    """CRC-32 of the file up to an offset."""
    file.seek(0)
    checksum = 0
    while end > 0 and (part := file.read(min(end, 2**20))):
        checksum = zlib.crc32(part, checksum)
        end -= len(part)
    return checksum


class _Search:
    """Search for chunks with correct checksums, compressed with zstd as the recorder's are."""

    def __init__(self, file, size):
        self._file, self._size = file, size
        self._left = _TRIES * size + 2**20  # bytes that the search may read
        self.done = 0  # no chunk begins before this offset

    def next_chunk(self, at):
        """Offset of the first chunk at or after an offset, or None."""
        file, lead = self._file, RECORD.size + CHUNK.size - 4
        at += lead
        while at < self._size and self._left > 0:
            file.seek(at)
            window = file.read(2**20)
            self._left -= len(window)
            place = window.find(_ZSTD)
            while place >= 0 and self._left > 0:
                found = at + place - lead
                if self._is_good(found):
                    self.done = found
                    return found
                place = window.find(_ZSTD, place + 1)
            at += max(1, len(window) - len(_ZSTD) + 1)
        self.done = self._size
        return None

    def _is_good(self, at):
        opcode, length, damage = _record_at(self._file, at, self._size)
        if damage or opcode != Opcode.CHUNK or length > LARGEST:
            return False
        body = self._file.read(length)
        try:
            head = chunk_head(body)
            self._left -= max(length, head.size // LARGEST_RATIO)
            if head.data_start + head.length != length or not head.checksum:
                return False
            chunk_data(head, body[head.data_start :])
            return True
        except Damaged:
            return False


def clean(text, longest=200):
    """Text without control characters, for a terminal: names in a file are arbitrary bytes."""
    text = "".join(c if c in _PLAIN or c.isprintable() else "\ufffd" for c in text)
    return text if len(text) <= longest else text[: longest - 3] + "..."
