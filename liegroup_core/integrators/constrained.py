# SPDX-License-Identifier: Apache-2.0
"""RATTLE for mechanisms, and its symmetric compositions of higher order."""
import math
from typing import NamedTuple

import numpy as np

from .._compile import borrowed, kernel, subroutine
from ..dynamics.constraints import assemble, position_residuals
from ..dynamics.projection import is_closed
from ..dynamics.saddle_point import SPATIAL_SIZES, solve
from ..forces.gravity import add_wrench as add_gravity
from ..forces.kinds import add_wrenches, count_turns, too_fast
from ..lie.so3 import so3_exp
from ..lie.vec3 import (ZERO3, add3, axpy3, dot3, load3, load9, matmul3, matrix3, matvec3, scale3,
                        store3, store9, tmatvec3)
from ..model.arrays import make_work
from .motion import copy_state, is_finite, orthonormal
from .rotation_maps import velocity
from .rotation_newton import EXPONENTIAL, INCREMENT, newton
from .status import (DEPENDENT_ROWS, LARGEST_ROTATION, NOT_CONVERGED, NOT_FINITE, OK,
                     ROTATION_TOO_LARGE, TURNS_NOT_COUNTED)


def _mirrored(*half):
    return np.array([*half[:-1], *half[::-1]])


_SUZUKI = 1.0 / (4.0 - 4.0 ** (1.0 / 3.0))
SUBSTEPS = {
    "constrained_rattle": np.ones(1),
    "constrained_rattle4": _mirrored(_SUZUKI, _SUZUKI, 1.0 - 4.0 * _SUZUKI),
    "constrained_rattle6": _mirrored(
        0.39216144400731413927925056, 0.33259913678935943859974864, -0.70624617255763935980996482,
        0.08221359629355080023149045, 0.79854399093482996339895035),
    "constrained_rattle8": _mirrored(
        0.13020248308889008087881763, 0.56116298177510838456196441, -0.38947496264484728640807860,
        0.15884190655515560089621075, -0.39590389413323757733623154, 0.18453964097831570709183254,
        0.25837438768632204729397911, 0.29501172360931029887096624, -0.60550853383003451169892108),
}

MOST_ITERATIONS, MOST_REPEATS = 60, 100
TOLERANCE, STUCK = 1e-15, 100.0


class Memory(NamedTuple):
    """What the method holds beside pose, twist and Work."""

    half: np.ndarray        # (n, 6) velocity halfway, components in the axes of the start
    turn: np.ndarray        # (n, 3) rad, rotation vector of a body's turn in this substep
    load: np.ndarray        # (n, 6) wrenches at the start of a substep, then at its end
    impulse: np.ndarray     # (n, 6) right-hand side of the bodies
    target: np.ndarray      # (rows,) right-hand side of the rows
    wanted: np.ndarray      # (rows,) (2/h) J V halfway
    counts: np.ndarray


@subroutine
def _loads(model, work, pose, twist, external):
    """Sum of all wrenches but the gyroscopic terms into work.wrench (n, 6)."""
    model, work, pose = borrowed(model), borrowed(work), borrowed(pose)
    twist, external = borrowed(twist), borrowed(external)
    for i in range(len(model.bodies)):
        for c in range(6):
            work.wrench[i, c] = external[i, c]
    add_gravity(model, pose, work.wrench)
    add_wrenches(model.forces, work.angle, work.acting, pose, twist, work.wrench)


@subroutine
def _respond(model, work, memory, fresh, pose, twist, out):
    model, work, memory = borrowed(model), borrowed(work), borrowed(memory)
    pose, twist, out = borrowed(pose), borrowed(twist), borrowed(out)
    if fresh:
        assemble(model, work, pose, twist)
    for i in range(len(model.bodies)):
        at = model.bodies[i]["start"]
        for c in range(6):
            work.solution[at + c] = memory.impulse[i, c]
    for j in range(len(model.joints)):
        start, first = model.joints[j]["start"], model.joints[j]["first"]
        for r in range(model.joints[j]["rows"]):
            work.solution[start + r] = memory.target[first + r]
            if fresh:
                work.solution[start + r] -= work.slip[first + r]
    dependent = solve(model, work, model.refinements, 0.0, SPATIAL_SIZES, fresh)
    if dependent >= 0:
        return DEPENDENT_ROWS + (model.joints[dependent]["element"] << 8)
    for i in range(len(model.bodies)):
        at = model.bodies[i]["start"]
        for c in range(6):
            out[i, c] += work.solution[at + c]
    return OK


