# SPDX-License-Identifier: Apache-2.0
"""Trim: equilibria and steady motions near a state, and the inputs that hold a pose.

An equilibrium has z' = 0 and z'' = 0; in a steady motion given rates stay constant and all other coordinates
rest. Newton's method finds it on the closed mechanism, with the derivatives of differences.py. Where a
coordinate has no influence (a free motion), the nearest solution is taken.
"""

from dataclasses import dataclass

import numpy as np

from liegroup_core.errors import SimulationError

from .channels import Inputs
from .coordinates import Coordinates
from .differences import derivative
from .linear_system import LinearSystem, system_of
from .probe import Probe

MOST_STEPS = 100
LARGEST_TURN = 0.3  # rad, or share of the mechanism's size, in a direction of a step
NO_INFLUENCE = 1e-9  # relative singular value of a free motion
FOUND = 1e-10  # of the first accelerations plus gravity


class TrimError(SimulationError):
    """No equilibrium was found; one line of text."""


@dataclass(frozen=True, eq=False)
class Trim:
    """An equilibrium or a steady motion.

    bodies    : names
    pose, twist : (n, 12), (n, 6) of the body frames
    joints    : {joint: position} of the joints with one coordinate, rad or m
    inputs    : {name: value} that were found, in addition to those that act
    undetermined : names of inputs that can change together without effect on the equilibrium
    residual  : largest acceleration that remains, rad/s^2 or m/s^2
    system    : LinearSystem there, with the inputs that were asked for
    """

    bodies: tuple
    pose: np.ndarray
    twist: np.ndarray
    joints: dict
    inputs: dict
    undetermined: tuple
    residual: float
    system: LinearSystem

    @property
    def is_stable(self):
        """Whether small differences decay or stay bounded, by the largest real part: None if it is zero."""
        growth = self.system.poles.real.max(initial=-np.inf)
        return None if abs(growth) <= self.system.round_off else bool(growth < 0.0)


def trim(simulation, rates=None, held=(), inputs=None, time=None):
    """Trim near a state of a simulation, which does not change.

    time   : s, of a state within the present step; None: the present state
    rates  : {coordinate: rate} that stay constant, rad/s or m/s; the other rates are zero
    held   : coordinates that keep their positions, such as those that inputs hold
    inputs : names of inputs to find, see channels.py; those of the smallest sum of squares
    Raises SceneError for unknown names, TrimError if there is no equilibrium near the state.
    """
    probe = Probe(simulation, time)
    return _found(probe, rates or {}, held, inputs or ())


def _found(probe, rates, held, names):
    coordinates = Coordinates(probe)
    known = [freedom.name for freedom in coordinates.freedoms]
    for name in (*rates, *held):
        coordinates.number(name)
    inputs = Inputs(probe, names)
    u, limit, remaining = np.zeros(len(inputs)), 0.0, np.inf
    for _ in range(MOST_STEPS):
        _set_rates(probe, coordinates, rates, known)
        coordinates = Coordinates(probe)
        lengths = np.array([1.0 if unit == "rad" else probe.layout.size for unit in coordinates.units])
        accelerations = _accelerations(probe, coordinates, inputs, u)
        remaining = float(np.abs(accelerations / lengths).max(initial=0.0))
        limit = limit or FOUND * (max(float(np.linalg.norm(probe.layout.scene.gravity)), 1.0) + remaining)
        moved, pushed = _moved(probe, coordinates, inputs, u), _pushed(probe, coordinates, inputs, u)
        if remaining <= limit:
            return _trim(probe, coordinates, inputs, u, pushed, accelerations)
        free = [k for k, name in enumerate(coordinates.names) if name not in held and name not in rates]
        scaled = moved[:, free] / lengths[:, None] * lengths[free]
        effects = pushed / lengths[:, None]
        sizes = max(np.abs(scaled).max(initial=0.0), remaining) / _lengths_of(effects)
        step = _step(scaled, effects * sizes, -accelerations / lengths)
        z = np.zeros(len(lengths))
        z[free] = lengths[free] * step[: len(free)]
        u = u + sizes * step[len(free) :]
        probe.go_to(coordinates.at(z))
    kept = "; stops, cables and friction keep their modes: start nearer to it" if probe.layout.switches else ""
    raise TrimError(
        f"no equilibrium near the state: an acceleration of {remaining:.3g} rad/s^2, or times the mechanism's size in "
        f"m/s^2, remains after {MOST_STEPS} steps{kept}"
    )


