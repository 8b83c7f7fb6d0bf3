# SPDX-License-Identifier: Apache-2.0
"""Single records of an MCAP file that may be damaged, or made to do harm; for all who read one.

What their check sums do not confirm is refused; no size that they claim is believed, so memory is
bounded by LARGEST. damaged_scan.py looks with them for all that is good in a damaged file,
read_mcap.py gives the messages of a recording as arrays.

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
from mcap.records import Channel, Header, Metadata, Schema

# Bytes of a record, and of a chunk when it is decompressed. Chunks of the recorder have 128 KiB,
# those of other tools up to some MiB.
LARGEST = 64 * 2**20
# Messages carry a stamp and a number each, which do not shrink so much; bombs do.
MOST_EXPANSION = 1000
# A file that grows more than this, and LARGEST, is none of a log: bodies at rest reach 6.
LARGEST_RATIO = 100
GROWS = f"it claims to hold more than {LARGEST_RATIO} times its size; the rest is left out"

RECORD = struct.Struct("<BQ")  # opcode, size of what follows
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
CHUNK = struct.Struct("<QQQII")  # times, size, check sum, length of the compression
_ATTACHMENT = struct.Struct("<QQI")  # log time, create time, length of the name


class Damaged(Exception):
    """Bytes that are not what they should be."""


class Block(NamedTuple):
    """Records of schemas, channels and messages."""

    definitions: list  # Schema and Channel
    starts: array  # where in `data` the messages begin, and
    ends: array  # where they end
    data: bytes
    is_whole: bool  # False: the beginning of a chunk that the file ends in

    def messages(self):
        """Generator of (channel, sequence, log time, publish time, offset of its bytes, end)."""
        data, unpack, size = self.data, _MESSAGE.unpack_from, _MESSAGE.size
        for start, end in zip(self.starts, self.ends):
            yield (*unpack(data, start), start + size, end)


class ChunkHead(NamedTuple):
    """What a chunk says of itself."""

    first_ns: int  # stamps
    last_ns: int
    size: int  # bytes, decompressed
    checksum: int  # of these; 0: none
    compression: bytes
    data_start: int  # offset in the record
    length: int  # bytes, in the file


class AttachmentPiece(NamedTuple):
    log_time: int
    create_time: int
    name: str
    media_type: str
    data: bytes


# Records that are read; those that the library parses with its class.
KINDS = {
    Opcode.HEADER: Header,
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.MESSAGE: None,
    Opcode.CHUNK: None,
    Opcode.ATTACHMENT: None,
    Opcode.METADATA: Metadata,
}


class _Fields(ReadDataStream):
    """The library's own gives fewer bytes than a length says, without a word."""

    def read(self, length):
        data = super().read(length)
        if len(data) != length:
            raise Damaged("a length beyond the end of its record")
        return data


def parsed(kind, body):
    """Record of a class of the library, or Damaged."""
    try:
        return kind.read(_Fields(BytesIO(body)))
    except Damaged:
        raise
    except Exception as error:  # damaged bytes can make a parser raise anything
        raise Damaged(f"a damaged record ({kind.__name__})") from error


def chunk_head(body):
    """ChunkHead of a chunk, of which the first 56 bytes are enough, or Damaged."""
    if len(body) < CHUNK.size:
        raise Damaged("a damaged chunk")
    first_ns, last_ns, size, checksum, name_length = CHUNK.unpack_from(body)
    data_start = CHUNK.size + name_length + 8
    if name_length > 16 or len(body) < data_start:
        raise Damaged("a damaged chunk")
    compression = body[CHUNK.size : CHUNK.size + name_length]
    (length,) = struct.unpack_from("<Q", body, data_start - 8)
    return ChunkHead(first_ns, last_ns, size, checksum, compression, data_start, length)


def chunk_data(head, packed):
    """Records of a chunk that is whole, out of its bytes in the file, or Damaged."""
    if len(packed) != head.length:
        raise Damaged("a damaged chunk")
    check_claim(head)
    data = _decompressed(head.compression, packed, head.size)
    if len(data) != head.size or head.checksum and zlib.crc32(data) != head.checksum:
        raise Damaged("a damaged chunk")
    return data


