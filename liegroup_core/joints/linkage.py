# SPDX-License-Identifier: Apache-2.0
"""Bodies and joints as dense matrices in NumPy: closing loops, and the rows of the joints.

For what is done once per scene: finding redundant rows, and assembly. Lengths are in units of the
linkage's size, so that turns and shifts compare. Poses are {body: (4, 4)}, the world included.
"""

from functools import cached_property

import numpy as np
import scipy.linalg

from liegroup_core.lie.groups import SE3

from .kinds import forbidden_rows, position_residual

# Singular values of unit rows: a useful one is rarely below 1e-3. Where a linkage is stretched, a
# gap of CLOSED leaves sqrt(CLOSED) = 1e-6 in place of zero.
RANK_TOLERANCE = 3e-5
CLOSED = 1e-12
ROUND_OFF = 4e-16
MOST_ROUNDS = 50
LARGEST_TURN = 1.0  # rad in a round: a full step from afar leads anywhere
MOST_HALVINGS = 8


def inverse(C):
    """C^-1 of a pose (4, 4)."""
    result = np.eye(4)
    result[:3, :3] = C[:3, :3].T
    result[:3, 3] = -C[:3, :3].T @ C[:3, 3]
    return result


def _are_angular(rows):
    """Which rows (k, 6) forbid nothing but turns."""
    return rows[:, :3].any(axis=1) & ~rows[:, 3:].any(axis=1)


def freedoms(matrix):
    """Directions (f, columns) that a matrix of unit rows leaves free."""
    _, sizes, directions = np.linalg.svd(matrix)
    return directions[int((sizes > RANK_TOLERANCE).sum()) :]


