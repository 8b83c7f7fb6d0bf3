# SPDX-License-Identifier: Apache-2.0
"""State transition along a run: how small differences at its start arrive at its end,

    dx(T) = Phi dx(0) ,   x = (z, z')

in the chart that moves with the state, from the variational equations (variations.py). Along a period of a periodic
motion, or of inputs that act on a state at rest, Phi is the monodromy matrix: its eigenvalues are the multipliers of
Floquet, and differences decay if all are inside the unit circle.
"""

from dataclasses import dataclass

import numpy as np

from liegroup_core.errors import SceneError, SimulationError
from liegroup_core.forces.instants import LATEST
from liegroup_core.threads import one_blas_thread

from .coordinates import Coordinates
from .probe import Probe
from .variations import Variations


@dataclass(frozen=True, eq=False)
class Transition:
    """State transition of a run.

    phi    : (n, n) SI units
    states : names
    coordinates : how many of them are coordinates; the others are rates
    start, duration : s
    error  : of phi, relative to its largest entry
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


@one_blas_thread()
def transition(simulation, duration, independent=None):
    """Transition along the next part of a run; the simulation does not change. Events of stops and friction included.

    duration    : s, greater than 0
    independent : names of the coordinates, which must be independent at the end, too; None: those with the best
                  condition now
    Raises SceneError for wrong names, SimulationError where runs to both sides behave differently, and where stops,
    friction or laws hold other joints at the end. Accuracy: test/verification/test_transition.py.
    """
    if not 0.0 < duration <= LATEST - simulation.time:
        raise SceneError(f"the duration must be greater than 0 and end before {LATEST:g} s, got {duration:g} s")
    first = Coordinates(Probe(simulation, in_space=True), independent)
    m, states = len(first.independent), len(first.independent) + len(first.moving)
    signs = np.concatenate([first.signs, first.rate_signs])
    ways = [first.neighbour(k, 1.0) for k in range(m)]
    ways += [first.neighbour(k, 1.0, True) for k in range(states - m)]
    ways = np.reshape(ways, (states, len(first.freedoms), 2)) * signs[:, None, None]
    end_ns = simulation.time_ns + round(duration * 1e9)
    run = Variations(simulation, end_ns, ways)
    for _ in run.through([end_ns]):
        pass
    if run.rough.any() or not np.isfinite(run.columns).all():
        raise SimulationError(
            "the run has no state transition: at a stop or in friction, runs to both sides behave differently"
        )
    last = Coordinates(run.probe, None, (*first.rate_names, *first.names))
    if last.names != first.names or last.rate_names != first.rate_names:
        raise SimulationError("stops, friction or laws hold other joints at the end of the run than at its start")
    # The run ends at a whole ns; its slope leads from there to the given end.
    rest = np.eye(states) + (duration - 1e-9 * round(1e9 * duration)) * run.matrix(last)
    phi, doubt = (
        signs[:, None] * (rest @ np.vstack([each[:, last.independent, 0].T, each[:, last.moving, 1].T]))
        for each in (run.columns, run.doubt)
    )
    error = np.abs(doubt - phi).max(initial=0.0) / np.abs(phi).max(initial=1e-300)
    names = (*first.names, *(f"{name}.rate" for name in first.rate_names))
    return Transition(phi, names, m, simulation.time, duration, error)
