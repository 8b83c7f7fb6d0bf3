# SPDX-License-Identifier: Apache-2.0
"""Arrays for kernels: Model, which is constant, and Work, scratch memory.

A joint of the scene consists of one or two constraint elements (joints.elements). Bodies and
`elements` are in the order of the scene. `elements` have the geometry and all rows of the joints.
Body frames are at the centres of mass. Twist (omega, v) and wrench (torque, force) are in body
axes. A pose has twelve numbers: R row by row, then r.

    n bodies, s stages of the method
    a "row" is one forbidden direction of relative motion: a row of the Jacobian J
"""
import numpy as np

from liegroup_core.compiling import Record, Struct, kernel, shaped
from liegroup_core.forces.kinds import count, target_values

BODY = np.dtype([
    ("mass", "f8"), ("inverse_mass", "f8"),                       # kg, 1/kg
    ("inertia", "f8", (9,)), ("inverse_inertia", "f8", (9,)),     # kg m^2 about the COM, body axes
], align=True)

# Numbers of Work.report: largest squared rotation of a stage, rad^2, so far and in this step; number of
# solves at a singular pose; smallest pivot of W; round-off in accelerations of this step; number of factors of W
# near a singular pose; largest depth of a contact of two bodies at the end of a step without events, over
# Laws.closing["size"], and its number there.
LARGEST_TURN, STEP_TURN, SINGULAR_SOLVES, PIVOT, ROUND_OFF, NEAR_SOLVES, DEEPEST, DEEPEST_OF = range(8)


class CallTimes(Record):
    """Times of a call of a method: a step starts at count h + offset s, the next at (count + 1) h + offset."""

    count: np.ndarray = shaped(1)
    offset: np.ndarray = shaped(1)
    now: np.ndarray = shaped(1)        # s, of the stage
    from_step: np.ndarray = shaped(1)  # the call leads from these whole steps, and s after them,
    since: np.ndarray = shaped(1)
    to_step: np.ndarray = shaped(1)    # to these
    until: np.ndarray = shaped(1)
    step_size: np.ndarray = shaped(1)  # s


class Model(Struct):
    """Constant arrays of the bodies of a scene, its forces and the elements of its joints."""

    gravity: np.ndarray            # (1, 3) m/s^2, world axes
    bodies: np.ndarray             # (n,) of BODY
    forces: Struct                 # Forces: the rows of every kind (forces/kinds.py)
    rotors: np.ndarray             # of forces.rotors.ROW: rotors of joints
    motions: np.ndarray            # (d, 7) of each driven joint at the start: joints/motion.py
    elements: np.ndarray           # of joints.elements.ELEMENT
    row_residual: np.ndarray       # (rows,) which residuals are those of independent rows
    refinements: int               # steps of iterative refinement that a solve with all rows takes
    projects: bool = False         # True: every step ends with a projection onto the constraints
    baumgarte_rate: float = 0.0    # 1/s, of Baumgarte's terms; 0: no such terms


class Work(Struct):
    """Memory of one simulation; `angle`, `targets`, `motions` and counts of the report hold between calls."""

    wrench: np.ndarray             # (n, 6) sum of the applied wrenches
    angle: np.ndarray              # rad, of each of forces.counted at the last finished step, and states of laws
    start_angle: np.ndarray        # the same at the start of a step that is taken in substeps
    targets: np.ndarray            # (k, 2) position and velocity of each servo: input of a call
    registers: np.ndarray          # (m, 2) of the laws of the scene
    motions: np.ndarray            # (d, 7) motion of each driven joint: input of a call
    clock: CallTimes
    stage_pose: np.ndarray         # (n, 12)
    stage_twist: np.ndarray        # (n, 6)
    slopes: np.ndarray             # ((s + 1) n, 12) k of stages and end: algebra, then velocity part
    report: np.ndarray             # (8,) LARGEST_TURN .. DEEPEST_OF


def make_work(model, stages):
    """Allocate the scratch memory of a model for a method with this number of stages."""
    n = len(model.bodies)
    kept = count(model.forces)
    return Work(
        wrench=np.zeros((n, 6)), angle=np.zeros(kept), start_angle=np.zeros(kept),
        targets=target_values(model.forces), registers=model.forces.laws.registers.copy(),
        motions=model.motions.copy(), clock=CallTimes.make(),
        stage_pose=np.zeros((n, 12)), stage_twist=np.zeros((n, 6)),
        slopes=np.zeros(((stages + 1) * n, 12)), report=np.zeros(8))


@kernel
def copy_state(source_pose, source_twist, pose_out, twist_out):
    """Copy pose (n, 12) and twist (n, 6) of a state."""
    for i in range(len(source_pose)):
        for c in range(12):
            pose_out[i, c] = source_pose[i, c]
        for c in range(6):
            twist_out[i, c] = source_twist[i, c]
