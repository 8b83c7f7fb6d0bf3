# SPDX-License-Identifier: Apache-2.0
"""Recorder of a simulation run: self-contained MCAP files that `ros2 bag` and other tools open.

The caller's thread packs messages into chunks. The recorder's own thread compresses and writes
whole chunks. The two threads therefore seldom wait for each other. Passing single messages would
interrupt the simulation a thousand times a second, which costs more than the recording itself.

A chunk ends when it reaches CHUNK_SIZE, and `flush_interval` seconds of wall time after the last
flush. Every write goes straight to the operating system. A killed process loses at most that
interval (test_recorder.py), and closed chunks are readable without the end of the file. Chunks
end between two instants, so they do not overlap in time. `save` writes the messages of the present chunk behind the
others; the finished chunk takes their place.

log_time = publish_time = the stamp of the message, simulated time in ns. Sequence numbers count
from 1 in each channel and continue over the parts of a recording. A full disk ends the recording,
not the simulation: `failure` holds the error, `lost` counts the messages. So does the removal, replacement or
truncation of the file while it is written: every flush and the end check for that.

Source: mcap.dev specification, profile "ros2"; rosbag2 bag metadata version 9.
"""

import atexit
import logging
import threading
import time
from collections import deque

from liegroup_sim_ros.messages import schemas
from liegroup_sim_ros.numbers import counted
from liegroup_sim_ros.version import __version__

from .bag_metadata import FILE_NAME, BagMetadata, as_yaml, record_of_file, topic_info
from .errors import FileLostError, RecorderError
from .write_files import new_file_path, part_path, reason, refuse_old_parts
from .write_mcap import Chunk, McapFile, UnbufferedFile

QUEUE_BYTES = 64 * 2**20  # largest size of the queue; limits it if messages are large
LIBRARY = f"liegroup_sim_ros/{__version__}"
_IDLE = 5e-3  # s between two checks of the queue
_INSTANT = 20e-3  # s of wall time in which all messages of an instant arrive

_log = logging.getLogger(__name__)


