# SPDX-License-Identifier: Apache-2.0
"""Single records of an MCAP file that may be damaged or hostile, for all readers of this folder.

Records with a wrong checksum are refused. Claimed sizes are not trusted, so memory is bounded by
LARGEST. walk.py passes over whole files.

Source: mcap.dev specification, version 0.
"""

import struct
import zlib
from io import BytesIO
from pathlib import Path
from typing import NamedTuple

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Header, Metadata, Schema
from mcap.writer import MCAP0_MAGIC

# Bytes of a record, and of a decompressed chunk. Chunks of the recorder have 128 KiB, those of
# other tools some MiB.
LARGEST = 64 * 2**20
# Each message has a stamp and a sequence number, so only a zip bomb exceeds this expansion.
MOST_EXPANSION = 1000
# Largest ratio of decompressed bytes above LARGEST to file size; recordings of bodies at rest reach 6.
LARGEST_RATIO = 100
GROWS = f"it claims to contain more than {LARGEST_RATIO} times its size; the rest is omitted"

RECORD = struct.Struct("<BQ")  # opcode, length of the content
CHUNK = struct.Struct("<QQQII")  # times, size, checksum, length of the compression name
TABLES = (".npz", ".csv", ".parquet")  # that `run` and `sweep` write


class Damaged(Exception):
    """Bytes that violate the format or its checksums."""


class DamagedLength(Damaged):
    """Sizes in a record that contradict its length."""


def read_magic(file):
    """Read what an MCAP file begins with. Raises Damaged for another file."""
    if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
        is_table = Path(str(getattr(file, "name", ""))).suffix in TABLES
        raise Damaged("not an MCAP file" + (": write one with `run --out FILE.mcap`" if is_table else ""))


class ChunkHead(NamedTuple):
    """Head of a chunk: what the chunk claims to contain."""

    first_ns: int  # stamps
    last_ns: int
    size: int  # bytes, decompressed
    checksum: int  # CRC-32 of the decompressed bytes; 0: none
    compression: bytes
    data_start: int  # offset in the record
    length: int  # bytes, in the file


# Records that are read, and the class of the library that parses them.
KINDS = {
    Opcode.HEADER: Header,
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.MESSAGE: None,
    Opcode.CHUNK: None,
    Opcode.ATTACHMENT: Attachment,
    Opcode.METADATA: Metadata,
}


class _Fields(ReadDataStream):
    """ReadDataStream that raises Damaged; the library returns fewer bytes without an error."""

    def read(self, length):
        data = super().read(length)
        if len(data) != length:
            raise Damaged("a length beyond the end of its record")
        return data


def parsed(kind, body):
    """Record parsed by a class of the library. Raises Damaged."""
    try:
        return kind.read(_Fields(BytesIO(body)))
    except Damaged:
        raise
    except Exception as error:  # a parser may raise any exception for damaged bytes
        raise Damaged(f"a damaged record ({kind.__name__})") from error


def chunk_head(body):
    """ChunkHead of a chunk; its first 56 bytes suffice. Raises Damaged."""
    if len(body) < CHUNK.size:
        raise DamagedLength("a damaged chunk")
    first_ns, last_ns, size, checksum, name_length = CHUNK.unpack_from(body)
    data_start = CHUNK.size + name_length + 8
    if name_length > 16 or len(body) < data_start:
        raise DamagedLength("a damaged chunk")
    compression = body[CHUNK.size : CHUNK.size + name_length]
    (length,) = struct.unpack_from("<Q", body, data_start - 8)
    return ChunkHead(first_ns, last_ns, size, checksum, compression, data_start, length)


def chunk_data(head, packed):
    """Decompressed records of a whole chunk. Raises Damaged."""
    if len(packed) != head.length:
        raise Damaged("a damaged chunk")
    check_claim(head)
    data = _decompressed(head.compression, packed, head.size)
    if len(data) != head.size or head.checksum and zlib.crc32(data) != head.checksum:
        raise Damaged("a damaged chunk")
    return data


def check_claim(head):
    """Raise Damaged if a chunk claims to contain more than messages can."""
    if max(head.size, head.length) > LARGEST or head.size > MOST_EXPANSION * max(head.length, 64):
        raise Damaged(f"a chunk of {head.length} bytes that claims to contain {head.size}")


def _decompressed(compression, data, size):
    """Decompressed bytes of a chunk, at most one more than its size."""
    if compression == b"zstd":
        try:
            # Not decompress(), which trusts the size claimed in the data.
            return zstandard.ZstdDecompressor(max_window_size=LARGEST).stream_reader(data).read(size + 1)
        except (zstandard.ZstdError, MemoryError) as error:
            raise Damaged("a damaged chunk") from error
    if compression == b"lz4":
        try:
            from lz4.frame import LZ4FrameDecompressor
        except ImportError:
            raise Damaged("a chunk compressed with lz4, which is not installed: pip install lz4") from None
        try:
            return LZ4FrameDecompressor().decompress(data, size + 1)
        except (RuntimeError, EOFError, MemoryError) as error:
            raise Damaged("a damaged chunk") from error
    if compression == b"":
        return data
    raise Damaged("a chunk of unknown compression")


def beginning(body):
    """Records at the readable beginning of a truncated chunk, bytes. Raises Damaged."""
    head = chunk_head(body)
    return _decompressed(head.compression, body[head.data_start :], min(head.size, LARGEST))[: head.size]


def attachment_of(body):
    """Attachment of a record. Raises Damaged."""
    stream = _Fields(BytesIO(body))
    try:
        found = Attachment.read(stream)
    except Exception as error:  # as in `parsed`
        raise DamagedLength("a damaged attachment") from error
    if stream.count != len(body):
        raise DamagedLength("a damaged attachment")
    (checksum,) = struct.unpack_from("<I", body, len(body) - 4)
    if checksum and zlib.crc32(body[:-4]) != checksum:
        raise Damaged(f"a damaged attachment, {found.name}")
    return found
