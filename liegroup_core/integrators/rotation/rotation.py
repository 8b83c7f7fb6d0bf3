# SPDX-License-Identifier: Apache-2.0
"""Momentum-preserving methods for bodies that are free or on one spherical joint to ground.

maps.py has the step of R and w of one body for each method, bodies.py the geometry of held bodies.
Forces are evaluated for all bodies together, so that springs may couple bodies. The centre of mass
of a free body is integrated in world axes, P = m R v:
    KICKED       P' = P + (h/2) f ,  r+ = r + (h/m) P' ,  P+ = P' + (h/2) f+        order 2
    ITERATED     P+ = P + h f_m ,  r+ = r + (h/m) (P + P+)/2 ,  f_m at the midpoint  order 2
                 (BOTTASSO_BORRI: the mean of f and f+ instead of f_m)
    RUNGE_KUTTA  the same tableau                                               its order

The coadjoint methods of Runge-Kutta type are Munthe-Kaas methods for the rotation Psi of a step and
the angular momentum Y = R y in world axes:
    Psi' = dexpinv_{-Psi} w ,  Y' = R T ,  R = R_0 exp Psi ,  I w = y = R^T Y
For T = 0 this is (6.34), (6.38), (6.39) and (6.44): y+ = exp(-Psi) y. Components of Y without
torque at all poses, such as that along gravity of a top, are conserved to machine precision too.

At the end of a KICKED step, forces that depend on velocity are evaluated at 2 w' - w, w' the
angular velocity of Q, and at 2 P' - P. This keeps order 2 without a solve over all bodies. With the
implicit w+ instead, errors under a drag were between equal and 2000 times larger (measured).
ITERATED steps evaluate such forces together with the torque, the others in every stage. Orders
under such forces: test/verification/test_rotation_forces.py.

The configuration group is SO(3) x R^3 for every `group` of the simulation.
"""

import math

import numpy as np

