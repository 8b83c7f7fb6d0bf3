# SPDX-License-Identifier: Apache-2.0
"""Event for which one thread waits: a lock, which takes half the time of threading.Event."""

import contextlib
import threading


class Wake:
    """As threading.Event, for one thread that waits and clears."""

    def __init__(self):
        self._is_set, self._lock = False, threading.Lock()
        self._lock.acquire()
        self.is_set = lambda: self._is_set

    def set(self):
        """Wake the thread, or let its next `wait` return at once."""
        self._is_set = True
        with contextlib.suppress(RuntimeError):  # released already
            self._lock.release()

    def clear(self):
        """Let the next `wait` wait."""
        self._is_set = False  # first: a `set` from now on stays
        self._lock.acquire(blocking=False)

    def wait(self, seconds):
        """Wait until it is set, at most for a time; returns whether it is set."""
        if not self._is_set and seconds > 0.0:
            self._lock.acquire(timeout=min(seconds, threading.TIMEOUT_MAX))
        return self._is_set
