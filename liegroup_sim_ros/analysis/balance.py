# SPDX-License-Identifier: Apache-2.0
"""Energy balance of a run: what is stored, what work was done, and what does not add up.

    kinetic + potential energy + energy of springs - (work of forces and joints + energy of impacts) = constant

The energies are those of the recorded states, the energies of impacts and works of contacts are recorded. Other work is
the integral of the powers at the samples, by quintic splines between the times at which an input or a mode of a joint
changes, or what a sampled law holds, unless that changes more often than there are samples. The error of this
quadrature is estimated by its difference from that with every second sample, summed over the times between samples.
Where samples are too far apart for the powers, as of a stiff servo, states between them are integrated (between.py).
The remainder contains both errors, that of the motion and that of the quadrature.
"""

import numpy as np
from scipy.interpolate import make_interp_spline

from liegroup_core.forces import kinds
from liegroup_core.forces.contact import WORK
from liegroup_core.forces.external import acts, power
from liegroup_core.forces.instants import StepGrid
from liegroup_core.forces.law import laws_of, states_of
from liegroup_core.forces.sampled import Sampling
from liegroup_core.observables.along import STORES, powers
from liegroup_sim_ros.messages.joint_modes import ENERGY

from .acting import ActingInputs
from .between import COARSE, FINE, Between

WORKS = (*kinds.POWERS, "wrenches", "driven joints", "stops and friction", "impacts", "contacts")
WRENCHES, IMPACTS, CONTACTS = map(WORKS.index, ("wrenches", "impacts", "contacts"))
MOST_POINTS = 2000  # of a curve
DEGREE = 5
AT_CHANGE = 1e-9  # s: stamps are rounded to ns
RESOLVED = 1e-3  # error of the work of a run, relative to its energies, up to which its samples are close enough


