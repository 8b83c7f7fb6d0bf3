# SPDX-License-Identifier: Apache-2.0
"""Trim: equilibria and steady motions near a state, and the inputs that hold a pose.

An equilibrium has z' = 0 and z'' = 0; in a steady motion given rates stay constant and all other coordinates
rest. Newton's method finds it on the closed mechanism, with the derivatives of tangents.py. Where a
coordinate has no influence (a free motion, or one that the inputs balance anywhere), the nearest solution is taken.
States of laws that only motion changes, as the strain of a point that presses, go with the motion. Where contacts are
to carry what has no equilibrium close by, the motion leads to one, see settling.py.
"""

from dataclasses import dataclass

import numpy as np
import scipy

from liegroup_core.dynamics.switches import MOVES
from liegroup_core.errors import SceneError, SimulationError

from .channels import InputChannels
from .coordinates import ANGLE, Coordinates
from .differences import derivative
from .friction import Resting, Stops, stick
from .linear_system import LinearSystem, change_of, system_of
from .probe import Probe, refuse_sliding
from .settling import lifted, rests

MOST_STEPS = 100
FEW_STEPS = 8  # on contacts, before the motion leads to another state, see settling.py
LARGEST_TURN = 0.3  # rad, or share of the mechanism's size, in a direction of a step
NO_INFLUENCE = 1e-9  # relative singular value of a free motion
FOUND = 1e-10  # of the first accelerations plus gravity
STEADY = 1e-6  # of these: largest change over the motion by a radian, or the mechanism's size
# A step is halved while the joints cannot be closed at its end, or accelerations are LARGER than before: a fall ends
# where a contact begins to press.
PART, MOST_PARTS, LARGER = 0.5, 24, 10.0


class TrimError(SimulationError):
    """No equilibrium was found; one line of text."""


@dataclass(frozen=True, eq=False)
class Trim:
    """An equilibrium or a steady motion.

    bodies    : names
    pose, twist : (n, 12), (n, 6) of the body frames
    joints    : {joint: position} of the joints with one coordinate, rad or m
    inputs    : {name: value} that were found: efforts and wrenches in addition to those that act, targets as they are
    intervals : {name: (least, largest) of inputs for which the pose rests, the others as found}, where joints rest by
                dry friction or at a stop; nan: not found
    undetermined : names of inputs that can change together without effect on the equilibrium
    loose     : names of coordinates that can change together, with suitable inputs, to equilibria nearby
    residual  : largest acceleration that remains, rad/s^2 or m/s^2
    is_steady : whether the accelerations stay zero while it moves; False where driven joints move
    change    : largest change of an entry of A of the system along the motion, 1/s, see `change_along`
    system    : LinearSystem there, with the inputs to find; with the default ones if there are none
    """

    bodies: tuple
    pose: np.ndarray
    twist: np.ndarray
    joints: dict
    inputs: dict
    intervals: dict
    undetermined: tuple
    loose: tuple
    residual: float
    is_steady: bool
    change: float
    system: LinearSystem

    @property
    def is_stable(self):
        """Whether small differences decay or stay bounded, by the largest real part: None if it is zero.

        Without meaning where the motion is not steady, or A changes along it.
        """
        growth = self.system.poles.real.max(initial=-np.inf)
        return None if abs(growth) <= self.system.round_off else bool(growth < 0.0)


def trim(simulation, rates=None, held=(), inputs=None, time=None):
    """Trim near a state of a simulation, which does not change.

    time   : s, of a state within the present step; None: the present state
    rates  : {coordinate: rate} that stay constant, rad/s or m/s; the other rates are zero
    held   : coordinates that keep their positions, such as those that inputs hold
    inputs : names of inputs to find, see channels.py; those of the smallest sum of squares. Dry friction of joints
             that rest holds only what they cannot
    Raises SceneError for unknown names, TrimError if there is no equilibrium near the state. With contacts, and without
    `rates` and `held`, that is where the mechanism comes to rest.
    """
    probe = Probe(simulation, time)
    refuse_sliding(probe, "trim")
    rates = rates or {}
    if not probe.layout.touching.names or probe.layout.motions or any(rates.values()) or held:
        return _found(probe, rates, held, inputs or ())
    if (sample := lifted(probe.layout, probe.base)) is not None:
        probe.take(sample)
    samples = rests(simulation, probe.base)
    while True:
        try:
            return _found(probe, rates, held, inputs or (), FEW_STEPS)
        except TrimError as error:
            failed = error
        try:
            sample = next(samples, None)
        except SimulationError as error:
            raise TrimError(f"no equilibrium near the state: {error}") from None
        if sample is None:
            raise failed
        probe = Probe(simulation, time)
        probe.take(sample)


