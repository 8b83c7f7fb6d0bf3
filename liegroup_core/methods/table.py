# SPDX-License-Identifier: Apache-2.0
"""Table of integration methods; a Munthe-Kaas method is defined by a Runge-Kutta tableau.

To add an explicit Runge-Kutta method, add an entry to _RUNGE_KUTTA. Tests include it: they check row sums,
the order conditions of all rooted trees up to the stated order, and the order on problems with
non-commuting rotations: test/contract/test_methods.py, test/verification/test_orders.py.

Methods for every scene:
    rkmk...              explicit; constraints at acceleration level. A pair with an error estimate
                         divides each step into substeps by error control
    radau5               implicit, for stiff scenes; the same constraints and error control
    generalized_alpha    implicit, for stiff scenes, with fixed steps; constraints at position level
    constrained_rattle, constrained_rattle4, constrained_rattle8    orders 2, 4, 8; symplectic,
                         for long runs; explicit in forces, constraints at position level

Methods for bodies that are free or on one spherical joint to ground (folder rotation). All except
the last one conserve the angular momentum of free bodies to machine precision at any step size:
    stoermer_verlet      explicit, (6.42)
    coadjoint_rkmk...    explicit, with the tableau of that name
    rattle, austin_krishnaprasad_wang               implicit for each body, explicit in forces
    simo_wong, lie_midpoint, bottasso_borri_candidate    implicit
    lie_newmark          velocities implicit for each body: (6.41); does not conserve momentum
"""
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from liegroup_core.motion_groups.table import FLOATING

# The product of the motion groups of the joints of a tree.
RELATIVE = "relative"
CONFIGURATION_GROUPS = (*FLOATING, RELATIVE)

EXACT = -1                  # instead of the last power of ad in dexpinv: closed form


def refuse_stabilisation(method, model):
    """Raise ValueError if a model is stabilised: the method satisfies the constraints itself."""
    if model.projects or model.baumgarte_rate > 0.0:
        raise ValueError(f"{method.name} satisfies the constraints itself: stabilisation must be 'none'")


@dataclass(frozen=True)
class Tableau:
    """Coefficients of a Runge-Kutta method of `s` stages.

    a : (s, s) strictly lower triangular, or full
    b : (s,) weights
    c : (s,) nodes, the row sums of a
    e : (1, s + 1) weights of the error estimate, b - b_hat, or (2, s + 1) of two estimates of orders
        5 and 3. The last weight is that of the stage derivative at the end of the step, of an
        implicit method at its start.
        (0, s + 1) for a method without error control
    """

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    e: np.ndarray


@dataclass(frozen=True)
class Method:
    """Properties of one method.

    family       : family that implements it, see families.py
    order        : of global convergence
    source       : literature
    coefficients : of a Runge-Kutta method, else None: function without arguments that returns
                   (a, b), or (a, b, *e) with error estimates. a of an explicit method omits the zeros
                   on and above the diagonal
    """

    name: str
    family: str
    order: int
    source: str
    coefficients: Callable | None = None

    @property
    def implicit(self):
        """Whether it is an implicit Runge-Kutta method."""
        return self.name in _IMPLICIT

    @property
    def power(self):
        """Exponent of the substep in the tolerance that it meets with error control."""
        return 1 + len(self.tableau.b) if self.implicit else self.order

    @property
    def controlled(self):
        """Whether each step is divided into substeps by error control."""
        return self.family == "rkmk" and len(self.tableau.e) > 0

    @property
    def options(self):
        """Names of the settings that not all methods have."""
        if self.family != "rkmk":
            return {"generalized_alpha": ("rho_inf", "space"), "constrained": ("space",)}.get(self.family, ())
        # The iterations of implicit methods could stop at no order.
        return ("dexpinv",) * (not self.implicit) + ("space",) + ("rtol", "atol") * self.controlled

    @cached_property
    def tableau(self):
        """Tableau; only for a method with coefficients."""
        a, b, *e = self.coefficients()
        full = np.zeros((len(b), len(b)))
        for i, row in enumerate(a):
            full[i, :len(row)] = row
        return Tableau(full, np.array(b, dtype=float), full.sum(axis=1),
                       np.array(e, dtype=float).reshape(-1, len(b) + 1))


def _dormand_prince_5():
    """Coefficients of the fifth-order method, and its difference to the fourth-order one."""
    a = [[], [1 / 5], [3 / 40, 9 / 40], [44 / 45, -56 / 15, 32 / 9],
         [19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729],
         [9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656]]
    b = [35 / 384, 0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84]
    fourth = [5179 / 57600, 0, 7571 / 16695, 393 / 640, -92097 / 339200, 187 / 2100, 1 / 40]
    return a, b, np.append(b, 0.0) - fourth


def _dormand_prince_8():
    """Coefficients from SciPy, whose modules are loaded at their first use."""
    DOP853 = scipy.integrate.DOP853
    return DOP853.A, DOP853.B


def _dormand_prince_853():
    DOP853 = scipy.integrate.DOP853
    return DOP853.A, DOP853.B, DOP853.E5, DOP853.E3


