# SPDX-License-Identifier: Apache-2.0
"""An MCAP file from front to back, chunk by chunk, with the messages of a chunk as arrays.

Made for files that nobody vouches for: every length is checked before anything of that size is
read, unpacked or allocated; check sums are compared wherever the format has them; what is damaged
is skipped and told. So memory is that of one chunk, and time is linear in the file's size.
A file that was never finished gives all its closed chunks.

The library `mcap` makes an object of every message, some 5 us; here a compiled loop finds the
messages of a chunk, some 10 ns each (benchmarks/recording_analysis.py).

Source: mcap.dev specification, version 0.
"""
import io
import struct
import zlib
from typing import NamedTuple

import numpy as np
import zstandard

from liegroup_core._compile import subroutine

MAGIC = b"\x89MCAP0\r\n"
(HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX, ATTACHMENT,
 ATTACHMENT_INDEX, STATISTICS, METADATA, METADATA_INDEX, SUMMARY_OFFSET, DATA_END) = range(1, 16)

# Chunks of the recorder have 128 KiB, those of other tools up to some MiB.
LARGEST_CHUNK = 64 * 2**20      # bytes, unpacked
LARGEST_RECORD = 64 * 2**20     # bytes, of any other record that is read
# Messages carry a stamp and a number each, which do not shrink so much; bombs do.
MOST_EXPANSION = 1000
# Messages outside of chunks are put together to pieces of this size.
PIECE = 2**20                   # bytes

_RECORD = struct.Struct("<BQ")              # opcode, size of what follows
_CHUNK_START = struct.Struct("<QQQII")      # start, end, unpacked size, CRC, size of next string
_MESSAGE_START = 22                         # bytes of a message before its data


class Channel(NamedTuple):
    id: int
    topic: str
    encoding: str
    type: str                   # name of its schema
    schema: bytes               # text of the schema
    metadata: dict


class Attachment(NamedTuple):
    name: str
    data: bytes


class Messages(NamedTuple):
    """The messages of a chunk, in file order."""

    data: np.ndarray            # (bytes,) uint8, the unpacked chunk
    channel: np.ndarray         # (m,) channel id
    sequence: np.ndarray        # (m,)
    log_time: np.ndarray        # (m,) ns
    start: np.ndarray           # (m,) where in data its payload begins
    size: np.ndarray            # (m,) bytes of its payload

    def payload(self, k):
        """Bytes of message k."""
        return self.data[self.start[k]:self.start[k] + self.size[k]].tobytes()

    def rows(self, index):
        """(len(index), size) uint8: payloads of messages of one size."""
        size = int(self.size[index[0]])
        return self.data[self.start[index][:, None] + np.arange(size)]


class Damage(Exception):
    """A part of the file that is not what the format says; one line of text."""


