# SPDX-License-Identifier: Apache-2.0
"""Controllers in Python: functions that a run calls at exact times, before it goes on from there."""

from pathlib import Path

from liegroup_core.errors import LieGroupSimError
from liegroup_core.fields.arguments import got, is_finite
from liegroup_core.forces.instants import AFTER, exact_seconds


class ControlError(LieGroupSimError):
    """A file has no controller; one line of text."""


class _Periodic:
    """Function with a period: its times are the multiples of the period, exact, rounded to whole ns."""

    def __init__(self, function, period, grid):
        self.function, self._grid = function, grid
        self._period = exact_seconds(period)
        self.forget()

    def forget(self):
        """Find the next time anew, because a state was set."""
        self.due = None

    def at(self, number):
        """Instant of a multiple of the period."""
        return self._grid.instant(number * self._period)

    def find(self, now):
        """Set `due` to the first time from an Instant on."""
        if self.due is None:
            self._number = max(0, int(now.time / self._period) - 1)
            self.due = self.at(self._number)
        while self.due < now:
            self.go_on()

    def go_on(self):
        """Set `due` to the next time."""
        self._number += 1
        self.due = self.at(self._number)


class Controls:
    """Functions with periods; grid : StepGrid of the steps."""

    def __init__(self, grid):
        self._grid, self._entries = grid, []

    def __bool__(self):
        return bool(self._entries)

    def add(self, function, period):
        """Add a function with a period in s. Raises ValueError."""
        if not callable(function):
            raise ValueError(f"a controller must be a function of the simulation, {got(function)}")
        if not (is_finite(period) and 1e-9 <= period <= 1e9):
            raise ValueError(f"the period of a controller must be a number of seconds from 1e-9 to 1e9, {got(period)}")
        self._entries.append(_Periodic(function, float(period), self._grid))

    def forget(self):
        """Take notice of a state that was set."""
        for entry in self._entries:
            entry.forget()

    def call(self, simulation):
        """Call the functions that are due, in the order in which they were added; returns the next Instant."""
        now = simulation.now
        for entry in self._entries:
            entry.find(now)
            if entry.due == now:
                entry.function(simulation)
                entry.go_on()
        return min((entry.due for entry in self._entries), default=AFTER)


def read_setup(text):
    """(source, name) of a function FILE.py:NAME that adds controllers to a simulation. Raises ControlError."""
    path, colon, name = text.rpartition(":")
    if not colon or not name.isidentifier():
        raise ControlError(f"{text}: give the file and a function of it, as FILE.py:NAME")
    try:
        return Path(path).read_text(encoding="utf-8"), name
    except (OSError, UnicodeDecodeError) as error:
        raise ControlError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from None


def set_up(simulation, source, name, file=""):
    """Execute a source, and call its function with a simulation; file : for tracebacks. Raises ControlError."""
    file = file or f"<{name}>"
    names = {"__name__": name}
    try:
        exec(compile(source, file, "exec"), names)  # as a user of Python runs this file
    except Exception as error:
        raise ControlError(f"{file}: cannot be used: {type(error).__name__}: {error}") from None
    if name not in names:
        raise ControlError(f"{file}: has no function {name}")
    names[name](simulation)
