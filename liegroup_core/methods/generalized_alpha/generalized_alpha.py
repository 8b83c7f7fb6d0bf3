# SPDX-License-Identifier: Apache-2.0
"""Generalised-alpha method on the group with position-level constraints (index 3).

The method is for stiff scenes. It is implicit, of order 2, and damps frequencies that the step does
not resolve: rho_inf from 1 (no damping) to 0 (damped within one step). One step, with velocities V
on the group:
    q_1 = q_0 exp psi ,   psi = h V_0 + h^2 ((1/2 - beta) a_0 + beta a_1)
    V_1 = V_0 + h ((1 - gamma) a_0 + gamma a_1)
    (1 - alpha_m) a_1 + alpha_m a_0 = (1 - alpha_f) Vdot_1 + alpha_f Vdot_0
    M Vdot_1 + bias + J^T lambda = Q(q_1, V_1) ,   g(q_1) = 0
    alpha_m = (2 rho - 1)/(rho + 1), alpha_f = rho/(rho + 1),
    gamma = 1/2 + alpha_f - alpha_m, beta = (gamma + 1/2)^2 / 4
All constraints are satisfied to machine precision at position level, in all groups and at every
step size, without stabilisation (test/verification/test_orders.py). Velocity residuals are O(h^2).

The groups are SE(3)^n, (SO(3) x R^3)^n and the product of the joints' motion groups. On SO(3) x R^3 V
is (omega, rdot), see munthe_kaas.py. In relative coordinates V are the rates of the joints of the
tree, and J and lambda belong to the cut joints only.

Newton's method in x = (Vdot_1, lambda): with sigma = d psi/d Vdot_1 the constraints are
g / sigma = 0. The matrix is then [[M, J^T], [J, 0]] plus O(h). Unlike the matrix for psi, it stays
well conditioned for small steps. It is dense (newton.py): a body that is held by a hinge adds 11
unknowns on SE(3)^n and one in relative coordinates. So relative coordinates suit about a
hundred bodies, SE(3)^n about ten.

Source: Bruels, Cardona and Arnold, Mech. Mach. Theory 48 (2012) 121-137, table 1; the scaling
after Bottasso, Bauchau and Cardona, J. Comput. Nonlinear Dyn. 2 (2007).
"""

import numpy as np

from liegroup_core.compiling import SameTypes, borrowed, kernel, stepper
from liegroup_core.dynamics.state import model_and_work
from liegroup_core.forces.external import COLUMNS as EXTERNAL_COLUMNS
from liegroup_core.mechanism.arrays import links_of
from liegroup_core.mechanism.bodies import LARGEST_TURN, STEP_TURN, copy_state
from liegroup_core.methods.table import refuse_stabilisation
from liegroup_core.status import DEPENDENT_ROWS, OK

from .arrays import Coefficients, keep_end, make_memory, set_old
from .newton import newton
from .steps import begin, enter, finish, leave, move, set_unknowns


@stepper
def advance(model, work, memory, numbers, h, steps, pose_in, twist_in, external_in):
    """Take `steps` steps of size h in place of pose (n, 12) and twist (n, 6).

    model, work     : RelativeModel or PlaneModel, and RelativeWork
    external        : external wrenches of these steps, see forces/external.py
    returns (steps done, status), as munthe_kaas/advance.py; if status is not OK, memory is invalid
    """
    pose_in, twist_in, external_in = borrowed(pose_in), borrowed(twist_in), borrowed(external_in)
    pose, twist, external, status = enter(model, work, pose_in, twist_in, external_in)
    done = 0
    while done < steps and status == OK:
        begin(model, work, memory, pose, twist)
        set_old(memory, numbers)
        work.clock.now[0] = (work.clock.count[0] + (done + 1)) * h + work.clock.offset[0]
        status = newton(model, work, memory, numbers, h, pose, external)
        work.report[STEP_TURN] = 0.0
        if status == OK:
            status = move(model, work, memory, numbers, h, pose)
        if status == OK:
            status = finish(model, work, memory, h)
        if status == OK:
            keep_end(memory, numbers)
            copy_state(work.stage_pose, work.stage_twist, pose, twist)
            work.report[LARGEST_TURN] = max(work.report[LARGEST_TURN], work.report[STEP_TURN])
            done += 1
    if done > 0:
        leave(model, work, pose, twist, pose_in, twist_in)
    return done, status


