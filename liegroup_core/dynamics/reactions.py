# SPDX-License-Identifier: Apache-2.0
"""Wrenches that the joints of the scene transmit, in O(n): one solve for accelerations, one sweep.

The joints of a body must supply M Vdot - ad_V^T M V minus the applied wrenches. The wrenches of cut joints
follow from their multipliers. With these subtracted, a tree joint transmits the sum over all bodies behind
it. The sweep runs over the joints of the scene, so it includes welds and, in a planar mechanism, the
components normal to its plane.

Source: Featherstone, Rigid Body Dynamics Algorithms, section 5.3 (recursive Newton-Euler).
"""

import math

import numpy as np

from liegroup_core.compiling import Struct, borrowed, kernel, stepper
from liegroup_core.joints.elements import WORLD
from liegroup_core.lie.se3 import se3_Ad_inverse
from liegroup_core.lie.vec3 import (
    ZERO3,
    add3,
    cross3,
    load3,
    load9,
    matmul3,
    matrix3,
    matvec3,
    scale3,
    store3,
    sub3,
    tmatvec3,
    vector3,
)
from liegroup_core.mechanism.arrays import COORDINATE, EFFORT, KNOWN, RESTS, SIDE, SLIP
from liegroup_core.mechanism.bodies import SINGULAR_SOLVES
from liegroup_core.mechanism.spanning_tree import WORLD_NAME, spanning_tree
from liegroup_core.scene.consistency import resolve_frames

from .accelerations import apply_forces, balance
from .coordinates import coordinates, place_links
from .impulses import add_impulse, clear_impulses, factor_rows, respond_to_impulses
from .state import enter_states
from .trees import move_links


class ReactionTable(Struct):
    """Joints of a scene for `joint_wrenches`; J joints, t of them in the tree, c cut elements."""

    ends: np.ndarray  # (J, 2) body indices of parent and child; the parent may be WORLD
    frames: np.ndarray  # (J, 12) joint frame in the frame of the child: R row by row, then r
    order: np.ndarray  # (t, 3) tree joints, leaves first: joint, body behind it, body before it
    owners: np.ndarray  # (c,) joint of each cut element that is solved for; -1: a coupling, or a
    # stop of a joint of the tree
    hidden: np.ndarray  # (J, 6) bool: components that are NaN in the results
    lacking: np.ndarray  # (n, 6) scratch: wrench that a body needs from its joints, world axes, about its COM


def reaction_table(layout):
    """ReactionTable of a Layout; its cut joints are those of `layout.relative_in_space`."""
    scene, model = layout.centred, layout.relative_in_space
    index = {body.name: i for i, body in enumerate(scene.bodies)} | {WORLD_NAME: WORLD}
    ends = [(index[joint.parent], index[joint.child]) for joint in scene.joints]
    cut = set(spanning_tree(scene).cut)
    beside = {}
    for j, (a, b) in enumerate(ends):
        if j not in cut:
            beside.setdefault(a, []).append((j, b))
            beside.setdefault(b, []).append((j, a))
    order, reached = [], set()
    for root in (WORLD, *range(len(scene.bodies))):
        pending = [] if root in reached else [root]
        reached.add(root)
        for body in pending:
            for j, behind in beside.get(body, ()):
                if behind not in reached:  # else a weld that closes a loop of welds
                    reached.add(behind)
                    pending.append(behind)
                    order.append((j, behind, body))
    coupled = model.coupling >= 0
    of_row = {int(s["row"]): int(s["joint"]) for s in model.switches if s["row"] >= 0}
    owners = []
    for k, cut in enumerate(model.cuts):
        own = -1 if coupled[k] else of_row.get(int(cut["first"]))
        owners.append(layout.owners[model.owners[k]] if own is None else own)
    return ReactionTable(
        ends=np.array(ends, dtype=np.int64).reshape(-1, 2),
        frames=np.array([[*B[:3, :3].ravel(), *B[:3, 3]] for _, B in resolve_frames(scene)], dtype=float).reshape(
            -1, 12
        ),
        order=np.array(order[::-1], dtype=np.int64).reshape(-1, 3),
        owners=np.array(owners, dtype=np.int64),
        hidden=np.zeros((len(ends), 6), dtype=bool),
        lacking=np.zeros((len(scene.bodies), 6)),
    )


