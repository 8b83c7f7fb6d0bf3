# SPDX-License-Identifier: Apache-2.0
"""Redundant constraint equations of closed loops: found once at build, and eliminated.

A planar four-bar has 18 rows of rank 17, so that (6.22) is singular as printed. Redundancy is
determined at generic poses: the mechanism is moved along its own degrees of freedom and closed
again. A singular initial pose is therefore not mistaken for redundancy, and an overconstrained
linkage loses the right rows. Trees have no redundant rows and are skipped.

The eliminated rows must be redundant at every pose. Let U^T J = 0, U with orthonormal columns,
contain the vanishing combinations of rows. The rows D can be eliminated where the square block U_D
is regular; its smallest singular value measures how well. In Bricard's linkage some entries of U
change sign along the motion: without such a row the others lose rank there, although the pose of
the linkage is regular. So the linkage is moved far, and the rows with the best block over all
poses are eliminated. If every row has such a pose, no choice holds for the whole motion.

Elimination differs from a solution with a pseudo-inverse. If round-off crosses the cut-off of the
pseudo-inverse once, the redundant row becomes a constraint with a wrong right-hand side. This
destroys the solution while all residuals stay small.
"""

from functools import lru_cache

import numpy as np

from liegroup_core.errors import SceneError
from liegroup_core.joints.linkage import RANK_TOLERANCE, Linkage, freedoms
from liegroup_core.lie.groups import SE3

TURN = 0.3  # rad (or characteristic lengths) between these poses
MOST_POSES, LEAST_POSES = 40, 3  # 40 rotations of 0.3 rad turn a crank around twice
POSES_WORK = 2e8  # bound on poses times rows cubed: about a second
# The first dependent rows are eliminated, unless the block of others is better by this factor.
MUCH_BETTER = 2.0
# Number of linkages in the cache: an ensemble has many runs of one linkage with other masses.
REMEMBERED = 8


