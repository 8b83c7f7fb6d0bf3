# SPDX-License-Identifier: Apache-2.0
"""Errors of the trade checked against motions computed with other software.

    python benchmarks/trade_truth_peers.py [--write]

Accelerations of Pinocchio and MuJoCo, integrated by SciPy's DOP853 at tolerance 1e-13 between the
sampling times of the trade. Their uncertainty is the difference to tolerance 1e-12. The scenes are
written independently in this file, for the trees and the loop that these codes support. Output:

    truth   distance of the trade's reference solution from the peer's, and both uncertainties
    front   every configuration on the Pareto fronts in docs/which_method.json is run again. Its
            error against the peer's motion and its error in the file may differ by this distance

--write stores every tenth sample of three scenes with its origin in test/verification/peers.json,
so that the tests need neither package. Needs pip install '.[bench]'.
"""

import argparse
import json
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pinocchio
import scipy
from scipy.integrate import solve_ivp
from side_by_side import problems
from side_by_side.mujoco_code import model_of
from side_by_side.problems import BALL, GROUND, HINGE, Body, Joint, Problem

from liegroup_core import load_scene
from liegroup_core.engine import Engine
from liegroup_core.layout import make_layout
from liegroup_core.reference import Trajectory, distance
from liegroup_core.study.trade.configurations import as_time, sample_times
from liegroup_core.study.trade.measure import listening
from liegroup_core.study.trade.reference_solution import find_truth, scaled

ROOT = Path(__file__).resolve().parent.parent
DATA, KEPT = ROOT / "docs" / "which_method.json", ROOT / "test" / "verification" / "peers.json"
TIGHT, LOOSE = 1e-13, 1e-12
EVERY = 10  # every so many instants, and the last one, are kept for the tests
TESTED = ("heavy_top", "double_pendulum", "four_bar")  # the chain takes the tests too long
DOWN, Y = np.array([0.0, 0.0, -9.81]), np.array([0.0, 1.0, 0.0])


def rods(count, length, mass, radius):
    """Solid cylinders in a row along x, at rest, on revolute joints about y."""
    inertia = np.diag([mass * radius**2 / 2, *[mass * (3 * radius**2 + length**2) / 12] * 2])
    return Problem(
        "",
        "",
        tuple(Body(mass, inertia, np.array([(i + 0.5) * length, 0, 0])) for i in range(count)),
        tuple(Joint(HINGE, i - 1, i, np.array([i * length, 0, 0]), Y) for i in range(count)),
        (),
        DOWN,
        1.0,
        1,
        True,
    )


def top():
    """Body on a spherical joint; a zero-length spring acts on its centre of mass."""
    body = Body(
        21.6, np.diag([0.36, 0.306, 0.09]), np.array([0.5, 0, 0]), np.array([0, 0, 0.5]), np.array([0, 0.25, 0])
    )
    return Problem("", "", (body,), (Joint(BALL, GROUND, 0, np.zeros(3)),), (), DOWN, 1.0, 1, True)


def spring(positions):
    """Force on the centre of mass of the top, world axes, N."""
    return 1e4 * (np.array([1.0, 0.0, 0.5]) - positions[0])


SCENES = {
    "heavy_top": (top, spring),
    "double_pendulum": (lambda: rods(2, 1.2, 1.0, 0.02), None),
    "hinge_chain": (lambda: rods(10, 0.1, 0.1, 0.005), None),
    "four_bar": (lambda: replace(problems.four_bar(density=400.0), gravity=np.zeros(3)), None),
}


