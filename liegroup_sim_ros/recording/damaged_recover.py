# SPDX-License-Identifier: Apache-2.0
"""Write a readable file from the intact records of a truncated or damaged one, for `recover`."""

import json
import os
from pathlib import Path

from mcap.records import Attachment, Metadata

from . import bag_metadata
from .damaged_survey import open_file
from .errors import RecordingError
from .mcap_records import Damaged
from .walk import MESSAGE, Walk, clean
from .write import LIBRARY
from .write_mcap import Chunk, McapFile

NOTE = "recovered"  # metadata record of a recovered file


def write_recovered(found, out):
    """Write all intact records of a surveyed file to a new one; returns the number of messages.

    Raises RecordingError; the new file is then removed.
    """
    out = Path(out)
    if out.suffix != ".mcap":
        raise RecordingError(f"{out}: the file name must end in .mcap")
    try:
        file = open(out, "xb")
    except FileExistsError:
        raise RecordingError(f"{out}: the file already exists; choose another name with -o") from None
    except (OSError, ValueError) as error:
        raise RecordingError(f"{out}: cannot be written: {getattr(error, 'strerror', None) or error}") from None
    try:
        with file:
            return _copy(found, file, out.name)
    except BaseException as error:
        os.unlink(out)
        if isinstance(error, OSError):
            raise RecordingError(f"{out}: cannot be written: {error.strerror or error}") from None
        if isinstance(error, Damaged):
            raise RecordingError(f"{found.path}: {error}: the file changed while it was read") from None
        raise


def _copy(found, file, name):
    new = McapFile(file, LIBRARY, clean(found.header.profile))
    schemas, channels = {}, {}  # ids in the old file -> in the new one
    chunk = Chunk()

    def end_chunk():
        nonlocal chunk
        new.write_chunk(chunk)
        chunk = Chunk()

    def channel(number):
        """New id of a channel; its definitions are written when first needed."""
        if number not in channels:
            old = found.channels[number]
            schema = old.schema
            if schema is not None and schema.id not in schemas:
                schemas[schema.id] = new.add_schema(schema.name, schema.encoding, schema.data)
            channels[number] = new.add_channel(
                old.topic, old.encoding, schemas[schema.id] if schema else 0, old.metadata
            )
        return channels[number]

    stream, size = open_file(found.path)
    with stream:
        for item in Walk(stream, size):
            if isinstance(item, Attachment):
                end_chunk()
                new.add_attachment(item.create_time, item.log_time, item.name, item.media_type, item.data)
            elif isinstance(item, Metadata):
                if item.name not in (NOTE, "rosbag2"):
                    new.add_metadata(item.name, item.metadata)
            else:
                data = item.data.tobytes()
                for start, size in zip(item.start.tolist(), item.size.tolist()):
                    number, sequence, log_time, publish_time = MESSAGE.unpack_from(data, start - MESSAGE.size)
                    if number in found.channels:
                        if chunk.ends_before(log_time):
                            end_chunk()
                        number = channels.get(number) or channel(number)
                        chunk.add(number, log_time, data[start : start + size], sequence, publish_time)
    for number in found.channels:  # including topics without messages
        channel(number)
    end_chunk()
    new.add_metadata(
        NOTE,
        {
            "from": found.path.name,
            "problems": json.dumps(list(found.problems)),
            "lost": json.dumps(found.lost),
            "unfinished": str(found.unfinished),
        },
    )
    topics = [(_topic_info(old), new.counts[channels[number]]) for number, old in found.channels.items()]
    new.add_metadata("rosbag2", bag_metadata.record_of_file(name, new.stamps, topics))
    new.finish()
    file.flush()
    return sum(new.counts.values())


def _topic_info(channel):
    """rosbag2's description of a topic, from the metadata of its channel."""
    return bag_metadata.topic_info(
        channel.topic, channel.type, channel.qos, channel.metadata.get("topic_type_hash", "")
    )
