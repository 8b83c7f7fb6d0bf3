# SPDX-License-Identifier: Apache-2.0
"""Independent coordinates of a mechanism near a state, and the tangent space of its motions.

Without loops every degree of freedom of the spanning tree is independent. Cut joints, couplings and driven joints
leave a subspace for velocities, the range of their projection P. Rows of a basis of it with the best condition are
independent:

    psi = N z ,   w = M u + c(z)

with the changes c of rates that keep the joints closed where the position changes. N is M, except where wheels, balls
that roll or knife edges forbid velocities only: then N is the null space of the position residuals, and there are
more coordinates z than rates u. Together they are the tangent space of all states, in which the equations of motion
are linearised.

A motion that slides along a surface of a law stays on it, so that one rate depends on the others and on the
coordinates: the surface forbids a velocity, as a wheel does.
"""

from functools import cached_property

import numpy as np
import scipy

from liegroup_core.errors import SceneError, SimulationError
from liegroup_core.fields.values import suggestion

from .differences import derivative

ANGLE = 1e-2  # first displacement: rad, and of the mechanism's size
# Weights of coordinates of joints, of the independent rates and of preferred ones, where independent ones are chosen.
OF_JOINT, MOVING, PREFERRED = 10.0, 1e3, 1e5
CLOSED, MOST_CLOSINGS = 1e-13, 100  # rad, or share of the mechanism's size: what closes joints still
SMALL_MOVE = 1e-6  # of a direction: round-off
FIRST = 1e-9  # preference for the first of several that are equally independent: above round-off
NO_ROW = 1e-9  # relative size of a row, or a singular value, that is round-off


