# SPDX-License-Identifier: Apache-2.0
"""What the engine's kernels compute, as dense arrays that tests can compare."""
import numpy as np

import naive
from liegroup_core.dynamics.constraints import assemble_rows, position_residuals


def residual(model, found):
    """Position residuals (all rows,) at poses (n, 4, 4)."""
    values = np.zeros(int(model.elements["rows"].sum()))
    position_residuals(model, naive.flat(found), values)
    return values


def rows(simulation, pose=None, twist=None, world_axes=False):
    """Jacobian (all rows, 6 n) and bias of a state, by default the simulation's.

    Its rows are in the order of `residual`.
    """
    model, work = simulation.layout.model, simulation._work
    pose = simulation.state()[0] if pose is None else pose
    twist = simulation.state()[1] if twist is None else twist
    found = np.zeros(len(model.row_residual))
    assemble_rows(model, work, pose, twist, world_axes, found)
    J, bias = np.zeros((len(found), 6 * len(pose))), np.zeros(len(found))
    bias[model.row_residual] = found
    m = len(model.joints)
    for j, joint in enumerate(model.joints):
        for r in range(joint["rows"]):
            row = model.row_residual[joint["row_start"] + r]
            for side, body in ((0, joint["child"]), (m, joint["parent"])):
                if body >= 0:
                    J[row, 6 * body:6 * body + 6] += work.jacobian[side + j, 6 * r:6 * r + 6]
    return J, bias


def masses(scene):
    """Mass matrix (6 n, 6 n) of all bodies in their body frames."""
    M = np.zeros((6 * len(scene.bodies), 6 * len(scene.bodies)))
    for i, body in enumerate(scene.bodies):
        M[6 * i:6 * i + 3, 6 * i:6 * i + 3] = body.inertia_matrix
        M[6 * i + 3:6 * i + 6, 6 * i + 3:6 * i + 6] = body.mass * np.eye(3)
    return M