@kernel
def _place(model, work, memory, kind, h):
    """Poses at the end of a substep with the velocities halfway as they are. Returns a status."""
    for i in range(len(model.bodies)):
        inertia = matrix3(model.bodies[i]["inertia"])
        momentum = matvec3(inertia, load3(memory.half, i, 0))
        if kind == INCREMENT:
            x, found = newton(kind, inertia, h, scale3(0.5, load3(memory.turn, i, 0)), ZERO3, momentum, ZERO3,
                              ZERO3)
            x = scale3(2.0, x)
        else:
            x, found = newton(kind, inertia, h, load3(memory.turn, i, 0), ZERO3, ZERO3, ZERO3,
                              scale3(h, momentum))
        squared = dot3(x, x)
        if not squared < math.inf:
            return NOT_FINITE
        if not found:
            return NOT_CONVERGED
        if squared > LARGEST_ROTATION * LARGEST_ROTATION:
            return ROTATION_TOO_LARGE
        store3(x, memory.turn, i, 0)
        rot = load9(work.start_pose, i, 0)
        store9(orthonormal(matmul3(rot, so3_exp(x))), work.stage_pose, i, 0)
        store3(axpy3(h, matvec3(rot, load3(memory.half, i, 3)), load3(work.start_pose, i, 9)),
               work.stage_pose, i, 9)
    return OK


@kernel
def _substep(model, work, memory, kind, h, fresh, external):
    n, rows = len(model.bodies), len(model.row_residual)
    for i in range(n):
        for c in range(6):
            memory.half[i, c] = work.start_twist[i, c]
            memory.impulse[i, c] = 0.5 * h * memory.load[i, c]
        for c in range(3):
            memory.turn[i, c] = h * work.start_twist[i, c]
    for r in range(rows):
        memory.target[r] = 0.5 * h * memory.wanted[r]
    status = _respond(model, work, memory, fresh, work.start_pose, work.start_twist, memory.half)
    if status != OK:
        return status
    for i in range(n):
        for c in range(6):
            memory.impulse[i, c] = 0.0
    closed = rows == 0
    for iteration in range(MOST_ITERATIONS):
        memory.counts[0] += 1
        status = _place(model, work, memory, kind, h)
        if status != OK:
            return status
        if closed:
            break
        if iteration == MOST_ITERATIONS - 1:
            return NOT_CONVERGED
        position_residuals(model, work.stage_pose, work.gap)
        closed = is_closed(model, work, work.stage_pose)
        for r in range(rows):
            memory.target[r] = -work.gap[model.row_residual[r]] / h
            memory.wanted[r] += 2.0 / h * memory.target[r]
        status = _respond(model, work, memory, False, work.stage_pose, work.start_twist,
                          memory.half)
    # velocity
    for i in range(n):
        change = so3_exp(load3(memory.turn, i, 0))
        inertia, inverse = matrix3(model.bodies[i]["inertia"]), matrix3(model.bodies[i]["inverse_inertia"])
        y = tmatvec3(change, matvec3(inertia, load3(memory.half, i, 0)))
        w = axpy3(2.0 / h, load3(memory.turn, i, 0), scale3(-1.0, load3(work.start_twist, i, 0)))
        v = axpy3(2.0, load3(memory.half, i, 3), scale3(-1.0, load3(work.start_twist, i, 3)))
        store3(w, work.stage_twist, i, 0)
        store3(tmatvec3(change, v), work.stage_twist, i, 3)
        store3(velocity(inertia, inverse, y), memory.half, i, 0)
        store3(tmatvec3(change, load3(memory.half, i, 3)), memory.half, i, 3)
    _loads(model, work, work.stage_pose, work.stage_twist, external)
    for i in range(n):
        for c in range(6):
            memory.load[i, c] = work.wrench[i, c]
            memory.impulse[i, c] = 0.5 * h * work.wrench[i, c]
            work.stage_twist[i, c] = memory.half[i, c]
    for r in range(rows):
        memory.target[r] = 0.0
    status = _respond(model, work, memory, True, work.stage_pose, memory.half, work.stage_twist)
    if status != OK:
        return status
    previous = math.inf
    for repeat in range(MOST_REPEATS):
        _loads(model, work, work.stage_pose, work.stage_twist, external)
        speed = apart = 0.0
        for i in range(n):
            inverse, inverse_mass = matrix3(model.bodies[i]["inverse_inertia"]), model.bodies[i]["inverse_mass"]
            for c in range(6):
                memory.impulse[i, c] = 0.5 * h * (work.wrench[i, c] - memory.load[i, c])
                memory.load[i, c] = work.wrench[i, c]
            dw = matvec3(inverse, load3(memory.impulse, i, 0))
            dv = scale3(inverse_mass, load3(memory.impulse, i, 3))
            for c in range(3):
                if not abs(dw[c]) <= apart:
                    apart = abs(dw[c])
                if not abs(dv[c]) <= apart:
                    apart = abs(dv[c])
                speed = max(speed, abs(work.stage_twist[i, c]), abs(work.stage_twist[i, 3 + c]))
        if apart <= TOLERANCE * speed or 0.5 * previous < apart <= STUCK * TOLERANCE * speed:
            return OK
        previous = apart
        status = _respond(model, work, memory, False, work.stage_pose, memory.half,
                          work.stage_twist)
    return NOT_CONVERGED