@subroutine
def _find_messages(data, channel, sequence, log_time, start, size, other):
    """Fill the arrays; (messages, other records, bytes walked).

    other : (., 3) opcode, start and size of every record that is no message
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
    """Reads a file once: `for item in stream` gives Attachment and Messages.

    file : binary file object that can seek
    size : bytes of it that count

    After that, or on the way, for what came so far: `channels` {id: Channel}, `finished` True when
    the file's end was reached as it should be, `damaged` parts that were skipped, `remarks` on
    them, `statistics` {channel id: message count} of the summary or None, `attachments_indexed`
    number of them there or None. With `wanted`, a function of (offset, start_ns, end_ns), only the
    chunks are given for which it is true.
    """

    def __init__(self, file, size, wanted=None):
        self._file, self._size, self._wanted = file, size, wanted
        self.channels, self._schemas = {}, {}
        self.finished, self.damaged, self.remarks = False, 0, []
        self.statistics = self.attachments_indexed = None
        self.offset = 0                     # of the record that the last item came from
        self._loose = bytearray()

    def __iter__(self):
        file = self._file
        file.seek(0)
        if file.read(len(MAGIC)) != MAGIC:
            raise Damage("not an MCAP file")
        at = len(MAGIC)
        while True:
            head = file.read(_RECORD.size)
            if len(head) < _RECORD.size:
                break
            opcode, length = _RECORD.unpack(head)
            at += _RECORD.size
            if opcode == 0 or length > self._size - at:
                break
            if opcode == FOOTER:
                self.finished = length == 20 and len(file.read(20)) == 20 and (
                    file.read(len(MAGIC)) == MAGIC)
                break
            if opcode == MESSAGE:
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
        if opcode not in (SCHEMA, CHANNEL, CHUNK, ATTACHMENT, STATISTICS):
            return
        if length > LARGEST_RECORD:
            self._skip(f"a record claims {length} bytes")
            return
        try:
            if opcode == CHUNK:
                found = self._chunk(length, at)
                if found is not None:
                    yield found
                return
            data = self._file.read(length)
            if opcode == ATTACHMENT:
                yield _attachment(data)
            elif opcode == STATISTICS:
                self._take_statistics(data)
            else:
                self._take_names(opcode, data)
        except (Damage, struct.error, ValueError, IndexError, KeyError) as error:
            self._skip(str(error) if isinstance(error, Damage) else "a record cannot be read")

    def _skip(self, remark):
        self.damaged += 1
        if remark not in self.remarks and len(self.remarks) < 5:
            self.remarks.append(remark)

    def _chunk(self, length, at):
        """Messages of the chunk that begins here, or None for one that is not wanted."""
        first, last, size, crc, name = _CHUNK_START.unpack(self._file.read(_CHUNK_START.size))
        if name > 16:
            raise Damage("a chunk with a damaged head")
        compression = self._file.read(name)
        packed, = struct.unpack("<Q", self._file.read(8))
        if packed != length - _CHUNK_START.size - name - 8:
            raise Damage("a chunk with a damaged head")
        if size > LARGEST_CHUNK or size > MOST_EXPANSION * max(packed, 64):
            raise Damage(f"a chunk of {packed} bytes claims {size} unpacked")
        if self._wanted is not None and not self._wanted(at, first, last):
            return None
        data = _unpacked(compression, self._file.read(packed), size)
        if crc and zlib.crc32(data) != crc:
            raise Damage("a chunk whose check sum is wrong")
        return self._messages(np.frombuffer(data, dtype=np.uint8))

    def _messages(self, data):
        room = len(data) // (_RECORD.size + _MESSAGE_START) + 1
        channel, sequence, log_time, start, size = np.empty((5, room), dtype=np.int64)
        other = np.empty((len(data) // _RECORD.size + 1, 3), dtype=np.int64)
        found, others, walked = _find_messages(data, channel, sequence, log_time, start, size,
                                               other)
        for opcode, begin, length in other[:others].tolist():
            if opcode in (SCHEMA, CHANNEL):
                self._take_names(opcode, data[begin:begin + length].tobytes())
        if walked != len(data):
            self._skip("a chunk whose records do not fit")
        return Messages(data, channel[:found], sequence[:found], log_time[:found], start[:found],
                        size[:found])

    def _take_names(self, opcode, data):
        reader = _Reader(data)
        number = reader.number("<H")
        if opcode == SCHEMA:
            self._schemas[number] = reader.text(), reader.text(), reader.bytes()
            return
        schema, topic, encoding = reader.number("<H"), reader.text(), reader.text()
        name, _, text = self._schemas.get(schema, ("", "", b""))
        found = Channel(number, topic, encoding, name, text, reader.map())
        before = self.channels.setdefault(number, found)
        if before[:3] != found[:3]:
            raise Damage(f"channel {number} is said to be two different ones")

    def _take_statistics(self, data):
        reader = _Reader(data)
        for form in ("<Q", "<H", "<I"):     # messages, schemas, channels
            reader.number(form)
        self.attachments_indexed = reader.number("<I")
        for form in ("<I", "<I", "<Q", "<Q"):   # metadata, chunks, first and last time
            reader.number(form)
        pairs = np.frombuffer(reader.bytes(), dtype=[("id", "<u2"), ("count", "<u8")])
        self.statistics = dict(zip(pairs["id"].tolist(), pairs["count"].tolist()))


class _Reader:
    """Fields of a record, one after the other."""

    def __init__(self, data):
        self._data, self._at = data, 0

    def number(self, form):
        value, = struct.unpack_from(form, self._data, self._at)
        self._at += struct.calcsize(form)
        return value

    def bytes(self):
        size = self.number("<I")
        if size > len(self._data) - self._at:
            raise Damage("a record with a length beyond its end")
        self._at += size
        return self._data[self._at - size:self._at]

    def text(self):
        return self.bytes().decode()

    def map(self):
        inner, entries = _Reader(self.bytes()), {}
        while inner._at < len(inner._data):
            key = inner.text()
            entries[key] = inner.text()
        return entries


def _attachment(data):
    crc, = struct.unpack_from("<I", data, len(data) - 4)
    if crc and zlib.crc32(data[:-4]) != crc:
        raise Damage("an attachment whose check sum is wrong")
    reader = _Reader(data)
    reader.number("<Q"), reader.number("<Q")        # log time, create time
    name = reader.text()
    reader.text()                                   # media type
    size = reader.number("<Q")
    if size != len(data) - reader._at - 4:
        raise Damage("an attachment with a length that does not fit")
    return Attachment(name, data[reader._at:-4])


def _unpacked(compression, packed, size):
    """The bytes of a chunk; never more than `size` are unpacked."""
    try:
        if compression == b"zstd":
            reader = zstandard.ZstdDecompressor(max_window_size=LARGEST_CHUNK).stream_reader(
                io.BytesIO(packed))
            data = reader.read(size + 1)
        elif compression == b"lz4":
            import lz4.frame
            data = lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=size + 1)
        elif compression == b"":
            data = packed
        else:
            raise Damage("a chunk of an unknown compression")
    except (zstandard.ZstdError, RuntimeError, MemoryError):
        raise Damage("a chunk that cannot be unpacked") from None
    if len(data) != size:
        raise Damage("a chunk that cannot be unpacked")
    return data
