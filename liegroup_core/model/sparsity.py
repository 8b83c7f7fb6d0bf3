# SPDX-License-Identifier: Apache-2.0
"""Elimination order and fill of the saddle-point matrix, found once when a model is built.

    K = | M  J^T |      vertices: the bodies, blocks of 6, and the joints, blocks of k rows;
        | J   0  |      an edge between a joint and each moving body it touches

A body is eliminated by its mass; what it leaves with its joints is -J M^-1 J^T. Leaves go first:
in a tree, body, joint, parent and so on down to the ground, each joint ADDS the inertia of all
beyond it to its parent, and no digits cancel whatever the ratio of the masses. (S = J M^-1 J^T,
the usual shortcut, subtracts: it loses as many digits as the ratio of neighbouring masses has.) A
chain or tree costs O(n), without fill. In a loop a joint waits for all of its bodies, since a
chain that is held at its far end may not move freely where the joint is: there K is reduced to
S, by minimum degree.
"""
import heapq

import numpy as np


def elimination_order(sizes, neighbours, bodies):
    """Order of the vertices, and which later vertices each one is coupled with.

    sizes      : (v,) scalars per vertex
    neighbours : list of sets of vertices; edges join bodies with joints
    bodies     : vertices below this number are bodies, the others joints
    returns (order, below): order[p] the vertex eliminated p-th; below[p] the positions, in that
    order, of the blocks below the diagonal of column p, fill included
    """
    graph = [set(near) for near in neighbours]
    waiting = [len(near) for near in neighbours]          # of a joint: its bodies not yet gone
    ready = [v < bodies for v in range(len(graph))]
    left = set(range(len(graph)))
    order, near_when_eliminated = [], []
    # Candidates by cost; a vertex whose cost changes is entered again, the old entry is stale.
    heap = []

    def cost(v):
        return len(graph[v]) > 1, sum(sizes[w] for w in graph[v]), v < bodies, v

    for v in left:
        if ready[v]:
            heapq.heappush(heap, cost(v))
    while left:
        entry = heapq.heappop(heap)
        v = entry[-1]
        if v not in left or entry != cost(v):
            continue
        near = graph[v]
        for other in near:
            graph[other] |= near - {other}
            graph[other].discard(v)
        left.discard(v)
        if v < bodies:
            for joint in neighbours[v]:
                waiting[joint] -= 1
                # All its bodies are gone, or the part beyond it, a tree, moves freely.
                ready[joint] |= waiting[joint] == 0 or len(near) == 1
        for other in near:
            if ready[other]:
                heapq.heappush(heap, cost(other))
        order.append(v)
        near_when_eliminated.append(near)
    position = {v: p for p, v in enumerate(order)}
    return order, [sorted(position[w] for w in near) for near in near_when_eliminated]


def block_layout(sizes, below):
    """Places of all blocks of the lower triangle, and the updates of a right-looking elimination.

    sizes : (v,) scalars of each vertex in elimination order
    below : from elimination_order
    returns (place, size, ranges, columns, updates): place[i, j] of every block, the length of the
    flat array, per vertex (diagonal, column_start, column_end, update_start, update_end) of
    VERTEX, and the arrays columns and updates of Model
    """
    place, size = {}, 0
    for j, coupled in enumerate(below):
        for i in [j, *coupled]:
            place[i, j] = size
            size += int(sizes[i] * sizes[j])
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
