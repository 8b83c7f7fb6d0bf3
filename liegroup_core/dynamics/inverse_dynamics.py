# SPDX-License-Identifier: Apache-2.0
"""Generalised forces for given joint accelerations, in O(n).

With the relative pose C_ba of parent a and child b, X = Ad(C_ba), and an acceleration -g of the
world,
    Vdot_b = X Vdot_a + [V_b, S qdot] + S qddot
from the world to the leaves, and from the leaves to the world
    F_b = I Vdot_b - ad_V^T I V_b - W_b + sum of X^T F of its children ,   f_b = S^T F_b
W_b are the applied wrenches less J^T lambda of the cut joints. Own inertias of the links enter, no
sums of them, so that the result has the digits that articulated inertias may lose.

Source: Featherstone, Rigid Body Dynamics Algorithms, section 5.3 (recursive Newton-Euler).
"""

from liegroup_core.compiling import kernel, subroutine
from liegroup_core.joints.elements import WORLD
from liegroup_core.lie.se3 import se3_Ad_inverse
from liegroup_core.lie.vec3 import ZERO3, add3, load3, load9, store3
from liegroup_core.motion_groups.table import rate_twist

from .residuals import add_multipliers, add_own_forces
from .trees import pass_on


@kernel
def _accelerate(model, work, rates):
    """Vdot - gravity of all links for the joint accelerations `rates`, to work.moved."""
    g = load3(model.gravity, 0, 0)
    for b in range(len(model.bodies)):
        link = model.bodies[b]
        a, first = link["parent"], link["freedom"]
        rot, p = load9(work.relative, b, 0), load3(work.relative, b, 9)
        if a == WORLD:
            w, v = se3_Ad_inverse(rot, p, ZERO3, (-g[0], -g[1], -g[2]))
        else:
            w, v = se3_Ad_inverse(rot, p, load3(work.moved, a, 0), load3(work.moved, a, 3))
        for k in range(link["freedoms"]):
            work.velocity[b, k] = rates[first + k]
        sw, sv = rate_twist(link, work.velocity, b)
        store3(add3(add3(w, load3(work.drift, b, 0)), sw), work.moved, b, 0)
        store3(add3(add3(v, load3(work.drift, b, 3)), sv), work.moved, b, 3)


@subroutine
def inverse_dynamics(model, work, rates, force_out):
    """Forces that the freedoms lack for given accelerations: M qddot + bias + J^T lambda - S^T W.

    rates     : (f,) qddot, rad/s^2 or m/s^2; longer arrays are allowed
    force_out : (f,) N m or N; zero if the equations of motion hold
    Uses kinematics, work.applied and work.multipliers of the stage; overwrites work.velocity, moved
    and force. Accuracy: test/core/test_inverse_dynamics.py.
    """
    _accelerate(model, work, rates)
    for b in range(len(model.bodies)):
        for c in range(6):
            work.force[b, c] = 0.0
    add_multipliers(model, work)
    add_own_forces(model, work)
    for b in range(len(model.bodies) - 1, -1, -1):
        link = model.bodies[b]
        first, a = link["freedom"], link["parent"]
        for k in range(first, first + link["freedoms"]):
            force_out[model.order[k, 0]] = work.force[b, model.order[k, 1]]
        if link["pitch"] != 0.0:
            force_out[first] += link["pitch"] * work.force[b, 5]
        if a != WORLD:
            pass_on(work, b, work.force, b, a)
    return 0
