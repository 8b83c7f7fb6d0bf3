# SPDX-License-Identifier: Apache-2.0
"""Redundant rows of closed loops: found once, structurally, and left out for good.

A planar four-bar has 18 rows of rank 17, and (6.22) is singular as printed. Which rows depend on
others is judged at generic poses: the mechanism is moved along its own freedoms and closed again,
so that a start in a singular pose is not taken for redundancy, and an overconstrained linkage
loses the right rows. A tree of joints has no redundant row and is not looked at.

Dropping is not the same as solving with a pseudo-inverse: its cut-off, met once by round-off, turns
the dependent row into a constraint with a wrong right-hand side and destroys the solution while
every residual looks perfect.
"""
import numpy as np

from ..errors import SceneError
from ..joints.elements import forbidden_rows, position_residual
from ..lie.groups import SE3

# Singular values of unit rows: a useful one is rarely below 1e-3. Where a linkage is stretched, a gap
# of CLOSED leaves sqrt(CLOSED) = 1e-6 in place of zero.
RANK_TOLERANCE = 3e-5
CLOSED = 1e-12
GENERIC_POSES = 3
TURN = 0.3                                  # rad (or characteristic lengths) between these poses


def loop_joints(ends):
    """Numbers of the joints that are part of a closed loop, or between loops.

    ends : (parent, child) body of every joint, the world being one of them. Bodies that hang on a
    single joint are taken away until there are none; what is left is closed.
    """
    touching = {}
    for j, pair in enumerate(ends):
        for body in pair:
            touching.setdefault(body, set()).add(j)
    hanging = [body for body, joints in touching.items() if len(joints) == 1]
    while hanging:
        body = hanging.pop()
        for j in touching[body]:
            for other in ends[j]:
                if other != body:
                    touching[other].discard(j)
                    if len(touching[other]) == 1:
                        hanging.append(other)
        touching[body] = set()
    return sorted(set().union(*touching.values())) if touching else []


def kept_rows(scene, frames, parts):
    """Which rows of every joint to keep: list of (k,) bool.

    frames : (parent frame, child frame) of every joint, (4, 4) each
    parts  : tuple of joints.elements.Element of every joint
    raises SceneError for a linkage at a pose that it cannot leave
    """
    keep = [np.ones(sum(len(part.forbidden) for part in elements), dtype=bool)
            for elements in parts]
    loops = loop_joints([(joint.parent, joint.child) for joint in scene.joints])
    # Joints to ground first: on SE(3) these are kept exactly, so rows are dropped elsewhere.
    loops.sort(key=lambda j: scene.joints[j].parent != "world")
    if not loops:
        return keep
    linkage = _Linkage(scene, frames, parts, loops)
    places = linkage.generic_poses()
    matrices = [linkage.jacobian(poses) for poses in places]
    ranks = [np.linalg.matrix_rank(matrix, tol=RANK_TOLERANCE) for matrix in matrices]
    best = int(np.argmax(ranks))
    if ranks[best] == len(matrices[best]):
        return keep
    chosen = _independent(matrices[best])
    if not linkage.moves_freely(places[best], matrices[best]):
        numbers = np.repeat(loops, [len(keep[j]) for j in loops])
        joint = int(numbers[np.argmin(chosen)])
        raise SceneError(
            f'joints[{joint}] "{scene.joints[joint].name}": the loop it closes is stretched or '
            "folded to a pose that it cannot leave, where its rows depend on each other; start "
            "from another pose, or change a length", ("joints", joint))
    at = 0
    for j in loops:
        keep[j][:] = chosen[at:at + len(keep[j])]
        at += len(keep[j])
    return keep


def _independent(rows):
    """Mask of the rows that do not depend on earlier ones (Gram-Schmidt, twice for round-off)."""
    basis = np.zeros((0, rows.shape[1]))
    mask = np.zeros(len(rows), dtype=bool)
    for i, row in enumerate(rows):
        rest = row - basis.T @ (basis @ row)
        rest -= basis.T @ (basis @ rest)
        size = np.linalg.norm(rest)
        if size > RANK_TOLERANCE * np.linalg.norm(row):
            basis = np.vstack([basis, rest / size])
            mask[i] = True
    return mask


