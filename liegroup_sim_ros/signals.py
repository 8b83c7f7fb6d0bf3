# SPDX-License-Identifier: Apache-2.0
"""Signals that end a program in order: a flag that it looks at, so that nothing is lost midway."""

import signal
import threading

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)


class Signals:
    """Handlers of SIGNALS that only set `received`; a `with` block restores the ones before.

    An exception from a handler may get lost in a callback, or end what must not be divided. A second
    signal, as `ros2 launch` sends it, changes nothing.
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


def handled():
    """SIGNALS, in the thread that Python lets handle them; SIGHUP not below nohup, which ignores it.

    A shell starts background processes with SIGINT and SIGQUIT ignored: they are handled.
    """
    if threading.current_thread() is not threading.main_thread():
        return []
    ignored = signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
    return [number for number in SIGNALS if not (ignored and number == signal.SIGHUP)]
