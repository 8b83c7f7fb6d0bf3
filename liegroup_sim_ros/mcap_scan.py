# SPDX-License-Identifier: Apache-2.0
"""What is good in an MCAP file, wherever it is cut or damaged: piece by piece, front to back.

Only what its check sum confirms is handed out, and, marked as such, the beginning of a chunk that
the file ends in. After damage the next chunk is searched for whose check sum is right. Nothing a
file claims about its sizes is believed: memory is bounded by LARGEST, time by LARGEST_RATIO times
the size of the file.

Source: mcap.dev specification, version 0.
"""
import struct
import zlib
from array import array
from io import BytesIO
from typing import NamedTuple

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Footer, Header, Metadata, Schema, Statistics
from mcap.writer import MCAP0_MAGIC

LARGEST = 32 * 2**20          # bytes of a record, and of a chunk when it is decompressed
# A file that grows more than this, and LARGEST, is none of a log: bodies at rest reach 6.
LARGEST_RATIO = 100
_TRIES = 16                   # times the size of the file may be read in search of a chunk

_RECORD = struct.Struct("<BQ")              # opcode, size of what follows
_MESSAGE = struct.Struct("<HIQQ")           # channel, sequence, log time, publish time
_CHUNK = struct.Struct("<QQQII")            # times, size, check sum, length of the compression
_ATTACHMENT = struct.Struct("<QQI")         # log time, create time, length of the name
_FOOTER = _RECORD.size + 20
_ZSTD = struct.pack("<I", 4) + b"zstd"      # in every chunk that is searched for


class Damaged(Exception):
    """Bytes that are not what they should be."""


class Block(NamedTuple):
    """Records of schemas, channels and messages."""

    definitions: list           # Schema and Channel
    starts: array               # where in `data` the messages begin, and
    ends: array                 # where they end
    data: bytes
    is_whole: bool              # False: the beginning of a chunk that the file ends in

    def messages(self):
        """Generator of (channel, sequence, log time, publish time, offset of its bytes, end)."""
        data, unpack, size = self.data, _MESSAGE.unpack_from, _MESSAGE.size
        for start, end in zip(self.starts, self.ends):
            yield (*unpack(data, start), start + size, end)


class AttachmentPiece(NamedTuple):
    log_time: int
    create_time: int
    name: str
    media_type: str
    data: bytes


class Damage(NamedTuple):
    """Something that is left out."""

    text: str


class End(NamedTuple):
    """The end of a file that was finished."""

    definitions: list           # Schema and Channel of the summary
    statistics: object          # Statistics, or None


def pieces(stream, size):
    """Generator of the good pieces of an MCAP file, in file order.

    stream : of the file, can seek; size: its bytes
    yields Header, Metadata, AttachmentPiece, Block, Damage and, last, End if the file is finished
    raises Damaged when the file is no MCAP file
    """
    stream.seek(0)
    if stream.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
        raise Damaged("not an MCAP file")
    search = _Search(stream, size)
    budget = LARGEST + LARGEST_RATIO * size
    good_end = at = len(MCAP0_MAGIC)        # all before good_end is known to be right
    while True:
        try:
            opcode, length, is_cut = _next_record(stream, at, size)
        except Damaged as damage:
            found = search.next_chunk(max(good_end, search.done))
            if found is None:
                if at < size:
                    yield Damage(str(damage))
                return
            yield Damage("damage between two chunks")
            good_end = at = found
            continue
        start, end = at + _RECORD.size, at + _RECORD.size + length
        if is_cut:
            found = search.next_chunk(max(good_end, search.done))
            if found is not None:
                yield Damage("a damaged record")
                good_end = at = found
                continue
            if opcode == Opcode.CHUNK:
                stream.seek(start)
                block = _beginning(stream.read(min(size - start, LARGEST)))
                if block:
                    yield block
            return
        if opcode == Opcode.DATA_END:
            try:
                yield _end(stream, at, size)
            except Damaged as damage:
                yield Damage(str(damage))
            return
        try:
            piece = _piece(stream, opcode, start, length)
            if isinstance(piece, Block):
                budget -= len(piece.data)
                if budget < 0:
                    raise Damaged(f"it claims to hold more than {LARGEST_RATIO} times its size; "
                                  "the rest is left out")
        except Damaged as damage:
            yield Damage(str(damage))
            if budget < 0:
                return
            if not _fits_itself(stream, opcode, start, length):
                found = search.next_chunk(max(good_end, search.done, at + 1))
                if found is None:
                    return
                good_end = end = found
        else:
            if piece is not None:
                yield piece
                good_end = end
        at = end


def _next_record(stream, at, size):
    """(opcode, length, whether the file ends within) of the record at an offset."""
    stream.seek(at)
    head = stream.read(_RECORD.size)
    if len(head) < _RECORD.size:
        return 0, 0, True
    opcode, length = _RECORD.unpack(head)
    if opcode == 0 or Opcode.DATA_END < opcode < 0x80 or opcode == Opcode.DATA_END and length != 4:
        raise Damaged("bytes that are no record")
    return opcode, length, at + _RECORD.size + length > size


