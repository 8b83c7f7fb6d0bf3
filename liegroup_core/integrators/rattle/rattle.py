# SPDX-License-Identifier: Apache-2.0
"""RATTLE for mechanisms: variational, symmetric, its joints closed in every step.

Unknowns halfway are the velocities V' = (w', v'), components in the axes of the start. One step,
Q the wrenches of applied_wrench, gravity and forces, M = diag(I, m), from (R, r, V) to the next:
    M V' = M V + (h/2) (Q - J^T lambda)                     lambda so that all joints are closed
    R+ = R exp x ,  h I w' = dexpinv_{-x} I x ,  r+ = r + h R v'                    at R+, r+
    M V+ = M V'+ + (h/2) (Q+ - J+^T mu)                     mu so that J+ V+ = 0
with V'+ what M V' is in the axes of the end: I w'+ = exp(-x) I w', v'+ = exp(-x) v'. The step is
that of the discrete Lagrangian with the kinetic energy of the constant velocity (x/h, (r+ - r)/h)
and the potential energy halved between both ends; J^T lambda acts at the start and J+^T mu at the
end, as in RATTLE. So, shown by test/verification/test_constrained_geometric.py,
  * it is of order 2 and symmetric: a step h and a step -h lead back, to rounding, with forces of
    velocity too, for V+ in Q+ is solved for;
  * it is symplectic where all forces have a potential: energy stays within O(h^2) of its start
    and does not drift. Other symmetric turns are compared in docs/explanation/long_runs.md;
  * joints are closed and J V = 0 to rounding; momentum that joints and forces leave is kept to
    rounding.
Steps g_1 h, ..., g_k h one after the other with symmetric g, sum g = 1, are one step of higher
order of the same properties, see SUBSTEPS. docs/explanation/long_runs.md compares them with rkmk4 and rkmk8.

Lambda is found by Broyden's method in J V', which starts with the saddle-point matrix of the start
of the step: it is eliminated once a step, all else are substitutions. Poses move on SO(3) x R^3
whichever group the simulation names.

Source: Andersen, J. Comput. Phys. 52 (1983) 24-34; Marsden and West, Acta Numerica 2001, 3.5.2;
Bou-Rabee and Marsden, Found. Comput. Math. 9 (2009) 197-219 for the turn.
"""

import math

import numpy as np

from liegroup_core.compiling import SameTypes, Struct, borrowed, kernel, stepper
from liegroup_core.forces.kinds import count_turns, too_fast, turns_over
from liegroup_core.formulations.absolute.constraints import position_residuals
from liegroup_core.formulations.absolute.projection import is_closed
from liegroup_core.integrators.broyden import broyden
from liegroup_core.integrators.methods import refuse_stabilisation
from liegroup_core.integrators.motion import copy_state, is_finite, orthonormal, turn_status
from liegroup_core.integrators.rotation.maps import turn, velocity
from liegroup_core.integrators.rotation.newton import EXPONENTIAL, newton
from liegroup_core.lie.vec3 import (
    ZERO3,
    axpy3,
    dot3,
    load3,
    load9,
    matmul3,
    matrix3,
    matvec3,
    scale3,
    store3,
    store9,
    tmatvec3,
)
from liegroup_core.model.arrays import MET, WAIT, make_work
from liegroup_core.status import NOT_CONVERGED, NOT_FINITE, OK, TURNS_NOT_COUNTED

from .solve import loads, respond


def _mirrored(*half):
    """Symmetric substeps from the first half of them and the middle one."""
    return np.array([*half[:-1], *half[::-1]])


_SUZUKI = 1.0 / (4.0 - 4.0 ** (1.0 / 3.0))
# Parts g of a step. Order 4: Suzuki, Phys. Lett. A 146 (1990); order 8: Kahan and Li, Math. Comp.
# 66 (1997), as in Hairer, Lubich and Wanner, Geometric Numerical Integration, (V.3.13).
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

MOST_ITERATIONS = 50
# Corrections that Broyden's method remembers before it begins anew.
REMEMBERED = 8
# Forces of velocity are repeated until they change no velocity by more than this part of the
# largest; where rounding is larger, until changes of so many times that no longer come down.
TOLERANCE, STUCK = 1e-15, 100.0
MOST_REPEATS = 100


class Memory(Struct):
    """What the method holds beside pose, twist and Work; the last three make first guesses."""

    half: np.ndarray  # (n, 6) V', then V'+
    turn: np.ndarray  # (n, 3) rad, x
    load: np.ndarray  # (n, 6) Q at the start of a substep, then at its end
    impulse: np.ndarray  # (n, 6) right-hand side of the bodies, N m s and N s
    target: np.ndarray  # (rows,) right-hand side of the rows: change of J V wanted
    corrections: np.ndarray  # (REMEMBERED, rows) of J V' in this substep
    bias: np.ndarray  # (rows,) (2/h) J V' of the last substep
    growth: np.ndarray  # (rows,) its rate
    size: np.ndarray  # (1,) s, the last substep; 0: there is none


