# SPDX-License-Identifier: Apache-2.0
"""Motion of the links of a mechanism in joint coordinates, and its derivatives along a direction, with 50 digits.

Link b has the pose X_a X_b exp(S psi) in the world, with its parent a, and relative to it the twist S w. In link axes

    V_b    = Ad(X^-1) V_a + S w
    Vdot_b = Ad(X^-1) Vdot_a + [Ad(X^-1) V_a, S w] + S w'

Derivatives are central differences of 50 digits: with a distance of 1e-15 they have an error of 1e-30.
"""

from decimal import Decimal

import numpy as np
from jets import decimals, precise
from precise import Reader, accelerations_at

from liegroup_core.joints.elements import WORLD
from liegroup_core.motion_groups.table import column_twist

DISTANCE = Decimal(10) ** -15
POWERS = 4  # of the exponential series: the next one is 1e-75


def _hat(w):
    return np.array([[0 * w[0], -w[2], w[1]], [w[2], 0 * w[0], -w[0]], [-w[1], w[0], 0 * w[0]]], dtype=object)


def _exp(w, v):
    """Pose (R, p) of a small screw."""
    A, found, term = decimals(np.zeros((4, 4))), decimals(np.eye(4)), decimals(np.eye(4))
    A[:3, :3], A[:3, 3] = _hat(w), v
    for k in range(1, POWERS + 1):
        term = term @ A / k
        found = found + term
    return found[:3, :3], found[:3, 3]


def _times(X, Y):
    return X[0] @ Y[0], X[0] @ Y[1] + X[1]


def _inverse(X):
    return X[0].T, -(X[0].T @ X[1])


def _at(X, V):
    """Twist, or acceleration, (6,) in the axes of a frame at X: Ad(X^-1) V."""
    R, p = X
    return np.concatenate([R.T @ V[:3], R.T @ (V[3:] + np.cross(V[:3], p))])


def _bracket(V, W):
    return np.concatenate([np.cross(V[:3], W[:3]), np.cross(V[:3], W[3:]) + np.cross(V[3:], W[:3])])


class Links:
    """Links of a Probe in space at its state, as decimals.

    rounding : seed of random changes of all data, see Reader; None: exact
    """

    @precise
    def __init__(self, probe, rounding=None):
        probe.slopes()
        self._rounding = rounding
        read = Reader(None if rounding is None else np.random.default_rng(rounding))
        model, work = probe._model, probe._work
        self._links, self._parts = model.links, model.bodies
        world = [(read.rotation(row[:9].reshape(3, 3)), decimals(row[9:12])) for row in work.world[: len(self._links)]]
        self._fixed = [
            X if a == WORLD else _times(_inverse(world[a]), X) for X, a in zip(world, self._links["parent"].tolist())
        ]
        self._rates = decimals(probe.closed()[0])
        self._places = [
            (read.rotation(each["rotation"].reshape(3, 3)), decimals(each["point"])) for each in model.bodies
        ]
        self._screws = [decimals(_screws(link)) for link in self._links]

    def bodies(self, s, y, slopes):
        """([(R, r, w, v)], (n, 6) accelerations) of the bodies a distance s along y (f, 2), with w' (f,)."""
        X, V, A = [], [], []
        for b, (link, fixed, S) in enumerate(zip(self._links, self._fixed, self._screws)):
            a, own = link["parent"], slice(link["freedom"], link["freedom"] + link["freedoms"])
            screw = s * (S @ y[own, 0])
            near = _times(fixed, _exp(screw[:3], screw[3:]))
            rate, zero = S @ (self._rates[own] + s * y[own, 1]), 0 * screw
            moved = zero if a == WORLD else _at(near, V[a])
            X.append(near if a == WORLD else _times(X[a], near))
            V.append(moved + rate)
            A.append((zero if a == WORLD else _at(near, A[a])) + _bracket(moved, rate) + S @ slopes[own])
        states, accelerations = [], []
        for part, place in zip(self._parts, self._places):
            b = part["link"]
            if b == WORLD:
                states.append((*place, 0 * place[1], 0 * place[1]))
                accelerations.append(decimals(np.zeros(6)))
                continue
            R, r = _times(X[b], place)
            twist = _at(place, V[b])
            states.append((R, r, twist[:3], twist[3:]))
            accelerations.append(_at(place, A[b]))
        return states, np.array(accelerations)

    @precise
    def derivatives(self, scene, y, slopes, changes):
        """Derivatives (n, 6) along y (f, 2) of the bodies' accelerations, exact and from joints; accelerations (n, 6).

        slopes, changes : (f,) w' and its derivative
        Raises NearlySingular.
        """
        y, slopes, changes = map(decimals, (y, slopes, changes))
        here, accelerations = self.bodies(Decimal(0), y, slopes)
        exact = accelerations_at(scene, here, self._rounding)
        sides = []
        for s in (DISTANCE, -DISTANCE):
            states, by_joints = self.bodies(s, y, slopes + s * changes)
            sides.append(np.array([exact(states), by_joints]))
        return (*((sides[0] - sides[1]) / (2 * DISTANCE)).astype(float), accelerations.astype(float))


def _screws(link):
    """(6, k) S of a link."""
    count, columns = link["freedoms"], []
    for unit in np.eye(max(count, 1))[:count]:
        columns.append(np.concatenate(column_twist(link, unit[:, None].copy(), 0)))
    return np.array(columns).reshape(count, 6).T
