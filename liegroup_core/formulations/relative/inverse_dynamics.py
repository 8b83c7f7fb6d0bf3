# SPDX-License-Identifier: Apache-2.0
"""Generalised forces for given joint accelerations, in O(n).

With the relative pose C_ba of parent a and child b, X = Ad(C_ba), and an acceleration -g of the
world,
    Vdot_b = X Vdot_a + [V_b, S qdot] + S qddot
from the world to the leaves, and from the leaves to the world
    F_b = I Vdot_b - ad*(V_b) I V_b - W_b + sum of X^T F of its children ,   f_b = S^T F_b
W_b are the applied wrenches less J^T lambda of the cut joints. Own inertias of the links enter, no
sums of them, so that the result has the digits that articulated inertias may lose.

Source: Featherstone, Rigid Body Dynamics Algorithms, section 5.3 (recursive Newton-Euler).
"""

from liegroup_core.compiling import kernel, subroutine
from liegroup_core.joints.elements import WORLD
from liegroup_core.lie.se3 import se3_Ad_inverse
from liegroup_core.lie.vec3 import ZERO3, add3, cross3, load3, load9, store3, sub3

from .arrays import BALL, CYLINDER, PLANE, SCREW, SLIDE
from .coordinates import rate_twist
from .residuals import add_multipliers
from .trees import add_wrench, momentum


@kernel
def _component(group, k):
    """Component of a twist that the k-th freedom of a link is."""
    if group >= BALL:
        return k
    if group == SLIDE or (group == CYLINDER and k == 1):
        return 5
    return 2 + k if group == PLANE else 2


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
    """Forces f of all freedoms, N m or N, that are missing for their accelerations.

    rates     : (f, ...) qddot, rad/s^2 or m/s^2
    force_out : (f, ...) M qddot + bias + J^T lambda - S^T W; zero if the equations of motion hold
    Uses kinematics, work.applied and work.multipliers of the stage; overwrites work.velocity, moved
    and force.
    """
    _accelerate(model, work, rates)
    for b in range(len(model.bodies)):
        for c in range(6):
            work.force[b, c] = 0.0
    add_multipliers(model, work)
    for b in range(len(model.bodies) - 1, -1, -1):
        link = model.bodies[b]
        w, v = load3(work.velocities, b, 0), load3(work.velocities, b, 3)
        angular, linear = momentum(link, w, v)
        torque, force = add3(cross3(w, angular), cross3(v, linear)), cross3(w, linear)
        angular, linear = momentum(link, load3(work.moved, b, 0), load3(work.moved, b, 3))
        torque = sub3(add3(torque, angular), load3(work.applied, b, 0))
        force = sub3(add3(force, linear), load3(work.applied, b, 3))
        torque = add3(torque, load3(work.force, b, 0))
        force = add3(force, load3(work.force, b, 3))
        store3(torque, work.force, b, 0)
        store3(force, work.force, b, 3)
        group, first, a = link["group"], link["freedom"], link["parent"]
        for k in range(link["freedoms"]):
            force_out[first + k] = work.force[b, _component(group, k)]
        if group == SCREW:
            force_out[first] += link["pitch"] * force[2]
        if a != WORLD:
            rot, p = load9(work.relative, b, 0), load3(work.relative, b, 9)
            add_wrench(torque, force, rot, p, work.force, a)
    return 0