@kernel
def _place(model, work, memory, h):
    """Poses at the end of a substep for V' as it is now: work.stage_pose. Returns a status."""
    for i in range(len(model.bodies)):
        inertia = matrix3(model.bodies[i]["inertia"])
        momentum = matvec3(inertia, load3(memory.half, i, 0))
        x, found = newton(
            EXPONENTIAL,
            inertia,
            h,
            load3(memory.turn, i, 0),
            ZERO3,
            ZERO3,
            ZERO3,
            scale3(h, momentum),
        )
        status = turn_status(dot3(x, x))
        if status != OK:
            return status
        if not found:
            return NOT_CONVERGED
        store3(x, memory.turn, i, 0)
        rot = load9(work.start_pose, i, 0)
        store9(orthonormal(matmul3(rot, turn(x))), work.stage_pose, i, 0)
        store3(
            axpy3(h, matvec3(rot, load3(memory.half, i, 3)), load3(work.start_pose, i, 9)),
            work.stage_pose,
            i,
            9,
        )
    return OK


@kernel
def _guess(memory, h):
    """J V' as the last substeps let expect, into memory.target. Returns s since the last one.

    (2/h) J V' is the joints' acceleration h/3 after the start of a substep, up to O(h^2).
    """
    since = (2.0 * memory.size[0] + h) / 3.0
    for r in range(len(memory.bias)):
        memory.target[r] = 0.5 * h * (memory.bias[r] + since * memory.growth[r])
    return since


@kernel
def _remember(memory, h, since):
    """What `_guess` wants to know of a finished substep, whose J V' is in memory.target."""
    # Substeps that go back may meet at nearly the same time: too near for a difference.
    differ = memory.size[0] != 0.0 and abs(since) > 0.2 * abs(h)
    for r in range(len(memory.bias)):
        now = 2.0 / h * memory.target[r]
        if differ:
            memory.growth[r] = (now - memory.bias[r]) / since
        memory.bias[r] = now
    memory.size[0] = h


@kernel
def _correct(model, work, memory, h, k):
    """Correction number k of J V' for the residuals in work.gap, into memory.corrections.

    Its square is d gap / d (J V') = h + O(h^2): Broyden's method with h to start from.
    """
    step, rows = memory.corrections, len(model.row_residual)
    for r in range(rows):
        step[k, r] = -work.gap[model.row_residual[r]] / h
    broyden(step, k, 0.5)


@kernel
def _first_half(model, work, memory, h, fresh):
    """V' and the pose at the end, with all joints closed. Returns a status.

    fresh : the saddle-point matrix of the start is not there yet
    """
    n, rows = len(model.bodies), len(model.row_residual)
    since = _guess(memory, h)
    for i in range(n):
        for c in range(6):
            memory.impulse[i, c] = 0.5 * h * memory.load[i, c]
        for c in range(3):
            memory.turn[i, c] = h * work.start_twist[i, c]
    copy_state(work.start_pose, work.start_twist, work.stage_pose, memory.half)
    status = respond(
        model,
        work,
        memory.impulse,
        memory.target,
        fresh,
        0.0,
        work.start_pose,
        work.start_twist,
        memory.half,
    )
    for i in range(n):
        for c in range(6):
            memory.impulse[i, c] = 0.0
    closed = rows == 0
    for iteration in range(MOST_ITERATIONS):
        if status == OK:
            status = _place(model, work, memory, h)
        if status != OK:
            return status
        if closed:
            _remember(memory, h, since)
            return OK
        position_residuals(model, work.stage_pose, work.gap)
        # Closed to some roundings: one correction more leaves rounding that has no preferred sign.
        closed = is_closed(model, work, work.stage_pose)
        k = iteration % REMEMBERED
        _correct(model, work, memory, h, k)
        for r in range(rows):
            memory.target[r] += memory.corrections[k, r]
        status = respond(
            model,
            work,
            memory.impulse,
            memory.corrections[k],
            False,
            0.0,
            work.stage_pose,
            memory.half,
            memory.half,
        )
    return NOT_CONVERGED


@kernel
def _carry(model, work, memory, h):
    """V'+ into memory.half; work.stage_twist becomes a first guess of V+, 2 V'+ - V."""
    for i in range(len(model.bodies)):
        inertia = matrix3(model.bodies[i]["inertia"])
        inverse = matrix3(model.bodies[i]["inverse_inertia"])
        x = load3(memory.turn, i, 0)
        change = turn(x)
        w, v = load3(work.start_twist, i, 0), load3(work.start_twist, i, 3)
        store3(axpy3(2.0 / h, x, scale3(-1.0, w)), work.stage_twist, i, 0)
        half = load3(memory.half, i, 3)
        store3(tmatvec3(change, axpy3(2.0, half, scale3(-1.0, v))), work.stage_twist, i, 3)
        y = tmatvec3(change, matvec3(inertia, load3(memory.half, i, 0)))
        store3(velocity(inertia, inverse, y), memory.half, i, 0)
        store3(tmatvec3(change, half), memory.half, i, 3)


