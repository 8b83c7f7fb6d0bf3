# SPDX-License-Identifier: Apache-2.0
"""Variational equations of a run: how small differences of its start, and of numbers of its scene, arrive later,

    dx' = A(t) dx + F(t) dp ,   x = (z, z')

with A of linear_system.py in the chart that moves with the state, and F the derivative of the accelerations at the
state by the numbers p (numbers.py). They are solved by Lobatto IIIC in intervals, whose length follows the last
coefficients of the polynomials.

The differences are displacements and rates of all freedoms of the tree. Each interval has independent coordinates of
its own; those that stops or friction hold are among them, as they may differ, too.

At an event of stops, friction or a law differences jump: the event comes earlier or later. From a step before it to a
step after it they are differences of order six between neighbouring runs, so that every event acts as it does.
"""

import contextlib
import math

import numpy as np
from numpy.polynomial import legendre

from liegroup_core.errors import SimulationError
from liegroup_core.events.times import SAME_TIME
from liegroup_core.forces.contact import stiffest
from liegroup_core.forces.formulas import SHARED
from liegroup_core.forces.instants import AFTER
from liegroup_core.settings import of_engine
from liegroup_core.simulation import Simulation

from .channels import StateChannels
from .coordinates import ANGLE, Coordinates, scales_of
from .differences import SIDED, WEIGHTS, derivative
from .numbers import Sides
from .probe import Probe

LOCAL = 1e-11  # largest relative error of an interval
ROUGHLY = 1e-2  # and that of a difference that is an error
FIRST, MOST = 1e-2, 4.0  # s: first interval; growth from one to the next
SHORTEST = 100  # ns
MARGIN = 0.25  # of a step, between an event and the ends of the steps that cross it
PARTS = 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000  # of a step: whole ns of most
TIGHT = 1e-13  # tolerances of the run and of neighbouring runs
NEAR = 1e-3  # rad, and of the mechanism's size: first distance of neighbouring runs
FEW = 1e-12  # relative size of a singular value that is round-off
# Of Lobatto: at the ends, too, so that no jump of A falls between two intervals.
POINTS = 10
NODES = 0.5 + 0.5 * np.array([-1.0, *legendre.Legendre.basis(POINTS - 1).deriv().roots(), 1.0])
TINY = 1e-300