@kernel
def initialise(model, work, memory, pose_in, twist_in, external_in):
    """Initialise Vdot, a and lambda from the index-1 equations.

    returns -1, or the element with dependent rows
    """
    pose_in, twist_in, external_in = borrowed(pose_in), borrowed(twist_in), borrowed(external_in)
    pose, twist, external, _ = enter(model, work, pose_in, twist_in, external_in)
    dependent = set_unknowns(model, work, memory, pose, twist, external)
    for k in range(len(memory.rate)):
        memory.rate[k] = memory.mean[k] = memory.x[k]
    memory.factored[0] = 0.0
    return dependent


class GeneralizedAlpha:
    """Generalised-alpha method for a model, with its memory between calls.

    The memory holds Vdot, its mean a, lambda and the factors. It is initialised from the index-1
    accelerations after `restart`, after a failed step, and when wrenches or the step size change.
    """

    substeps = (0, 0)

    def __init__(self, method, layout, group, step, options):
        rho = float(options["rho_inf"])
        alpha_m, alpha_f = (2.0 * rho - 1.0) / (rho + 1.0), rho / (rho + 1.0)
        gamma = 0.5 + alpha_f - alpha_m
        self._numbers = Coefficients(alpha_m, alpha_f, 0.25 * (gamma + 0.5) ** 2, gamma)
        refuse_stabilisation(method, layout.model)
        self._model, self._work, self.work = model_and_work(layout, group, options, 1)
        n = len(layout.model.bodies)
        self._memory = make_memory(len(self._work.freedoms), len(self._model.row_residual))
        self._advance, self._initialise = SameTypes(advance), SameTypes(initialise)
        # Step size and wrenches for which the memory was initialised; NaN: not initialised.
        inputs = EXTERNAL_COLUMNS * n + self.work.targets.size + self.work.motions.size
        self._started_for = np.zeros(1 + inputs)
        self.restart()

    def restart(self):
        """Clear the memory between calls: the state was set."""
        self._started_for[:] = np.nan
        self._work.known[0] = 0.0

    @property
    def memory(self):
        """Arrays of the memory between calls."""
        return (self._started_for, *self._memory.values(), *links_of(self._work))

    def advance(self, h, steps, pose, twist, external):
        """Take steps of size h in place; returns (steps done, status)."""
        inputs = np.concatenate(((h,), external.ravel(), self.work.targets.ravel(), self.work.motions.ravel()))
        if self._started_for.tobytes() != inputs.tobytes():
            dependent = self._initialise(self._model, self._work, self._memory, pose, twist, external)
            if dependent >= 0:
                return 0, DEPENDENT_ROWS + (dependent << 8)
            self._shift_mean(h, pose, twist, external)
            self._started_for[:] = inputs
        done, status = self._take(h, steps, pose, twist, external)
        if status != OK:
            self._started_for[:] = np.nan
        return done, status

    def _take(self, h, steps, pose, twist, external):
        return self._advance(self._model, self._work, self._memory, self._numbers, h, steps, pose, twist, external)

    def _shift_mean(self, h, pose, twist, external):
        """Shift a by alpha_m - alpha_f steps from Vdot, by a trial step.

        A step that starts with a = Vdot is only of order 1. If wrenches change at every step, the
        whole run would be of order 1.
        """
        memory = self._memory
        state = (memory.rate, memory.x, memory.size, self.work.angle, *links_of(self._work))
        kept = [array.copy() for array in state]
        _, status = self._take(h, 1, pose.copy(), twist.copy(), external)
        # If the trial step fails, a is unchanged.
        shift = self._numbers.alpha_m - self._numbers.alpha_f
        memory.mean[:] = kept[0] + shift * (memory.rate - kept[0])
        for array, value in zip(state, kept):
            array[...] = value
        if status != OK:
            memory.factored[0] = 0.0