class Pinocchio:
    """aba, and constraintDynamics where there is a loop. State: q, v."""

    NAME = f"Pinocchio {pinocchio.__version__}"
    LOOPS = True

    def __init__(self, problem, force):
        self._force, self._bodies, model = force, problem.bodies, pinocchio.Model()
        model.gravity.linear = problem.gravity
        origins, place = {GROUND: np.zeros(3)}, pinocchio.SE3.Identity()
        for i, (joint, body) in enumerate(zip(problem.tree, problem.bodies)):
            origins[i] = joint.point
            kind = (
                pinocchio.JointModelSpherical()
                if joint.kind == BALL
                else pinocchio.JointModelRevoluteUnaligned(joint.axis)
            )
            model.addJoint(
                joint.parent + 1, kind, pinocchio.SE3(np.eye(3), joint.point - origins[joint.parent]), f"j{i}"
            )
            model.appendBodyToJoint(
                i + 1, pinocchio.Inertia(body.mass, body.position - joint.point, body.inertia), place
            )
        self._model, self._data = model, model.createData()
        self._balls = [joint.idx_q for joint in model.joints[1:] if joint.nq == 4]
        self._loops = pinocchio.StdVec_RigidConstraintModel()
        self._loop_data = pinocchio.StdVec_RigidConstraintData()
        for loop in problem.loops:
            self._loops.append(
                pinocchio.RigidConstraintModel(
                    pinocchio.ContactType.CONTACT_3D,
                    model,
                    loop.parent + 1,
                    pinocchio.SE3(np.eye(3), loop.point - origins[loop.parent]),
                    loop.child + 1,
                    pinocchio.SE3(np.eye(3), loop.point - origins[loop.child]),
                    pinocchio.ReferenceFrame.LOCAL,
                )
            )
            self._loop_data.append(self._loops[-1].createData())
        if problem.loops:
            pinocchio.initConstraintDynamics(model, self._data, self._loops, self._loop_data)
        # Proximal iterations until the residual of the regularisation is below round-off.
        self._exactly = pinocchio.ProximalSettings(1e-15, 1e-10, 20)
        self.start = np.concatenate([pinocchio.neutral(model), start_speeds(problem)])

    def normal(self, state):
        """The state with unit quaternions."""
        return np.concatenate([pinocchio.normalize(self._model, state[: self._model.nq]), state[self._model.nq :]])

    def slope(self, _, state):
        """Derivative of the state."""
        model, data = self._model, self._data
        state = self.normal(state)
        q, v = state[: model.nq], state[model.nq :]
        if len(self._loops):
            a = pinocchio.constraintDynamics(
                model, data, q, v, np.zeros(model.nv), self._loops, self._loop_data, self._exactly
            )
        elif self._force is None:
            a = pinocchio.aba(model, data, q, v, np.zeros(model.nv))
        else:
            turns, places = self.bodies(state)
            pull = turns[0].T @ self._force(places)
            arm = model.inertias[1].lever
            forces = pinocchio.StdVec_Force()
            forces.extend([pinocchio.Force.Zero(), pinocchio.Force(pull, np.cross(arm, pull))])
            a = pinocchio.aba(model, data, q, v, np.zeros(model.nv), forces)
        rates = np.array(v) if not self._balls else quaternion_rate(q[[3, 0, 1, 2]], v)[[1, 2, 3, 0]]
        return np.concatenate([rates, a])

    def bodies(self, state):
        """(n, 3, 3) attitudes since the start, (n, 3) centres of mass, m."""
        model, data = self._model, self._data
        pinocchio.forwardKinematics(model, data, state[: model.nq])
        frames = data.oMi[1:]
        return (
            np.array([frame.rotation for frame in frames]),
            np.array([frame.act(inertia.lever) for frame, inertia in zip(frames, model.inertias[1:])]),
        )


class Mujoco:
    """mj_forward without contacts, limits and friction. State: qpos, qvel."""

    NAME = f"MuJoCo {mujoco.__version__}"
    LOOPS = False  # it closes loops by springs

    def __init__(self, problem, force):
        self._force, self._problem = force, problem
        self._model = model_of(problem, 1.0)
        self._data = mujoco.MjData(self._model)
        self._ball = self._model.nq > self._model.nv
        self.start = np.concatenate([self._data.qpos, start_speeds(problem)])

    def normal(self, state):
        """The state with unit quaternions."""
        state = state.copy()
        if self._ball:
            state[:4] /= np.linalg.norm(state[:4])
        return state

    def slope(self, _, state):
        """Derivative of the state."""
        model, data = self._model, self._data
        state = self.normal(state)
        if self._force is not None:
            data.xfrc_applied[1, :3] = self._force(self.bodies(state)[1])
        self._put(state)
        mujoco.mj_forward(model, data)
        q, v = state[: model.nq], state[model.nq :]
        return np.concatenate([quaternion_rate(q, v) if self._ball else v, data.qacc])

    def bodies(self, state):
        """(n, 3, 3) attitudes since the start, (n, 3) centres of mass, m."""
        self._put(state)
        mujoco.mj_kinematics(self._model, self._data)
        turns = self._data.xmat[1:].reshape(-1, 3, 3).copy()
        arms = [body.position - joint.point for body, joint in zip(self._problem.bodies, self._problem.tree)]
        return turns, self._data.xpos[1:] + np.einsum("nij,nj->ni", turns, arms)

    def _put(self, state):
        self._data.qpos[:], self._data.qvel[:] = state[: self._model.nq], state[self._model.nq :]


def quaternion_rate(q, omega):
    """q' = q (0, omega) / 2 of q = w, x, y, z and a body-fixed omega."""
    return 0.5 * np.array([-q[1:] @ omega, *(q[0] * omega + np.cross(q[1:], omega))])


def start_speeds(problem):
    """Initial joint velocities, in order."""
    speeds, still = [], np.zeros(3)
    for joint, body in zip(problem.tree, problem.bodies):
        relative = body.omega - (still if joint.parent == GROUND else problem.bodies[joint.parent].omega)
        speeds += [*relative] if joint.kind == BALL else [relative @ joint.axis]
    return np.array(speeds, dtype=float)


