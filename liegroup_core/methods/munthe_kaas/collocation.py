# SPDX-License-Identifier: Apache-2.0
"""Data of an implicit Munthe-Kaas method of three stages, see implicit.py."""

import numpy as np

from liegroup_core.compiling import Struct
from liegroup_core.state import StoredMatrix

STAGES = 3
START, END = STAGES, STAGES + 1  # rows of Collocation.z after those of the stages
LISTS = "filled", "coupled", "active"


class Collocation(Struct):
    """Data and scratch memory of an implicit method, f degrees of freedom; else all arrays are empty."""

    inverse: np.ndarray  # (3, 3) of a
    real: np.ndarray  # (3, 2) transformation to the eigenvector of the real eigenvalue, and back
    pair: np.ndarray  # (3, 4) the same for one complex eigenvalue, and twice back: real, imaginary parts
    real_value: float
    pair_value: np.ndarray  # (2,) real and imaginary part
    estimate: np.ndarray  # (3,) weights of the z_j in the error estimate
    known: np.ndarray  # (1,) 1: the Jacobian is that of this substep or of an earlier one of the step
    z: np.ndarray  # (5, f, 2) y of the stages, of a perturbed start, and of the end
    slopes: np.ndarray  # (5, f, 2) F there
    initial: np.ndarray  # (f, 2) F at the start
    stiffness: np.ndarray  # (f, f) Q, its columns in rows
    damping: np.ndarray  # (f, f) D, the same
    filled: np.ndarray  # (f,) int64 whether a column of Q or D is not zero; -1: that is not known
    coupled: np.ndarray  # (1 + f,) int64 number of freedoms on which an acceleration depends, and these
    active: np.ndarray  # (1 + f,) int64 the same of those whose acceleration depends on one
    factors: np.ndarray  # (f, f) of these, in its first rows and columns
    pivots: np.ndarray  # (f,)
    x: np.ndarray  # (f,)
    real_factors: np.ndarray  # (f, f) of the complex system, real and imaginary parts
    imag_factors: np.ndarray
    pair_pivots: np.ndarray  # (f,)
    real_x: np.ndarray  # (f,)
    imag_x: np.ndarray
    packed: np.ndarray  # (f,) of the coupled freedoms
    imag_packed: np.ndarray  # (f,)
    residual: np.ndarray  # (3, f, 2)
    next: np.ndarray  # (f, 2) solution

    @property
    def jacobian(self):
        """Whether the Jacobian is known, and its parts; none of an explicit method."""
        if len(self.z) == 0:
            return ()
        known, parts = self.known[0] != 0.0, (self.stiffness, self.damping)
        return self.known, *(StoredMatrix(len(part), part, self.filled, known) for part in parts)


def no_collocation():
    """Collocation of an explicit method."""
    sizes = {"stiffness": 2, "damping": 2, "factors": 2, "real_factors": 2, "imag_factors": 2}
    sizes |= {"inverse": 2, "real": 2, "pair": 2, "initial": 2, "next": 2}
    sizes |= {"z": 3, "slopes": 3, "residual": 3}
    arrays = {
        name: np.zeros((0,) * sizes.get(name, 1), dtype=np.int64 if "pivots" in name or name in LISTS else float)
        for name in Collocation.__annotations__
        if name != "real_value"
    }
    return Collocation(**arrays, real_value=0.0)


def stage_polynomials(c):
    """Coefficients (3, 3) of theta, theta^2, theta^3 in the weights of the stages: 1 at their own nodes, else 0."""
    powers = np.arange(1, STAGES + 1)
    return np.linalg.inv(c[:, None] ** powers).T.copy()


def make_collocation(tableau, freedoms):
    """Collocation of an implicit Tableau of three stages, for a number of freedoms."""
    inverse = np.linalg.inv(tableau.a)
    values, vectors = np.linalg.eig(inverse)
    back = np.linalg.inv(vectors)
    real, pair = (int(np.argmax(part)) for part in (-np.abs(values.imag), values.imag))
    f = freedoms
    return Collocation(
        inverse=inverse,
        real=np.ascontiguousarray(np.stack([back[real], vectors[:, real]], axis=1).real),
        pair=np.ascontiguousarray(
            [
                [there.real, there.imag, 2.0 * again.real, 2.0 * again.imag]
                for there, again in zip(back[pair], vectors[:, pair])
            ]
        ),
        real_value=float(values[real].real),
        pair_value=np.array([values[pair].real, values[pair].imag]),
        estimate=tableau.e[0, :-1] @ inverse,
        known=np.zeros(1),
        z=np.zeros((STAGES + 2, f, 2)),
        slopes=np.zeros((STAGES + 2, f, 2)),
        initial=np.zeros((f, 2)),
        stiffness=np.zeros((f, f)),
        damping=np.zeros((f, f)),
        filled=np.zeros(f, dtype=np.int64),
        coupled=np.zeros(1 + f, dtype=np.int64),
        active=np.zeros(1 + f, dtype=np.int64),
        factors=np.zeros((f, f)),
        pivots=np.zeros(f, dtype=np.int64),
        x=np.zeros(f),
        real_factors=np.zeros((f, f)),
        imag_factors=np.zeros((f, f)),
        pair_pivots=np.zeros(f, dtype=np.int64),
        real_x=np.zeros(f),
        imag_x=np.zeros(f),
        packed=np.zeros(f),
        imag_packed=np.zeros(f),
        residual=np.zeros((STAGES, f, 2)),
        next=np.zeros((f, 2)),
    )
