# SPDX-License-Identifier: Apache-2.0
"""Generalised-alpha method on the group with the joints at position level (index 3).

For stiff scenes: implicit, of order 2, with a damping of what the step cannot resolve that the
user sets, rho_inf from 1 (none) to 0 (all of it within one step). One step, velocities V on the
group:
    q_1 = q_0 exp psi ,   psi = h V_0 + h^2 ((1/2 - beta) a_0 + beta a_1)
    V_1 = V_0 + h ((1 - gamma) a_0 + gamma a_1)
    (1 - alpha_m) a_1 + alpha_m a_0 = (1 - alpha_f) Vdot_1 + alpha_f Vdot_0
    M Vdot_1 + J^T lambda = Q(q_1, V_1) ,   g(q_1) = 0
    alpha_m = (2 rho - 1)/(rho + 1), alpha_f = rho/(rho + 1),
    gamma = 1/2 + alpha_f - alpha_m, beta = (gamma + 1/2)^2 / 4
The joints stay closed to rounding on both groups and at every step
size; their velocities are off by O(h^2). On SO(3) x R^3 V is (omega, rdot), see rkmk.py.

Newton's method in x = (Vdot_1, lambda): with sigma = d psi/d Vdot_1 the joints' equations are
g / sigma = 0, which makes the matrix [[I, M^-1 J^T], [J, 0]] plus O(h): it does not degenerate for
small steps as the one for psi does. The matrix is taken by differences, so every kind of force is
treated implicitly without formulas of its own. It is dense: its factors cost (6 n + rows)^3 / 3
multiplications, which suits some ten bodies (a chain of 3, 10, 30: about 10, 100, 1000 us a step)
and not a hundred. They are kept over iterations and steps while the iteration converges quickly.

Source: Bruels, Cardona and Arnold, Mech. Mach. Theory 48 (2012) 121-137, table 1; the scaling
after Bottasso, Bauchau and Cardona, J. Comput. Nonlinear Dyn. 2 (2007).
"""
import math
from typing import NamedTuple

import numpy as np

from .._compile import borrowed, kernel, subroutine
from ..dynamics.constraints import assemble, position_residuals
from ..dynamics.newton_euler import accelerations, wrenches
from ..forces.kinds import count_turns, too_fast
from ..lie.vec3 import (axpy3, cross3, dot3, load3, load9, matrix3, matvec3, scale3, store3,
                        store9, sub3, tmatvec3, vector3)
from ..model.arrays import WORLD, make_work
from .methods import GROUPS, SE3
from .motion import copy_state, displace, group_velocity, is_finite, orthonormal
from .status import (DEPENDENT_ROWS, LARGEST_ROTATION, NOT_CONVERGED, NOT_FINITE, OK,
                     ROTATION_TOO_LARGE, TURNS_NOT_COUNTED)

# Newton's method ends when a correction of the poses, rad and m, is this part of the largest
# coordinate or of 1: some ten roundings. What is left of it in a pose is 2 / h times that in the
# velocity. Where rounding is larger, corrections stop shrinking: then so many times that.
TOLERANCE, STUCK = 2e-15, 100.0
# New factors are made when a correction is more than SLOW times the one before; a correction is
# halved when the next one is more than GROWTH times as large. Some growth must pass: a stiff
# spring that the first guess stretches pulls so hard that corrections grow before they shrink.
SLOW, GROWTH = 0.1, 10.0
MOST_ITERATIONS = 50
DISPLACEMENT = 1e-7         # rad and m, of a pose for differences: half the digits are right


class Coefficients(NamedTuple):
    """The method's numbers."""

    alpha_m: float
    alpha_f: float
    beta: float
    gamma: float


class Memory(NamedTuple):
    """What the method holds beside pose, twist and Work; N = 6 n + rows."""

    rate: np.ndarray        # (n, 6) Vdot_0 on the group
    mean: np.ndarray        # (n, 6) a_0
    old: np.ndarray         # (n, 6) (alpha_f Vdot_0 - alpha_m a_0) / (1 - alpha_m)
    body_rate: np.ndarray   # (n, 6) Vdot_1 in body axes
    x: np.ndarray           # (N,) Vdot_1, then lambda
    start: np.ndarray       # (N,) x before the first iteration
    residual: np.ndarray    # (N,)
    base: np.ndarray        # (N,) residual that differences are taken from
    correction: np.ndarray  # (N,) by which x was corrected last
    next: np.ndarray        # (N,) residual, then the next correction
    matrix: np.ndarray      # (N, N) factors of the derivative of the residual
    pivots: np.ndarray      # (N,) row that was exchanged with each
    factored: np.ndarray    # (1,) bool: `matrix` holds factors