def _lengths_of(pushed):
    """Lengths of the columns; 1 of a column of zeros."""
    found = np.linalg.norm(pushed, axis=0)
    return np.where(found > 0.0, found, 1.0)


def _step(moved, pushed, right):
    """Change of the coordinates and the inputs towards an equilibrium.

    Newton's method takes its step if that is short; directions without influence stay. Farther away it would lead to
    any equilibrium, or nowhere: the step is then that of an implicit method for motions along the accelerations,
    (mu - A) dz = z'', which ends in the next stable equilibrium (pseudo-transient continuation).
    """
    matrix = np.hstack([moved, pushed])
    left, values, directions = np.linalg.svd(matrix, full_matrices=False)
    along = left.T @ right
    known = values > NO_INFLUENCE * values.max(initial=0.0)
    parts = np.divide(along, values, out=np.zeros_like(along), where=known)
    lost = np.linalg.norm(right - left[:, known] @ along[known])
    if np.abs(parts).max(initial=0.0) <= LARGEST_TURN and lost <= 0.5 * np.linalg.norm(right):
        return parts @ directions
    m = moved.shape[1]
    growth = np.linalg.eigvals(moved).real.max() if m and len(moved) == m else 0.0
    weight = np.linalg.norm(right) / LARGEST_TURN + 2.0 * max(growth, 0.0)
    return np.linalg.lstsq(np.hstack([moved - weight * np.eye(len(moved), m), pushed]), right, rcond=1e-10)[0]


def _set_rates(probe, coordinates, rates, known):
    """Give the state its constant rates; all others are zero."""
    y = np.zeros((probe.freedoms, 2))
    present = probe.closed()[0]
    wanted = np.zeros(len(coordinates.independent))
    for name, rate in rates.items():
        k = known.index(name)
        if k not in coordinates.independent:
            raise TrimError(f"{name} is not an independent coordinate here: {', '.join(coordinates.names)} are")
        wanted[coordinates.independent.tolist().index(k)] = rate * coordinates.freedoms[k].sign
    y[:, 1] = coordinates.motions @ (wanted - present[coordinates.independent])
    probe.go_to(y)


def _accelerations(probe, coordinates, inputs, u, y=None):
    slopes, _, _ = probe.slopes(y, *inputs.applied(u))
    return slopes[probe.freedoms + coordinates.independent]


def _moved(probe, coordinates, inputs, u):
    columns = []
    for k in range(len(coordinates.independent)):
        columns.append(
            derivative(
                lambda s, k=k: _accelerations(probe, coordinates, inputs, u, coordinates.neighbour(k, s)),
                coordinates.size(k),
            )[0]
        )
    m = len(coordinates.independent)
    return np.array(columns).reshape(m, m).T


def _pushed(probe, coordinates, inputs, u):
    columns = []
    for j in range(len(inputs)):
        change = np.eye(len(inputs))[j]
        columns.append(
            derivative(
                lambda s, change=change: _accelerations(probe, coordinates, inputs, u + s * change), inputs.sizes[j]
            )[0]
        )
    return np.array(columns).reshape(len(inputs), len(coordinates.independent)).T


def _trim(probe, coordinates, inputs, u, pushed, accelerations):
    probe.external, probe.wanted = inputs.applied(u)
    _, pose, twist = probe.slopes()
    sample = probe.sample(pose, twist, probe.external, probe.wanted)
    probe.base = sample
    return Trim(
        bodies=sample.body_names,
        pose=sample.pose.copy(),
        twist=sample.twist.copy(),
        joints={joint: values[0] for joint, values in sample.joint_coordinates.items()},
        inputs=dict(zip(inputs.names, u.tolist())),
        undetermined=undetermined(pushed, inputs.names),
        residual=float(np.abs(accelerations).max(initial=0.0)),
        system=system_of(probe),
    )


def undetermined(pushed, names):
    """Names of inputs that can change together without effect: null space of their accelerations (m, k)."""
    if not len(names):
        return ()
    sizes = np.linalg.norm(pushed, axis=0)
    scaled = pushed / np.where(sizes > 0.0, sizes, 1.0)
    _, values, directions = np.linalg.svd(scaled)
    rank = int((values > 1e-9).sum())
    loose = np.abs(directions[rank:]).max(axis=0, initial=0.0) > 1e-6
    return tuple(name for name, is_loose in zip(names, loose) if is_loose)
