# SPDX-License-Identifier: Apache-2.0
"""Linear equations of a mechanism near a state:

    d/dt dx = A dx + B du ,   dy = C dx + D du ,   x = (z, z')

with independent coordinates z in the chart that moves with the state (probe.py, coordinates.py): X = X_0(t) exp
psi. At an equilibrium or a steady motion they describe small motions about it, elsewhere the growth of small
differences at that instant.
Entries of A and B are tangents of the equations that the engine integrates (tangents.py).
"""

import json
from dataclasses import dataclass

import numpy as np
import scipy

from .channels import InputChannels, OutputChannels
from .coordinates import Coordinates
from .differences import derivative
from .probe import Probe

DISPLACED = 1e-4  # rad, m, and of rates, in the derivatives of A


@dataclass(frozen=True, eq=False)
class LinearSystem:
    """Linearised mechanism.

    A (n, n), B (n, k), C (p, n), D (p, k) : see the module; SI units
    states, inputs, outputs : names; the states are m coordinates, then rates: as many, or fewer with rolling
                              and on surfaces of laws, and states of laws on which something depends
    coordinates : m
    motions   : (f, m) change of each degree of freedom of the tree with the coordinates
    freedoms  : names of the f degrees of freedom
    slope     : (n,) d/dt of x at the state: zero at an equilibrium
    error     : largest estimated error of an entry of A and B, or C and D, relative to their largest entry
    time      : s
    scene     : name
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    states: tuple
    inputs: tuple
    outputs: tuple
    coordinates: int
    motions: np.ndarray
    freedoms: tuple
    slope: np.ndarray
    error: float
    time: float
    scene: str

    @property
    def poles(self):
        """(n,) eigenvalues of A in rad/s and 1/s, by magnitude."""
        found = np.linalg.eigvals(self.A) if self.A.size else np.empty(0, dtype=complex)
        return found[np.lexsort((-found.imag, found.real, np.abs(found).round(9)))]

    @property
    def round_off(self):
        """Magnitude of poles below which they may be those of free motions: a double zero is the root of round-off."""
        return 1e-7 * max(np.abs(self.poles).max(initial=0.0), np.sqrt(np.abs(self.A).max(initial=0.0)))

    @property
    def zeros(self):
        """Transmission zeros of a system with as many inputs as outputs, rad/s and 1/s; None for others."""
        n, (p, k) = len(self.A), self.D.shape
        if p != k or not n or not k:
            return None
        left = np.block([[self.A, self.B], [self.C, self.D]])
        right = scipy.linalg.block_diag(np.eye(n), np.zeros((p, k)))
        with np.errstate(all="ignore"):
            alpha, beta = scipy.linalg.eigvals(left, right, homogeneous_eigvals=True)
        finite = np.abs(beta) > 1e-10 * (np.abs(alpha) + np.abs(beta))
        found = alpha[finite] / beta[finite]
        return found[np.lexsort((-found.imag, found.real, np.abs(found).round(9)))]

    def uncontrollable(self):
        """Poles that no input changes: [A - s 1, B] lacks rank there (test of Hautus)."""
        return self._lacking(self.A, self.B)

    def unobservable(self):
        """Poles that no output shows."""
        return self._lacking(self.A.T, self.C.T)

    def _lacking(self, A, B):
        scale = max(np.abs(A).max(initial=0.0), 1e-300)
        columns = np.abs(B).max(axis=0, initial=0.0)
        B = B[:, columns > 0.0] / columns[columns > 0.0] * scale
        limit = 1e-8 * scale
        return np.array(
            [
                s
                for s in self.poles
                if np.linalg.svd(np.hstack([A - s * np.eye(len(A)), B]), compute_uv=False)[-1] < limit
            ],
            dtype=complex,
        )

    def to_control(self):
        """control.StateSpace of the package python-control, whose names have _ for each dot."""
        import control

        given = {"states": self.states, "inputs": self.inputs, "outputs": self.outputs}
        names = {key: [name.replace(".", "_") for name in names] for key, names in given.items()}
        return control.StateSpace(self.A, self.B, self.C, self.D, name=self.scene, **names)

    def as_dict(self):
        """JSON types."""
        return {
            "scene": self.scene,
            "time": self.time,
            **{name: getattr(self, name).tolist() for name in "ABCD"},
            "coordinates": self.coordinates,
            **{name: list(getattr(self, name)) for name in ("states", "inputs", "outputs", "freedoms")},
            "motions": self.motions.tolist(),
            "slope": self.slope.tolist(),
            "poles": [[p.real, p.imag] for p in self.poles.tolist()],
            "error": self.error,
        }

    def save(self, path):
        """Write *.json, *.npz or *.mat (MATLAB). Raises ValueError for another ending, OSError."""
        ending = str(path).rpartition(".")[2]
        if ending == "json":
            with open(path, "w", encoding="utf-8") as file:
                json.dump(self.as_dict(), file, indent=1)
            return
        arrays = {name: getattr(self, name) for name in ("A", "B", "C", "D", "motions", "slope", "poles")}
        names = ("states", "inputs", "outputs", "freedoms")
        if ending == "npz":
            np.savez(path, **arrays, **{name: np.array(getattr(self, name), dtype=str) for name in names})
        elif ending == "mat":
            cells = {name: np.array(getattr(self, name), dtype=object) for name in names}
            scipy.io.savemat(path, arrays | cells)
        else:
            raise ValueError(f"{path}: the name must end in .json, .npz or .mat")


def linearise(simulation, inputs=None, outputs=None, independent=None, time=None):
    """LinearSystem of a simulation at a state; the simulation does not change.

    time   : s, of a state within the present step; None: the present state
    inputs, outputs : names, see channels.py; None: the default ones
    independent : names of the coordinates; None: those with the best condition
    Stops and friction keep their present modes; joints that they hold do not move. A motion that slides along a
    comparison of a law stays there. The inputs that act continue.
    Raises SceneError for unknown names, SimulationError if the accelerations cannot be computed.
    Accuracy: test/verification/test_linear.py.
    """
    return system_of(Probe(simulation, time), inputs, outputs, independent)


def change_along(simulation, system, time=None):
    """Largest change of an entry of A along the motion, 1/s, relative to its largest entry.

    system : LinearSystem of this simulation and time
    Zero at an equilibrium and in a steady motion. Elsewhere A and its poles are those of one instant, so in the body
    axes of a wheel that rolls.
    """
    return change_of(Probe(simulation, time), system)


def change_of(probe, system):
    """As `change_along`, of a Probe at the state of the system."""
    m = system.coordinates
    largest = np.abs(system.A).max(initial=0.0)
    if not largest:
        return 0.0
    coordinates = Coordinates(probe, _chosen(system))
    speed, way = coordinates.along(coordinates.signs * system.slope[:m])
    return float(np.abs(_change(probe, coordinates, system, way)).max() * speed / largest) if speed else 0.0


def _chosen(system):
    """Names of the freedoms whose rates are states of a LinearSystem."""
    return [name.removesuffix(".rate") for name in system.states[system.coordinates :]]


def _change(probe, coordinates, system, way):
    """Derivative of A (n, n) of a LinearSystem along a way y (f, 2), by a central difference."""
    kept, sides = probe.keep(), []
    for sign in (1.0, -1.0):
        probe.go_to(sign * DISPLACED * way)
        sides.append(system_of(probe, [], [], coordinates.rate_names, coordinates.names, system.states).A)
        probe.restore(kept)
    return (sides[0] - sides[1]) / (2.0 * DISPLACED)


def pole_errors(simulation, system, time=None):
    """(n,) errors of the poles of a LinearSystem that follow from the estimated error of the state, rad/s and 1/s.

    system : of this simulation and time
    A bound to first order: the changes of A with every coordinate and rate, times the largest change of that
    which the estimated errors of all bodies allow, and the error of the entries. NaN without an estimate, and for
    poles whose eigenvectors are dependent.
    """
    probe = Probe(simulation, time)
    poles, m, n = system.poles, system.coordinates, len(system.A)
    if probe.base.errors is None or not n:
        return np.full(n, np.nan)
    chosen = _chosen(system)
    shown = system_of(probe, [], ["bodies", "twists"], chosen, states=system.states).C
    position, attitude, velocity, rate = np.maximum(probe.base.errors, 1e-300).T
    errors = np.concatenate([_by_body(attitude, position), _by_body(rate, velocity)])
    largest = np.abs(np.linalg.pinv(shown / errors[:, None])).sum(axis=1)
    values, left, right = scipy.linalg.eig(system.A, left=True)
    order = [int(np.argmin(np.abs(values - pole))) for pole in poles]
    product = np.einsum("ij,ij->j", left.conj(), right)
    found = system.error * np.abs(system.A).max() / np.where(product != 0.0, np.abs(product), np.nan)[order]
    coordinates = Coordinates(probe, chosen)
    for k, name in enumerate(system.states):
        place = coordinates.state_names.index(name)
        way = coordinates.neighbour(place - m if k >= m else place, 1.0, k >= m)
        change = _change(probe, coordinates, system, way)
        with np.errstate(divide="ignore", invalid="ignore"):  # a pole without independent eigenvectors: NaN
            moved = np.abs(np.einsum("ij,ik,kj->j", left.conj(), change, right) / product)
        found += largest[k] * moved[order]
    return found


def _by_body(turning, moving):
    """(6 n,) three times the number of each body, one after the other."""
    return np.repeat(np.stack([turning, moving], axis=1), 3, axis=1).ravel()


def system_of(probe, inputs=None, outputs=None, independent=None, preferred=(), states=None):
    """As `linearise`, of a Probe; preferred: as of Coordinates.

    states : names of the states; None: without states of laws on which no rate and no output depends
    """
    coordinates = Coordinates(probe, independent, preferred)
    inputs, outputs = InputChannels(probe, inputs), OutputChannels(probe, outputs)
    rows = np.concatenate([coordinates.independent, probe.freedoms + coordinates.moving])
    signs = np.concatenate([coordinates.signs, coordinates.rate_signs])
    m, n = len(coordinates.independent), len(rows)

    moves = [(coordinates.neighbour(k, 1.0), coordinates.size(k)) for k in range(m)]
    moves += [(coordinates.neighbour(k, 1.0, True), coordinates.rate_size(k)) for k in range(n - m)]
    count = len(moves) + len(inputs)
    directions, sizes = np.zeros((count, probe.freedoms, 2)), np.concatenate([[h for _, h in moves], inputs.sizes])
    directions[: len(moves)] = np.reshape([y for y, _ in moves], (len(moves), probe.freedoms, 2))
    slopes, errors = probe.derivatives(directions, sizes, *inputs.changes(len(moves)))
    found, errors = signs * slopes[:, rows], errors[:, rows]

    def seen(d, s):
        u = np.zeros(len(inputs)) if d < len(moves) else s * np.eye(len(inputs))[d - len(moves)]
        applied = None if d < len(moves) else inputs.applied(u)
        _, pose, twist = probe.slopes(s * directions[d], applied)
        sample = probe.sample(pose, twist, applied)
        sample.joint_efforts = inputs.efforts(u)
        return outputs.of(sample)

    # In the chart that moves with the state, d/dt psi = w + [psi, V]; in the fixed one half of the bracket.
    found[:m, :m] += found[:m, :m] - (coordinates.signs * coordinates.changes[coordinates.independent].T)
    shown, doubt = outputs.along(directions), np.zeros((count, len(outputs)))
    if shown is None:
        parts = [derivative(lambda s, d=d: seen(d, s), sizes[d]) for d in range(count)]
        shown, doubt = (np.reshape(part, (count, len(outputs))) for part in zip(*parts)) if parts else (doubt, doubt)
    matrix, error = np.hstack([found, shown]).T, np.hstack([errors, doubt]).T
    matrix[:, :n] *= signs
    # Round-off of entries that are zero would couple what is not: eigenvectors depend on it.
    matrix[np.abs(matrix) <= error] = 0.0
    all_states, is_law = coordinates.state_names, np.append(np.zeros(m, bool), coordinates.is_state[coordinates.moving])
    if states is None:
        places = np.flatnonzero(~is_law | matrix[:, :n].any(axis=0))
    else:
        places = np.array([all_states.index(name) for name in states], dtype=int)
    used = np.append(places, np.arange(n, matrix.shape[1]))
    matrix, error = (each[np.append(places, np.arange(n, len(each)))][:, used] for each in (matrix, error))
    slope, states = (signs * probe.slopes()[0][rows])[places], tuple(all_states[k] for k in places)
    n = len(places)
    own, rest = slice(0, n), slice(n, None)
    parts = [(np.abs(matrix[rows]).max(initial=0.0), error[rows]) for rows in (own, rest)]
    names = [freedom.name for freedom in coordinates.freedoms]
    all_signs = np.array([freedom.sign for freedom in coordinates.freedoms])
    return LinearSystem(
        *(matrix[:n, :n], matrix[:n, n:], matrix[n:, :n], matrix[n:, n:]),
        states=states,
        coordinates=m,
        inputs=tuple(inputs.names),
        outputs=tuple(outputs.names),
        motions=all_signs[:, None] * coordinates.motions * coordinates.signs,
        freedoms=tuple(names),
        slope=slope,
        error=max(part.max(initial=0.0) / size if size > 0.0 else 0.0 for size, part in parts),
        time=probe.base.time,
        scene=probe.layout.scene.name,
    )
