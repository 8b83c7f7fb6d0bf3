# SPDX-License-Identifier: Apache-2.0
"""Operations on a link or a cut joint in space: see links.py. Those in a plane are in plane.py."""

from liegroup_core.compiling import kernel
from liegroup_core.joints.elements import PAIR, WORLD
from liegroup_core.joints.kinds import variable_row
from liegroup_core.lie.se3 import se3_Ad, se3_ad, se3_Ad_inverse, se3_inverse, se3_wrench
from liegroup_core.lie.so3 import so3_nearest
from liegroup_core.lie.vec3 import (
    ZERO3,
    add3,
    axpy3,
    cross3,
    load3,
    load9,
    matrix3,
    matvec3,
    store3,
    store9,
    sub3,
    tmatmul3,
    tmatvec3,
    vector3,
)
from liegroup_core.motion_groups import table
from liegroup_core.motion_groups.articulated import add_inertia, load_inertia, symmetric_times, times

from .algebra import Ad_inverse, add, add_to, load, relative, store, wrench_at


@kernel
def momentum(model, link, V):
    """I V of a link without its children."""
    w, v = V
    moment, inertia = vector3(link["moment"]), link["inertia"]
    angular = symmetric_times(inertia[0], inertia[1], inertia[2], inertia[3], inertia[4], inertia[5], w)
    return add3(angular, cross3(moment, v)), axpy3(link["mass"], v, cross3(w, moment))


@kernel
def bias_force(model, work, link, b):
    """-ad_V^T I V of a link without its children."""
    w, v = load(model, work.velocities, b)
    angular, linear = momentum(model, link, (w, v))
    return add3(cross3(w, angular), cross3(v, linear)), cross3(w, linear)


@kernel
def body_wrench(model, work, i):
    """Wrench on body i, in the axes of its link."""
    body = model.bodies[i]
    rot, p = matrix3(body["rotation"]), vector3(body["point"])
    return se3_wrench(rot, p, load3(work.wrench, i, 0), load3(work.wrench, i, 3))


@kernel
def apply(model, work, b, F):
    """Apply a wrench to link b."""
    add_to(model, F, work.applied, b)


@kernel
def move_link(model, work, link, b, S):
    """Twist of a link with rates S qdot at the stage; its pose in its parent, and [V, S qdot]."""
    rot, p = table.relative_pose(link, work.stage_pose, len(model.bodies) + b)
    store9(rot, work.relative, b, 0)
    store3(p, work.relative, b, 9)
    V, bracket = S, (ZERO3, ZERO3)
    if link["parent"] != WORLD:
        w, v = load(model, work.velocities, link["parent"])
        w, v = se3_Ad_inverse(rot, p, w, v)
        V, bracket = table.add_rates(link, S[0], S[1], w, v)
    store(model, bracket, work.drift, b)
    return V


@kernel
def start(model, work, link, b):
    """Set inertia and bias force of the articulated body of link b to its own."""
    mass, inertia = link["mass"], link["inertia"]
    x, y, z = vector3(link["moment"])
    for k in range(6):
        work.inertia[b, k] = inertia[k]
    # B = [m c]: L = I w + m c x v
    work.inertia[b, 6], work.inertia[b, 7], work.inertia[b, 8] = 0.0, -z, y
    work.inertia[b, 9], work.inertia[b, 10], work.inertia[b, 11] = z, 0.0, -x
    work.inertia[b, 12], work.inertia[b, 13], work.inertia[b, 14] = -y, x, 0.0
    work.inertia[b, 15], work.inertia[b, 16], work.inertia[b, 17] = mass, 0.0, 0.0
    work.inertia[b, 18], work.inertia[b, 19], work.inertia[b, 20] = mass, 0.0, mass
    torque, force = bias_force(model, work, link, b)
    store3(sub3(torque, load3(work.applied, b, 0)), work.force, b, 0)
    store3(sub3(force, load3(work.applied, b, 3)), work.force, b, 3)


@kernel
def pass_inertia(model, work, link, b):
    """Eliminate the degrees of freedom of link b from its articulated body; add the rest to the parent's."""
    m, (torque, force) = load_inertia(work.inertia, b), load(model, work.force, b)
    m, torque, force = table.eliminate(link, work, link["freedom"], m, torque, force)
    if link["parent"] == WORLD:
        return
    short = False
    if link["rotor"] == 0.0:
        short, torque, force = table.hand_on(link, work, b, m, torque, force)
    rot, p = relative(model, work, b)
    if not short:
        dw, dv = times(m, load3(work.drift, b, 0), load3(work.drift, b, 3))
        torque, force = add3(torque, dw), add3(force, dv)
        add_inertia(m, rot, p, work.inertia, link["parent"])
    F = wrench_at(model, (rot, p), (torque, force))
    add_to(model, F, work.force, link["parent"])


