# SPDX-License-Identifier: Apache-2.0
"""Intact records of a truncated or damaged MCAP file, from front to back.

Records are returned if their checksum is correct. The beginning of a truncated chunk at the end of
the file is also returned, marked as such. After damage, the scan continues at the next chunk with a
correct checksum. Sizes claimed by the file are not trusted: memory is bounded by LARGEST, time by
LARGEST_RATIO times the size of the file.

Source: mcap.dev specification, version 0.
"""

import struct
import zlib
from typing import NamedTuple

from mcap.opcode import Opcode
from mcap.records import Footer, Statistics
from mcap.writer import MCAP0_MAGIC

from .mcap_records import (
    CHUNK,
    GROWS,
    KINDS,
    LARGEST,
    LARGEST_RATIO,
    RECORD,
    Block,
    Damaged,
    attachment_of,
    beginning,
    block_of,
    chunk_data,
    chunk_head,
    parsed,
    read_magic,
)

_TRIES = 16  # the search for chunks reads at most this many times the file size

_FOOTER = RECORD.size + 20
_ZSTD = struct.pack("<I", 4) + b"zstd"  # present in every chunk of the recorder


class Damage(NamedTuple):
    """A damaged part of the file; it is skipped."""

    text: str


class End(NamedTuple):
    """The end of a finished file."""

    definitions: list  # Schema and Channel of the summary
    statistics: object  # Statistics, or None


def pieces(stream, size):
    """Generator of the intact records of an MCAP file, in file order.

    stream : seekable binary stream of `size` bytes
    yields Header, Metadata, AttachmentPiece, Block, Damage and, last, End if the file is finished
    raises Damaged if the file is not an MCAP file
    """
    stream.seek(0)
    read_magic(stream)
    search = _Search(stream, size)
    budget = LARGEST + LARGEST_RATIO * size
    good_end = at = len(MCAP0_MAGIC)  # everything before good_end is intact
    while True:
        try:
            opcode, length, is_cut = _next_record(stream, at, size)
        except Damaged as damage:
            found = search.next_chunk(max(good_end, search.done))
            if found is None:
                if at < size:
                    yield Damage(str(damage))
                return
            yield Damage("damaged bytes between two chunks")
            good_end = at = found
            continue
        start, end = at + RECORD.size, at + RECORD.size + length
        if is_cut:
            found = search.next_chunk(max(good_end, search.done))
            if found is not None:
                yield Damage("a damaged record")
                good_end = at = found
                continue
            if opcode == Opcode.CHUNK:
                stream.seek(start)
                block = beginning(stream.read(min(size - start, LARGEST)))
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
                    raise Damaged(GROWS)
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
    """(opcode, length, whether it is truncated) of the record at an offset."""
    stream.seek(at)
    head = stream.read(RECORD.size)
    if len(head) < RECORD.size:
        return 0, 0, True
    opcode, length = RECORD.unpack(head)
    if opcode == 0 or Opcode.DATA_END < opcode < 0x80 or opcode == Opcode.DATA_END and length != 4:
        raise Damaged("bytes that are not a record")
    return opcode, length, at + RECORD.size + length > size


def _piece(stream, opcode, start, length):
    """Content of a record, or None for an index record. Raises Damaged."""
    if opcode not in KINDS:
        return None
    if length > LARGEST:
        raise Damaged(f"a record of {length} bytes; the limit is {LARGEST}")
    stream.seek(start)
    body = stream.read(length)
    if opcode == Opcode.CHUNK:
        return block_of(_chunk_data(body))
    if opcode == Opcode.ATTACHMENT:
        return attachment_of(body)
    if opcode in (Opcode.HEADER, Opcode.METADATA):
        return parsed(KINDS[opcode], body)
    return block_of(RECORD.pack(opcode, length) + body)


def _chunk_data(body):
    head = chunk_head(body)
    return chunk_data(head, body[head.data_start : head.data_start + head.length])


def _fits_itself(stream, opcode, start, length):
    """Whether the sizes in a damaged record agree with its length.

    If they agree, the next record begins at the end of this length.
    """
    stream.seek(start)
    if opcode != Opcode.CHUNK:
        return opcode != Opcode.ATTACHMENT
    try:
        head = chunk_head(stream.read(min(length, 256)))
    except Damaged:
        return False
    return head.data_start + head.length == length


def summary_of(stream, size):
    """End of a file with a readable summary; the rest may be damaged. Raises Damaged."""
    stream.seek(max(0, size - len(MCAP0_MAGIC) - _FOOTER))
    footer = stream.read(_FOOTER)
    if len(footer) < _FOOTER:
        raise Damaged("the end of the file is damaged")
    at = parsed(Footer, footer[RECORD.size :]).summary_start - 4 - RECORD.size
    if at < 0 or at > size or _next_record(stream, at, size)[:2] != (Opcode.DATA_END, 4):
        raise Damaged("the end of the file is damaged")
    return _end(stream, at, size, check_data=False)


def _end(stream, at, size, check_data=True):
    """End of a file whose data end at an offset. Raises Damaged if anything after the offset is damaged."""
    stream.seek(at + RECORD.size)
    tail_start = size - len(MCAP0_MAGIC) - _FOOTER
    summary_start = at + RECORD.size + 4
    if tail_start < summary_start or tail_start - summary_start > LARGEST:
        raise Damaged("the end of the file is damaged")
    (data_checksum,) = struct.unpack("<I", stream.read(4))
    summary, footer = stream.read(tail_start - summary_start), stream.read(_FOOTER)
    if stream.read() != MCAP0_MAGIC or RECORD.unpack_from(footer) != (Opcode.FOOTER, 20):
        raise Damaged("the end of the file is damaged")
    footer_record = parsed(Footer, footer[RECORD.size :])
    checksum = footer_record.summary_crc
    if checksum and zlib.crc32(summary + footer[:-4]) != checksum:
        raise Damaged("the summary is damaged")
    if summary and footer_record.summary_start != summary_start:
        raise Damaged("the footer does not point to the summary")
    if check_data and data_checksum and _checksum(stream, at) != data_checksum:
        raise Damaged("wrong checksum of the data")
    definitions, statistics, place = [], None, 0
    while place + RECORD.size <= len(summary):
        opcode, length = RECORD.unpack_from(summary, place)
        place += RECORD.size
        if place + length > len(summary):
            raise Damaged("the summary is damaged")
        body = summary[place : place + length]
        if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            definitions.append(parsed(KINDS[opcode], body))
        elif opcode == Opcode.STATISTICS:
            statistics = parsed(Statistics, body)
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
    """Search for chunks with correct checksums, compressed with zstd as the recorder's are."""

    def __init__(self, stream, size):
        self._stream, self._size = stream, size
        self._left = _TRIES * size + 2**20  # bytes that the search may read
        self.done = 0  # no chunk begins before this offset

    def next_chunk(self, at):
        """Offset of the first chunk at or after an offset, or None."""
        stream, lead = self._stream, RECORD.size + CHUNK.size - 4
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
            head = chunk_head(body)
            self._left -= max(length, head.size // LARGEST_RATIO)
            if head.data_start + head.length != length or not head.checksum:
                return False
            block_of(_chunk_data(body))
            return True
        except Damaged:
            return False
