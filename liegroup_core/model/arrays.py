# SPDX-License-Identifier: Apache-2.0
"""Arrays for kernels: Model, which is constant, and Work, scratch memory.

A joint of the scene consists of one or two constraint elements (joints.elements). Bodies and
`elements` are in the order of the scene. `elements` have the geometry and all rows of the joints;
`joints` are the elements with rows that are solved for. `vertices` are bodies and joints in
elimination order.
Body frames are at the centres of mass. Twist (omega, v) and wrench (torque, force) are in body
axes. A pose has twelve numbers: R row by row, then r.

    n bodies, m joints, s stages of the Runge-Kutta method
    a "row" is one forbidden direction of relative motion: a row of the Jacobian J

Each array is structured: one record per body, element, joint or vertex.
"""
import numpy as np

from liegroup_core.compiling import Struct, kernel
from liegroup_core.forces.kinds import count_of_angles, wanted_values

BODY = np.dtype([
    ("mass", "f8"), ("inverse_mass", "f8"),                       # kg, 1/kg
    ("inertia", "f8", (9,)), ("inverse_inertia", "f8", (9,)),     # kg m^2 about the COM, body axes
], align=True)

JOINT = np.dtype([
    ("parent", "i8"), ("child", "i8"),      # body index; the parent may be WORLD, the child not
    ("kind", "i8"), ("element", "i8"),      # kind of element, and its index in Model.elements
    ("rows", "i8"), ("start", "i8"),        # rows k it solves for, and their place in Work.solution
    ("first", "i8"),                        # the first of them in Model.row_residual and Work.slip
    ("child_place", "i8"), ("child_turned", "i8"),    # block of the child's rows J_b in K: its
    ("parent_place", "i8"), ("parent_turned", "i8"),  # place, and 1 where it holds J_b^T; parent
], align=True)

VERTEX = np.dtype([                         # body or joint in the order of elimination
    ("joint", "i8"),                        # which joint; -1: a body
    ("size", "i8"), ("start", "i8"),        # its scalars and their place in Work.solution
    ("is_constant", "i8"), ("diagonal", "i8"),      # 1: no pose changes its diagonal block, and
                                                    # that of a body is its mass; place
    ("column_start", "i8"), ("column_fresh", "i8"), # its range of Model.columns, and from where on
    ("column_end", "i8"),                           # poses change them
    ("update_start", "i8"), ("update_end", "i8"),   # its range of Model.updates
], align=True)


class Model(Struct):
    """Constant arrays of a scene. K and its blocks: see sparsity.py."""

    gravity: np.ndarray            # (1, 3) m/s^2, world axes
    bodies: np.ndarray             # (n,) of BODY
    forces: Struct                 # Forces: the rows of every kind (forces/kinds.py)
    motions: np.ndarray            # (d, 7) of each driven joint at the start: joints/motion.py
    elements: np.ndarray           # of joints.elements.ELEMENT
    joints: np.ndarray             # (m,) of JOINT
    row_residual: np.ndarray       # (rows,) which residual is that of a row that is solved for
    child_jacobian: np.ndarray     # (rows, 6) J_b = A Ad(F_b^-1) of every PAIR
    ground_projector: np.ndarray   # (m, 36) of a PAIR to ground: M^-1 J^T (J M^-1 J^T)^-1 J
    vertices: np.ndarray           # (n + m,) of VERTEX
    columns: np.ndarray            # (b, 3) a block below the diagonal: vertex of its rows, place,
                                   # and where poses change it that of its product
    updates: np.ndarray            # (u, 5) target place, places of both factors, vertices i and w
                                   # of its rows and columns: where poses change one of the factors
    pivot_floor: np.ndarray        # (6 n + rows,) pivots below are zero: rows depend on others
    constant: np.ndarray           # (blocks,) the part of K that no pose changes
    matrix: np.ndarray             # the same, constant vertices eliminated; then scratch memory
    summed: int                    # the first so many entries of `matrix` begin so at every pose;
    fresh: int                     # from there to here they are written anew
    refinements: int               # steps of iterative refinement that each solve takes
    projects: bool = False         # True: every step ends with dynamics.projection
    baumgarte_rate: float = 0.0    # 1/s, see dynamics.constraints; 0: no such terms


