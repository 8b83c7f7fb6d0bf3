# SPDX-License-Identifier: Apache-2.0
"""External wrenches at one instant: for every body a part in body axes and a part in world axes.

Both act at the origin of the body frame. The part in world axes keeps its direction in the world
while the body rotates, also between the stages of a step.

Forces F_i in world axes at body-fixed points p_i have the torque

    sum p_i x R^T F_i = sum over k of e_k x R^T G_k ,   G_k = sum of p_ik F_i

about the origin, in body axes. The levers G = sum of p_i F_i^T (3, 3) therefore represent any number of such
forces exactly, at every attitude.

A pull is a spring with a damper from a point p of the body to a fixed point in the world, and a torque with a damper:

    force  k (x* - x_p) - c v_p  at p        torque  n - d omega        world axes

It acts in each run on the state of this run, so two runs that differ are not pushed apart.

Columns of the array (n, COLUMNS) that the integrators receive:
    0..5    torque N m, force N in body axes, about the centre of mass
    6..11   torque N m, force N in world axes, about the origin of the body frame
    12..14  centre of mass in the body frame, m
    15      2 if any of 16..24 is not zero, else 1 if any of 6..11 is not zero
    16..24  levers G by rows, N m
    25      1 if a pull acts;  26, 27  k N/m, c N s/m;  28..30  x* m;  31..33  p m, relative to the centre of mass
    34..36  n N m;  37  d N m s/rad
"""

import numpy as np

from liegroup_core.compiling import kernel
from liegroup_core.lie.vec3 import add3, axpy3, cross3, load3, load9, matmul3, matvec3, scale3, store3, sub3, tmatvec3

COLUMNS, PULL = 38, 25
PULL_VALUES = COLUMNS - PULL - 1


def no_wrenches(offsets):
    """Array (n, COLUMNS) without a wrench; offsets: Offsets of the scene."""
    external = np.zeros((len(offsets.com), COLUMNS))
    external[:, 12:15] = offsets.com
    return external


def set_wrench(external, body, wrench, axes):
    """Set the total of a body in one of the axes of Schedule.total: body, world (6,), levers (9,) or pull (12,)."""
    if axes == "pull":
        external[body, PULL] = float(any(wrench))
        external[body, PULL + 1 :] = wrench
        external[body, PULL + 6 : PULL + 9] -= external[body, 12:15] * external[body, PULL]
        return
    if not any(wrench):
        wrench = (0.0,) * len(wrench)  # no negative zeros: equal totals have equal bits
    if axes == "body":
        com = tuple(external[body, 12:15].tolist())
        if any(com):  # otherwise the numbers stay bit-identical
            wrench = (*sub3(wrench[:3], cross3(com, tuple(wrench[3:]))), *wrench[3:])
        external[body, :6] = wrench
        return
    first = 6 if axes == "world" else 16
    external[body, first : first + len(wrench)] = wrench
    turning = external[body, 16:PULL].any()
    external[body, 15] = 2.0 if turning else float(external[body, 6:12].any())


def acts(external):
    """Whether any external wrench or pull acts."""
    return bool(external[:, :6].any() or external[:, 15].any() or external[:, PULL].any())


def power(external, pose, twist):
    """Power of external wrenches in a state at the centres of mass, W."""
    wrench = np.zeros_like(twist)
    set_external_wrenches(external, pose, twist, wrench)
    return float(np.vdot(wrench, twist))


def _moment(point, force):
    """Cross product of arrays (3,), much faster than np.cross."""
    return cross3(tuple(point.tolist()), tuple(force.tolist()))


@kernel
def _pushed(external, pose, i):
    """(torque, force) of the wrenches on body i about its centre of mass, body axes."""
    torque, force = load3(external, i, 0), load3(external, i, 3)
    if external[i, 15] != 0.0:
        rot = load9(pose, i, 0)
        turned = tmatvec3(rot, load3(external, i, 9))
        moment = sub3(tmatvec3(rot, load3(external, i, 6)), cross3(load3(external, i, 12), turned))
        torque, force = add3(torque, moment), add3(force, turned)
        if external[i, 15] == 2.0:
            levers = matmul3(load9(external, i, 16), rot)
            torque = add3(torque, (levers[5] - levers[7], levers[6] - levers[2], levers[1] - levers[3]))
    return torque, force