class Linkage:
    """Some joints of a scene, and the bodies they hold.

    frames : (parent frame, child frame) of every joint of the scene, (4, 4) each
    parts  : tuple of joints.elements.Element of every joint of the scene
    joints : numbers of those that are looked at
    held   : names of bodies that do not move
    Two are equal when all these numbers are: what was found of one need not be found again.
    """

    def __init__(self, scene, frames, parts, joints, held=()):
        self.joints = [scene.joints[j] for j in joints]
        self.frames = [frames[j] for j in joints]
        self.parts = [parts[j] for j in joints]
        self.counts = [sum(len(part.names) for part in elements) for elements in self.parts]
        names = {name for joint in self.joints for name in (joint.parent, joint.child)}
        self.start = {body.name: body.pose for body in scene.bodies} | {"world": np.eye(4)}
        self.bodies = [
            body.name for body in scene.bodies if body.name in names and body.name not in held
        ]
        self.place = {name: 6 * i for i, name in enumerate(self.bodies)}
        offsets = [np.sum(frame[:3, 3] ** 2) for pair in self.frames for frame in pair]
        self.length = np.sqrt(np.mean(offsets or [0.0])) or 1.0

    @cached_property
    def _key(self):
        """All that it is made of, to the bit."""
        ends = {name for joint in self.joints for name in (joint.parent, joint.child)}
        return (
            tuple((joint.type, joint.parent, joint.child) for joint in self.joints),
            tuple(self.bodies),
            np.array(self.frames).tobytes(),
            tuple(
                (part.kind, part.forbidden.tobytes(), part.parameter)
                for parts in self.parts
                for part in parts
            ),
            tuple((name, pose.tobytes()) for name, pose in self.start.items() if name in ends),
        )

    def __eq__(self, other):
        return isinstance(other, Linkage) and self._key == other._key

    def __hash__(self):
        return hash(self._key)

    def relative(self, j, poses):
        """C_rel of the j-th of the joints: pose of the child's joint frame in the parent's one."""
        joint, (parent, child) = self.joints[j], self.frames[j]
        return inverse(poses[joint.parent] @ parent) @ poses[joint.child] @ child

    def joint_rows(self, j, poses):
        """Rows (k, 6) of the j-th of the joints for the relative twist in the child's body frame."""
        return forbidden_rows(self.parts[j], self.relative(j, poses)) @ SE3.Ad(
            inverse(self.frames[j][1])
        )

    def velocity_rows(self, poses, rows=None):
        """Rows (rows, 6 bodies) for twists (omega, v) of the bodies.

        rows : (k, 6) for the twist of the child against the parent, in the child's body frame, of
               every joint; those of the joints themselves if left out
        """
        if rows is None:
            rows = [self.joint_rows(j, poses) for j in range(len(self.joints))]
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
        matrix.reshape(len(matrix), -1, 6)[:, :, :3] /= self.length
        sizes = np.linalg.norm(matrix, axis=1, keepdims=True)
        return matrix / np.where(sizes > 0.0, sizes, 1.0)

    @cached_property
    def _units(self):
        """Unit of each row of the joints: 1 rad, or the length."""
        return np.concatenate(
            [
                np.zeros(0),
                *(
                    np.where(
                        _are_angular(forbidden_rows(part, self.relative(j, self.start))),
                        1.0,
                        self.length,
                    )
                    for j, part in enumerate(self.parts)
                ),
            ]
        )

    def _gaps(self, poses):
        """Position residuals of all joints, rad and in units of the length."""
        return (
            np.concatenate(
                [np.zeros(0), *(self.joint_residual(j, poses) for j in range(len(self.joints)))]
            )
            / self._units
        )

    def joint_residual(self, j, poses):
        """Position residual (k,) of the j-th of the joints; closed, its slope is that of its rows."""
        return position_residual(self.parts[j], self.relative(j, poses))

    def gap(self, j, poses):
        """How far the j-th of the joints is open: m and rad."""
        angular = _are_angular(forbidden_rows(self.parts[j], self.relative(j, poses)))
        residual = self.joint_residual(j, poses)
        return np.linalg.norm(residual[~angular]), np.linalg.norm(residual[angular])

    def moved(self, poses, step):
        """Poses moved along body twists; step (6 bodies,) as (omega length, v)."""
        step = step.reshape(-1, 6) / np.array([self.length] * 3 + [1.0] * 3)
        return poses | {
            name: poses[name] @ SE3.exp(twist) for name, twist in zip(self.bodies, step)
        }

    def closed(self, poses):
        """The nearest closed poses, or None."""
        poses = self.nearest(poses)
        return poses if self.is_closed(poses) else None

    def is_closed(self, poses):
        """True when all residuals are small enough to be called closed."""
        return self._is_small(self._gaps(poses), poses, CLOSED)

    def _is_small(self, gap, poses, tolerance):
        """True when a residual is this small next to the coordinates it comes from."""
        farthest = max((np.abs(poses[name][:3, 3]).max() for name in self.bodies), default=0.0)
        return np.abs(gap).max(initial=0.0) <= tolerance * max(1.0, farthest / self.length)

    def nearest(self, poses):
        """The poses that Newton's method on the group ends at: closed, or with a least gap.

        Each round takes the shortest step that closes the linearised joints, or the half, the
        quarter ... of it, so that the gap shrinks; it ends when that does not help any more.
        Near closed poses the gap is squared in each round, down to round-off.
        """
        for _ in range(MOST_ROUNDS if self.bodies else 0):
            gap = self._gaps(poses)
            if self._is_small(gap, poses, ROUND_OFF):
                break
            # The joints' rows are the slope of the residual where it vanishes; from afar its
            # differences may do what they do not.
            better = self._step(poses, gap, self.velocity_rows(poses))
            if better is None and not self._is_small(gap, poses, CLOSED):
                better = self._step(poses, gap, self._differences(poses))
            if better is None:
                break
            poses = better
        return poses

    def _step(self, poses, gap, matrix):
        """Poses with a smaller gap by a step along a Jacobian for twists (omega, v), or None."""
        matrix /= self._units[:, None]
        matrix.reshape(len(matrix), -1, 6)[:, :, :3] /= self.length
        step = -scipy.linalg.lstsq(matrix, gap, cond=RANK_TOLERANCE, lapack_driver="gelsy")[0]
        turn = np.abs(step.reshape(-1, 6)[:, :3]).max() / self.length
        part = 1.0 / max(1.0, turn / LARGEST_TURN)
        # Of closed joints only round-off is left, which no half of a step makes smaller.
        closed = self._is_small(gap, poses, CLOSED)
        enough = 0.5 if closed else 0.01
        for _ in range(1 if closed else MOST_HALVINGS):
            moved = self.moved(poses, part * step)
            if np.linalg.norm(self._gaps(moved)) < (1.0 - enough * part) * np.linalg.norm(gap):
                return moved
            part /= 2.0
        return None

    def _differences(self, poses):
        """Differences of the residual by twists (omega, v) of the bodies."""
        step = 1e-6
        matrix = np.zeros((sum(self.counts), 6 * len(self.bodies)))
        first = 0
        for j, (joint, count) in enumerate(zip(self.joints, self.counts)):
            for name in {joint.parent, joint.child} & self.place.keys():
                for c in range(6):
                    nudge = step * np.eye(6)[c] * (1.0 if c < 3 else self.length)
                    ahead, behind = (
                        self.joint_residual(j, poses | {name: poses[name] @ SE3.exp(sign * nudge)})
                        for sign in (1.0, -1.0)
                    )
                    matrix[first : first + count, self.place[name] + c] = (ahead - behind) / (
                        2.0 * np.abs(nudge).max()
                    )
            first += count
        return matrix