class Recorder:
    """Writer of messages to one new MCAP file, or to several in sequence.

    path           : new file *.mcap, whose folder is created; or an existing folder, in which the
                     file is named by the wall time. `.path` is the current file
    attachments    : {name: (media_type, bytes)}, written first
    metadata       : {name: {key: text}}, written to every file
    queue_size     : messages that may be queued before `write` blocks; QUEUE_BYTES also applies
    flush_interval : s of wall time, the most that a killed process loses
    max_size       : file size in bytes from which on a new part is due, 0: no limit
    max_duration   : duration in ns of stamps from which on a new part is due, 0: no limit
    part           : number of the first part; part 2 of run.mcap is run_part2.mcap
    bag            : BagMetadata that the files are added to and whose metadata.yaml is written to
                     their folder; True: a new bag; None: no metadata.yaml
    continues      : True: the simulation continues after a failure, which is logged; False: the caller ends it

    Counters: `written` messages in closed chunks of the files, `queued` messages, `lost` messages
    (0 unless there was a failure), `bytes` in the current file. `failure`: None or one line of
    text; `is_lost`: the reason is that the file was removed, replaced or truncated. A `with` block closes
    the recorder. Raises RecorderError.
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
        continues=True,
    ):
        self.path = new_file_path(path)
        self.part, self._first_path = part, part_path(self.path, part, 1)
        self.bag = BagMetadata() if bag is True else bag
        if max_size or max_duration:
            refuse_old_parts(self.path, part)
        if bag is True and (self.path.parent / FILE_NAME).exists():
            raise RecorderError(
                f"cannot record to {self.path}: the folder already contains a rosbag2 bag "
                f"({FILE_NAME}); choose another folder"
            )
        self.written = 0
        self.lost = 0
        self.failure, self.is_lost = None, False
        self._continues = continues
        self._metadata = metadata or {}
        self._channels = []
        self._schema_ids = {}  # message type -> schema id in the present file
        self._chunk = Chunk()  # under construction
        self._queue = deque()  # chunks, and functions for the recorder's thread
        self._disk = threading.Lock()  # of the file and of the front of the queue; taken before the other one
        self._lock = threading.Lock()  # of the chunk and of the end of the queue
        self._queue_size = queue_size
        self._submitted = 0  # messages passed to `write` so far
        self._bytes_in = self._bytes_out = 0  # of all chunks queued, and taken from the queue
        self._flush_interval = flush_interval
        self._flush_at = time.monotonic() + flush_interval
        self._flushing = None  # the chunk that is to end with the current instant
        self._max_size, self._max_duration = max_size, max_duration
        self._part_since = None  # stamp, ns; None: no sample yet
        self._is_dividing = False
        self._closing = threading.Event()
        self._closed = False
        self._file = None
        try:
            self._open(self.path, attachments or {})
        except FileExistsError:
            raise RecorderError(
                f"cannot record to {self.path}: the file already exists; remove it or choose another name"
            ) from None
        except OSError as error:
            if self._file is not None:  # its first records do not fit on the disk
                self._file.close()
                self.path.unlink()
            raise RecorderError(f"cannot record to {self.path}: {reason(error)}") from None
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()
        atexit.register(self.close)  # also if the program ends by an exception

    def __enter__(self):
        return self

    def __exit__(self, *exception):
        self.close()

    @property
    def queued(self):
        return self._submitted - self.written - self.lost

    @property
    def bytes(self):
        return self._file.tell()

    @property
    def sequences(self):
        """{topic: sequence number of its last message}."""
        return {channel.info["name"]: channel.sequence for channel in self._channels}

    def part_path(self, part):
        """Path of a part of the recording."""
        return part_path(self._first_path, 1, part)

    def add_channel(self, topic, msg_type, qos="reliable", depth=10):
        """Add a channel; returns its number for `write`.

        msg_type such as "geometry_msgs/msg/PoseStamped"; qos and depth as in schemas.qos_profile.
        Raises RecorderError if the type is not installed.
        """
        try:
            channel = _Channel(
                topic_info(topic, msg_type, [schemas.qos_profile(qos, depth)], schemas.type_hash(msg_type)),
                schemas.definition(msg_type).encode(),
            )
        except schemas.SchemaError as error:
            raise RecorderError(f"cannot record {topic}: {error}") from None
        with self._disk, self._lock:
            self._channels.append(channel)
            channel.id = len(self._channels)
            self._add_to_file(channel)
            return channel.id - 1

    def write(self, channel, stamp_ns, data):
        """Record one serialized message, from any thread.

        Blocks while the queue is full, unless the recording has failed. Raises no disk errors.
        """
        if self._is_full():
            self._wait_for_queue(stamp_ns)
        channel = self._channels[channel]
        with self._lock:  # sequence numbers in the order of the chunks
            self._submitted += 1
            if self._closed or self.failure is not None:
                self.lost += 1
                return
            chunk = self._chunk
            if chunk.ends_before(stamp_ns):
                self._close_chunk()
                chunk = self._chunk
            channel.sequence += 1
            chunk.add(channel.id, stamp_ns, data, channel.sequence & 0xFFFFFFFF)

    def save(self):
        """Write all messages so far to the file before this returns. Raises no disk errors."""
        while self._is_dividing and self.failure is None:  # messages of a part that is not open yet
            time.sleep(_IDLE)
        with self._disk:
            with self._lock:
                items = [*self._queue, self._chunk]
            for chunk in items:
                if isinstance(chunk, Chunk):
                    self._attempt(lambda chunk=chunk: self._mcap.save(chunk))

    def _wait_for_queue(self, stamp_ns):
        with self._lock:
            if self._chunk.count and not self._chunk.may_end_before(stamp_ns):
                return  # an instant is not divided
        while self._is_full() and not self._closed:
            with self._lock:  # in every iteration: another thread may have filled the next chunk
                self._close_chunk()
            time.sleep(_IDLE)

    def _is_full(self):
        return self.queued >= self._queue_size or self._bytes_in - self._bytes_out > QUEUE_BYTES

    def _close_chunk(self):
        """Queue the current chunk and begin another one. The caller holds the lock."""
        if self._chunk.count:
            self._bytes_in += self._chunk.size
            self._queue.append(self._chunk)
            self._chunk = Chunk()

    def _in_order(self, action):
        """Run a function in the recorder's thread, after all messages so far are written."""
        with self._lock:
            self._close_chunk()
            self._queue.append(action)

    def add_attachment(self, name, media_type, data):
        """Add an attachment, usually at the end of a part or of the run."""
        self._in_order(lambda: self._mcap.add_attachment(time.time_ns(), self._mcap.stamps[1], name, media_type, data))

    def is_part_due(self, stamp_ns):
        """Whether the current part has reached its size or, at this stamp, its duration."""
        if self._part_since is None:
            self._part_since = stamp_ns
        if self._is_dividing or self.failure or not (self._max_size or self._max_duration):
            return False
        return bool(
            self._max_size
            and self.bytes >= self._max_size
            or self._max_duration
            and stamp_ns - self._part_since >= self._max_duration
        )

    def divide(self, stamp_ns, attachments):
        """Continue in a new file, the next part, which begins with a stamp.

        attachments : {name: (media_type, bytes)} of the new file
        """
        self._is_dividing, self._part_since = True, stamp_ns
        self.part += 1
        path = self.part_path(self.part)

        def open_next():
            self._finish(is_last=False)
            self._file.close()
            self._open(path, attachments)
            self.path = path
            for channel in self._channels:
                self._add_to_file(channel)
            self._is_dividing = False

        self._in_order(open_next)

    def close(self):
        """Write all queued messages and finish the file. Further calls do nothing.

        Messages passed to `write` later are not in the file and count as `lost`.
        """
        self._closing.set()
        self._thread.join()
        atexit.unregister(self.close)
        self.lost = self._submitted - self.written  # including those that arrived while the thread ended

    # The methods below run in the recorder's thread.

    def _open(self, path, attachments):
        self._file = UnbufferedFile(path)
        self._mcap = McapFile(self._file, LIBRARY)
        self._earlier, self._schema_ids = self.written, {}
        for name, (media_type, data) in attachments.items():
            self._mcap.add_attachment(time.time_ns(), 0, name, media_type, data)
        for name, entries in self._metadata.items():
            self._mcap.add_metadata(name, entries)

    def _add_to_file(self, channel):
        """Define a channel in the file; the order, and so its id, is the same in every part."""
        info = channel.info
        if info["type"] not in self._schema_ids:
            self._schema_ids[info["type"]] = self._mcap.add_schema(info["type"], "ros2msg", channel.definition)
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
        while not self._closed:
            if self._closing.is_set():
                with self._disk, self._lock:
                    self._close_chunk()
                    self._closed = True
            else:
                self._flush(time.monotonic())
            self._write_queued()
            if not self._queue:
                self._closing.wait(_IDLE)
        self._attempt(self._finish)
        self._file.close()

    def _flush(self, now):
        """End the chunk with the current instant if a flush is due.

        `write` ends it at the next stamp. If none arrives within _INSTANT, it ends here.
        """
        if now >= self._flush_at:
            self._flush_at, self._flush_by = now + self._flush_interval, now + _INSTANT
            with self._disk:
                self._attempt(self._file.check)
            if self._chunk.count:
                self._flushing = self._chunk
                self._flushing.limit = 0
        if self._flushing is not None and now >= self._flush_by:
            with self._lock:
                if self._chunk is self._flushing:
                    self._close_chunk()
            self._flushing = None

    def _write_queued(self):
        for _ in range(len(self._queue)):
            with self._disk:
                item = self._queue.popleft()
                if not isinstance(item, Chunk):
                    self._attempt(item)
                    continue
                self._attempt(lambda item=item: self._write_chunk(item))
                self._bytes_out += item.size

    def _write_chunk(self, chunk):
        self._mcap.write_chunk(chunk)
        self.written += chunk.count

    def _finish(self, is_last=True):
        mcap = self._mcap
        topics = [(channel.info, mcap.counts.get(channel.id, 0)) for channel in self._channels]
        mcap.add_metadata("rosbag2", record_of_file(self.path.name, mcap.stamps, topics))
        mcap.finish()
        self._file.check()
        if self.bag is not None:
            self.bag.add_file(self.path.name, mcap.stamps, topics)
            if is_last or self.bag.is_due():
                self.bag.write(self.path.parent)

    def _attempt(self, action):
        """Run a function unless the recording has failed."""
        if self.failure is None:
            try:
                action()
            except Exception as error:
                self._fail(error)

    def _fail(self, error):
        """End the recording. Whatever the error is, the simulation continues."""
        with self._lock:
            # Other messages of the last chunk may be there, too.
            self.is_lost = isinstance(error, FileLostError)
            here = 0 if self.is_lost else sum(self._mcap.counts.values())
            self.written = self._earlier + here
            name = getattr(error, "filename", None)
            self.failure = (
                f"recording to {self.path} stopped after {counted(self.written, 'message')}: "
                f"{reason(error)}"
                f"{f': {name}' if name else ''}"
                + ("; the simulation continues without recording" if self._continues else "")
            )
            self._chunk = Chunk()
            self.lost = self._submitted - self.written
        if self._continues:
            _log.error(self.failure)


class _Channel:
    """A topic: id, last sequence number, metadata and message definition."""

    def __init__(self, info, definition):
        self.id = None  # the same in every file
        self.sequence = 0
        self.info, self.definition = info, definition