_RUNGE_KUTTA = {method.name: method for method in (
    Method("rkmk1", "rkmk", 1, "Lie-Euler method: Euler 1768",
           lambda: ([[]], [1])),
    Method("rkmk2", "rkmk", 2, "explicit midpoint rule: Runge 1895",
           lambda: ([[], [1 / 2]], [0, 1])),
    Method("rkmk2_heun", "rkmk", 2, "explicit trapezoidal rule: Heun 1900",
           lambda: ([[], [1]], [1 / 2, 1 / 2])),
    Method("rkmk3", "rkmk", 3, "Ralston 1962; advancing method of the pair of "
           "Bogacki and Shampine, Appl. Math. Lett. 2 (1989)",
           lambda: ([[], [1 / 2], [0, 3 / 4]], [2 / 9, 1 / 3, 4 / 9])),
    Method("rkmk4", "rkmk", 4,
           "classical method: Kutta 1901, as Munthe-Kaas method: Munthe-Kaas, BIT 38 (1998) "
           "92-111; (6.25)",
           lambda: ([[], [1 / 2], [0, 1 / 2], [0, 0, 1]], [1 / 6, 1 / 3, 1 / 3, 1 / 6])),
    Method("rkmk54", "rkmk", 5,
           "5(4) pair: Dormand and Prince, J. Comput. Appl. Math. 6 (1980) 19-26",
           _dormand_prince_5),
    Method("rkmk8", "rkmk", 8, "advancing method of the 8(5,3) pair of Dormand and Prince: "
           "Hairer, Norsett and Wanner, Solving ODEs I, DOP853",
           _dormand_prince_8),
    Method("rkmk853", "rkmk", 8, "8(5,3) pair of Dormand and Prince with its error control: "
           "Hairer, Norsett and Wanner, Solving ODEs I, DOP853",
           _dormand_prince_853),
)}


def _radau_5():
    """Collocation at the zeros of d^2/dx^2 (x^2 (x - 1)^3), and the estimate with the start's derivative."""
    root = math.sqrt(6.0)
    c = np.array([(4.0 - root) / 10.0, (4.0 + root) / 10.0, 1.0])
    powers = np.vander(c, increasing=True)
    a = np.linalg.solve(powers.T, (c[:, None] ** [1, 2, 3] / [1, 2, 3]).T).T
    values = np.linalg.eigvals(np.linalg.inv(a))
    start = 1.0 / values[np.argmin(np.abs(values.imag))].real
    b = np.linalg.solve(powers.T, [1.0 - start, 1 / 2, 1 / 3])
    return a, a[-1], [np.append(b - a[-1], start)]


_IMPLICIT = {"radau5": Method(
    "radau5", "rkmk", 5, "Radau IIA: Hairer and Wanner, Solving ODEs II, IV.8", _radau_5)}


def _coadjoint(name):
    """Coadjoint method of the rotation family with the tableau of a Munthe-Kaas method."""
    method = _RUNGE_KUTTA[name]
    return Method(f"coadjoint_{name}", "rotation", method.order,
                  f"(6.34), (6.38), (6.39), (6.44); Engo and Faltinsen 1999; {method.source}",
                  method.coefficients)


METHODS = {method.name: method for method in (
    *_RUNGE_KUTTA.values(),
    *_IMPLICIT.values(),
    Method("generalized_alpha", "generalized_alpha", 2,
           "Bruels, Cardona and Arnold, Mech. Mach. Theory 48 (2012) 121-137"),
    Method("stoermer_verlet", "rotation", 2,
           "(6.42); Terze, Mueller and Zlatar, modified Stoermer-Verlet in Lie-group setting"),
    *map(_coadjoint, ("rkmk2", "rkmk2_heun", "rkmk4", "rkmk8")),
    Method("lie_newmark", "rotation", 2,
           "Krysl and Endres, Int. J. Numer. Meth. Eng. 62 (2005) 2154-2177; (6.41) is the same"),
    Method("rattle", "rotation", 2, "Leimkuhler and Reich, Simulating Hamiltonian Dynamics, 2004; "
           "without forces discrete Moser-Veselov"),
    Method("simo_wong", "rotation", 2,
           "ALGO_C1: Simo and Wong, Int. J. Numer. Meth. Eng. 31 (1991) 19-52"),
    Method("austin_krishnaprasad_wang", "rotation", 2,
           "Austin, Krishnaprasad and Wang, J. Comput. Phys. 107 (1993) 105-117; the impulse of "
           "the torque is ours"),
    Method("lie_midpoint", "rotation", 2, "implicit Lie midpoint rule, LIEMID[I]: Krysl, Int. J. "
           "Numer. Meth. Eng. 63 (2005) 2171-2193"),
    Method("bottasso_borri_candidate", "rotation", 2,
           "may be that of Bottasso and Borri, Comput. Methods Appl. Mech. Eng. 164 (1998) "
           "307-331: identified by name and structure alone"),
    Method("constrained_rattle", "constrained", 2,
           "Andersen, J. Comput. Phys. 52 (1983) 24-34; Bou-Rabee and Marsden, Found. Comput. "
           "Math. 9 (2009) 197-219"),
    Method("constrained_rattle4", "constrained", 4,
           "composition of five steps: Suzuki, Phys. Lett. A 146 (1990) 319-323"),
    Method("constrained_rattle8", "constrained", 8,
           "composition of seventeen steps: Kahan and Li, Math. Comp. 66 (1997) 1089-1099"),
)}
