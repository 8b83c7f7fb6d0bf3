# SPDX-License-Identifier: Apache-2.0
"""Exudyn (fast module) with the solver that suits each problem.

one body  Lie group node and explicit Runge-Kutta methods. They ignore joints, so a body with a fixed
          point has its node and inertia there, and its weight acts off it.
tree      ObjectKinematicTree, minimal coordinates of hinges and slides, explicit: fixed steps, and
          DOPRI5 with error control. Joints with more degrees of freedom are chains with massless links;
          balls are omitted, because their three angles become singular
loop      planar bodies with joints at velocity level (index 2), implicit trapezoidal rule
"""

import contextlib
import io
import sys
from math import ceil, log

import numpy as np

from .measure import Entry, geometric
from .problems import CYLINDRICAL, FREE, GROUND, HINGE, SLIDE, UNIVERSAL

sys.exudynFast = True
with contextlib.redirect_stdout(io.StringIO()):
    import exudyn as exu
    import exudyn.itemInterface as items

CODE = "exudyn"
EXPLICIT = ("RK44", "RK67")
CONTROLLED = "DOPRI5"
LOOSEST, TIGHTEST = 1e-2, 1e-13  # tolerances of DOPRI5
FIRST_STEPS = 500  # per duration: sets its first step, which it soon adapts
X, Y, Z = np.eye(3)
# Links of a joint: (turning, axis); a number means this axis of the joint.
LINKS = {
    HINGE: [(True, 0)],
    SLIDE: [(False, 0)],
    UNIVERSAL: [(True, 0), (True, 1)],
    CYLINDRICAL: [(True, 0), (False, 0)],
    FREE: [(False, X), (False, Y), (False, Z), (True, X), (True, Y), (True, Z)],
}


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
        items.NodeRigidBodyRotVecLG(referenceCoordinates=[*at, 0.0, 0.0, 0.0], initialVelocities=[*speed, *body.omega])
    )
    made = mbs.AddObject(
        items.ObjectRigidBody(
            nodeNumber=node, physicsMass=body.mass, physicsInertia=inertia[[0, 1, 2, 1, 0, 0], [0, 1, 2, 2, 2, 1]]
        )
    )
    if problem.gravity.any():
        marker = mbs.AddMarker(items.MarkerBodyPosition(bodyNumber=made, localPosition=[*arm]))
        mbs.AddLoad(items.Force(markerNumber=marker, loadVector=[*body.mass * problem.gravity]))
    return lambda: ([mbs.GetNodeOutput(node, exu.OutputVariableType.RotationMatrix).reshape(3, 3)], 0.0)


def _axis_frame(axis):
    """Rotation (3, 3) whose z is an axis."""
    side = np.cross(axis, X if abs(axis[0]) < 0.5 else Y)
    side /= np.linalg.norm(side)
    return np.column_stack([side, np.cross(axis, side), axis])


def _links(problem):
    """(rows, last): links with one degree of freedom about or along z, and the last link of each body.

    rows : (turning, parent, frame (3, 3), offset (3,) in world axes at the start, speed, body or None)
    """
    rows, last, place = [], {GROUND: -1}, {GROUND: np.zeros(3)}
    for i, joint in enumerate(problem.tree):
        parts = LINKS[joint.kind]
        for count, ((turning, axis), rate) in enumerate(zip(parts, problem.rates(i))):
            axis = (joint.axis, joint.second)[axis] if isinstance(axis, int) else axis
            first, end = count == 0, count == len(parts) - 1
            rows.append(
                (
                    turning,
                    last[joint.parent] if first else len(rows) - 1,
                    _axis_frame(axis),
                    joint.point - place[joint.parent] if first else np.zeros(3),
                    rate,
                    i if end else None,
                )
            )
        last[i], place[i] = len(rows) - 1, joint.point
    return rows, last