def _piece(stream, opcode, start, length):
    """The piece in a record, or None for one that can be spared. Raises Damaged."""
    if opcode not in _KINDS:
        return None
    if length > LARGEST:
        raise Damaged(f"a record of {length} bytes, the largest that is read has {LARGEST}")
    stream.seek(start)
    body = stream.read(length)
    if opcode == Opcode.CHUNK:
        return block_of(_chunk_data(body))
    if opcode == Opcode.ATTACHMENT:
        return _attachment(body)
    if opcode in (Opcode.HEADER, Opcode.METADATA):
        return _parsed(_KINDS[opcode], body)
    return block_of(_RECORD.pack(opcode, length) + body)


_KINDS = {Opcode.HEADER: Header, Opcode.SCHEMA: Schema, Opcode.CHANNEL: Channel,
          Opcode.MESSAGE: None, Opcode.CHUNK: None, Opcode.ATTACHMENT: None,
          Opcode.METADATA: Metadata}


def _parsed(kind, body):
    try:
        return kind.read(ReadDataStream(BytesIO(body)))
    except Exception as error:              # damaged bytes can make a parser raise anything
        raise Damaged(f"a damaged record ({kind.__name__})") from error


def _fits_itself(stream, opcode, start, length):
    """Whether the sizes within a damaged record agree with its length, so that the next one is
    where the length says."""
    stream.seek(start)
    if opcode != Opcode.CHUNK:
        return opcode != Opcode.ATTACHMENT
    try:
        _, _, _, data_start, data_length = _chunk_head(stream.read(min(length, 256)))
    except Damaged:
        return False
    return data_start + data_length == length


def _chunk_head(body):
    """(compression, uncompressed size, check sum, offset of the data, their length)."""
    if len(body) < _CHUNK.size:
        raise Damaged("a damaged chunk")
    _, _, size, checksum, name_length = _CHUNK.unpack_from(body)
    data_start = _CHUNK.size + name_length + 8
    if name_length > 16 or len(body) < data_start:
        raise Damaged("a damaged chunk")
    compression = body[_CHUNK.size:_CHUNK.size + name_length]
    length, = struct.unpack_from("<Q", body, data_start - 8)
    return compression, size, checksum, data_start, length


def _chunk_data(body):
    """Records of a chunk that is whole, or Damaged."""
    compression, size, checksum, start, length = _chunk_head(body)
    if start + length > len(body):
        raise Damaged("a damaged chunk")
    if size > LARGEST:
        raise Damaged(f"a chunk of {length} bytes that claims to hold {size}")
    data = _decompressed(compression, body[start:start + length], size)
    if len(data) != size or checksum and zlib.crc32(data) != checksum:
        raise Damaged("a damaged chunk")
    return data


def _decompressed(compression, data, size):
    """The bytes of a chunk, at most one more than its size."""
    if compression == b"zstd":
        try:
            # Not decompress(), which believes the size that the data claim.
            return zstandard.ZstdDecompressor(max_window_size=LARGEST).stream_reader(
                data).read(size + 1)
        except (zstandard.ZstdError, MemoryError) as error:
            raise Damaged("a damaged chunk") from error
    if compression == b"lz4":
        try:
            from lz4.frame import LZ4FrameDecompressor
        except ImportError:
            raise Damaged("a chunk compressed with lz4: pip install lz4") from None
        try:
            return LZ4FrameDecompressor().decompress(data, size + 1)
        except (RuntimeError, EOFError) as error:
            raise Damaged("a damaged chunk") from error
    if compression == b"":
        return data
    raise Damaged("a chunk of unknown compression")


def _beginning(body):
    """Block of what can be had of a chunk whose end is missing, or None."""
    try:
        compression, size, _, start, _ = _chunk_head(body)
    except Damaged:
        return None
    data = b""
    if compression == b"":
        data = body[start:]
    elif compression == b"zstd":
        parts, left = [], min(size, LARGEST)
        decompress = zstandard.ZstdDecompressor(max_window_size=LARGEST).decompressobj().decompress
        try:
            while left > 0 and start < len(body):
                # A little at a time: a byte may become 32 KiB.
                parts.append(decompress(body[start:start + 64]))
                left -= len(parts[-1])
                start += 64
        except (zstandard.ZstdError, MemoryError):
            pass
        data = b"".join(parts)[:size]
    try:
        block = block_of(data, is_whole=False)
    except Damaged:
        return None
    return block if block.definitions or block.starts else None


