# SPDX-License-Identifier: Apache-2.0
"""Operations of a Munthe-Kaas step in relative coordinates: states on the product of joint groups.

The algebra of a link has one number for each freedom. On SO(2), R, SO(2) x R and screws, which are
commutative, dexp is the identity. work.slopes has the freedoms of all links, stage by stage.
"""

import math

from liegroup_core.compiling import kernel
from liegroup_core.forces import kinds
from liegroup_core.formulations.relative.arrays import BALL, PLANE
from liegroup_core.formulations.relative.coordinates import (
    coordinates,
    displace,
    normalise,
    place_bodies,
    place_links,
    rate_twist,
)
from liegroup_core.formulations.relative.dynamics import accelerations
from liegroup_core.formulations.relative.loops import project
from liegroup_core.formulations.relative.trees import move_links
from liegroup_core.integrators.methods import EXACT
from liegroup_core.integrators.motion import copy_state, is_finite
from liegroup_core.joints.elements import WORLD
from liegroup_core.lie.coefficients import dexpinv_coefficients, truncated_dexpinv_coefficients
from liegroup_core.lie.se3 import se3_Ad_inverse, se3_dexpinv_of
from liegroup_core.lie.so3 import so3_dexpinv_of
from liegroup_core.lie.vec3 import add3, cross3, dot3, load3, load9, store3, vector3
from liegroup_core.status import (
    LARGEST_ROTATION,
    NOT_FINITE,
    OK,
    ROTATION_TOO_LARGE,
    TURNS_NOT_COUNTED,
)


@kernel
def enter(model, work, pose, twist, external):
    """Continue from the coordinates of the last call, or find them from a state that was set."""
    copy_state(pose, twist, work.pose, work.twist)
    if work.known[0] == 0.0:
        coordinates(model, work, work.pose, work.twist)
        work.known[0] = 1.0
        # Bodies that are welded to the world are never placed.
        copy_state(work.pose, work.twist, work.stage_pose, work.stage_twist)
        copy_state(pose, twist, work.space.stage_pose, work.space.stage_twist)
    total = 0.0
    for i in range(len(external)):
        for c in range(12):
            total += abs(external[i, c])
    work.pushed[0] = total
    return work.pose, work.twist, external, OK


@kernel
def leave(model, work, pose, twist, pose_out, twist_out):
    """Write poses and twists of the bodies to the caller's arrays."""
    _place(model, work, pose, twist, pose_out, twist_out)


@kernel
def begin(model, work, group, pose, twist):
    """Set stage 0 to the state."""
    n = len(model.parts)
    for b in range(len(model.bodies)):
        for k in range(6):
            work.velocity[b, k] = twist[n + b, k]
    copy_state(pose, twist, work.stage_pose, work.stage_twist)


@kernel
def _add_slopes(h, weights, row, stages, slopes, count, to):
    """Write the sums h weights[row, l] k_l over the first stages l to rows of slopes from `to` on."""
    for f in range(count):
        slopes[to + f, 0] = 0.0
        slopes[to + f, 1] = 0.0
    for stage in range(stages):
        weight = weights[row, stage]
        if weight != 0.0:
            start = stage * count
            for f in range(count):
                slopes[to + f, 0] += weight * slopes[start + f, 0]
                slopes[to + f, 1] += weight * slopes[start + f, 1]
    for f in range(count):
        slopes[to + f, 0] *= h
        slopes[to + f, 1] *= h


@kernel
def move(model, work, scheme, group, h, stage, end, pose):
    """Set all links to X_0 exp Psi of a stage; at the end of a step, bodies where they are needed."""
    n, count = len(model.parts), len(work.freedoms)
    first = stage * count
    _add_slopes(h, scheme.a, stage, stage, work.slopes, count, first)
    largest = 0.0
    for b in range(len(model.bodies)):
        link = model.bodies[b]
        f = first + link["freedom"]
        largest = max(largest, displace(link, pose, n + b, work.slopes, f, 1.0, work.stage_pose))
        if end:
            normalise(link, work.stage_pose, n + b)
        for k in range(link["freedoms"]):
            work.stage_twist[n + b, k] = work.velocity[b, k] + work.slopes[f + k, 1]
    if not largest < LARGEST_ROTATION * LARGEST_ROTATION:
        return ROTATION_TOO_LARGE if largest < math.inf else NOT_FINITE
    work.report[1] = max(work.report[1], largest)
    if end and (len(scheme.error) > 0 or len(work.angle) > 0):
        _place(model, work, work.stage_pose, work.stage_twist, work.stage_pose, work.stage_twist)
    return OK


@kernel
def _place(model, work, pose, twist, pose_out, twist_out):
    """Poses and twists of the bodies, from the rows of the links in pose and twist (n + L, ...)."""
    move_links(model, work, pose, twist, len(model.parts))
    place_links(model, work.relative, work.world)
    place_bodies(model, work.world, work.velocities, pose_out, twist_out)


@kernel
def accelerate(model, work, external):
    """Compute the accelerations of a stage. Returns -1, or the element with dependent rows."""
    joint = accelerations(model, work, external)
    return joint if joint < 0 else model.owners[joint]


