# SPDX-License-Identifier: Apache-2.0
"""Loop closure and Jacobian of bodies and joints, with dense matrices in NumPy.

Used once per scene, for the detection of redundant rows and for assembly. Lengths are in units of the
linkage's characteristic length, so that rotations and translations are comparable. Poses are
{body: (4, 4)} and include the world.
"""

from functools import cached_property

import numpy as np
import scipy

from liegroup_core.lie.groups import SE3

from .coupling import coordinate, difference, gap, rate_row, turns
from .kinds import forbidden_rows, position_residual
from .rolling import is_holonomic

# Smallest singular value, for unit rows, that counts as independent. Independent rows rarely have one below
# 1e-3. In a singular pose, a residual of CLOSED gives sqrt(CLOSED) = 1e-6 instead of zero.
RANK_TOLERANCE = 3e-5
CLOSED = 1e-12
ROUND_OFF = 4e-16
MOST_ROUNDS = 50
LARGEST_TURN = 1.0  # rad per iteration; far from the solution, full steps may diverge
MOST_HALVINGS = 8


def inverse(C):
    """C^-1 of a pose (4, 4)."""
    result = np.eye(4)
    result[:3, :3] = C[:3, :3].T
    result[:3, 3] = -C[:3, :3].T @ C[:3, 3]
    return result


def _are_angular(rows):
    """Mask (k,) of the rows (k, 6) that forbid rotations only."""
    return rows[:, :3].any(axis=1) & ~rows[:, 3:].any(axis=1)


def freedoms(matrix):
    """Null space (f, columns) of a matrix of unit rows."""
    _, sizes, directions = np.linalg.svd(matrix)
    return directions[int((sizes > RANK_TOLERANCE).sum()) :]


