# SPDX-License-Identifier: Apache-2.0
"""Accelerations of trees in O(n): kinematics, and articulated bodies.

With the relative pose C_ba of parent a and child b, X = Ad(C_ba), twists in link axes,
    V_b = X V_a + S qdot ,   Vdot_b = X Vdot_a + [V_b, S qdot] + S qddot
From the leaves to the world every link adds the inertia and bias force of its articulated body to
its parent, one freedom s (column of S) after the other:
    U = I s ,  D = s . U ,  u = -s . p ;   I <- I - U U^T / D ,  p <- p + U u / D
    I_a += X^T I X ,   p_a += X^T (p + I [V_b, S qdot])
and from the world to the leaves, in the reverse order,
    qddot = (u - U . Vdot) / D ,   Vdot <- Vdot + s qddot
The world accelerates by -g instead of a weight on every link: Work.moved is Vdot - g.

A freedom leaves its row of I exactly zero. So a massive link gives a light parent no inertia about
the axis of their hinge, not even that of round-off; a ball joint gives its parent a mass matrix
only. A freedom that is held (switches.py) leaves nothing: it does not accelerate.

Source: Featherstone, Rigid Body Dynamics Algorithms, section 7.3.
"""

from liegroup_core.compiling import kernel, subroutine
from liegroup_core.joints.elements import WORLD
from liegroup_core.lie.se3 import se3_Ad_inverse
from liegroup_core.lie.vec3 import (
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
    vector3,
)
from liegroup_core.motion_groups.articulated import (
    add_inertia,
    load_inertia,
    symmetric_times,
    times,
)
from liegroup_core.motion_groups.table import (
    accelerate,
    add_rates,
    eliminate,
    hand_on,
    rate_twist,
    relative_pose,
)


@kernel
def move_links(model, work):
    """Relative poses, twists V and [V, S qdot] of all links at the stage; no applied wrenches."""
    first, coordinates, rates = len(model.parts), work.stage_pose, work.stage_twist
    for b in range(len(model.bodies)):
        link = model.bodies[b]
        a = link["parent"]
        rot, p = relative_pose(link, coordinates, first + b)
        store9(rot, work.relative, b, 0)
        store3(p, work.relative, b, 9)
        sw, sv = rate_twist(link, rates, first + b)
        if a == WORLD:
            w, v = sw, sv
            store3((0.0, 0.0, 0.0), work.drift, b, 0)
            store3((0.0, 0.0, 0.0), work.drift, b, 3)
        else:
            w, v = se3_Ad_inverse(
                rot, p, load3(work.velocities, a, 0), load3(work.velocities, a, 3)
            )
            (w, v), (cw, cv) = add_rates(link, sw, sv, w, v)
            store3(cw, work.drift, b, 0)
            store3(cv, work.drift, b, 3)
        store3(w, work.velocities, b, 0)
        store3(v, work.velocities, b, 3)
        store3((0.0, 0.0, 0.0), work.applied, b, 0)
        store3((0.0, 0.0, 0.0), work.applied, b, 3)


@kernel
def add_wrench(torque, force, rot, p, out, row):
    """Add X^T W to row `row` of `out`, for a wrench W on a link at rot, p in its parent."""
    f = matvec3(rot, force)
    t = add3(matvec3(rot, torque), cross3(p, f))
    for c in range(3):
        out[row, c] += t[c]
        out[row, 3 + c] += f[c]


@kernel
def pass_on(work, b, wrenches, row, to):
    """Add X^T W to row `to` of `wrenches`, for the wrench W on link b in row `row`."""
    torque, force = load3(wrenches, row, 0), load3(wrenches, row, 3)
    rot, p = load9(work.relative, b, 0), load3(work.relative, b, 9)
    add_wrench(torque, force, rot, p, wrenches, to)


@kernel
def momentum(link, w, v):
    """I V of a link without its children: angular and linear momentum."""
    moment, inertia = vector3(link["moment"]), link["inertia"]
    angular = symmetric_times(
        inertia[0], inertia[1], inertia[2], inertia[3], inertia[4], inertia[5], w
    )
    return add3(angular, cross3(moment, v)), axpy3(link["mass"], v, cross3(w, moment))


@kernel
def apply_wrenches(model, work):
    """Add the wrenches on the bodies, work.wrench, to work.applied."""
    for i in range(len(model.parts)):
        part = model.parts[i]
        if part["link"] != WORLD:
            add_wrench(
                load3(work.wrench, i, 0),
                load3(work.wrench, i, 3),
                matrix3(part["rotation"]),
                vector3(part["point"]),
                work.applied,
                part["link"],
            )


@kernel
def _start(model, work):
    """Set inertia and bias force of every link to its own."""
    for b in range(len(model.bodies)):
        link = model.bodies[b]
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
        w, v = load3(work.velocities, b, 0), load3(work.velocities, b, 3)
        angular, linear = momentum(link, w, v)
        torque = add3(cross3(w, angular), cross3(v, linear))
        force = cross3(w, linear)
        store3(sub3(torque, load3(work.applied, b, 0)), work.force, b, 0)
        store3(sub3(force, load3(work.applied, b, 3)), work.force, b, 3)


@kernel
def gather(model, work):
    """Articulated inertias and bias forces for work.applied, from the leaves to the world."""
    _start(model, work)
    for b in range(len(model.bodies) - 1, -1, -1):
        link = model.bodies[b]
        f, a = link["freedom"], link["parent"]
        m = load_inertia(work.inertia, b)
        torque, force = load3(work.force, b, 0), load3(work.force, b, 3)
        m, torque, force = eliminate(link, work, f, m, torque, force)
        if a == WORLD:
            continue
        short, torque, force = hand_on(link, work, b, m, torque, force)
        rot, p = load9(work.relative, b, 0), load3(work.relative, b, 9)
        if not short:
            dw, dv = times(m, load3(work.drift, b, 0), load3(work.drift, b, 3))
            torque, force = add3(torque, dw), add3(force, dv)
            add_inertia(m, rot, p, work.inertia, a)
        add_wrench(torque, force, rot, p, work.force, a)


@subroutine
def _spread(model, work, gx, gy, gz, drift):
    """Accelerations of all freedoms and links, from the world to the leaves.

    gx, gy, gz : acceleration of gravity, world axes
    drift      : 1 with the terms [V, S qdot], 0 without: response to forces alone
    writes work.acceleration, and Vdot - gravity of the links to work.moved
    """
    for b in range(len(model.bodies)):
        link = model.bodies[b]
        a = link["parent"]
        rot, p = load9(work.relative, b, 0), load3(work.relative, b, 9)
        if a == WORLD:
            w, v = se3_Ad_inverse(rot, p, (0.0, 0.0, 0.0), (-gx, -gy, -gz))
        else:
            w, v = se3_Ad_inverse(rot, p, load3(work.moved, a, 0), load3(work.moved, a, 3))
        if drift == 1:
            w = add3(w, load3(work.drift, b, 0))
            v = add3(v, load3(work.drift, b, 3))
        w, v = accelerate(link, work, link["freedom"], w, v)
        store3(w, work.moved, b, 0)
        store3(v, work.moved, b, 3)
    return 0


@kernel
def spread(model, work):
    """Accelerations of all freedoms and links at the stage."""
    g = load3(model.gravity, 0, 0)
    _spread(model, work, g[0], g[1], g[2], 1)


@kernel
def spread_response(model, work):
    """The same without gravity and velocities: the response to the forces u of the freedoms."""
    _spread(model, work, 0.0, 0.0, 0.0, 0)