@kernel
def store_slopes(model, work, scheme, group, stage):
    """Compute k of all links from the accelerations of a stage."""
    n, count = len(model.parts), len(work.freedoms)
    first = stage * count
    for b in range(len(model.bodies)):
        link = model.bodies[b]
        f, row = link["freedom"], n + b
        at = first + f
        kind = link["group"]
        # At stage 0 Psi is zero, and dexp^-1 the identity.
        if stage > 0 and kind >= PLANE:
            _store_curved(link, scheme, work.stage_twist, row, work.slopes, at)
        else:
            for k in range(link["freedoms"]):
                work.slopes[at + k, 0] = work.stage_twist[row, k]
        for k in range(link["freedoms"]):
            work.slopes[at + k, 1] = work.acceleration[f + k, 0]


@kernel
def _store_curved(link, scheme, rates, row, slopes, at):
    """dexp^-1_{-Psi} qdot of a link on SE(2), SO(3) or SE(3), to column 0 of slopes."""
    kind = link["group"]
    if kind == PLANE:
        xi, ex, ey = slopes[at, 0], slopes[at + 1, 0], slopes[at + 2, 0]
        x = xi * xi
    else:
        w_psi = (-slopes[at, 0], -slopes[at + 1, 0], -slopes[at + 2, 0])
        x = dot3(w_psi, w_psi)
    if scheme.highest == EXACT:
        first = 0.5
        b, u = dexpinv_coefficients(x)
    else:
        first, b, u = truncated_dexpinv_coefficients(scheme.highest, x)
    if kind == PLANE:
        w, vx, vy = rates[row, 0], rates[row, 1], rates[row, 2]
        gx, gy = ey * w - xi * vy, xi * vx - ex * w
        slopes[at, 0] = w
        slopes[at + 1, 0] = vx + first * gx - b * xi * gy
        slopes[at + 2, 0] = vy + first * gy + b * xi * gx
        return
    w = load3(rates, row, 0)
    if kind == BALL:
        w = so3_dexpinv_of(first, b, w_psi, w)
    else:
        v_psi = (-slopes[at + 3, 0], -slopes[at + 4, 0], -slopes[at + 5, 0])
        w, v = se3_dexpinv_of(first, b, u, w_psi, v_psi, w, load3(rates, row, 3))
        for c in range(3):
            slopes[at + 3 + c, 0] = v[c]
    for c in range(3):
        slopes[at + c, 0] = w[c]


@kernel
def check_end(model, work, h):
    """Check the end of a step of size h; see spaces.py."""
    if not is_finite(work.stage_pose, work.stage_twist):
        return NOT_FINITE
    fast = kinds.too_fast(model.space.forces, h, work.stage_pose, work.stage_twist)
    if fast >= 0:
        return TURNS_NOT_COUNTED + (fast << 8)
    return OK


@kernel
def error_square(model, work, scheme, row, h, twist, i, rtol, atol):
    """Square of an error estimate of the body that represents link i; see munthe_kaas.py.

    The differences of the freedoms add up along the tree: links come in the order of the tree.
    """
    link = model.bodies[i]
    count, links = len(work.freedoms), len(model.bodies)
    parts = work.difference
    for k in range(link["freedoms"]):
        psi, dq = 0.0, 0.0
        for stage in range(scheme.error.shape[1]):
            weight = scheme.error[row, stage]
            if weight != 0.0:
                at = stage * count + link["freedom"] + k
                psi += weight * work.slopes[at, 0]
                dq += weight * work.slopes[at, 1]
        parts[0, k], parts[1, k] = h * psi, h * dq
    xi, eta = rate_twist(link, parts, 0)
    dw, dv = rate_twist(link, parts, 1)
    a = link["parent"]
    place = row * links
    if a != WORLD:
        rot, p = load9(work.relative, i, 0), load3(work.relative, i, 9)
        at = place + a
        w, v = se3_Ad_inverse(rot, p, load3(work.errors, at, 0), load3(work.errors, at, 3))
        xi, eta = add3(xi, w), add3(eta, v)
        w, v = se3_Ad_inverse(rot, p, load3(work.errors, at, 6), load3(work.errors, at, 9))
        dw, dv = add3(dw, w), add3(dv, v)
    store3(xi, work.errors, place + i, 0)
    store3(eta, work.errors, place + i, 3)
    store3(dw, work.errors, place + i, 6)
    store3(dv, work.errors, place + i, 9)
    body = link["body"]
    if body < 0:
        return 0.0
    point = vector3(link["body_point"])
    eta, dv = add3(eta, cross3(xi, point)), add3(dv, cross3(dw, point))
    w0, w1 = load3(twist, body, 0), load3(work.stage_twist, body, 0)
    v0, v1 = load3(twist, body, 3), load3(work.stage_twist, body, 3)
    tol_w = atol + rtol * math.sqrt(max(dot3(w0, w0), dot3(w1, w1)))
    tol_v = atol + rtol * math.sqrt(max(dot3(v0, v0), dot3(v1, v1)))
    return (
        (dot3(xi, xi) + dot3(eta, eta)) / (atol * atol)
        + dot3(dw, dw) / (tol_w * tol_w)
        + dot3(dv, dv) / (tol_v * tol_v)
    )


@kernel
def close(model, work):
    """Project the end of a step onto the cut joints. Returns a status."""
    status = project(model, work, work.stage_pose, work.stage_twist)
    if status == OK and len(work.angle) > 0:
        _place(model, work, work.stage_pose, work.stage_twist, work.stage_pose, work.stage_twist)
    return status


@kernel
def count_turns(model, work):
    """Unwrap the angles of the torsional springs at the end of a step."""
    kinds.count_turns(model.space.forces, work.stage_pose, work.angle)
