# SPDX-License-Identifier: Apache-2.0
"""Momentum-preserving methods for bodies that are free or on one spherical joint to ground.

maps.py has the step of R and w of one body for each method, bodies.py the geometry of held bodies;
kicked.py, iterated.py and staged.py have the parts of a step of all bodies between two evaluations
of the forces. Forces are evaluated for all bodies together, so that springs may couple bodies. The
centre of mass of a free body is integrated in world axes, P = m R v:
    KICKED       P' = P + (h/2) f ,  r+ = r + (h/m) P' ,  P+ = P' + (h/2) f+        order 2
    ITERATED     P+ = P + h f_m ,  r+ = r + (h/m) (P + P+)/2 ,  f_m at the midpoint  order 2
                 (BOTTASSO_BORRI: the mean of f and f+ instead of f_m)
    RUNGE_KUTTA  with the tableau of the rotation                      order of the tableau

The coadjoint methods of Runge-Kutta type are Munthe-Kaas methods for the rotation Psi of a step and
the angular momentum Y = R y in world axes:
    Psi' = dexpinv_{-Psi} w ,  Y' = R T ,  R = R_0 exp Psi ,  I w = y = R^T Y
For T = 0 this is (6.34), (6.38), (6.39) and (6.44): y+ = exp(-Psi) y. Components of Y on which no
torque acts at any pose, as along gravity for a top, are conserved to machine precision too.

At the end of a KICKED step, velocity-dependent forces are evaluated at 2 w' - w and at 2 P' - P,
where w' is the angular velocity of Q. This keeps order 2 without a solve over all bodies. With the
implicit w+ instead, errors under a drag were between equal and 2000 times larger (measured).
ITERATED steps evaluate such forces together with the torque, RUNGE_KUTTA steps in every stage.
Orders under such forces: test/verification/test_rotation_forces.py.

The configuration group is SO(3) x R^3 for every `group` of the simulation.
"""

import math

import numpy as np

from liegroup_core.compiling import SameTypes, borrowed, stepper
from liegroup_core.forces.external import set_external_wrenches
from liegroup_core.forces.gravity import add_wrench as add_gravity
from liegroup_core.forces.kinds import add_wrenches
from liegroup_core.mechanism.bodies import LARGEST_TURN, STEP_TURN, copy_state, make_work
from liegroup_core.methods.checks import is_finite
from liegroup_core.methods.table import METHODS, refuse_stabilisation
from liegroup_core.status import DIVERGED, HOPELESS_ROTATION, NOT_CONVERGED, NOT_FINITE, OK

from .bodies import COLUMNS, make_spinners
from .iterated import HISTORY, finish_iterated, iterated, update_loads
from .kicked import kicked
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
)
from .staged import staged

RULES = {
    "stoermer_verlet": STOERMER_VERLET,
    "lie_newmark": LIE_NEWMARK,
    "rattle": RATTLE,
    "austin_krishnaprasad_wang": AUSTIN,
    "lie_midpoint": LIE_MIDPOINT,
    "simo_wong": SIMO_WONG,
    "bottasso_borri_candidate": BOTTASSO_BORRI,
} | {name: RUNGE_KUTTA for name, method in METHODS.items() if method.family == "rotation" and method.coefficients}

# An ITERATED step is repeated until no displacement changes by more than TOLERANCE, in rad or relative to
# the largest coordinate (at least 1 m). If round-off is larger, it ends when the change is below STUCK *
# TOLERANCE and two iterations have not halved it.
TOLERANCE, STUCK = 1e-15, 100.0
MAX_REPEATS = 100


@stepper
def advance(model, work, spinners, memory, loads, corrections, rule, weights, h, steps, pose, twist, external):
    """Take `steps` steps of size h in place of pose (n, 12) and twist (n, 6).

    spinners            : (n,) records of bodies.SPINNER
    memory              : (n, COLUMNS) scratch; loads (6 n,), corrections (HISTORY, 6 n): scratch
    rule                : method, a code of maps.py
    weights             : (s + 1, s) a of the tableau, below it b; (1, 0) without a tableau
    external            : external wrenches of these steps, see forces/external.py
    returns (steps done, status): fewer steps if status is not OK; pose and twist are then those of
    the last valid step. NO_RATTLE_STEP has the index of the body above its low byte.

    All methods share one loop with one evaluation of the forces: forces are inlined and compiled at
    every call.
    """
    spinners = borrowed(spinners)
    memory, weights = borrowed(memory), borrowed(weights)
    loads, corrections = borrowed(loads), borrowed(corrections)
    pose, twist, external = borrowed(pose), borrowed(twist), borrowed(external)
    for done in range(steps):
        copy_state(pose, twist, work.stage_pose, work.stage_twist)
        work.report[STEP_TURN] = 0.0
        status, finished = OK, False
        evaluation, previous, earlier = 0, math.inf, math.inf
        while not finished:
            set_external_wrenches(external, work.stage_pose, work.stage_twist, work.wrench)
            add_gravity(model, work.stage_pose, work.wrench)
            stage_pose, stage_twist = work.stage_pose, work.stage_twist
            add_wrenches(model.forces, work.angle, work.targets, work.registers, stage_pose, stage_twist, work.wrench)
            if rule == RUNGE_KUTTA:
                status, finished = staged(spinners, work, memory, weights, h, evaluation, pose, twist)
            elif rule < FIRST_ITERATED:
                status, finished = kicked(rule, spinners, work, memory, h, evaluation, pose, twist)
            else:
                update_loads(spinners, work, loads, corrections, evaluation)
                status, change = iterated(rule, spinners, work, memory, loads, h, evaluation, pose, twist)
                finished = (
                    status != OK or change <= TOLERANCE or (0.5 * max(previous, earlier) < change <= STUCK * TOLERANCE)
                )
                previous, earlier = change, previous
                if finished and status == OK:
                    finish_iterated(spinners, work, memory, pose)
                elif evaluation == MAX_REPEATS:
                    status, finished = NOT_CONVERGED, True
            evaluation += 1
        if status == OK and not is_finite(work.stage_pose, work.stage_twist):
            status = NOT_FINITE
        if status == OK and work.report[STEP_TURN] > HOPELESS_ROTATION * HOPELESS_ROTATION:
            status = DIVERGED
        if status != OK:
            return done, status
        copy_state(work.stage_pose, work.stage_twist, pose, twist)
        work.report[LARGEST_TURN] = max(work.report[LARGEST_TURN], work.report[STEP_TURN])
    return steps, OK


class Rotation:
    """Rotation method for a model; it has no memory between steps."""

    substeps = (0, 0)

    def __init__(self, method, layout, group, step, options):
        model = layout.model
        refuse_stabilisation(method, model)
        self._model, self._name, self._rule = model, method.name, RULES[method.name]
        self._spinners = make_spinners(model)
        tableau = method.tableau if method.coefficients else None
        self._weights = np.zeros((1, 0)) if tableau is None else np.vstack([tableau.a, tableau.b])
        self._memory = np.zeros((len(model.bodies), COLUMNS))
        self._loads = np.zeros(6 * len(model.bodies))
        self._corrections = np.zeros((HISTORY, 6 * len(model.bodies)))
        self.work = make_work(model, self._weights.shape[1])
        self._advance = SameTypes(advance)

    def restart(self):
        """Do nothing: there is no memory between calls."""

    @property
    def memory(self):
        """Arrays of the memory between calls: none."""
        return ()

    def advance(self, h, steps, pose, twist, external):
        """Take steps of size h in place; returns (steps done, status)."""
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
