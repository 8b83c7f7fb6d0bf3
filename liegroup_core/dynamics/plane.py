# SPDX-License-Identifier: Apache-2.0
"""Operations on a link or a cut joint in a plane: those of space.py, with twists of three components.

Let A be the acceleration of a link, minus gravity, if no degree of freedom accelerates:
    A_b = X A_a + [V_b, S qdot] ,   A_world = -g
In the plane A has no angular part. The bias forces include I A, and the sweeps solve for the rest E:
    Vdot_b = A_b + E_b ,   E_b = X E_a + S qddot ,   E_world = 0
So only the bias forces depend on gravity and velocities. Work.drift has A and Work.moved has E.
"""

from liegroup_core.compiling import kernel
from liegroup_core.joints.elements import WORLD
from liegroup_core.lie.se2 import se2_Ad, se2_Ad_inverse, se2_between, se2_inverse, turn2, turn_back2
from liegroup_core.lie.vec3 import ZERO3, load3, load9, matvec3, store3, store9, sub3
from liegroup_core.motion_groups import table
from liegroup_core.motion_groups.about_z import turned
from liegroup_core.motion_groups.in_plane import place

from . import space
from .algebra import Ad_inverse, add_to, load, relative


@kernel
def momentum(model, link, V):
    mass, mx, my = link["mass"], link["moment_x"], link["moment_y"]
    w, x, y = V
    return link["inertia"] * w + (mx * y - my * x), mass * x - my * w, mass * y + mx * w


@kernel
def _bias(link, V, A):
    """-ad_V^T I V + I A."""
    mass, mx, my = link["mass"], link["moment_x"], link["moment_y"]
    (w, x, y), (ax, ay) = V, A
    px, py = mass * x - w * my, mass * y + w * mx
    return (x * py - y * px) + (mx * ay - my * ax), mass * ax - w * py, mass * ay + w * px


@kernel
def bias_force(model, work, link, b):
    return _bias(link, load(model, work.velocities, b), (work.drift[b, 0], work.drift[b, 1]))


@kernel
def body_wrench(model, work, i):
    """Components of the wrench in the plane; the others have no effect."""
    torque, force = space.body_wrench(model, work, i)
    return torque[2], force[0], force[1]


@kernel
def apply(model, work, b, F):
    """Apply a wrench to link b; its bias force is already set, so that it changes, too."""
    add_to(model, F, work.applied, b)
    store3(sub3(load(model, work.force, b), F), work.force, b, 0)


@kernel
def move_link(model, work, link, b, S):
    """Return V, store A instead of [V, S qdot], and set inertia and bias force of the articulated body."""
    X, a, V, bx, by = relative(model, work, b), link["parent"], S, 0.0, 0.0
    ax, ay = -model.plane_gravity[0, 0], -model.plane_gravity[0, 1]
    if a != WORLD:
        V = se2_Ad_inverse(X, load(model, work.velocities, a))
        V, (bx, by) = table.plane_add_rates(link, S, V)
        ax, ay = work.drift[a, 0], work.drift[a, 1]
    ax, ay = turn_back2(X[0], X[1], ax, ay)
    A, inertia, mass = (ax + bx, ay + by), work.inertia, link["mass"]
    work.drift[b, 0], work.drift[b, 1] = A
    store3(_bias(link, V, A), work.force, b, 0)
    store3((link["inertia"], -link["moment_y"], link["moment_x"]), inertia, b, 0)
    store3((mass, 0.0, mass), inertia, b, 3)
    return V


@kernel
def start(model, work, link, b):
    """Do nothing: `move_link` has set them, which saves a loop over the links."""


@kernel
def pass_inertia(model, work, link, b):
    m = work.inertia
    m = (m[b, 0], m[b, 1], m[b, 2], m[b, 3], m[b, 4], m[b, 5])
    m, F = table.plane_eliminate(link, work, link["freedom"], m, load(model, work.force, b))
    if link["parent"] != WORLD:
        table.plane_hand_on(link, work, len(model.bodies) + b, m, F)


@kernel
def without_freedoms(model, work, b, a, g, drift):
    return Ad_inverse(model, relative(model, work, b), load(model, work.moved, a)) if a != WORLD else ZERO3


@kernel
def accelerated(model, work, link, b, g, drift):
    E, V, a = ZERO3, ZERO3, link["parent"]
    if a != WORLD:
        E = load(model, work.moved, a)
        V = Ad_inverse(model, relative(model, work, b), E)
    return table.plane_accelerate(link, work, link["freedom"], E, V)


@kernel
def acceleration_of(model, work, b, a):
    """E; the bias of the rows includes A."""
    return load(model, work.moved, b)


@kernel
def leave(model, work, link, b):
    f, F = link["freedom"], load(model, work.force, b)
    F, y, second, third = table.plane_leave(link, work, f, len(model.bodies) + b, F)
    work.freedoms[f, 7] = -y
    if link["freedoms"] == 3:
        work.freedoms[f + 1, 7], work.freedoms[f + 2, 7] = -second, -third
    if link["parent"] != WORLD:
        add_to(model, F, work.force, link["parent"])


@kernel
def seen_from(model, work, cut, a, b):
    child = place(work.placed, b)
    if a == WORLD:
        return se2_inverse(child), ZERO3
    X = se2_between(child, place(work.placed, a))
    return X, se2_Ad(X, load(model, work.velocities, a))


@kernel
def set_variable_row(model, work, cut, X, error):
    """Return 0: all cut joints of planar mechanisms are pairs."""
    return 0.0


@kernel
def store_parent_row(model, work, X, r):
    c, s, px, py = X
    alpha, x, y = load3(work.child_jacobian, r, 2)
    bx, by = turn_back2(c, s, x, y)
    store3(((px * y - py * x) - alpha, -bx, -by), work.parent_jacobian, r, 2)


@kernel
def row_bracket(model, work, cut, a, b, X, V, W, e):
    """A of the child minus that of the parent, plus [V, W] and omega x e; the rows act on E."""
    ax, ay, w, wa = -model.plane_gravity[0, 0], -model.plane_gravity[0, 1], V[0], W[0]
    if a != WORLD:
        ax, ay = work.drift[a, 0], work.drift[a, 1]
    ax, ay = turn2(X[0], X[1], ax, ay)
    ax = work.drift[b, 0] - ax + (wa * V[2] - w * W[2])
    ay = work.drift[b, 1] - ay + (w * W[1] - wa * V[1])
    return 0.0, ax - w * e[2], ay + w * e[1]


@kernel
def set_place(model, work, X, b):
    work.placed[b, 0], work.placed[b, 1], work.placed[b, 2], work.placed[b, 3] = X


@kernel
def lift_links(model, work):
    """Write the poses of all links in the world, from those in the plane."""
    axes = load9(model.axes, 0, 0)
    for b in range(len(model.plane_links)):
        c, s, x, y = place(work.placed, b)
        # Normalise the rotation by one Newton iteration.
        scale = 1.5 - 0.5 * (c * c + s * s)
        store9(turned(axes, c * scale, s * scale), work.world, b, 0)
        store3(matvec3(axes, (x, y, model.link_heights[b])), work.world, b, 9)
