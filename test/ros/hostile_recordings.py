# SPDX-License-Identifier: Apache-2.0
"""Files that are no recordings, or that claim and unpack to more than they should, for the tests."""

import json
import random
import struct
import zlib

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import Attachment, Channel, Chunk, Metadata, Schema
from mcap.writer import MCAP0_MAGIC

from liegroup_sim_ros.recording.mcap_records import LARGEST

EVIL = "<script>alert(1)</script>\x1b[31m\n[bold red]"


def record(kind):
    """Bytes of an MCAP record."""
    builder = RecordBuilder()
    kind.write(builder)
    return builder.end()


def chunk(packed, size, crc=0, compression="zstd"):
    """Chunk that claims to unpack to a size."""
    stamps = {"message_start_time": 1, "message_end_time": 1}
    return record(Chunk(compression=compression, data=packed, uncompressed_crc=crc, uncompressed_size=size, **stamps))


def channel(number, topic, schema=0):
    return record(Channel(id=number, topic=topic, message_encoding="cdr", metadata={}, schema_id=schema))


def attachment(name, data=b"", media="x"):
    return record(Attachment(0, 0, name, media, data))


def bomb(size, chunks, noise=0, payload=0):
    """Small chunks that decompress to a large size, with messages of undeclared channels."""
    data = struct.pack("<BQHIQQ", 5, 22 + noise, 1, 1, 1, 1) + random.Random(3).randbytes(noise)
    message = struct.pack("<BQHIQQ", 5, 22 + payload, 1, 1, 1, 1) + bytes(payload)
    data += message * ((size - len(data)) // len(message))
    return chunk(zstandard.compress(data, 19), len(data), zlib.crc32(data)) * chunks


def zeros_that_claim_nothing(size):
    """zstd stream without a content size."""
    compressor = zstandard.ZstdCompressor(level=3).compressobj()
    return b"".join([*(compressor.compress(bytes(2**20)) for _ in range(size // 2**20)), compressor.flush()])


SETTINGS = {
    "format": 1,
    "scene": EVIL,
    "step": {},
    "promise": {"accuracy": 10**400, "horizon": 1, "length": 1},
    "sequences": {"/a": -1, "/b": "x"},
    "part": [1],
}
NO_FILES = {
    "nothing": b"",
    "text": b"#!/bin/sh\n",
    "magic only": MCAP0_MAGIC,
    "noise": MCAP0_MAGIC + random.Random(1).randbytes(300_000),
}
# Functions that make what follows the magic bytes: some take seconds.
CONTENTS = {
    "huge length": lambda: b"\x06" + b"\xff" * 8 + bytes(50),
    "huge attachment": lambda: b"\x09" + struct.pack("<Q", 2**62) + bytes(50),
    "attachment of huge parts": lambda: struct.pack("<BQ", 9, 100) + b"\xff" * 100,
    "attachments of huge names": lambda: (struct.pack("<BQQQI", 9, 40, 0, 0, 2**32 - 1) + bytes(20)) * 5000,
    "chunk of a huge length": lambda: (
        b"\x06" + struct.pack("<QQQQII", 40, 0, 1, 2**62, 0, 4) + b"zstd" + struct.pack("<Q", 2**62)
    ),
    "chunk of no compression that exists": lambda: chunk(bytes(100), 100, compression="none"),
    "many bombs": lambda: bomb(LARGEST - 100, 200),
    # Each for itself within what a chunk may claim, all together not.
    "many chunks that grow": lambda: attachment("a", media="b") + bomb(LARGEST - 100, 4, noise=80_000, payload=1000),
    "short message": lambda: (
        channel(1, "/a")
        + struct.pack("<BQHIQQ", 5, 22, 1, 1, 1, 1)
        + struct.pack("<BQI", 5, 4, 0)
        + struct.pack("<BQHIQQ", 5, 22, 1, 2, 2, 2)
    ),
    "length beyond its record": lambda: struct.pack("<BQHIIIH", 3, 16, 1, 0, 0, 2**32 - 1, 0) + channel(1, "/a", 1),
    "bomb that claims 2^60": lambda: chunk(zeros_that_claim_nothing(2**28), 2**60),
    "bomb that claims little": lambda: chunk(zeros_that_claim_nothing(2**28), 9),
    "frame that claims 2^60": lambda: chunk(b"\x28\xb5\x2f\xfd\xe0" + struct.pack("<Q", 2**60) + bytes(100), 100),
    "cut bomb": lambda: chunk(zeros_that_claim_nothing(2**30), 2**62)[:-9],
    "chunk marks": lambda: (
        (b"\x06" + struct.pack("<Q", 200_000) + bytes(28) + b"\x04\0\0\0zstd" + struct.pack("<Q", 199_952)) * 8000
    ),
    "zero records": lambda: bytes(2_000_000),
    "unknown records": lambda: struct.pack("<BQ", 0xFF, 0) * 200_000,
    "many attachments": lambda: attachment("a", media="b") * 100_000,
    "many channels": lambda: b"".join(channel(i, f"/{i}" + "x" * 300) for i in range(1, 60_000)),
    "names": lambda: (
        record(Schema(id=1, data=b"", encoding="ros2msg", name=EVIL))
        + channel(1, EVIL, 1)
        + attachment(EVIL, b"x", EVIL)
        + record(Metadata(EVIL, {EVIL: EVIL}))
    ),
    "deep JSON": lambda: attachment("settings.json", b"[" * 500_000),
    "nested JSON": lambda: attachment("settings.json", b'{"machine": ' * 400 + b"1" + b"}" * 400),
    "numbers of no JSON": lambda: attachment("settings.json", b'{"format": 1, "step": NaN, "machine": 1e999}'),
    "odd JSON": lambda: (
        attachment("settings.json", json.dumps(SETTINGS).encode())
        + attachment("initial_state.json", b'{"steps": "many", "bodies": 7}')
    ),
}
HOSTILE = (*NO_FILES, *CONTENTS)  # names


def hostile(name):
    """Bytes of a file."""
    return NO_FILES[name] if name in NO_FILES else MCAP0_MAGIC + CONTENTS[name]()
