# SPDX-License-Identifier: Apache-2.0
"""Stages of free bodies: steps.py for SE(3)^n only, without a branch on the motion group of every link.

See dynamics/free_bodies.py.
"""

from liegroup_core.compiling import borrowed, subroutine
from liegroup_core.lie.se3 import se3_compose, se3_dexpinv_of, se3_exp
from liegroup_core.lie.so3 import so3_nearest
from liegroup_core.lie.vec3 import (
    ZERO3,
    add3,
    axpy3,
    dot3,
    load3,
    load9,
    load_column,
    scale3,
    store3,
    store9,
    store_column,
)

from .series import dexpinv_series


@subroutine
def move_bodies(model, work, scheme, h, stage, end, pose_in):
    """Set all bodies to X_0 exp Psi of a stage; returns the largest squared rotation."""
    pose = borrowed(pose_in)
    n, slopes, largest = len(model.bodies), work.slopes, 0.0
    for i in range(n):
        xi, eta, dw, dv = ZERO3, ZERO3, ZERO3, ZERO3
        for other in range(stage):
            weight, at = scheme.a[stage, other], 6 * (other * n + i)
            if weight != 0.0:
                xi = axpy3(weight, load_column(slopes, at, 0), xi)
                eta = axpy3(weight, load_column(slopes, at + 3, 0), eta)
                dw = axpy3(weight, load_column(slopes, at, 1), dw)
                dv = axpy3(weight, load_column(slopes, at + 3, 1), dv)
        xi, eta = scale3(h, xi), scale3(h, eta)
        rotation = dot3(xi, xi)
        largest = max(largest, rotation)
        turn, shift = se3_exp(xi, eta)
        rot, r = se3_compose(load9(pose, n + i, 0), load3(pose, n + i, 9), turn, shift)
        if end:
            rot = so3_nearest(rot)
        at = 6 * (stage * n + i)
        store_column(xi, slopes, at, 0)
        store_column(eta, slopes, at + 3, 0)
        store9(rot, work.stage_pose, n + i, 0)
        store3(r, work.stage_pose, n + i, 9)
        w, v = load3(work.velocity, i, 0), load3(work.velocity, i, 3)
        store3(add3(w, scale3(h, dw)), work.stage_twist, n + i, 0)
        store3(add3(v, scale3(h, dv)), work.stage_twist, n + i, 3)
    return largest


@subroutine
def store_slopes_of_bodies(model, work, scheme, stage):
    """Stage derivatives k of all bodies, from the accelerations of a stage."""
    n, slopes = len(model.bodies), work.slopes
    for i in range(n):
        w, v, at = (load3(work.stage_twist, n + i, 0), load3(work.stage_twist, n + i, 3), 6 * (stage * n + i))
        if stage > 0:
            xi = scale3(-1.0, load_column(slopes, at, 0))
            eta = scale3(-1.0, load_column(slopes, at + 3, 0))
            first, b, u = dexpinv_series(scheme, dot3(xi, xi))
            w, v = se3_dexpinv_of(first, b, u, xi, eta, w, v)
        store_column(w, slopes, at, 0)
        store_column(v, slopes, at + 3, 0)
        store_column(load_column(work.acceleration, 6 * i, 0), slopes, at, 1)
        store_column(load_column(work.acceleration, 6 * i + 3, 0), slopes, at + 3, 1)
    return 0