@kernel
def _new_impulse(model, work, memory, h):
    """Impulse of what Q+ has changed by, work.wrench, against memory.load, which follows.

    returns (largest component of the velocity that it gives a body, and that of work.stage_twist)
    """
    apart = speed = 0.0
    for i in range(len(model.bodies)):
        for c in range(6):
            memory.impulse[i, c] = 0.5 * h * (work.wrench[i, c] - memory.load[i, c])
            memory.load[i, c] = work.wrench[i, c]
            speed = max(speed, abs(work.stage_twist[i, c]))
        dw = matvec3(matrix3(model.bodies[i]["inverse_inertia"]), load3(memory.impulse, i, 0))
        dv = scale3(model.bodies[i]["inverse_mass"], load3(memory.impulse, i, 3))
        for c in range(3):
            # NaN becomes the largest, and stays it.
            if not abs(dw[c]) <= apart:
                apart = abs(dw[c])
            if not abs(dv[c]) <= apart:
                apart = abs(dv[c])
    return apart, speed


@kernel
def _second_half(model, work, memory, h, external):
    """V+ into work.stage_twist, Q+ into memory.load. Returns a status."""
    _carry(model, work, memory, h)
    for i in range(len(model.bodies)):
        for c in range(6):
            memory.load[i, c] = 0.0
    for r in range(len(memory.target)):
        memory.target[r] = 0.0
    previous = math.inf
    for repeat in range(MOST_REPEATS):
        loads(model, work, work.stage_pose, work.stage_twist, external)
        apart, speed = _new_impulse(model, work, memory, h)
        if repeat == 0:
            copy_state(work.stage_pose, memory.half, work.stage_pose, work.stage_twist)
        elif apart <= TOLERANCE * speed or (0.5 * previous < apart <= STUCK * TOLERANCE * speed):
            return OK
        else:
            previous = apart
        # The first brings J V+ to zero, the others change it no more.
        status = respond(
            model,
            work,
            memory.impulse,
            memory.target,
            repeat == 0,
            1.0 if repeat == 0 else 0.0,
            work.stage_pose,
            memory.half,
            work.stage_twist,
        )
        if status != OK:
            return status
    return NOT_CONVERGED


@stepper
def advance(model, work, memory, parts, h, steps, pose, twist, external):
    """Take `steps` steps of size h in place of pose (n, 12) and twist (n, 6).

    parts           : of SUBSTEPS
    external (n, 6) : applied wrenches in body axes, constant over these steps
    returns (steps done, status), as rkmk.advance does; when status is not OK, the guesses in
    memory are of no use
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
            status = _first_half(model, work, memory, size, done + part == 0)
            if status == OK:
                status = _second_half(model, work, memory, size, external)
            if status != OK:
                return done, status
            for i in range(len(model.bodies)):
                x = load3(memory.turn, i, 0)
                work.report[1] = max(work.report[1], dot3(x, x))
            copy_state(work.stage_pose, work.stage_twist, work.start_pose, work.start_twist)
        if not is_finite(work.stage_pose, work.stage_twist):
            return done, NOT_FINITE
        fast = too_fast(model.forces, h, work.stage_pose, work.stage_twist)
        if fast >= 0:
            return done, TURNS_NOT_COUNTED + (fast << 8)
        count_turns(model.forces, work.stage_pose, work.angle)
        copy_state(work.stage_pose, work.stage_twist, pose, twist)
        work.report[0] = max(work.report[0], work.report[1])
        if work.report[3] == WAIT and turns_over(model.forces, h, pose, twist):
            work.report[3] = MET
            return done + 1, OK
    return steps, OK


class Constrained:
    """A method of the family on a model: its memory, and guesses that last between calls."""

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
            corrections=np.zeros((REMEMBERED, rows)),
            bias=np.zeros(rows),
            growth=np.zeros(rows),
            size=np.zeros(1),
        )
        self.work = make_work(model, 1)
        self._advance = SameTypes(advance)

    @staticmethod
    def options(method):
        """{name: (default, what it may be, check)}: there are none."""
        return {}

    def restart(self):
        """Forget the guesses: the state is a new one."""
        for guess in self.memory:
            guess[:] = 0.0

    @property
    def memory(self):
        """The arrays that last between calls."""
        return self._memory.bias, self._memory.growth, self._memory.size

    def advance(self, h, steps, pose, twist, external):
        """Take steps of size h in place; returns (steps done, status)."""
        done, status = self._advance(
            self._model, self.work, self._memory, self._parts, h, steps, pose, twist, external
        )
        if status != OK:
            self.restart()
        return done, status
