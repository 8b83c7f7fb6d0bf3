# SPDX-License-Identifier: Apache-2.0
"""RATTLE for mechanisms: variational, symmetric, satisfies all constraints in every step.

The unknowns are the velocities V' = (w', v') at half step, in the body axes of the start. One step
from (R, r, V), with the wrenches Q of gravity, forces and external wrenches, M = diag(I, m):
    M V' = M V + (h/2) (Q - J^T lambda)                     lambda: constraints satisfied
    R+ = R exp x ,  h I w' = dexpinv_{-x} I x ,  r+ = r + h R v'                    at R+, r+
    M V+ = M V'+ + (h/2) (Q+ - J+^T mu)                     mu: J+ V+ = 0
V'+ has the momentum of V', in the axes of the end: I w'+ = exp(-x) I w', v'+ = exp(-x) v'. This is
the step of a discrete Lagrangian: the kinetic energy of the constant velocity (x/h, (r+ - r)/h),
and half of the potential energy at each end. J^T lambda acts at the start and J+^T mu at the end,
as in RATTLE.
Properties, shown by test/verification/test_constrained_geometric.py:
  * order 2 and symmetric: a step h followed by a step -h returns to the start, to machine
    precision. This includes velocity-dependent forces: the equation for V+ with Q+(V+) is solved
  * symplectic if all forces have a potential: the energy error is O(h^2) and does not drift. Other
    symmetric maps are compared in benchmarks/turns.py
  * constraints and J V = 0 are satisfied to machine precision; momentum components that joints and
    forces do not change are conserved to machine precision
Steps g_1 h, ..., g_k h with symmetric g, sum g = 1, compose a step of higher order with the same
properties, see SUBSTEPS. docs/explanation/long_runs.md compares them with rkmk4 and rkmk8.

Only cut joints have multipliers. On (SO(3) x R^3)^n all joints are cut: the trajectory is the same,
test/verification/test_rattle_relative.py, as the multipliers of the joints of a tree are eliminated
exactly.

Broyden's method finds the displacements of the joints from the articulated bodies at the start of the
step. A step takes one elimination; all other solves are substitutions.

Source: Andersen, J. Comput. Phys. 52 (1983) 24-34; Marsden and West, Acta Numerica 2001, 3.5.2;
Bou-Rabee and Marsden, Found. Comput. Math. 9 (2009) 197-219 for the rotation.
"""

import numpy as np

from liegroup_core.compiling import SameTypes, borrowed, stepper
from liegroup_core.dynamics.state import model_and_work
from liegroup_core.mechanism.arrays import PlaneModel, links_of
from liegroup_core.mechanism.bodies import LARGEST_TURN, STEP_TURN, copy_state
from liegroup_core.methods.table import refuse_stabilisation
from liegroup_core.status import OK

from .arrays import clear_guesses, make_memory
from .halves import begin, enter, finish, first_half, keep, leave, second_half


def _mirrored(*half):
    """Symmetric sequence of substeps; half: its first half with the middle one."""
    return np.array([*half[:-1], *half[::-1]])


_SUZUKI = 1.0 / (4.0 - 4.0 ** (1.0 / 3.0))
# Substeps g as fractions of a step. Order 4: Suzuki, Phys. Lett. A 146 (1990); order 8: Kahan and
# Li, Math. Comp. 66 (1997), as in Hairer, Lubich and Wanner, Geometric Numerical Integration,
# (V.3.13).
SUBSTEPS = {
    "constrained_rattle": np.ones(1),
    "constrained_rattle4": _mirrored(_SUZUKI, _SUZUKI, 1.0 - 4.0 * _SUZUKI),
    "constrained_rattle8": _mirrored(
        0.13020248308889008,
        0.56116298177510838,
        -0.38947496264484729,
        0.15884190655515560,
        -0.39590389413323758,
        0.18453964097831571,
        0.25837438768632205,
        0.29501172360931030,
        -0.60550853383003451,
    ),
}


@stepper
def advance(model, work, memory, parts, h, steps, pose_in, twist_in, external_in):
    """Take `steps` steps of size h in place of pose (n, 12) and twist (n, 6).

    model, work     : RelativeModel or PlaneModel, and RelativeWork
    parts           : (k,) substeps as fractions of a step, an entry of SUBSTEPS
    external        : external wrenches of these steps, see forces/external.py
    returns (steps done, status), as munthe_kaas/advance.py; if status is not OK, the initial guesses
    are invalid
    """
    pose_in, twist_in = borrowed(pose_in), borrowed(twist_in)
    external_in, parts = borrowed(external_in), borrowed(parts)
    pose, twist, external, status = enter(model, work, pose_in, twist_in, external_in)
    done = 0
    while done < steps and status == OK:
        start, passed = (work.clock.count[0] + done) * h + work.clock.offset[0], 0.0
        work.clock.now[0] = start
        begin(model, work, memory, pose, twist, external, done == 0)
        work.report[STEP_TURN] = 0.0
        for part in range(len(parts)):
            size = parts[part] * h
            passed = passed + parts[part] if part + 1 < len(parts) else 1.0
            work.clock.now[0] = start + passed * h
            status = first_half(model, work, memory, size, done + part == 0)
            if status == OK:
                status = second_half(model, work, memory, size, external)
            if status != OK:
                break
            keep(model, work, memory)
        if status == OK:
            status = finish(model, work, h)
        if status == OK:
            copy_state(work.stage_pose, work.stage_twist, pose, twist)
            work.report[LARGEST_TURN] = max(work.report[LARGEST_TURN], work.report[STEP_TURN])
            done += 1
    if done > 0:
        leave(model, work, pose, twist, pose_in, twist_in)
    return done, status


class Constrained:
    """RATTLE method for a model, with its memory and initial guesses between calls."""

    substeps = (0, 0)

    def __init__(self, method, layout, group, step, options):
        refuse_stabilisation(method, layout.model)
        self._parts = SUBSTEPS[method.name]
        self._model, self._work, self.work = model_and_work(layout, group, options, 1)
        self._model = _for_rates(self._model)
        self._memory = make_memory(self._model)
        self._advance = SameTypes(advance)

    def restart(self):
        """Clear the initial guesses: the state was set."""
        clear_guesses(self._memory)
        self._work.known[0] = 0.0

    @property
    def memory(self):
        """Arrays of the memory between calls."""
        guesses = self._memory.bias, self._memory.growth, self._memory.size
        return (*guesses, *links_of(self._work))

    def advance(self, h, steps, pose, twist, external):
        """Take steps of size h in place; returns (steps done, status)."""
        done, status = self._advance(
            self._model, self._work, self._memory, self._parts, h, steps, pose, twist, external
        )
        if status != OK:
            clear_guesses(self._memory)
        return done, status


def _for_rates(model):
    """RelativeModel for rates instead of accelerations, without gravity: a step adds the impulses of weights."""
    couplings = model.couplings.copy()
    couplings["order"] = 1
    changes = {"gravity": np.zeros_like(model.gravity), "couplings": couplings}
    if isinstance(model, PlaneModel):
        changes["plane_gravity"] = np.zeros_like(model.plane_gravity)
    return model.replace(**changes)