def _found(probe, rates, held, names, most=MOST_STEPS):
    preferred = (*rates, *held)
    inputs = InputChannels(probe, names)
    # Dry friction holds the coordinates that keep their positions; whether it can is checked at the end.
    numbers = list(map(Coordinates(probe).number, held))
    if numbers and probe.layout.switches:
        stick(probe, np.flatnonzero(probe.largest_friction() > 0.0), numbers)
    u, limit, remaining, stops = inputs.starting(rates), 0.0, np.inf, Stops(probe)
    own = Coordinates(probe).is_state
    moves = np.abs(probe.closed()[0][~own]).max(initial=0.0) > MOVES and not any(rates.values())
    advice = "; the state moves: name rates that stay constant" if moves else ""
    for _ in range(most):
        coordinates = _at_rates(probe, rates, preferred)
        fixed = [coordinates.number(name) for name in preferred]
        rows, columns = coordinates.rate_scales, coordinates.scales
        accelerations = _accelerations(probe, coordinates, inputs, u)
        remaining = float(np.abs(accelerations / rows).max(initial=0.0))
        limit = limit or FOUND * (max(float(np.linalg.norm(probe.layout.scene.gravity)), 1.0) + remaining)
        moved, pushed = _derivatives(probe, coordinates, inputs, u)
        free = scipy.linalg.null_space(coordinates.motions[fixed] * columns) if fixed else np.eye(len(columns))
        scaled = moved / rows[:, None] * columns @ free
        follow = np.eye(len(columns)) if remaining <= limit else _following(probe, coordinates, inputs, u, moved)
        ways = follow * columns / columns[:, None] @ free
        effects = pushed / rows[:, None]
        sizes = 1.0 / _lengths_of(effects)
        if remaining <= limit:
            if beyond := stops.beyond():
                hint = "start at the stop, or nearer to another equilibrium"
                raise TrimError(f"the equilibrium near the state is beyond a stop: {beyond}; {hint}")
            _, values, directions, _ = _influences(_across(effects * sizes), scaled)
            rank = int((values > max(NO_INFLUENCE * np.linalg.norm(scaled), limit)).sum())
            loose = coordinates.moved_by(columns[:, None] * free @ directions[rank:].T)
            return _trim(probe, preferred, inputs, u, loose)
        same = (coordinates.moving[:, None] == coordinates.independent) @ ways
        step, change = _step(moved / rows[:, None] * columns @ ways, effects * sizes, -accelerations / rows, same)
        u = u + sizes * change
        way = columns * (ways @ step)
        if not _go(probe, coordinates, fixed, way, inputs, u, LARGER * remaining):
            raise TrimError(f"no equilibrium near the state: the joints cannot be closed on the way to it{advice}")
        stops.follow()
    if not names and (held or rates):
        advice += "; name inputs that hold it"
    if idle := [name for name, effect in zip(inputs.names, effects.T) if not effect.any()]:
        advice += f"; {', '.join(idle)} have no effect there, as with a servo at its limit: start nearer to it"
    kept = "; stops, cables and friction keep their modes on the way" if probe.layout.switches else ""
    kind, size = "steady motion" if any(rates.values()) else "equilibrium", probe.layout.size
    raise TrimError(
        f"no {kind} near the state: an acceleration of {remaining:.3g} rad/s^2, or {remaining * size:.3g} m/s^2, "
        f"remains after {most} steps{advice}{kept}"
    )