class Variations:
    """Differences (c, f, 2), displacements and rates of all freedoms of the tree, along a run.

    simulation : Simulation, whose state is the start; it does not change
    end_ns     : ns, the latest time
    differences: (c, f, 2) at the start, of the freedoms of a Probe in space
    numbers    : Numbers of the scene, whose q columns follow, by value / scale; None: none

    probe   : at the present state
    columns : (c + q, f, 2) differences now
    doubt   : (c + q, f, 2) those with all errors
    rough   : (c + q,) whether neighbouring runs have other events, so that a column has no meaning any more
    Raises SimulationError, OtherStructure. Accuracy: test/verification/test_transition.py, test_sensitivities.py.
    """

    def __init__(self, simulation, end_ns, differences=None, numbers=None):
        self._settings, self._parts = _settings(simulation)
        self._run, self._near = (self._copy(simulation) for _ in range(2))
        self.time_ns, self._h = simulation.time_ns, FIRST
        self._windows = self._events(end_ns)
        self.probe = Probe(self._run, in_space=True)
        self._scales = scales_of(self.probe.layout)
        self._sides = None if numbers is None else Sides(numbers, self._run, self._settings)
        f = self.probe.freedoms
        self.columns = np.zeros((0, f, 2)) if differences is None else np.asarray(differences, dtype=float)
        self._first, self._count = len(self.columns), 0 if numbers is None else len(numbers)
        self.doubt = self.columns.copy()
        if self._count:
            outputs = StateChannels(self.probe)
            shown, error = self._sides.at_start(outputs)
            own, doubt = self._from_bodies(self.probe, outputs, shown, error)
            self.columns, self.doubt = np.concatenate([self.columns, own]), np.concatenate([self.doubt, doubt])
        self.rough = np.zeros(len(self.columns), dtype=bool)

    def _copy(self, simulation):
        copy = Simulation(simulation.scene, quiet=True, **self._settings)
        copy.start_from(simulation)
        return copy

    def _events(self, end_ns):
        """[(start, end)] in ns of the steps of the Simulation that cross events up to a time."""
        run, found, h, parts = self._near, [], self._near.step * self._parts, self._parts
        if not (run.layout.switches or len(run.layout.model.forces.laws.kinks)):
            return found
        start = run.snapshot()
        run.drain_instants()  # kept from now on
        run.reach(run.instant_of(end_ns))
        with contextlib.suppress(SimulationError):  # after the end
            run.advance(parts)
        # At the start neighbouring states may move where this one is at rest.
        begin = start.parts["steps"] // parts
        found.append([begin, begin + 1])
        for event in run.drain_instants()[1:]:
            first = max(math.floor(event.time / h - MARGIN), begin)
            last = math.ceil(event.time / h + MARGIN)
            if first <= found[-1][1]:
                found[-1][1] = max(last, found[-1][1])
            else:
                found.append([first, last])
        run.restore(start)
        return [tuple(run.step_ns(parts * step) for step in window) for window in found]

    def through(self, times_ns, tell=None):
        """Yield a Sample at times in ns that do not decrease; `columns` and `doubt` are there.

        tell : function of the time in ns, how far the run is
        """
        waiting = list(times_ns)
        parts = iter(())
        while waiting:
            if waiting[0] <= self.time_ns:
                waiting.pop(0)
                yield self.probe.base
                continue
            part = next(parts, None)
            if part is None:
                parts = self._part(waiting)
                continue
            sample, self.columns, self.doubt = part
            self.probe.take(sample)
            self.time_ns = sample.time_ns
            if tell is not None:
                tell(self.time_ns)

    def _part(self, waiting):
        """[(Sample, columns, doubt)] at the waiting times in the next part of the run, and at its end."""
        window = next(((a, b) for a, b in self._windows if b > self.time_ns), (waiting[-1], waiting[-1]))
        if window[0] <= self.time_ns:
            return self._cross([time for time in waiting if time < window[1]], window[1])
        change = self._run.inputs.schedule.next_after(self._run.instant_of(self.time_ns))
        limits = [waiting[-1], window[0], *([] if change is AFTER else [round(1e9 * change.time)])]
        return self._interval(waiting, min(limit for limit in limits if limit > self.time_ns))

    def _interval(self, waiting, limit_ns):
        """[(Sample, columns, doubt)] at those of the waiting times that are in an interval, and at its end."""
        state, began = self._run.snapshot(), self.time_ns
        coordinates = Coordinates(self.probe, displaced=True)
        start = np.hstack([self._state(coordinates, each) for each in (self.columns, self.doubt)])
        left, count = limit_ns - began, len(self.columns)
        while True:
            h = round(self._h * 1e9)
            h = left if h >= left else max(min(h, left // 2), min(SHORTEST, left))
            times = sorted({*(time for time in waiting if time < began + h), began + h})
            error = np.inf
            try:
                samples, u, live, matrices, doubts, kept = self._look(began, h, times, coordinates)
                begin = start[live]
                found = _Collocation(u, matrices, 1e-9 * h, begin)
                # What errors of the derivatives allow is not resolved.
                noise = found.filter @ (doubts @ np.maximum(np.abs(begin), np.abs(found.at(1.0))))
                size, allowed = (np.abs(x).max(axis=0, initial=TINY) for x in (found.at(1.0)[: len(noise)], noise))
                # Errors that were carried here need two digits, of their largest size: some decay fast.
                apart = [np.subtract(*np.hsplit(x, 2)) for x in (begin, found.at(1.0))]
                allowed[count:] += ROUGHLY * np.abs(np.vstack(apart)).max(axis=0, initial=0.0)
                error = (found.error.max(axis=0, initial=0.0) / (size + allowed / LOCAL)).max(initial=0.0)
            except SimulationError:
                if h <= SHORTEST:
                    raise
            self._h = 1e-9 * h * float(np.clip(0.9 * (LOCAL / max(error, TINY)) ** (1.0 / (POINTS + 2)), 0.1, MOST))
            if error <= LOCAL or h <= SHORTEST:
                break
            self._run.restore(state)
        for time in times:
            x, end = start.copy(), found.at((time - began) / h)
            if time == began + h:
                # A jump of A may lie anywhere in a shortest interval.
                rest = found.error if error <= LOCAL else found.range
                end[: len(noise), count:] += (rest + noise)[:, :count]
            x[live] = end
            yield samples[time], *(self._columns(*kept[time], part) for part in (x[:, :count], x[:, count:]))

    def _look(self, began, h, times, coordinates):
        """What an interval of h ns needs.

        Most states of contacts have zero rows and columns in A while nothing touches: they stay as they are.

        returns {time: Sample}; points u (s,); numbers of the r coordinates that change, then of the q numbers; [A F]
        of these at the points, errors (r, r + q); {time: (Coordinates, changes, offsets)}
        """
        # The last one is before the end, where inputs may change.
        nodes = [began + min(round(part * h), h - 1) for part in (NODES if h >= SHORTEST else [0.5])]
        samples = self._samples(sorted({*nodes, *times}))
        matrices, kept = [], {}
        acts = np.zeros(self.probe.freedoms, dtype=bool)
        for sample in samples.values():
            self.probe.take(sample)
            acts |= self.probe.acts
        for time, sample in samples.items():
            self.probe.take(sample)
            here = Coordinates(self.probe, coordinates.rate_names, coordinates.names, displaced=True)
            by_numbers = self._by_numbers(here)
            if time in nodes:
                matrices.append(self._matrix(here, *by_numbers, acts[here.moving]))
            kept[time] = here, here.changes, by_numbers[0]
        matrices, doubts = np.array(matrices).swapaxes(0, 1)
        columns = np.ones(matrices.shape[1] + self._count, dtype=bool)
        columns[len(here.independent) : len(columns) - self._count] = acts[here.moving]
        live = columns.copy()
        live[: matrices.shape[1]] |= matrices.any(axis=(0, 2))
        live, columns = np.flatnonzero(live), np.flatnonzero(columns)
        whole = np.zeros((2, len(nodes), len(live) - self._count, len(live)))
        whole[..., np.searchsorted(live, columns)] = np.stack((matrices, doubts))[:, :, live[: whole.shape[2]]]
        return samples, (np.array(nodes) - began) / h, live, whole[0], whole[1].max(axis=0), kept

    def _samples(self, times):
        """{time in ns: Sample} of the run, which goes to the last one."""
        found = {}
        for time in times:
            self._run.reach(self._run.instant_of(time))
            found[time] = self._run.sample()
        return found

    def _by_numbers(self, coordinates):
        """Changes with the numbers at the state of the probe: of dependent freedoms, of accelerations, its error."""
        probe, f = self.probe, self.probe.freedoms
        if not self._count:
            return np.zeros((0, f, 2)), np.zeros((0, f)), np.zeros((0, f))
        found, error = self._sides.of_equations(probe)
        gaps, slips = np.split(found[:, f:], 2, axis=1)
        return coordinates.closing(gaps, slips), found[:, :f], error[:, :f]

    def _matrix(self, coordinates, offsets, accelerations, error, acts=None):
        """[A F] (n, n + q) at the state of the probe, and their errors; acts : which rates have columns, None: all."""
        probe, f = self.probe, self.probe.freedoms
        rates = coordinates.rates if acts is None else coordinates.rates[:, acts]
        m, r, q = len(coordinates.independent), rates.shape[1], self._count
        n = m + r
        directions = np.zeros((n + q, f, 2))
        directions[:m, :, 0], directions[:m, :, 1] = coordinates.motions.T, coordinates.changes.T
        directions[m:n, :, 1], directions[n:] = rates.T, offsets
        slopes, doubts = np.zeros((2, n + q, 2 * f))
        slopes[n:, f:], doubts[n:, f:] = accelerations, error
        moving = directions.any(axis=(1, 2))
        if moving.any():
            ways = directions[moving]
            sizes = ANGLE / np.abs(ways / self._scales[:, None]).max(axis=(1, 2))
            found, doubt = probe.derivatives(ways, sizes)
            # In the chart that moves with the state, d/dt psi = w + [psi, V]; in the fixed one half of the bracket.
            found[:, :f] += found[:, :f] - ways[:, :, 1]
            slopes[moving] += found
            doubts[moving] += doubt
        rows = np.concatenate([coordinates.independent, f + coordinates.moving])
        return slopes[:, rows].T, doubts[:, rows].T

    def matrix(self, coordinates):
        """A (n, n) of Coordinates at the present state."""
        found = self._matrix(coordinates, *self._by_numbers(coordinates))[0]
        return found[:, : len(found)]

    def _state(self, coordinates, columns):
        """(n + q, c + q) independent coordinates of columns (c + q, f, 2), and 1 for each number."""
        x = [columns[:, coordinates.independent, 0].T, columns[:, coordinates.moving, 1].T]
        return np.vstack([*x, np.eye(self._count, len(columns), self._first)])

    def _columns(self, coordinates, changes, offsets, x):
        """(c + q, f, 2) of independent coordinates and numbers (n + q, c + q)."""
        m = len(coordinates.independent)
        n = m + len(coordinates.moving)
        columns = np.tensordot(x[n:].T, offsets, 1)
        columns[:, :, 0] += (coordinates.motions @ x[:m]).T
        columns[:, :, 1] += (changes @ x[:m] + coordinates.rates @ x[m:n]).T
        return columns

    def _cross(self, inside, end_ns):
        """[(Sample, columns, doubt)] at times inside a window of events and at its end, from neighbouring runs."""
        run, probe, start, times = self._run, self.probe, self._run.snapshot(), [*inside, end_ns]
        angles = probe.base.angles.copy()
        near = probe.base.switching[:, 3].copy() if probe.layout.switches else np.empty(0)
        run.drain_instants()
        samples = self._samples(times)
        home, expected = self._events_at(run, self.time_ns, times)
        self._near.restore(start)
        probes = [Probe(self._near, in_space=True) for _ in times]
        for one, time in zip(probes, times):
            one.take(samples[time])
        outputs = [StateChannels(one) for one in probes]

        base = np.array([seen.of(samples[time]) for time, seen in zip(times, outputs)])

        def arrivals(other, beside, way, s, whole=False):
            """(k, p) StateChannels of the run s ways beside; NaN between its and our event, refused if whole."""
            if beside is not probe:
                beside.follow(probe)
            rates, *state = beside.beside(s * way)
            own = beside.with_states(angles, rates)
            commands = other.inputs.commands
            other.drain_instants()
            other.set_state(*state, start.parts["steps"], own, near)
            other.inputs.commands = commands
            met = []
            for time, seen in zip(times, outputs):
                other.reach(other.instant_of(time))
                met.append(seen.of(other.sample()))
            events = self._events_at(other, self.time_ns, times, home)[1]
            if events[-1] != expected[-1] or whole and events != expected:
                raise SimulationError("neighbouring runs have other events")
            return np.where([[mine == own] for mine, own in zip(events, expected)], met, np.nan)

        def values(c, s, whole):
            sides = (self._near, probe) if c < self._first else self._sides.at(c - self._first, s)
            return arrivals(*sides, self.columns[c], s, whole)

        # Neighbours come to a surface from both sides, whose forces differ.
        weights = SIDED if SHARED in home else WEIGHTS

        def crossed(c):
            for whole in (True, False):  # near enough that no time is between two events, if that is possible
                with contextlib.suppress(SimulationError):
                    size = NEAR / max(self._sizes(self.columns)[c], 1.0)
                    return derivative(lambda s, whole=whole: values(c, s, whole), size, base, weights, TIGHT)
            self.rough[c] = True
            return np.zeros((2, len(times), len(outputs[0])))

        def carried(error, size):
            """(k, p) what an error before the events is after them."""
            if size == 0.0:
                return np.zeros((len(times), len(outputs[0])))
            h = NEAR / size
            try:
                sides = (arrivals(self._near, probe, error, sign * h) for sign in (1, -1))
                return np.nan_to_num(np.subtract(*sides)) / (2.0 * h)
            except SimulationError:
                return np.full((len(times), len(outputs[0])), size)

        found, error = (np.array(part).swapaxes(0, 1) for part in zip(*map(crossed, range(len(self.columns)))))
        before = self.doubt - self.columns
        error += np.abs(np.array(list(map(carried, before, self._sizes(before))))).swapaxes(0, 1)
        for shown, doubt, one, seen, time in zip(found, error, probes, outputs, times):
            yield samples[time], *self._from_bodies(one, seen, shown, doubt)

    def _sizes(self, columns):
        """(c,) largest entries of columns, in the units of the freedoms."""
        return np.abs(columns / self._scales[:, None]).max(axis=(1, 2), initial=0.0)

    @staticmethod
    def _events_at(run, start_ns, times, home=()):
        """(branches of laws after the start, for each time in ns: modes and events after each change of the modes).

        Round-off decides which sides of a surface of a law a run meets before it slides along it: the last ones count.

        home : branches of a run that slides from its start; how a neighbour beside the surface gets there is left out
        """
        instants = run.drain_instants()
        ends = [*(np.nextafter(one.time - SAME_TIME, 0.0) for one in instants[1:]), np.inf]
        found = [
            (1e9 * one.time, one.branches.tolist(), one.modes[:, :3].tolist(), [event[1:3] for event in one.events])
            for one, end in zip(instants, ends)
            if one.events or one.time < end
        ]
        first = next((k for k, one in enumerate(found) if one[0] > start_ns + 0.5), len(found))
        begins = found[first - 1][1] if first else []
        if SHARED in home and begins != home:
            back = next((k + 1 for k, one in enumerate(found) if k >= first and one[1] == home), first)
            first = first if any(one[3] for one in found[first:back]) else back
        return begins, [[rest for when, *rest in found[first:] if when <= time] for time in times]

    def of_outputs(self, outputs):
        """(c + q, p) changes of OutputChannels of the probe, and their errors."""
        found, doubt = (outputs.along(columns) for columns in (self.columns, self.doubt))
        if found is None:
            flat = [self._flat(columns) for columns in (self.columns, self.doubt)]
            used = np.any(flat, axis=(0, 1))
            frame = self._frame(self.probe, outputs, used)
            found, doubt = (columns[:, used] @ frame for columns in flat)
            if self._count:
                own, error = self._sides.of_outputs(self.probe, outputs)
                found[self._first :] += own
                doubt[self._first :] += own + error
        return found, np.abs(doubt - found)

    def _flat(self, columns):
        """(c, 2 f) columns (c, f, 2) in the units of the freedoms."""
        return (columns / self._scales[:, None]).swapaxes(1, 2).reshape(len(columns), 2 * len(self._scales))

    def _frame(self, probe, outputs, used):
        """(k, p) derivatives of p OutputChannels by those of f freedoms and their f rates that are used (2 f,)."""
        f, base = probe.freedoms, outputs.of(probe.neighbour())
        ways = np.eye(2 * f)[used].reshape(used.sum(), 2, f).swapaxes(1, 2) * self._scales[:, None]
        parts = [
            derivative(lambda s, w=w: outputs.apart(outputs.of(probe.neighbour(s * w)), base), ANGLE) for w in ways
        ]
        return np.reshape([part for part, _ in parts], (len(ways), len(outputs)))

    def _from_bodies(self, probe, outputs, shown, error):
        """Columns (c, f, 2) whose changes of all StateChannels are (c, p), and those with the errors of these.

        Those of numbers are the last.
        """
        states, own = probe.state_freedoms, np.zeros_like(shown)
        used = np.ones((2, probe.freedoms), dtype=bool)
        used[:, states] = False
        used, seen = used.ravel(), len(outputs) - len(states)
        frame = self._frame(probe, outputs, used)[:, :seen]
        if self._count:
            own[len(own) - self._count :] = self._sides.of_outputs(probe, outputs)[0]

        def columns(values):
            known = np.isfinite(values).all(axis=1)
            x = np.full((2 * probe.freedoms, len(values)), np.nan)
            x[:, known] = 0.0
            x[np.ix_(used, known)] = np.linalg.lstsq(frame.T, values[known, :seen].T, rcond=FEW)[0]
            x[np.ix_(probe.freedoms + states, known)] = values[known, seen:].T / self._scales[states, None]
            return x.T.reshape(len(values), 2, probe.freedoms).swapaxes(1, 2) * self._scales[:, None]

        return columns(shown - own), columns(shown + error - own)


def _settings(simulation):
    """(settings without an estimate, and with tight tolerances instead of an accuracy; steps in one of the Simulation).

    A state within a step is integrated from its start: steps are no longer than the way between two points of an
    interval in which the stiffest contact acts.
    """
    if simulation.promise is None:
        return simulation.arguments | {"estimate": False}, 1
    settings = of_engine(simulation) | {"method": simulation.method, "rtol": TIGHT, "atol": TIGHT, "estimate": False}
    step, longest = settings["step"], stiffest(simulation.scene.forces)[0] / POINTS
    parts = next(parts for parts in PARTS if step <= parts * longest or parts == PARTS[-1])
    parts = 1 if round(1e9 * step) % parts else parts
    return settings | {"step": step / parts}, parts


class _Polynomial:
    """Polynomials through points u (s,) of an interval, in Legendre's basis."""

    def __init__(self, u):
        self._inverse = np.linalg.inv(legendre.legvander(2.0 * u - 1.0, len(u) - 1))

    def coefficients(self, values):
        """(s, ...) of values (s, ...)."""
        return np.tensordot(self._inverse, values, 1)

    def integrals(self, u):
        """(k, s) weights of the values in integrals from 0 to u (k,)."""
        x, s = 2.0 * np.atleast_1d(u) - 1.0, len(self._inverse)
        basis = legendre.legvander(x, s)
        # Integrals of P_k over the interval are (P_k+1 - P_k-1) / (2 (2 k + 1)), and x + 1 of P_0.
        found = np.empty((len(x), s))
        found[:, 0] = 0.5 * (x + 1.0)
        found[:, 1:] = 0.5 * (basis[:, 2:] - basis[:, : s - 1]) / (2.0 * np.arange(1, s) + 1.0)
        return found @ self._inverse

    def damped(self, u):
        """(s, s) weights of Lobatto IIIC in these integrals to the points: those of the first point are all equal."""
        found = self.integrals(u)
        if len(u) > 1:
            basis = legendre.legvander(2.0 * u - 1.0, len(u) - 2)
            first = self.integrals(1.0)[0, 0]
            rest = found @ basis - first * basis[0]
            found = np.column_stack([np.full(len(u), first), np.linalg.solve(basis[1:].T, rest.T).T])
        return found


class _Collocation:
    """Polynomials x (n + q, c) of x' = A x + F p over an interval of h s, by Lobatto IIIC.

    What decays much faster than h decays in the interval, too: Hairer and Wanner, Solving Ordinary Differential
    Equations II, IV.5. Errors are filtered as there in IV.8: what a rate does until it has decayed.

    u, matrices : (s,) points of the interval, and [A F] (s, n, n + q) there
    start       : (n + q, c), with constant p
    filter      : (n, n) s, by which errors of x' that stay act on x at the end
    error       : (n, c), from the coefficients of x'
    range       : (n, c), of x' times h
    """

    def __init__(self, u, matrices, h, start):
        s, n, _ = matrices.shape
        self._polynomial, self._start, self._h = _Polynomial(u), start, h
        weights = self._polynomial.damped(u)
        left = np.eye(s * n) - h * np.einsum("iab,ij->iajb", matrices[:, :, :n], weights).reshape(s * n, s * n)
        count = start.shape[1]
        self._rates = np.linalg.solve(left, (matrices @ start).reshape(s * n, count)).reshape(s, n, count)
        # The coefficients decrease like a geometric sequence; two of them, as every second one may be zero.
        part = h / (2.0 * s)
        last = self._polynomial.coefficients(self._rates)[-4:]
        sizes = np.abs(np.linalg.solve(np.eye(n) - part * matrices[-1, :, :n], last))
        last, before = sizes[-2:].sum(axis=0), sizes[-4:-2].sum(axis=0)
        ratio = np.divide(last, before, out=np.zeros_like(last), where=before > 0.0)
        self.filter = h * np.abs(np.linalg.inv(np.eye(n) - h * matrices[-1, :, :n]))
        self.error, self.range = part * last * np.minimum(ratio, 1.0), h * np.ptp(self._rates, axis=0)

    def at(self, u):
        """x at a part u of the interval."""
        x, n = self._start.copy(), self._rates.shape[1]
        x[:n] += self._h * np.tensordot(self._polynomial.integrals(u)[0], self._rates, 1)
        return x