@kernel
def _pull(external, i, rot, stretch, speed, turn):
    """(torque, force) of a pull about the centre of mass, body axes.

    stretch, speed, turn : x* - x_p in world axes, v_p and omega in body axes
    """
    force = axpy3(-external[i, PULL + 2], speed, scale3(external[i, PULL + 1], tmatvec3(rot, stretch)))
    torque = axpy3(-external[i, PULL + 12], turn, cross3(load3(external, i, PULL + 6), force))
    return torque, force


@kernel
def _pulled(external, pose, twist, i):
    """(torque, force) of the pull at body i about its centre of mass, body axes."""
    rot, point, turn = load9(pose, i, 0), load3(external, i, PULL + 6), load3(twist, i, 0)
    stretch = sub3(load3(external, i, PULL + 3), add3(load3(pose, i, 9), matvec3(rot, point)))
    speed = add3(load3(twist, i, 3), cross3(turn, point))
    torque, force = _pull(external, i, rot, stretch, speed, turn)
    return add3(torque, tmatvec3(rot, load3(external, i, PULL + 9))), force


@kernel
def external_wrench(external, pose, twist, i):
    """Torque about the centre of mass and force on body i, with its pull, in a state; body axes."""
    torque, force = _pushed(external, pose, i)
    if external[i, PULL] != 0.0:
        more = _pulled(external, pose, twist, i)
        torque, force = add3(torque, more[0]), add3(force, more[1])
    return torque, force


@kernel
def set_external_wrenches(external, pose, twist, wrench_out):
    """Write `external_wrench` of all bodies to wrench_out (n, 6)."""
    for i in range(len(wrench_out)):
        torque, force = external_wrench(external, pose, twist, i)
        store3(torque, wrench_out, i, 0)
        store3(force, wrench_out, i, 3)


def parts_of_wrench(wrench, axes, point):
    """[(axes of Schedule.total, values)] equivalent to a wrench whose force acts at a point of the body.

    wrench : (6,) torque N m, force N, in "body" or "world" axes
    point  : (3,) m, in the body frame; None: its origin
    """
    if point is None:
        return [(axes, wrench)]
    torque, force = np.array(wrench[:3]), np.array(wrench[3:])
    if axes == "body":
        return [(axes, np.concatenate([torque + _moment(np.array(point), force), force]))]
    return [(axes, wrench), ("levers", np.outer(point, force).ravel())]


@kernel
def set_changes(external, more, at, pose, twist, moves, rates, wrench_out):
    """Write the changes of the external wrenches along displacements, see kinds.add_changes, to wrench_out (n, 6).

    more : changes of their columns in body axes, from row `at` on
    """
    for i in range(len(wrench_out)):
        torque, force = load3(more, at + i, 0), load3(more, at + i, 3)
        if external[i, 15] != 0.0:
            rot, turn = load9(pose, i, 0), load3(moves, i, 0)
            moved = cross3(tmatvec3(rot, load3(external, i, 9)), turn)
            moment = cross3(tmatvec3(rot, load3(external, i, 6)), turn)
            torque = add3(torque, sub3(moment, cross3(load3(external, i, 12), moved)))
            force = add3(force, moved)
            if external[i, 15] == 2.0:
                x, y, z = turn
                levers = matmul3(matmul3(load9(external, i, 16), rot), (0.0, -z, y, z, 0.0, -x, -y, x, 0.0))
                torque = add3(torque, (levers[5] - levers[7], levers[6] - levers[2], levers[1] - levers[3]))
        if external[i, PULL] != 0.0:
            rot, turn, point = load9(pose, i, 0), load3(moves, i, 0), load3(external, i, PULL + 6)
            moved = add3(load3(moves, i, 3), cross3(turn, point))  # of the point, body axes
            speed = add3(load3(rates, i, 3), cross3(load3(rates, i, 0), point))
            along = _pull(external, i, rot, matvec3(rot, scale3(-1.0, moved)), speed, load3(rates, i, 0))
            at_point = add3(load3(pose, i, 9), matvec3(rot, point))
            spring = tmatvec3(rot, sub3(load3(external, i, PULL + 3), at_point))
            turned = scale3(external[i, PULL + 1], cross3(spring, turn))  # the spring's force turns back in the body
            torque = add3(torque, add3(along[0], cross3(point, turned)))
            torque = add3(torque, cross3(tmatvec3(rot, load3(external, i, PULL + 9)), turn))
            force = add3(force, add3(along[1], turned))
        store3(torque, wrench_out, i, 0)
        store3(force, wrench_out, i, 3)