def _at_rates(probe, rates, preferred):
    """Coordinates at the given rates, with dry friction against the motion. Raises SceneError."""
    modes, moves = probe.modes, any(rates.values())
    if moves:
        probe.release()
    coordinates = Coordinates(probe, preferred=preferred, states=True)
    for name, rate in rates.items():
        coordinates.number(name)
        if not np.isfinite(rate):
            raise SceneError(f"the rate of {name} must be a finite number, got {rate}")
        if name not in coordinates.rate_names:
            known = f"independent are {', '.join(coordinates.rate_names)}"
            why = "is prescribed: its joint is driven" if name in probe.layout.motions else "is not independent here"
            raise SceneError(f"the rate of {name} {why}; {known}")
    probe.go_to(coordinates.with_rates(np.array([rates.get(name, 0.0) for name in coordinates.rate_names])))
    if moves:
        probe.oppose(modes)
    return Coordinates(probe, preferred=preferred, states=True)


def _go(probe, coordinates, fixed, z, inputs, u, limit):
    """Go to coordinates z, or a part of the way, see LARGER; returns whether the joints could be closed.

    limit : of the accelerations there, relative to their scales
    """
    kept, closed = probe.keep(), False
    for _ in range(MOST_PARTS):
        probe.restore(kept)
        try:
            probe.go_to(coordinates.holding(z, fixed))
            found = _accelerations(probe, coordinates, inputs, u) / coordinates.rate_scales
            closed = True
            if np.abs(found).max(initial=0.0) <= limit:
                break
        except SimulationError:
            pass
        z = z * PART
    return closed


def _lengths_of(pushed):
    """Lengths of the columns; 1 of a column of zeros."""
    found = np.linalg.norm(pushed, axis=0)
    return np.where(found > 0.0, found, 1.0)


def _step(moved, pushed, right, same):
    """Change of the coordinates and the inputs towards an equilibrium.

    The inputs balance what they can, so that the coordinates move as little as the rest needs. Newton's method takes
    its step if that is short; directions without influence stay. Farther away it would lead to any equilibrium, or
    nowhere: the step is then that of an implicit method for motions along the accelerations, (mu - A) dz = z'', which
    ends in the next stable equilibrium (pseudo-transient continuation).
    same : 1 where a row of an acceleration and a column are of the same coordinate
    """
    across = _across(pushed)
    left, values, directions, known = _influences(across, moved)
    rest = across @ right
    along = left.T @ rest
    parts = np.divide(along, values, out=np.zeros_like(along), where=known)
    lost = np.linalg.norm(rest - left[:, known] @ along[known])
    if np.abs(parts).max(initial=0.0) <= LARGEST_TURN and lost <= 0.5 * np.linalg.norm(right):
        step = parts @ directions[: len(parts)]
    else:
        growth = np.linalg.eigvals(same.T @ moved).real.max(initial=0.0)
        weight = np.linalg.norm(right) / LARGEST_TURN + 2.0 * growth
        moved = moved - weight * same
        step = np.linalg.lstsq(across @ moved, rest, rcond=1e-10)[0]
    return step, np.linalg.pinv(pushed, rcond=NO_INFLUENCE) @ (right - moved @ step)


def _across(pushed):
    """Projection (p, p) of accelerations onto those that inputs cannot produce; columns (p, k) of length 1 or 0."""
    return np.eye(len(pushed)) - pushed @ np.linalg.pinv(pushed, rcond=NO_INFLUENCE)


def _influences(across, moved):
    """Singular values and vectors of what inputs leave of the effects of the coordinates, and which have influence."""
    left, values, directions = np.linalg.svd(across @ moved)
    count = len(values)
    return left[:, :count], values, directions, values > NO_INFLUENCE * np.linalg.norm(moved)


def _accelerations(probe, coordinates, inputs, u, y=None):
    slopes, _, _ = probe.slopes(y, inputs.applied(u))
    return slopes[probe.freedoms + coordinates.moving]


def _derivatives(probe, coordinates, inputs, u):
    """Derivatives of the accelerations (p,) by the coordinates (p, m) and by the inputs (p, k)."""
    m = len(coordinates.independent)
    directions = np.zeros((m + len(inputs), probe.freedoms, 2))
    for k in range(m):
        directions[k] = coordinates.neighbour(k, 1.0)
    sizes = np.array([*map(coordinates.size, range(m)), *inputs.sizes])
    changes, present = inputs.changes(m), probe.acting
    probe.acting = inputs.applied(u)
    try:
        found = probe.derivatives(directions, sizes, *changes)[0][:, probe.freedoms + coordinates.moving].T
    finally:
        probe.acting = present
    return found[:, :m], found[:, m:]


