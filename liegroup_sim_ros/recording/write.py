# SPDX-License-Identifier: Apache-2.0
"""Recorder of a simulation run: self-contained MCAP files that `ros2 bag` and others open.

Messages are packed into chunks by the caller; the recorder's own thread, the only one to touch the
file, compresses and writes whole chunks. So the two seldom wait for each other: a thread that had
to do something for every message took the interpreter from the simulation a thousand times a
second, which cost more than the recording. A chunk is closed when it reaches CHUNK_SIZE and, if
messages are in it, when `flush_interval` seconds of wall time have passed; every write goes
straight to the operating system. So a process that is killed loses at most that interval
(test_recorder.py), and what is in closed chunks can be read without the file's end.

log_time = publish_time = the message's stamp, simulation time in ns; sequence numbers count from 1
in every channel, on and on over the parts of a recording. A full disk ends the recording, not the
simulation: `failure` says it, `lost` counts.

Source: mcap.dev specification, profile "ros2"; rosbag2 bag metadata version 9.
"""

import atexit
import logging
import re
import threading
import time
from collections import deque
from pathlib import Path

from liegroup_sim_ros import __version__
from liegroup_sim_ros.messages import schemas

from .bag_metadata import FILE_NAME, Bag, as_yaml, record_of_file, topic_info
from .write_mcap import Chunk, McapFile

CHUNK_SIZE = 128 * 1024  # bytes before compression; more than nearly all messages have
QUEUE_BYTES = 64 * 2**20  # that may wait, for messages so large that few fit
LIBRARY = f"liegroup_sim_ros/{__version__}"
_IDLE = 5e-3  # s between looks at the queue

_log = logging.getLogger(__name__)


class RecorderError(Exception):
    """The recording cannot be started; one line of text for the user, exit code 2."""


