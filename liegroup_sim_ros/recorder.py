# SPDX-License-Identifier: Apache-2.0
"""Recorder of a simulation run: one self-contained MCAP file that `ros2 bag` and others open.

Messages are queued by the caller and written by the recorder's own thread, the only one to touch
the file. A chunk is closed when it reaches CHUNK_SIZE and, if messages are waiting in it, when
`flush_interval` seconds of wall time have passed; every write goes straight to the operating
system. So a process that is killed loses at most that interval (test_recorder.py), and what is in
closed chunks can be read without the file's end.

log_time = publish_time = the message's stamp, simulation time in ns; sequence numbers count from 1
in every channel. A full disk ends the recording, not the simulation: `failure` says it, `lost`
counts.

Source: mcap.dev specification, profile "ros2"; rosbag2 bag metadata version 9.
"""

import atexit
import itertools
import logging
import threading
import time
from collections import deque
from pathlib import Path

import yaml

from liegroup_sim_ros import __version__, schemas
from liegroup_sim_ros.mcap_file import McapFile

CHUNK_SIZE = 128 * 1024       # bytes before compression; more than nearly all messages have
_IDLE = 5e-3                  # s between looks at the queue

_log = logging.getLogger(__name__)


class RecorderError(Exception):
    """The recording cannot be started; one line of text for the user, exit code 2."""


class Recorder:
    """Writes messages to a new MCAP file.

    path           : *.mcap, must not exist, its folder is made; or an existing folder, in which
                     the file gets a name with the wall time. `.path` is the file.
    attachments    : {name: (media_type, bytes)}, the first things in the file
    metadata       : {name: {key: text}}
    queue_size     : messages that may wait before `write` waits
    flush_interval : s of wall time that a killed process can lose

    Counters: `written` messages handed to the file, `queued` waiting, `lost` not in the file (0
    unless there was a failure), `bytes` in the file. `failure`: None or one line of text, also
    logged once. `with Recorder(...) as recorder:` closes it at the end. Raises RecorderError.
    """

    def __init__(self, path, attachments=None, metadata=None, queue_size=20000,
                 flush_interval=1.0):
        self.path = _new_file_path(path)
        self.written = 0
        self.lost = 0
        self.failure = None
        self._channels = []
        self._schema_ids = {}                  # message type -> schema id
        self._queue = deque()                  # messages, and functions that add a channel or so
        self._queue_size = queue_size
        self._flush_interval = flush_interval
        self._secured = 0                      # `written` at the last flush
        self._closing = threading.Event()
        self._closed = False
        try:
            self._file = _File(self.path)
            self._mcap = McapFile(self._file, f"liegroup_sim_ros/{__version__}", CHUNK_SIZE)
            for name, (media_type, data) in (attachments or {}).items():
                self._mcap.add_attachment(time.time_ns(), 0, name, media_type, data)
            for name, entries in (metadata or {}).items():
                self._mcap.add_metadata(name, entries)
        except FileExistsError:
            raise RecorderError(f"cannot record to {self.path}: it exists already; "
                                f"remove it or choose another name") from None
        except OSError as error:
            raise RecorderError(f"cannot record to {self.path}: {_reason(error)}") from None
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()
        atexit.register(self.close)            # a program that ends by an exception, too

    def __enter__(self):
        return self

    def __exit__(self, *exception):
        self.close()

    @property
    def queued(self):
        return len(self._queue)

    @property
    def bytes(self):
        return self._file.tell()

    def add_channel(self, topic, msg_type, qos="reliable", depth=10):
        """Number of a new channel, for `write`; at any time, from one thread.

        msg_type such as "geometry_msgs/msg/PoseStamped"; qos and depth as in schemas.qos_profile.
        Raises RecorderError if the type is not installed.
        """
        try:
            channel = _Channel(topic, msg_type, schemas.qos_profile(qos, depth),
                               schemas.type_hash(msg_type))
            text = schemas.definition(msg_type)
        except schemas.SchemaError as error:
            raise RecorderError(f"cannot record {topic}: {error}") from None

        def register():
            if msg_type not in self._schema_ids:
                self._schema_ids[msg_type] = self._mcap.add_schema(
                    msg_type, "ros2msg", text.encode())
            channel.id = self._mcap.add_channel(
                topic, "cdr", self._schema_ids[msg_type],
                {"offered_qos_profiles": _yaml(channel.info["offered_qos_profiles"]),
                 "topic_type_hash": channel.info["type_description_hash"]})

        self._channels.append(channel)
        self._queue.append(register)
        return len(self._channels) - 1

    def write(self, channel, stamp_ns, data):
        """Queue one serialized message, from any thread.

        Waits while the queue is full, but not after a failure. Never raises for the disk.
        """
        while len(self._queue) >= self._queue_size and not self._closed:
            time.sleep(_IDLE)
        if self._closed:
            self.lost += 1
            return
        channel = self._channels[channel]
        self._queue.append((channel, next(channel.sequence), stamp_ns, data))

    def add_attachment(self, name, media_type, data):
        """Attach a file, usually at the end of a run, before `close`."""
        def attach():
            self._mcap.flush()              # the stamps of all that came before count
            self._mcap.add_attachment(time.time_ns(), self._mcap.stamps[1], name, media_type, data)

        self._queue.append(attach)

    def close(self):
        """Write everything queued and finish the file; may be called again, from any thread.

        Messages that come later are not in the file and count as `lost`.
        """
        self._closing.set()
        self._thread.join()
        atexit.unregister(self.close)
        while self._queue:                     # came while the thread was ending
            self.lost += isinstance(self._queue.popleft(), tuple)

    # What follows runs in the recorder's thread.

    def _run(self):
        flushed = time.monotonic()
        while True:
            closing = self._closing.is_set()   # asked first: then all there was is written below
            self._write_queued()
            if self.written > self._secured and time.monotonic() - flushed > self._flush_interval:
                self._attempt(self._flush)
                flushed = time.monotonic()
            if closing:
                break
            if not self._queue:
                self._closing.wait(_IDLE)
        self._attempt(self._finish)
        self._file.close()
        self._closed = True

    def _write_queued(self):
        queue, add_message = self._queue, self._mcap.add_message
        for _ in range(len(queue)):
            item = queue.popleft()
            if not isinstance(item, tuple):
                self._attempt(item)
                continue
            if self.failure is None:
                channel, sequence, stamp_ns, data = item
                try:
                    add_message(channel.id, stamp_ns, data, sequence)
                    self.written += 1
                    continue
                except Exception as error:
                    self._fail(error)
            self.lost += 1

    def _flush(self):
        self._mcap.flush()
        self._secured = self.written

    def _finish(self):
        self._mcap.flush()
        self._mcap.add_metadata("rosbag2", {"serialized_metadata": _yaml(self._bag_metadata())})
        self._mcap.finish()

    def _attempt(self, action):
        """Run one step unless the recording has failed."""
        if self.failure is None:
            try:
                action()
            except Exception as error:
                self._fail(error)

    def _fail(self, error):
        """End the recording. Whatever the error is, the simulation goes on without it."""
        # Chunks are written whole or not at all as far as a reader is concerned, so only what
        # the last flush secured is sure to be there.
        self.lost += self.written - self._secured
        self.written = self._secured
        self.failure = (f"recording to {self.path} stopped after {self.written} messages: "
                        f"{_reason(error)}; the simulation goes on unrecorded")
        _log.error(self.failure)

    def _bag_metadata(self):
        """rosbag2's description of the bag, version 9."""
        first, last = self._mcap.stamps
        start, duration = {"nanoseconds_since_epoch": first}, {"nanoseconds": last - first}
        return {
            "version": 9, "storage_identifier": "mcap", "duration": duration,
            "starting_time": start, "message_count": self.written,
            "topics_with_message_count": [
                {"topic_metadata": channel.info, "message_count": self._mcap.counts[channel.id]}
                for channel in self._channels],
            "compression_format": "", "compression_mode": "",
            "relative_file_paths": [self.path.name],
            "files": [{"path": self.path.name, "starting_time": start, "duration": duration,
                       "message_count": self.written}],
            "custom_data": {}, "ros_distro": "jazzy"}