class _Linkage:
    """The closed part of a scene as dense matrices, lengths in units of its size."""

    def __init__(self, scene, frames, parts, loops):
        self.joints = [scene.joints[j] for j in loops]
        self.frames = [frames[j] for j in loops]
        self.parts = [parts[j] for j in loops]
        names = {name for joint in self.joints for name in (joint.parent, joint.child)}
        self.bodies = [body.name for body in scene.bodies if body.name in names]
        self.start = {body.name: body.pose for body in scene.bodies if body.name in names}
        offsets = [frame[:3, 3] for pair in self.frames for frame in pair]
        self.length = np.sqrt(np.mean(np.square(offsets).sum(axis=1))) or 1.0

    def _relative(self, poses):
        """(joint, elements, child frame, C_rel, C_ba) of every joint at these poses."""
        poses = {**poses, "world": np.eye(4)}
        for joint, elements, (parent, child) in zip(self.joints, self.parts, self.frames):
            between = np.linalg.inv(poses[joint.child]) @ poses[joint.parent]
            yield joint, elements, child, np.linalg.inv(between @ parent) @ child, between

    def jacobian(self, poses):
        """Unit rows (rows, 6 bodies) for velocities (omega length, v)."""
        blocks = []
        for joint, elements, child, relative, between in self._relative(poses):
            rows = forbidden_rows(elements, relative) @ SE3.Ad(np.linalg.inv(child))
            block = np.zeros((len(rows), 6 * len(self.bodies)))
            at = 6 * self.bodies.index(joint.child)
            block[:, at:at + 6] = rows
            if joint.parent != "world":
                at = 6 * self.bodies.index(joint.parent)
                block[:, at:at + 6] = -rows @ SE3.Ad(between)
            blocks.append(block)
        matrix = np.concatenate(blocks)
        matrix.reshape(len(matrix), -1, 6)[:, :, :3] /= self.length
        return matrix / np.linalg.norm(matrix, axis=1, keepdims=True)

    def residual(self, poses):
        """Position residuals of all joints, m and rad."""
        return np.concatenate([position_residual(elements, relative)
                               for _, elements, _, relative, _ in self._relative(poses)])

    def moved(self, poses, step):
        """Poses moved along body twists; step (6 bodies,) as (omega length, v)."""
        step = step.reshape(-1, 6) / np.array([self.length] * 3 + [1.0] * 3)
        return {name: poses[name] @ SE3.exp(twist) for name, twist in zip(self.bodies, step)}

    def closed(self, poses):
        """The nearest closed poses (Newton on the group, least squares), or None."""
        for _ in range(30):
            gap = self.residual(poses)
            if np.abs(gap).max() <= CLOSED * max(1.0, self.length):
                return poses
            poses = self.moved(poses, -np.linalg.lstsq(
                self._plain_jacobian(poses), gap, rcond=RANK_TOLERANCE)[0])
        return None

    def _plain_jacobian(self, poses):
        """Differences of the residual: the residual's own axes, whatever they are."""
        count = 6 * len(self.bodies)
        step = 1e-6 * self.length
        return np.array([
            (self.residual(self.moved(poses, step * unit))
             - self.residual(self.moved(poses, -step * unit))) / (2 * step)
            for unit in np.eye(count)]).T

    def freedoms(self, matrix):
        """Directions (f, 6 bodies) that a Jacobian leaves free."""
        _, sizes, directions = np.linalg.svd(matrix)
        return directions[int((sizes > RANK_TOLERANCE).sum()):]

    def generic_poses(self):
        """The start, and poses that the linkage can move to, each away from the last."""
        rng = np.random.default_rng(1)
        places = [self.start]
        for _ in range(GENERIC_POSES):
            free = self.freedoms(self.jacobian(places[-1]))
            if len(free) == 0:
                break
            move = rng.normal(size=len(free)) @ free
            move *= TURN * self.length / np.abs(move).max()
            for halving in range(6):
                closed = self.closed(self.moved(places[-1], move / 2 ** halving))
                if closed is not None:
                    places.append(closed)
                    break
        return places

    def moves_freely(self, poses, matrix):
        """True when every freedom of the Jacobian is one of the linkage, not of first order only.

        A real freedom is closed by a correction that shrinks with the square of the step; a
        stretched linkage is pulled back by all of it.
        """
        step = 0.01 * self.length
        for free in self.freedoms(matrix):
            moved = self.moved(poses, step * free)
            closed = self.closed(moved)
            if closed is None:
                return False
            back = np.concatenate([SE3.log(np.linalg.inv(moved[name]) @ closed[name])
                                   * ([self.length] * 3 + [1.0] * 3) for name in self.bodies])
            if np.linalg.norm(back) > 0.3 * step:
                return False
        return True