class Balance:
    """Energy balance, block by block."""

    def __init__(self, layout, recording, expected):
        self._layout, self._step = layout, recording.settings["step"]
        self._acting, self._grid = ActingInputs(layout, self._step), StepGrid(self._step)
        forces, self._sampling = layout.model.forces, Sampling(layout, self._grid)
        self._held = slice(len(forces.counted), len(forces.counted) + len(forces.laws.held))
        self._laws, states = [law.name for law in laws_of(layout.scene.forces)], dict(states_of(layout.scene.forces))
        contacts = {force.name for force in layout.scene.forces if force.type == "contact"}
        self._known = [(k, [*states].index(f"{law}.{WORK}")) for k, law in enumerate(self._laws) if law in contacts]
        self._first_state = kinds.count(forces) - len(states)
        self._has_forces = any(not force.is_conservative for force in layout.scene.forces)
        self._has_joints = bool(layout.motions or layout.switches)
        self._between = Between(layout.scene, recording.settings)
        self._every, self._expected = -(-expected // MOST_POINTS), expected
        self._stretch = self._first = None
        self._work, self._set = np.zeros(len(WORKS) + len(self._laws)), 0.0
        self._largest, self._at, self._error, self._taken, self._scale = 0.0, None, 0.0, 0, 0.0
        self._curves = {}

    def add(self, block, stored, angles):
        """Add a Block with its energies (k, 3) by STORES, J, and the angles (k, t) of its torsional springs, rad."""
        state = block.times, block.pose, block.twist, angles
        fresh = block.stretch is not self._stretch
        if fresh:
            if self._first is None:
                self._first = self._last = stored[0]
            self._set += float(stored[0].sum() - self._last.sum())
            self._stretch, self._changes = block.stretch, self._acting.changes(block.stretch)
            self._does_work = self._has_forces or self._has_joints or len(block.stretch.inputs) > 0
        else:
            state = tuple(np.concatenate([old, new]) for old, new in zip(self._before, state))
        self._scale = max(self._scale, float(stored[:, 0].max()), float(np.abs(stored - self._first).sum(axis=1).max()))
        works, errors = self._works(*state, fresh=fresh)
        between = [None] * len(errors)
        for apart in (COARSE, FINE):
            unresolved = np.flatnonzero(errors > RESOLVED * self._scale / self._expected)
            for k in unresolved:
                more = self._between.states(self._stretch, [part[k - 1] for part in state], state[0][k], apart)
                between[k] = more or between[k]
            if len(unresolved):
                works, errors = self._works_through(state, [more for more in between if more], fresh)
        works, self._error = works[-len(stored) :], self._error + float(errors.sum())
        self._before, self._last = (*(part[-1:] for part in state),), stored[-1]
        self._work = works[-1]
        remainder = stored.sum(axis=1) - works[:, : len(WORKS)].sum(axis=1) - self._first.sum() - self._set
        worst = int(np.abs(remainder).argmax())
        if not abs(remainder[worst]) <= abs(self._largest):  # True also for NaN
            self._largest, self._at = float(remainder[worst]), float(block.log_times[worst])
        self._remainder = float(remainder[-1])
        rows = slice(-self._taken % self._every, None, self._every)
        self._taken += len(works)
        columns = block.log_times, stored - self._first, works[:, : len(WORKS)], remainder
        self._curves.setdefault(id(block.stretch), []).append(tuple(part[rows] for part in columns))

    def _works_through(self, state, between, fresh):
        """`_works` at the states, by way of those in between."""
        merged = [np.concatenate(parts) for parts in zip(state, *between)]
        order = np.argsort(merged[0], kind="stable")
        works, errors = self._works(*(part[order] for part in merged), fresh=fresh)
        kept = np.argsort(order)[: len(state[0])]
        return works[kept], np.diff(np.cumsum(errors)[kept], prepend=0.0)

    def _works(self, times, pose, twist, angles, fresh=False):
        """Work by WORKS and of each law at k states, since the start of the run, (k, w + l) J; and its errors.

        fresh : a stretch begins with them
        returns also (k,) J, the error of the work since the state before, all WORKS together
        """
        out, errors = np.tile(self._work, (len(times), 1)), np.zeros(len(times))
        if not self._does_work:
            return out, errors
        pose, twist = self._layout.offsets.to_centres(pose, twist)
        done, changes = self._work.copy(), self._changes
        inner = changes[(changes > times[0]) & (changes < times[-1])]
        ends = (self._grid.instant(float(time)) for time in times[[0, -1]])
        sampled = self._sampling.between(*ends, len(times))
        if sampled:
            inner = np.unique(np.concatenate([inner, sampled]))
        for a, b in zip([times[0], *inner], [*inner, times[-1]]):
            first, end = np.searchsorted(times, [a - AT_CHANGE, b + AT_CHANGE])
            # With fewer than two samples inside, those around are better than none.
            around = end - first < 2
            rows = slice(max(0, first - around), end + around)
            own = angles[rows]
            if sampled:
                own = own.copy()
                own[:, self._held] = angles[min(first, len(angles) - 1), self._held]
            found = self._powers(0.5 * (a + b), times[rows], pose[rows], twist[rows], own)
            work, error = _integrals(times[rows], found, a)
            out[first:end] = done + work(times[first:end])
            done += work(b)
            errors[rows][1:] += error[:, : len(WORKS)].sum(axis=1)
        for law, s in self._known:
            known = angles[:, self._first_state + s]
            out[:, [CONTACTS, len(WORKS) + law]] += (known - known[0])[:, None]
        track = self._stretch.joint_modes
        if track is not None:
            total = np.concatenate([[0.0], np.cumsum(track.values[:, :, ENERGY].sum(axis=1))])
            when = (track.stamp_ns - self._stretch.base_ns) * 1e-9
            # The first sample of a stretch is that before an impact at its time, others are those after it.
            since = times[0] + (-AT_CHANGE if fresh else AT_CHANGE)
            before, *until = total[np.searchsorted(when, [since, *(times + AT_CHANGE)], "right")]
            out[:, IMPACTS] += np.array(until) - before
        return out, errors

    def _powers(self, time, times, pose, twist, angles):
        """(k, w + l) W at k states, with the inputs at a time in s since step 0; 0 of impacts."""
        layout, (acting, _, modes) = self._layout, self._acting.at(self._stretch, time)
        out = np.zeros((len(times), len(self._work)))
        if self._has_forces:
            own = [law for law, _ in self._known]
            found = powers(layout, angles, acting.targets, times, pose, twist, own)
            out[:, :WRENCHES], out[:, len(WORKS) :] = np.split(found, [WRENCHES], axis=1)
        if acts(acting.external):
            out[:, WRENCHES] = [power(acting.external, *state) for state in zip(pose, twist)]
        if self._has_joints:
            found = layout.reactions.powers(pose, twist, angles, acting, modes, times.tolist())
            found = found if layout.switches else found * (1.0, 0.0)  # no round-off as work
            out[:, WRENCHES + 1 : IMPACTS] = found
        return out

    def figures(self):
        """(figures, [(times, change of energies (k, 3), works (k, w), remainder (k,))] per stretch), J."""
        stored = [
            {"name": name, "start_J": start, "end_J": end}
            for name, start, end in zip(STORES, self._first.tolist(), self._last.tolist())
        ]
        return {
            "stored": stored,
            "work_J": dict(zip(WORKS, self._work.tolist())),
            "work_of_laws_J": dict(zip(self._laws, self._work[len(WORKS) :].tolist())),
            "set_J": self._set,
            "remainder_J": self._remainder,
            "largest_J": abs(self._largest),
            "largest_at_s": self._at,
            "quadrature_J": self._error,
        }, [tuple(np.concatenate(part) for part in zip(*parts)) for parts in self._curves.values()]


def _integrals(times, values, a):
    """(function of times: integral of values (k, w) from a on, errors between the times (k - 1, w)); k > 1."""
    fine, rows = _integral(times, values, a), np.append(np.arange(0, len(times) - 1, 2), len(times) - 1)
    if len(times) == 2:
        rows = rows[:1]
    apart = fine(times) - _integral(times[rows], values[rows], a)(times)
    return fine, np.abs(np.diff(apart, axis=0))


def _integral(times, values, start):
    """Function of times: integral from a start, of the polynomial or quintic spline through the values (k, w)."""
    if len(times) > DEGREE + 1:
        total = make_interp_spline(times, values, DEGREE).antiderivative()
        return lambda at: total(at) - total(start)
    unit, powers_of = times[-1] - times[0] or 1.0, np.arange(len(times))
    scaled = ((times - start) / unit)[:, None] ** powers_of
    coefficients = np.linalg.solve(scaled, values) * (unit / (powers_of + 1.0))[:, None]
    return lambda at: (np.asarray((at - start) / unit)[..., None] ** (powers_of + 1.0)) @ coefficients
