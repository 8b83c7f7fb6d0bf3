# SPDX-License-Identifier: Apache-2.0
"""Results of the engine's kernels as dense arrays, for tests."""

import naive
import numpy as np

from liegroup_core.formulations.absolute.constraints import assemble, position_residuals


def residual(model, found):
    """Position residuals (all rows,) at poses (n, 4, 4)."""
    values = np.zeros(int(model.elements["rows"].sum()))
    position_residuals(model, naive.flat(found), values)
    return values


def rows(simulation, pose=None, twist=None):
    """Jacobian (all rows, 6 n) and bias of a state, by default the simulation's.

    Rows are in the order of `residual`; redundant rows are zero.
    """
    model, work = simulation.layout.model, simulation._work
    pose = simulation.state()[0] if pose is None else pose
    twist = simulation.state()[1] if twist is None else twist
    assemble(model, work, pose, twist)
    count = int(model.elements["rows"].sum())
    J, bias = np.zeros((count, 6 * len(pose))), np.zeros(count)
    for j, joint in enumerate(model.joints):
        k, body = joint["rows"], 6 * joint["child"]
        where = model.row_residual[joint["first"] : joint["first"] + k]
        bias[where] = work.solution[joint["start"] : joint["start"] + k]
        J[where, body : body + 6] = work.child_jacobian[joint["first"] : joint["first"] + k]
        if joint["parent"] >= 0:
            body = 6 * joint["parent"]
            block = work.matrix[joint["parent_place"] : joint["parent_place"] + 6 * k]
            block = block.reshape(6, k).T if joint["parent_turned"] else block.reshape(k, 6)
            J[where, body : body + 6] = block
    return J, bias


def masses(scene):
    """Mass matrix (6 n, 6 n) of all bodies in their body frames."""
    M = np.zeros((6 * len(scene.bodies), 6 * len(scene.bodies)))
    for i, body in enumerate(scene.bodies):
        M[6 * i : 6 * i + 3, 6 * i : 6 * i + 3] = body.inertia_matrix
        M[6 * i + 3 : 6 * i + 6, 6 * i + 3 : 6 * i + 6] = body.mass * np.eye(3)
    return M
