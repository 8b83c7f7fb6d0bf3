# SPDX-License-Identifier: Apache-2.0
"""State transition along a run: how small differences at its start arrive at its end,

    dx(T) = Phi dx(0) ,   Phi' = A(t) Phi ,   x = (z, z')

with A of linear_system.py in the chart that moves with the state. Along a period of a periodic motion, or of inputs
that act on a state at rest, Phi is the monodromy matrix: its eigenvalues are the multipliers of Floquet, and
differences decay if all are inside the unit circle.
"""

from dataclasses import dataclass

import numpy as np
import scipy

from liegroup_core.errors import SceneError, SimulationError

from .coordinates import Coordinates
from .linear_system import system_of
from .probe import Probe

LEAST, MOST = 8, 2048  # intervals
ENOUGH = 1e-9  # relative change of Phi at which intervals are not halved any more
SHORT = 1e-6  # s: of intervals that are not divided at knots of motions, nor corrected for whole ns
GAUSS = 0.5 + np.array([-1.0, 0.0, 1.0]) * np.sqrt(15.0) / 10.0


@dataclass(frozen=True, eq=False)
class Transition:
    """State transition of a run.

    phi    : (n, n) SI units
    states : names
    coordinates : how many of them are coordinates; the others are rates
    start, duration : s
    error  : of phi, relative to its largest entry: its change when intervals were halved
    """

    phi: np.ndarray
    states: tuple
    coordinates: int
    start: float
    duration: float
    error: float

    @property
    def multipliers(self):
        """(n,) eigenvalues of phi, by magnitude: of Floquet, if the duration is a period."""
        found = np.linalg.eigvals(self.phi)
        return found[np.lexsort((-found.imag, np.abs(found).round(12)))]


def transition(simulation, duration, independent=None):
    """Transition along the next part of a run; the simulation returns to where it is.

    duration    : s, greater than 0
    independent : names of the coordinates, which must stay independent; None: those with the best condition now
    Raises SceneError for wrong names, SimulationError where stops or friction change their modes: differences jump
    there. Accuracy: test/verification/test_transition.py. Method of Magnus of order 6: S. Blanes, F. Casas, J. Ros
    (2000), BIT 40, eq. (4.18), with intervals that are halved.
    """
    if not 0.0 < duration < np.inf:
        raise SceneError(f"the duration must be a number of seconds greater than 0, got {duration:g}")
    start, began = simulation.snapshot(), simulation.time
    coordinates = Coordinates(Probe(simulation), independent)
    chosen, preferred = coordinates.rate_names, coordinates.names
    states = len(chosen) + len(preferred)
    knots = [row[0] for rows in simulation.layout.motions.values() for row in rows]
    ends = [began]
    for knot in sorted(knots):
        if ends[-1] + SHORT < knot < began + duration - SHORT:
            ends.append(knot)
    ends.append(began + duration)
    before, count = None, max(1, LEAST // (len(ends) - 1))
    try:
        while True:
            phi = np.eye(states)
            for first, h in zip(ends[:-1], np.diff(ends) / count):
                for k in range(count):
                    phi = _over(simulation, first + k * h, h, chosen, preferred) @ phi
            simulation.restore(start)
            largest = np.abs(phi).max(initial=1e-300)
            change = np.inf if before is None else np.abs(phi - before).max(initial=0.0) / largest
            if change <= ENOUGH:
                break
            if count * (len(ends) - 1) >= MOST:
                raise SimulationError(
                    f"the state transition over {duration:.6g} s has a relative error of {change:.3g} with "
                    f"{count * (len(ends) - 1)} intervals: take a shorter duration"
                )
            before, count = phi, 2 * count
    finally:
        simulation.restore(start)
    states = (*preferred, *(f"{name}.rate" for name in chosen))
    return Transition(phi, states, len(preferred), began, duration, change)


def _over(simulation, start, h, chosen, preferred):
    """exp Omega (n, n) of an interval h with A at Gauss points."""
    events, times, matrices = simulation.event_count, [], []
    for time in start + h * GAUSS:
        simulation.advance_to(time)
        probe = Probe(simulation, time)
        times.append(probe.base.time)
        matrices.append(system_of(probe, [], [], chosen, preferred).A)
    if simulation.event_count != events:
        raise SimulationError(f"stops or friction change their modes before {times[-1]:.9g} s: differences jump there")
    # Samples are at whole ns: their parabola gives A at the Gauss points.
    if h > SHORT:
        weights = np.linalg.solve(np.vander((np.array(times) - start) / h).T, np.vander(GAUSS).T).T
        matrices = np.tensordot(weights, np.array(matrices), 1)
    a, b, c = matrices
    first, second, third = h * b, np.sqrt(15.0) / 3.0 * h * (c - a), 10.0 / 3.0 * h * (c - 2.0 * b + a)
    one = _bracket(first, second)
    two = -_bracket(first, 2.0 * third + one) / 60.0
    return scipy.linalg.expm(first + third / 12.0 + _bracket(-20.0 * first - third + one, second + two) / 240.0)


def _bracket(a, b):
    return a @ b - b @ a
