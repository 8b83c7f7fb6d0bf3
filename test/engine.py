# SPDX-License-Identifier: Apache-2.0
"""Results of the engine's kernels as dense arrays, for tests."""

import naive
import numpy as np

from liegroup_core.engine import Engine
from liegroup_core.formulations.absolute.constraints import assemble, position_residuals
from liegroup_core.formulations.relative.arrays import PlaneModel, RelativeModel
from liegroup_core.integrators.rkmk import spaces


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


def engine_accelerations(scene, wrenches=(), **options):
    """Accelerations (n, 6) at the initial state: body axes, at the centres of mass.

    wrenches : [(body, (6,) torque and force about the origin of the body's frame, "body" or
               "world")]
    options  : of the engine, such as space="space"

    The engine enters its first stage and solves there, as in a step. What it then has in its
    scratch memory is read as it is: a difference of velocities would lose digits.
    """
    simulation = Engine(scene, "rkmk4", quiet=True, **options)
    for body, wrench, axes in wrenches:
        simulation.apply_wrench(body, wrench, source=axes, axes=axes)
    simulation.advance(0)  # writes the wrenches of this instant
    integrator = simulation._integrator
    model, work = integrator._model, integrator._work
    pose, twist, external, status = spaces.enter(
        model, work, *simulation.state(), simulation._external
    )
    assert status == 0
    spaces.begin(model, work, integrator._group, pose, twist)
    assert spaces.accelerate(model, work, external) == -1
    if isinstance(model, RelativeModel):
        return _of_bodies(model, work, simulation.state()[0])
    return work.acceleration.copy()


def _of_bodies(model, work, pose):
    """Accelerations (n, 6) of the bodies, from those of their links less gravity."""
    gravity, links = model.gravity[0], work.moved
    if isinstance(model, PlaneModel):
        normal = model.axes[0, 2::3]
        gravity = gravity - normal * (normal @ gravity)
        links = np.zeros((len(work.moved), 6))
        links[:, 2:5] = work.moved
        links[:, 3:5] += work.drift
    found = np.zeros((len(pose), 6))
    for i, part in enumerate(model.parts):
        if part["link"] >= 0:
            turn, (w, v) = part["rotation"].reshape(3, 3), links[part["link"]].reshape(2, 3)
            found[i, :3], found[i, 3:] = w @ turn, (v + np.cross(w, part["point"])) @ turn
            found[i, 3:] += gravity @ pose[i, :9].reshape(3, 3)
    return found
