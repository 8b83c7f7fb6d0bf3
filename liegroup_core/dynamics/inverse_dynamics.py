# SPDX-License-Identifier: Apache-2.0
"""Generalised forces for given joint accelerations, in O(n).

With the relative pose C_ba of parent a and child b, X = Ad(C_ba), and an acceleration -g of the
world,
    Vdot_b = X Vdot_a + [V_b, S qdot] + S qddot
from the world to the leaves, and from the leaves to the world
    F_b = I Vdot_b - ad_V^T I V_b - W_b + sum of X^T F of its children ,   f_b = S^T F_b + rotor qddot
W_b are the applied wrenches minus J^T lambda of the cut joints. The links' own inertias enter, not sums of
them, so the result keeps digits that articulated inertias may lose.

Source: Featherstone, Rigid Body Dynamics Algorithms, section 5.3 (recursive Newton-Euler).
"""

from liegroup_core.compiling import kernel, subroutine
from liegroup_core.joints.elements import WORLD
from liegroup_core.lie.vec3 import load3

from .algebra import add, add_to, column_twist, link_of, load, own_forces, relative, size, store, wrench_at
from .links import without_freedoms
from .residuals import add_multipliers, add_own_forces


@kernel
def _accelerate(model, work, rates):
    """Vdot - gravity of all links for the joint accelerations `rates`, to work.moved."""
    g = load3(model.gravity, 0, 0)
    for b in range(len(model.links)):
        link = link_of(model, b)
        V = without_freedoms(model, work, b, link["parent"], g, 1)
        store(model, add(model, V, column_twist(model, link, rates, link["freedom"])), work.moved, b)


@subroutine
def inverse_dynamics(model, work, rates, force_out):
    """Generalised forces still needed for given accelerations: M qddot + bias + J^T lambda - S^T W.

    rates     : (f, 1) qddot, rad/s^2 or m/s^2
    force_out : (f,) N m or N; zero if the equations of motion hold
    Uses kinematics, work.applied and work.multipliers of the stage; overwrites work.moved
    and force. Accuracy: test/core/test_dynamics.py.
    """
    _accelerate(model, work, rates)
    for b in range(len(model.links)):
        for c in range(size(model)):
            work.force[b, c] = 0.0
    add_multipliers(model, work)
    add_own_forces(model, work)
    for b in range(len(model.links) - 1, -1, -1):
        link, F = link_of(model, b), load(model, work.force, b)
        own_forces(model, link, F, force_out, link["freedom"])
        if link["rotor"] > 0.0:
            force_out[link["freedom"]] += link["rotor"] * rates[link["freedom"], 0]
        if link["parent"] != WORLD:
            F = wrench_at(model, relative(model, work, b), F)
            add_to(model, F, work.force, link["parent"])
    return 0
