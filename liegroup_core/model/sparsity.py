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

from .arrays import JOINT, VERTEX, WORLD


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


class Structure:
    """Blocks of K for some bodies and the joints between them.

    body : scalars of a body, 6 or, in a plane, 3
    n    : number of bodies
    rows : scalars of each joint, one at least
    ends : (parent, child) body of each joint; the parent may be WORLD
    vertices, columns, updates : of Model
    """

    def __init__(self, body, n, rows, ends):
        self._body, self._n, self._rows, self._ends = body, n, rows, ends
        sizes = [body] * n + list(rows)         # bodies 0..n-1, then joints
        neighbours = [set() for _ in sizes]
        for j, pair in enumerate(ends):
            for end in pair:
                if end != WORLD:
                    neighbours[end].add(n + j)
                    neighbours[n + j].add(end)
        order, below = elimination_order(sizes, neighbours, n)
        self._position = {v: p for p, v in enumerate(order)}
        sizes = np.array([sizes[v] for v in order], dtype=np.int64)
        self._starts = np.concatenate([[0], np.cumsum(sizes)[:-1]]).astype(np.int64)
        self.unknowns = int(sizes.sum())
        self._place, self._size, ranges, self.columns, self.updates = block_layout(sizes, below)
        self.vertices = np.array(
            [(order[p] - n if order[p] >= n else -1, sizes[p], self._starts[p], *ranges[p])
             for p in range(len(order))], dtype=VERTEX)

    def start(self, vertex):
        """Place of a vertex, body i or joint n + j, in Work.solution."""
        return self._starts[self._position[vertex]]

    def joints(self):
        """(m,) of JOINT, all but their kinds and elements."""
        joints = np.zeros(len(self._ends), dtype=JOINT)
        firsts = np.concatenate([[0], np.cumsum(self._rows)])
        for j, (parent, child) in enumerate(self._ends):
            joint = joints[j]
            joint["parent"], joint["child"] = parent, child
            joint["rows"], joint["first"] = self._rows[j], firsts[j]
            joint["start"] = self.start(self._n + j)
            joint["child_place"], joint["child_turned"] = self._block(j, child)
            joint["parent_place"], joint["parent_turned"] = self._block(j, parent)
        return joints

    def _block(self, joint, body):
        """Place of the block of a joint and a body in K, and 1 if it holds the rows as columns."""
        if body == WORLD:
            return -1, 0
        joint, body = self._position[self._n + joint], self._position[body]
        return self._place[max(joint, body), min(joint, body)], int(body > joint)

    def constant_part(self, masses, jacobians):
        """The flat array of K with M and the children's rows, the rest zero.

        masses    : mass matrix of each body
        jacobians : (k, body) rows of each joint for its child; zeros where the pose decides
        """
        constant = np.zeros(self._size)
        for i, matrix in enumerate(masses):
            at = self._place[self._position[i], self._position[i]]
            constant[at:at + matrix.size] = matrix.ravel()
        for j, jacobian in enumerate(jacobians):
            at, turned = self._block(j, self._ends[j][1])
            constant[at:at + jacobian.size] = (jacobian.T if turned else jacobian).ravel()
        return constant
