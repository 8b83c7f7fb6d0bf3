# SPDX-License-Identifier: Apache-2.0
"""Joints that rest by dry friction or at a stop: whether a pose rests, and for which inputs.

With the inputs u and the efforts f of these joints, a pose rests if

    a(u) + F f = 0 ,   least <= f <= most

so that the end of the interval of an input is the solution of a linear program. It is repeated there, because
friction may depend on the load.
"""

import numpy as np
import scipy

from liegroup_core.dynamics.switches import MOVES
from liegroup_core.lie.groups import within_a_turn
from liegroup_core.placing import switch_places
from liegroup_core.scene.switches import unit_of

from .coordinates import Coordinates

DEPENDENT = 1e-9  # relative singular value of efforts that balance each other
MOST_REPEATS, SAME = 50, 1e-11
AVOIDED = 1e3  # cost of friction beyond its bounds
BEYOND_STOP = 1e-9  # rad or m: round-off
STILL = 1e-6  # rad/s^2 or m/s^2: accelerations of a coordinate that rests, by splines
BEYOND = 1e-7  # of the largest friction: tolerance of the linear program


def stick(probe, candidates, held=None):
    """Let dry friction hold a largest independent set of switches among `candidates` at the state of a Probe.

    held : indices of freedoms that keep their positions: only switches that these keep at rest; None: all
    """
    if not len(candidates):
        return
    coordinates, modes = Coordinates(probe), probe.modes
    rest, scales = probe.switch_rates(), coordinates.rate_scales
    moves = [probe.switch_rates(coordinates.neighbour(k, scale, rate=True)) for k, scale in enumerate(scales)]
    rows = (
        np.array([each - rest for each in moves]).reshape(len(scales), len(rest)).T / probe.layout.switch_sizes[:, None]
    )
    free = np.eye(len(scales)) if held is None else scipy.linalg.null_space(coordinates.rates[held] * scales)
    for k in candidates:
        size = np.linalg.norm(rows[k])
        if size > DEPENDENT and (held is None or np.linalg.norm(rows[k] @ free) <= DEPENDENT * size):
            modes[k, 0], modes[k, 1], modes[k, 4] = 1.0, 0.0, 0.0
            rows = rows - np.outer(rows @ rows[k], rows[k]) / size**2
    probe.modes = modes