@kernel
def _set_lacking(model, work, table, weight, out):
    """Write the wrench that each body needs from its joints to table.lacking, its motion to out[J:].

    weight : 1, or 0 without gravity
    """
    poses, first = work.space.stage_pose, len(table.ends)
    for i in range(len(model.bodies)):
        body, solid, rot = model.bodies[i], model.space.bodies[i], load9(poses, i, 0)
        b, turn, at = body["link"], matrix3(body["rotation"]), vector3(body["point"])
        if b == WORLD:
            g = scale3(weight, tmatvec3(rot, load3(model.gravity, 0, 0)))
            w, v, dw, dv = ZERO3, ZERO3, ZERO3, (-g[0], -g[1], -g[2])
        else:
            w, v = se3_Ad_inverse(turn, at, load3(work.velocities, b, 0), load3(work.velocities, b, 3))
            dw, dv = se3_Ad_inverse(turn, at, load3(work.moved, b, 0), load3(work.moved, b, 3))
        inertia = matrix3(solid["inertia"])
        torque = add3(matvec3(inertia, dw), cross3(w, matvec3(inertia, w)))
        dv = add3(dv, cross3(w, v))
        store3(dw, out, first + i, 0)
        store3(dv, out, first + i, 3)
        force = scale3(solid["mass"], dv)
        torque, force = (sub3(torque, load3(work.wrench, i, 0)), sub3(force, load3(work.wrench, i, 3)))
        store3(matvec3(rot, torque), table.lacking, i, 0)
        store3(matvec3(rot, force), table.lacking, i, 3)


@kernel
def _add_at(work, body, torque, force, point, sign, out):
    """Add sign times a wrench about a point, world axes, to that of a body about its COM."""
    torque = add3(torque, cross3(sub3(point, load3(work.space.stage_pose, body, 9)), force))
    for c in range(3):
        out[body, c] += sign * torque[c]
        out[body, 3 + c] += sign * force[c]


@kernel
def _take_cut_joints(model, work, table, out):
    """Write the wrenches of cut joints, world axes about the child's COM; subtract them from table.lacking."""
    for k in range(len(model.cuts)):
        cut, owner = model.cuts[k], table.owners[k]
        if owner < 0:
            continue
        b = cut["child"]
        torque, force = ZERO3, ZERO3
        for r in range(cut["first"], cut["first"] + cut["rows"]):
            size = -work.multipliers[r]
            torque = add3(torque, scale3(size, load3(work.child_jacobian, r, 0)))
            force = add3(force, scale3(size, load3(work.child_jacobian, r, 3)))
        rot, at = load9(work.world, b, 0), load3(work.world, b, 9)
        torque, force = matvec3(rot, torque), matvec3(rot, force)
        parent, child = table.ends[owner, 0], table.ends[owner, 1]
        _add_at(work, child, torque, force, at, -1.0, table.lacking)
        if parent != WORLD:
            _add_at(work, parent, torque, force, at, 1.0, table.lacking)
        torque = add3(torque, cross3(sub3(at, load3(work.space.stage_pose, child, 9)), force))
        for c in range(3):
            out[owner, c] += torque[c]
            out[owner, 3 + c] += force[c]


@kernel
def _begin(model, work, pose, twist):
    """Set the stage to a state: pose (n, 12), twist (n, 6) of the bodies."""
    n = len(model.bodies)
    for i in range(n):
        for c in range(12):
            work.pose[i, c] = work.stage_pose[i, c] = work.space.stage_pose[i, c] = pose[i, c]
        for c in range(6):
            work.twist[i, c] = work.stage_twist[i, c] = work.space.stage_twist[i, c] = twist[i, c]
    coordinates(model, work, work.pose, work.twist)
    enter_states(model, work, work.twist)
    for b in range(n, n + len(model.links)):
        for c in range(12):
            work.stage_pose[b, c] = work.pose[b, c]
        for c in range(6):
            work.stage_twist[b, c] = work.twist[b, c]
    move_links(model, work)
    place_links(model, work)


