# SPDX-License-Identifier: Apache-2.0
"""What a page shows and commands: frames of a motion, and the requests that its source takes."""

import bisect
import threading
from typing import NamedTuple

import numpy as np

from liegroup_core.observables.sample import Sample

from .server import ViewError

# Frames that a history keeps; then every second one of them goes.
MOST_KEPT = 20_000
MOST_EVENTS = 500


class Frame(NamedTuple):
    """State at one instant.

    time   : s, as the stamps of the source; it increases over resets
    sample : liegroup_core Sample with errors and external wrenches, as far as they are known
    bound  : (m, rad) that the requested accuracy allows, or None
    """

    time: float
    sample: Sample
    bound: tuple | None


class Status(NamedTuple):
    """How a live source runs."""

    state: str  # "running", "paused" or "faulted"; of a recording "recorded"
    factor: float | None  # achieved real-time factor
    latency: float | None  # s, by which the newest frame arrived later than the fastest one
    text: str  # what else is known, one line


class Source:
    """Motion of one scene.

    layout : Layout of the scene
    title  : for the page
    takes  : names of the commands that `ask` takes: "pause", "resume", "step" (count), "reset", "speed" (factor),
             "accuracy" (number), "place" ({joint: position}), "save" and "restore" (name of a snapshot), "effort",
             "servo" and "driven" (joint, value); and "push", if it takes wrenches
    is_live: whether frames arrive while it runs; else `history` is complete from the start
    knows_efforts : whether the samples have what servos, drives and commands exert
    """

    takes = frozenset()
    is_live = knows_efforts = True

    def __init__(self, layout, title):
        self.layout, self.title = layout, title
        self.history = History()
        self._new_events, self._lock = [], threading.Lock()

    def frame(self):
        """Newest Frame, or None before the first one."""
        raise NotImplementedError

    def status(self):
        """Status."""
        raise NotImplementedError

    def dressed(self, frame):
        """The Frame with everything that acts, before it is drawn."""
        return frame

    def ask(self, command, *arguments):
        """Carry out a command; returns one line of text. Raises LieGroupSimError if it is refused."""
        raise ViewError(f"{self.title} takes no command {command!r}")

    def push(self, body, wrench, seconds, point):
        """Apply a wrench (torque, force) in world axes, at a point (3,) of a body's frame, for a simulated time in s.

        It replaces the last one on this body.
        """
        raise ViewError(f"{self.title} takes no wrenches")

    def release(self, body):
        """End the wrench of `push`."""

    def branch(self, time):
        """Source that continues from an instant of `history`, in this process, paused. Raises LieGroupSimError."""
        raise ViewError(f"{self.title} cannot be continued")

    def events(self):
        """[(time in s, name, text)] since the last call."""
        with self._lock:
            found, self._new_events = self._new_events, []
        return found

    def tell(self, time, name, text):
        """Note an event; at most MOST_EVENTS are kept until they are taken."""
        with self._lock:
            self._new_events = [*self._new_events[1 - MOST_EVENTS :], (time, name, text)]

    def close(self):
        """End it."""


def allowed(layout, accuracy, horizon, seconds):
    """(m, rad) that an accuracy allows after some seconds, as Sample.bound."""
    wanted = accuracy * max(1.0, seconds / horizon)
    return wanted * layout.size, wanted


class History:
    """Frames in the order of time, thinned when they are many."""

    def __init__(self):
        self.times, self.frames, self.every, self._skipped = [], [], 1, 0

    def add(self, frame):
        """Append a frame that is later than the last one."""
        if self.times and frame.time <= self.times[-1]:
            return
        self._skipped += 1
        if self._skipped < self.every:
            return
        self._skipped = 0
        if len(self.times) >= MOST_KEPT:
            self.times, self.frames, self.every = self.times[::2], self.frames[::2], 2 * self.every
        self.times.append(frame.time)
        self.frames.append(frame)

    def at(self, time):
        """Frame at a time, or the last one before it."""
        return self.frames[max(0, bisect.bisect_right(self.times, time) - 1)]

    def span(self):
        """(first, last time), s."""
        return (self.times[0], self.times[-1]) if self.times else (0.0, 0.0)

    def curve(self, value, since, most=300):
        """(times, values) of a function of a Frame from a time on, at most `most` of them; times increase."""
        first = bisect.bisect_left(self.times, since)
        some = np.unique(np.linspace(first, len(self.times) - 1, min(most, len(self.times) - first)).astype(int))
        frames = self.frames  # `add` may replace the list
        times = [frames[k].time for k in some]
        return np.array(times), np.array([value(frames[k]) for k in some])
