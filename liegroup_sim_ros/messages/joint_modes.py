# SPDX-License-Identifier: Apache-2.0
"""Events at joints with stops or dry friction, and of contacts: messages with the modes of joints, and lines of text.

~/joint_modes has a message for every instant at which a mode changes or a stop is hit: a matrix with a
row for each joint with stops or friction, in the order of the scene. Column `mode` is one of the constants
below. `slip` is the sign of the velocity that sliding friction opposes. `effort` is the effort of a joint that
rests only because others are held, else NaN. `impulse` and `energy` are those of an impact at this instant.
"""

import math
from collections import Counter
from typing import NamedTuple

import numpy as np

from liegroup_core.scene.switches import unit_of
from liegroup_sim_ros.numbers import counted

from . import matrices
from .commands import joint_labels

TYPE = matrices.TYPE
# Units: coordinate rad or m, impulse N m s or N s, energy J, effort N m or N.
COLUMNS = ("mode", "slip", "coordinate", "impulse", "energy", "effort")
MODE, SLIP, COORDINATE, IMPULSE, ENERGY, EFFORT = range(6)
# Free; at rest at a stop, or by friction alone; moving beyond a compliant stop.
FREE, LOWER, UPPER, STICK, BEYOND_LOWER, BEYOND_UPPER = range(6)
IMPACT = "impact"
JOINT, CONTACT = "joint", "contact"  # names of events
LINES = 20  # most instants per second of simulated time that have a line each


def encoder(layout):
    """Function (modes (k, 5) as Sample.switching, [JointEvent]) -> serialized Float64MultiArray."""
    names = [switch.name for switch in layout.switches]
    pack = matrices.encoder(joint_labels(names, layout.scene.robot), COLUMNS)
    row = {name: k for k, name in enumerate(names)}

    def encode(modes, events=()):
        held, slip, side, coordinate, effort = modes.T
        values = np.zeros((len(names), len(COLUMNS)))
        at_rest = np.where(side < 0.0, LOWER, np.where(side > 0.0, UPPER, STICK))
        moving = np.where(side < 0.0, BEYOND_LOWER, np.where(side > 0.0, BEYOND_UPPER, FREE))
        values[:, MODE] = np.where(held != 0.0, at_rest, moving)
        values[:, SLIP], values[:, COORDINATE] = slip, coordinate
        values[:, EFFORT] = np.where(held == 2.0, effort, math.nan)
        for event in events:
            values[row[event.joint], IMPULSE] += event.impulse
            values[row[event.joint], ENERGY] += event.energy
        return pack(values.ravel().tolist())

    return encode


def decode(payload):
    """(names of the joints, numbers row by row). Raises MessageError."""
    return matrices.decode(payload, COLUMNS)[::2]


def switching(values):
    """(..., k, 5) modes as Sample.switching, of the numbers (..., k, 6) of messages."""
    mode = values[..., MODE]
    side = np.where(np.isin(mode, (LOWER, BEYOND_LOWER)), -1.0, 0.0)
    side[np.isin(mode, (UPPER, BEYOND_UPPER))] = 1.0
    rests = np.isfinite(values[..., EFFORT])
    held = np.where(rests, 2.0, np.isin(mode, (LOWER, UPPER, STICK)))
    effort = np.where(rests, values[..., EFFORT], 0.0)
    own = values[..., SLIP], side, values[..., COORDINATE]
    return np.stack([held, *own, effort], axis=-1)


class Report(NamedTuple):
    """Messages about the joints and contacts at one instant.

    time_ns : since step 0
    modes   : message of ~/joint_modes, or None
    line    : text of an event, or None
    name    : of the event
    """

    time_ns: int
    modes: bytes | None
    line: str | None
    name: str = JOINT


def has_reports(layout):
    """Whether a layout has joints with stops or friction, or contacts."""
    return bool(layout.switches or layout.touching.names)


class JointReports:
    """Reports on joints with stops or friction, and on contacts that touch, leave, slip and stick, during a simulation.

    At most LINES instants in a second of simulated time have a line. The others are counted; the
    first report after that second sums them up. Call `begin` at the start and after a state was set.
    """

    def __init__(self, simulation):
        self._simulation, self._last, self._time = simulation, None, 0.0
        layout = simulation.layout
        self._encode = encoder(layout) if layout.switches else None
        units = {switch.name: unit_of(switch, layout.scene) for switch in layout.switches}
        self._unit = {name: "N s" if unit == "m" else "N m s" for name, unit in units.items()}
        self._clear()

    def _clear(self):
        self._second, self._lines = 0, 0
        self._more, self._kinds, self._energy = 0, Counter(), 0.0

    def begin(self):
        """[Report] of the modes of the present state."""
        simulation = self._simulation
        simulation.drain_instants()
        self._clear()
        self._second, self._time = int(simulation.time), simulation.time
        self._last = simulation.sample().switching
        return [Report(simulation.time_ns, self._encode(self._last), None)] if self._encode else []

    def drain(self):
        """[Report] of the instants since the last call, in the order of time."""
        reports = []
        for instant in self._simulation.drain_instants():
            reports += self._of_instant(instant)
        self._time = self._simulation.time
        if int(self._time) > self._second:
            reports += self._sum_up(self._time)
        return reports

    def finish(self):
        """[Report] that sums up the instants without a line."""
        return self._sum_up(self._time)

    def _of_instant(self, instant):
        time, modes = instant.time, None
        joints = [event for event in instant.events if event.joint in self._unit]
        if self._encode and (joints or not np.array_equal(instant.modes, self._last)):
            modes = self._encode(instant.modes, joints)
        self._last, name = instant.modes, JOINT if joints else CONTACT
        if not instant.events:  # a state that was set, friction that reverses with the motion, or another law
            return [Report(round(time * 1e9), modes, None)] if modes else []
        reports = self._sum_up(time) if int(time) > self._second else []
        line = None
        if self._lines < LINES:
            self._lines += 1
            line = f"{time:.9f} s: {'; '.join(map(self._text, instant.events))}"
        else:
            self._more += 1
            self._kinds.update(event.kind for event in instant.events)
            self._energy += math.fsum(event.energy for event in instant.events)
        return [*reports, *([Report(round(time * 1e9), modes, line, name)] if modes or line else [])]

    def _text(self, event):
        if event.kind != IMPACT:
            return f"{event.joint} {event.kind}"
        unit = self._unit[event.joint]
        return f"{event.joint} {IMPACT}, impulse {event.impulse:.6g} {unit}, energy {event.energy:.6g} J"

    def _sum_up(self, time):
        """[Report] of the instants without a line in the second that ends."""
        reports = []
        if self._more:
            kinds = ", ".join(f"{count} {kind}" for kind, count in sorted(self._kinds.items()))
            text = (
                f"{time:.9f} s: {counted(self._more, 'more instant')} since {self._second} s: {kinds}"
                f"{f'; energy {self._energy:.6g} J' if self._encode else ''}"
            )
            reports.append(Report(round(time * 1e9), None, text, JOINT if self._encode else CONTACT))
        self._clear()
        self._second = int(time)
        return reports