@kernel
def _subtract_constraint_wrenches(model, work, multiplier, first):
    """work.wrench -= J^T lambda, J of the last `assemble`, lambda from multiplier[first] on."""
    for j in range(len(model.joints)):
        a = model.joints[j]["parent"]
        b = model.joints[j]["child"]
        rows = model.joints[j]["rows"]
        place = model.joints[j]["parent_place"]
        row_step, step = 6, 1
        if model.joints[j]["parent_turned"] == 1:
            row_step, step = 1, rows
        for r in range(rows):
            value = multiplier[first + model.joints[j]["first"] + r]
            for c in range(6):
                work.wrench[b, c] -= value * work.child_jacobian[j, 6 * r + c]
                if a != WORLD:
                    work.wrench[a, c] -= value * work.matrix[place + r * row_step + c * step]


@kernel
def _sigma(numbers, h):
    """d psi / d Vdot_1, s^2."""
    return h * h * numbers.beta * (1.0 - numbers.alpha_f) / (1.0 - numbers.alpha_m)


@kernel
def _move(model, work, memory, numbers, group, h, pose):
    """State at the unknowns: work.stage_pose and stage_twist, memory.body_rate.

    returns OK, ROTATION_TOO_LARGE or NOT_FINITE
    """
    part = (1.0 - numbers.alpha_f) / (1.0 - numbers.alpha_m)
    for i in range(len(model.bodies)):
        for c in range(0, 6, 3):
            rate = (memory.x[6 * i + c], memory.x[6 * i + c + 1], memory.x[6 * i + c + 2])
            a0 = load3(memory.mean, i, c)
            a1 = axpy3(part, rate, load3(memory.old, i, c))
            v0 = load3(work.velocity, i, c)
            store3(axpy3(h, v0, axpy3(h * h * (0.5 - numbers.beta), a0,
                                      scale3(h * h * numbers.beta, a1))), work.slopes, i, c)
            store3(axpy3(h * (1.0 - numbers.gamma), a0, axpy3(h * numbers.gamma, a1, v0)),
                   work.stage_twist, i, c)
            store3(rate, memory.body_rate, i, c)
        xi, eta = load3(work.slopes, i, 0), load3(work.slopes, i, 3)
        rotation = dot3(xi, xi)
        if not rotation < LARGEST_ROTATION * LARGEST_ROTATION:
            if rotation < math.inf:
                return ROTATION_TOO_LARGE
            return NOT_FINITE
        work.report[1] = max(work.report[1], rotation)
        rot, r = displace(group, pose, i, xi, eta)
        store9(rot, work.stage_pose, i, 0)
        store3(r, work.stage_pose, i, 9)
        if group != SE3:
            w = load3(work.stage_twist, i, 0)
            v = tmatvec3(rot, load3(work.stage_twist, i, 3))
            store3(v, work.stage_twist, i, 3)
            linear = tmatvec3(rot, load3(memory.body_rate, i, 3))
            store3(sub3(linear, cross3(w, v)), memory.body_rate, i, 3)
    return OK


@subroutine
def _residual(model, work, memory, numbers, group, h, pose, external):
    """Equations of one step at memory.x into memory.residual; the state as by `_move`.

    returns OK, ROTATION_TOO_LARGE or NOT_FINITE
    """
    model, work, memory = borrowed(model), borrowed(work), borrowed(memory)
    pose, external = borrowed(pose), borrowed(external)
    status = _move(model, work, memory, numbers, group, h, pose)
    if status != OK:
        return status
    n = len(model.bodies)
    wrenches(model, work, work.stage_pose, work.stage_twist, external)
    assemble(model, work, work.stage_pose, work.stage_twist)
    _subtract_constraint_wrenches(model, work, memory.x, 6 * n)
    for i in range(n):
        angular = matvec3(matrix3(model.bodies[i]["inverse_inertia"]), load3(work.wrench, i, 0))
        inverse_mass = model.bodies[i]["inverse_mass"]
        for c in range(3):
            memory.residual[6 * i + c] = memory.body_rate[i, c] - angular[c]
            memory.residual[6 * i + 3 + c] = (memory.body_rate[i, 3 + c]
                                              - inverse_mass * work.wrench[i, 3 + c])
    position_residuals(model, work.stage_pose, work.gap)
    for row in range(len(model.row_residual)):
        gap = work.gap[model.row_residual[row]]
        memory.residual[6 * n + row] = gap / _sigma(numbers, h)
    return OK