def loop_joints(ends):
    """Indices of the joints that are part of a closed loop, or between loops.

    ends : (parent, child) body of every joint, the world included
    Bodies with a single joint are removed until none is left; the rest has the loops.
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


def loop_groups(ends):
    """Lists of the joints whose closed loops share joints, sorted.

    ends : as above. Joints outside of loops are in no list. Reaction forces of redundant rows are in
    equilibrium on the bodies of a list, and each list moves independently of the others. So each list is
    analysed alone.
    """
    beside = {}
    for j, (a, b) in enumerate(ends):
        beside.setdefault(a, []).append((j, b))
        beside.setdefault(b, []).append((j, a))
    depth, holder, used = {}, {}, set()
    for root in beside:
        if root in depth:
            continue
        depth[root], pending = 0, [root]
        for body in pending:
            for j, other in beside[body]:
                if other not in depth:
                    depth[other], holder[other] = depth[body] + 1, (j, body)
                    used.add(j)
                    pending.append(other)
    leader = list(range(len(ends)))

    def find(j):
        while leader[j] != j:
            leader[j] = leader[leader[j]]
            j = leader[j]
        return j

    for closing in sorted(set(range(len(ends))) - used):
        a, b = ends[closing]
        while a != b:
            a, b = (a, b) if depth[a] >= depth[b] else (b, a)
            j, a = holder[a]
            leader[find(j)] = find(closing)
    groups = {}
    for j in range(len(ends)):
        groups.setdefault(find(j), []).append(j)
    return sorted(group for group in groups.values() if len(group) > 1)


def _constrained_loops(scene):
    """`loop_groups` of the joints of a scene that have constraint equations; a cable closes no loop."""
    numbers = [j for j, joint in enumerate(scene.joints) if joint.constrains]
    ends = [(scene.joints[j].parent, scene.joints[j].child) for j in numbers]
    return [[numbers[i] for i in group] for group in loop_groups(ends)]


def dependent_groups(scene, couplings):
    """[(joints of loops, numbers of couplings)] whose rows can depend on each other.

    couplings : of consistency.ResolvedCoupling
    """
    found = [(set(loops), loops, []) for loops in _constrained_loops(scene)]
    for c, coupling in enumerate(couplings):
        own = set(coupling.joints)
        touching = [part for part in found if part[0] & own]
        found = [part for part in found if not part[0] & own]
        found.append(
            (
                own.union(*(part[0] for part in touching)),
                sorted(j for part in touching for j in part[1]),
                [n for part in touching for n in part[2]] + [c],
            )
        )
    return [part[1:] for part in found]


def kept_rows(scene, frames, parts):
    """Mask (k,) of the rows to keep, of every joint.

    frames : (parent frame, child frame) of every joint, (4, 4) each
    parts  : tuple of joints.elements.Element of every joint
    Raises SceneError for a linkage in a pose that it cannot leave.
    """
    keep = [np.ones(sum(len(part.names) for part in elements), dtype=bool) for elements in parts]
    for loops in _constrained_loops(scene):
        # Joints to ground first: SE(3) satisfies them exactly, so rows of others are eliminated.
        loops.sort(key=lambda j: scene.joints[j].parent != "world")
        _eliminate(scene, Linkage(scene, frames, parts, loops), loops, keep)
    return keep


def _eliminate(scene, linkage, loops, keep):
    """Remove the redundant rows of a linkage of the joints `loops` from the masks of all joints."""
    chosen, moves = _chosen(linkage)
    if not chosen.all() and not moves:
        numbers = np.repeat(loops, [len(keep[j]) for j in loops])
        joint = int(numbers[np.argmin(chosen)])
        raise SceneError(
            f'joints[{joint}] "{scene.joints[joint].name}": its loop is fully stretched or '
            "folded and cannot move, or its axes are almost but not exactly parallel; "
            "start from another pose, change a length, or make the axes exactly parallel",
            ("joints", joint),
        )
    at = 0
    for j in loops:
        keep[j][:] = chosen[at : at + len(keep[j])]
        at += len(keep[j])


@lru_cache(maxsize=REMEMBERED)
def _chosen(linkage):
    """(mask of the rows to keep, whether they have the full rank at all poses) of a linkage."""
    places = generic_poses(linkage)
    matrices = [linkage.jacobian(poses) for poses in places]
    chosen, best = independent_rows(
        matrices,
        [joint.parent == "world" for joint, count in zip(linkage.joints, linkage.counts) for _ in range(count)],
    )
    chosen.flags.writeable = False
    return chosen, bool(chosen.all()) or _moves_freely(linkage, places[best], matrices[best])


def independent_rows(matrices, grounded):
    """Mask of rows that are independent at all poses, with the best condition found.

    matrices : Jacobians (rows, columns) at generic poses, unit rows
    grounded : mask of rows of joints to ground, which are kept if possible
    returns (mask, index of a matrix of full rank)
    """
    ranks = [np.linalg.matrix_rank(matrix, tol=RANK_TOLERANCE) for matrix in matrices]
    rank = max(ranks)
    if rank == len(grounded):
        return np.ones(rank, dtype=bool), int(np.argmax(ranks))
    vanishing = [np.linalg.svd(matrix)[0][:, rank:] for matrix, found in zip(matrices, ranks) if found == rank]
    first = np.flatnonzero(~_independent(matrices[int(np.argmax(ranks))]))
    weight = np.where(grounded, 1.0 / MUCH_BETTER, 1.0)
    best = _spared(vanishing, weight)
    # Near the tolerance the two numbers of dependent rows may differ: then `best` is complete.
    better = len(first) != len(best) or _quality(best, vanishing) > MUCH_BETTER * _quality(first, vanishing)
    mask = np.ones(len(grounded), dtype=bool)
    mask[best if better else first] = False
    return mask, int(np.argmax(ranks))


def _quality(rows, vanishing):
    """Smallest singular value over all poses of the block of these rows: 1 best, 0 singular."""
    return min(np.linalg.svd(U[rows], compute_uv=False)[-1] for U in vanishing)


def _spared(vanishing, weight):
    """Rows that can be eliminated at all poses: greedy, by the largest minimum of the remainder."""
    rest, rows = [U.copy() for U in vanishing], []
    for _ in range(rest[0].shape[1]):
        row = int(np.argmax(weight * np.min([np.linalg.norm(U, axis=1) for U in rest], axis=0)))
        for U in rest:
            direction = U[row] / (np.linalg.norm(U[row]) or 1.0)
            U -= np.outer(U @ direction, direction)
        rows.append(row)
    return np.array(rows)


def _independent(rows):
    """Mask of rows that are independent of earlier ones (Gram-Schmidt, twice for round-off)."""
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


@lru_cache(maxsize=REMEMBERED)
def generic_poses(linkage):
    """Initial poses, and poses that the linkage can move to, each farther than the one before."""
    rng = np.random.default_rng(1)
    places, last, halvings = [linkage.start], None, 0
    matrix = linkage.jacobian(linkage.start)
    count = int(np.clip(POSES_WORK / len(matrix) ** 3, LEAST_POSES, MOST_POSES))
    for _ in range(count):
        free = freedoms(matrix)
        if len(free) == 0:
            break
        move = rng.normal(size=len(free)) @ free
        if last is not None:  # continue the last move, with a small random part
            move *= 0.5 * np.linalg.norm(last) / np.linalg.norm(move)
            move += free.T @ (free @ last)
        move *= TURN * linkage.length / np.abs(move).max()
        # Start from at most twice the last step that closed: an attempt that fails is the most expensive.
        for halving in range(max(0, halvings - 1), 6):
            closed = linkage.closed(linkage.moved(places[-1], move / 2**halving))
            if closed is not None:
                places.append(closed)
                matrix, last, halvings = linkage.jacobian(closed), move, halving
                break
    return places


def _moves_freely(linkage, poses, matrix):
    """True if every direction of the null space is a finite motion, not one of first order only.

    Along a finite motion the closing correction decreases with the square of the step. In a
    singular pose the correction undoes the whole step.
    """
    step = 0.01 * linkage.length
    for free in freedoms(matrix):
        moved = linkage.moved(poses, step * free)
        closed = linkage.closed(moved)
        if closed is None:
            return False
        back = np.concatenate(
            [
                SE3.log(np.linalg.inv(moved[name]) @ closed[name]) * ([linkage.length] * 3 + [1.0] * 3)
                for name in linkage.bodies
            ]
        )
        if np.linalg.norm(back) > 0.3 * step:
            return False
    return True