class Work(Struct):
    """Scratch memory of one simulation; only `angle` keeps its meaning between calls."""

    child_jacobian: np.ndarray     # (rows, 6) J_b at this pose, those of a PAIR constant
    slip: np.ndarray               # (rows,) J V
    gap: np.ndarray                # (all rows,) position residuals of the elements
    matrix: np.ndarray             # as Model.matrix: K, then its factor in place
    solution: np.ndarray           # (6 n + rows,) right-hand side, then Vdot and lambda
    kept: np.ndarray               # (blocks,) K, and solution twice: for refinement
    right: np.ndarray
    residual: np.ndarray
    wrench: np.ndarray             # (n, 6) sum of the applied wrenches
    angle: np.ndarray              # rad, of each torsional spring at the last finished step: state
    acting: np.ndarray             # bool, of each applied wrench of the scene: input of a call
    wanted: np.ndarray             # (k, 2) position and velocity of each servo: input of a call
    motions: np.ndarray            # (d, 7) motion of each driven joint: input of a call
    clock: np.ndarray              # (3,) input of a call: a step starts at clock[0] h + clock[1] s,
                                   # the next at (clock[0] + 1) h + clock[1]; then time of the stage
    stage_pose: np.ndarray         # (n, 12)
    stage_twist: np.ndarray        # (n, 6)
    start_pose: np.ndarray         # (n, 12) at the start of a step that is taken in substeps
    start_twist: np.ndarray        # (n, 6)
    start_angle: np.ndarray        # angle there
    velocity: np.ndarray           # (n, 6) velocity on the group at the start of the step
    slopes: np.ndarray             # ((s + 1) n, 12) k of stages and end: algebra, then velocity part
    report: np.ndarray             # (5,) largest squared rotation of a stage, rad^2: so far, this step;
                                   # number of solves at a singular pose; in relative coordinates
                                   # smallest pivot of W, round-off in accelerations of this step
    acceleration: np.ndarray = None    # (n, 6) those 6 n of `solution`: Q, then Vdot

    def __post_init__(self):
        # In copies, too, the same memory.
        shape = self.wrench.shape
        self.__dict__["acceleration"] = self.solution[:shape[0] * shape[1]].reshape(shape)
        super().__post_init__()


def make_work(model, stages):
    """Allocate the scratch memory of a model for a method of so many stages."""
    n, rows = len(model.bodies), len(model.row_residual)
    springs = count_of_angles(model.forces)
    return Work(
        child_jacobian=model.child_jacobian.copy(), slip=np.zeros(rows),
        gap=np.zeros(int(model.elements["rows"].sum())),
        matrix=model.matrix.copy(), solution=np.zeros(len(model.pivot_floor)),
        kept=model.constant.copy(), right=np.zeros(len(model.pivot_floor)),
        residual=np.zeros(len(model.pivot_floor)), wrench=np.zeros((n, 6)),
        angle=np.zeros(springs), start_angle=np.zeros(springs),
        acting=np.zeros(len(model.forces.applied_wrench), dtype=bool),
        wanted=wanted_values(model.forces), motions=model.motions.copy(), clock=np.zeros(3),
        stage_pose=np.zeros((n, 12)), stage_twist=np.zeros((n, 6)),
        start_pose=np.zeros((n, 12)), start_twist=np.zeros((n, 6)), velocity=np.zeros((n, 6)),
        slopes=np.zeros(((stages + 1) * n, 12)), report=np.zeros(5))


@kernel
def copy_state(source_pose, source_twist, pose_out, twist_out):
    """Copy pose (n, 12) and twist (n, 6) of a state."""
    for i in range(len(source_pose)):
        for c in range(12):
            pose_out[i, c] = source_pose[i, c]
        for c in range(6):
            twist_out[i, c] = source_twist[i, c]
