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
    symmetric maps are compared in docs/explanation/long_runs.md
  * constraints and J V = 0 are satisfied to machine precision; momentum components that joints and
    forces do not change are conserved to machine precision
Steps g_1 h, ..., g_k h with symmetric g, sum g = 1, compose a step of higher order with the same
properties, see SUBSTEPS. docs/explanation/long_runs.md compares them with rkmk4 and rkmk8.

Broyden's method finds lambda, in terms of J V', from the saddle-point matrix at the start of the
step. A step takes one elimination; all other solves are substitutions. The configuration group is
SO(3) x R^3 for every `group` of the simulation. half_steps.py has both halves of a step.

Source: Andersen, J. Comput. Phys. 52 (1983) 24-34; Marsden and West, Acta Numerica 2001, 3.5.2;
Bou-Rabee and Marsden, Found. Comput. Math. 9 (2009) 197-219 for the rotation.
"""

import numpy as np

from liegroup_core.compiling import SameTypes, borrowed, stepper
from liegroup_core.forces.kinds import count_turns
from liegroup_core.integrators.methods import refuse_stabilisation
from liegroup_core.integrators.motion import copy_state, end_status
from liegroup_core.lie.vec3 import dot3, load3
from liegroup_core.model.arrays import make_work
from liegroup_core.status import OK

from .half_steps import HISTORY, Memory, first_half, second_half
from .solve import loads


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
def advance(model, work, memory, parts, h, steps, pose, twist, external):
    """Take `steps` steps of size h in place of pose (n, 12) and twist (n, 6).

    parts           : (k,) substeps as fractions of a step, an entry of SUBSTEPS
    external        : external wrenches of these steps, see forces/external.py
    returns (steps done, status), as munthe_kaas.advance; if status is not OK, the initial guesses
    are invalid
    """
    pose, twist, external, parts = (
        borrowed(pose),
        borrowed(twist),
        borrowed(external),
        borrowed(parts),
    )
    for done in range(steps):
        copy_state(pose, twist, work.start_pose, work.start_twist)
        loads(model, work, pose, twist, external)
        for i in range(len(model.bodies)):
            for c in range(6):
                memory.load[i, c] = work.wrench[i, c]
        work.report[1] = 0.0
        for part in range(len(parts)):
            size = parts[part] * h
            status = first_half(model, work, memory, size, done + part == 0)
            if status == OK:
                status = second_half(model, work, memory, size, external)
            if status != OK:
                return done, status
            for i in range(len(model.bodies)):
                x = load3(memory.turn, i, 0)
                work.report[1] = max(work.report[1], dot3(x, x))
            copy_state(work.stage_pose, work.stage_twist, work.start_pose, work.start_twist)
        status = end_status(model.forces, h, work.stage_pose, work.stage_twist)
        if status != OK:
            return done, status
        count_turns(model.forces, work.stage_pose, work.angle)
        copy_state(work.stage_pose, work.stage_twist, pose, twist)
        work.report[0] = max(work.report[0], work.report[1])
    return steps, OK


class Constrained:
    """RATTLE method for a model, with its memory and initial guesses between calls."""

    kernels = "constrained"
    substeps = (0, 0)

    def __init__(self, method, layout, group, step, options):
        model = layout.model
        refuse_stabilisation(method, model)
        n, rows = len(model.bodies), len(model.row_residual)
        self._model, self._parts = model, SUBSTEPS[method.name]
        self._memory = Memory(
            half=np.zeros((n, 6)),
            turn=np.zeros((n, 3)),
            load=np.zeros((n, 6)),
            impulse=np.zeros((n, 6)),
            target=np.zeros(rows),
            corrections=np.zeros((HISTORY, rows)),
            bias=np.zeros(rows),
            growth=np.zeros(rows),
            size=np.zeros(1),
        )
        self.work = make_work(model, 1)
        self._advance = SameTypes(advance)

    @staticmethod
    def options(method):
        """Options of the method: none."""
        return {}

    def restart(self):
        """Clear the initial guesses: the state was set."""
        for guess in self.memory:
            guess[:] = 0.0

    @property
    def memory(self):
        """Arrays of the memory between calls."""
        return self._memory.bias, self._memory.growth, self._memory.size

    def advance(self, h, steps, pose, twist, external):
        """Take steps of size h in place; returns (steps done, status)."""
        done, status = self._advance(
            self._model, self.work, self._memory, self._parts, h, steps, pose, twist, external
        )
        if status != OK:
            self.restart()
        return done, status
