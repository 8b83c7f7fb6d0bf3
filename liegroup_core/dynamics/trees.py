# SPDX-License-Identifier: Apache-2.0
"""Accelerations of trees in O(n): kinematics, and articulated bodies.

With the relative pose C_ba of parent a and child b, X = Ad(C_ba), twists in link axes,
    V_b = X V_a + S qdot ,   Vdot_b = X Vdot_a + [V_b, S qdot] + S qddot
From the leaves to the world every link adds the inertia and bias force of its articulated body to
its parent, one degree of freedom s (column of S) after the other:
    U = I s ,  D = s . U ,  u = -s . p ;   I <- I - U U^T / D ,  p <- p + U u / D
    I_a += X^T I X ,   p_a += X^T (p + I [V_b, S qdot])
and from the world to the leaves, in the reverse order,
    qddot = (u - U . Vdot) / D ,   Vdot <- Vdot + s qddot
The world accelerates by -g instead of a weight on every link: Work.moved is Vdot - g.

Eliminating a degree of freedom makes its row of I exactly zero. So a massive link adds no inertia about the axis of a
hinge to a light parent, not even by round-off, and through a ball joint it adds a mass matrix only. A held
degree of freedom (switches.py) is not eliminated: it does not accelerate.

Source: Featherstone, Rigid Body Dynamics Algorithms, section 7.3.
"""

from liegroup_core.compiling import kernel, subroutine
from liegroup_core.joints.elements import WORLD
from liegroup_core.lie.vec3 import load3

from .algebra import first_state, link_of, rate_twist, state_column, store, tree_size, zero
from .links import accelerated, apply, body_wrench, move_link, pass_inertia, start


@kernel
def move_links(model, work):
    """Relative poses, twists V and [V, S qdot] of all links at the stage; no applied wrenches."""
    for b in range(tree_size(model)):
        link = link_of(model, b)
        S = rate_twist(model, link, work.stage_twist, len(model.bodies) + b)
        store(model, move_link(model, work, link, b, S), work.velocities, b)
        store(model, zero(model), work.applied, b)
    for b in range(tree_size(model), len(model.links)):
        store(model, zero(model), work.applied, b)
        store(model, zero(model), work.force, b)


@kernel
def apply_wrenches(model, work):
    """Add the wrenches on the bodies, work.wrench, to work.applied."""
    for i in range(len(model.bodies)):
        b = model.bodies[i]["link"]
        if b != WORLD:
            apply(model, work, b, body_wrench(model, work, i))


@kernel
def gather(model, work):
    """Articulated inertias and bias forces for work.applied, from the leaves to the world."""
    for b in range(tree_size(model)):
        start(model, work, link_of(model, b), b)
    for b in range(tree_size(model) - 1, -1, -1):
        pass_inertia(model, work, link_of(model, b), b)
    size, first, c = tree_size(model), first_state(model, work), state_column(model)
    for s in range(len(model.law_links)):
        work.freedoms[first + s, 6], work.freedoms[first + s, 7] = 1.0, work.applied[size + s, c]


@subroutine
def _spread(model, work, gx, gy, gz, drift):
    """Accelerations of all degrees of freedom and links, from the world to the leaves.

    gx, gy, gz : acceleration of gravity, world axes
    drift      : 1 with the terms [V, S qdot], 0 without: response to forces alone
    writes work.acceleration, and Vdot - gravity of the links to work.moved
    """
    for b in range(tree_size(model)):
        V = accelerated(model, work, link_of(model, b), b, (gx, gy, gz), drift)
        store(model, V, work.moved, b)
    for f in range(first_state(model, work), len(work.freedoms)):
        work.acceleration[f, 0] = work.freedoms[f, 7]
    return 0


@kernel
def spread(model, work):
    """Accelerations of all degrees of freedom and links at the stage."""
    g = load3(model.gravity, 0, 0)
    _spread(model, work, g[0], g[1], g[2], 1)


@kernel
def spread_response(model, work):
    """The same without gravity and velocities: the response to the forces u of the freedoms."""
    _spread(model, work, 0.0, 0.0, 0.0, 0)
