# SPDX-License-Identifier: Apache-2.0
"""Poles of five mechanisms with loops about their equilibria, against the linearised system of Exudyn.

    python benchmarks/linear_exudyn.py

Needs Exudyn (pip install exudyn). `trim` finds the equilibria. Exudyn has the same bodies in absolute coordinates with
generic joints; M, K, D, the Jacobian C of the constraints and its null space N are those of its
ComputeLinearizedSystem. Its K lacks the change of the reactions with the pose: without it a pendulum has no stiffness.
The script adds it as derivative of C' lambda, with the multipliers of the equilibrium:

    N' M N z'' + N' D N z' + N' (K + d(C' lambda)/dq) N z = 0

Differences of poles, relative to the largest pole, with Exudyn 1.13.6:

    scene          poles   largest pole   difference   without d(C' lambda)/dq
    bricard            2         1.2413      2.5e-12              1.0e+00
    slider_crank       2         7.0711      2.1e-12              1.0e+00
    five_bar           4        12.9157      3.0e-14                  4.2e-01
    scissor_lift       2         7.3269      3.5e-13                  1.2e-01
    stewart           12        19.7807      2.4e-13                  2.5e-02
"""

import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import scipy

from liegroup_core import Simulation
from liegroup_core.linear import trim
from liegroup_core.linear.differences import derivative
from liegroup_core.scene.consistency import resolve_frames
from liegroup_core.scene.load import load_scene

ROBOTS = Path(__file__).resolve().parent.parent / "docs" / "robots"
SCENES = ["bricard", "slider_crank", ROBOTS / "five_bar.yaml", ROBOTS / "scissor_lift.yaml", ROBOTS / "stewart.sdf"]
# Translations and rotations that a joint prevents, in the axes of its frame.
PREVENTED = {
    "revolute": [1, 1, 1, 1, 1, 0],
    "prismatic": [1, 1, 0, 1, 1, 1],
    "spherical": [1, 1, 1, 0, 0, 0],
    "universal": [1, 1, 1, 0, 0, 1],
}
BACK = 1.0  # m along a prismatic joint, from its frame to the end of its spring


def exudyn_model(scene, result):
    """Model of a scene in Exudyn at a Trim."""
    import exudyn as exu
    from exudyn.utilities import ObjectGround, RigidBodyInertia

    container = exu.SystemContainer()
    mbs = container.AddSystem()
    numbers, frames = {"world": mbs.AddObject(ObjectGround())}, {"world": (np.eye(3), np.zeros(3))}
    centres = {"world": np.zeros(3)}
    for body, pose in zip(scene.bodies, result.pose):
        R, p = frames[body.name] = pose[:9].reshape(3, 3), pose[9:]
        centres[body.name] = p + R @ np.array(body.com)
        xx, yy, zz, xy, xz, yz = (*body.inertia, 0.0, 0.0, 0.0)[:6]
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        numbers[body.name] = mbs.CreateRigidBody(
            inertia=RigidBodyInertia(mass=body.mass, inertiaTensor=inertia),
            referencePosition=centres[body.name],
            referenceRotationMatrix=R,
            gravity=list(scene.gravity),
        )
    axes = {}
    for joint, (F_a, F_b) in zip(scene.joints, resolve_frames(scene)):
        pair = [numbers[joint.parent], numbers[joint.child]]
        (R, p), (turn, q) = frames[joint.parent], frames[joint.child]
        point, along = p + R @ F_a[:3, 3], R @ F_a[:3, :3]
        at = q + turn @ F_b[:3, 3]
        axes[joint.name] = joint, pair, at, along[:, 2], point
        if joint.type == "universal":
            # The cross has the x axis of the parent's frame and the y axis of the child's.
            x, y = along[:, 0], turn @ F_b[:3, 1]
            along = np.column_stack([x, y, np.cross(x, y)])
        mbs.CreateGenericJoint(
            bodyNumbers=pair, position=at, rotationMatrixAxes=along, constrainedAxes=PREVENTED[joint.type], show=False
        )
    for force in scene.forces:
        joint, pair, at, axis, point = axes[force.joint]
        if force.type == "torsional_spring_damper":
            assert force.stiffness == 0.0
            mbs.CreateTorsionalSpringDamper(bodyNumbers=pair, position=at, axis=axis, damping=force.damping, show=False)
            continue
        ends = zip((joint.parent, joint.child), (point - BACK * axis, at))
        local = [frames[body][0].T @ (end - centres[body]) for body, end in ends]
        mbs.CreateSpringDamper(
            bodyNumbers=pair,
            localPosition0=local[0],
            localPosition1=local[1],
            referenceLength=BACK + force.rest_position,
            stiffness=force.stiffness,
            damping=force.damping,
            show=False,
        )
    mbs.Assemble()
    return container, mbs


def exudyn_poles(scene, result, reactions=True):
    """Poles by Exudyn; with `reactions` K has their change."""
    import exudyn as exu

    container, mbs = exudyn_model(scene, result)
    settings = exu.SimulationSettings()
    settings.staticSolver.verboseMode = 0
    settings.solutionSettings.writeSolutionToFile = False
    start = mbs.systemData.GetODE2Coordinates(exu.ConfigurationType.Initial).copy()

    def linearised():
        return mbs.ComputeLinearizedSystem(settings, True, 1e-9, True, True)

    # Exudyn returns C as (coordinates, equations) and N as (degrees of freedom, coordinates).
    M, K, D, C, N = linearised()
    solver = exu.MainSolverStatic()
    solver.InitializeSolver(mbs, settings)
    solver.ComputeODE2RHS(mbs)
    forces = np.array(solver.GetSystemResidual())[: len(start)]
    multipliers = np.linalg.lstsq(C, forces, rcond=1e-9)[0]
    assert np.abs(C @ multipliers - forces).max() < 1e-10 * np.abs(forces).max(), "no equilibrium"

    def reaction(z):
        mbs.systemData.SetODE2Coordinates(start + z, exu.ConfigurationType.Initial)
        return linearised()[3] @ multipliers

    if reactions:
        K = K + N @ np.array([derivative(lambda s, n=n: reaction(s * n), 1e-2)[0] for n in N]).T
    m = len(M)
    A = np.block([[np.zeros((m, m)), np.eye(m)], [-np.linalg.solve(M, K), -np.linalg.solve(M, D)]])
    return np.linalg.eigvals(A)


def largest_difference(one, other):
    """Largest distance of poles from each other, each to the nearest one that is left, relative to the largest."""
    distances = np.abs(one[:, None] - other)
    rows, columns = scipy.optimize.linear_sum_assignment(distances)
    return distances[rows, columns].max() / np.abs(one).max()


def main():
    if find_spec("exudyn") is None:
        sys.exit("Exudyn is missing: pip install exudyn")
    print("scene          poles   largest pole   difference   without d(C' lambda)/dq")
    for name in SCENES:
        scene = load_scene(str(name))
        scene = scene.remade(forces=[force for force in scene.forces if force.type != "motor"])
        result = trim(Simulation(scene, "rkmk4", 1e-3, estimate=False, quiet=True))
        own = result.system.poles
        found = [largest_difference(own, exudyn_poles(scene, result, reactions)) for reactions in (True, False)]
        print(f"{scene.name:<14} {len(own):5d} {np.abs(own).max():14.4f} {found[0]:12.1e} {found[1]:24.1e}")


if __name__ == "__main__":
    main()