def _tree(mbs, problem):
    """Minimal coordinates of hinges and slides."""
    rows, last = _links(problem)
    turning, parents, frames, offsets, speeds, held = zip(*rows)
    count = len(rows)
    outer = [np.eye(3) if parent < 0 else frames[parent] for parent in parents]
    node = mbs.AddNode(
        items.NodeGenericODE2(
            referenceCoordinates=[0.0] * count,
            initialCoordinates=[0.0] * count,
            initialCoordinates_t=[*speeds],
            numberOfODE2Coordinates=count,
        )
    )
    bodies = [None if i is None else problem.bodies[i] for i in held]
    arms = [
        np.zeros(3) if i is None else frame.T @ (problem.bodies[i].position - problem.tree[i].point)
        for i, frame in zip(held, frames)
    ]
    inertias = [
        np.zeros((3, 3)) if body is None else frame.T @ body.inertia @ frame for body, frame in zip(bodies, frames)
    ]
    kinds = exu.JointType
    mbs.AddObject(
        items.ObjectKinematicTree(
            nodeNumber=node,
            gravity=problem.gravity,
            jointTypes=[kinds.RevoluteZ if turns else kinds.PrismaticZ for turns in turning],
            linkParents=[*parents],
            jointTransformations=exu.Matrix3DList([a.T @ b for a, b in zip(outer, frames)]),
            jointOffsets=exu.Vector3DList([a.T @ offset for a, offset in zip(outer, offsets)]),
            linkInertiasCOM=exu.Matrix3DList(inertias),
            linkCOMs=exu.Vector3DList(arms),
            linkMasses=[0.0 if body is None else body.mass for body in bodies],
        )
    )

    def state():
        found = mbs.GetNodeOutput(node, exu.OutputVariableType.Coordinates)
        rotations = []
        for turns, parent, before, frame, q in zip(turning, parents, outer, frames, np.atleast_1d(found)):
            c, s = np.cos(q), np.sin(q)
            turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) if turns else np.eye(3)
            base = np.eye(3) if parent < 0 else rotations[parent]
            rotations.append(base @ before.T @ frame @ turn)
        return [rotations[last[i]] @ frames[last[i]].T for i in range(len(problem.bodies))], 0.0

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
                items.ObjectRigidBody2D(nodeNumber=nodes[i], physicsMass=body.mass, physicsInertia=body.inertia[2, 2])
            ),
            body.position,
        )
        marker = mbs.AddMarker(items.MarkerNodePosition(nodeNumber=nodes[i]))
        mbs.AddLoad(items.Force(markerNumber=marker, loadVector=[*body.mass * problem.gravity]))
    markers = []
    for joint in problem.tree + problem.loops:
        ends = [
            mbs.AddMarker(
                items.MarkerBodyPosition(bodyNumber=made[end][0], localPosition=[*joint.point - made[end][1]])
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
        return [[[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]] for a in angles], gap

    return state


def _spatial_bodies(mbs, problem):
    """Six coordinates per body, spherical joints as constraints."""
    made = {GROUND: (mbs.AddObject(items.ObjectGround()), np.zeros(3))}
    for i, body in enumerate(problem.bodies):
        node = mbs.AddNode(
            items.NodeRigidBodyRotVecLG(
                referenceCoordinates=[*body.position, 0.0, 0.0, 0.0], initialVelocities=[*body.velocity, *body.omega]
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
            mbs.AddMarker(items.MarkerBodyRigid(bodyNumber=made[end][0], localPosition=[*joint.point - made[end][1]]))
            for end in (joint.parent, joint.child)
        ]
        mbs.AddObject(items.SphericalJoint(markerNumbers=ends))


class _Run:
    """One Exudyn solver with a number of steps per duration; each run restarts."""

    def __init__(self, problem, build, solver, steps, sparse=False, tolerance=None):
        self.controlled = tolerance is not None
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
        settings.timeIntegration.automaticStepSize = self.controlled
        if self.controlled:
            settings.timeIntegration.relativeTolerance = tolerance
            settings.timeIntegration.absoluteTolerance = tolerance
            settings.timeIntegration.initialStepSize = problem.duration / FIRST_STEPS
            settings.timeIntegration.minimumStepSize = 1e-10
        if sparse:
            settings.linearSolver.solverType = exu.LinearSolverType.EigenSparse

    def reset(self):
        """Do nothing: SolveDynamic begins at the initial state."""

    def take(self, steps):
        """Take a number of steps from the initial state."""
        self.settings.timeIntegration.numberOfSteps = steps
        self.settings.timeIntegration.endTime = steps * self.step
        try:
            self.mbs.SolveDynamic(self.settings, solverType=self.solver, storeSolver=self.controlled)
        except Exception as error:
            raise ArithmeticError(f"Exudyn's solver failed: {error}") from None

    def advance(self, times):
        if not self.controlled:
            self.take(times * self.steps)
            return
        # Repeated from the start: beyond the duration its steps would differ.
        for _ in range(times):
            self.take(self.steps)

    def end(self):
        rotations, gap = self.state()
        return np.array(rotations), gap

    def steps_per_duration(self):
        if self.controlled:
            return self.mbs.sys["dynamicSolver"].it.currentStepIndex
        return self.steps


def entries(problem, ratio):
    """Explicit methods for problems without constraints; the implicit solver for planar loops."""
    if problem.loops:
        if any(joint.kind != HINGE or joint.axis[2] != 1.0 for joint in problem.tree):
            return
        chosen = [("index 2, planar", _planar_bodies, "TrapezoidalIndex2")]
    elif len(problem.bodies) == 1:
        chosen = [(f"Lie {solver}", _one_body, solver) for solver in EXPLICIT]
    elif all(joint.kind in LINKS for joint in problem.tree):
        chosen = [(f"{solver} {problem.joints}", _tree, solver) for solver in EXPLICIT]
    else:
        return
    for setting, build, solver in chosen:
        yield Entry(
            CODE,
            setting.strip(),
            geometric(problem.coarsest, ratio),
            lambda steps, b=build, s=solver: _Run(problem, b, s, steps),
        )
    if chosen[0][1] is _tree:
        yield Entry(
            CODE,
            f"{CONTROLLED} {problem.joints}".strip(),
            [LOOSEST / ratio ** (5 * k) for k in range(ceil(log(LOOSEST / TIGHTEST, ratio) / 5) + 1)],
            lambda tolerance: _Run(problem, _tree, CONTROLLED, 1, tolerance=tolerance),
        )


def stepper(problem, step):
    """Function take_steps(n) of implicit steps from the start; spherical joints, sparse solver."""
    return _Run(problem, _spatial_bodies, "TrapezoidalIndex2", round(problem.duration / step), sparse=True).take