def block_of(data, is_whole=True):
    """Block of uncompressed records; what follows the last whole one is left out, or Damaged."""
    definitions, starts, ends, at, size = [], array("I"), array("I"), 0, len(data)
    while at + _RECORD.size <= size:
        opcode, length = _RECORD.unpack_from(data, at)
        start, end = at + _RECORD.size, at + _RECORD.size + length
        if end > size:
            break
        if opcode == Opcode.MESSAGE:
            if length < _MESSAGE.size:
                raise Damaged("a damaged message")
            starts.append(start)
            ends.append(end)
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            definitions.append(_parsed(_KINDS[opcode], data[start:end]))
        elif opcode < 0x80:
            raise Damaged("a chunk with a record that does not belong in it")
        at = end
    if is_whole and at != size:
        raise Damaged("a chunk whose last record is not whole")
    return Block(definitions, starts, ends, data, is_whole)


def _attachment(body):
    if len(body) < _ATTACHMENT.size + 4:
        raise Damaged("a damaged attachment")
    log_time, create_time, at = _ATTACHMENT.unpack_from(body)
    stream = ReadDataStream(BytesIO(body[16:]))
    try:
        name, media_type = stream.read_prefixed_string(), stream.read_prefixed_string()
        length = stream.read8()
    except Exception as error:              # likewise
        raise Damaged("a damaged attachment") from error
    at = 16 + stream.count
    if at + length + 4 != len(body):
        raise Damaged("a damaged attachment")
    checksum, = struct.unpack_from("<I", body, at + length)
    if checksum and zlib.crc32(body[:-4]) != checksum:
        raise Damaged(f"a damaged attachment, {name}")
    return AttachmentPiece(log_time, create_time, name, media_type, body[at:at + length])


def summary_of(stream, size):
    """End of a file whose summary can be read, whatever is in front of it. Raises Damaged."""
    stream.seek(max(0, size - len(MCAP0_MAGIC) - _FOOTER))
    footer = stream.read(_FOOTER)
    if len(footer) < _FOOTER:
        raise Damaged("the end of the file is damaged")
    at = _parsed(Footer, footer[_RECORD.size:]).summary_start - 4 - _RECORD.size
    if at < 0 or at > size or _next_record(stream, at, size)[:2] != (Opcode.DATA_END, 4):
        raise Damaged("the end of the file is damaged")
    return _end(stream, at, size, check_data=False)


def _end(stream, at, size, check_data=True):
    """End of a file whose data end at an offset, if all there is from there on is right."""
    stream.seek(at + _RECORD.size)
    tail_start = size - len(MCAP0_MAGIC) - _FOOTER
    summary_start = at + _RECORD.size + 4
    if tail_start < summary_start or tail_start - summary_start > LARGEST:
        raise Damaged("the end of the file is damaged")
    data_checksum, = struct.unpack("<I", stream.read(4))
    summary, footer = stream.read(tail_start - summary_start), stream.read(_FOOTER)
    if stream.read() != MCAP0_MAGIC or _RECORD.unpack_from(footer) != (Opcode.FOOTER, 20):
        raise Damaged("the end of the file is damaged")
    told = _parsed(Footer, footer[_RECORD.size:])
    if told.summary_crc and zlib.crc32(summary + footer[:-4]) != told.summary_crc:
        raise Damaged("the summary is damaged")
    if summary and told.summary_start != summary_start:
        raise Damaged("the summary is not where it should be")
    if check_data and data_checksum and _checksum(stream, at) != data_checksum:
        raise Damaged("the check sum of the data is wrong")
    definitions, statistics, place = [], None, 0
    while place + _RECORD.size <= len(summary):
        opcode, length = _RECORD.unpack_from(summary, place)
        place += _RECORD.size
        if place + length > len(summary):
            raise Damaged("the summary is damaged")
        body = summary[place:place + length]
        if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            definitions.append(_parsed(_KINDS[opcode], body))
        elif opcode == Opcode.STATISTICS:
            statistics = _parsed(Statistics, body)
        place += length
    return End(definitions, statistics)


def _checksum(stream, end):
    """CRC-32 of the file up to an offset."""
    stream.seek(0)
    checksum = 0
    while end > 0 and (part := stream.read(min(end, 2**20))):
        checksum = zlib.crc32(part, checksum)
        end -= len(part)
    return checksum


class _Search:
    """Looks for chunks whose check sums are right, compressed with zstd as ours are."""

    def __init__(self, stream, size):
        self._stream, self._size = stream, size
        self._left = _TRIES * size + 2**20      # bytes that may be read in vain
        self.done = 0                           # there is none before this offset

    def next_chunk(self, at):
        """Offset of the next one that begins at an offset or behind it, or None."""
        stream, lead = self._stream, _RECORD.size + _CHUNK.size - 4
        at += lead
        while at < self._size and self._left > 0:
            stream.seek(at)
            window = stream.read(2**20)
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
        try:
            opcode, length, is_cut = _next_record(self._stream, at, self._size)
            if opcode != Opcode.CHUNK or is_cut or length > LARGEST:
                return False
            body = self._stream.read(length)
            _, size, checksum, start, data_length = _chunk_head(body)
            self._left -= max(length, size // LARGEST_RATIO)
            if start + data_length != length or not checksum:
                return False
            block_of(_chunk_data(body))
            return True
        except Damaged:
            return False