from liegroup_core.compiling import SameTypes, borrowed, kernel, stepper
from liegroup_core.forces.gravity import add_wrench as add_gravity
from liegroup_core.forces.kinds import add_wrenches, turns_over
from liegroup_core.integrators.broyden import broyden
from liegroup_core.integrators.methods import METHODS, refuse_stabilisation
from liegroup_core.integrators.motion import copy_state, is_finite
from liegroup_core.lie.so3 import so3_dexpinv
from liegroup_core.lie.vec3 import (
    ZERO3,
    add3,
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
from liegroup_core.status import (
    DIVERGED,
    HOPELESS_ROTATION,
    NO_RATTLE_STEP,
    NOT_CONVERGED,
    NOT_FINITE,
    OK,
)

from .bodies import linear_momentum, load, make_spinners, place
from .maps import (
    AUSTIN,
    BOTTASSO_BORRI,
    FIRST_ITERATED,
    LIE_MIDPOINT,
    LIE_NEWMARK,
    RATTLE,
    RUNGE_KUTTA,
    SIMO_WONG,
    STOERMER_VERLET,
    iterated_end,
    iterated_step,
    kept,
    kicked_end,
    kicked_turn,
    turn,
    velocity,
)
from .stability import stability_limit

RULES = {
    "stoermer_verlet": STOERMER_VERLET,
    "lie_newmark": LIE_NEWMARK,
    "rattle": RATTLE,
    "austin_krishnaprasad_wang": AUSTIN,
    "lie_midpoint": LIE_MIDPOINT,
    "simo_wong": SIMO_WONG,
    "bottasso_borri_candidate": BOTTASSO_BORRI,
} | {
    name: RUNGE_KUTTA
    for name, method in METHODS.items()
    if method.family == "rotation" and method.coefficients
}

# An ITERATED step is repeated until the loads change no displacement by more than this, in rad and
# relative to the largest coordinate or 1 m. If round-off is larger: until the change is below this
# multiple and has not been halved in two iterations.
TOLERANCE, STUCK = 1e-15, 100.0
MOST_REPEATS = 100
# Corrections of the loads that Broyden's method stores before it restarts, and its `most`: above it
# forces nearly amplify a displacement, like a negative damping.
REMEMBERED, MOST_PART = 16, 0.9

# Columns of the memory of a step, per body: three of each, nine of Q. LINEAR, VELOCITY and PLACE
# are the present values of m R v, w and r at the end of the step.
TURN, MOMENTUM, TORQUE, FORCE, LINEAR, VELOCITY, PLACE, Q = 0, 3, 6, 9, 12, 15, 18, 21
COLUMNS = 30


@kernel
def _kicked(rule, spinners, work, memory, h, evaluation, pose, twist):
    """KICKED step after the first or second evaluation of the forces; returns (status, done)."""
    for i in range(len(spinners)):
        spinner = spinners[i]
        inertia, inverse = matrix3(spinner["inertia"]), matrix3(spinner["inverse_inertia"])
        torque, force = load(spinner, work, i)
        if evaluation == 0:
            w = load3(twist, i, 0)
            change, x, momentum, found = kicked_turn(rule, inertia, inverse, h, w, torque)
            squared = dot3(x, x)
            if not squared < math.inf:
                return NOT_FINITE, True
            work.report[1] = max(work.report[1], squared)
            if not found:
                if rule == RATTLE:
                    x = scale3(h, matvec3(inverse, axpy3(0.5 * h, torque, matvec3(inertia, w))))
                    work.report[1] = dot3(x, x)
                    return NO_RATTLE_STEP + (i << 8), True
                return NOT_CONVERGED, True
            linear = axpy3(0.5 * h, force, linear_momentum(spinner, pose, twist, i))
            guess = axpy3(2.0 / h, x, scale3(-1.0, w))
            store3(momentum, memory, i, MOMENTUM)
            store3(guess, memory, i, VELOCITY)
            store3(linear, memory, i, LINEAR)
            rot = kept(matmul3(load9(pose, i, 0), change))
            r = axpy3(h / spinner["mass"], linear, load3(pose, i, 9))
            place(
                spinner,
                i,
                rot,
                guess,
                r,
                axpy3(0.5 * h, force, linear),
                work.stage_pose,
                work.stage_twist,
            )
        else:
            w, found = kicked_end(
                rule,
                inertia,
                inverse,
                h,
                load3(memory, i, VELOCITY),
                load3(memory, i, MOMENTUM),
                torque,
            )
            if not found:
                return NOT_CONVERGED, True
            place(
                spinner,
                i,
                load9(work.stage_pose, i, 0),
                w,
                load3(work.stage_pose, i, 9),
                axpy3(0.5 * h, force, load3(memory, i, LINEAR)),
                work.stage_pose,
                work.stage_twist,
            )
    return OK, evaluation == 1


@kernel
def _moved(one, other):
    """Largest difference of two vectors' components; NaN propagates."""
    largest = 0.0
    for c in range(3):
        apart = abs(one[c] - other[c])
        if not apart <= largest:
            largest = apart
    return largest


@kernel
def _rates(spinner):
    """Scales of the loads: 1/(kg m^2) for torques and 1/kg for forces."""
    inertia = spinner["inertia"]
    return 3.0 / (inertia[0] + inertia[4] + inertia[8]), 1.0 / spinner["mass"]


@kernel
def _expect(spinners, work, loads, corrections, evaluation):
    """Correct the loads for the next iteration from those at the last result.

    loads (6 n,) : rad/s^2 and m/s^2, in place
    """
    k = max(0, evaluation - 1) % REMEMBERED
    for i in range(len(spinners)):
        torque, force = load(spinners[i], work, i)
        by_torque, by_force = _rates(spinners[i])
        for c in range(3):
            if evaluation == 0:
                loads[6 * i + c] = loads[6 * i + 3 + c] = 0.0
            corrections[k, 6 * i + c] = by_torque * torque[c] - loads[6 * i + c]
            corrections[k, 6 * i + 3 + c] = by_force * force[c] - loads[6 * i + 3 + c]
    if evaluation > 0:
        broyden(corrections, k, MOST_PART)
    for r in range(len(loads)):
        loads[r] += corrections[k, r]


@kernel
def _iterated(rule, spinners, work, memory, loads, h, evaluation, pose, twist):
    """ITERATED step with the present loads; sets the bodies to where forces are evaluated next.

    returns (status, largest change of a displacement since the last iteration, in rad and relative
    to the largest coordinate or 1 m)
    """
    largest = 0.0
    for i in range(len(spinners)):
        spinner = spinners[i]
        inertia, inverse = matrix3(spinner["inertia"]), matrix3(spinner["inverse_inertia"])
        by_torque, by_force = _rates(spinner)
        torque = (
            loads[6 * i] / by_torque,
            loads[6 * i + 1] / by_torque,
            loads[6 * i + 2] / by_torque,
        )
        force = (
            loads[6 * i + 3] / by_force,
            loads[6 * i + 4] / by_force,
            loads[6 * i + 5] / by_force,
        )
        w = load3(twist, i, 0)
        before = load3(memory, i, TURN)
        if evaluation == 0:
            store3(torque, memory, i, TORQUE)
            store3(force, memory, i, FORCE)
            before = scale3(0.5 * h if rule == LIE_MIDPOINT else h, w)
        first = load3(memory, i, TORQUE)
        u, found = iterated_step(rule, inertia, inverse, h, before, w, first, torque)
        if not found:
            return NOT_CONVERGED, 0.0
        whole, at, w_at, w_end = iterated_end(rule, inertia, inverse, h, u, w, first, torque)
        store3(u, memory, i, TURN)
        store3(w_end, memory, i, VELOCITY)
        store9(turn(whole), memory, i, Q)
        # A solution with a smaller rotation than the body's is not better.
        work.report[1] = max(work.report[1], dot3(whole, whole), h * h * dot3(w, w))

        r, linear = load3(pose, i, 9), linear_momentum(spinner, pose, twist, i)
        if rule == BOTTASSO_BORRI:
            force = scale3(0.5, add3(load3(memory, i, FORCE), force))
        halfway, end = axpy3(0.5 * h, force, linear), axpy3(h, force, linear)
        r_end = axpy3(h / spinner["mass"], halfway, r)
        store3(end, memory, i, LINEAR)
        store3(r_end, memory, i, PLACE)
        # Where the forces act: halfway, or at the end.
        there, moving = axpy3(0.5 * h / spinner["mass"], halfway, r), halfway
        if rule == BOTTASSO_BORRI:
            there, moving = r_end, end
        length = 1.0
        for c in range(3):
            length = max(length, abs(there[c]))
        apart = max(
            _moved(u, before),
            _moved(there, load3(work.stage_pose, i, 9)) / length if spinner["held"] == 0 else 0.0,
        )
        if evaluation == 0:
            apart = math.inf
        if not apart <= largest:
            largest = apart
        place(
            spinner,
            i,
            matmul3(load9(pose, i, 0), turn(at)),
            w_at,
            there,
            moving,
            work.stage_pose,
            work.stage_twist,
        )
    return OK, largest


@kernel
def _iterated_finish(spinners, work, memory, pose):
    """Place the bodies at the end of an ITERATED step."""
    for i in range(len(spinners)):
        rot = kept(matmul3(load9(pose, i, 0), load9(memory, i, Q)))
        place(
            spinners[i],
            i,
            rot,
            load3(memory, i, VELOCITY),
            load3(memory, i, PLACE),
            load3(memory, i, LINEAR),
            work.stage_pose,
            work.stage_twist,
        )


@kernel
def _weighted(slopes, weights, row, stages, n, i):
    """sum_l weights[row, l] of the given number of slopes of body i: four vectors."""
    turned, moved, torques, forces = ZERO3, ZERO3, ZERO3, ZERO3
    for stage in range(stages):
        weight = weights[row, stage]
        if weight != 0.0:
            k = stage * n + i
            turned = axpy3(weight, load3(slopes, k, 0), turned)
            moved = axpy3(weight, load3(slopes, k, 3), moved)
            torques = axpy3(weight, load3(slopes, k, 6), torques)
            forces = axpy3(weight, load3(slopes, k, 9), forces)
    return turned, moved, torques, forces


@kernel
def _staged(spinners, work, memory, weights, h, stage, pose, twist):
    """Go from an evaluated stage of a coadjoint method to the next stage, or to the end.

    weights : (s + 1, s) the tableau's a, below it its b
    """
    n, stages = len(spinners), weights.shape[1]
    end = stage + 1 == stages
    for i in range(n):
        spinner = spinners[i]
        torque, force = load(spinner, work, i)
        row = stage * n + i
        w = load3(work.stage_twist, i, 0)
        if stage > 0:
            w = so3_dexpinv(scale3(-1.0, load3(memory, i, TURN)), w)
        rot = load9(work.stage_pose, i, 0)
        store3(w, work.slopes, row, 0)
        store3(matvec3(rot, load3(work.stage_twist, i, 3)), work.slopes, row, 3)
        store3(matvec3(rot, torque), work.slopes, row, 6)
        store3(force, work.slopes, row, 9)

        turned, moved, torques, forces = _weighted(work.slopes, weights, stage + 1, stage + 1, n, i)
        psi = scale3(h, turned)
        squared = dot3(psi, psi)
        if not squared < math.inf:
            return NOT_FINITE, True
        work.report[1] = max(work.report[1], squared)
        store3(psi, memory, i, TURN)
        start = load9(pose, i, 0)
        inertia = matrix3(spinner["inertia"])
        y = add3(matvec3(inertia, load3(twist, i, 0)), tmatvec3(start, scale3(h, torques)))
        change = turn(psi)
        y = tmatvec3(change, y)
        r = axpy3(h, moved, load3(pose, i, 9))
        linear = axpy3(h, forces, linear_momentum(spinner, pose, twist, i))
        rot = matmul3(start, change)
        if end:
            rot = kept(rot)
        place(
            spinner,
            i,
            rot,
            velocity(inertia, matrix3(spinner["inverse_inertia"]), y),
            r,
            linear,
            work.stage_pose,
            work.stage_twist,
        )
    return OK, end


@stepper
def advance(
    model,
    work,
    spinners,
    memory,
    loads,
    corrections,
    rule,
    weights,
    h,
    steps,
    pose,
    twist,
    external,
):
    """Take `steps` steps of size h in place of pose (n, 12) and twist (n, 6).

    external (n, 6) : applied wrenches in body axes, constant over these steps
    returns (steps done, status): fewer steps if status is not OK; pose and twist are then those of
    the last valid step. The body's index is above the low byte of NO_RATTLE_STEP.

    All methods share one loop with one evaluation of the forces, because these are inlined, and so
    compiled, at every call.
    """
    spinners = borrowed(spinners)
    memory, weights = borrowed(memory), borrowed(weights)
    loads, corrections = borrowed(loads), borrowed(corrections)
    pose, twist, external = borrowed(pose), borrowed(twist), borrowed(external)
    for done in range(steps):
        copy_state(pose, twist, work.stage_pose, work.stage_twist)
        work.report[1] = 0.0
        status, ended = OK, False
        evaluation, previous, earlier = 0, math.inf, math.inf
        while not ended:
            for i in range(len(spinners)):
                for c in range(6):
                    work.wrench[i, c] = external[i, c]
            add_gravity(model, work.stage_pose, work.wrench)
            add_wrenches(
                model.forces,
                work.angle,
                work.acting,
                work.stage_pose,
                work.stage_twist,
                work.wrench,
            )
            if rule == RUNGE_KUTTA:
                status, ended = _staged(spinners, work, memory, weights, h, evaluation, pose, twist)
            elif rule < FIRST_ITERATED:
                status, ended = _kicked(rule, spinners, work, memory, h, evaluation, pose, twist)
            else:
                _expect(spinners, work, loads, corrections, evaluation)
                status, apart = _iterated(
                    rule, spinners, work, memory, loads, h, evaluation, pose, twist
                )
                ended = (
                    status != OK
                    or apart <= TOLERANCE
                    or (0.5 * max(previous, earlier) < apart <= STUCK * TOLERANCE)
                )
                previous, earlier = apart, previous
                if ended and status == OK:
                    _iterated_finish(spinners, work, memory, pose)
                elif evaluation == MOST_REPEATS:
                    status, ended = NOT_CONVERGED, True
            evaluation += 1
        if status == OK and not is_finite(work.stage_pose, work.stage_twist):
            status = NOT_FINITE
        if status == OK and work.report[1] > HOPELESS_ROTATION * HOPELESS_ROTATION:
            status = DIVERGED
        if status != OK:
            return done, status
        copy_state(work.stage_pose, work.stage_twist, pose, twist)
        work.report[0] = max(work.report[0], work.report[1])
        if work.report[3] == WAIT and turns_over(model.forces, h, pose, twist):
            work.report[3] = MET
            return done + 1, OK
    return steps, OK


class Rotation:
    """Rotation method for a model; it has no memory between steps."""

    kernels = "rotation"
    substeps = (0, 0)

    def __init__(self, method, layout, group, step, options):
        model = layout.model
        refuse_stabilisation(method, model)
        self._model, self._name, self._rule = model, method.name, RULES[method.name]
        self._looked = False  # for steps that are too large at the start
        self.doubt = None  # what that look has found, one line
        self._spinners = make_spinners(model)
        tableau = method.tableau if method.coefficients else None
        self._weights = np.zeros((1, 0)) if tableau is None else np.vstack([tableau.a, tableau.b])
        self._memory = np.zeros((len(model.bodies), COLUMNS))
        self._loads = np.zeros(6 * len(model.bodies))
        self._corrections = np.zeros((REMEMBERED, 6 * len(model.bodies)))
        self.work = make_work(model, self._weights.shape[1])
        self._advance = SameTypes(advance)

    @staticmethod
    def options(method):
        """Options of the method: none."""
        return {}

    def restart(self):
        """Do nothing: there is no memory between calls."""

    @property
    def memory(self):
        """Arrays of the memory between calls: none."""
        return ()

    def advance(self, h, steps, pose, twist, external):
        """Take steps of size h in place; returns (steps done, status)."""
        if steps > 0 and not self._looked:
            self._looked = True
            self._look(h, pose, twist, external)
        return self._take(h, steps, pose, twist, external)

    def _take(self, h, steps, pose, twist, external):
        return self._advance(
            self._model,
            self.work,
            self._spinners,
            self._memory,
            self._loads,
            self._corrections,
            self._rule,
            self._weights,
            h,
            steps,
            pose,
            twist,
            external,
        )

    def _look(self, h, pose, twist, external):
        """Warn of a step size beyond the stability limit at a state."""

        def step(size, steps, pose, twist):
            _, status = self._take(size, steps, pose, twist, external)
            return (pose, twist) if status == OK else None

        report = self.work.report.copy()
        self.work.report[3] = 0.0
        limit = stability_limit(step, self._spinners, h, pose, twist)
        self.work.report[:] = report
        if limit is not None:
            self.doubt = (
                f"{self._name}, step {h:g} s: unstable, an oscillation or a damper is too fast "
                f"for this step. The stability limit at the start of the run is {limit:.2g} s; "
                "use a smaller step"
            )