def motion(code, times, tolerance):
    """(k, n, 3, 3) attitudes since the start and (k, n, 3) centres of mass at times, s."""
    state, found = code.start, [code.bodies(code.start)]
    for begin, end in zip(times, times[1:]):
        run = solve_ivp(code.slope, (begin, end), state, method="DOP853", rtol=tolerance, atol=tolerance, t_eval=[end])
        if not run.success:
            raise SystemExit(f"{code.NAME}: {run.message}")
        state = code.normal(run.y[:, -1])
        found.append(code.bodies(state))
    turns, places = zip(*found)
    return np.array(turns), np.array(places)


def apart(turns, places, other_turns, other_places, length):
    """Error between two motions, as defined by truth.scaled."""
    none = np.zeros((*turns.shape[:2], 6))
    off = distance(Trajectory(None, turns, places, none), Trajectory(None, other_turns, other_places, none))
    return scaled(off.position, off.angle, length)


def run(scene, cell, horizon):
    """(rows of times that are whole steps, attitudes, positions) of a configuration."""
    step, times = as_time(cell["step"]), sample_times(horizon)
    rows = [row for row, at in enumerate(times) if at % step == 0]
    simulation = Engine(
        scene, **{name: cell[name] for name in ("method", "step", "group", "stabilisation")}, **cell["options"]
    )
    poses = []
    with listening():  # capture accuracy warnings of coarse configurations
        for row in rows:
            simulation.advance(round(times[row] / step) - simulation.steps)
            poses.append(simulation.sample().pose)
    poses = np.array(poses)
    return rows, poses[..., :9].reshape(*poses.shape[:2], 3, 3), poses[..., 9:]


def check(name, code, part, truth):
    """(table row, data stored for the tests) of a scene and a code."""
    scene, length = load_scene(name), part["length"]
    times = truth.motion.times

    def found(tolerance):
        """Motion in the frames of our bodies: the peer's is since the start, at the centres of mass."""
        turns, places = motion(code, times, tolerance)
        turns = turns @ truth.motion.rotation[0]
        return turns, places - np.einsum("knij,nj->kni", turns, [body.com for body in scene.bodies])

    turns, places = found(TIGHT)
    known = apart(turns, places, *found(LOOSE), length)
    off = apart(truth.motion.rotation, truth.motion.position, turns, places, length)
    worst, count = 0.0, 0
    for k in part["front"]:
        cell = part["cells"][k]
        rows, own_turns, own_places = run(scene, cell, truth.horizon)
        error = apart(own_turns, own_places, turns[rows], places[rows], length)
        worst, count = max(worst, abs(error - cell["error"])), count + 1
    both, kept = truth.known + known, np.arange(len(times))[::-EVERY][::-1]
    row = (
        name,
        code.NAME,
        f"{float(truth.horizon):g} s",
        f"{off:.1e}",
        f"{truth.known:.1e}",
        f"{known:.1e}",
        str(count),
        f"{worst:.1e}",
        "yes" if off <= both and worst <= both else "NO",
    )
    return row, {
        "scene": name,
        "software": f"{code.NAME}, DOP853 of SciPy {scipy.__version__} at {TIGHT:g}",
        "known": known,
        "length": length,
        "horizon": float(truth.horizon),
        "times": times[kept].tolist(),
        "position": places[kept].tolist(),
        "rotation": turns[kept].tolist(),
    }


def main():
    """Compute the motions, print the table, and store some of them with --write."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--write", action="store_true", help="store samples for the tests")
    parser.add_argument("--scenes", nargs="+", choices=list(SCENES), default=list(SCENES))
    args = parser.parse_args()
    parts = {part["scene"]: part for part in json.loads(DATA.read_text())["scenes"]}
    print(
        "| scene | accelerations of | horizon | truths apart | ours known to | theirs known to "
        "| settings on the front | errors apart, at most | within both |"
    )
    print("|---|---|---|---|---|---|---|---|---|", flush=True)
    kept = []
    for name in args.scenes:
        make, force = SCENES[name]
        truth = find_truth(make_layout(load_scene(name)), as_time(parts[name]["horizon"]))
        for code in (Pinocchio, Mujoco):
            problem = make()
            if problem.loops and not code.LOOPS:
                continue
            row, reference = check(name, code(problem, force), parts[name], truth)
            print(f"| {' | '.join(row)} |", flush=True)
            if code is Pinocchio and name in TESTED:
                kept.append(reference)
    if args.write:
        KEPT.write_text(json.dumps(kept) + "\n")


if __name__ == "__main__":
    main()
