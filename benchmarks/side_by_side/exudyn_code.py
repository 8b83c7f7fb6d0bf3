# SPDX-License-Identifier: Apache-2.0
"""Exudyn (fast module) with the solver that suits each problem.

one body  Lie group node and explicit Runge-Kutta methods. They ignore joints, so a body about
          a fixed point is a body there, with its inertia about it and its weight off it.
chain     ObjectKinematicTree, minimal coordinates of hinges, explicit
loop      planar bodies with joints at velocity level (index 2), implicit trapezoidal rule
"""

import contextlib
import io
import sys

import numpy as np

from .measure import Entry, geometric
from .problems import GROUND, HINGE

sys.exudynFast = True
with contextlib.redirect_stdout(io.StringIO()):
    import exudyn as exu
    import exudyn.itemInterface as items

CODE = "exudyn"
EXPLICIT = ("RK44", "RK67")


def version():
    """Version of the package."""
    return exu.__version__


def _one_body(mbs, problem):
    """Lie group node at the fixed point if there is one, else at the centre of mass."""
    body = problem.bodies[0]
    at = problem.tree[0].point if problem.tree else body.position
    arm = body.position - at
    inertia = body.inertia + body.mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    speed = [0.0, 0.0, 0.0] if problem.tree else [*body.velocity]
    node = mbs.AddNode(
        items.NodeRigidBodyRotVecLG(
            referenceCoordinates=[*at, 0.0, 0.0, 0.0], initialVelocities=[*speed, *body.omega]
        )
    )
    made = mbs.AddObject(
        items.ObjectRigidBody(
            nodeNumber=node,
            physicsMass=body.mass,
            physicsInertia=inertia[[0, 1, 2, 1, 0, 0], [0, 1, 2, 2, 2, 1]],
        )
    )
    if problem.gravity.any():
        marker = mbs.AddMarker(items.MarkerBodyPosition(bodyNumber=made, localPosition=[*arm]))
        mbs.AddLoad(items.Force(markerNumber=marker, loadVector=[*body.mass * problem.gravity]))
    return lambda: (
        [mbs.GetNodeOutput(node, exu.OutputVariableType.RotationMatrix).reshape(3, 3)],
        0.0,
    )


def _tree_of_hinges(mbs, problem):
    """Minimal coordinates of revolute joints about y."""
    count = len(problem.bodies)
    node = mbs.AddNode(
        items.NodeGenericODE2(
            referenceCoordinates=[0.0] * count,
            initialCoordinates=[0.0] * count,
            initialCoordinates_t=[0.0] * count,
            numberOfODE2Coordinates=count,
        )
    )
    origins = {GROUND: np.zeros(3)} | {joint.child: joint.point for joint in problem.tree}
    mbs.AddObject(
        items.ObjectKinematicTree(
            nodeNumber=node,
            gravity=problem.gravity,
            jointTypes=[exu.JointType.RevoluteY] * count,
            linkParents=[joint.parent for joint in problem.tree],
            jointTransformations=exu.Matrix3DList([np.eye(3)] * count),
            jointOffsets=exu.Vector3DList(
                [joint.point - origins[joint.parent] for joint in problem.tree]
            ),
            linkInertiasCOM=exu.Matrix3DList([body.inertia for body in problem.bodies]),
            linkCOMs=exu.Vector3DList(
                [body.position - origins[i] for i, body in enumerate(problem.bodies)]
            ),
            linkMasses=[body.mass for body in problem.bodies],
        )
    )

    def state():
        turns = mbs.GetNodeOutput(node, exu.OutputVariableType.Coordinates)
        angle = np.zeros(count)
        for joint, turn in zip(problem.tree, np.atleast_1d(turns)):
            angle[joint.child] = turn + (angle[joint.parent] if joint.parent != GROUND else 0.0)
        c, s, zero = np.cos(angle), np.sin(angle), np.zeros(count)
        rotations = np.array([[c, zero, s], [zero, zero + 1, zero], [-s, zero, c]])
        return rotations.transpose(2, 0, 1), 0.0

    return state


