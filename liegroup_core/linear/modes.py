# SPDX-License-Identifier: Apache-2.0
"""Modes: eigenvalues and eigenvectors of a linearised mechanism, with loops, damping and gyroscopic forces.

A damped mode is an eigenvalue s = -zeta omega +- i omega sqrt(1 - zeta^2) of A; its shape is the motion
Re(shape exp(s t)) of all degrees of freedom. Undamped modes leave all forces out that depend on velocities:
s^2 is an eigenvalue of the part of A that belongs to the coordinates.
"""

from typing import NamedTuple

import numpy as np
import scipy

from liegroup_core.errors import SceneError, SimulationError

from .coordinates import scales_of
from .probe import Probe

# Largest displacement of a shape that is drawn, rad, or share of the mechanism's size; factor if it cannot be closed.
DRAWN, SMALLER, MOST_ATTEMPTS = 0.35, 0.5, 8
SAME = 1e-9  # relative difference of a pair of conjugate eigenvalues


class Mode(NamedTuple):
    """A mode.

    pole      : s, 1/s and rad/s; of a pair the one with positive imaginary part
    frequency : |s| in Hz; 0 for a mode that does not oscillate
    damping   : ratio zeta, from -1 (grows without oscillation) to 1
    shape     : (f,) complex change of the degrees of freedom, the largest one is 1
    """

    pole: complex
    frequency: float
    damping: float
    shape: np.ndarray

    @property
    def oscillates(self):
        """Whether it is a pair of conjugate poles."""
        return self.pole.imag > 0.0


def modes_of(system, damped=True):
    """[Mode] of a LinearSystem, from slow to fast. Double poles of free motions are listed twice."""
    m = system.coordinates
    if not m:
        return []
    if not damped and len(system.A) != 2 * m:
        raise SceneError("undamped modes need as many rates as coordinates: there are none with rolling")
    if damped:
        poles, vectors = scipy.linalg.eig(system.A)
    else:
        squares, vectors = scipy.linalg.eig(system.A[m:, :m])
        poles = np.sqrt(squares.astype(complex))
        poles = np.where(poles.real < 0.0, -poles, poles)
        # Round-off of a negative square.
        poles = np.where(np.abs(poles.real) <= SAME * np.abs(poles), 1j * np.abs(poles.imag), poles)
    found = []
    for k in np.lexsort((poles.imag, np.abs(poles).round(12))):
        s = complex(poles[k])
        if abs(s) <= system.round_off:
            s = 0j
        if abs(s.imag) <= SAME * abs(s):
            s = complex(s.real + 0.0)
        if s.imag < 0.0:
            continue
        shape = system.motions @ vectors[:m, k]
        largest = shape[np.argmax(np.abs(shape))]
        shape = shape / largest if largest != 0.0 else shape
        size = abs(s)
        damping = 0.0 - s.real / size if size else 0.0
        found.append(Mode(s, size / (2.0 * np.pi) if s.imag else 0.0, damping, shape))
    return found


def shapes_of(simulation, mode, count, time=None):
    """[Sample] of a period of a Mode about the state of a simulation, closed, with a size that is seen.

    count : number of instants of the period; a mode that does not oscillate is drawn as if it did
    time  : s, of the state that the mode is about; None: the present one
    """
    probe = Probe(simulation, time)
    scales = scales_of(probe.layout)
    signs = np.array([freedom.sign for freedom in probe.layout.freedoms])
    largest = np.abs(mode.shape / scales).max(initial=0.0)
    size = DRAWN / largest if largest > 0.0 else 0.0
    for _ in range(MOST_ATTEMPTS):
        try:
            found = []
            for phase in np.arange(count) * (2.0 * np.pi / count):
                y = np.zeros((probe.freedoms, 2))
                y[:, 0] = size * signs * (mode.shape * np.exp(1j * phase)).real
                _, pose, twist = probe.closed(y)
                found.append(probe.sample(pose, np.zeros_like(twist)))
            return found
        except SimulationError:
            size *= SMALLER
    raise SimulationError("the shape of the mode cannot be drawn: its joints cannot be closed")
