# SPDX-License-Identifier: Apache-2.0
"""Results of the engine's kernels as dense arrays, for tests."""

import naive
import numpy as np

from liegroup_core.dynamics.constraints import position_residuals
from liegroup_core.dynamics.coordinates import lift_links, place_links
from liegroup_core.dynamics.coupled_rows import set_all_rows
from liegroup_core.dynamics.loops import gather_alone, project
from liegroup_core.dynamics.state import place
from liegroup_core.dynamics.trees import move_links
from liegroup_core.engine import Engine
from liegroup_core.lie.groups import SE3
from liegroup_core.mechanism.arrays import PlaneModel, make_relative_work
from liegroup_core.mechanism.bodies import make_work
from liegroup_core.methods.munthe_kaas import steps


def residual(model, found):
    """Position residuals (all rows,) at poses (n, 4, 4)."""
    values = np.zeros(int(model.elements["rows"].sum()))
    position_residuals(model, naive.flat(found), values)
    return values


def at_stage(simulation, pose=None, twist=None):
    """(model, work) of a Munthe-Kaas method whose stage is a state, by default the simulation's."""
    model, work = simulation._integrator.mechanism
    _set_stage(simulation, model, work, pose, twist)
    return model, work


def _set_stage(simulation, model, work, pose, twist):
    pose = simulation.state()[0] if pose is None else pose
    twist = simulation.state()[1] if twist is None else twist
    work.known[0] = 0.0  # the coordinates are found from the state
    steps.enter(model, work, pose, twist, simulation.inputs.acting.external)
    steps.begin(model, work, work.pose, work.twist)
    work.known[0] = 0.0


def rows(simulation, pose=None, twist=None):
    """Jacobian (all rows, 6 n) and bias of a state, by default that of the simulation.

    With an empty tree, whatever the tree of the simulation. Rows are in the order of `residual`;
    redundant rows, and those of joints that weld bodies, are zero. Columns of bodies that are
    welded together are those of the first of them.
    """
    model = simulation.layout.floating("se3")
    work = make_relative_work(model, make_work(model.space, 1), 1)
    _set_stage(simulation, model, work, pose, twist)
    for kernel in (move_links, place_links, lift_links, gather_alone, set_all_rows):
        kernel(model, work)
    space = simulation.layout.model
    J = np.zeros((int(space.elements["rows"].sum()), 6 * len(model.bodies)))
    bias = np.zeros(len(J))
    for joint, owner in zip(model.cuts, model.owners):
        of = slice(joint["first"], joint["first"] + joint["rows"])
        first = model.elements["row_start"][joint["element"]]
        where = model.row_residual[of] - first + space.elements["row_start"][owner]
        bias[where] = work.bias[of]
        for link, jacobian in ((joint["child"], work.child_jacobian), (joint["parent"], work.parent_jacobian)):
            if link >= 0:
                body = int(np.argmax(model.bodies["link"] == link))
                part = model.bodies[body]
                own = naive.matrices(np.concatenate([part["rotation"], part["point"]])[None])[0]
                J[where, 6 * body : 6 * body + 6] = jacobian[of] @ SE3.Ad(own)
    return J, bias


def placed(model, work):
    """(pose, twist) of all bodies at the stage."""
    pose, twist = work.pose[: len(model.bodies)].copy(), work.twist[: len(model.bodies)].copy()
    place(model, work, pose, twist)
    return pose, twist


def projected(simulation, pose, twist):
    """(status, pose, twist) after the projection of a state onto the cut joints."""
    model, work = at_stage(simulation, pose, twist)
    status = project(model, work)
    return status, *placed(model, work)


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
    model, work = at_stage(simulation)
    assert steps.accelerate(model, work, simulation.inputs.acting.external) == -1
    return _of_bodies(model, work, simulation.state()[0])


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
    for i, part in enumerate(model.bodies):
        if part["link"] >= 0:
            turn, (w, v) = part["rotation"].reshape(3, 3), links[part["link"]].reshape(2, 3)
            found[i, :3], found[i, 3:] = w @ turn, (v + np.cross(w, part["point"])) @ turn
            found[i, 3:] += gravity @ pose[i, :9].reshape(3, 3)
    return found