@kernel
def _factorise(matrix, pivots):
    """LU factors with row exchanges in place; False for a matrix that has none."""
    size = len(pivots)
    for k in range(size):
        best = k
        for r in range(k + 1, size):
            if abs(matrix[r, k]) > abs(matrix[best, k]):
                best = r
        pivots[k] = best
        if not 0.0 < abs(matrix[best, k]) < math.inf:
            return False
        if best != k:
            for c in range(size):
                matrix[k, c], matrix[best, c] = matrix[best, c], matrix[k, c]
        for r in range(k + 1, size):
            factor = matrix[r, k] / matrix[k, k]
            matrix[r, k] = factor
            if factor != 0.0:
                for c in range(k + 1, size):
                    matrix[r, c] -= factor * matrix[k, c]
    return True


@kernel
def _solve(matrix, pivots, x):
    """Solve with the factors of `_factorise`, in place of the right-hand side x."""
    size = len(pivots)
    for k in range(size):
        x[k], x[pivots[k]] = x[pivots[k]], x[k]
    for k in range(size):
        for r in range(k + 1, size):
            x[r] -= matrix[r, k] * x[k]
    for k in range(size - 1, -1, -1):
        for c in range(k + 1, size):
            x[k] -= matrix[k, c] * x[c]
        x[k] /= matrix[k, k]


@kernel
def _differentiate(model, work, memory, numbers, group, h, pose, external):
    """Factors of the residual's derivative at memory.x, whose residual is memory.base."""
    rates = 6 * len(model.bodies)
    for c in range(len(memory.x)):
        kept = memory.x[c]
        memory.x[c] += DISPLACEMENT / _sigma(numbers, h) if c < rates else 1.0 + abs(kept)
        change = memory.x[c] - kept
        status = _residual(model, work, memory, numbers, group, h, pose, external)
        memory.x[c] = kept
        if status != OK:
            return status
        for r in range(len(memory.x)):
            memory.matrix[r, c] = (memory.residual[r] - memory.base[r]) / change
    memory.factored[0] = _factorise(memory.matrix, memory.pivots)
    return OK if memory.factored[0] else NOT_CONVERGED


@kernel
def _correct(model, memory, numbers, h):
    """Correction for the residual in memory.next, in its place; its largest displacement."""
    _solve(memory.matrix, memory.pivots, memory.next)
    largest = 0.0
    for k in range(6 * len(model.bodies)):
        # NaN becomes the largest, and stays it.
        if not abs(memory.next[k]) <= largest:
            largest = abs(memory.next[k])
    return largest * _sigma(numbers, h)


@kernel
def _tolerance(model, pose):
    """Correction of a pose at which Newton's method ends, m and rad."""
    largest = 1.0
    for i in range(len(model.bodies)):
        r = load3(pose, i, 9)
        largest = max(largest, math.sqrt(dot3(r, r)))
    for e in range(len(model.elements)):
        a = vector3(model.elements[e]["parent_point"])
        b = vector3(model.elements[e]["child_point"])
        largest = max(largest, math.sqrt(max(dot3(a, a), dot3(b, b))))
    return TOLERANCE * largest


@kernel
def _newton(model, work, memory, numbers, group, h, pose, external):
    """Solve one step for memory.x, from memory.x on; returns a status."""
    size = len(memory.x)
    tolerance = _tolerance(model, pose)
    for k in range(size):
        memory.start[k] = memory.x[k]
    old_factors = memory.factored[0]
    status, previous = OK, math.inf
    for _ in range(MOST_ITERATIONS):
        status = _residual(model, work, memory, numbers, group, h, pose, external)
        correction = math.inf
        if status == OK and memory.factored[0]:
            for k in range(size):
                memory.next[k] = memory.residual[k]
            correction = _correct(model, memory, numbers, h)
        if (STUCK * tolerance < previous < math.inf) and not correction < GROWTH * previous:
            if old_factors:
                # They have led astray: begin again with new ones.
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


