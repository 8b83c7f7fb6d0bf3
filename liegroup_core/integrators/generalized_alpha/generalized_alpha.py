# SPDX-License-Identifier: Apache-2.0
"""Generalised-alpha method on the group with position-level constraints (index 3).

The method is for stiff scenes. It is implicit, of order 2, and damps frequencies that the step does
not resolve: rho_inf from 1 (no damping) to 0 (damped within one step). One step, with velocities V
on the group:
    q_1 = q_0 exp psi ,   psi = h V_0 + h^2 ((1/2 - beta) a_0 + beta a_1)
    V_1 = V_0 + h ((1 - gamma) a_0 + gamma a_1)
    (1 - alpha_m) a_1 + alpha_m a_0 = (1 - alpha_f) Vdot_1 + alpha_f Vdot_0
    M Vdot_1 + J^T lambda = Q(q_1, V_1) ,   g(q_1) = 0
    alpha_m = (2 rho - 1)/(rho + 1), alpha_f = rho/(rho + 1),
    gamma = 1/2 + alpha_f - alpha_m, beta = (gamma + 1/2)^2 / 4
All constraints are satisfied to machine precision at position level, on both groups and at every
step size, without stabilisation (test/verification/test_orders.py). Velocity residuals are O(h^2).
On SO(3) x R^3 V is (omega, rdot), see munthe_kaas.py.

Newton's method in x = (Vdot_1, lambda): with sigma = d psi/d Vdot_1 the constraints are
g / sigma = 0. The matrix is then [[I, M^-1 J^T], [J, 0]] plus O(h). Unlike the matrix for psi, it
stays well conditioned for small steps. Finite differences give the matrix, so that all forces are
implicit without further formulas. It is dense: its factorisation takes (6 n + rows)^3 / 3
multiplications, suitable for about ten bodies, not for a hundred. The factors are reused over
iterations and steps as long as the iteration converges quickly.

Source: Bruels, Cardona and Arnold, Mech. Mach. Theory 48 (2012) 121-137, table 1; the scaling
after Bottasso, Bauchau and Cardona, J. Comput. Nonlinear Dyn. 2 (2007).
"""

import math

import numpy as np

from liegroup_core.compiling import SameTypes, borrowed, kernel, stepper
from liegroup_core.forces.external import COLUMNS as EXTERNAL_COLUMNS
from liegroup_core.forces.kinds import count_turns, too_fast
from liegroup_core.formulations.absolute.newton_euler import accelerations
from liegroup_core.integrators.methods import GROUPS, SE3, refuse_stabilisation
from liegroup_core.integrators.motion import copy_state, group_velocity, is_finite
from liegroup_core.lie.so3 import so3_nearest
from liegroup_core.lie.vec3 import dot3, load3, load9, store9, vector3
from liegroup_core.model.arrays import make_work
from liegroup_core.status import DEPENDENT_ROWS, NOT_CONVERGED, NOT_FINITE, OK, TURNS_NOT_COUNTED

from .dense_lu import lu_factorise, lu_solve
from .equations import Coefficients, Memory, move, residual, sigma

# Newton's method ends when the correction of the poses, rad and m, is below TOLERANCE times the
# largest coordinate or 1: about ten times round-off. Its effect on velocities is larger by 2 / h.
# If round-off is larger and corrections stop decreasing, the bound is STUCK times that.
TOLERANCE, STUCK = 2e-15, 100.0
# The matrix is factorised again if a correction exceeds SLOW times the one before. A correction is
# halved if the next one exceeds GROWTH times it. Some growth is allowed: if the initial guess
# stretches a stiff spring, corrections increase before they decrease.
SLOW, GROWTH = 0.1, 10.0
MOST_ITERATIONS = 50
DISPLACEMENT = 1e-7  # rad and m, perturbation of a pose: the derivative has half of all digits


@kernel
def _differentiate(model, work, memory, numbers, group, h, pose, external):
    """Factorise the Jacobian of the residual at memory.x; memory.base is the residual there.

    returns a status
    """
    rates = 6 * len(model.bodies)
    for c in range(len(memory.x)):
        value = memory.x[c]
        memory.x[c] += DISPLACEMENT / sigma(numbers, h) if c < rates else 1.0 + abs(value)
        change = memory.x[c] - value
        status = residual(model, work, memory, numbers, group, h, pose, external)
        memory.x[c] = value
        if status != OK:
            return status
        for r in range(len(memory.x)):
            memory.matrix[r, c] = (memory.residual[r] - memory.base[r]) / change
    memory.factored[0] = lu_factorise(memory.matrix, memory.pivots)
    return OK if memory.factored[0] else NOT_CONVERGED