@kernel
def advance(model, work, memory, kind, parts, h, steps, pose, twist, external):
    model, work, memory, parts = borrowed(model), borrowed(work), borrowed(memory), borrowed(parts)
    pose, twist, external = borrowed(pose), borrowed(twist), borrowed(external)
    if steps == 0:
        return 0, OK
    fresh = True
    _loads(model, work, pose, twist, external)
    for i in range(len(model.bodies)):
        for c in range(6):
            memory.load[i, c] = work.wrench[i, c]
    for done in range(steps):
        copy_state(pose, twist, work.start_pose, work.start_twist)
        work.report[1] = 0.0
        for part in range(len(parts)):
            status = _substep(model, work, memory, kind, parts[part] * h, fresh, external)
            fresh = False
            if status != OK:
                return done, status
            copy_state(work.stage_pose, work.stage_twist, work.start_pose, work.start_twist)
            for i in range(len(model.bodies)):
                x = load3(memory.turn, i, 0)
                work.report[1] = max(work.report[1], dot3(x, x))
        if not is_finite(work.stage_pose, work.stage_twist):
            return done, NOT_FINITE
        fast = too_fast(model.forces, h, work.stage_pose, work.stage_twist)
        if fast >= 0:
            return done, TURNS_NOT_COUNTED + (fast << 8)
        count_turns(model.forces, work.stage_pose, work.angle)
        copy_state(work.stage_pose, work.stage_twist, pose, twist)
        work.report[0] = max(work.report[0], work.report[1])
    return steps, OK


class Constrained:
    substeps = (0, 0)

    def __init__(self, method, layout, group, step, options):
        model = layout.model
        if model.projects or model.baumgarte_rate > 0.0:
            raise ValueError(f"{method.name} closes the joints by itself: "
                             "stabilisation must be 'none'")
        self._model, self._parts = model, SUBSTEPS[method.name]
        n, rows = len(model.bodies), len(model.row_residual)
        self._memory = Memory(np.zeros((n, 6)), np.zeros((n, 3)), np.zeros((n, 6)),
                              np.zeros((n, 6)), np.zeros(rows), np.zeros(rows), np.zeros(3))
        self.work = make_work(model, 1)
        self.kind = EXPONENTIAL

    @staticmethod
    def options(method):
        return {}

    def restart(self):
        self._memory.wanted[:] = 0.0

    def advance(self, h, steps, pose, twist, external):
        return advance(self._model, self.work, self._memory, self.kind, self._parts, h, steps,
                       pose, twist, external)
