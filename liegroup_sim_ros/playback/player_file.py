# SPDX-License-Identifier: Apache-2.0
"""Topics of a recording, and its messages from a start time, for publishing."""

import re
from typing import NamedTuple

import numpy as np

from liegroup_core.errors import LieGroupSimError
from liegroup_sim_ros.recording.read_file import ErrorsWithPath
from liegroup_sim_ros.recording.walk import ChunkMessages, Walk

_TYPE = re.compile(r"[a-z][a-z0-9_]*/msg/[A-Z][A-Za-z0-9]*")


class PlayError(LieGroupSimError):
    """The recording cannot be published; one line of text, exit code 2."""


class RecordedTopic(NamedTuple):
    name: str
    type: str  # such as geometry_msgs/msg/PoseStamped
    reliable: bool
    latched: bool
    depth: int


class PlayFile:
    """Topics and messages of a Recording.

    topics : {channel id: RecordedTopic}, of channels with ROS 2 messages in CDR
    first_ns, last_ns, seconds : first and last stamp, and duration, of the messages
    """

    def __init__(self, recording):
        self.path, self._recording = recording.path, recording
        self._source = recording._source
        self.topics = {
            number: RecordedTopic(channel.topic, channel.type, *_qos(channel))
            for number, channel in recording.channels.items()
            if channel.encoding == "cdr" and _TYPE.fullmatch(channel.type)
        }
        self._chunks = self._index()
        edges = [edge for _, *pair in self._chunks for edge in pair]
        if not self.topics or not edges:
            raise PlayError(f"{self.path}: contains no message to publish")
        self.first_ns, self.last_ns = min(edges), max(edges)
        self.seconds = (self.last_ns - self.first_ns) * 1e-9
        self.has_clock = any(
            topic.name == "/clock" and recording.topics.get("/clock") for topic in self.topics.values()
        )

    def _index(self):
        """(offset, first, last stamp) of all readable chunks."""
        chunks = []
        for messages, _ in self._source.messages():
            offset = self._source.stream.offset
            chunks.append((offset, int(messages.log_time.min()), int(messages.log_time.max())))
        return chunks

    def messages(self, since_ns):
        """Generator of (stamp ns, [(RecordedTopic, payload)]) from a start stamp, in the order of stamps.

        Messages with the same stamp are yielded together. Recordings of other software may not be
        sorted: a message that is earlier than the previous one gets the stamp of the previous one.
        Raises RecordingError.
        """
        chunks = {offset for offset, _, last in self._chunks if last >= since_ns}
        reached = since_ns
        with ErrorsWithPath(self.path), open(self._source.path, "rb") as file:
            stream = Walk(file, self._source.size, lambda at, *_: at in chunks)
            stream.channels.update(self._recording.channels)
            for item in stream:
                if not isinstance(item, ChunkMessages):
                    continue
                stamps = item.log_time
                order = np.argsort(stamps, kind="stable")
                order = order[stamps[order] >= since_ns]
                edges = np.flatnonzero(np.diff(stamps[order])) + 1
                for part in np.split(order, edges) if len(order) else ():
                    group = [
                        (self.topics[number], item.payload(k))
                        for k, number in zip(part.tolist(), item.channel[part].tolist())
                        if number in self.topics
                    ]
                    reached = max(reached, int(stamps[part[0]]))
                    yield reached, group


def _qos(channel):
    """(reliable, latched, depth) of the QoS that the publisher offered."""
    first = channel.qos[0] if channel.qos and isinstance(channel.qos[0], dict) else {}
    depth = first.get("depth")
    return (
        str(first.get("reliability")) not in ("best_effort", "2"),
        str(first.get("durability")) in ("transient_local", "1"),
        depth if isinstance(depth, int) and 0 < depth <= 10_000 else 10,
    )
