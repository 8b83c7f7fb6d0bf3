# SPDX-License-Identifier: Apache-2.0
"""Signals that end a program: handlers set a flag, and the program ends in order when it sees the flag."""

import os
import signal
import sys
import threading

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)


class Signals:
    """Handlers of SIGNALS that only set `received`; a `with` block restores the previous handlers.

    An exception from a handler may get lost in a callback, or interrupt an operation that must complete.
    A second signal, such as `ros2 launch` sends, has no effect.
    """

    def __init__(self):
        self.received = False
        self._before = {number: signal.signal(number, self._handle) for number in handled()}

    def _handle(self, *_):
        self.received = True

    def check(self):
        """Raise KeyboardInterrupt if a signal has arrived."""
        if self.received:
            raise KeyboardInterrupt

    def __enter__(self):
        return self

    def __exit__(self, *exception):
        for number, handler in self._before.items():
            signal.signal(number, handler)


def end_as_by_ctrl_c():
    """Let all SIGNALS raise KeyboardInterrupt."""
    for number in handled():
        signal.signal(number, signal.default_int_handler)


def halt_on_signals():
    """Let a signal halt all simulations: Python calls handlers between two calls of kernels, which may be minutes."""
    reads, writes = os.pipe()
    os.set_blocking(writes, False)
    signal.set_wakeup_fd(writes, warn_on_full_buffer=False)

    def wait():
        while number := os.read(reads, 1):
            if number[0] in SIGNALS and "liegroup_core.engine" in sys.modules:  # else nothing runs
                sys.modules["liegroup_core.engine"].halt_all()

    threading.Thread(target=wait, daemon=True).start()


def ignore():
    """Let all SIGNALS have no effect from now on: the program ends."""
    for number in handled():
        signal.signal(number, signal.SIG_IGN)


def handled():
    """SIGNALS that this thread can handle: none outside the main thread; no SIGHUP under nohup, which ignores it.

    SIGINT and SIGQUIT are handled even if they are ignored: shells start background processes like that.
    """
    if threading.current_thread() is not threading.main_thread():
        return []
    ignored = signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
    return [number for number in SIGNALS if not (ignored and number == signal.SIGHUP)]
