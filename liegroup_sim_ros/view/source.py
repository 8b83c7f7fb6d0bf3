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
SAME = 1e-9  # s, between two times that are equal but for rounding


class ViewFrame(NamedTuple):
    """State at one instant.

    time   : s, that a page shows: of a simulation the simulated time, of a recording its stamps
    sample : liegroup_core Sample with errors and external wrenches, as far as they are known
    bound  : (m, rad) that the requested accuracy allows, or None
    ratios : errors of predictions of a machine by their limit, some times ahead; (): there is none
    """

    time: float
    sample: Sample
    bound: tuple | None
    ratios: tuple = ()


class Status(NamedTuple):
    """How a live source runs."""

    state: str  # "running", "paused" or "faulted"; of a recording "recorded", else one word
    factor: float | None  # achieved real-time factor
    latency: float | None  # s, by which the newest frame arrived later than the fastest one
    text: str  # what else is known, one line


class Source:
    """Motion of one scene.

    layout : Layout of the scene
    title  : for the page
    takes  : names of the commands that `ask` takes: "pause", "resume", "step" (count), "reset", "speed" (factor),
             "accuracy" (number), "place" ({joint: position}), "save" and "restore" (name of a snapshot), "effort",
             "servo" and "driven" (joint, value); "push", if it takes wrenches; "method", if `with_method` works;
             "reference", if `reference` does
    is_live: whether frames arrive while it runs; else `history` is complete from the start
    is_motion : whether its frames are a motion, which has an energy, errors, efforts and reactions
    compares : whether a real machine is beside it
    polled : whether the page adds the newest frame to `history` at its rate; else the source adds all frames
    """

    takes = frozenset()
    is_live = is_motion = polled = True
    compares = False

    def __init__(self, layout, title):
        self.layout, self.title = layout, title
        self.history = History()
        self._new_events, self._lock = [], threading.Lock()

    def frame(self):
        """Newest ViewFrame, or None before the first one."""
        raise NotImplementedError

    def status(self):
        """Status."""
        raise NotImplementedError

    accuracy = "1e-6"  # present one, as text
    how = ""  # method and accuracy or step, one line

    def dressed(self, frame):
        """The ViewFrame with everything that acts, before it is drawn."""
        return frame

    def ask(self, command, *arguments):
        """Carry out a command; returns one line of text. Raises LieGroupSimError if it is refused."""
        raise ViewError(f"{self.title} takes no command {command!r}")

    def tell_by_event(self, command, *arguments):
        """`ask` for a command whose event tells of it."""
        self.ask(command, *arguments)

    def pull(self, body, values, seconds, point):
        """Pull at a point (3,) of a body's frame for a simulated time in s.

        values (9,) : of a Command, see commands.py. It replaces the last one on this body.
        """
        raise ViewError(f"{self.title} takes no pulls")

    def release(self, body):
        """End the pull."""

    def branch(self, time):
        """Source that continues from an instant of `history`, in this process, paused. Raises LieGroupSimError."""
        raise ViewError(f"{self.title} cannot be continued")

    def with_method(self, method, step, time=None):
        """Source that continues with a method and a step in s, paused. Raises LieGroupSimError.

        time : s, an instant of `history`; None: the present one
        """
        raise ViewError(f"{self.title} keeps its method")

    def reference(self):
        """(History of the reference integration from the same start, one line of text). Raises LieGroupSimError."""
        raise ViewError(f"{self.title} has no reference")

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


class Known(Source):
    """Frames that are all in the history from the start, and are no motion.

    state : one word, see Status
    """

    is_live = is_motion = polled = False
    state = ""

    def frame(self):
        """The first frame; a page shows those of the history."""
        return self.history.frames[0]

    def status(self):
        """Status."""
        return Status(self.state, None, None, "")


def _velocities(sample):
    """Velocities (n, 3) of the origins of the bodies of a Sample, world axes, m/s."""
    return np.einsum("nij,nj->ni", sample.pose[:, :9].reshape(-1, 3, 3), sample.twist[:, 3:])


def settings_text(method, accuracy, step):
    """One line: a method, and its accuracy or else its step in s."""
    return f"{method}, " + (f"accuracy {accuracy:g}" if accuracy else f"step {step:g} s")


def allowed(layout, accuracy, horizon, seconds):
    """(m, rad) that an accuracy allows after some seconds, as Sample.bound."""
    wanted = accuracy * max(1.0, seconds / horizon)
    return wanted * layout.size, wanted


class History:
    """Frames in the order of time, thinned when they are many; one thread adds, others read."""

    def __init__(self):
        self.times, self.frames, self.every, self._skipped = [], [], 1, 0
        self._known = {}  # {key of a curve: {time: value}}

    def add(self, frame):
        """Append a frame. It replaces those of its time and later ones: a simulation was set back."""
        if self.times and frame.time <= self.times[-1] + SAME:
            k = bisect.bisect_left(self.times, frame.time - SAME)
            self.times, self.frames, self._known = self.times[:k], self.frames[:k], {}
            self._skipped = self.every - 1
        self._skipped += 1
        if self._skipped < self.every:
            return
        self._skipped = 0
        if len(self.times) >= MOST_KEPT:
            self.times, self.frames, self.every = self.times[::2], self.frames[::2], 2 * self.every
        self.frames.append(frame)  # first: another thread may look for the time
        self.times.append(frame.time)

    def until(self, time):
        """History of the frames up to a time, which gets no more."""
        copy, end = History(), bisect.bisect_right(self.times, time)
        copy.times, copy.frames = self.times[:end], self.frames[:end]
        return copy

    def _number(self, time):
        """Number of the frame at a time, or of the last one before it, or the first."""
        return max(0, bisect.bisect_right(self.times, time) - 1)

    def at(self, time):
        """ViewFrame at a time, or the last one before it."""
        return self.frames[self._number(time)]

    def has(self, time):
        """Whether there is a frame at a time."""
        return bool(self.times) and abs(time - self.times[self._number(time + SAME)]) <= SAME

    def places(self, time):
        """Positions (n, 3) of the bodies at a time between two frames, m, by their velocities: a cubic polynomial."""
        k = self._number(time + SAME)
        begin, end = self.frames[k], self.frames[min(k + 1, len(self.times) - 1)]
        if time - begin.time <= SAME or end is begin:
            return begin.sample.rows[:, :3]
        h = end.time - begin.time
        s = (time - begin.time) / h
        (p, v), (q, w) = ((f.sample.rows[:, :3], h * _velocities(f.sample)) for f in (begin, end))
        rest = 1.0 - s
        return rest**2 * ((1.0 + 2.0 * s) * p + s * v) + s**2 * ((1.0 + 2.0 * rest) * q - rest * w)

    def span(self):
        """(first, last time), s."""
        return (self.times[0], self.times[-1]) if self.times else (0.0, 0.0)

    def curve(self, value, since, key, most=300):
        """(times, values) of a function of a ViewFrame from a time on, about `most` of them; times increase.

        key : name of the function: a value that is known is not computed again
        """
        frames = self.frames  # `add` may replace the list
        first, end = bisect.bisect_left(self.times, since), len(frames)
        every = max(1, (end - first) // most)
        some = [frames[k] for k in range(-(-first // every) * every, end, every)]
        known = self._known.get(key, {})
        found = {frame.time: known[frame.time] if frame.time in known else value(frame) for frame in some}
        self._known[key] = found
        return np.array(list(found)), np.array(list(found.values()))