def check_claim(head):
    """Raise Damaged for a chunk that claims to hold more than one of messages can."""
    if head.size > LARGEST or head.size > MOST_EXPANSION * max(head.length, 64):
        raise Damaged(f"a chunk of {head.length} bytes that claims to hold {head.size}")


def _decompressed(compression, data, size):
    """The bytes of a chunk, at most one more than its size."""
    if compression == b"zstd":
        try:
            # Not decompress(), which believes the size that the data claim.
            return (
                zstandard.ZstdDecompressor(max_window_size=LARGEST)
                .stream_reader(data)
                .read(size + 1)
            )
        except (zstandard.ZstdError, MemoryError) as error:
            raise Damaged("a damaged chunk") from error
    if compression == b"lz4":
        try:
            from lz4.frame import LZ4FrameDecompressor
        except ImportError:
            raise Damaged("a chunk compressed with lz4: pip install lz4") from None
        try:
            return LZ4FrameDecompressor().decompress(data, size + 1)
        except (RuntimeError, EOFError, MemoryError) as error:
            raise Damaged("a damaged chunk") from error
    if compression == b"":
        return data
    raise Damaged("a chunk of unknown compression")


def beginning(body):
    """Block of what can be had of a chunk whose end is missing, or None."""
    try:
        head = chunk_head(body)
    except Damaged:
        return None
    data, start = b"", head.data_start
    if head.compression == b"":
        data = body[start:]
    elif head.compression == b"zstd":
        parts, left = [], min(head.size, LARGEST)
        decompress = zstandard.ZstdDecompressor(max_window_size=LARGEST).decompressobj().decompress
        try:
            while left > 0 and start < len(body):
                # A little at a time: a byte may become 32 KiB.
                parts.append(decompress(body[start : start + 64]))
                left -= len(parts[-1])
                start += 64
        except (zstandard.ZstdError, MemoryError):
            pass
        data = b"".join(parts)[: head.size]
    try:
        block = block_of(data, is_whole=False)
    except Damaged:
        return None
    return block if block.definitions or block.starts else None


def block_of(data, is_whole=True):
    """Block of uncompressed records; what follows the last whole one is left out, or Damaged."""
    definitions, starts, ends, at, size = [], array("I"), array("I"), 0, len(data)
    while at + RECORD.size <= size:
        opcode, length = RECORD.unpack_from(data, at)
        start, end = at + RECORD.size, at + RECORD.size + length
        if end > size:
            break
        if opcode == Opcode.MESSAGE:
            if length < _MESSAGE.size:
                raise Damaged("a damaged message")
            starts.append(start)
            ends.append(end)
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            definitions.append(parsed(KINDS[opcode], data[start:end]))
        elif opcode < 0x80:
            raise Damaged("a chunk with a record that does not belong in it")
        at = end
    if is_whole and at != size:
        raise Damaged("a chunk whose last record is not whole")
    return Block(definitions, starts, ends, data, is_whole)


def attachment_of(body):
    """AttachmentPiece of a record, or Damaged."""
    if len(body) < _ATTACHMENT.size + 4:
        raise Damaged("a damaged attachment")
    log_time, create_time, at = _ATTACHMENT.unpack_from(body)
    stream = _Fields(BytesIO(body[16:]))
    try:
        name, media_type = stream.read_prefixed_string(), stream.read_prefixed_string()
        length = stream.read8()
    except Exception as error:  # likewise
        raise Damaged("a damaged attachment") from error
    at = 16 + stream.count
    if at + length + 4 != len(body):
        raise Damaged("a damaged attachment")
    (checksum,) = struct.unpack_from("<I", body, at + length)
    if checksum and zlib.crc32(body[:-4]) != checksum:
        raise Damaged(f"a damaged attachment, {name}")
    return AttachmentPiece(log_time, create_time, name, media_type, body[at : at + length])