@kernel
def _sweep(model, work, table, weight, out):
    """Wrenches of all joints for the accelerations of the links; see joint_wrenches."""
    for j in range(len(table.ends)):
        for c in range(6):
            out[j, c] = 0.0
    _set_lacking(model, work, table, weight, out)
    _take_cut_joints(model, work, table, out)
    lacking, poses = table.lacking, work.space.stage_pose
    for k in range(len(table.order)):
        j, behind, before = table.order[k, 0], table.order[k, 1], table.order[k, 2]
        torque, force = load3(lacking, behind, 0), load3(lacking, behind, 3)
        at, child = load3(poses, behind, 9), table.ends[j, 1]
        if before != WORLD:
            _add_at(work, before, torque, force, at, 1.0, lacking)
        sign = 1.0 if child == behind else -1.0
        torque = add3(torque, cross3(sub3(at, load3(poses, child, 9)), force))
        store3(scale3(sign, torque), out, j, 0)
        store3(scale3(sign, force), out, j, 3)
    for j in range(len(table.ends)):
        rot = load9(poses, table.ends[j, 1], 0)
        force = load3(out, j, 3)
        torque = sub3(load3(out, j, 0), cross3(matvec3(rot, load3(table.frames, j, 9)), force))
        axes = matmul3(rot, load9(table.frames, j, 0))
        store3(tmatvec3(axes, torque), out, j, 0)
        store3(tmatvec3(axes, force), out, j, 3)
        for c in range(6):
            if table.hidden[j, c]:
                out[j, c] = math.nan


@kernel
def copy_modes(from_model, from_work, model, work_out):
    """Copy the modes of the switches from another model of the same scene; returns whether they are known."""
    for f in range(len(work_out.held)):
        work_out.held[f] = 0.0
    known = True
    for k in range(len(model.switches)):
        there, here = from_model.switches[k], model.switches[k]
        work_out.held[here["freedom"]] = from_work.held[there["freedom"]]
        work_out.modes[k, RESTS] = from_work.modes[k, RESTS]
        sign = there["sign"] * here["sign"]
        for c in (SLIP, SIDE, COORDINATE, EFFORT):
            work_out.modes[k, c] = sign * from_work.modes[k, c]
        known = known and from_work.modes[k, KNOWN] != 0.0
        work_out.modes[k, KNOWN] = 1.0
    return known


@stepper
def joint_wrenches(model, work, table, pose_in, twist_in, external_in, out_in):
    """Wrench of every joint on its child: torque, force in the axes of the child's joint frame.

    pose (n, 12), twist (n, 6) : of the bodies;  external : (n, COLUMNS), see forces/external.py
    out : (J + n, 6) the wrenches, NaN where table.hidden; then angular acceleration and specific force
          (acceleration minus gravity) of each body at its centre of mass, in its axes
    The torque is about the origin of the joint frame. Redundant rows are eliminated and transmit nothing. A
    coupling acts along the degrees of freedom of its joints. Springs, motors and other forces are excluded;
    stops and friction are included, in the modes of work.held and work.modes. Returns -1, -2 at a singular
    pose, or the joint with dependent rows if the solve fails.
    """
    pose, twist = borrowed(pose_in), borrowed(twist_in)
    external, out = borrowed(external_in), borrowed(out_in)
    regular = work.report[SINGULAR_SOLVES]
    _begin(model, work, pose, twist)
    apply_forces(model, work, external)
    found = balance(model, work)
    if found >= 0:
        return found
    _sweep(model, work, table, 1.0, out)
    return -1 if work.report[SINGULAR_SOLVES] == regular else -2


@stepper
def impulse_wrenches(model, work, table, pose, twist, impulses, out):
    """Impulses of every joint on its child at an impact; as joint_wrenches, in N m s and N s.

    pose     : (n, 12) of the bodies;  twist : (n, 6) zeros
    impulses : (k,) of the stops on the coordinates of the links of the switches
    returns -1, or the joint with dependent rows if the solve fails
    """
    _begin(model, work, pose, twist)
    for i in range(len(model.bodies)):
        for c in range(6):
            work.wrench[i, c] = 0.0
    found = factor_rows(model, work)
    if found >= 0:
        return found
    clear_impulses(model, work)
    for k in range(len(model.switches)):
        add_impulse(model, work, k, impulses[k])
    respond_to_impulses(model, work)
    _sweep(model, work, table, 0.0, out)
    return -1