class Resting:
    """Joints with stops or dry friction that rest at the state of a Probe, with efforts instead of their modes.

    indices : (r,) in layout.switches
    kept    : modes of the state
    """

    def __init__(self, probe):
        self._probe, self.kept = probe, probe.modes
        held = self.kept[:, 0] != 0.0
        rests = (np.abs(probe.switch_rates()) <= MOVES) & (probe.largest_friction() > 0.0) & (self.kept[:, 2] == 0.0)
        self.indices = np.flatnonzero(held | rests)
        self._sides = self.kept[self.indices, 2]
        self.apply(np.zeros(len(self.indices)))

    @property
    def names(self):
        """Names of these joints."""
        return [self._probe.layout.switches[k].name for k in self.indices]

    def apply(self, efforts):
        """Apply constant efforts (r,), N m or N."""
        modes = self.kept.copy()
        modes[self.indices, 0], modes[self.indices, 1], modes[self.indices, 4] = 2.0, 0.0, efforts
        self._probe.modes = modes

    def settle(self, efforts):
        """Hold the joints: those that were not held stick, if independent, and else rest by their efforts."""
        self.apply(efforts)
        modes = self._probe.modes
        held = self.kept[:, 0] == 1.0
        modes[held] = self.kept[held]
        self._probe.modes = modes
        stick(self._probe, self.indices)

    def bounds(self, efforts, applied):
        """(least, most) efforts (r,) that hold the joints, where efforts and inputs of the Probe act."""
        self.apply(efforts)
        most = self._probe.largest_friction(applied)[self.indices]
        return np.where(self._sides > 0.0, -np.inf, -most), np.where(self._sides < 0.0, np.inf, most)

    def effects(self, accelerations, u):
        """F (p, r): accelerations by unit efforts; then no efforts act."""
        columns = []
        for efforts in (*np.eye(len(self.indices)), np.zeros(len(self.indices))):
            self.apply(efforts)
            columns.append(accelerations(u))
        found = np.array(columns)
        return (found[:-1] - found[-1]).T

    def hold(self, accelerations, u, pushed, inputs):
        """Inputs (k,) and efforts (r,) that hold the pose; None if nothing does.

        Dry friction holds only what inputs and stops cannot, with the smallest sum of its parts of the bounds. Inputs
        have the smallest sum of squares.
        pushed : (p, k) accelerations by unit inputs
        """
        effects, a, stops = self.effects(accelerations, u), accelerations(u), self._sides != 0.0
        others, dry = np.hstack([pushed, effects[:, stops]]), effects[:, ~stops]
        efforts, before = np.zeros(len(self.indices)), np.inf
        if _remaining(others, a) > DEPENDENT * np.abs(a).max(initial=0.0):
            k, n = others.shape[1], dry.shape[1]
            # Unknowns: inputs and stops, friction, its magnitude, and what is beyond its bounds until loads settle.
            pattern = [[1, -1, 0], [-1, -1, 0], [0, 1, -1], [0, 0, -1]]
            rows = np.hstack([np.zeros((4 * n, k)), np.kron(pattern, np.eye(n))])
            for _ in range(MOST_REPEATS):
                most = self.bounds(efforts, inputs.applied(u))[1][~stops]
                each = 1.0 / np.where(most > 0.0, most, 1.0)
                cost = np.concatenate([np.zeros(k + n), each, AVOIDED * each])
                room = np.concatenate([np.zeros(2 * n), most, np.zeros(n)])
                found = _program(cost, np.hstack([others, dry, 0.0 * dry, 0.0 * dry]), -a, rows, room)
                if found is None:
                    return None
                efforts[~stops] = found[k : k + n]
                if abs(cost @ found - before) <= SAME * (before if before < np.inf else 0.0):
                    break
                before = cost @ found
        self.apply(0.0 * efforts)
        right = -a - effects @ efforts
        across = np.eye(len(a)) - effects[:, stops] @ np.linalg.pinv(effects[:, stops])
        smallest = _smallest(across @ pushed, u, across @ right)
        # A servo at its limit has no effect here, but elsewhere.
        terms = np.abs(pushed) @ np.abs(smallest) + np.abs(effects) @ np.abs(efforts)
        rest = across @ (accelerations(smallest) + effects @ efforts)
        if np.abs(rest).max(initial=0.0) <= DEPENDENT * terms.max(initial=0.0):
            u = smallest
        efforts[stops] = np.linalg.lstsq(effects[:, stops], -accelerations(u) - effects @ efforts)[0]
        least, most = self.bounds(efforts, inputs.applied(u))
        beyond = BEYOND * np.abs(efforts).max(initial=0.0)
        return (u, efforts) if ((least - beyond <= efforts) & (efforts <= most + beyond)).all() else None

    def end(self, sign, j, u, efforts, accelerations, pushed, inputs):
        """Largest, or with sign -1 smallest, value of input j for which the pose rests; nan if it is not found."""
        u = u.copy()
        for _ in range(MOST_REPEATS):
            least, most = self.bounds(efforts, inputs.applied(u))
            effects, column = self.effects(accelerations, u), pushed(u, [j])
            right = -(accelerations(u) + effects @ efforts)
            rows = np.hstack([np.zeros((2 * len(most), 1)), np.vstack([np.eye(len(most)), -np.eye(len(most))])])
            room = np.concatenate([most - efforts, efforts - least])
            finite = np.isfinite(room)
            cost = -sign * np.eye(1 + len(most))[0]
            found = _program(cost, np.c_[column, effects], right, rows[finite], room[finite])
            if found is None:
                return np.nan
            if not np.isfinite(found[0]):
                return found[0]
            u[j] += found[0]
            efforts = efforts + found[1:]
            if abs(found[0]) <= SAME * max(1.0, abs(u[j])):
                return u[j]
        return np.nan