class _Channel:
    """A topic: its number in the file, its next sequence number, what rosbag2 says about it."""

    def __init__(self, topic, msg_type, qos, type_hash):
        self.id = None
        self.sequence = itertools.count(1)
        self.info = {"name": topic, "type": msg_type, "serialization_format": "cdr",
                     "offered_qos_profiles": [qos], "type_description_hash": type_hash}


class _File:
    """A new file without a buffer: what `write` returned from survives the process."""

    def __init__(self, path):
        self._raw = open(path, "xb", buffering=0)
        self._size = 0
        self.close = self._raw.close

    def write(self, data):
        rest = memoryview(data)
        while rest:                            # the system may take a part, and refuse the next
            taken = self._raw.write(rest)
            self._size += taken
            rest = rest[taken:]

    def tell(self):
        return self._size

    def flush(self):
        """Nothing waits here."""


class _Dumper(yaml.SafeDumper):
    def ignore_aliases(self, data):            # rosbag2's reader takes values, not references
        return True


def _yaml(data):
    return yaml.dump(data, Dumper=_Dumper, sort_keys=False)


def _new_file_path(path):
    path = Path(path).expanduser()
    try:
        if path.is_dir():
            path /= time.strftime("recording_%Y_%m_%d-%H_%M_%S.mcap")
        elif path.suffix != ".mcap":
            raise RecorderError(f"cannot record to {path}: the name must end in .mcap, "
                                f"or be an existing folder")
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RecorderError(f"cannot record to {path}: {_reason(error)}") from None
    return path


def _reason(error):
    return getattr(error, "strerror", None) or f"{type(error).__name__}: {error}"