@kernel
def advance(model, work, memory, numbers, group, h, steps, pose, twist, external):
    """Take `steps` steps of size h in place of pose (n, 12) and twist (n, 6).

    external (n, 6) : applied wrenches in body axes, constant over these steps
    returns (steps done, status), as rkmk.advance does
    """
    model, work, memory = borrowed(model), borrowed(work), borrowed(memory)
    pose, twist, external = borrowed(pose), borrowed(twist), borrowed(external)
    n = len(model.bodies)
    inverse = 1.0 / (1.0 - numbers.alpha_m)
    for done in range(steps):
        for i in range(n):
            group_velocity(group, pose, twist, i, work.velocity)
            for c in range(6):
                memory.old[i, c] = inverse * (numbers.alpha_f * memory.rate[i, c]
                                              - numbers.alpha_m * memory.mean[i, c])
        status = _newton(model, work, memory, numbers, group, h, pose, external)
        work.report[1] = 0.0
        if status == OK:
            status = _move(model, work, memory, numbers, group, h, pose)
        if status == OK and not is_finite(work.stage_pose, work.stage_twist):
            status = NOT_FINITE
        if status == OK:
            fast = too_fast(model.forces, h, work.stage_pose, work.stage_twist)
            if fast >= 0:
                status = TURNS_NOT_COUNTED + (fast << 8)
        if status != OK:
            for k in range(len(memory.x)):
                memory.x[k] = memory.start[k]
            memory.factored[0] = False
            return done, status
        for i in range(n):
            store9(orthonormal(load9(work.stage_pose, i, 0)), work.stage_pose, i, 0)
            for c in range(6):
                memory.rate[i, c] = memory.x[6 * i + c]
                memory.mean[i, c] = (memory.old[i, c] + inverse * (1.0 - numbers.alpha_f)
                                     * memory.rate[i, c])
        count_turns(model.forces, work.stage_pose, work.angle)
        copy_state(work.stage_pose, work.stage_twist, pose, twist)
        work.report[0] = max(work.report[0], work.report[1])
    return steps, OK


class GeneralizedAlpha:
    """The method on a model: its memory, and what lasts between calls.

    rho_inf : spectral radius at infinite step size, 0..1

    What lasts is Vdot, its mean a, lambda and the factors. They start from the index-1
    accelerations after `restart`, and where the wrenches or the step size jump.
    """

    substeps = (0, 0)

    def __init__(self, method, layout, group, step, options):
        rho = float(options["rho_inf"])
        alpha_m, alpha_f = (2.0 * rho - 1.0) / (rho + 1.0), rho / (rho + 1.0)
        gamma = 0.5 + alpha_f - alpha_m
        self._numbers = Coefficients(alpha_m, alpha_f, 0.25 * (gamma + 0.5) ** 2, gamma)
        model = layout.model
        if model.projects or model.baumgarte_rate > 0.0:
            raise ValueError("generalized_alpha keeps the joints closed by itself: it goes with "
                             "stabilisation 'none'")
        n = len(model.bodies)
        size = 6 * n + len(model.row_residual)
        self._memory = Memory(
            rate=np.zeros((n, 6)), mean=np.zeros((n, 6)), old=np.zeros((n, 6)),
            body_rate=np.zeros((n, 6)), x=np.zeros(size), start=np.zeros(size),
            residual=np.zeros(size), base=np.zeros(size),
            correction=np.zeros(size), next=np.zeros(size),
            matrix=np.zeros((size, size)), pivots=np.zeros(size, dtype=np.int64),
            factored=np.zeros(1, dtype=bool))
        self._model, self._group = model, GROUPS[group]
        self.work = make_work(model, 1)
        self.restart()

    @staticmethod
    def options(method):
        """{name: (default, what it may be, check)} of the options this method takes."""
        return {"rho_inf": (0.8, "a number from 0 to 1", _is_part)}

    def restart(self):
        """Forget what lasts between calls: the state is a new one."""
        self._started_for = None

    def advance(self, h, steps, pose, twist, external):
        """Take steps of size h in place; returns (steps done, status)."""
        now = (h, external.tobytes(), self.work.acting.tobytes())
        if self._started_for != now:
            dependent = self._start(pose, twist, external)
            if dependent >= 0:
                return 0, DEPENDENT_ROWS + (dependent << 8)
            self._started_for = now
        return advance(self._model, self.work, self._memory, self._numbers, self._group, h, steps,
                       pose, twist, external)

    def _start(self, pose, twist, external):
        """Vdot, a and lambda from the index-1 equations; -1, or the joint whose rows depend."""
        work, memory = self.work, self._memory
        dependent = accelerations(self._model, work, pose, twist, external)
        if dependent < 0:
            memory.rate[:] = work.acceleration
            if self._group != SE3:
                turn = pose[:, :9].reshape(-1, 3, 3)
                linear = work.acceleration[:, 3:] + np.cross(twist[:, :3], twist[:, 3:])
                memory.rate[:, 3:] = np.einsum("nij,nj->ni", turn, linear)
            memory.mean[:] = memory.rate
            multipliers = [work.solution[joint["start"]:joint["start"] + joint["rows"]]
                           for joint in self._model.joints]
            memory.x[:] = np.concatenate([memory.rate.ravel(), *multipliers])
            memory.factored[0] = False
        return dependent


def _is_part(value):
    """True for a number from 0 to 1."""
    return isinstance(value, (int, float)) and 0.0 <= value <= 1.0
