# SPDX-License-Identifier: Apache-2.0
"""`liegroup_sim recover`: out of a recording that was cut or damaged, one that every reader opens.

Exit code 0 when a file was written, or when there was nothing to recover; 2 with one line when the
file holds nothing, or the new one cannot be written.
"""

import json
import os
import sys
from pathlib import Path

import yaml
from rich.console import Console

from liegroup_sim_ros.recording import bag_metadata
from liegroup_sim_ros.recording.damaged_survey import Survey, clean, open_file, survey, walk
from liegroup_sim_ros.recording.mcap_records import Damaged
from liegroup_sim_ros.recording.read import RecordingError
from liegroup_sim_ros.recording.write import LIBRARY
from liegroup_sim_ros.recording.write_mcap import Chunk, McapFile

from .info import topics_table

NOTE = "recovered"  # metadata record of a file that was made here


def add_arguments(parser):
    """Arguments of the subcommand."""
    parser.description = (
        "Write a complete recording from one that is truncated (killed process, power "
        "failure, full disk) or damaged, and report what is missing. The file itself stays "
        "unchanged."
    )
    parser.add_argument("log", metavar="FILE", help="recording (*.mcap)")
    parser.add_argument(
        "-o",
        "--out",
        metavar="OUT",
        help="new file (default: beside FILE, with _recovered in its name)",
    )


def run(args):
    """Run the subcommand; returns the exit code. Raises RecordingError."""
    path = Path(args.log)
    out = Path(args.out) if args.out else path.with_name(f"{path.stem}_recovered.mcap")
    with Console(stderr=True).status("reading"):
        found = survey(path)
    if found.complete:
        print(
            f"{path}: is complete, {found.count} messages; there is nothing to recover"
            + (
                f"; {_sum(found.lost)} messages were lost before they were written"
                if found.lost
                else ""
            )
        )
        return 0
    with Console(stderr=True).status("writing"):
        written = write_recovered(found, out)
    for problem, times in found.problems.items():
        print(f"{path}: {problem}" + (f" ({times} times)" if times > 1 else ""))
    if found.unfinished:
        print(f"{path}: {found.unfinished} messages are out of a chunk whose end is missing")
    if not written:
        print(f"{out}: no message, only what came before them")
        return 0
    first, last = (stamp * 1e-9 for stamp in found.stamps)
    Console(file=sys.stdout).print(topics_table(found))
    print(
        f"{out}: {written} messages from {first:.9g} s to {last:.9g} s, "
        f"{_sum(found.lost)} before the last ones are missing; "
        + ("its end is there" if _has_end(found) else "what came after is lost")
    )
    return 0


def write_recovered(found, out):
    """Write a new file with all that is good in a surveyed one; returns the number of messages.

    Raises RecordingError; then the new file is not there.
    """
    out = Path(out)
    if out.suffix != ".mcap":
        raise RecordingError(f"{out}: the name must end in .mcap")
    try:
        file = open(out, "xb")
    except FileExistsError:
        raise RecordingError(
            f"{out}: the file already exists; choose another name with -o"
        ) from None
    except (OSError, ValueError) as error:
        raise RecordingError(
            f"{out}: cannot be written: {getattr(error, 'strerror', None) or error}"
        ) from None
    try:
        with file:
            return _copy(found, file, out.name)
    except BaseException as error:
        os.unlink(out)
        if isinstance(error, OSError):
            raise RecordingError(f"{out}: cannot be written: {error.strerror or error}") from None
        if isinstance(error, Damaged):
            raise RecordingError(f"{found.path}: {error}: it changes while it is read") from None
        raise


def _copy(found, file, name):
    new = McapFile(file, LIBRARY, clean(found.profile))
    schemas, channels = {}, {}  # ids in the old file -> in the new one
    chunk = Chunk()

    def end_chunk():
        nonlocal chunk
        new.write_chunk(chunk)
        chunk = Chunk()

    def channel(number):
        """The new id, with the definitions written when they are first needed."""
        if number not in channels:
            told = found.channels[number]
            schema = found.schemas.get(told.schema_id)
            if schema is not None and schema.id not in schemas:
                schemas[schema.id] = new.add_schema(schema.name, schema.encoding, schema.data)
            channels[number] = new.add_channel(
                told.topic, told.message_encoding, schemas.get(told.schema_id, 0), told.metadata
            )
        return channels[number]

    def copy_block(block):
        data = block.data
        for number, sequence, log_time, publish_time, start, end in block.messages():
            if number in found.channels:
                if chunk.ends_before(log_time):
                    end_chunk()
                chunk.add(
                    channels.get(number) or channel(number),
                    log_time,
                    data[start:end],
                    sequence,
                    publish_time,
                )

    def copy_attachment(piece):
        end_chunk()
        new.add_attachment(
            piece.create_time, piece.log_time, piece.name, piece.media_type, piece.data
        )

    def copy_metadata(piece):
        if piece.name not in (NOTE, "rosbag2"):
            new.add_metadata(piece.name, piece.metadata)

    stream, size = open_file(found.path)
    with stream:
        walk(stream, Survey(found.path, size), copy_block, copy_attachment, copy_metadata)
    for number in found.channels:  # topics without a message are there, too
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
    topics = [
        (_topic_info(found, told), new.counts[channels[number]])
        for number, told in found.channels.items()
    ]
    new.add_metadata("rosbag2", bag_metadata.record_of_file(name, new.stamps, topics))
    new.finish()
    file.flush()
    return sum(new.counts.values())


def _topic_info(found, channel):
    """What rosbag2 keeps of a topic, out of the metadata of its channel."""
    try:
        qos = yaml.safe_load(channel.metadata.get("offered_qos_profiles", ""))
    except (yaml.YAMLError, RecursionError, ValueError):
        qos = None
    schema = found.schemas.get(channel.schema_id)
    return bag_metadata.topic_info(
        channel.topic,
        schema.name if schema else "",
        qos if isinstance(qos, list) else [],
        channel.metadata.get("topic_type_hash", ""),
    )


def _has_end(found):
    return any(name == "pacing.json" for name, _, _ in found.attachments)


def _sum(lost):
    return sum(lost.values())