class Coordinates:
    """Independent coordinates near the state of a Probe.

    chosen : names of freedoms that are independent, of states of laws as many as wanted; None: those with the best
             condition
    preferred : names that are among them if they can be
    displaced : True: coordinates that stops or friction hold are among them, without a rate; and neighbours may be
                beside surfaces of laws
    states : True: states of laws on which something depends are among the independent coordinates, which else have
             positions only; other states are left out

    freedoms : [Freedom]
    independent, moving : indices of the independent coordinates and of the independent rates
    motions  : N (f, m), unit rows at the independent coordinates
    rates    : M (f, p), unit rows at the independent rates
    names, units : of the independent coordinates
    rate_names   : of the independent rates
    Raises SceneError for unknown or dependent names.
    """

    def __init__(self, probe, chosen=None, preferred=(), displaced=False, states=False):
        self._probe, self.freedoms = probe, probe.layout.freedoms
        self.is_state, self._with_states = np.array([not each.unit for each in self.freedoms], dtype=bool), states
        self._signs = np.array([freedom.sign for freedom in self.freedoms])
        self._scales = scales_of(probe.layout)
        self._slides = len(probe.slides) > 0 and not displaced
        basis = self._velocities()
        weights = np.array([OF_JOINT if freedom.is_of_joint else 1.0 for freedom in self.freedoms])
        weights *= 1.0 - FIRST * np.arange(len(weights))
        weights[[self.number(name) for name in preferred]] = PREFERRED
        wanted = None if chosen is None else self._with_all_states(list(map(self.number, chosen)), basis.shape[1])
        if probe.layout.rolls or self._slides or displaced and (probe.held.any() or probe.is_switched.any()):
            places = self._positions(displaced)
            if not displaced and wanted is not None and len(wanted) == places.shape[1] != basis.shape[1]:
                raise SceneError("with rolling or sliding, choose as many coordinates as there are independent rates")
            self.moving, self.rates = self._independent(basis, wanted, weights)
            weights[self.moving] = np.maximum(weights[self.moving], MOVING)
            self.independent, self.motions = self._independent(places, None, weights)
        else:
            self.moving, self.rates = self._independent(basis, wanted, weights)
            self.independent, self.motions = self.moving, self.rates
        if any(self.is_state):
            self._place_states()
        self.names, self.rate_names = ([self.freedoms[k].name for k in of] for of in (self.independent, self.moving))
        self.units = [self.freedoms[k].unit for k in self.independent]

    def _with_all_states(self, numbers, count):
        """Numbers of freedoms, and of states of laws that are not among them, up to a count."""
        others = np.setdiff1d(np.flatnonzero(self.is_state), numbers)
        return np.array([*numbers, *others[: max(count - len(numbers), 0)]], dtype=int)

    def _place_states(self):
        """Leave positions of the links of laws out: their rates are the states, see forces/law.py."""
        kept = np.ones(len(self.independent), dtype=bool) if self._with_states else ~self.is_state[self.independent]
        self.independent, self.motions = self.independent[kept], self.motions[:, kept]

    def rate_name(self, k):
        """Name of the rate of freedom k, of a law that of its state."""
        return self.freedoms[k].name + ("" if self.is_state[k] else ".rate")

    @property
    def state_names(self):
        """Names of the states of a linear system: coordinates, then rates."""
        return (*self.names, *map(self.rate_name, self.moving))

    @property
    def signs(self):
        """(m,) signs of the independent coordinates in their joints."""
        return self._signs[self.independent]

    @property
    def scales(self):
        """(m,) scales of the independent coordinates, see `scales_of`."""
        return self._scales[self.independent]

    @property
    def rate_scales(self):
        """(p,) scales of the independent rates."""
        return self._scales[self.moving]

    @property
    def rate_signs(self):
        """(p,) signs of the independent rates in their joints."""
        return self._signs[self.moving]

    def size(self, k):
        """First displacement along independent coordinate k."""
        return ANGLE * self.scales[k]

    def rate_size(self, k):
        """First displacement along independent rate k."""
        return ANGLE * self.rate_scales[k]

    def _velocities(self):
        """Basis (f, p) of the velocities that the joints allow, in the units of the freedoms."""
        probe = self._probe
        f = probe.freedoms
        free = np.flatnonzero(~probe.held & (probe.acts if self._with_states else True))
        if not probe.is_closed:
            return self._along_surfaces(np.eye(f)[:, free])
        # Columns of P; its nonzero singular values are at least 1.
        rest = probe.closed()[0]
        columns = []
        for k in free:
            y = np.zeros((f, 2))
            y[k, 1] = self._scales[k]
            columns.append((probe.closed(y)[0] - rest) / self._scales)
        left, sizes, _ = np.linalg.svd(np.array(columns).reshape(-1, f).T, full_matrices=False)
        return self._along_surfaces(left[:, sizes > 0.5])

    def _along_surfaces(self, basis):
        """Basis (f, p - s) of those velocities of a basis (f, p) that keep the motion on s surfaces of laws."""
        if not self._slides:
            return basis
        return basis @ scipy.linalg.null_space(self._climbs(self._rate_ways).T @ basis, rcond=NO_ROW)

    def _climbs(self, directions):
        """(d, s) changes along directions (d, f, 2) of the distances from the surfaces of laws."""
        probe = self._probe
        if not self._slides:
            return np.zeros((len(directions), 0))
        with probe.holding():
            return np.array([derivative(lambda s, y=y: probe.heights(s * y), ANGLE)[0] for y in directions])

    @property
    def _rate_ways(self):
        """(f, f, 2) directions of the rates of all freedoms, in the units of the freedoms."""
        f = self._probe.freedoms
        directions = np.zeros((f, f, 2))
        directions[np.arange(f), np.arange(f), 1] = self._scales
        return directions

    @cached_property
    def _gaps(self):
        """(f, m) changes of the position residuals with all freedoms, in the units of the freedoms."""
        probe, rows = self._probe, []
        if not probe.layout.rolls:
            return self._slips
        for k in range(probe.freedoms):
            y = np.zeros((probe.freedoms, 2))

            def gaps(s, y=y, k=k):
                y[k, 0] = s * self._scales[k]
                return probe.gaps(y)

            rows.append(derivative(gaps, ANGLE)[0])
        return np.array(rows)

    def _positions(self, displaced):
        """Basis (f, m) of the displacements that the joints allow, in the units of the freedoms."""
        probe, rows = self._probe, self._gaps.T
        f = probe.freedoms
        rows = rows[~probe.is_switched] if displaced else np.vstack([rows, np.eye(f)[probe.held]])
        sizes = np.linalg.norm(rows, axis=1)
        rows = rows[sizes > NO_ROW * sizes.max(initial=0.0)]
        rows /= np.linalg.norm(rows, axis=1, keepdims=True)
        return scipy.linalg.null_space(rows, rcond=NO_ROW) if len(rows) else np.eye(f)

    def _independent(self, basis, wanted, weights):
        """(indices, matrix) of the rows of a basis that are independent: those wanted, or the best with weights."""
        count = basis.shape[1]
        if count == len(basis) and (wanted is None or (wanted == np.arange(count)).all()):
            return np.arange(count), np.eye(count)
        if wanted is None:
            order = scipy.linalg.qr((basis * weights[:, None]).T, pivoting=True, mode="r")[1]
            picked = np.sort(order[:count])
        else:
            picked = wanted
            if len(picked) != count or len(set(picked.tolist())) != count:
                given = f"{len(set(picked.tolist()))} different independent coordinates are given"
                raise SceneError(f"{given}, the mechanism has {count} here")
        square = basis[picked]
        if count and np.linalg.svd(square, compute_uv=False)[-1] < 1e-9:
            raise SceneError(f"the coordinates {', '.join(self.freedoms[k].name for k in picked)} are not independent")
        found = self._scales[:, None] * np.linalg.solve(square.T, basis.T).T / self._scales[picked]
        found[picked] = np.eye(count)
        return picked, found

    @cached_property
    def _numbers(self):
        return {freedom.name: k for k, freedom in enumerate(self.freedoms)}

    def number(self, name):
        """Index of the freedom with a name. Raises SceneError."""
        if name not in self._numbers:
            raise SceneError(f"unknown coordinate {name!r}; {suggestion(name, [*self._numbers])}")
        return self._numbers[name]

    @cached_property
    def changes(self):
        """Changes c (f, m) of the dependent rates with the coordinates; zero without loops."""
        probe = self._probe
        changes = np.zeros_like(self.motions)
        if not (probe.is_closed or self._slides):
            return changes
        # J c = -d(J V) along the independent coordinates, without a change of the independent rates.
        directions = np.zeros((len(self.independent), probe.freedoms, 2))
        directions[:, :, 0] = self.motions.T
        slips = probe.tangents(directions, np.full(len(directions), ANGLE))[2]
        return self._rates_against(np.hstack([slips, self._climbs(directions)]), ~probe.held).T

    @cached_property
    def _slips(self):
        """(f, m) changes of the rates J V with those of all freedoms, in the units of the freedoms."""
        return self._probe.tangents(self._rate_ways, np.full(self._probe.freedoms, ANGLE))[2]

    def _rates_against(self, slips, free):
        """(d, f) changes of rates that take back changes (d, m + s) of J V and of the distances from surfaces.

        The independent rates do not change.
        """
        changes = np.zeros((len(slips), self._probe.freedoms))
        rows = np.hstack([self._slips, self._climbs(self._rate_ways)])
        found = np.linalg.lstsq(rows[free].T, -slips.T, rcond=NO_ROW)[0]
        changes[:, free] = (self._scales[free, None] * found).T
        return changes - changes[:, self.moving] @ self.rates.T

    def closing(self, gaps, slips):
        """Changes (d, f, 2) of the dependent freedoms and rates that take back changes (d, m) of residuals and of J V.

        For numbers of the scene: the independent coordinates do not change.
        """
        probe = self._probe
        changes = np.zeros((len(gaps), probe.freedoms, 2))
        if not probe.is_closed:
            return changes
        rest = ~probe.is_switched
        found = (self._scales[:, None] * np.linalg.lstsq(self._gaps[:, rest].T, -gaps[:, rest].T, rcond=NO_ROW)[0]).T
        changes[:, :, 0] = found - found[:, self.independent] @ self.motions.T
        moved = probe.tangents(changes, ANGLE / np.maximum(np.abs(changes).max(axis=(1, 2)), ANGLE))[2]
        changes[:, :, 1] = self._rates_against(slips + moved, ~probe.held)
        return changes

    def neighbour(self, k, s, rate=False):
        """y (f, 2) a distance s along independent coordinate k, or independent rate k; for a derivative."""
        y = np.zeros((self._probe.freedoms, 2))
        if rate:
            y[:, 1] = s * self.rates[:, k]
        else:
            y[:, 0], y[:, 1] = s * self.motions[:, k], s * self.changes[:, k]
        return self._states_as_rates(y)

    def _states_as_rates(self, y):
        """y (f, 2) with displacements of states of laws as those of the rates of their links."""
        if self._with_states and self.is_state.any():
            y[self.is_state] = y[self.is_state, ::-1]
        return y

    def at(self, z):
        """y (f, 2) of independent coordinates z (m,) at the rates of the state: before projection."""
        y = np.zeros((self._probe.freedoms, 2))
        y[:, 0] = self.motions @ z
        return self._states_as_rates(y)

    def moved_by(self, directions):
        """Names of the freedoms, and of joints with one coordinate, that directions (m, d) of unit length move."""
        layout, moves = self._probe.layout, {}
        for direction in directions.T:
            sides = [self._probe.closed(self.at(sign * ANGLE * direction))[1:] for sign in (0.0, 1.0)]
            rest, there = (layout.coordinates.at(*side, self._probe.angles) for side in sides)
            turns = {freedom.name: way for freedom, way in zip(self.freedoms, ANGLE * self.motions @ direction)}
            for name, way in {**{name: there[name][0] - rest[name][0] for name in there}, **turns}.items():
                moves[name] = max(moves.get(name, 0.0), abs(way))
        units = {freedom.name: freedom.unit for freedom in self.freedoms} | layout.coordinates.units
        least = {"rad": SMALL_MOVE * ANGLE, "m": SMALL_MOVE * ANGLE * layout.size, "": SMALL_MOVE * ANGLE}
        return tuple(name for name, way in moves.items() if way > least[units[name]])

    def holding(self, z, held):
        """y (f, 2) as of `at`, closed by the freedoms that are not `held` (indices). Raises SimulationError.

        A projection alone would move all freedoms: those held keep their positions to first order only.
        """
        probe, y = self._probe, self.at(z)
        if not probe.is_closed or not len(held):
            return y
        y[held, 0] = 0.0
        others = np.setdiff1d(np.arange(probe.freedoms), held)
        closes = np.linalg.pinv(self._gaps[others].T, rcond=NO_ROW)
        for _ in range(MOST_CLOSINGS):
            change = closes @ probe.gaps(y)
            y[others, 0] -= self._scales[others] * change
            if np.abs(change).max(initial=0.0) <= CLOSED:
                return y
        raise SimulationError(f"{', '.join(self.freedoms[k].name for k in held)} cannot be held there")

    def with_rates(self, rates):
        """y (f, 2) at the position of the state with independent rates (p,) in the joints: before projection."""
        y = np.zeros((self._probe.freedoms, 2))
        change = self.rate_signs * rates - self._probe.closed()[0][self.moving]
        y[:, 1] = self.rates @ np.where(self.is_state[self.moving], 0.0, change)
        return y

    def along(self, rates):
        """(largest of the rates (m,) relative to their scales, the y (f, 2) of a unit way along them)."""
        rates = np.where(self.is_state[self.independent], 0.0, rates)  # of the links of laws: the states
        speed = np.abs(rates / self.scales).max(initial=0.0)
        if not speed:
            return 0.0, np.zeros((self._probe.freedoms, 2))
        return speed, sum(rate / speed * self.neighbour(k, 1.0) for k, rate in enumerate(rates))


def scales_of(layout):
    """(f,) scales of the degrees of freedom of the tree: 1 rad, the mechanism's size in m, 1 of a state of a law."""
    return np.array([layout.size if freedom.unit == "m" else 1.0 for freedom in layout.freedoms])
