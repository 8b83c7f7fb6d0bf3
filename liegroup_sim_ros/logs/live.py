# SPDX-License-Identifier: Apache-2.0
"""Messages of a machine that runs, as of a Bag: the last ones."""

import threading
from collections import deque

import numpy as np

from liegroup_sim_ros.messages.codecs import MessageError

from .bag import LOOKED_AT, BagError, TopicMessages, listed, names_of, number_of, stamp_of

DENSEST = 4_000_000  # ns between the messages of one source that are kept: 75 of them show a start of a Shadow
BACK = 1_000_000_000  # ns: a stamp that is earlier by more begins a new run of the machine


class LiveBag:
    """The last messages of some topics; `take` is for other threads.

    decode : function (type, payload) -> {field: value}, which raises MessageError
    topics : {topic: type} of those that have messages
    newest : ns of the last stamp
    """

    def __init__(self, decode):
        self._decode, self._lock = decode, threading.Lock()
        self.topics, self._waiting, self._kept, self._last, self.newest = {}, deque(maxlen=100_000), {}, {}, 0

    def take(self, topic, kind, log_ns, payload):
        """Add a message that was received at a wall time."""
        with self._lock:
            self._waiting.append((topic, kind, log_ns, payload))

    def update(self, seconds):
        """Decode what was received, and drop what is older than some seconds; whether a new run began.

        Raises BagError for a message that cannot be decoded, without the others.
        """
        with self._lock:
            waiting, self._waiting = self._waiting, deque(maxlen=self._waiting.maxlen)
        is_new, wrong = False, None
        for topic, kind, log_ns, payload in waiting:
            kept = self._kept.setdefault(topic, deque())
            try:
                message = self._decode(kind, payload)
            except MessageError as error:
                wrong = BagError(f"{topic}: {error}")
                continue
            stamp, source = stamp_of(message), (topic, *names_of([message]))  # several drivers may share a topic
            if 0 <= log_ns - self._last.get(source, -DENSEST) < DENSEST:
                continue
            self._last[source] = log_ns
            if kept and 0 < stamp < kept[-1][1] - BACK:
                is_new = True
                for each in self._kept.values():
                    each.clear()
            self.topics[topic], self.newest = kind, log_ns
            kept.append((log_ns, stamp, message))
        for kept in self._kept.values():
            while kept and kept[0][0] < self.newest - seconds * 1e9 and len(kept) > LOOKED_AT:
                kept.popleft()
        if wrong is not None:
            raise wrong
        return is_new

    def late(self, topic, least):
        """ns by which messages of a topic arrive later than their stamps, by the median; 0 below `least` in s."""
        late = [log_ns - stamp for log_ns, stamp, _ in self._kept.get(topic, ()) if stamp > 0]
        found = round(float(np.median(late))) if late else 0
        return found if abs(found) > least * 1e9 else 0

    def messages(self, topic):
        """Messages of a topic, decoded."""
        return (message for *_, message in self._kept[topic])

    def names(self, topic):
        """Names in the messages of a topic: of entries of lists."""
        return names_of(self.messages(topic))

    def read(self, wanted):
        """{topic: TopicMessages} of fields {topic: [Field]}. Raises BagError."""
        found = {}
        for topic, fields in wanted.items():
            kept = list(self._kept.get(topic, ()))
            if not kept:
                raise BagError(f"no message on {topic} yet")
            values = np.array([[number_of(field(message)) for field in fields] for *_, message in kept], dtype=float)
            times = np.array([each[:2] for each in kept], dtype=np.int64)
            found[topic] = TopicMessages(times[:, 0], times[:, 1], values.reshape(len(kept), len(fields)))
            for field, column in zip(fields, values.T):
                if np.isnan(column).all():
                    names = listed(self.names(topic))
                    raise BagError(f"no message on {topic} has a number {field.text}; its names: {names}")
        return found
