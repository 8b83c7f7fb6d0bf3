# SPDX-License-Identifier: Apache-2.0
"""Arrays of the planar kernels, as Model and Work for motions in space.

World and body axes are permuted so that the first two span the plane. The permutation only moves
numbers and changes their signs. In these axes a body rotates by an angle theta about the third axis:
    pose      (cos theta, sin theta, x, y), position of the centre of mass in m
    twist     (omega, v_1, v_2), v in body axes
    wrench    (torque, force_1, force_2), body axes
The rows of a joint are rows for (omega, v_1, v_2).
"""
import numpy as np

from liegroup_core.compiling import Struct
from liegroup_core.model.arrays import Model, Work

from .tree import COLUMNS

PLANAR_BODY = np.dtype([
    ("mass", "f8"), ("inertia", "f8"),          # kg; kg m^2 about the normal and the COM
    ("axes", "f8", (9,)),                       # rows: planar axes in body axes
], align=True)


class PlanarModel(Struct):
    """Constants of a planar mechanism; fields without a comment as in Model."""

    space: Model                   # the same mechanism in space
    has_forces: bool               # any force other than gravity
    world: np.ndarray              # (1, 9) rows: the planar axes in world axes
    gravity: np.ndarray            # (1, 2) m/s^2
    bodies: np.ndarray             # (n,) of PLANAR_BODY
    joints: np.ndarray             # (m,) of JOINT: lower pairs
    child_jacobian: np.ndarray     # (rows, 3) of all joints for their children
    ground_projector: np.ndarray   # (m, 9) of a joint to ground: M^-1 J^T (J M^-1 J^T)^-1 J
    vertices: np.ndarray
    columns: np.ndarray
    updates: np.ndarray
    pivot_floor: np.ndarray
    constant: np.ndarray
    matrix: np.ndarray
    summed: int
    fresh: int
    refinements: int
    projects: bool
    links: np.ndarray              # (n,) of tree.LINK for the O(n) solve of trees, else (0,): K is solved


class PlanarWork(Struct):
    """Scratch memory of one simulation; fields without a comment as in Work."""

    space: Work
    angle: np.ndarray              # that of `space`
    start_angle: np.ndarray        # that of `space`
    report: np.ndarray             # that of `space`
    pose: np.ndarray               # (n, 4)
    twist: np.ndarray              # (n, 3)
    external: np.ndarray           # (n, 7) external wrenches, see state.external_to_plane
    wrench: np.ndarray             # (n, 3) wrenches of the forces
    stage_pose: np.ndarray         # (n, 4)
    stage_twist: np.ndarray        # (n, 3)
    start_pose: np.ndarray         # (n, 4)
    start_twist: np.ndarray        # (n, 3)
    velocity: np.ndarray           # (n, 3)
    slopes: np.ndarray             # ((s + 1) n, 6)
    matrix: np.ndarray
    solution: np.ndarray
    links: np.ndarray              # (n, 17) see tree.py
    kept: np.ndarray
    right: np.ndarray
    residual: np.ndarray


def make_planar_work(model, work, stages):
    """Allocate the scratch memory of a PlanarModel; work: Work of the same mechanism."""
    n, unknowns = len(model.bodies), len(model.pivot_floor)
    return PlanarWork(
        space=work, angle=work.angle, start_angle=work.start_angle, report=work.report,
        pose=np.zeros((n, 4)), twist=np.zeros((n, 3)), external=np.zeros((n, 7)),
        wrench=np.zeros((n, 3)),
        stage_pose=np.zeros((n, 4)), stage_twist=np.zeros((n, 3)),
        start_pose=np.zeros((n, 4)), start_twist=np.zeros((n, 3)), velocity=np.zeros((n, 3)),
        slopes=np.zeros(((stages + 1) * n, 6)), matrix=model.matrix.copy(),
        solution=np.zeros(unknowns), kept=model.constant.copy(), right=np.zeros(unknowns),
        residual=np.zeros(unknowns), links=np.zeros((len(model.links), COLUMNS)))