class Recorder:
    """Writes messages to a new MCAP file, or to one after the other.

    path           : *.mcap, must not exist, its folder is made; or an existing folder, in which
                     the file gets a name with the wall time. `.path` is the present file
    attachments    : {name: (media_type, bytes)}, the first things in the file
    metadata       : {name: {key: text}}, in every file
    queue_size     : messages that may wait before `write` waits; QUEUE_BYTES bounds them, too
    flush_interval : s of wall time that a killed process can lose
    max_size       : bytes after which a part is due to end, 0: never
    max_duration   : ns of stamps after which it is, 0: never
    part           : number of the first part; part 2 of run.mcap is run_part2.mcap
    bag            : Bag that the files are added to, and whose metadata.yaml is kept beside them;
                     True: a new one; None: no metadata.yaml

    Counters: `written` messages in closed chunks of the files, `queued` waiting, `lost` not in a
    file (0 unless there was a failure), `bytes` in the present file. `failure`: None or one line
    of text, also logged once. `with Recorder(...) as recorder:` closes it at the end. Raises
    RecorderError.
    """

    def __init__(
        self,
        path,
        attachments=None,
        metadata=None,
        queue_size=20000,
        flush_interval=1.0,
        max_size=0,
        max_duration=0,
        part=1,
        bag=None,
    ):
        self.path = _new_file_path(path)
        self.part = part
        self._stem = self.path.stem if part == 1 else self.path.stem.removesuffix(f"_part{part}")
        self.bag = Bag() if bag is True else bag
        if max_size or max_duration:
            self._refuse_old_parts()
        if bag is True and (self.path.parent / FILE_NAME).exists():
            raise RecorderError(
                f"cannot record to {self.path}: its folder is a bag already, it "
                f"has a {FILE_NAME}; choose another folder"
            )
        self.written = 0
        self.lost = 0
        self.failure = None
        self._metadata = metadata or {}
        self._channels, self._registered = [], []
        self._schema_ids = {}  # message type -> schema id in the present file
        self._chunk = Chunk()  # under construction
        self._queue = deque()  # chunks, and functions that add a channel or so
        self._lock = threading.Lock()  # of the chunk and of those who fill the queue
        self._queue_size = queue_size
        self._given = 0  # messages that came so far
        self._bytes_in = self._bytes_out = 0  # of chunks that went into the queue, and out
        self._flush_interval = flush_interval
        self._max_size, self._max_duration = max_size, max_duration
        self._part_since = None  # stamp, ns; None: no sample of this part yet
        self._dividing = False
        self._closing = threading.Event()
        self._closed = False
        try:
            self._open(self.path, attachments or {})
        except FileExistsError:
            raise RecorderError(
                f"cannot record to {self.path}: it exists already; remove it or choose another name"
            ) from None
        except OSError as error:
            raise RecorderError(f"cannot record to {self.path}: {_reason(error)}") from None
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()
        atexit.register(self.close)  # a program that ends by an exception, too

    def __enter__(self):
        return self

    def __exit__(self, *exception):
        self.close()

    def _refuse_old_parts(self):
        pattern = re.compile(re.escape(self._stem) + r"_part[0-9]+\.mcap")
        old = sorted(
            entry.name
            for entry in self.path.parent.iterdir()
            if pattern.fullmatch(entry.name) and self.part == 1
        )
        if old:
            raise RecorderError(
                f"cannot record to {self.path}: {old[0]} is in the way of its "
                f"parts; remove it or choose another name"
            )

    @property
    def queued(self):
        return self._given - self.written - self.lost

    @property
    def bytes(self):
        return self._file.tell()

    @property
    def sequences(self):
        """{topic: sequence number of its last message so far}."""
        return {channel.info["name"]: channel.sequence for channel in self._channels}

    def part_path(self, part):
        """Path of a part."""
        return self.path.with_name(
            f"{self._stem}_part{part}.mcap" if part > 1 else f"{self._stem}.mcap"
        )

    def add_channel(self, topic, msg_type, qos="reliable", depth=10):
        """Number of a new channel, for `write`; at any time, from one thread.

        msg_type such as "geometry_msgs/msg/PoseStamped"; qos and depth as in schemas.qos_profile.
        Raises RecorderError if the type is not installed.
        """
        try:
            channel = _Channel(
                topic_info(
                    topic, msg_type, [schemas.qos_profile(qos, depth)], schemas.type_hash(msg_type)
                ),
                schemas.definition(msg_type).encode(),
            )
        except schemas.SchemaError as error:
            raise RecorderError(f"cannot record {topic}: {error}") from None
        with self._lock:
            self._channels.append(channel)
            channel.id = len(self._channels)
            self._queue.append(lambda: self._register(channel))
            return channel.id - 1

    def write(self, channel, stamp_ns, data):
        """Take in one serialized message, from any thread.

        Waits while the queue is full, but not after a failure. Never raises for the disk.
        """
        if self._is_full():
            with self._lock:
                self._close_chunk()
            while self._is_full() and not self._closed:
                time.sleep(_IDLE)
        channel = self._channels[channel]
        with self._lock:  # numbers in the order of the chunks
            self._given += 1
            if self._closed or self.failure is not None:
                self.lost += 1
                return
            channel.sequence += 1
            self._chunk.add(channel.id, stamp_ns, data, channel.sequence & 0xFFFFFFFF)
            if self._chunk.size > CHUNK_SIZE:
                self._close_chunk()

    def _is_full(self):
        return self.queued >= self._queue_size or self._bytes_in - self._bytes_out > QUEUE_BYTES

    def _close_chunk(self):
        """What comes next goes into another chunk. The caller has the lock."""
        if self._chunk.count:
            self._bytes_in += self._chunk.size
            self._queue.append(self._chunk)
            self._chunk = Chunk()

    def _in_order(self, action):
        """Do something behind all that came so far, in the recorder's thread."""
        with self._lock:
            self._close_chunk()
            self._queue.append(action)

    def add_attachment(self, name, media_type, data):
        """Attach a file, usually at the end of a part or a run."""
        self._in_order(
            lambda: self._mcap.add_attachment(
                time.time_ns(), self._mcap.stamps[1], name, media_type, data
            )
        )

    def is_part_due(self, stamp_ns):
        """Whether the present part has reached its size or, at this stamp, its duration."""
        if self._part_since is None:
            self._part_since = stamp_ns
        if self._dividing or self.failure or not (self._max_size or self._max_duration):
            return False
        return bool(
            self._max_size
            and self.bytes >= self._max_size
            or self._max_duration
            and stamp_ns - self._part_since >= self._max_duration
        )

    def divide(self, attachments):
        """What is written from now on goes to a new file: the next part, with its attachments."""
        self._dividing, self._part_since = True, None
        self.part += 1
        path = self.part_path(self.part)

        def open_next():
            self._finish()
            self._file.close()
            self._open(path, attachments)
            self.path = path
            for channel in self._registered:  # others come out of the queue yet
                self._add_to_file(channel)
            self._dividing = False

        self._in_order(open_next)

    def close(self):
        """Write everything queued and finish the file; may be called again, from any thread.

        Messages that come later are not in the file and count as `lost`.
        """
        self._closing.set()
        self._thread.join()
        atexit.unregister(self.close)
        self.lost = self._given - self.written  # with those that came while the thread was ending

    # What follows runs in the recorder's thread.

    def _open(self, path, attachments):
        self._file = _File(path)
        self._mcap = McapFile(self._file, LIBRARY)
        self._earlier, self._schema_ids = self.written, {}
        for name, (media_type, data) in attachments.items():
            self._mcap.add_attachment(time.time_ns(), 0, name, media_type, data)
        for name, entries in self._metadata.items():
            self._mcap.add_metadata(name, entries)

    def _register(self, channel):
        self._registered.append(channel)
        self._add_to_file(channel)

    def _add_to_file(self, channel):
        """Its number in the file is the same in every part: they are added in their order."""
        info = channel.info
        if info["type"] not in self._schema_ids:
            self._schema_ids[info["type"]] = self._mcap.add_schema(
                info["type"], "ros2msg", channel.definition
            )
        self._mcap.add_channel(
            info["name"],
            "cdr",
            self._schema_ids[info["type"]],
            {
                "offered_qos_profiles": as_yaml(info["offered_qos_profiles"]),
                "topic_type_hash": info["type_description_hash"],
            },
        )

    def _run(self):
        flushed = time.monotonic()
        while True:
            closing = self._closing.is_set()  # asked first: then all there was is written below
            if closing or time.monotonic() - flushed > self._flush_interval:
                with self._lock:
                    self._close_chunk()
                flushed = time.monotonic()
            self._write_queued()
            if closing:
                break
            if not self._queue:
                self._closing.wait(_IDLE)
        self._attempt(self._finish)
        self._file.close()
        self._closed = True

    def _write_queued(self):
        for _ in range(len(self._queue)):
            item = self._queue.popleft()
            if not isinstance(item, Chunk):
                self._attempt(item)
                continue
            self._attempt(lambda item=item: self._write_chunk(item))
            self._bytes_out += item.size

    def _write_chunk(self, chunk):
        self._mcap.write_chunk(chunk)
        self.written += chunk.count

    def _finish(self):
        mcap = self._mcap
        topics = [(channel.info, mcap.counts.get(channel.id, 0)) for channel in self._channels]
        mcap.add_metadata("rosbag2", record_of_file(self.path.name, mcap.stamps, topics))
        mcap.finish()
        if self.bag is not None:
            self.bag.add_file(self.path.name, mcap.stamps, topics)
            self.bag.write(self.path.parent)

    def _attempt(self, action):
        """Run one step unless the recording has failed."""
        if self.failure is None:
            try:
                action()
            except Exception as error:
                self._fail(error)

    def _fail(self, error):
        """End the recording. Whatever the error is, the simulation goes on without it."""
        with self._lock:
            # A chunk whose index did not go into the file is there for a reader all the same.
            self.written = self._earlier + sum(self._mcap.counts.values())
            self.failure = (
                f"recording to {self.path} stopped after {self.written} messages: "
                f"{_reason(error)}{_where(error)}; the simulation goes on unrecorded"
            )
            self._chunk = Chunk()
            self.lost = self._given - self.written
        _log.error(self.failure)


