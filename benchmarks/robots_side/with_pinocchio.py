# SPDX-License-Identifier: Apache-2.0
"""Trees from URDF compared with Pinocchio, which reads the file itself."""

import numpy as np
import pinocchio as pin

from .accelerations import Accelerations, coupled, difference, offsets_of
from .motion import motion_against, radau

# s, of RK4 with Pinocchio's accelerations.
STEPS = 1e-4, 2.5e-5, 5e-6
DIVERGED = 1e8  # m/s or rad/s


def against_pinocchio(path, scene, states):
    """(largest relative difference of accelerations at random states, that state).

    The state is (poses (n, 12), twists (n, 6), our accelerations (n, 6), Pinocchio's).
    """
    tree = _Tree(path, scene)
    rng, solve, worst = np.random.default_rng(7), Accelerations(scene), (-1.0, None)
    for _ in range(states):
        q, v, rows = tree.random_state(rng, 1.5)
        state = tree.poses_and_twists(q, v, tree.accelerations(q, v, rows))
        theirs = state[2] + np.zeros((len(scene.bodies), 6))
        for A, body in zip(theirs, scene.bodies):
            A[3:] += np.cross(A[:3], body.com)
        state = *state[:2], solve(*state[:2]), theirs
        found = difference(*state[2:], scene.bodies)
        if found > worst[0]:
            worst = found, state
    return worst


def motion_against_pinocchio(path, scene, seconds=1.0):
    """Differences after a motion from a random state: see motion.py."""
    tree = _Tree(path, scene)
    start = tree.random_state(np.random.default_rng(3), 0.5)
    pose, twist, _ = tree.poses_and_twists(*start[:2], 0.0 * start[1])
    return motion_against(scene, pose, twist, seconds, STEPS, lambda step: tree.end(*start, seconds, step))


class _Tree:
    """Model of Pinocchio with the bodies, damping and couplings of a scene."""

    def __init__(self, path, scene):
        self.scene, names = scene, scene.robot
        # For a floating base Pinocchio's reader requires a root link, not a world.
        self.floats = all(joint.parent != "world" for joint in scene.joints)
        model = (
            pin.buildModelFromUrdf(str(path), pin.JointModelFreeFlyer())
            if self.floats
            else pin.buildModelFromUrdf(str(path))
        )
        kept = set(names.joints.values())
        held = [j for j in range(1, model.njoints) if model.names[j] not in kept and model.names[j] != "root_joint"]
        if held:
            model = pin.buildReducedModel(model, held, pin.neutral(model))
        model.gravity.linear = np.array(scene.gravity)
        self.model, self.data, self.offsets = model, model.createData(), offsets_of(scene)
        number = {frame.name: i for i, frame in enumerate(model.frames) if frame.type == pin.BODY}
        self.frames = [number[names.links[body.name]] for body in scene.bodies]
        damping = {force.joint: force.damping for force in scene.forces}
        self.damping = np.zeros(model.nv)
        for joint in scene.joints:
            if joint.type != "fixed":
                number = model.getJointId(names.joints[joint.name])
                self.damping[model.joints[number].idx_v] = damping.get(joint.name, 0.0)

    def random_state(self, rng, largest):
        """(q, v, rows of the couplings (k, nv)) of a state that satisfies the couplings."""
        model = self.model
        q = pin.integrate(model, pin.neutral(model), rng.uniform(-largest, largest, model.nv))
        v = rng.uniform(-1.0, 1.0, model.nv)
        return q, v, self._coupled(q, v)

    def accelerations(self, q, v, rows):
        """Accelerations (nv,) of the joints."""
        model, data = self.model, self.data
        a = pin.aba(model, data, q, v, -self.damping * v)
        if not len(rows):
            return a
        M = pin.crba(model, data, q)
        return coupled(a, rows, np.linalg.solve(np.triu(M) + np.triu(M, 1).T, rows.T))

    def poses_and_twists(self, q, v, a):
        """Poses (n, 12), twists and accelerations (n, 6) of the frames of all bodies."""
        model, data = self.model, self.data
        pin.forwardKinematics(model, data, q, v, a)
        pin.updateFramePlacements(model, data)
        pose, twist, rate = [], [], []
        for frame in self.frames:
            place = data.oMf[frame]
            pose.append([*place.rotation.ravel(), *place.translation])
            V = pin.getFrameVelocity(model, data, frame, pin.LOCAL)
            A = pin.getFrameAcceleration(model, data, frame, pin.LOCAL)
            twist.append([*V.angular, *V.linear])
            rate.append([*A.angular, *A.linear])
        return np.array(pose), np.array(twist), np.array(rate)

    def end(self, q, v, rows, seconds, step):
        """Positions (n, 3) of the body frames after a motion; infinite if it diverges.

        step : s, of RK4; None: SciPy's Radau
        """
        if step is None:
            end = radau(
                lambda _, y: np.concatenate(self._slope(q, *np.split(y, 2), rows)),
                np.concatenate([0.0 * v, v]),
                seconds,
            )
            at, v = np.split(end, 2)
            q = pin.integrate(self.model, q, at)
        else:
            for _ in range(round(seconds / step)):
                with np.errstate(all="ignore"):
                    q, v = self.step(q, v, rows, step)
                if not np.abs(v).max() < DIVERGED:
                    return np.full((len(self.scene.bodies), 3), np.inf)
        return self.poses_and_twists(q, v, 0.0 * v)[0][:, 9:]

    def step(self, q, v, rows, h):
        """State after a step of RK4 in the exponential coordinates of the joints at its start."""
        at, rate, slopes = np.zeros_like(v), v, []
        for part in (0.0, 0.5, 0.5, 1.0):
            if slopes:
                at, rate = (x + part * h * dx for x, dx in zip((0.0 * v, v), slopes[-1]))
            slopes.append(self._slope(q, at, rate, rows))
        at, dv = (h / 6.0 * (a + 2.0 * (b + c) + d) for a, b, c, d in zip(*slopes))
        return pin.integrate(self.model, q, at), v + dv

    def _slope(self, q, at, rate, rows):
        """Rates of the exponential coordinates about q, and of the velocities."""
        turned = rate
        if self.floats:
            turned = np.linalg.solve(pin.dIntegrate(self.model, q, at, pin.ARG1), rate)
        return turned, self.accelerations(pin.integrate(self.model, q, at), rate, rows)

    def _coupled(self, q, v):
        """Make a state satisfy the couplings; returns their rows (k, nv)."""
        scene, model = self.scene, self.model
        rows = np.zeros((len(scene.couplings), model.nv))
        for row, coupling, offset in zip(rows, scene.couplings, self.offsets):
            first, other = (
                model.joints[model.getJointId(scene.robot.joints[name])] for name in (coupling.joint, coupling.other)
            )
            at = q[other.idx_q : other.idx_q + other.nq]
            value = coupling.ratio * (at[0] if other.nq == 1 else np.arctan2(at[1], at[0])) + offset
            q[first.idx_q : first.idx_q + first.nq] = [value] if first.nq == 1 else [np.cos(value), np.sin(value)]
            v[first.idx_v] = coupling.ratio * v[other.idx_v]
            row[first.idx_v], row[other.idx_v] = 1.0, -coupling.ratio
        return rows