def _following(probe, coordinates, inputs, u, moved):
    """Matrix (m, m) of displacements: those of states of laws that no displacement changes follow from the others.

    At rest their rates are zero everywhere. A slow motion changes them by the derivatives of their rates by the rates
    of the coordinates.
    moved : derivatives of the accelerations by the coordinates, as from `_derivatives`
    """
    follow, is_state = np.eye(len(coordinates.independent)), coordinates.is_state
    rows = [j for j, k in enumerate(coordinates.moving) if is_state[k] and not moved[j].any()]
    if not rows:
        return follow
    rates = np.flatnonzero(~is_state[coordinates.moving])
    directions = np.array([coordinates.neighbour(k, 1.0, rate=True) for k in rates])
    present, probe.acting = probe.acting, inputs.applied(u)
    try:
        by_rates = probe.derivatives(directions, coordinates.rate_scales[rates] * ANGLE)[0][:, probe.freedoms :].T
    finally:
        probe.acting = present
    for k in coordinates.moving[rows]:
        row = np.flatnonzero(coordinates.independent == k)
        follow[row] = by_rates[k] @ coordinates.motions[coordinates.moving[rates]]
    return follow


def _trim(probe, preferred, inputs, u, loose):
    resting = Resting(probe)
    coordinates = Coordinates(probe, preferred=preferred, states=True)
    rows = coordinates.rate_scales

    def accelerations(u):
        return _accelerations(probe, coordinates, inputs, u) / rows

    def pushed(u, chosen=None):
        found = _derivatives(probe, coordinates, inputs, u)[1] / rows[:, None]
        return found if chosen is None else found[:, chosen]

    effects = pushed(u)
    found = resting.hold(accelerations, u, effects, inputs)
    if found is None:
        raise TrimError(
            f"dry friction and stops of {', '.join(resting.names)} cannot hold the equilibrium near the state: start "
            "nearer to another one"
        )
    u, efforts = found
    ends = {
        name: tuple(float(resting.end(sign, j, u, efforts, accelerations, pushed, inputs)) for sign in (-1.0, 1.0))
        for j, name in enumerate(inputs.names if resting.names else ())
    }
    resting.settle(efforts)
    targets = [inputs.target(name) for name in inputs.names]
    coordinates = Coordinates(probe, preferred=preferred, states=True)
    probe.acting = inputs.applied(u)
    _, pose, twist = probe.slopes()
    sample = probe.sample(pose, twist, probe.acting)
    probe.base = sample
    system = system_of(probe, inputs.names or None)
    return Trim(
        bodies=sample.body_names,
        pose=sample.pose.copy(),
        twist=sample.twist.copy(),
        joints={joint: values[0] for joint, values in sample.joint_coordinates.items()},
        inputs={name: target + own for name, target, own in zip(inputs.names, targets, u.tolist())},
        intervals={name: (target + low, target + high) for target, (name, (low, high)) in zip(targets, ends.items())},
        undetermined=undetermined(effects, inputs.names),
        loose=loose,
        residual=float(np.abs(_accelerations(probe, coordinates, inputs, 0.0 * u)).max(initial=0.0)),
        is_steady=_is_steady(probe, coordinates, inputs, 0.0 * u),
        change=change_of(probe, system),
        system=system,
    )


def _is_steady(probe, coordinates, inputs, u):
    """Whether the accelerations stay zero along the motion of a state."""
    if any(abs(rate) > MOVES for _, rate, _ in probe.base.prescribed.values()):
        return False
    speed, way = coordinates.along(probe.closed()[0][coordinates.independent])
    if speed <= MOVES:
        return True
    change, error = derivative(lambda s: _accelerations(probe, coordinates, inputs, u, s * way), ANGLE)
    limit = STEADY * max(float(np.linalg.norm(probe.layout.scene.gravity)), speed**2)
    return bool((np.abs(change) <= coordinates.rate_scales * limit + error).all())


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