class Linkage:
    """Selected joints of a scene, and the bodies that they connect.

    frames : (parent frame, child frame) of every joint of the scene, (4, 4) each
    parts  : tuple of joints.elements.Element of every joint of the scene
    joints : indices of the selected joints
    held   : names of bodies that do not move
    couplings : [consistency.ResolvedCoupling]; their joints are indices into the selected joints
    Linkages with equal numbers are equal and have equal hashes, so that results can be cached.
    """

    def __init__(self, scene, frames, parts, joints, held=(), couplings=()):
        self.numbers = list(joints)
        self.joints = [scene.joints[j] for j in joints]
        self.frames = [frames[j] for j in joints]
        self.parts = [parts[j] for j in joints]
        self.couplings = couplings
        self.counts = [sum(len(part.names) for part in elements) for elements in self.parts]
        names = {name for joint in self.joints for name in (joint.parent, joint.child)}
        self.start = {body.name: body.pose for body in scene.bodies} | {"world": np.eye(4)}
        self.bodies = [body.name for body in scene.bodies if body.name in names and body.name not in held]
        self.place = {name: 6 * i for i, name in enumerate(self.bodies)}
        offsets = [np.sum(frame[:3, 3] ** 2) for pair in self.frames for frame in pair]
        self.length = np.sqrt(np.mean(offsets or [0.0])) or 1.0

    @cached_property
    def _key(self):
        """All numbers of the linkage, as a hashable tuple."""
        ends = {name for joint in self.joints for name in (joint.parent, joint.child)}
        return (
            tuple((joint.type, joint.parent, joint.child) for joint in self.joints),
            tuple(self.bodies),
            tuple(self.couplings),
            np.array(self.frames).tobytes(),
            tuple((part.kind, part.forbidden.tobytes(), part.parameter) for parts in self.parts for part in parts),
            tuple((name, pose.tobytes()) for name, pose in self.start.items() if name in ends),
        )

    def __eq__(self, other):
        return isinstance(other, Linkage) and self._key == other._key

    def __hash__(self):
        return hash(self._key)

    def relative(self, j, poses):
        """C_rel of joint j: pose of the child's joint frame in the parent's."""
        joint, (parent, child) = self.joints[j], self.frames[j]
        return inverse(poses[joint.parent] @ parent) @ poses[joint.child] @ child

    def joint_rows(self, j, poses):
        """Rows (k, 6) of joint j for the relative twist in the child's body frame."""
        return forbidden_rows(self.parts[j], self.relative(j, poses)) @ self._to_joint[j]

    @cached_property
    def _to_joint(self):
        """[(6, 6)] for each joint: transforms twists from the child's body frame to its joint frame."""
        return [SE3.Ad(inverse(child)) for _, child in self.frames]

    @cached_property
    def _is_holonomic(self):
        """(rows,) whether a row is the derivative of a residual: those of rolling forbid velocities only."""
        kinds = [is_holonomic(part.kind) for parts in self.parts for part in parts for _ in part.names]
        return np.array(kinds + [True] * len(self.couplings), dtype=bool)

    def velocity_rows(self, poses):
        """Rows (rows, 6 bodies) of all joints, then of all couplings, for twists of the bodies."""
        own = [self.joint_rows(j, poses) for j in range(len(self.joints))]
        return np.concatenate([self.relative_rows(poses, own), self._coupling_rows(poses)])

    def _coupling_rows(self, poses):
        """Rows (couplings, 6 bodies)."""
        coupled = sorted({j for entry in self.couplings for j in entry.joints})
        rates = [np.zeros((0, 6))] * len(self.joints)
        for j in coupled:
            rates[j] = rate_row(self.joints[j], self.frames[j][1])[None]
        rates = dict(zip(coupled, self.relative_rows(poses, rates)))
        rows = [
            sum(factor * rates[j] for j, factor in zip(entry.joints, self.factors(entry, poses)))
            for entry in self.couplings
        ]
        return np.array(rows).reshape(len(self.couplings), 6 * len(self.bodies))

    def relative_rows(self, poses, rows):
        """Rows (rows, 6 bodies) for twists (omega, v) of the bodies.

        rows : [(k, 6)] for each joint, for the twist of the child relative to the parent, in the
               child's body frame
        """
        matrix = np.zeros((sum(len(part) for part in rows), 6 * len(self.bodies)))
        first = 0
        for joint, part in zip(self.joints, rows):
            block = matrix[first : first + len(part)]
            first += len(part)
            if joint.child in self.place:
                at = self.place[joint.child]
                block[:, at : at + 6] = part
            if joint.parent in self.place:
                at = self.place[joint.parent]
                between = inverse(poses[joint.child]) @ poses[joint.parent]
                block[:, at : at + 6] = -part @ SE3.Ad(between)
        return matrix

    def jacobian(self, poses):
        """Unit rows (rows, 6 bodies) for velocities (omega length, v)."""
        matrix = self.velocity_rows(poses)
        matrix.reshape(len(matrix), matrix.shape[1] // 6, 6)[:, :, :3] /= self.length
        sizes = np.linalg.norm(matrix, axis=1, keepdims=True)
        return matrix / np.where(sizes > 0.0, sizes, 1.0)

    @cached_property
    def _units(self):
        """Unit of each row of the joints: 1 rad, or the length."""
        return np.concatenate(
            [
                np.zeros(0),
                *(
                    np.where(_are_angular(forbidden_rows(part, self.relative(j, self.start))), 1.0, self.length)
                    for j, part in enumerate(self.parts)
                ),
                [1.0 if turns(self.joints[entry.joint]) else self.length for entry in self.couplings],
            ]
        )

    def _gaps(self, poses):
        """Residuals of all joints and couplings, rad and in units of the characteristic length."""
        joints = (self.joint_residual(j, poses) for j in range(len(self.joints)))
        couplings = [self.coupling_gap(entry, poses) for entry in self.couplings]
        return np.concatenate([np.zeros(0), *joints, couplings]) / self._units

    def _coordinate(self, j, poses):
        """Coordinate of joint j; an angle is unwrapped from its value at the start."""
        q = coordinate(self.joints[j], self.relative(j, poses))
        if turns(self.joints[j]):
            before = coordinate(self.joints[j], self.relative(j, self.start))
            q = before + difference(q, before, True)
        return q

    def factors(self, entry, poses):
        """Factors of the rates of the joints of a coupling in its row."""
        return entry.factors(self._coordinate(entry.other, poses) if entry.curve else 0.0)

    def coupling_gap(self, entry, poses):
        """Residual of a coupling, rad or m."""
        at = {j: self._coordinate(j, poses) for j in entry.joints}
        return gap(entry, at, turns(self.joints[entry.joint]))

    def joint_residual(self, j, poses):
        """Position residual (k,) of joint j; where it is zero, its derivative is joint_rows."""
        return position_residual(self.parts[j], self.relative(j, poses))

    def gap(self, j, poses):
        """Norms of the position residual of joint j: linear in m, angular in rad."""
        angular = _are_angular(forbidden_rows(self.parts[j], self.relative(j, poses)))
        residual = self.joint_residual(j, poses)
        return np.linalg.norm(residual[~angular]), np.linalg.norm(residual[angular])

    def moved(self, poses, step):
        """Poses moved along body twists; step (6 bodies,) as (omega length, v)."""
        step = step.reshape(-1, 6) / np.array([self.length] * 3 + [1.0] * 3)
        return poses | {name: poses[name] @ SE3.exp(twist) for name, twist in zip(self.bodies, step)}

    def closed(self, poses):
        """Nearest poses that satisfy all joints, or None."""
        poses = self.nearest(poses)
        return poses if self.is_closed(poses) else None

    def is_closed(self, poses):
        """True if all residuals are below CLOSED."""
        return self._is_small(self._gaps(poses), poses, CLOSED)

    def _is_small(self, gap, poses, tolerance):
        """True if a residual is small relative to the coordinates from which it is computed."""
        farthest = max((np.abs(poses[name][:3, 3]).max() for name in self.bodies), default=0.0)
        return np.abs(gap).max(initial=0.0) <= tolerance * max(1.0, farthest / self.length) < np.inf

    def nearest(self, poses):
        """Poses found by Newton's method on the group: they satisfy all joints, or minimise the residual locally.

        Each iteration takes the shortest step that satisfies the linearised joints. The step is halved
        until the residual decreases. If it does not decrease, the iteration ends. Convergence is quadratic,
        down to round-off.
        """
        for _ in range(MOST_ROUNDS if self.bodies else 0):
            gap = self._gaps(poses)
            if self._is_small(gap, poses, ROUND_OFF):
                break
            # The rows are the derivative of the residual only where it vanishes. Elsewhere, finite
            # differences may converge although the rows do not.
            rows = self.velocity_rows(poses)
            rows[~self._is_holonomic] = 0.0
            better = self._step(poses, gap, rows)
            if better is None and not self._is_small(gap, poses, CLOSED):
                better = self._step(poses, gap, self._differences(poses))
            if better is None:
                break
            poses = better
        return poses

    def _step(self, poses, gap, matrix):
        """Poses with a smaller residual after a Newton step with a Jacobian, or None."""
        matrix /= self._units[:, None]
        matrix.reshape(len(matrix), matrix.shape[1] // 6, 6)[:, :, :3] /= self.length
        step = -scipy.linalg.lstsq(matrix, gap, cond=RANK_TOLERANCE, lapack_driver="gelsy")[0]
        turn = np.abs(step.reshape(-1, 6)[:, :3]).max() / self.length
        part = 1.0 / max(1.0, turn / LARGEST_TURN)
        # The residual of satisfied joints is round-off, which halving the step does not reduce.
        closed = self._is_small(gap, poses, CLOSED)
        enough = 0.5 if closed else 0.01
        for _ in range(1 if closed else MOST_HALVINGS):
            moved = self.moved(poses, part * step)
            if np.linalg.norm(self._gaps(moved)) < (1.0 - enough * part) * np.linalg.norm(gap):
                return moved
            part /= 2.0
        return None

    def _differences(self, poses):
        """Jacobian of the residual for twists (omega, v) of the bodies, by central differences."""
        step = 1e-6
        matrix = np.zeros((sum(self.counts) + len(self.couplings), 6 * len(self.bodies)))
        matrix[sum(self.counts) :] = self._coupling_rows(poses)
        first = 0
        for j, (joint, count) in enumerate(zip(self.joints, self.counts)):
            for name in {joint.parent, joint.child} & self.place.keys():
                for c in range(6):
                    nudge = step * np.eye(6)[c] * (1.0 if c < 3 else self.length)
                    ahead, behind = (
                        self.joint_residual(j, poses | {name: poses[name] @ SE3.exp(sign * nudge)})
                        for sign in (1.0, -1.0)
                    )
                    matrix[first : first + count, self.place[name] + c] = (ahead - behind) / (2.0 * np.abs(nudge).max())
            first += count
        return matrix