class _Channel:
    """A topic: its number, its last sequence number, what is known of it."""

    def __init__(self, info, definition):
        self.id = None  # in every file
        self.sequence = 0
        self.info, self.definition = info, definition


class _File:
    """A new file without a buffer: what `write` returned from survives the process."""

    def __init__(self, path):
        self._raw = open(path, "xb", buffering=0)
        self._size = 0
        self.close = self._raw.close

    def write(self, data):
        rest = memoryview(data)
        while rest:  # the system may take a part, and refuse the next
            taken = self._raw.write(rest)
            self._size += taken
            rest = rest[taken:]

    def tell(self):
        return self._size

    def flush(self):
        """Nothing waits here."""


def _new_file_path(path):
    path = Path(path).expanduser()
    try:
        if path.is_dir():
            path /= time.strftime("recording_%Y_%m_%d-%H_%M_%S.mcap")
        elif path.suffix != ".mcap":
            raise RecorderError(
                f"cannot record to {path}: the name must end in .mcap, or be an existing folder"
            )
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RecorderError(f"cannot record to {path}: {_reason(error)}") from None
    return path


def _where(error):
    return f": {error.filename}" if getattr(error, "filename", None) else ""


def _reason(error):
    return getattr(error, "strerror", None) or f"{type(error).__name__}: {error}"
