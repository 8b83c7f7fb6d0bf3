# SPDX-License-Identifier: Apache-2.0
"""Elimination order and fill of S = J M^-1 J^T, found once when a model is built.

Joints are the vertices of a graph, two of them neighbours when they share a moving body. The
order is by minimum degree: a chain or tree then has no fill and costs O(n). Each joint owns a
dense k x k block of S; blocks lie one behind the other in a flat array.
"""
import numpy as np


def elimination_order(neighbours):
    """Order of the joints by minimum degree, and which later joints each one is coupled with.

    neighbours : list of sets, neighbours[j] the joints that share a moving body with joint j
    returns (order, below): order[p] the joint eliminated p-th; below[p] the joints, in positions
    of that order, that have a block below the diagonal of column p, fill included
    """
    graph = [set(near) for near in neighbours]
    order, near_when_eliminated = [], []
    left = set(range(len(graph)))
    while left:
        # Ties go to the lowest index, so that the same scene always gives the same order.
        joint = min(left, key=lambda j: (len(graph[j]), j))
        near = graph[joint]
        for other in near:
            graph[other] |= near - {other}
            graph[other].discard(joint)
        left.discard(joint)
        order.append(joint)
        near_when_eliminated.append(near)
    position = {joint: p for p, joint in enumerate(order)}
    below = [sorted(position[j] for j in near) for near in near_when_eliminated]
    return order, below


def block_layout(rows, below):
    """Places of all blocks of the lower triangle, and the updates of a right-looking Cholesky.

    rows  : (m,) rows k of each joint in elimination order
    below : from elimination_order
    returns (place, size, ranges, columns, updates): place[i, j] of every block, the length of the
    flat array, per joint (diagonal, column_start, column_end, update_start, update_end) of JOINT,
    and the arrays columns and updates of Model
    """
    place, size = {}, 0
    for j, coupled in enumerate(below):
        for i in [j, *coupled]:
            place[i, j] = size
            size += int(rows[i] * rows[j])
    ranges, columns, updates = [], [], []
    for j, coupled in enumerate(below):
        column_start, update_start = len(columns), len(updates)
        for a, i in enumerate(coupled):
            columns.append((i, place[i, j]))
            for k in coupled[:a + 1]:
                updates.append((place[i, k], place[i, j], place[k, j], i, k))
        ranges.append((place[j, j], column_start, len(columns), update_start, len(updates)))
    return (place, size, ranges, np.array(columns, dtype=np.int64).reshape(-1, 2),
            np.array(updates, dtype=np.int64).reshape(-1, 5))