@kernel
def _correct(model, memory, numbers, h):
    """Replace the residual in memory.next by the Newton correction.

    returns the largest displacement of a pose that it causes, rad or m
    """
    lu_solve(memory.matrix, memory.pivots, memory.next)
    largest = 0.0
    for k in range(6 * len(model.bodies)):
        # NaN propagates.
        if not abs(memory.next[k]) <= largest:
            largest = abs(memory.next[k])
    return largest * sigma(numbers, h)


@kernel
def _tolerance(model, pose):
    """Correction of a pose below which Newton's method ends, m and rad."""
    largest = 1.0
    for i in range(len(model.bodies)):
        r = load3(pose, i, 9)
        largest = max(largest, math.sqrt(dot3(r, r)))
    for e in range(len(model.elements)):
        for r in (
            vector3(model.elements[e]["parent_point"]),
            vector3(model.elements[e]["child_point"]),
        ):
            largest = max(largest, math.sqrt(dot3(r, r)))
    return TOLERANCE * largest


@kernel
def _newton(model, work, memory, numbers, group, h, pose, external):
    """Solve one step for memory.x, with memory.x as the initial guess; returns a status."""
    size = len(memory.x)
    tolerance = _tolerance(model, pose)
    for k in range(size):
        memory.start[k] = memory.x[k]
    old_factors = memory.factored[0]
    status, previous = OK, math.inf
    for _ in range(MOST_ITERATIONS):
        status = residual(model, work, memory, numbers, group, h, pose, external)
        correction = math.inf
        if status == OK and memory.factored[0]:
            for k in range(size):
                memory.next[k] = memory.residual[k]
            correction = _correct(model, memory, numbers, h)
        if (STUCK * tolerance < previous < math.inf) and not correction < GROWTH * previous:
            if old_factors:
                # The iteration diverged with old factors: restart it with new ones.
                old_factors = memory.factored[0] = False
                previous = math.inf
                for k in range(size):
                    memory.x[k] = memory.start[k]
            else:
                for k in range(size):
                    memory.correction[k] *= 0.5
                    memory.x[k] += memory.correction[k]
            continue
        if status != OK:
            return status
        if not memory.factored[0] or max(SLOW * previous, STUCK * tolerance) < correction:
            for k in range(size):
                memory.base[k] = memory.residual[k]
            status = _differentiate(model, work, memory, numbers, group, h, pose, external)
            if status != OK:
                return status
            old_factors = False
            for k in range(size):
                memory.next[k] = memory.base[k]
            correction = _correct(model, memory, numbers, h)
        for k in range(size):
            memory.correction[k] = memory.next[k]
            memory.x[k] -= memory.correction[k]
        if correction <= tolerance or SLOW * previous < correction <= STUCK * tolerance:
            return OK
        previous = correction
    if status != OK:
        return status
    return NOT_CONVERGED


@stepper
def advance(model, work, memory, numbers, group, h, steps, pose, twist, external):
    """Take `steps` steps of size h in place of pose (n, 12) and twist (n, 6).

    external        : external wrenches of these steps, see forces/external.py
    returns (steps done, status), as munthe_kaas.advance; if status is not OK, memory is invalid
    """
    pose, twist, external = borrowed(pose), borrowed(twist), borrowed(external)
    n = len(model.bodies)
    inverse = 1.0 / (1.0 - numbers.alpha_m)
    for done in range(steps):
        for i in range(n):
            group_velocity(group, pose, twist, i, work.velocity)
            for c in range(6):
                memory.old[i, c] = inverse * (
                    numbers.alpha_f * memory.rate[i, c] - numbers.alpha_m * memory.mean[i, c]
                )
        status = _newton(model, work, memory, numbers, group, h, pose, external)
        work.report[1] = 0.0
        if status == OK:
            status = move(model, work, memory, numbers, group, h, pose)
        if status == OK and not is_finite(work.stage_pose, work.stage_twist):
            status = NOT_FINITE
        if status == OK:
            fast = too_fast(model.forces, h, work.stage_pose, work.stage_twist)
            status = OK if fast < 0 else TURNS_NOT_COUNTED + (fast << 8)
        if status != OK:
            return done, status
        for i in range(n):
            store9(so3_nearest(load9(work.stage_pose, i, 0)), work.stage_pose, i, 0)
            for c in range(6):
                memory.rate[i, c] = memory.x[6 * i + c]
                memory.mean[i, c] = (
                    memory.old[i, c] + inverse * (1.0 - numbers.alpha_f) * memory.rate[i, c]
                )
        count_turns(model.forces, work.stage_pose, work.angle)
        copy_state(work.stage_pose, work.stage_twist, pose, twist)
        work.report[0] = max(work.report[0], work.report[1])
    return steps, OK


