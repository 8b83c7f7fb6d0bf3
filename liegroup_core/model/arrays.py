# SPDX-License-Identifier: Apache-2.0
"""The arrays that kernels see: a constant Model, and Work, scratch memory without meaning of its own.

Bodies keep the order of the scene. A joint of the scene is one or two constraint elements
(joints.elements). `elements` keeps them in the scene's order, with all rows and what their
geometry is; `joints` are the same in the order in which the solve eliminates them, with the rows
it solves for.
Body frames sit at the centre of mass. Twist (omega, v) and wrench (torque, force) are
components in body axes; a pose is R row by row, then r: twelve numbers.

    n bodies, m elements, ns spring-dampers, s stages of the Runge-Kutta method
    a "row" of an element is one forbidden direction of relative motion: a row of the Jacobian J

A kind of thing is one structured array, a record per thing: kernels are handed few arrays, and
reading a field costs no reference count.
"""
from typing import NamedTuple

import numpy as np

WORLD = -1                                  # index of the world where a body is meant

BODY = np.dtype([
    ("mass", "f8"), ("inverse_mass", "f8"),                       # kg, 1/kg
    ("inertia", "f8", (9,)), ("inverse_inertia", "f8", (9,)),     # kg m^2 about the COM, body axes
], align=True)

SPRING_DAMPER = np.dtype([
    ("parent", "i8"), ("child", "i8"),                            # body index or WORLD
    ("parent_point", "f8", (3,)), ("child_point", "f8", (3,)),    # m, in the frame of each
    ("stiffness", "f8"), ("damping", "f8"), ("rest_length", "f8"),    # N/m, N s/m, m
], align=True)

ELEMENT = np.dtype([
    ("kind", "i8"), ("parent", "i8"), ("child", "i8"),      # the last two as in JOINT
    ("rows", "i8"), ("row_start", "i8"),    # its rows, and the first of them, in a residual
    ("parent_rotation", "f8", (9,)), ("parent_point", "f8", (3,)),    # its frame in the parent, m
    ("child_rotation", "f8", (9,)), ("child_point", "f8", (3,)),      # and in the child
    ("forbidden", "f8", (36,)), ("turns_freely", "i8"),     # A of a PAIR, see joints.elements
    ("pitch", "f8"), ("length", "f8"),                      # m/rad, m
], align=True)

JOINT = np.dtype([
    ("parent", "i8"), ("child", "i8"),      # body index; the parent may be WORLD, the child not
    ("kind", "i8"), ("element", "i8"),      # kind of element, and its index in Model.elements
    ("rows", "i8"), ("row_start", "i8"),    # number of rows k, and its first among all rows
    ("diagonal", "i8"),                     # place of its diagonal block of S
    ("column_start", "i8"), ("column_end", "i8"),     # its range of Model.columns
    ("update_start", "i8"), ("update_end", "i8"),     # its range of Model.updates
], align=True)


class Model(NamedTuple):
    """What does not change while a scene is integrated. From `products` on: see sparsity.py."""

    gravity: np.ndarray            # (1, 3) m/s^2, world axes
    bodies: np.ndarray             # (n,) of BODY
    springs: np.ndarray            # (ns,) of SPRING_DAMPER
    elements: np.ndarray           # (m,) of ELEMENT
    joints: np.ndarray             # (m,) of JOINT
    row_residual: np.ndarray       # (rows,) which residual is that of a row of the solve
    child_jacobian: np.ndarray     # (m, 36) rows A Ad(F_b^-1), the first 6 k used
    child_mobility: np.ndarray     # (m, 36) the same rows times M_b^-1
    products: np.ndarray           # (p, 5) place, joint i, side i, joint j, side j: S += J_i G_j^T
    columns: np.ndarray            # (b, 2) a block below the diagonal: joint of its rows, place
    updates: np.ndarray            # (u, 5) target place, places of L_i and L_k, joints i and k
    solve_constant: np.ndarray     # (blocks,) the part of S that no pose changes, or its factor
    solve_is_constant: bool        # True: all of S is constant and solve_constant is its factor
    projects: bool = False         # True: every step ends with dynamics.projection
    baumgarte_rate: float = 0.0    # 1/s, see dynamics.constraints; 0: no such terms


class Work(NamedTuple):
    """Scratch memory of one simulation; nothing in it outlives a call."""

    jacobian: np.ndarray           # (2 m, 36) child side (of a PAIR constant), then parent side
    mobility: np.ndarray           # (2 m, 36) the same rows times M^-1
    solve: np.ndarray              # (blocks,) S, then its factor in place
    multiplier: np.ndarray         # (rows,) lambda
    residual: np.ndarray           # (all rows,) of the elements' positions
    wrench: np.ndarray             # (n, 6) sum of applied and constraint wrenches
    acceleration: np.ndarray       # (n, 6) Vdot
    stage_pose: np.ndarray         # (n, 12)
    stage_twist: np.ndarray        # (n, 6)
    velocity: np.ndarray           # (n, 6) velocity on the group at the start of the step
    slopes: np.ndarray             # (s n, 12) stages k of each body: algebra, then velocity part
    report: np.ndarray             # (1,) largest squared rotation of a stage so far, rad^2


def make_work(model, stages):
    """Allocate the scratch memory of a model for a method of so many stages."""
    n, m = len(model.bodies), len(model.joints)
    work = Work(
        jacobian=np.zeros((2 * m, 36)), mobility=np.zeros((2 * m, 36)),
        solve=model.solve_constant.copy(),
        multiplier=np.zeros(int(model.joints["rows"].sum())),
        residual=np.zeros(int(model.elements["rows"].sum())),
        wrench=np.zeros((n, 6)), acceleration=np.zeros((n, 6)),
        stage_pose=np.zeros((n, 12)), stage_twist=np.zeros((n, 6)), velocity=np.zeros((n, 6)),
        slopes=np.zeros((stages * n, 12)), report=np.zeros(1))
    work.jacobian[:m] = model.child_jacobian
    work.mobility[:m] = model.child_mobility
    return work