@kernel
def without_freedoms(model, work, b, a, g, drift):
    """Acceleration minus g of link b with parent a if its degrees of freedom do not accelerate.

    drift : 1 with [V, S qdot], 0 without it
    """
    X = relative(model, work, b)
    if a == WORLD:
        V = Ad_inverse(model, X, (ZERO3, (-g[0], -g[1], -g[2])))
    else:
        V = Ad_inverse(model, X, load(model, work.moved, a))
    return add(model, V, load(model, work.drift, b)) if drift == 1 else V


@kernel
def accelerated(model, work, link, b, g, drift):
    """Acceleration minus g of link b, with that of its degrees of freedom."""
    w, v = without_freedoms(model, work, b, link["parent"], g, drift)
    return table.accelerate(link, work, link["freedom"], w, v)


@kernel
def acceleration_of(model, work, b, a):
    """Acceleration of child b that the rows of a cut joint constrain; a: parent of the joint."""
    w, v = load(model, work.moved, b)
    if a == WORLD:
        # The world accelerates by -g, see trees.py.
        v = add3(v, tmatvec3(load9(work.world, b, 0), load3(model.gravity, 0, 0)))
    return w, v


@kernel
def leave(model, work, link, b):
    """u of the degrees of freedom of link b for the wrench -work.force on it; the rest is added to the parent."""
    w, v = load(model, work.force, b)
    F = table.load_freedoms(link, work, link["freedom"], w, v)
    if link["parent"] != WORLD:
        F = wrench_at(model, relative(model, work, b), F)
        add_to(model, F, work.force, link["parent"])


@kernel
def seen_from(model, work, cut, a, b):
    """Pose of the parent a of a cut joint in its child b, and the twist of a in the axes of b."""
    rot_b, r_b = load9(work.world, b, 0), load3(work.world, b, 9)
    if a == WORLD:
        return se3_inverse(rot_b, r_b), (ZERO3, ZERO3)
    rot = tmatmul3(rot_b, load9(work.world, a, 0))
    p = tmatvec3(rot_b, sub3(load3(work.world, a, 9), r_b))
    if cut["own_points"] == 1:
        # Shift the parent by the gap, so that its joint point coincides with that of the child.
        element = model.elements[cut["element"]]
        point = matvec3(rot, vector3(element["parent_point"]))
        p = sub3(vector3(element["child_point"]), point)
    w, v = load(model, work.velocities, a)
    return (rot, p), se3_Ad(rot, p, w, v)


@kernel
def set_variable_row(model, work, cut, X, error):
    """Write the row of an element that is not a pair; returns the bias term Jdot_b (V_b - W)."""
    if cut["kind"] == PAIR:
        return 0.0
    element = model.elements[cut["element"]]
    row_w, row_v, rate = variable_row(element, X[0], X[1], error[0], error[1])
    store(model, (row_w, row_v), work.child_jacobian, cut["first"])
    return rate


@kernel
def store_parent_row(model, work, X, r):
    """Write row r of the parent of a cut joint, -J X."""
    rot, p = X
    alpha, beta = load(model, work.child_jacobian, r)
    back = tmatvec3(rot, beta)
    row = (tmatvec3(rot, sub3(cross3(p, beta), alpha)), (-back[0], -back[1], -back[2]))
    store(model, row, work.parent_jacobian, r)


@kernel
def row_bracket(model, work, cut, a, b, X, V, W, e):
    """[V, W] + omega x e; -J times it is the bias. V, W: twists of child b and parent a."""
    turn = V[0]
    if a != WORLD and cut["own_points"] == 1:
        turn = add3(V[0], W[0])
    w, v = se3_ad(V[0], V[1], W[0], W[1])
    return w, add3(v, cross3(turn, e[1]))


@kernel
def set_place(model, work, X, b):
    """Write the pose of link b in the world."""
    # Without this, rotations lose orthogonality along a chain of many links.
    store9(so3_nearest(X[0]), work.world, b, 0)
    store3(X[1], work.world, b, 9)


@kernel
def lift_links(model, work):
    """Do nothing: work.world already has the poses of all links in the world."""