class GeneralizedAlpha:
    """Generalised-alpha method for a model, with its memory between calls.

    rho_inf : spectral radius at infinite step size, 0..1

    The memory holds Vdot, its mean a, lambda and the factors. It is initialised from the index-1
    accelerations after `restart`, after a failed step, and when wrenches or the step size change.
    """

    kernels = "generalized_alpha"
    substeps = (0, 0)

    def __init__(self, method, layout, group, step, options):
        rho = float(options["rho_inf"])
        alpha_m, alpha_f = (2.0 * rho - 1.0) / (rho + 1.0), rho / (rho + 1.0)
        gamma = 0.5 + alpha_f - alpha_m
        self._numbers = Coefficients(alpha_m, alpha_f, 0.25 * (gamma + 0.5) ** 2, gamma)
        model = layout.model
        refuse_stabilisation(method, model)
        n, rows = len(model.bodies), len(model.row_residual)
        size = 6 * n + rows
        self._memory = Memory(
            rate=np.zeros((n, 6)),
            mean=np.zeros((n, 6)),
            old=np.zeros((n, 6)),
            body_rate=np.zeros((n, 6)),
            x=np.zeros(size),
            start=np.zeros(size),
            residual=np.zeros(size),
            base=np.zeros(size),
            correction=np.zeros(size),
            next=np.zeros(size),
            matrix=np.zeros((size, size)),
            pivots=np.zeros(size, dtype=np.int64),
            factored=np.zeros(1, dtype=bool),
        )
        self._model, self._group = model, GROUPS[group]
        self.work = make_work(model, 1)
        self._advance = SameTypes(advance)
        # Step size and wrenches for which the memory was initialised; NaN: not initialised.
        self._started_for = np.zeros(1 + EXTERNAL_COLUMNS * n + len(self.work.acting))
        self.restart()

    @staticmethod
    def options(method):
        """{name: (default, description of valid values, check)} of the method's options."""
        return {"rho_inf": (0.8, "a number from 0 to 1", _is_fraction)}

    def restart(self):
        """Clear the memory between calls: the state was set."""
        self._started_for[:] = np.nan

    @property
    def memory(self):
        """Arrays of the memory between calls."""
        return (self._started_for, *self._memory.values())

    def advance(self, h, steps, pose, twist, external):
        """Take steps of size h in place; returns (steps done, status)."""
        inputs = np.concatenate(((h,), external.ravel(), self.work.acting))
        if self._started_for.tobytes() != inputs.tobytes():
            dependent = self._start(h, pose, twist, external)
            if dependent >= 0:
                return 0, DEPENDENT_ROWS + (self._model.joints[dependent]["element"] << 8)
            self._started_for[:] = inputs
        done, status = self._advance(
            self._model,
            self.work,
            self._memory,
            self._numbers,
            self._group,
            h,
            steps,
            pose,
            twist,
            external,
        )
        if status != OK:
            self.restart()
        return done, status

    def _start(self, h, pose, twist, external):
        """Initialise Vdot, a and lambda from the index-1 equations.

        returns -1, or the joint with dependent rows
        """
        work, memory = self.work, self._memory
        dependent = accelerations(self._model, work, pose, twist, external)
        if dependent < 0:
            memory.rate[:] = work.acceleration
            if self._group != SE3:
                turn = pose[:, :9].reshape(-1, 3, 3)
                linear = work.acceleration[:, 3:] + np.cross(twist[:, :3], twist[:, 3:])
                memory.rate[:, 3:] = np.einsum("nij,nj->ni", turn, linear)
            memory.mean[:] = memory.rate
            memory.x[:] = work.solution
            memory.x[: memory.rate.size] = memory.rate.ravel()
            memory.factored[0] = False
            self._shift_mean(h, pose, twist, external)
        return dependent

    def _shift_mean(self, h, pose, twist, external):
        """Shift a by alpha_m - alpha_f steps from Vdot, by a trial step.

        A step that starts with a = Vdot is only of order 1. If wrenches change at every step, the
        whole run would be of order 1.
        """
        memory, angle = self._memory, self.work.angle.copy()
        rate, x = memory.rate.copy(), memory.x.copy()
        _, status = self._advance(
            self._model,
            self.work,
            memory,
            self._numbers,
            self._group,
            h,
            1,
            pose.copy(),
            twist.copy(),
            external,
        )
        # If the trial step fails, a is unchanged.
        shift = self._numbers.alpha_m - self._numbers.alpha_f
        memory.mean[:] = rate + shift * (memory.rate - rate)
        memory.rate[:], memory.x[:], self.work.angle[:] = rate, x, angle
        if status != OK:
            memory.factored[0] = False


def _is_fraction(value):
    """True for a number from 0 to 1."""
    return isinstance(value, (int, float)) and 0.0 <= value <= 1.0