def _planar_bodies(mbs, problem):
    """Three coordinates per body, revolute joints about z as constraints."""
    ground = mbs.AddObject(items.ObjectGround())
    nodes, made = [], {GROUND: (ground, np.zeros(3))}
    for i, body in enumerate(problem.bodies):
        nodes.append(
            mbs.AddNode(
                items.NodeRigidBody2D(
                    referenceCoordinates=[*body.position[:2], 0.0],
                    initialVelocities=[*body.velocity[:2], body.omega[2]],
                )
            )
        )
        made[i] = (
            mbs.AddObject(
                items.ObjectRigidBody2D(
                    nodeNumber=nodes[i], physicsMass=body.mass, physicsInertia=body.inertia[2, 2]
                )
            ),
            body.position,
        )
        marker = mbs.AddMarker(items.MarkerNodePosition(nodeNumber=nodes[i]))
        mbs.AddLoad(items.Force(markerNumber=marker, loadVector=[*body.mass * problem.gravity]))
    markers = []
    for joint in problem.tree + problem.loops:
        ends = [
            mbs.AddMarker(
                items.MarkerBodyPosition(
                    bodyNumber=made[end][0], localPosition=[*joint.point - made[end][1]]
                )
            )
            for end in (joint.parent, joint.child)
        ]
        mbs.AddObject(items.RevoluteJoint2D(markerNumbers=ends))
        markers += ends

    def state():
        angles = [mbs.GetNodeOutput(node, exu.OutputVariableType.Coordinates)[2] for node in nodes]
        positions = np.array(
            [mbs.GetMarkerOutput(marker, exu.OutputVariableType.Position) for marker in markers]
        ).reshape(-1, 2, 3)
        gap = np.linalg.norm(positions[:, 0] - positions[:, 1], axis=1).max()
        return [
            [[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]] for a in angles
        ], gap

    return state


def _spatial_bodies(mbs, problem):
    """Six coordinates per body, spherical joints as constraints."""
    made = {GROUND: (mbs.AddObject(items.ObjectGround()), np.zeros(3))}
    for i, body in enumerate(problem.bodies):
        node = mbs.AddNode(
            items.NodeRigidBodyRotVecLG(
                referenceCoordinates=[*body.position, 0.0, 0.0, 0.0],
                initialVelocities=[*body.velocity, *body.omega],
            )
        )
        made[i] = (
            mbs.AddObject(
                items.ObjectRigidBody(
                    nodeNumber=node,
                    physicsMass=body.mass,
                    physicsInertia=body.inertia[[0, 1, 2, 1, 0, 0], [0, 1, 2, 2, 2, 1]],
                )
            ),
            body.position,
        )
        marker = mbs.AddMarker(items.MarkerNodePosition(nodeNumber=node))
        mbs.AddLoad(items.Force(markerNumber=marker, loadVector=[*body.mass * problem.gravity]))
    for joint in problem.tree:
        ends = [
            mbs.AddMarker(
                items.MarkerBodyRigid(
                    bodyNumber=made[end][0], localPosition=[*joint.point - made[end][1]]
                )
            )
            for end in (joint.parent, joint.child)
        ]
        mbs.AddObject(items.SphericalJoint(markerNumbers=ends))


class _Run:
    """One Exudyn solver with a number of steps per duration; each run restarts."""

    def __init__(self, problem, build, solver, steps, sparse=False):
        exu.config.printToConsole, exu.config.suppressWarnings = False, True
        self.step, self.steps = problem.duration / steps, steps
        self.mbs = exu.SystemContainer().AddSystem()
        self.state = build(self.mbs, problem)
        self.mbs.Assemble()
        self.solver = getattr(exu.DynamicSolverType, solver)
        settings = self.settings = exu.SimulationSettings()
        settings.timeIntegration.verboseMode = 0
        settings.solutionSettings.writeSolutionToFile = False
        settings.timeIntegration.explicit.useLieGroupIntegration = True
        settings.timeIntegration.explicit.computeEndOfStepAccelerations = False
        settings.timeIntegration.newton.useModifiedNewton = True
        if sparse:
            settings.linearSolver.solverType = exu.LinearSolverType.EigenSparse

    def reset(self):
        """Nothing to do: SolveDynamic begins at the start."""

    def take(self, steps):
        """Take a number of steps from the initial state."""
        self.settings.timeIntegration.numberOfSteps = steps
        self.settings.timeIntegration.endTime = steps * self.step
        try:
            self.mbs.SolveDynamic(self.settings, solverType=self.solver, storeSolver=False)
        except Exception as error:
            raise ArithmeticError(f"Exudyn's solver failed: {error}") from None

    def advance(self, times):
        self.take(times * self.steps)

    def end(self):
        rotations, gap = self.state()
        return np.array(rotations), gap

    def steps_per_duration(self):
        return self.steps


def entries(problem, ratio):
    """Explicit methods for problems without constraints, else the implicit solver."""
    if problem.loops:
        chosen = [("index 2, planar", _planar_bodies, "TrapezoidalIndex2")]
    elif len(problem.bodies) == 1:
        chosen = [(f"Lie {solver}", _one_body, solver) for solver in EXPLICIT]
    elif problem.tree[0].kind == HINGE:
        chosen = [(f"{solver} hinges", _tree_of_hinges, solver) for solver in EXPLICIT]
    else:
        return
    for setting, build, solver in chosen:
        yield Entry(
            CODE,
            setting,
            geometric(problem.coarsest, ratio),
            lambda steps, b=build, s=solver: _Run(problem, b, s, steps),
        )


def stepper(problem, step):
    """Function take_steps(n) of implicit steps from the start; spherical joints, sparse solver."""
    return _Run(
        problem, _spatial_bodies, "TrapezoidalIndex2", round(problem.duration / step), sparse=True
    ).take
