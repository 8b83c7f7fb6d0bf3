# SPDX-License-Identifier: Apache-2.0
"""Elimination order and fill of the saddle-point matrix, found once when a model is built.

    K = | M  J^T |      vertices: the bodies, blocks of 6, and the joints, blocks of k rows;
        | J   0  |      an edge between a joint and each moving body it touches

Eliminating a body by its mass adds -J M^-1 J^T to the blocks of its joints. There are two orders
for a tree, both O(n) for a chain:
  leaves first    body, joint, parent and so on, without fill. Each joint ADDS the inertia of the
                  subtree to its parent: no cancellation, whatever the ratio of the masses
  bodies first    K is reduced to S = J M^-1 J^T, where all joints of a body are coupled. Mass
                  matrices are constant and eliminated once; the rest has the size of the joint
                  rows. It SUBTRACTS: it loses the digits of the ratio of neighbouring masses
In a loop a joint is eliminated after all of its bodies: the subtree beyond it may have no free
motion at the joint. There K is reduced to S, by minimum degree.

Blocks that no pose changes are eliminated here, once.
"""

import heapq

import numpy as np
import scipy

from liegroup_core.joints.elements import WORLD

from .arrays import JOINT, VERTEX

SCALARS = 6  # of a body


def elimination_order(sizes, neighbours, bodies, bodies_first=False):
    """Elimination order of the vertices, and their fill.

    sizes      : (v,) scalars per vertex
    neighbours : list of sets of vertices; edges join bodies with joints
    bodies     : vertices below this number are bodies, the others joints
    bodies_first : True: joints of trees, too, are eliminated after their bodies
    returns (order, below): order[p] the vertex eliminated p-th; below[p] the positions, in that
    order, of the blocks below the diagonal of column p, fill included
    """
    graph = [set(near) for near in neighbours]
    waiting = [len(near) for near in neighbours]  # of a joint: bodies not yet eliminated
    ready = [v < bodies for v in range(len(graph))]
    left = set(range(len(graph)))
    order, near_when_eliminated = [], []
    # Candidates by cost; a vertex whose cost changes is pushed again, the old entry is stale.
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
                ready[joint] |= waiting[joint] == 0 or (len(near) == 1 and not bodies_first)
        for other in near:
            if ready[other]:
                heapq.heappush(heap, cost(other))
        order.append(v)
        near_when_eliminated.append(near)
    position = {v: p for p, v in enumerate(order)}
    return order, [sorted(position[w] for w in near) for near in near_when_eliminated]


def block_layout(sizes, below, changing):
    """Addresses of all blocks of the lower triangle, and updates of a right-looking elimination.

    sizes    : (v,) scalars of each vertex in elimination order
    below    : from elimination_order
    changing : pairs (i, j), i >= j, of the blocks of K that poses change
    returns (place, ends, ranges, columns, updates): place[i, j] of every block in the flat array;
    where the parts of that end: the blocks that elimination adds to, those that are written anew at
    every pose, all others, scratch memory; per vertex (is_constant, diagonal, column_start,
    column_fresh, column_end, update_start, update_end) of VERTEX; the arrays columns and updates
    of Model
    """
    written, changing = set(changing), set(changing)
    for j, coupled in enumerate(below):
        if (j, j) in changing:
            changing.update((i, j) for i in coupled)
        changing.update(
            (i, k)
            for a, i in enumerate(coupled)
            for k in coupled[: a + 1]
            if (i, j) in changing or (k, j) in changing
        )
    blocks = [(i, j) for j, coupled in enumerate(below) for i in [j, *coupled]]
    blocks.sort(key=lambda block: (block not in changing, block in written))
    place, size, summed, fresh = {}, 0, 0, 0
    for block in blocks:
        place[block] = size
        size += int(sizes[block[0]] * sizes[block[1]])
        if block in changing:
            fresh = size
            if block not in written:
                summed = size
    end = size + max(sizes)
    ranges, columns, updates = [], [], []
    for j, coupled in enumerate(below):
        column_start, update_start = len(columns), len(updates)
        constant = [i for i in coupled if (i, j) not in changing]
        columns += [(i, place[i, j], -1) for i in constant]
        scratch, free = {}, size
        for i in coupled:
            if (i, j) in changing:
                scratch[i] = free
                free += int(sizes[i] * sizes[j])
                columns.append((i, place[i, j], scratch[i]))
        end = max(end, free)
        for a, i in enumerate(coupled):
            for k in coupled[: a + 1]:
                if k in scratch:
                    updates.append((place[i, k], place[i, j], scratch[k], i, k))
                elif i in scratch:
                    updates.append((place[i, k], scratch[i], place[k, j], i, k))
        ranges.append(
            (
                (j, j) not in changing,
                place[j, j],
                column_start,
                column_start + len(constant),
                len(columns),
                update_start,
                len(updates),
            )
        )
    return (
        place,
        (summed, fresh, size, end),
        ranges,
        np.array(columns, dtype=np.int64).reshape(-1, 3),
        np.array(updates, dtype=np.int64).reshape(-1, 5),
    )