class Stops:
    """Coordinates of the stops, with their turns along the path of a Probe."""

    def __init__(self, probe):
        self._probe = probe
        self._places = probe.base.switching[:, 3].copy() if probe.layout.switches else np.empty(0)

    def follow(self):
        """Take the coordinates of the present state."""
        if len(self._places):
            for k, (switch, q) in enumerate(switch_places(self._probe.layout, self._probe.pose, self._probe.twist)):
                self._places[k] = within_a_turn(q, self._places[k]) if switch.is_angle else q

    def pushing(self, y):
        """Sign (k,) of the efforts that rigid stops can give where coordinates rest at them; 0 elsewhere.

        y : (f, 2) change of the rates by the accelerations of the state: a coordinate that leaves its stop is free
        """
        probe, found = self._probe, np.zeros(len(self._places))
        if not len(found):
            return found
        rates, changes, modes = probe.switch_rates(), probe.switch_rates(y), probe.modes
        rests = (np.abs(rates) <= MOVES) & (np.abs(changes - rates) <= STILL) & (modes[:, 0] == 0.0)
        for k, (q, switch) in enumerate(zip(self._places, probe.layout.switches)):
            if rests[k] and switch.limits is not None and switch.limits.stiffness is None:
                found[k] = (q - switch.limits.least <= BEYOND_STOP) - float(switch.limits.largest - q <= BEYOND_STOP)
        return found

    def beyond(self):
        """Text of a stop that acts at the state but not in its mode, or only in its mode; or None."""
        layout = self._probe.layout
        for q, switch, side in zip(self._places, layout.switches, self._probe.modes[:, 2]):
            if switch.limits is None or switch.limits.least == switch.limits.largest:
                continue
            is_pressed = switch.limits.stiffness is not None and side != 0.0
            if switch.limits.excess(q) * (-1.0 if is_pressed else 1.0) > BEYOND_STOP:
                return f"{switch.name} would be at {q:.6g} {unit_of(switch, layout.scene)}"
        return None


def _remaining(columns, right):
    """Largest entry of what columns cannot produce."""
    return np.abs(right - columns @ np.linalg.lstsq(columns, right, rcond=DEPENDENT)[0]).max(initial=0.0)


def _program(cost, equal, right, rows, room):
    """x with equal x = right, rows x <= room and the smallest cost x; None if there is none.

    Where the cost has no bound, x is infinite in the direction of -cost.
    """
    sizes = np.linalg.norm(equal, axis=0)
    sizes = np.where(sizes > 0.0, sizes, 1.0)
    some = np.linalg.lstsq(equal / sizes, right, rcond=DEPENDENT)[0] / sizes
    free = scipy.linalg.null_space(equal / sizes, rcond=DEPENDENT) / sizes[:, None]
    if not free.shape[1]:
        return some
    found = scipy.optimize.linprog(cost @ free, rows @ free, room - rows @ some, bounds=(None, None))
    if found.status == 3:
        return np.where(cost != 0.0, np.copysign(np.inf, -cost), some)
    return some + free @ found.x if found.status == 0 else None


def _smallest(effects, u, right):
    """Inputs of the smallest sum of squares whose effects differ from those of u by `right`."""
    sizes = np.linalg.norm(effects, axis=0)
    sizes = np.where(sizes > 0.0, sizes, 1.0)
    u = u + np.linalg.lstsq(effects / sizes, right, rcond=DEPENDENT)[0] / sizes
    free = scipy.linalg.null_space(effects / sizes, rcond=DEPENDENT) / sizes[:, None] if len(u) else np.eye(0)
    return u - free @ np.linalg.lstsq(free, u, rcond=DEPENDENT)[0]