def operations(vertices, columns, updates):
    """Number of additions and multiplications of an elimination at a new pose and one solve.

    vertices, columns, updates : of Model
    """
    size = vertices["size"]
    # A Cholesky factor of k x k takes k^3 / 3, a block of r x k divided by it r k^2, and an update
    # of r x s from k columns 2 r s k, or half of it for the lower triangle of a square. A solve
    # takes two triangles of every vertex, k^2 each. In place of k^2 a constant body, a matrix of
    # t x t and one number, takes 2 t (t - 1) + k, with t = k // 2.
    factor = float((size[vertices["is_constant"] == 0] ** 3).sum()) / 3.0
    solve = 0.0
    for vertex in vertices:
        k = int(vertex["size"])
        first, fresh, end = (vertex[f"column_{each}"] for each in ("start", "fresh", "end"))
        row = k * k
        if vertex["joint"] < 0 and vertex["is_constant"]:
            row = 2 * (k // 2) * (k // 2 - 1) + k
        factor += float(size[columns[fresh:end, 0]].sum()) * row
        solve += 2.0 * row + 4.0 * float((size[columns[first:end, 0]] * k).sum())
        ends = updates[vertex["update_start"] : vertex["update_end"], 3:]
        full = 2.0 * k * size[ends].prod(axis=1)
        square = ends[:, 0] == ends[:, 1]
        factor += float(full.sum() - full[square].sum() / 2.0)
    return factor, solve


def cheapest_structure(n, rows, ends, changing, alike):
    """Structure of a mechanism with the fewest operations at a new pose.

    alike : True if neighbouring masses are similar, so that both orders for trees are accurate
    The other arguments are those of Structure.
    """
    ways = [
        Structure(n, rows, ends, changing, bodies_first)
        for bodies_first in ((False, True) if alike else (False,))
    ]
    return min(ways, key=lambda structure: structure.operations)


def _keep_joint(block):
    """Replace the constant block K of a joint by W^T and -d with -K^-1 = W^T d W."""
    k = len(block)
    K, L, pivots = -block, np.eye(k), np.zeros(k)
    for r in range(k):
        pivots[r] = K[r, r] - L[r, :r] ** 2 @ pivots[:r]
        L[r + 1 :, r] = (K[r + 1 :, r] - L[r + 1 :, :r] @ (pivots[:r] * L[r, :r])) / pivots[r]
    W = scipy.linalg.solve_triangular(L, np.eye(k), lower=True, unit_diagonal=True)
    block[:] = np.tril(W, -1) + np.diag(1.0 / pivots)
    return W.T, np.diag(-1.0 / pivots)


def _keep_body(block):
    """Replace the constant block M of a body by its inverse inertia and 1 / mass; 1 and M^-1.

    The block is block diagonal: a joint that is eliminated before the body adds to it by rows for
    a parent, which change with the pose.
    """
    turns = len(block) // 2
    inverse = np.linalg.inv(block)
    block[:] = 0.0
    block.flat[: turns * turns + 1] = [*inverse[:turns, :turns].ravel(), inverse[-1, -1]]
    return np.eye(len(block)), inverse


class Structure:
    """Blocks of K for bodies and the joints between them.

    n    : number of bodies
    rows : scalars of each joint, at least one
    ends : (parent, child) body of each joint; the parent may be WORLD
    changing     : mask of joints whose rows for the child depend on the pose; those for a parent
                   always do
    bodies_first : elimination order for trees, see above
    unknowns   : size of K
    operations : additions and multiplications of a solve at a new pose
    """

    def __init__(self, n, rows, ends, changing, bodies_first):
        self._n, self._rows, self._ends = n, rows, ends
        sizes = [SCALARS] * n + list(rows)  # bodies 0..n-1, then joints
        neighbours = [set() for _ in sizes]
        for j, pair in enumerate(ends):
            for end in pair:
                if end != WORLD:
                    neighbours[end].add(n + j)
                    neighbours[n + j].add(end)
        order, self._below = elimination_order(sizes, neighbours, n, bodies_first)
        self._position = {v: p for p, v in enumerate(order)}
        self._sizes = sizes = np.array([sizes[v] for v in order], dtype=np.int64)
        self.unknowns = int(sizes.sum())
        blocks = [self._pair(j, pair[1]) for j, pair in enumerate(ends) if changing[j]]
        blocks += [self._pair(j, pair[0]) for j, pair in enumerate(ends) if pair[0] != WORLD]
        self._place, self._ends_of_parts, ranges, self._columns, self._updates = block_layout(
            sizes, self._below, blocks
        )
        # In Work.solution: bodies, then joints, each in their own order.
        self._starts = np.cumsum([0, *([SCALARS] * n), *rows])
        self._vertices = np.array(
            [(max(v - n, -1), sizes[p], self._starts[v], *ranges[p]) for p, v in enumerate(order)],
            dtype=VERTEX,
        )
        self.operations = sum(operations(self._vertices, self._columns, self._updates))

    def joints(self):
        """(m,) of JOINT, without kinds and elements."""
        joints = np.zeros(len(self._ends), dtype=JOINT)
        for j, (parent, child) in enumerate(self._ends):
            joint = joints[j]
            joint["parent"], joint["child"] = parent, child
            joint["rows"], joint["start"] = self._rows[j], self._starts[self._n + j]
            joint["first"] = joint["start"] - self._starts[self._n]
            joint["child_place"], joint["child_turned"] = self._block(j, child)
            joint["parent_place"], joint["parent_turned"] = self._block(j, parent)
        return joints

    def _block(self, joint, body):
        """Address of the block of a joint and a body in K, and 1 if the block is transposed."""
        if body == WORLD:
            return -1, 0
        row, column = self._pair(joint, body)
        return self._place[row, column], int(row == self._position[body])

    def _pair(self, joint, body):
        """The block of a joint and a body: positions of its rows and columns."""
        joint, body = self._position[self._n + joint], self._position[body]
        return max(joint, body), min(joint, body)

    def arrays(self, masses, jacobians):
        """Fields of a Model: vertices, columns, updates, K and its constant part.

        masses    : mass matrix of each body
        jacobians : (k, 6) rows of each joint for its child; zeros if they depend on the pose
        """
        summed, fresh, _, _ = self._ends_of_parts
        constant = self._constant_part(masses, jacobians)
        return {
            "vertices": self._vertices,
            "columns": self._columns,
            "updates": self._updates,
            "constant": constant,
            "matrix": self._eliminated(constant),
            "summed": summed,
            "fresh": fresh,
        }

    def _constant_part(self, masses, jacobians):
        """Flat array of K with M and the children's rows; the rest is zero."""
        _, _, size, _ = self._ends_of_parts
        constant = np.zeros(size)
        for i, matrix in enumerate(masses):
            at = self._place[self._position[i], self._position[i]]
            constant[at : at + matrix.size] = matrix.ravel()
        for j, jacobian in enumerate(jacobians):
            at, turned = self._block(j, self._ends[j][1])
            constant[at : at + jacobian.size] = (jacobian.T if turned else jacobian).ravel()
        return constant

    def _eliminated(self, constant):
        """K after elimination of the constant vertices, as saddle_point does it, and scratch memory."""
        _, fresh, size, end = self._ends_of_parts
        matrix = np.concatenate([constant, np.zeros(end - size)])
        for j, coupled in enumerate(self._below):
            if not self._vertices[j]["is_constant"]:
                continue
            diagonal = self._view(matrix, j, j)
            constant_below = [i for i in coupled if self._place[i, j] >= fresh]
            keep = _keep_joint if self._vertices[j]["joint"] >= 0 else _keep_body
            P, D = keep(diagonal)
            products = {i: self._view(matrix, i, j) @ P for i in constant_below}
            for i, product in products.items():
                self._view(matrix, i, j)[:] = product @ D
            for a, i in enumerate(constant_below):
                for k in constant_below[: a + 1]:
                    self._view(matrix, i, k)[:] -= self._view(matrix, i, j) @ products[k].T
        return matrix

    def _view(self, flat, i, j):
        """Block (i, j) of a flat array, two-dimensional."""
        rows, columns = self._sizes[i], self._sizes[j]
        at = self._place[i, j]
        return flat[at : at + rows * columns].reshape(rows, columns)
